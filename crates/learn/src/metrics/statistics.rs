//! Statistics of errors: percentiles, and intervals over resampled groups.

use std::collections::BTreeMap;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Error, Summary};

const RESAMPLES: usize = 1000;
const LOW: f64 = 0.025;
const HIGH: f64 = 0.975;

pub(super) fn summarise(name: &str, errors: &[Error], seed: u64) -> Summary {
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
        unit: match name {
            "angle" => "rad",
            _ if name.starts_with("position") => "m",
            _ => "N",
        }
        .into(),
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

/// Sorts magnitudes, and says which is in the middle; NaN of nothing.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    percentile(values, 0.5)
}

/// Linear between the order statistics; NaN of nothing.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let at = share * last as f64;
    let below = at.floor() as usize;
    let (low, high) = (sorted[below], sorted[(below + 1).min(last)]);
    let share = at - below as f64;
    // Infinite ones are among the bounds: their difference is no number.
    if share == 0.0 || low.total_cmp(&high).is_eq() { low } else { low + share * (high - low) }
}
