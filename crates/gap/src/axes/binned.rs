//! Bins of the axes that a gap may go along.

use std::collections::BTreeMap;

use dermis_skin::Phase;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use super::{CHANNEL, View};
use crate::constants::location::{BINS, CELLS, COMMON, FORCE, IN_BOTH, LEAST, ONE, SPREAD, STILL};
use crate::samples::Sample;
use crate::wording::short;

/// Bins of one axis: for each row the index of its bin, or none.
pub(super) struct Binned {
    pub name: &'static str,
    pub of: Vec<Option<usize>>,
    pub labels: Vec<String>,
    /// Whether bins have an order.
    pub ordered: bool,
}

impl Binned {
    /// The same bins in another order, as chance would have it. What all frames of a place or of a press have in common stays in common:
    /// frames that were done together are no proof of each other. Samples that the axis says nothing of stay where they are.
    pub fn drawn(&self, samples: &[Sample], rng: &mut ChaCha8Rng) -> Vec<Option<usize>> {
        let one = |unit: fn(&Sample) -> usize| -> Option<BTreeMap<usize, usize>> {
            let mut of: BTreeMap<usize, BTreeMap<usize, usize>> = BTreeMap::new();
            for (row, bin) in samples.iter().zip(&self.of) {
                if let Some(bin) = bin {
                    *of.entry(unit(row)).or_default().entry(*bin).or_default() += 1;
                }
            }
            let most = |bins: &BTreeMap<usize, usize>| {
                bins.iter().max_by_key(|(_, n)| **n).map_or((0, 0), |(b, n)| (*b, *n))
            };
            let held: usize = of.values().map(|bins| most(bins).1).sum();
            let all: usize = of.values().flat_map(BTreeMap::values).sum();
            (held as f64 > COMMON * all as f64)
                .then(|| of.iter().map(|(u, bins)| (*u, most(bins).0)).collect())
        };
        let units: [fn(&Sample) -> usize; 2] = [|row| row.group, |row| row.press];
        for unit in units {
            let Some(of) = one(unit) else { continue };
            let mut bins: Vec<usize> = of.values().copied().collect();
            bins.shuffle(rng);
            let drawn: BTreeMap<usize, usize> = of.keys().copied().zip(bins).collect();
            return samples
                .iter()
                .zip(&self.of)
                .map(|(row, bin)| bin.and_then(|_| drawn.get(&unit(row)).copied()))
                .collect();
        }
        let mut known: Vec<usize> = self.of.iter().flatten().copied().collect();
        known.shuffle(rng);
        let mut known = known.into_iter();
        self.of.iter().map(|bin| bin.and_then(|_| known.next())).collect()
    }

    /// Whether samples fall into its bins as they do into those of another axis.
    pub fn is_one_with(&self, other: &Self) -> bool {
        if !self.ordered || !other.ordered {
            return false;
        }
        let both: Vec<(f64, f64)> =
            self.of.iter().zip(&other.of).filter_map(|(a, b)| Some(((*a)? as f64, (*b)? as f64))).collect();
        let known = |of: &[Option<usize>]| of.iter().flatten().count();
        let n = both.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| both.iter().map(of).sum::<f64>() / n.max(1.0);
        let (a, b) = (mean(|p| p.0), mean(|p| p.1));
        let sum = |of: &dyn Fn(&(f64, f64)) -> f64| both.iter().map(of).sum::<f64>();
        let (ab, aa, bb) =
            (sum(&|p| (p.0 - a) * (p.1 - b)), sum(&|p| (p.0 - a).powi(2)), sum(&|p| (p.1 - b).powi(2)));
        let most = known(&self.of).max(known(&other.of)) as f64;
        n > IN_BOTH * most && ab.abs() > ONE * (aa * bb).sqrt()
    }
}

/// Bins with as many samples each.
fn quantiles(
    name: &'static str,
    samples: &[Sample],
    value: impl Fn(&Sample) -> f64,
    unit: (&str, f64),
) -> Option<Binned> {
    let mut sorted: Vec<f64> = samples.iter().map(&value).filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let (low, high) = (*sorted.first()?, *sorted.last()?);
    if high - low <= 1e-9 * high.abs().max(1e-12) || sorted.len() < 4 * LEAST {
        return None;
    }
    let bins = BINS.min(sorted.len() / (2 * LEAST)).max(2);
    let mut edges: Vec<f64> = (1..bins).map(|b| sorted[b * sorted.len() / bins]).collect();
    edges.dedup();
    edges.retain(|e| *e > low);
    if edges.is_empty() {
        return None;
    }
    let mut labels = Vec::new();
    let (suffix, scale) = unit;
    let text = |v: f64| short(v * scale);
    for b in 0..=edges.len() {
        let from = if b == 0 { low } else { edges[b - 1] };
        let to = edges.get(b).copied().unwrap_or(high);
        labels.push(format!("{} to {} {suffix}", text(from), text(to)).trim_end().to_owned());
    }
    let of = samples
        .iter()
        .map(|r| Some(value(r)).filter(|v| v.is_finite()).map(|v| edges.partition_point(|e| *e <= v)))
        .collect();
    Some(Binned { name, of, labels, ordered: true })
}

fn listed<K: Ord + Clone>(
    name: &'static str,
    samples: &[Sample],
    key: impl Fn(&Sample) -> Option<K>,
    label: impl Fn(&K) -> String,
) -> Option<Binned> {
    let mut keys: Vec<K> = samples.iter().filter_map(&key).collect();
    keys.sort();
    keys.dedup();
    if keys.len() < 2 {
        return None;
    }
    let labels = keys.iter().map(label).collect();
    let of = samples.iter().map(|r| key(r).and_then(|k| keys.binary_search(&k).ok())).collect();
    Some(Binned { name, of, labels, ordered: false })
}

/// Cells of the surface, about as many as `most`.
fn cells(samples: &[Sample], most: usize) -> Option<Binned> {
    let locations: Vec<[f64; 3]> = samples.iter().filter(|r| r.contacts == 1).map(|r| r.position).collect();
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in &locations {
        for a in 0..3 {
            low[a] = low[a].min(p[a]);
            high[a] = high[a].max(p[a]);
        }
    }
    let spans: Vec<f64> = (0..3).map(|a| high[a] - low[a]).collect();
    let wide: Vec<usize> = (0..3).filter(|a| spans[*a] > SPREAD).collect();
    if wide.is_empty() {
        return None;
    }
    let volume: f64 = wide.iter().map(|a| spans[*a]).product();
    let side = (volume / most as f64).powf(1.0 / wide.len() as f64);
    let cell = |p: &[f64; 3]| -> Vec<i64> {
        wide.iter().map(|&a| ((p[a] - low[a]) / side).floor() as i64).collect()
    };
    let middle = |c: &Vec<i64>| {
        let mut text = Vec::new();
        for (&a, i) in wide.iter().zip(c) {
            let at = low[a] + (*i as f64 + 0.5) * side;
            text.push(format!("{} = {} mm", ["x", "y", "z"][a], short(at * 1e3)));
        }
        text.join(", ")
    };
    listed("surface location", samples, |r| (r.contacts == 1).then(|| cell(&r.position)), middle)
}

/// Every axis that the samples have.
pub(super) fn all(view: &View<'_>, recorded: &[String]) -> Vec<Binned> {
    let samples = &view.samples.list;
    let touched = |r: &Sample| r.phase.touched();
    let phase_name = |p: &Phase| {
        let name = match p {
            Phase::Idle => "idle",
            Phase::Approach => "untouched between presses",
            Phase::Load => "load",
            Phase::Hold => "hold",
            Phase::Slide => "slide",
            Phase::Unload => "unload",
        };
        name.to_owned()
    };
    let when = |r: &Sample| if touched(r) { r.since } else { f64::NAN };
    let after = |r: &Sample| if touched(r) { f64::NAN } else { r.since };
    let count = |r: &Sample| if r.press == usize::MAX { f64::NAN } else { r.press as f64 };
    let speed = |r: &Sample| {
        let speed = r.speed / r.force.max(FORCE);
        if touched(r) && speed.abs() > STILL { speed } else { f64::NAN }
    };
    let history = |r: &Sample| if touched(r) { r.before / r.force.max(FORCE) } else { f64::NAN };
    let found = [
        cells(samples, CELLS),
        quantiles("force", samples, |r| if touched(r) { r.force } else { f64::NAN }, ("N", 1.0)),
        listed("phase", samples, |r| Some(r.phase), phase_name),
        quantiles("time since contact", samples, when, ("s", 1.0)),
        quantiles("time since release", samples, after, ("s", 1.0)),
        quantiles("session time", samples, |r| r.time, ("s", 1.0)),
        quantiles("temperature", samples, |r| r.temperature - 273.15, ("°C", 1.0)),
        // What lags behind is wrong by a share of the reading: the force's speed over the force.
        quantiles("speed of the force", samples, speed, ("of it a second", 1.0)),
        quantiles("presses so far", samples, count, ("", 1.0)),
        quantiles("history: largest force so far per force", samples, history, ("", 1.0)),
        listed("number of contacts", samples, |r| Some(r.contacts), |n| format!("{n} at once")),
        listed(
            "tip",
            samples,
            |r| touched(r).then(|| (r.diameter * 1e6).round() as i64),
            |d| format!("{} mm", short(*d as f64 * 1e-3)),
        ),
        listed(
            "session",
            samples,
            |r| Some(r.session),
            |run| recorded.get(*run as usize).cloned().unwrap_or_else(|| format!("run {run}")),
        ),
    ];
    let mut found: Vec<Binned> = found.into_iter().flatten().collect();
    let labels = vec!["all".to_owned()];
    found.push(Binned { name: CHANNEL, of: vec![Some(0); samples.len()], labels, ordered: false });
    found
}
