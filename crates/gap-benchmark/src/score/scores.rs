//! Counts of right and wrong answers, and what is aimed at.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::{Answer, Mapping, Named, Share};
use crate::Region;
use crate::set::{GroundTruth, Kind};

/// Scores of the cases of one gap size, of one noise level, or of all.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Scores {
    /// Cases.
    pub cases: usize,
    /// Single causes of the library: first name right, a class counted as one over its size.
    pub top1: Share,
    /// First class holds the right name.
    pub class: Share,
    /// Members of those classes.
    pub class_sizes: Vec<f64>,
    /// Among the first three.
    pub top3: Share,
    /// Names that stand alone in their class and are firm: right.
    pub precision: Share,
    /// Controls where a firm effect is named.
    pub false_alarms: Share,
    /// Controls where any effect is named, or a gap of unknown cause is seen.
    pub any_alarms: Share,
    /// Causes outside of the library that are seen and called unknown.
    pub unknown_found: Share,
    /// Causes outside of the library where a firm effect is named.
    pub unknown_named: Share,
    /// Single causes of the library that are called unknown.
    pub false_unknown: Share,
    /// Causes outside of the library that would be called unknown, were the limit of the unexplained share such that at most 2 % of
    /// those inside are.
    pub unknown_at_2: Share,
    /// Causes that this recording cannot tell from others: the class holds the right name.
    pub confounded: Share,
    /// The same: one firm name, and a wrong one.
    pub confounded_wrong: Share,
    /// Several causes: all found.
    pub all_found: Share,
    /// Several causes: at least one found.
    pub one_found: Share,
    /// Several causes: something else named besides.
    pub extra: Share,
    /// Two causes: both found.
    pub both_found: Share,
    /// Localised causes: the first axis is right.
    pub axis: Share,
    /// One of the first two axes is.
    pub axis_of_two: Share,
    /// Causes on some channels or at one place: that is where the gap is seen.
    pub region: Share,
    /// Localised causes: one of the first two axes is right, and the region where there is one.
    pub located: Share,
    /// 90 % intervals of parameters that hold the true value.
    pub covered: Share,
    /// Relative errors of parameters.
    pub parameter_errors: Vec<f64>,
    /// Differences between predicted and achieved reduction of the residual.
    #[serde(rename = "residual_reduction_errors", alias = "closure_errors")]
    pub reduction_errors: Vec<f64>,
    /// Intervals of the reduction that hold what was achieved.
    #[serde(rename = "residual_reduction_covered", alias = "closure_covered")]
    pub reduction_covered: Share,
    /// Differences between predicted reduction and that in another recording of the same reference device.
    pub elsewhere_errors: Vec<f64>,
    /// Intervals of the reduction that hold that in another recording.
    pub elsewhere_covered: Share,
    /// Logarithms of the probability of the right answer, for single causes and those outside of the library.
    pub log_scores: Vec<f64>,
    /// What was answered for each cause of single cases: counts by cause and first answer.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
    #[serde(skip)]
    unexplained: [Vec<f64>; 2],
}

/// The middle one; NaN of nothing.
#[must_use]
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[n / 2],
        n => 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]),
    }
}

/// 1 of what is so, 0 of what is not.
fn yes(so: bool) -> f64 {
    f64::from(u8::from(so))
}

impl Scores {
    /// Adds one case.
    pub fn add(
        &mut self,
        truth: &GroundTruth,
        answer: &Answer,
        mapping: &Mapping,
        library: &BTreeSet<String>,
    ) {
        self.cases += 1;
        let right = |name: &String| truth.causes.iter().any(|t| mapping.right(&t.cause.id, name));
        let hit = |class: &[String]| class.iter().any(right);
        for named in answer.named.iter().filter(|n| n.firm && n.class.len() == 1) {
            // A control may hold a cause that is too weak to matter: naming it right is no mistake.
            self.precision.add(yes(hit(&named.class)));
        }
        let first = answer.named.first();
        let firm = |n: &&Named| n.firm;
        let wrong = |n: &Named| !hit(&n.class);
        match truth.kind {
            Kind::Controls => {
                self.false_alarms.add(yes(answer.named.iter().filter(firm).any(wrong)));
                let unknown = answer.gap && answer.unknown;
                self.any_alarms.add(yes(unknown || answer.named.iter().any(wrong)));
                self.confused("(nothing)", answer);
                return;
            }
            Kind::Pairs | Kind::Triples => {
                if mapping.holds(truth) {
                    let found = truth.causes.iter().map(|t| {
                        let right = |name: &String| mapping.right(&t.cause.id, name);
                        answer.named.iter().any(|n| n.class.iter().any(right))
                    });
                    let found: Vec<bool> = found.collect();
                    let all = yes(found.iter().all(|f| *f));
                    self.all_found.add(all);
                    if found.len() == 2 {
                        self.both_found.add(all);
                    }
                    self.one_found.add(yes(found.iter().any(|f| *f)));
                    self.extra.add(yes(answer.named.iter().any(wrong)));
                }
            }
            Kind::Confounded if mapping.holds(truth) => {
                self.confounded.add(yes(first.is_some_and(|n| hit(&n.class))));
                let sure = first.filter(|n| n.firm && n.class.len() == 1);
                self.confounded_wrong.add(yes(sure.is_some_and(wrong)));
            }
            _ if truth.kind != Kind::Confounded && mapping.holds(truth) => {
                let found = first.is_some_and(|n| hit(&n.class));
                self.class.add(yes(found));
                self.class_sizes.extend(first.map(|n| n.class.len() as f64));
                self.top1.add(first.filter(|_| found).map_or(0.0, |n| {
                    n.class.iter().filter(|name| right(name)).count() as f64 / n.class.len() as f64
                }));
                self.top3.add(yes(answer.ranking.iter().take(3).any(right)));
                self.false_unknown.add(yes(answer.unknown));
                self.unexplained[0].push(answer.unexplained.unwrap_or(0.0));
                self.single(truth, answer, mapping, library);
            }
            _ => {
                self.unknown_found.add(yes(answer.unknown));
                self.unknown_named.add(yes(answer.named.iter().any(|n| n.firm)));
                self.unexplained[1].push(answer.unexplained.unwrap_or(0.0));
                self.single(truth, answer, mapping, library);
            }
        }
        if truth.causes.len() == 1 {
            self.located(truth, answer, mapping);
        }
        self.residual_reduction(answer);
        self.parameters(truth, answer, mapping);
    }

    /// What was answered first.
    fn confused(&mut self, cause: &str, answer: &Answer) {
        let said = answer.named.first();
        let said = said.map_or_else(|| format!("({})", answer.verdict), |n| n.class.join(" or "));
        *self.confusion.entry(cause.to_owned()).or_default().entry(said).or_default() += 1;
    }

    fn single(
        &mut self,
        truth: &GroundTruth,
        answer: &Answer,
        mapping: &Mapping,
        library: &BTreeSet<String>,
    ) {
        if let Some(withheld) = truth.causes.first() {
            self.confused(&withheld.cause.id, answer);
            self.log_scores.push(answer.probability(mapping.of(&withheld.cause.id), library).ln());
        }
        let [inside, outside] = &self.unexplained;
        let mut shares = inside.clone();
        shares.sort_by(|a, b| b.total_cmp(a));
        // The largest limit that leaves at most so many of those inside above it.
        let limit = shares.get((0.02 * inside.len() as f64) as usize).copied().unwrap_or(0.0);
        let over = outside.iter().filter(|share| **share > limit).count();
        self.unknown_at_2 = Share { hits: over as f64, of: outside.len() };
    }

    fn located(&mut self, truth: &GroundTruth, answer: &Answer, mapping: &Mapping) {
        let Some(withheld) = truth.causes.first() else { return };
        let Some(axes) = mapping.causes.get(&withheld.cause.id).map(|a| &a.axes).filter(|a| !a.is_empty())
        else {
            return;
        };
        let among = |first: usize| answer.axes.iter().take(first).any(|a| axes.contains(a));
        self.axis.add(yes(among(1)));
        self.axis_of_two.add(yes(among(2)));
        let region = withheld.region.as_ref().map(|region| match region {
            Region::Channels { names } => answer.channel.as_ref().is_some_and(|c| names.contains(c)),
            Region::Place { at, within } => answer.peak.is_some_and(|peak| {
                let off = peak.iter().zip(at).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
                off.sqrt() <= *within
            }),
        });
        if let Some(region) = region {
            self.region.add(yes(region));
        }
        self.located.add(yes(among(2) && region.unwrap_or(true)));
    }

    fn residual_reduction(&mut self, answer: &Answer) {
        let Some([predicted, achieved]) = answer.residual_reduction else { return };
        self.reduction_errors.push((predicted - achieved).abs());
        let holds = |value: f64| answer.interval.map(|[low, high]| yes((low..=high).contains(&value)));
        if let Some(holds) = holds(achieved) {
            self.reduction_covered.add(holds);
        }
        if let Some(elsewhere) = answer.elsewhere {
            self.elsewhere_errors.push((predicted - elsewhere).abs());
            if let Some(holds) = holds(elsewhere) {
                self.elsewhere_covered.add(holds);
            }
        }
    }

    fn parameters(&mut self, truth: &GroundTruth, answer: &Answer, mapping: &Mapping) {
        for withheld in &truth.causes {
            let Some(accepted) = mapping.causes.get(&withheld.cause.id) else { continue };
            let Some(parameter) = &accepted.parameter else { continue };
            let Some(size) = withheld.parameters.values().next().copied().filter(|v| *v != 0.0) else {
                continue;
            };
            let [neutral, factor] = accepted.scale.unwrap_or([0.0, 1.0]);
            let truth = neutral + factor * size;
            if let Some((value, interval)) = answer.named.iter().find_map(|n| n.parameters.get(parameter)) {
                self.parameter_errors.push(((value - truth) / (truth - neutral)).abs());
                if let Some([low, high]) = interval {
                    self.covered.add(yes((*low..=*high).contains(&truth)));
                }
            }
        }
    }

    /// Every rate with its name and what is aimed at, in the order of tables.
    #[must_use]
    pub fn rates(&self) -> Vec<(&'static str, Share, Option<Aim>)> {
        use Aim::{AtLeast, AtMost, Between};
        vec![
            ("top-1, class-weighted", self.top1, Some(AtLeast(0.90))),
            ("first class holds it", self.class, None),
            ("top-3", self.top3, Some(AtLeast(0.98))),
            ("precision of single firm names", self.precision, Some(AtLeast(0.98))),
            ("false alarms on controls", self.false_alarms, Some(AtMost(0.01))),
            ("any alarm on controls", self.any_alarms, None),
            ("out of library, called unknown", self.unknown_found, None),
            ("out of library, called unknown at 2 % false-unknown", self.unknown_at_2, Some(AtLeast(0.85))),
            ("out of library, a firm name", self.unknown_named, None),
            ("in library, called unknown", self.false_unknown, Some(AtMost(0.02))),
            ("two causes, both found", self.both_found, Some(AtLeast(0.80))),
            ("several causes, all found", self.all_found, None),
            ("several causes, one found", self.one_found, None),
            ("several causes, another named besides", self.extra, None),
            ("confounded, the class holds it", self.confounded, None),
            ("confounded, one firm wrong name", self.confounded_wrong, None),
            ("where: first axis", self.axis, None),
            ("where: one of the first two axes", self.axis_of_two, None),
            ("where: channel or place", self.region, None),
            ("where: axis (of two) and region", self.located, Some(AtLeast(0.90))),
            ("parameter intervals (90 %) that hold", self.covered, Some(Between(0.85, 0.95))),
            (
                "residual reduction intervals (90 %) that hold, held-out contacts",
                self.reduction_covered,
                None,
            ),
            (
                "residual reduction intervals (90 %) that hold, another recording",
                self.elsewhere_covered,
                Some(Between(0.85, 0.95)),
            ),
        ]
    }

    /// Every middle value with its name, count and what is aimed at.
    #[must_use]
    pub fn middles(&self) -> Vec<(&'static str, f64, usize, Option<Aim>)> {
        let of = |name, values: &[f64], aim| (name, median(values), values.len(), aim);
        let most = |limit| Some(Aim::AtMost(limit));
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        vec![
            of("median parameter error", &self.parameter_errors, most(0.10)),
            of(
                "median difference of predicted and achieved residual reduction, held-out contacts",
                &self.reduction_errors,
                most(0.03),
            ),
            of(
                "median difference of predicted and achieved residual reduction, another recording",
                &self.elsewhere_errors,
                None,
            ),
            ("mean members of the first class", mean(&self.class_sizes), self.class_sizes.len(), None),
            ("mean log score [nat]", mean(&self.log_scores), self.log_scores.len(), None),
        ]
    }
}

/// What is aimed at.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Aim {
    /// At least this.
    AtLeast(f64),
    /// At most this.
    AtMost(f64),
    /// From the first to the second.
    Between(f64, f64),
}

impl Aim {
    /// Whether a value reaches it.
    #[must_use]
    pub fn reached(&self, value: f64) -> bool {
        match *self {
            Self::AtLeast(least) => value >= least,
            Self::AtMost(most) => value <= most,
            Self::Between(low, high) => (low..=high).contains(&value),
        }
    }

    /// As a table says it.
    #[must_use]
    pub fn text(&self) -> String {
        match self {
            Self::AtLeast(least) => format!("≥ {least}"),
            Self::AtMost(most) => format!("≤ {most}"),
            Self::Between(low, high) => format!("{low} to {high}"),
        }
    }
}
