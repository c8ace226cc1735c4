//! Where a gap lies: along which axis, in which bins, and where on the surface.

use std::collections::BTreeMap;

use dermis_skin::{Phase, SkinDescription, Surface};
use nalgebra::Point3;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::rows::{Row, Rows};

/// Permutations whose mean is what an axis explains by chance.
const PERMUTATIONS: usize = 8;
/// Bins of a continuous axis.
const BINS: usize = 8;
/// Rows that a bin must hold to be fitted.
const LEAST: usize = 8;
/// Name of the axis that has no bins: each channel is one.
const CHANNEL: &str = "channel";
/// Points of a map, at most.
const POINTS: usize = 400;

/// One bin of an axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bin {
    /// For people.
    pub label: String,
    /// Rows in it.
    pub rows: usize,
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
    /// chance.
    pub share: f64,
    /// 95 % interval of it, over places.
    pub interval: [f64; 2],
    /// Its bins.
    pub bins: Vec<Bin>,
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
    pub rows: &'a Rows,
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
}

/// Bins with as many rows each.
fn quantiles(
    name: &'static str,
    rows: &[Row],
    value: impl Fn(&Row) -> f64,
    unit: (&str, f64),
) -> Option<Binned> {
    let mut sorted: Vec<f64> = rows.iter().map(&value).filter(|v| v.is_finite()).collect();
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
    let of = rows
        .iter()
        .map(|r| Some(value(r)).filter(|v| v.is_finite()).map(|v| edges.partition_point(|e| *e <= v)))
        .collect();
    Some(Binned { name, of, labels })
}

/// Three digits.
pub(crate) fn short(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 {
        "0".to_owned()
    } else if !(1e-2..1e5).contains(&size) {
        format!("{value:.2e}")
    } else {
        let digits = (2 - size.log10().floor() as i32).max(0) as usize;
        let text = format!("{value:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    }
}

fn listed<K: Ord + Clone>(
    name: &'static str,
    rows: &[Row],
    key: impl Fn(&Row) -> Option<K>,
    label: impl Fn(&K) -> String,
) -> Option<Binned> {
    let mut keys: Vec<K> = rows.iter().filter_map(&key).collect();
    keys.sort();
    keys.dedup();
    if keys.len() < 2 {
        return None;
    }
    let labels = keys.iter().map(label).collect();
    let of = rows.iter().map(|r| key(r).and_then(|k| keys.binary_search(&k).ok())).collect();
    Some(Binned { name, of, labels })
}

/// Cells of the surface, about as many as `most`.
fn cells(rows: &[Row], most: usize) -> Option<Binned> {
    let places: Vec<[f64; 3]> = rows.iter().filter(|r| r.contacts == 1).map(|r| r.position).collect();
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
    listed("surface location", rows, |r| (r.contacts == 1).then(|| cell(&r.position)), middle)
}

fn axes(view: &View<'_>, recorded: &[String]) -> Vec<Binned> {
    let rows = &view.rows.rows;
    let touched = |r: &Row| r.phase.touched();
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
    let when = |r: &Row| if touched(r) { r.since } else { f64::NAN };
    let after = |r: &Row| if touched(r) { f64::NAN } else { r.since };
    let count = |r: &Row| if r.press == usize::MAX { f64::NAN } else { r.press as f64 };
    let history = |r: &Row| if touched(r) { r.before / r.force.max(0.01) } else { f64::NAN };
    let found = [
        cells(rows, 24),
        quantiles("force", rows, |r| if touched(r) { r.force } else { f64::NAN }, ("N", 1.0)),
        listed("phase", rows, |r| Some(r.phase), phase_name),
        quantiles("time since contact", rows, when, ("s", 1.0)),
        quantiles("time since release", rows, after, ("s", 1.0)),
        quantiles("session time", rows, |r| r.time, ("s", 1.0)),
        quantiles("temperature", rows, |r| r.temperature - 273.15, ("°C", 1.0)),
        quantiles("speed of the force", rows, |r| if touched(r) { r.speed } else { f64::NAN }, ("N/s", 1.0)),
        quantiles("presses so far", rows, count, ("", 1.0)),
        quantiles("history: largest force so far per force", rows, history, ("", 1.0)),
        listed("number of contacts", rows, |r| Some(r.contacts), |n| format!("{n} at once")),
        listed(
            "tip",
            rows,
            |r| touched(r).then(|| (r.diameter * 1e6).round() as i64),
            |d| format!("{} mm", short(*d as f64 * 1e-3)),
        ),
        listed(
            "session",
            rows,
            |r| Some(r.session),
            |run| recorded.get(*run as usize).cloned().unwrap_or_else(|| format!("run {run}")),
        ),
    ];
    let mut found: Vec<Binned> = found.into_iter().flatten().collect();
    found.push(Binned { name: CHANNEL, of: vec![Some(0); rows.len()], labels: vec!["all".to_owned()] });
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

/// What a residual leaves, rows × channels, after a mean and a factor for each bin, fitted on the other one of two folds.
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
    for (i, row) in view.rows.rows.iter().enumerate() {
        for &k in &usable {
            let (x, y) = (view.model[i * width + k], residual[i * width + k]);
            lines[at(i, k)][fold[row.group]].add(f64::from(x), f64::from(y));
        }
    }
    let fits: Vec<[(f64, f64); 2]> = lines.iter().map(|l| [l[1].fit(), l[0].fit()]).collect();
    let mut left = vec![0.0; residual.len()];
    for (i, row) in view.rows.rows.iter().enumerate() {
        for &k in &usable {
            let (a, c) = fits[at(i, k)][fold[row.group]];
            let (x, y) = (view.model[i * width + k], residual[i * width + k]);
            left[i * width + k] = (f64::from(y) - a - c * f64::from(x)) as f32;
        }
    }
    left
}

/// Energy of each group.
fn energies(view: &View<'_>, residual: &[f32]) -> Vec<f64> {
    let mut energy = vec![0.0; view.rows.groups];
    for (row, values) in view.rows.rows.iter().zip(residual.chunks_exact(view.channels)) {
        energy[row.group] += values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
    }
    energy
}

/// How much of the gap goes along each axis, the most telling first.
///
/// What all channels have in common, a mean and a factor, goes along no axis. The channel's share is what a mean and a factor of its own
/// explain beyond that; of every other axis, what one for each bin explains beyond the channel's, be it alike on all channels or
/// different on each.
#[must_use]
pub fn shares(view: &View<'_>, sessions: &[String], seed: u64) -> Vec<Axis> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0xa7e5);
    let groups = view.rows.groups;
    let mut order: Vec<usize> = (0..groups).collect();
    order.shuffle(&mut rng);
    let mut fold = vec![0; groups];
    order.iter().enumerate().for_each(|(i, g)| fold[*g] = i % 2);
    let before = energies(view, view.residual);
    let all = vec![Some(0); view.rows.rows.len()];
    let common = energies(view, &held_out(view, view.residual, (&all, 1), &fold, Pool::Bins));
    let alone = held_out(view, view.residual, (&all, 1), &fold, Pool::Channels);
    let own = energies(view, &alone);
    let mut found = Vec::new();
    for axis in axes(view, sessions) {
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
                    // Rows that the axis says nothing of stay where they are.
                    let mut known: Vec<usize> = axis.of.iter().flatten().copied().collect();
                    known.shuffle(&mut rng);
                    let mut drawn = known.into_iter();
                    let of: Vec<Option<usize>> =
                        axis.of.iter().map(|o| o.and_then(|_| drawn.next())).collect();
                    by_chance += share(&own, &left(&of), &mut (0..groups)) / PERMUTATIONS as f64;
                }
                let after = left(&axis.of);
                let value = share(&own, &after, &mut (0..groups)) - by_chance;
                if best.as_ref().is_none_or(|b| value > b.0) {
                    best = Some((value, after, by_chance));
                }
            }
            let Some((_, after, by_chance)) = best else { continue };
            (&own, after, by_chance)
        };
        let value = share(base, &after, &mut (0..groups)) - by_chance;
        let mut drawn: Vec<f64> = (0..200)
            .map(|_| {
                let mut draw = (0..groups).map(|_| rand::Rng::random_range(&mut rng, 0..groups));
                share(base, &after, &mut draw) - by_chance
            })
            .collect();
        drawn.sort_by(f64::total_cmp);
        let bins = if axis.name == CHANNEL { Vec::new() } else { bins(view, &axis) };
        found.push(Axis { axis: axis.name.to_owned(), share: value, interval: [drawn[5], drawn[194]], bins });
    }
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found
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
        .map(|(label, (rows, energy, square))| Bin {
            label: label.clone(),
            rows,
            fvu: energy / (rows as f64 * n) / view.variance,
            rmse: (square / (rows as f64 * n)).sqrt(),
        })
        .collect()
}

/// Unexplained variance and error of each channel.
#[must_use]
pub fn channels(view: &View<'_>, readings: &[f32], skin: &SkinDescription) -> Vec<Bin> {
    let n = view.rows.rows.len().max(1) as f64;
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
                rows: view.rows.rows.len(),
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
    let single: Vec<usize> = (0..view.rows.rows.len())
        .filter(|i| view.rows.rows[*i].contacts == 1 && view.rows.rows[*i].phase.touched())
        .collect();
    if single.len() < 20 {
        return Map::default();
    }
    let area: f64 = surface.areas.iter().sum();
    // As wide as some eight contacts lie apart.
    let mut places: Vec<[i64; 3]> =
        single.iter().map(|i| view.rows.rows[*i].position.map(|v| (v * 1e5).round() as i64)).collect();
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
            let away = (Point3::from(view.rows.rows[i].position) - point).norm() / width;
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
