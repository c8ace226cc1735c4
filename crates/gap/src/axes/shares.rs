//! What a mean and a factor for each bin explain on held-out groups, and where the energy of a residual lies.

use super::View;
use super::binned::Binned;
use crate::constants::location::{LEAST, RIDGE};

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
        let slope = (self.xy - self.x * self.y / self.n) / (spread + RIDGE);
        ((self.y - slope * self.x) / self.n, slope)
    }
}

/// How a fit shares its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Pool {
    /// A mean and a factor for each bin and channel.
    Channels,
    /// A mean and a factor for each bin, alike on all channels.
    Bins,
}

/// What a residual leaves, samples × channels, after a mean and a factor for each bin, fitted on the other one of two folds.
pub(super) fn held_out(
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
pub(super) struct Held {
    bins: usize,
    of: Vec<[f64; 3]>,
}

impl Held {
    pub fn of(view: &View<'_>, residual: &[f32], axis: &Binned) -> Self {
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
    /// groups `learnt`, and how much more it is there on groups `tested`.
    fn moved(&self, learnt: impl Iterator<Item = usize>, tested: impl Iterator<Item = usize>) -> f64 {
        let [learnt, tested] = [self.sums(learnt), self.sums(tested)];
        let total = |sums: &[[f64; 3]], i: usize| sums.iter().map(|s| s[i]).sum::<f64>();
        let energy = total(&tested, 0);
        let excess = |sums: &[[f64; 3]], b: usize, mix: f64| {
            let share = |i: usize| sums[b][i] / total(sums, i).max(1e-300);
            share(0) - mix * share(1) - (1.0 - mix) * share(2)
        };
        let moved = |mix: f64| {
            let bins = (0..self.bins).filter(|b| excess(&learnt, *b, mix) > 0.0);
            bins.map(|b| excess(&tested, b, mix)).sum::<f64>()
        };
        let least = [0.0, 0.25, 0.5, 0.75, 1.0].map(moved).into_iter().fold(f64::INFINITY, f64::min);
        if energy > 0.0 { least * energy } else { 0.0 }
    }

    /// The same over the folds of draws of groups, each learnt on the other one.
    pub fn concentrated(&self, fold: &[usize], drawn: &[usize]) -> f64 {
        let of = |f: usize| drawn.iter().copied().filter(move |g| fold[*g] == f);
        self.moved(of(0), of(1)) + self.moved(of(1), of(0))
    }
}

/// Energy of each group.
pub(super) fn energies(view: &View<'_>, residual: &[f32]) -> Vec<f64> {
    let mut energy = vec![0.0; view.samples.groups];
    for (row, values) in view.samples.list.iter().zip(residual.chunks_exact(view.channels)) {
        energy[row.group] += values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
    }
    energy
}
