//! What a tool answered on a benchmark set, compared to what was withheld: counts with Wilson's intervals.

mod cells;
mod scorecard;
mod scores;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::set::GroundTruth;

pub use cells::{Auroc, CellScores, Cells, cell};
pub use scorecard::Scorecard;
pub use scores::{Aim, Scores, median};

/// Between names that a tool says are of one thing: together they count as one answer.
pub const SAME: &str = " = ";

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
    pub const TEXT: &str = include_str!("../../mapping.toml");

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

    /// Whether a name is right for a cause. A name may be several of one thing, joined by [`SAME`].
    #[must_use]
    pub fn right(&self, cause: &str, name: &str) -> bool {
        name.split(SAME).any(|name| self.of(cause).iter().any(|n| n == name))
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
    /// All names that would explain it as well, the label first; names of one thing are one member ([`SAME`]).
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
    /// Share of the residual that it says it removes, before and after it is tried.
    #[serde(alias = "closure")]
    pub residual_reduction: Option<[f64; 2]>,
    /// 90 % interval of the share of the residual that it says it removes.
    pub interval: Option<[f64; 2]>,
    /// Share of the residual that what it names removes in another recording of the same reference device,
    /// where that was tried.
    pub elsewhere: Option<f64>,
    /// Share of the gap that it leaves unexplained; 0 where it sees none.
    pub unexplained: Option<f64>,
    /// How much speaks for "none of the known effects", the more the surer; the unexplained share counts where it says none.
    #[serde(default)]
    pub evidence: Option<f64>,
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
                let hits = first
                    .class
                    .iter()
                    .filter(|n| n.split(SAME).any(|n| right.iter().any(|r| r == n)))
                    .count();
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
