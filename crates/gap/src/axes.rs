//! Where a gap lies: along which axis, in which bins, and where on the surface.

use std::collections::BTreeMap;

use dermis_skin::{Phase, SkinDescription, Surface};
use nalgebra::Point3;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::constants::location::{
    BINS, CELLS, COMMON, DRAWS, INTERVAL, LEAST, ONE, PERMUTATIONS, POINTS, STILL, UNLUCKY,
};
use crate::samples::{Sample, Samples};
use crate::wording::short;

/// Name of the axis that has no bins: each channel is one.
const CHANNEL: &str = "channel";
/// Name of the axis of interference.
pub(crate) const FREQUENCY: &str = "frequency";

/// One bin of an axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bin {
    /// For people.
    pub label: String,
    /// Samples in it.
    pub samples: usize,
    /// Unexplained variance in it, in shares of the readings' variance over all bins.
    pub fvu: f64,
    /// Root mean square of readings minus model, in the unit of the skin.
    pub rmse: f64,
}

/// How much of a gap goes along one axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// Name.
    pub axis: String,
    /// Share of the gap on held-out contacts that a mean and a factor for each bin explain beyond those of each channel, and beyond
    /// chance; or that lies in other bins than readings do, where this is more.
    pub share: f64,
    /// 95 % interval of it, over places.
    pub interval: [f64; 2],
    /// Its bins.
    pub bins: Vec<Bin>,
    /// Axes that go with this one in the recording, so that no reading can tell them apart.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alike: Vec<String>,
}

impl Axis {
    /// Its name with those of the axes that go with it.
    #[must_use]
    pub fn title(&self) -> String {
        std::iter::once(self.axis.as_str())
            .chain(self.alike.iter().map(String::as_str))
            .collect::<Vec<_>>()
            .join(" or ")
    }
}

/// The gap over the surface.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Map {
    /// \[m\] places, in the frame of the skin's link.
    pub points: Vec<[f64; 3]>,
    /// Mean of readings minus model over channels and contacts near each place, in the unit of the skin; `None` below the noise.
    pub mean: Vec<Option<f64>>,
    /// Root mean square of the same; `None` below the noise.
    pub rms: Vec<Option<f64>>,
    /// Where the gap is largest \[m\].
    pub peak: Option<[f64; 3]>,
    /// How much larger it is there than in the median place.
    pub prominence: f64,
}

/// What residual and model were in each row.
pub struct View<'a> {
    /// Frames.
    pub samples: &'a Samples,
    /// Channels.
    pub channels: usize,
    /// Readings minus model, in deviations of the noise.
    pub residual: &'a [f32],
    /// Model, in the same.
    pub model: &'a [f32],
    /// Deviation of each channel's noise, in the unit of the skin.
    pub sigma: &'a [f64],
    /// Energy of readings about their means, a reading.
    pub variance: f64,
    /// Energy of the noise, a reading.
    pub noise: f64,
}

impl View<'_> {
    fn row(&self, i: usize) -> &[f32] {
        &self.residual[i * self.channels..(i + 1) * self.channels]
    }

    fn usable(&self) -> Vec<usize> {
        (0..self.channels).filter(|k| self.sigma[*k].is_finite()).collect()
    }
}

/// Bins of one axis: for each row the index of its bin, or none.
struct Binned {
    name: &'static str,
    of: Vec<Option<usize>>,
    labels: Vec<String>,
    /// Whether bins have an order.
    ordered: bool,
}

impl Binned {
    /// The same bins in another order, as chance would have it. What all frames of a place or of a press have in common stays in common:
    /// frames that were done together are no proof of each other. Samples that the axis says nothing of stay where they are.
    fn drawn(&self, samples: &[Sample], rng: &mut ChaCha8Rng) -> Vec<Option<usize>> {
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
    fn is_one_with(&self, other: &Self) -> bool {
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
        n > 0.9 * most && ab.abs() > ONE * (aa * bb).sqrt()
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
    let places: Vec<[f64; 3]> = samples.iter().filter(|r| r.contacts == 1).map(|r| r.position).collect();
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in &places {
        for a in 0..3 {
            low[a] = low[a].min(p[a]);
            high[a] = high[a].max(p[a]);
        }
    }
    let spans: Vec<f64> = (0..3).map(|a| high[a] - low[a]).collect();
    let wide: Vec<usize> = (0..3).filter(|a| spans[*a] > 1e-3).collect();
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

fn axes(view: &View<'_>, recorded: &[String]) -> Vec<Binned> {
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
        let speed = r.speed / r.force.max(0.01);
        if touched(r) && speed.abs() > STILL { speed } else { f64::NAN }
    };
    let history = |r: &Sample| if touched(r) { r.before / r.force.max(0.01) } else { f64::NAN };
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

/// Sums for the fit of residual = a + c · model in one bin and channel.
#[derive(Debug, Clone, Copy, Default)]
struct Line {
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
}

impl Line {
    fn add(&mut self, x: f64, y: f64) {
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
    }

    /// Intercept and slope; nothing where there is too little.
    fn fit(&self) -> (f64, f64) {
        if self.n < LEAST as f64 {
            return (0.0, 0.0);
        }
        let spread = self.xx - self.x * self.x / self.n;
        // A weak prior: where the model is silent there is no slope.
        let slope = (self.xy - self.x * self.y / self.n) / (spread + 10.0);
        ((self.y - slope * self.x) / self.n, slope)
    }
}

/// How a fit shares its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pool {
    /// A mean and a factor for each bin and channel.
    Channels,
    /// A mean and a factor for each bin, alike on all channels.
    Bins,
}

/// What a residual leaves, samples × channels, after a mean and a factor for each bin, fitted on the other one of two folds.
fn held_out(
    view: &View<'_>,
    residual: &[f32],
    (of, bins): (&[Option<usize>], usize),
    fold: &[usize],
    pool: Pool,
) -> Vec<f32> {
    let usable = view.usable();
    let width = view.channels;
    let mut lines = vec![[Line::default(); 2]; (bins + 1) * width];
    let at = |i: usize, k: usize| {
        let bin = of[i].unwrap_or(bins);
        if pool == Pool::Bins { bin } else { bin * width + k }
    };
    for (i, row) in view.samples.list.iter().enumerate() {
        for &k in &usable {
            let (x, y) = (view.model[i * width + k], residual[i * width + k]);
            lines[at(i, k)][fold[row.group]].add(f64::from(x), f64::from(y));
        }
    }
    let fits: Vec<[(f64, f64); 2]> = lines.iter().map(|l| [l[1].fit(), l[0].fit()]).collect();
    let mut left = vec![0.0; residual.len()];
    for (i, row) in view.samples.list.iter().enumerate() {
        for &k in &usable {
            let (a, c) = fits[at(i, k)][fold[row.group]];
            let (x, y) = (view.model[i * width + k], residual[i * width + k]);
            left[i * width + k] = (f64::from(y) - a - c * f64::from(x)) as f32;
        }
    }
    left
}

/// What each bin of an axis holds of each group: energy of a residual beyond noise, energy of the model, and samples.
struct Held {
    bins: usize,
    of: Vec<[f64; 3]>,
}

impl Held {
    fn of(view: &View<'_>, residual: &[f32], axis: &Binned) -> Self {
        let (usable, bins) = (view.usable(), axis.labels.len());
        let mut of = vec![[0.0; 3]; view.samples.groups * bins];
        for (i, (row, bin)) in view.samples.list.iter().zip(&axis.of).enumerate() {
            let Some(bin) = bin else { continue };
            let held = &mut of[row.group * bins + bin];
            for &k in &usable {
                let (x, y) = (view.model[i * view.channels + k], residual[i * view.channels + k]);
                held[0] += f64::from(y).powi(2) - view.noise;
                held[1] += f64::from(x).powi(2);
                held[2] += 1.0;
            }
        }
        Self { bins, of }
    }

    /// Sums over groups, a bin.
    fn sums(&self, groups: impl Iterator<Item = usize>) -> Vec<[f64; 3]> {
        let mut sums = vec![[0.0; 3]; self.bins];
        for g in groups {
            for (sum, held) in sums.iter_mut().zip(&self.of[g * self.bins..]) {
                (0..3).for_each(|i| sum[i] += held[i]);
            }
        }
        sums
    }

    /// Energy that lies in other bins than it would, were it spread as what the model reads or as samples are: bins where it is too much on
    /// groups `learnt`, and how much more it is there on groups `asked`.
    fn moved(&self, learnt: impl Iterator<Item = usize>, asked: impl Iterator<Item = usize>) -> f64 {
        let [learnt, asked] = [self.sums(learnt), self.sums(asked)];
        let total = |sums: &[[f64; 3]], i: usize| sums.iter().map(|s| s[i]).sum::<f64>();
        let energy = total(&asked, 0);
        let excess = |sums: &[[f64; 3]], b: usize, mix: f64| {
            let share = |i: usize| sums[b][i] / total(sums, i).max(1e-300);
            share(0) - mix * share(1) - (1.0 - mix) * share(2)
        };
        let moved = |mix: f64| {
            let bins = (0..self.bins).filter(|b| excess(&learnt, *b, mix) > 0.0);
            bins.map(|b| excess(&asked, b, mix)).sum::<f64>()
        };
        let least = [0.0, 0.25, 0.5, 0.75, 1.0].map(moved).into_iter().fold(f64::INFINITY, f64::min);
        if energy > 0.0 { least * energy } else { 0.0 }
    }

    /// The same over the folds of draws of groups, each learnt on the other one.
    fn concentrated(&self, fold: &[usize], drawn: &[usize]) -> f64 {
        let of = |f: usize| drawn.iter().copied().filter(move |g| fold[*g] == f);
        self.moved(of(0), of(1)) + self.moved(of(1), of(0))
    }
}

/// Energy of each group.
fn energies(view: &View<'_>, residual: &[f32]) -> Vec<f64> {
    let mut energy = vec![0.0; view.samples.groups];
    for (row, values) in view.samples.list.iter().zip(residual.chunks_exact(view.channels)) {
        energy[row.group] += values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
    }
    energy
}

/// How much of the gap goes along each axis, the most telling first.
///
/// What all channels have in common, a mean and a factor, goes along no axis. The channel's share is what a mean and a factor of its own
/// explain beyond that; of every other axis, what one for each bin explains beyond the channel's, be it alike on all channels or
/// different on each. A gap that changes its sign from place to place has no such mean and still lies somewhere: where it is more, the
/// share of an axis is the part of the gap that would have to move to other bins for it to be spread as readings are.
#[must_use]
pub fn shares(view: &View<'_>, sessions: &[String], seed: u64) -> Vec<Axis> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0xa7e5);
    let groups = view.samples.groups;
    let mut order: Vec<usize> = (0..groups).collect();
    order.shuffle(&mut rng);
    let mut fold = vec![0; groups];
    order.iter().enumerate().for_each(|(i, g)| fold[*g] = i % 2);
    let before = energies(view, view.residual);
    let all = vec![Some(0); view.samples.list.len()];
    let common = energies(view, &held_out(view, view.residual, (&all, 1), &fold, Pool::Bins));
    let alone = held_out(view, view.residual, (&all, 1), &fold, Pool::Channels);
    let own = energies(view, &alone);
    let mut found: Vec<Axis> = Vec::new();
    let every = axes(view, sessions);
    for axis in &every {
        let share = |base: &[f64], after: &[f64], groups: &mut dyn Iterator<Item = usize>| {
            let (mut gained, mut all) = (0.0, 0.0);
            for g in groups {
                gained += base[g] - after[g];
                all += before[g];
            }
            if all > 0.0 { gained / all } else { 0.0 }
        };
        let bins_of = axis.labels.len();
        let (base, after, by_chance) = if axis.name == CHANNEL {
            (&common, own.clone(), 0.0)
        } else {
            let mut best: Option<(f64, Vec<f64>, f64)> = None;
            for pool in [Pool::Channels, Pool::Bins] {
                let left = |of: &[Option<usize>]| {
                    energies(view, &held_out(view, &alone, (of, bins_of), &fold, pool))
                };
                let mut by_chance = 0.0;
                for _ in 0..PERMUTATIONS {
                    let of = axis.drawn(&view.samples.list, &mut rng);
                    by_chance += share(&own, &left(&of), &mut (0..groups)) / PERMUTATIONS as f64;
                }
                // Where few frames hold most of the energy, chance loses more than any axis gains.
                let by_chance = by_chance.max(-UNLUCKY);
                let after = left(&axis.of);
                let value = share(&own, &after, &mut (0..groups)) - by_chance;
                if best.as_ref().is_none_or(|b| value > b.0) {
                    best = Some((value, after, by_chance));
                }
            }
            let Some((_, after, by_chance)) = best else { continue };
            (&own, after, by_chance)
        };
        let held = Held::of(view, &alone, axis);
        let energy = |draw: &[usize]| draw.iter().map(|g| before[*g]).sum::<f64>().max(1e-300);
        let concentrated = |draw: &[usize]| held.concentrated(&fold, draw) / energy(draw);
        let explained = |draw: &[usize]| share(base, &after, &mut draw.iter().copied()) - by_chance;
        let all: Vec<usize> = (0..groups).collect();
        let of = |draw: &[usize], place: bool| if place { concentrated(draw) } else { explained(draw) };
        let place = concentrated(&all) > explained(&all);
        let value = of(&all, place);
        let mut drawn: Vec<f64> = (0..DRAWS)
            .map(|_| {
                let draw: Vec<usize> =
                    all.iter().map(|_| rand::Rng::random_range(&mut rng, 0..groups)).collect();
                of(&draw, place)
            })
            .collect();
        drawn.sort_by(f64::total_cmp);
        let bins = if axis.name == CHANNEL { Vec::new() } else { bins(view, axis) };
        let alike = Vec::new();
        let interval = INTERVAL.map(|i| drawn[i]);
        found.push(Axis { axis: axis.name.to_owned(), share: value, interval, bins, alike });
    }
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    let of = |name: &str| every.iter().find(|axis| axis.name == name);
    let mut told: Vec<Axis> = Vec::new();
    for axis in found {
        let one =
            told.iter_mut().find(|t| of(&t.axis).zip(of(&axis.axis)).is_some_and(|(a, b)| a.is_one_with(b)));
        match one {
            Some(one) => one.alike.push(axis.axis),
            None => told.push(axis),
        }
    }
    told
}

fn bins(view: &View<'_>, axis: &Binned) -> Vec<Bin> {
    let usable = view.usable();
    let mut sums: Vec<(usize, f64, f64)> = vec![(0, 0.0, 0.0); axis.labels.len()];
    for (i, of) in axis.of.iter().enumerate() {
        let Some(of) = of else { continue };
        let s = &mut sums[*of];
        s.0 += 1;
        for &k in &usable {
            let v = f64::from(view.row(i)[k]);
            s.1 += v * v;
            s.2 += (v * view.sigma[k]).powi(2);
        }
    }
    let n = usable.len().max(1) as f64;
    axis.labels
        .iter()
        .zip(sums)
        .filter(|(_, s)| s.0 > 0)
        .map(|(label, (samples, energy, square))| Bin {
            label: label.clone(),
            samples,
            fvu: energy / (samples as f64 * n) / view.variance,
            rmse: (square / (samples as f64 * n)).sqrt(),
        })
        .collect()
}

/// Unexplained variance and error of each channel.
#[must_use]
pub fn channels(view: &View<'_>, readings: &[f32], skin: &SkinDescription) -> Vec<Bin> {
    let n = view.samples.list.len().max(1) as f64;
    let width = view.channels;
    view.usable()
        .into_iter()
        .map(|k| {
            let of = |values: &[f32]| -> (f64, f64) {
                let values = values.iter().skip(k).step_by(width).map(|v| f64::from(*v));
                values.fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v))
            };
            let (sum, square) = of(readings);
            let (_, residual) = of(view.residual);
            Bin {
                label: skin.channels()[k].name.clone(),
                samples: view.samples.list.len(),
                fvu: residual / (square - sum * sum / n).max(1e-300),
                rmse: (residual / n).sqrt() * view.sigma[k],
            }
        })
        .collect()
}

/// The gap over the surface: contacts near each place, weighted by their distance.
#[must_use]
pub fn map(view: &View<'_>, surface: &Surface) -> Map {
    let usable = view.usable();
    let single: Vec<usize> = (0..view.samples.list.len())
        .filter(|i| view.samples.list[*i].contacts == 1 && view.samples.list[*i].phase.touched())
        .collect();
    if single.len() < 20 {
        return Map::default();
    }
    let area: f64 = surface.areas.iter().sum();
    // As wide as some eight contacts lie apart.
    let mut places: Vec<[i64; 3]> =
        single.iter().map(|i| view.samples.list[*i].position.map(|v| (v * 1e5).round() as i64)).collect();
    places.sort_unstable();
    places.dedup();
    let width = (area / places.len() as f64 * 4.0).sqrt().max(extent(surface) / 40.0);
    let each = surface.points.len().div_ceil(POINTS).max(1);
    let mut map = Map::default();
    let mut strongest: Option<(f64, usize)> = None;
    let mut levels = Vec::new();
    for point in surface.points.iter().step_by(each) {
        let (mut weight, mut mean, mut square, mut contacts, mut raw) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for &i in &single {
            let away = (Point3::from(view.samples.list[i].position) - point).norm() / width;
            if away > 3.0 {
                continue;
            }
            let w = (-away * away / 2.0).exp();
            weight += w;
            contacts += w * w;
            for &k in &usable {
                let v = f64::from(view.row(i)[k]);
                mean += w * v * view.sigma[k];
                square += w * (v * view.sigma[k]).powi(2);
                raw += w * v * v;
            }
        }
        let n = usable.len().max(1) as f64;
        let effective = if contacts > 0.0 { weight * weight / contacts } else { 0.0 };
        let known = weight > 0.05 && effective > 1.0;
        let excess = raw / (weight.max(1e-12) * n);
        // Twice the noise of a mean over that many contacts.
        let beyond = known && excess > view.noise * (1.0 + 3.0 / (effective * n).sqrt());
        let value = (square / (weight.max(1e-12) * n)).sqrt();
        map.points.push((*point).into());
        map.mean.push(beyond.then(|| mean / (weight * n)));
        map.rms.push(beyond.then_some(value));
        if known {
            levels.push(value);
        }
        if beyond && strongest.is_none_or(|s| value > s.0) {
            strongest = Some((value, map.points.len() - 1));
        }
    }
    levels.sort_by(f64::total_cmp);
    let median = levels.get(levels.len() / 2).copied().unwrap_or(0.0);
    if let Some((value, index)) = strongest {
        map.peak = Some(map.points[index]);
        map.prominence = value / median.max(1e-300);
    }
    map
}

/// \[m\] largest extent of a surface.
fn extent(surface: &Surface) -> f64 {
    let mut found = BTreeMap::new();
    for p in &surface.points {
        for a in 0..3 {
            let (low, high) = found.entry(a).or_insert((f64::INFINITY, f64::NEG_INFINITY));
            *low = f64::min(*low, p[a]);
            *high = f64::max(*high, p[a]);
        }
    }
    found.values().map(|(low, high)| high - low).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Forty places, each pressed once with eight frames, on two channels.
    fn samples() -> Samples {
        let mut samples = Samples { groups: 40, test: vec![false; 40], presses: 40, ..Samples::default() };
        for i in 0..320 {
            let (group, step) = (i / 8, i % 8);
            samples.list.push(Sample {
                frame: i,
                group,
                press: group,
                location: (0, group as u32),
                session: 0,
                phase: Phase::Hold,
                force: 0.5 + 0.1 * step as f64,
                since: 0.1 * ((3 * step) % 8) as f64,
                time: i as f64,
                before: 0.5 + 0.1 * step as f64,
                speed: 0.0,
                temperature: f64::NAN,
                position: [1e-3 * ((group * 7) % 40) as f64, 0.0, 0.0],
                diameter: 8e-3,
                contacts: 1,
                paired: false,
            });
        }
        samples
    }

    fn found(gap: impl Fn(&Sample) -> f64) -> Vec<Axis> {
        let samples = samples();
        let model: Vec<f32> = samples.list.iter().flat_map(|r| [100.0 * r.force as f32; 2]).collect();
        let residual: Vec<f32> = samples.list.iter().flat_map(|r| [gap(r) as f32; 2]).collect();
        let sigma = [1.0, 1.0];
        let view = View {
            samples: &samples,
            channels: 2,
            residual: &residual,
            model: &model,
            sigma: &sigma,
            variance: 1e4,
            noise: 0.0,
        };
        shares(&view, &["run".to_owned()], 1)
    }

    #[test]
    fn a_gap_that_changes_its_sign_lies_where_it_is() {
        // From the middle of the session on, to either side from place to place: no mean and no factor holds it.
        let axes = found(|r| {
            if r.time < 160.0 {
                0.0
            } else if r.group % 2 == 0 {
                10.0
            } else {
                -10.0
            }
        });
        assert_eq!(axes[0].axis, "session time", "{axes:?}");
        assert!((axes[0].share - 0.5).abs() < 0.1 && axes[0].interval[0] < axes[0].share, "{:?}", axes[0]);
        // Presses follow each other evenly.
        assert_eq!(axes[0].title(), "session time or presses so far");
        assert!(axes.iter().all(|a| a.axis != "presses so far"));
    }

    #[test]
    fn what_goes_with_the_force_and_with_nothing_is_told() {
        let axes = found(|r| if r.force > 1.0 { 40.0 * (r.force - 1.0) } else { 0.0 });
        let force = axes.iter().find(|a| a.axis == "force").unwrap();
        assert!(
            force.share > 0.05
                && force.share > axes.iter().find(|a| a.axis == "surface location").unwrap().share
        );
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let signs: Vec<f64> =
            (0..320).map(|_| if rand::Rng::random_bool(&mut rng, 0.5) { 10.0 } else { -10.0 }).collect();
        let axes = found(|r| signs[r.frame]);
        assert!(axes.iter().all(|a| a.share < 0.15), "{axes:?}");
    }
}
