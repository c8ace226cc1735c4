//! What a tool answered on a benchmark set, compared to what was withheld: counts with Wilson's intervals.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use serde::{Deserialize, Serialize};

use crate::Region;
use crate::set::{GroundTruth, Kind};

/// Which of a tool's names are right for a cause.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Accepted {
    /// Names of the tool's library; none where no library effect is this cause.
    pub names: Vec<String>,
    /// The tool's parameter, as `effect.parameter`, that is the same physical quantity as the cause's own size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter: Option<String>,
    /// What is added to the cause's size, times the second number, to have the tool's parameter: 0 and 1 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<[f64; 2]>,
    /// Axes along which the cause shows, where it is localised: on one channel, at one place, or along one axis. Any of them is
    /// right.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub axes: Vec<String>,
}

/// From causes to the names of the tool, by cause.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Mapping {
    /// By the cause's name in ground truths.
    pub causes: BTreeMap<String, Accepted>,
}

impl Mapping {
    /// The mapping that belongs to the benchmark sets of this version.
    pub const TEXT: &str = include_str!("../mapping.toml");

    /// Reads one.
    ///
    /// # Errors
    ///
    /// What is wrong with it.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        toml::from_str(text).map_err(|e| e.to_string())
    }

    fn of(&self, cause: &str) -> &[String] {
        self.causes.get(cause).map_or(&[], |a| &a.names)
    }

    /// The mapping for a tool that has the effects of `library` only: a cause without any of its names is outside of the library.
    #[must_use]
    pub fn within(&self, library: &BTreeSet<String>) -> Self {
        let mut within = self.clone();
        within.causes.values_mut().for_each(|a| a.names.retain(|n| library.contains(n)));
        within
    }

    /// Whether the library has an effect for every cause.
    fn holds(&self, truth: &GroundTruth) -> bool {
        truth.causes.iter().all(|withheld| !self.of(&withheld.cause.id).is_empty())
    }
}

/// An effect that a tool names, with all that it cannot tell apart from it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Named {
    /// All names that would explain it as well, the label first.
    pub class: Vec<String>,
    /// Whether the tool stands by it, or says that it may be the model discrepancy of its own simulator as well.
    pub firm: bool,
    /// Value and 90 % interval of each parameter, by `effect.parameter`.
    pub parameters: BTreeMap<String, (f64, Option<[f64; 2]>)>,
}

/// What a tool says of one recording.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Answer {
    /// Its verdict, in its own words.
    pub verdict: String,
    /// Whether it sees a gap beyond noise and margin.
    pub gap: bool,
    /// Whether it says that none of its effects is the cause of most of it.
    pub unknown: bool,
    /// Effects, the most important first.
    pub named: Vec<Named>,
    /// Names from the most to the least likely, for whoever counts the first three.
    pub ranking: Vec<String>,
    /// Share of the gap that it says it closes, before and after it is tried.
    pub closure: Option<[f64; 2]>,
    /// 90 % interval of the share that it says it closes.
    pub interval: Option<[f64; 2]>,
    /// Share of the gap that what it names closes in another recording of the same reference device, where that was tried.
    pub elsewhere: Option<f64>,
    /// Share of the gap that it leaves unexplained; 0 where it sees none.
    pub unexplained: Option<f64>,
    /// Axes along which it sees the gap, the most telling first.
    pub axes: Vec<String>,
    /// Channel where it sees the largest gap.
    pub channel: Option<String>,
    /// \[m\] place where it sees the largest gap.
    pub peak: Option<[f64; 3]>,
}

impl Answer {
    /// The probability that its words give to any of the names `right`; of none of `library` where there are none. Nine tenths go to
    /// what it answers, in equal parts to all members of the first class, and one tenth to all other answers alike.
    #[must_use]
    pub fn probability(&self, right: &[String], library: &BTreeSet<String>) -> f64 {
        let others = library.len() as f64 + 1.0;
        let (said, count) = match self.named.first() {
            _ if self.unknown => (right.is_empty(), 1.0),
            Some(first) if !first.class.is_empty() => {
                let hits = first.class.iter().filter(|n| right.contains(n)).count();
                (hits > 0, first.class.len() as f64 / (hits.max(1) as f64))
            }
            _ => (false, 1.0),
        };
        let rest = 0.1 * right.len().max(1) as f64 / others;
        if said { 0.9 / count + rest } else { rest }
    }
}

/// A share of counts.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Share {
    /// What is counted; class hits count their part only.
    pub hits: f64,
    /// Of how many.
    pub of: usize,
}

impl Share {
    fn add(&mut self, hit: f64) {
        self.hits += hit;
        self.of += 1;
    }

    /// With one more count, which hits in part.
    #[must_use]
    pub fn and(mut self, hit: f64) -> Self {
        self.add(hit);
        self
    }

    /// The share; NaN of nothing.
    #[must_use]
    pub fn value(&self) -> f64 {
        self.hits / self.of as f64
    }

    /// Wilson's 95 % interval.
    #[must_use]
    pub fn interval(&self) -> [f64; 2] {
        if self.of == 0 {
            return [0.0, 1.0];
        }
        let (z, n, p) = (1.959_964, self.of as f64, self.value());
        let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
        let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
        [(middle - half).max(0.0), (middle + half).min(1.0)]
    }
}

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
    /// Differences between predicted and achieved closure.
    pub closure_errors: Vec<f64>,
    /// Intervals of the closure that hold what was achieved.
    pub closure_covered: Share,
    /// Differences between predicted closure and that in another recording of the same reference device.
    pub elsewhere_errors: Vec<f64>,
    /// Intervals of the closure that hold that in another recording.
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
        let right = |name: &String| truth.causes.iter().any(|t| mapping.of(&t.cause.id).contains(name));
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
                        let names = mapping.of(&t.cause.id);
                        answer.named.iter().any(|n| n.class.iter().any(|name| names.contains(name)))
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
            Kind::Singles | Kind::OutOfLibrary if mapping.holds(truth) => {
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
            Kind::Singles | Kind::Confounded | Kind::OutOfLibrary => {
                self.unknown_found.add(yes(answer.unknown));
                self.unknown_named.add(yes(answer.named.iter().any(|n| n.firm)));
                self.unexplained[1].push(answer.unexplained.unwrap_or(0.0));
                self.single(truth, answer, mapping, library);
            }
        }
        if truth.causes.len() == 1 {
            self.located(truth, answer, mapping);
        }
        self.closure(answer);
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

    fn closure(&mut self, answer: &Answer) {
        let Some([predicted, achieved]) = answer.closure else { return };
        self.closure_errors.push((predicted - achieved).abs());
        let holds = |value: f64| answer.interval.map(|[low, high]| yes((low..=high).contains(&value)));
        if let Some(holds) = holds(achieved) {
            self.closure_covered.add(holds);
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
            ("closure intervals (90 %) that hold, held-out contacts", self.closure_covered, None),
            (
                "closure intervals (90 %) that hold, another recording",
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
                "median difference of predicted and achieved closure, held-out contacts",
                &self.closure_errors,
                most(0.03),
            ),
            of(
                "median difference of predicted and achieved closure, another recording",
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

/// Scores of a whole benchmark set: all cases, those with a gap of at least three times the floor, and those of each gap and noise.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Scorecard {
    /// All cases.
    pub all: Scores,
    /// Gap at least three times the floor; controls and causes outside of the library included.
    pub headline: Scores,
    /// By gap, controls having none, in multiples of the floor.
    pub by_gap: BTreeMap<String, Scores>,
    /// By noise in multiples of the skin's, of those of the headline.
    pub by_noise: BTreeMap<String, Scores>,
    /// Names that the mapping accepts and the tool does not have.
    pub not_in_library: Vec<String>,
}

impl Scorecard {
    /// Scores of answers, one a ground truth, of a tool that has the effects of `library`.
    #[must_use]
    pub fn new<'a>(
        cases: impl IntoIterator<Item = (&'a GroundTruth, &'a Answer)>,
        mapping: &Mapping,
        library: &BTreeSet<String>,
    ) -> Self {
        let names: BTreeSet<&String> = mapping.causes.values().flat_map(|a| &a.names).collect();
        let not_in_library = names.into_iter().filter(|n| !library.contains(*n)).cloned().collect();
        let mut scorecard = Self { not_in_library, ..Self::default() };
        let mapping = mapping.within(library);
        for (truth, answer) in cases {
            scorecard.all.add(truth, answer, &mapping, library);
            let gap = scorecard.by_gap.entry(format!("{}", truth.gap)).or_default();
            gap.add(truth, answer, &mapping, library);
            if truth.gap == 0.0 || truth.gap >= 3.0 {
                scorecard.headline.add(truth, answer, &mapping, library);
                let noise = scorecard.by_noise.entry(format!("{}", truth.noise)).or_default();
                noise.add(truth, answer, &mapping, library);
            }
        }
        scorecard
    }

    /// As Markdown: the headline with what is aimed at, the main rates by gap and noise, and what was answered for each cause.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = String::from(
            "Gap of at least three times the floor, controls, and causes outside of the library:\n\n\
             | score | value | 95 % | of | aim | reached |\n|---|---|---|---|---|---|\n",
        );
        let s = &self.headline;
        let reached = |aim: Option<Aim>, value: f64| {
            aim.map_or((String::new(), ""), |a| (a.text(), if a.reached(value) { "yes" } else { "no" }))
        };
        for (name, share, aim) in s.rates().into_iter().filter(|(_, share, _)| share.of > 0) {
            let [low, high] = share.interval();
            let (aim, reached) = reached(aim, share.value());
            let value = share.value();
            let _ = writeln!(
                text,
                "| {name} | {value:.3} | {low:.2} to {high:.2} | {} | {aim} | {reached} |",
                share.of
            );
        }
        for (name, value, count, aim) in s.middles().into_iter().filter(|(_, _, count, _)| *count > 0) {
            let (aim, reached) = reached(aim, value);
            let _ = writeln!(text, "| {name} | {value:.3} | | {count} | {aim} | {reached} |");
        }
        text.push_str(
            "\n| cases | number | top-1 | top-3 | precision | false alarms | unknown found | both found | located |\n\
             |---|---|---|---|---|---|---|---|---|\n",
        );
        let gaps = self.by_gap.iter().map(|(gap, s)| (format!("gap {gap} × floor"), s));
        let noises = self.by_noise.iter().map(|(noise, s)| (format!("noise × {noise}"), s));
        for (name, s) in gaps.chain(noises) {
            let _ = write!(text, "| {name} | {}", s.cases);
            let of = [s.top1, s.top3, s.precision, s.false_alarms, s.unknown_found, s.both_found, s.located];
            for share in of {
                let _ = match share.of {
                    0 => write!(text, " | -"),
                    of => write!(text, " | {:.2} of {of}", share.value()),
                };
            }
            text.push_str(" |\n");
        }
        if !s.confusion.is_empty() {
            text.push_str("\n| withheld | answered first |\n|---|---|\n");
            for (cause, answers) in &s.confusion {
                let mut said: Vec<(&String, &usize)> = answers.iter().collect();
                said.sort_by(|a, b| b.1.cmp(a.1));
                let said: Vec<String> = said.iter().map(|(name, n)| format!("{n}× {name}")).collect();
                let _ = writeln!(text, "| {cause} | {} |", said.join(", "));
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_is_what_tables_say() {
        // Wilson 1927: 0 of 30 is at most 11.4 %, 9 of 10 lies between 59.6 and 98.2 %.
        let [low, high] = Share { hits: 0.0, of: 30 }.interval();
        assert!(low == 0.0 && (high - 0.1135).abs() < 1e-3, "{high}");
        let [low, high] = Share { hits: 9.0, of: 10 }.interval();
        assert!((low - 0.596).abs() < 1e-3 && (high - 0.982).abs() < 1e-3, "{low} {high}");
    }

    /// A ground truth of one cause, as JSON says it.
    fn truth(kind: &str, cause: &str, region: &serde_json::Value) -> GroundTruth {
        let causes = match cause {
            "" => serde_json::json!([]),
            _ => {
                serde_json::json!([{ "id": cause, "strength": 0.5, "seed": 1, "what": "", "parameters": { "size": 0.5 },
                "region": region }])
            }
        };
        serde_json::from_value(serde_json::json!({
            "schema": "gap-secret/1", "generator": "", "case": "case-0001", "kind": kind, "salt": "", "seed": 1,
            "causes": causes, "gap": if cause.is_empty() { 0.0 } else { 3.0 }, "noise": 1.0, "floor": 0.01,
            "unexplained": 0.03, "alone": [0.03], "form": crate::Numerics::default(), "only_warmer": false, "size": 1.0,
        }))
        .unwrap()
    }

    fn says(classes: &[&[&str]]) -> Answer {
        let named = |class: &&[&str]| Named {
            class: class.iter().map(|n| (*n).to_owned()).collect(),
            firm: true,
            ..Named::default()
        };
        Answer {
            gap: true,
            ranking: classes.iter().flat_map(|c| c.iter().map(|n| (*n).to_owned())).collect(),
            named: classes.iter().map(named).collect(),
            ..Answer::default()
        }
    }

    #[test]
    fn answers_are_scored_by_what_the_library_holds() {
        let mapping = Mapping::from_toml(
            "[causes]\nleads = { names = [\"dead\", \"gain\"], parameter = \"dead.loss\", axes = [\"channel\"] }\n\
             hole = { names = [\"void\"], axes = [\"place\"] }\n",
        )
        .unwrap();
        let library: BTreeSet<String> = ["dead", "gain", "friction"].map(str::to_owned).into();
        let channels = serde_json::json!({ "kind": "channels", "names": ["g3"] });
        let place = serde_json::json!({ "kind": "place", "at": [0.0, 0.0, 0.0], "within": 0.01 });
        let leads = truth("singles", "leads", &channels);
        let hole = truth("out-of-library", "hole", &place);
        let none = truth("controls", "", &serde_json::Value::Null);

        let mut right = says(&[&["dead", "friction"]]);
        right.axes = vec!["force".to_owned(), "channel".to_owned()];
        right.channel = Some("g3".to_owned());
        right.named[0].parameters.insert("dead.loss".to_owned(), (0.6, Some([0.4, 0.55])));
        right.closure = Some([0.9, 0.85]);
        (right.interval, right.elsewhere) = (Some([0.8, 0.95]), Some(0.7));
        let mut unknown = Answer { gap: true, unknown: true, unexplained: Some(0.9), ..Answer::default() };
        unknown.peak = Some([0.02, 0.0, 0.0]);
        let alarm = says(&[&["friction"]]);
        let cases = [(&leads, &right), (&hole, &unknown), (&none, &alarm), (&none, &Answer::default())];
        let scorecard = Scorecard::new(cases, &mapping, &library);
        let s = &scorecard.headline;
        let of = |share: Share| (share.hits, share.of);
        assert_eq!((of(s.top1), of(s.class), of(s.top3)), ((0.5, 1), (1.0, 1), (1.0, 1)));
        assert_eq!((of(s.unknown_found), of(s.unknown_at_2)), ((1.0, 1), (1.0, 1)));
        assert_eq!((of(s.false_alarms), of(s.precision)), ((1.0, 2), (0.0, 1)));
        assert_eq!((of(s.axis), of(s.axis_of_two)), ((0.0, 2), (1.0, 2)));
        assert_eq!((of(s.region), of(s.located)), ((1.0, 2), (1.0, 2)));
        assert_eq!((of(s.closure_covered), of(s.elsewhere_covered)), ((1.0, 1), (0.0, 1)));
        assert!((median(&s.parameter_errors) - 0.2).abs() < 1e-9 && of(s.covered) == (1.0, 1));
        assert_eq!(scorecard.not_in_library, ["void"]);
        // Nine tenths to two names, one tenth to four answers.
        let probability = right.probability(mapping.of("leads"), &library);
        assert!((probability - (0.45 + 0.05)).abs() < 1e-9, "{probability}");
        assert!(scorecard.table().contains("| friction |") || scorecard.table().contains("1× friction"));
    }

    #[test]
    fn every_cause_is_mapped_once() {
        let mapping = Mapping::from_toml(Mapping::TEXT).unwrap();
        let mut known = BTreeSet::new();
        for entry in std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../../launch/skins")).unwrap() {
            let skin = dermis_skin::SkinDescription::load(entry.unwrap().path()).unwrap();
            known.extend(crate::causes(&skin).into_iter().flatten().map(|c| c.id.to_owned()));
        }
        assert_eq!(mapping.causes.keys().cloned().collect::<BTreeSet<_>>(), known);
    }
}
