//! Errors per quantity and force: one implementation for training, evaluation and reports.

use std::collections::BTreeMap;

use pathfinding::matrix::Matrix;
use pathfinding::prelude::kuhn_munkres_min;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use dermis_skin::Contact;

use crate::dataset::{Truth, TruthContact};

mod maps;

pub(crate) use maps::MapScorer;
pub use maps::{MapErrors, MapPart, MapScores, MapSummary};

/// \[N\] edges of the bins of normal force that errors are reported by; the last bin is open.
pub const FORCE_BINS: [f64; 9] = [0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];

const RESAMPLES: usize = 1000;
const LOW: f64 = 0.025;
const HIGH: f64 = 0.975;

/// What is estimated of one frame, in SI units and in the frame of the skin's link; `None` where the model gives
/// no such quantity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Answer {
    /// \[m\].
    pub position: Option<[f64; 3]>,
    /// Whether `position` has a z that the model gives, instead of one that follows from the surface.
    pub depth: bool,
    /// \[N\] exerted on the skin.
    pub force: Option<[f64; 3]>,
    /// \[N\] pressing.
    pub normal_force: Option<f64>,
    /// Whether something touches the skin.
    pub contact: Option<bool>,
}

/// Distribution of one error. For a position the error is a distance, for anything else a difference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// `m` or `N`.
    pub unit: String,
    /// Samples.
    pub samples: usize,
    /// Root mean square.
    pub rms: f64,
    /// Mean magnitude.
    pub mean: f64,
    /// Median magnitude.
    pub median: f64,
    /// 95th percentile of the magnitude.
    pub p95: f64,
    /// Largest magnitude.
    pub max: f64,
    /// Mean of estimate − truth; absent for a distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bias: Option<f64>,
    /// 95 % interval of `rms` over resampled groups; absent with fewer than three groups.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_interval: Option<[f64; 2]>,
    /// 95 % interval of `mean` over resampled groups; absent with fewer than three groups.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_interval: Option<[f64; 2]>,
    /// Number of groups, and what they are.
    pub groups: usize,
    /// `location`, or `press` where all samples are of one or two locations.
    pub grouped_by: String,
}

/// Errors in one bin of normal force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bin {
    /// \[N\] lower end.
    pub from: f64,
    /// \[N\] upper end, absent for the last bin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<f64>,
    /// Samples.
    pub samples: usize,
    /// Root mean square of the error, in the unit of the quantity.
    pub rms: f64,
    /// Mean of the error's magnitude; 0 in cards of dermis 0.1.0 before it was kept.
    #[serde(default)]
    pub mean: f64,
}

/// \[N\] from which on every contact must press for their number to be judged.
pub const COUNTED_FROM: f64 = 0.2;

/// Index in [`FORCE_BINS`] of the bin of a normal force \[N\]; what pulls counts as the lightest.
pub(crate) fn bin_of(force: f64) -> usize {
    FORCE_BINS.iter().filter(|from| force >= **from).count().max(1) - 1
}

/// Root mean squares of values by the true normal force \[N\] of each, of pairs of force and value; empty bins and values of
/// unknown force are left out. `edges` \[N\] ascend; what lies below the first is left out, the last bin is open.
pub fn bins(edges: &[f64], values: impl Iterator<Item = (f64, f64)>) -> Vec<Bin> {
    let mut sums = vec![(0_usize, 0.0, 0.0); edges.len()];
    for (force, value) in values.filter(|(force, _)| force.is_finite()) {
        // What a noisy force cell says of the lightest press may be below 0.
        let force = if edges.first() == Some(&0.0) { force.max(0.0) } else { force };
        let Some(index) = edges.iter().filter(|from| force >= **from).count().checked_sub(1) else {
            continue;
        };
        let (samples, squares, magnitudes) = &mut sums[index];
        *samples += 1;
        *squares += value * value;
        *magnitudes += value.abs();
    }
    let bin = |(i, (samples, squares, magnitudes)): (usize, (usize, f64, f64))| Bin {
        from: edges[i],
        to: edges.get(i + 1).copied(),
        samples,
        rms: (squares / samples as f64).sqrt(),
        mean: magnitudes / samples as f64,
    };
    sums.into_iter().enumerate().filter(|(_, (samples, ..))| *samples > 0).map(bin).collect()
}

#[derive(Debug, Clone, Copy)]
struct Error {
    value: f64,
    /// \[N\] true normal force, NaN where unknown.
    force: f64,
    location: u64,
    press: u64,
}

/// Collects errors sample by sample.
#[derive(Debug, Clone, Default)]
pub struct Scores {
    errors: BTreeMap<&'static str, Vec<Error>>,
    touched: usize,
    missed: usize,
    untouched: usize,
    false_contacts: usize,
    /// By true number of contacts: frames, and those whose number was found right.
    counts: BTreeMap<usize, [usize; 2]>,
}

/// Names of the errors of frames with two, three … contacts.
const OF_SEVERAL: [(&str, &str); 3] = [
    ("position of 2", "force.normal of 2"),
    ("position of 3", "force.normal of 3"),
    ("position of more", "force.normal of more"),
];

impl Scores {
    /// Nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Compares one answer with the truth. `run` tells presses of different runs apart.
    ///
    /// Force errors of an untouched skin are kept apart under `force.normal untouched`. A contact that was missed
    /// counts as a force of 0 and has no position.
    pub fn push(&mut self, run: usize, truth: &Truth, answer: &Answer) {
        if let Some(contact) = answer.contact {
            let (all, wrong) = if truth.touched() {
                (&mut self.touched, &mut self.missed)
            } else {
                (&mut self.untouched, &mut self.false_contacts)
            };
            *all += 1;
            *wrong += usize::from(contact != truth.touched());
        }
        let press = ((run as u64) << 40) ^ truth.press;
        let mut add = |name: &'static str, value: f64| {
            self.errors.entry(name).or_default().push(Error {
                value,
                force: truth.single().and_then(TruthContact::normal_force).unwrap_or(f64::NAN),
                location: u64::from(truth.location),
                press,
            });
        };
        if let Some(force) = answer.normal_force
            && let Some(known) = truth.value("force.normal")
        {
            add(if truth.touched() { "force.normal" } else { "force.normal untouched" }, force - known);
        }
        if !truth.touched() {
            return;
        }
        if let Some(force) = answer.force {
            let mut squares = Some(0.0);
            for (name, value) in ["force.x", "force.y", "force.z"].into_iter().zip(force) {
                let known = truth.value(name);
                if let Some(known) = known {
                    add(name, value - known);
                }
                squares = squares.zip(known).map(|(s, known): (f64, f64)| s + (value - known).powi(2));
            }
            if let Some(squares) = squares {
                add("force", squares.sqrt());
            }
        }
        if let Some(position) = answer.position {
            let names = ["position.x", "position.y", "position.z"];
            let known = names.map(|n| truth.value(n));
            let axes = if answer.depth { 3 } else { 2 };
            let mut squares = Some(0.0);
            for ((name, known), value) in names.into_iter().zip(known).zip(position).take(axes) {
                if let Some(known) = known {
                    add(name, value - known);
                    squares = squares.map(|s: f64| s + (value - known).powi(2));
                } else {
                    squares = None;
                }
            }
            if let Some(squares) = squares {
                add("position", squares.sqrt());
            }
        }
    }

    /// Compares the contacts that were found with those of the truth: their number, and where there are several, each true
    /// one with the one that is found for it (the assignment whose distances add up to least).
    pub fn push_contacts(&mut self, run: usize, truth: &Truth, found: &[Contact]) {
        if !truth.touched() || found.is_empty() {
            return;
        }
        let clear = |c: &TruthContact| c.normal_force().is_none_or(|f| f >= COUNTED_FROM);
        if truth.contacts.iter().all(clear) {
            let [frames, right] = self.counts.entry(truth.contacts.len()).or_default();
            *frames += 1;
            *right += usize::from(found.len() == truth.contacts.len());
        }
        let Some(names) = truth.contacts.len().checked_sub(2).map(|i| OF_SEVERAL[i.min(2)]) else { return };
        let press = ((run as u64) << 40) ^ truth.press;
        for (true_one, index) in truth.contacts.iter().zip(assign(truth, found)) {
            let Some(answer) = index.map(|i| &found[i]) else { continue };
            let force = true_one.normal_force().unwrap_or(f64::NAN);
            let mut add = |name: &'static str, value: f64| {
                if value.is_finite() {
                    let error = Error { value, force, location: u64::from(truth.location), press };
                    self.errors.entry(name).or_default().push(error);
                }
            };
            add(names.0, (answer.position - true_one.position).norm());
            add(names.1, answer.normal_force() - force);
        }
    }

    /// Share of frames whose number of contacts was found right, by true number; frames in which a contact presses with
    /// less than [`COUNTED_FROM`] are left out.
    #[must_use]
    pub fn count_right(&self) -> BTreeMap<usize, f64> {
        self.counts
            .iter()
            .map(|(number, [frames, right])| (*number, *right as f64 / *frames as f64))
            .collect()
    }

    /// Every quantity that was compared: `position` (distance), `position.x` …, `force.normal`,
    /// `force.normal untouched`, `force.x` …, `force` (length of the difference).
    #[must_use]
    pub fn summaries(&self, seed: u64) -> BTreeMap<String, Summary> {
        self.errors.iter().map(|(name, errors)| ((*name).to_owned(), summarise(name, errors, seed))).collect()
    }

    /// Errors by true normal force, for quantities whose samples have one; empty bins are left out.
    #[must_use]
    pub fn by_force(&self, edges: &[f64]) -> BTreeMap<String, Vec<Bin>> {
        let mut all = BTreeMap::new();
        for (name, errors) in &self.errors {
            let bins = bins(edges, errors.iter().map(|e| (e.force, e.value)));
            if !bins.is_empty() {
                all.insert((*name).to_owned(), bins);
            }
        }
        all
    }

    /// Share of touched samples that were taken for untouched; `None` where the question never arose.
    #[must_use]
    pub fn missed(&self) -> Option<f64> {
        (self.touched > 0).then(|| self.missed as f64 / self.touched as f64)
    }

    /// Share of untouched samples that were taken for touched; `None` where the question never arose.
    #[must_use]
    pub fn false_contacts(&self) -> Option<f64> {
        (self.untouched > 0).then(|| self.false_contacts as f64 / self.untouched as f64)
    }
}

/// Which of `found` belongs to each true contact, none twice: the assignment whose distances add up to least (linear sum
/// assignment by the Hungarian method, Kuhn 1955).
fn assign(truth: &Truth, found: &[Contact]) -> Vec<Option<usize>> {
    let (rows, columns) = (truth.contacts.len(), found.len());
    // The method adds weights up exactly: whole picometres, and what is no number is as far as can be.
    let weight = |t: usize, f: usize| {
        let picometres = (found[f].position - truth.contacts[t].position).norm() * 1e12;
        if picometres < FARTHEST as f64 { picometres as i64 } else { FARTHEST }
    };
    let mut assigned = vec![None; rows];
    if rows == 0 || columns == 0 {
        return assigned;
    }
    // Every row gets a column: the shorter side has to be the rows.
    if rows <= columns {
        let weights = Matrix::from_fn(rows, columns, |(t, f)| weight(t, f));
        for (t, f) in kuhn_munkres_min(&weights).1.into_iter().enumerate() {
            assigned[t] = Some(f);
        }
    } else {
        let weights = Matrix::from_fn(columns, rows, |(f, t)| weight(t, f));
        for (f, t) in kuhn_munkres_min(&weights).1.into_iter().enumerate() {
            assigned[t] = Some(f);
        }
    }
    assigned
}

/// \[pm\] Largest distance between two contacts that counts: 10 km, of which sums cannot overflow.
const FARTHEST: i64 = 10_000_000_000_000_000;

fn summarise(name: &str, errors: &[Error], seed: u64) -> Summary {
    let count = errors.len() as f64;
    let rms = (errors.iter().map(|e| e.value * e.value).sum::<f64>() / count).sqrt();
    let mean = errors.iter().map(|e| e.value.abs()).sum::<f64>() / count;
    let mut sorted: Vec<f64> = errors.iter().map(|e| e.value.abs()).collect();
    sorted.sort_by(f64::total_cmp);
    let bias = (name.contains('.') && !name.starts_with("position of"))
        .then(|| errors.iter().map(|e| e.value).sum::<f64>() / count);

    let mut groups = Group::collect(errors, |e| e.location);
    let mut grouped_by = "location";
    if groups.len() < 3 {
        (groups, grouped_by) = (Group::collect(errors, |e| e.press), "press");
    }
    let intervals = (groups.len() >= 3).then(|| bootstrap(&groups, seed));
    Summary {
        unit: if name.starts_with("position") { "m" } else { "N" }.into(),
        samples: errors.len(),
        rms,
        mean,
        median: percentile(&sorted, 0.5),
        p95: percentile(&sorted, 0.95),
        max: sorted.last().copied().unwrap_or(f64::NAN),
        bias,
        rms_interval: intervals.map(|(rms, _)| rms),
        mean_interval: intervals.map(|(_, mean)| mean),
        groups: groups.len(),
        grouped_by: grouped_by.into(),
    }
}

/// Sums over one location or press.
#[derive(Debug, Clone, Copy, Default)]
struct Group {
    count: f64,
    squares: f64,
    magnitudes: f64,
}

impl Group {
    fn collect(errors: &[Error], key: impl Fn(&Error) -> u64) -> Vec<Self> {
        let mut groups: BTreeMap<u64, Self> = BTreeMap::new();
        for e in errors {
            let group = groups.entry(key(e)).or_default();
            group.count += 1.0;
            group.squares += e.value * e.value;
            group.magnitudes += e.value.abs();
        }
        groups.into_values().collect()
    }
}

/// 95 % intervals of root mean square and mean magnitude: whole groups are drawn with replacement, since samples of
/// one location are not independent (Efron & Tibshirani, An Introduction to the Bootstrap, chapter 8).
fn bootstrap(groups: &[Group], seed: u64) -> ([f64; 2], [f64; 2]) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut rms, mut mean) = (Vec::with_capacity(RESAMPLES), Vec::with_capacity(RESAMPLES));
    for _ in 0..RESAMPLES {
        let mut sum = Group::default();
        for _ in groups {
            let drawn = groups[rng.random_range(0..groups.len())];
            sum.count += drawn.count;
            sum.squares += drawn.squares;
            sum.magnitudes += drawn.magnitudes;
        }
        rms.push((sum.squares / sum.count).sqrt());
        mean.push(sum.magnitudes / sum.count);
    }
    let interval = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        [percentile(&values, LOW), percentile(&values, HIGH)]
    };
    (interval(rms), interval(mean))
}

/// Linear between the order statistics; NaN of nothing.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let at = share * last as f64;
    let below = at.floor() as usize;
    let above = (below + 1).min(last);
    sorted[below] + (at - below as f64) * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests;
