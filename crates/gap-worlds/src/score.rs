//! What a tool answered on a pack, compared to what was withheld: counts with Wilson's intervals.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use serde::{Deserialize, Serialize};

use crate::pack::{Kind, Secret};

/// Which of a tool's names are right for a cause.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Accepted {
    /// Names of the tool's library; none where no library effect is this cause.
    pub names: Vec<String>,
    /// The tool's parameter, as `effect.parameter`, that is the same physical quantity as the cause's own size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter: Option<String>,
}

/// From causes to the names of the tool, by cause.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Mapping {
    /// By the cause's name in secrets.
    pub causes: BTreeMap<String, Accepted>,
}

impl Mapping {
    /// The mapping that belongs to the packs of this version.
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

    /// Whether the library has an effect for every cause.
    fn holds(&self, secret: &Secret) -> bool {
        secret.causes.iter().all(|told| !self.of(&told.cause.id).is_empty())
    }
}

/// An effect that a tool names, with all that it cannot tell apart from it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Named {
    /// All names that would explain it as well, the label first.
    pub class: Vec<String>,
    /// Whether the tool stands by it, or says that it may be the form of its own simulator as well.
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

/// Scores of the cases of one gap size and noise level, or of all.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Scores {
    /// Single causes of the library: first name right, a class counted as one over its size.
    pub top1: Share,
    /// First class holds the right name.
    pub class: Share,
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
    /// Single causes of the library that are called unknown.
    pub false_unknown: Share,
    /// Several causes: all found.
    pub all_found: Share,
    /// Several causes: at least one found.
    pub one_found: Share,
    /// Several causes: something else named besides.
    pub extra: Share,
    /// 90 % intervals of parameters that hold the true value.
    pub covered: Share,
    /// Relative errors of parameters.
    pub parameter_errors: Vec<f64>,
    /// Differences between predicted and achieved closure.
    pub closure_errors: Vec<f64>,
    /// Intervals of the closure that hold what was achieved.
    pub closure_covered: Share,
    /// What was answered for each cause of single cases: counts by cause and first answer.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
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

impl Scores {
    /// Adds one case.
    pub fn add(&mut self, secret: &Secret, answer: &Answer, mapping: &Mapping) {
        let right = |name: &String| secret.causes.iter().any(|t| mapping.of(&t.cause.id).contains(name));
        let hit = |class: &[String]| class.iter().any(right);
        let yes = |b: bool| f64::from(u8::from(b));
        for named in answer.named.iter().filter(|n| n.firm && n.class.len() == 1) {
            // A control may hold a cause that is too weak to matter: naming it right is no mistake.
            self.precision.add(yes(hit(&named.class)));
        }
        match secret.kind {
            Kind::Controls => {
                let wrong = |n: &&Named| !hit(&n.class);
                self.false_alarms.add(yes(answer.named.iter().filter(|n| n.firm).any(|n| wrong(&n))));
                let unknown = answer.gap && answer.unknown;
                self.any_alarms.add(yes(unknown || answer.named.iter().any(|n| wrong(&n))));
                return;
            }
            Kind::Singles | Kind::Confounded if mapping.holds(secret) => {
                let first = answer.named.first();
                let found = first.is_some_and(|n| hit(&n.class));
                self.class.add(yes(found));
                self.top1.add(first.filter(|_| found).map_or(0.0, |n| 1.0 / n.class.len() as f64));
                self.top3.add(yes(answer.ranking.iter().take(3).any(right)));
                self.false_unknown.add(yes(answer.unknown));
                let said = first.map_or_else(|| format!("({})", answer.verdict), |n| n.class.join(" or "));
                let id = &secret.causes[0].cause.id;
                *self.confusion.entry(id.clone()).or_default().entry(said).or_default() += 1;
            }
            Kind::Singles | Kind::Confounded | Kind::OutOfLibrary => {
                self.unknown_found.add(yes(answer.unknown));
                let first = answer.named.first();
                let said = first.map_or_else(|| format!("({})", answer.verdict), |n| n.class.join(" or "));
                if let Some(told) = secret.causes.first() {
                    *self.confusion.entry(told.cause.id.clone()).or_default().entry(said).or_default() += 1;
                }
            }
            Kind::Pairs | Kind::Triples => {
                if mapping.holds(secret) {
                    let found: Vec<bool> = secret
                        .causes
                        .iter()
                        .map(|t| {
                            let names = mapping.of(&t.cause.id);
                            answer.named.iter().any(|n| n.class.iter().any(|name| names.contains(name)))
                        })
                        .collect();
                    self.all_found.add(yes(found.iter().all(|f| *f)));
                    self.one_found.add(yes(found.iter().any(|f| *f)));
                    self.extra.add(yes(answer.named.iter().any(|n| !hit(&n.class))));
                }
            }
        }
        if let Some([predicted, achieved]) = answer.closure {
            self.closure_errors.push((predicted - achieved).abs());
            if let Some([low, high]) = answer.interval {
                self.closure_covered.add(yes((low..=high).contains(&achieved)));
            }
        }
        for told in &secret.causes {
            let Some(parameter) = mapping.causes.get(&told.cause.id).and_then(|a| a.parameter.as_ref())
            else {
                continue;
            };
            let Some(truth) = told.parameters.values().next().copied().filter(|v| *v != 0.0) else {
                continue;
            };
            if let Some((value, interval)) = answer.named.iter().find_map(|n| n.parameters.get(parameter)) {
                self.parameter_errors.push(((value - truth) / truth).abs());
                if let Some([low, high]) = interval {
                    self.covered.add(yes((*low..=*high).contains(&truth)));
                }
            }
        }
    }
}

/// Scores of a whole pack: all cases, those with a gap of at least three times the floor, and those of each gap and noise.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Card {
    /// All cases.
    pub all: Scores,
    /// Gap at least three times the floor; controls and causes outside of the library included.
    pub headline: Scores,
    /// By `gap 3, noise 1`.
    pub by: BTreeMap<String, Scores>,
    /// Names that the mapping accepts and the tool does not have.
    pub not_in_library: Vec<String>,
}

impl Card {
    /// Scores of answers, one a secret.
    #[must_use]
    pub fn new<'a>(cases: impl IntoIterator<Item = (&'a Secret, &'a Answer)>, mapping: &Mapping) -> Self {
        let mut card = Self::default();
        for (secret, answer) in cases {
            card.all.add(secret, answer, mapping);
            if secret.gap == 0.0 || secret.gap >= 3.0 {
                card.headline.add(secret, answer, mapping);
            }
            let key = format!("gap {}, noise {}", secret.gap, secret.noise);
            card.by.entry(key).or_default().add(secret, answer, mapping);
        }
        card
    }

    /// As Markdown.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = String::from("| score | value | 95 % | of |\n|---|---|---|---|\n");
        let s = &self.headline;
        for (name, share) in [
            ("top-1, class-weighted", s.top1),
            ("first class holds it", s.class),
            ("top-3", s.top3),
            ("precision of single firm names", s.precision),
            ("false alarms on controls", s.false_alarms),
            ("any alarm on controls", s.any_alarms),
            ("out-of-library called unknown", s.unknown_found),
            ("library called unknown", s.false_unknown),
            ("several: all found", s.all_found),
            ("several: one found", s.one_found),
            ("several: extra named", s.extra),
            ("parameter intervals that hold", s.covered),
            ("closure intervals that hold", s.closure_covered),
        ] {
            if share.of > 0 {
                let [low, high] = share.interval();
                let _ = writeln!(
                    text,
                    "| {name} | {:.3} | {low:.2} to {high:.2} | {} |",
                    share.value(),
                    share.of
                );
            }
        }
        for (name, values) in [
            ("median parameter error", &s.parameter_errors),
            ("median difference of predicted and achieved closure", &s.closure_errors),
        ] {
            if !values.is_empty() {
                let _ = writeln!(text, "| {name} | {:.3} | | {} |", median(values), values.len());
            }
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

    /// Notes which accepted names are none of `library`.
    pub fn note_library(&mut self, mapping: &Mapping, library: &BTreeSet<String>) {
        let names: BTreeSet<&String> = mapping.causes.values().flat_map(|a| &a.names).collect();
        self.not_in_library = names.into_iter().filter(|n| !library.contains(*n)).cloned().collect();
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
