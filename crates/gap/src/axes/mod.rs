//! Where a gap lies: along which axis, in which bins, and where on the surface.
//!
//! Problem: say which circumstance (place, force, time, temperature, ...) a residual goes with. Method: binned regression of the
//! residual on each circumstance, scored on the other of two folds of groups, less the mean of permutations, with a bootstrap
//! interval over groups. Assumption: groups (locations) are independent. Cost: some ten passes over the residual for each axis.

mod binned;
mod map;
mod shares;
#[cfg(test)]
mod tests;

use dermis_skin::SkinDescription;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::constants::location::{DRAWS, INTERVAL, PERMUTATIONS, UNLUCKY};
use crate::samples::Samples;

use binned::Binned;
pub use map::{Map, map};
use shares::{Held, Pool, energies, held_out};

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
    #[serde(alias = "rows")]
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
    /// 95 % interval of it, over locations.
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

/// How much of the gap goes along each axis, the most telling first.
///
/// What all channels have in common, a mean and a factor, goes along no axis. The channel's share is what a mean and a factor of its own
/// explain beyond that; of every other axis, what one for each bin explains beyond the channel's, be it alike on all channels or
/// different on each. A gap that changes its sign from place to place has no such mean and still lies somewhere: where it is more, the
/// share of an axis is the part of the gap that would have to move to other bins for it to be spread as readings are.
#[must_use]
pub fn shares(view: &View<'_>, sessions: &[String], seed: u64) -> Vec<Axis> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0xa7e5);
    let of = Partition::of(view, &mut rng);
    let every = binned::all(view, sessions);
    let mut found: Vec<Axis> = every.iter().filter_map(|axis| of.axis(view, axis, &mut rng)).collect();
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    let of = |name: &str| every.iter().find(|axis| axis.name == name);
    let mut reported: Vec<Axis> = Vec::new();
    for axis in found {
        let one = reported
            .iter_mut()
            .find(|t| of(&t.axis).zip(of(&axis.axis)).is_some_and(|(a, b)| a.is_one_with(b)));
        match one {
            Some(one) => one.alike.push(axis.axis),
            None => reported.push(axis),
        }
    }
    reported
}

/// A residual, parted into what all channels have in common, what each has of its own, and the rest, by group.
struct Partition {
    /// One of two folds for each group.
    fold: Vec<usize>,
    before: Vec<f64>,
    /// What is left after a mean and a factor of all channels.
    common: Vec<f64>,
    /// What is left after those of each channel: values, and energy.
    alone: Vec<f32>,
    own: Vec<f64>,
}

/// What is left in each group after the bins of an axis, and what they explain by chance.
struct Explained<'a> {
    base: &'a [f64],
    after: Vec<f64>,
    by_chance: f64,
}

impl Partition {
    fn of(view: &View<'_>, rng: &mut ChaCha8Rng) -> Self {
        let groups = view.samples.groups;
        let mut order: Vec<usize> = (0..groups).collect();
        order.shuffle(rng);
        let mut fold = vec![0; groups];
        order.iter().enumerate().for_each(|(i, g)| fold[*g] = i % 2);
        let before = energies(view, view.residual);
        let all = vec![Some(0); view.samples.list.len()];
        let common = energies(view, &held_out(view, view.residual, (&all, 1), &fold, Pool::Bins));
        let alone = held_out(view, view.residual, (&all, 1), &fold, Pool::Channels);
        let own = energies(view, &alone);
        Self { fold, before, common, alone, own }
    }

    /// Share of the gap of these groups that goes from `base` to `after`.
    fn share(&self, base: &[f64], after: &[f64], groups: impl Iterator<Item = usize>) -> f64 {
        let (mut gained, mut all) = (0.0, 0.0);
        for g in groups {
            gained += base[g] - after[g];
            all += self.before[g];
        }
        if all > 0.0 { gained / all } else { 0.0 }
    }

    /// What the better of both pools of an axis explains.
    fn explained(&self, view: &View<'_>, axis: &Binned, rng: &mut ChaCha8Rng) -> Option<Explained<'_>> {
        if axis.name == CHANNEL {
            return Some(Explained { base: &self.common, after: self.own.clone(), by_chance: 0.0 });
        }
        let groups = self.before.len();
        let bins = axis.labels.len();
        let mut best: Option<(f64, Explained<'_>)> = None;
        for pool in [Pool::Channels, Pool::Bins] {
            let left = |of: &[Option<usize>]| {
                energies(view, &held_out(view, &self.alone, (of, bins), &self.fold, pool))
            };
            let mut by_chance = 0.0;
            for _ in 0..PERMUTATIONS {
                let of = axis.drawn(&view.samples.list, rng);
                by_chance += self.share(&self.own, &left(&of), 0..groups) / PERMUTATIONS as f64;
            }
            // Where few frames hold most of the energy, chance loses more than any axis gains.
            let by_chance = by_chance.max(-UNLUCKY);
            let after = left(&axis.of);
            let value = self.share(&self.own, &after, 0..groups) - by_chance;
            if best.as_ref().is_none_or(|b| value > b.0) {
                best = Some((value, Explained { base: &self.own, after, by_chance }));
            }
        }
        best.map(|(_, explained)| explained)
    }

    /// The share of one axis with its bootstrap interval over groups.
    fn axis(&self, view: &View<'_>, axis: &Binned, rng: &mut ChaCha8Rng) -> Option<Axis> {
        let groups = self.before.len();
        let Explained { base, after, by_chance } = self.explained(view, axis, rng)?;
        let held = Held::of(view, &self.alone, axis);
        let energy = |draw: &[usize]| draw.iter().map(|g| self.before[*g]).sum::<f64>().max(1e-300);
        let concentrated = |draw: &[usize]| held.concentrated(&self.fold, draw) / energy(draw);
        let explained = |draw: &[usize]| self.share(base, &after, draw.iter().copied()) - by_chance;
        let all: Vec<usize> = (0..groups).collect();
        let of = |draw: &[usize], place: bool| if place { concentrated(draw) } else { explained(draw) };
        let place = concentrated(&all) > explained(&all);
        let share = of(&all, place);
        let mut drawn: Vec<f64> = (0..DRAWS)
            .map(|_| {
                let draw: Vec<usize> = all.iter().map(|_| rng.random_range(0..groups)).collect();
                of(&draw, place)
            })
            .collect();
        drawn.sort_by(f64::total_cmp);
        let bins = if axis.name == CHANNEL { Vec::new() } else { bins(view, axis) };
        let interval = INTERVAL.map(|i| drawn[i]);
        Some(Axis { axis: axis.name.to_owned(), share, interval, bins, alike: Vec::new() })
    }
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
