//! Generic rivals: shapes that an unknown cause may have, held against the effects that are named.
//!
//! Problem: an effect with a number for each channel, or one that bends with time, fits what it did not cause. Method: flexible
//! regressions that know no cause (a factor of each channel that varies smoothly over place and force, a force curve of each channel,
//! channels mixed by a few patterns, a reading that depends on the course of its press, a change of some locations, a zero that drifts),
//! fitted to the same residual, each scored on locations that it was not fitted to. A name that is right leaves little that they find, for it has few numbers
//! and they have many; one that is wrong is beaten by the rival whose shape its cause has (falsification of models by what a richer one
//! predicts: Gelman and Shalizi 2013, "Philosophy and the practice of Bayesian statistics"; distortions of declared shapes as tests of
//! misspecification: arXiv 2412.15100).
//!
//! Assumptions: all but the last scale signals, so that they say nothing of untouched frames. Cost: one set of sufficient statistics for each
//! rival, and one solve for each fold; no simulation. Channels beyond some tens are left to those with the largest residual.

pub(crate) mod columns;
mod structure;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::constants::rivals::{CHANNELS, FOLDS, PRIOR};
use crate::samples::Samples;
use crate::statistics::{Column, Fit, Statistics};
use crate::wording::short;

pub use structure::Structure;

/// A shape without a cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// A factor of each channel that varies smoothly over place and force.
    Field,
    /// A factor of each channel that bends with the force.
    ForceCurve,
    /// Readings of each channel hold a few patterns of all.
    Mixing,
    /// A factor of each channel that depends on the course of its press.
    Lag,
    /// A factor of all channels that differs in some locations.
    Place,
    /// A drift of the zero of each channel.
    Zero,
}

impl Shape {
    /// All of them.
    const ALL: [Self; 6] = [Self::Field, Self::ForceCurve, Self::Mixing, Self::Lag, Self::Place, Self::Zero];

    /// What it is, in words that go on after "shaped like".
    #[must_use]
    pub const fn what(self) -> &'static str {
        match self {
            Self::Field => "a factor of each channel that varies smoothly over the place",
            Self::ForceCurve => "a force curve of each channel",
            Self::Mixing => "a share of all channels' readings in each",
            Self::Lag => "readings that depend on the course of each press",
            Self::Place => "a change of some locations",
            Self::Zero => "a drift of the zero of each channel",
        }
    }

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Field => "field",
            Self::ForceCurve => "force-curve",
            Self::Mixing => "mixing",
            Self::Lag => "lag",
            Self::Place => "place",
            Self::Zero => "zero",
        }
    }

    /// The axis along which it goes.
    #[must_use]
    pub const fn axis(self) -> &'static str {
        match self {
            Self::Field | Self::Place => "surface location",
            Self::ForceCurve => "force",
            Self::Mixing => "channel",
            Self::Lag => "time since contact",
            Self::Zero => "session time",
        }
    }
}

/// How a shape does against the named effects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rival {
    /// Shape.
    pub shape: Shape,
    /// What it is, with the place where it is strongest.
    pub what: String,
    /// Share of the gap beyond the noise that it explains on locations that it was not fitted to.
    pub explains: f64,
    /// By how much that is more than the named effects leave away, in the same; `None` where none is named.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub excess: Option<f64>,
    /// The same in standard errors over locations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deviations: Option<f64>,
}

/// What shapes are fitted to.
pub(crate) struct Field<'a> {
    pub samples: &'a Samples,
    /// Channels of a sample.
    pub channels: usize,
    /// Signals of the nominal model, whitened.
    pub signals: &'a [f32],
    /// Energy of the noise in each sample of a channel, in deviations squared.
    pub noise: f64,
    pub seed: u64,
}

impl Field<'_> {
    /// The same with the channels alone that have the largest residual, and that residual.
    fn strongest(&self, residual: &[f32]) -> (Vec<usize>, Vec<f32>) {
        let energy = |k: usize| -> f64 {
            residual.iter().skip(k).step_by(self.channels).map(|v| f64::from(*v).powi(2)).sum()
        };
        let mut order: Vec<(f64, usize)> = (0..self.channels).map(|k| (energy(k), k)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<usize> = order.into_iter().take(CHANNELS).map(|(_, k)| k).collect();
        chosen.sort_unstable();
        let values = of_channels(residual, self.channels, &chosen);
        (chosen, values)
    }

    /// Groups in folds: for each group the fold that it is held out in.
    fn folds(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.samples.groups).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(self.seed ^ 0x71a1));
        let mut fold = vec![0; order.len()];
        order.into_iter().enumerate().for_each(|(i, group)| fold[group] = i % FOLDS);
        fold
    }

    /// Energy of the noise in each group, over so many channels.
    fn floor(&self, channels: usize) -> f64 {
        self.noise * (self.samples.list.len() * channels) as f64
    }
}

fn of_channels(values: &[f32], channels: usize, chosen: &[usize]) -> Vec<f32> {
    values.chunks_exact(channels).flat_map(|row| chosen.iter().map(|k| row[*k])).collect()
}

/// What a fit of each set of columns leaves of each group, fitted without that group's fold; and the fit to all groups. `prior` is the
/// inverse variance of a column's coefficient.
fn held_out(
    statistics: &Statistics,
    sets: &[Vec<usize>],
    folds: &[usize],
    prior: impl Fn(usize) -> f64,
) -> Vec<(Vec<f64>, Fit)> {
    let total = statistics.sum(&vec![1.0; statistics.groups()]);
    let rest: Vec<_> = (0..FOLDS)
        .map(|f| {
            let own: Vec<f64> = folds.iter().map(|g| f64::from(u8::from(*g == f))).collect();
            total.minus(&statistics.sum(&own))
        })
        .collect();
    sets.iter()
        .map(|set| {
            let fits: Vec<Fit> = rest.iter().map(|sum| sum.fit(set, &prior)).collect();
            let losses = folds.iter().enumerate().map(|(g, fold)| statistics.loss(g, &fits[*fold]));
            (losses.collect(), total.fit(set, &prior))
        })
        .collect()
}

/// What rivals are held against.
pub(crate) struct Named<'a> {
    /// What the named effects leave, whitened.
    pub left: &'a [f32],
    /// Columns of the model discrepancy, which may make the best of it, as it may in selection.
    pub discrepancy: Vec<&'a Column>,
    /// Inverse variance of their coefficients.
    pub prior: f64,
}

impl Named<'_> {
    /// Columns of the model discrepancy on these channels.
    fn columns(&self, field: &Field<'_>, chosen: &[usize]) -> Vec<Column> {
        let narrow = |c: &&Column| match c.channel {
            Some(k) => {
                let channel = chosen.iter().position(|own| *own == k)?;
                Some(Column { channel: Some(channel), values: c.values.clone() })
            }
            None => Some(Column { channel: None, values: of_channels(&c.values, field.channels, chosen) }),
        };
        self.discrepancy.iter().filter_map(narrow).collect()
    }

    /// What is left of each group on these channels, with the discrepancy fitted to other groups.
    fn losses(&self, field: &Field<'_>, chosen: &[usize], folds: &[usize]) -> Vec<f64> {
        let columns = self.columns(field, chosen);
        let left = of_channels(self.left, field.channels, chosen);
        let statistics = Statistics::new(&columns, &left, field.samples, chosen.len());
        let sets = [Vec::new(), (0..columns.len()).collect()];
        let all = held_out(&statistics, &sets, folds, |_| self.prior).into_iter().map(|(losses, _)| losses);
        all.min_by(|a, b| a.iter().sum::<f64>().total_cmp(&b.iter().sum())).unwrap_or_default()
    }
}

/// What named effects leave beside the model discrepancy, and what shapes still find in it: shares of the gap before them.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Remains {
    /// What is left beyond the noise.
    pub left: f64,
    /// What each shape finds of it on locations that it was not fitted to, with the shape in words.
    pub beyond: Vec<(Shape, f64, String)>,
}

impl Remains {
    /// The shape that finds most.
    pub fn strongest(&self) -> Option<&(Shape, f64, String)> {
        self.beyond.iter().max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// Fits each shape beside the model discrepancy to what named effects leave of `before`.
pub(crate) fn remains(field: &Field<'_>, before: &[f32], after: &Named<'_>) -> Remains {
    let (chosen, residual) = field.strongest(before);
    let count = chosen.len();
    let energy: f64 = residual.iter().map(|v| f64::from(*v).powi(2)).sum();
    let floor = field.floor(count);
    let gap = energy - floor;
    if gap <= 0.0 {
        return Remains::default();
    }
    let signals = of_channels(field.signals, field.channels, &chosen);
    let left = of_channels(after.left, field.channels, &chosen);
    let folds = field.folds();
    let discrepancy = after.columns(field, &chosen);
    let known = discrepancy.len();
    let prior = |c: usize| if c < known { after.prior } else { PRIOR };
    let sum = |of: &(Vec<f64>, Fit)| of.0.iter().sum::<f64>();
    let mut found = Remains { left: f64::INFINITY, beyond: Vec::new() };
    for shape in Shape::ALL {
        let mut columns = discrepancy.clone();
        let made = columns::of(shape, field.samples, &signals, count);
        columns.extend(made.columns);
        if columns.len() == known {
            continue;
        }
        let statistics = Statistics::new(&columns, &left, field.samples, count);
        let own = known..columns.len();
        let sets = [Vec::new(), (0..known).collect(), own.collect(), (0..columns.len()).collect()];
        let fits = held_out(&statistics, &sets, &folds, prior);
        let losses: Vec<f64> = fits.iter().map(sum).collect();
        // The discrepancy makes the best of it, and may be left out.
        let without = losses[0].min(losses[1]);
        found.left = found.left.min((without - floor) / gap);
        let nowhere = vec![[f64::NAN; 3]; if made.locations.is_empty() { 0 } else { known }];
        let what = describe(shape, &fits[2].1, &[nowhere, made.locations].concat());
        found.beyond.push((shape, (without - losses[2].min(losses[3])) / gap, what));
    }
    found
}

/// Scores every shape on `before`, the whitened residual of the nominal model, against what the named effects leave. The one that
/// explains most comes first.
pub(crate) fn contest(field: &Field<'_>, before: &[f32], after: Option<&Named<'_>>) -> Vec<Rival> {
    let (chosen, residual) = field.strongest(before);
    let signals = of_channels(field.signals, field.channels, &chosen);
    let folds = field.folds();
    let mut nothing = vec![0.0; field.samples.groups];
    for (sample, row) in field.samples.list.iter().zip(residual.chunks_exact(chosen.len())) {
        nothing[sample.group] += row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
    }
    let gap = nothing.iter().sum::<f64>() - field.floor(chosen.len());
    if gap <= 0.0 {
        return Vec::new();
    }
    let named = after.map(|after| after.losses(field, &chosen, &folds));
    let mut found: Vec<Rival> = Shape::ALL
        .into_iter()
        .filter_map(|shape| {
            let made = columns::of(shape, field.samples, &signals, chosen.len());
            if made.columns.is_empty() {
                return None;
            }
            let statistics = Statistics::new(&made.columns, &residual, field.samples, chosen.len());
            let all: Vec<usize> = (0..made.columns.len()).collect();
            let (losses, fit) = held_out(&statistics, &[all], &folds, |_| PRIOR).pop()?;
            let explains = (nothing.iter().sum::<f64>() - losses.iter().sum::<f64>()) / gap;
            let (excess, deviations) = match &named {
                Some(named) => {
                    let (excess, deviations) = advantage(named, &losses);
                    (Some(excess / gap), Some(deviations))
                }
                None => (None, None),
            };
            let what = describe(shape, &fit, &made.locations);
            Some(Rival { shape, what, explains, excess, deviations })
        })
        .collect();
    found.sort_by(|a, b| b.explains.total_cmp(&a.explains));
    found
}

/// By how much the second losses are smaller, and that in standard errors over groups.
fn advantage(first: &[f64], second: &[f64]) -> (f64, f64) {
    let apart: Vec<f64> = first.iter().zip(second).map(|(a, b)| a - b).collect();
    let sum: f64 = apart.iter().sum();
    let mean = sum / apart.len().max(1) as f64;
    let spread: f64 = apart.iter().map(|d| (d - mean).powi(2)).sum();
    (sum, sum / spread.sqrt().max(1e-300))
}

/// The shape in words, with the place where it is strongest.
fn describe(shape: Shape, fit: &Fit, locations: &[[f64; 3]]) -> String {
    let strongest =
        fit.terms().filter(|_| !locations.is_empty()).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    match strongest.and_then(|(column, _)| locations.get(column)) {
        Some(at) => {
            let [x, y, z] = at.map(|v| short(v * 1e3));
            format!("{}, most near ({x}, {y}, {z}) mm", shape.what())
        }
        None => shape.what().to_owned(),
    }
}

/// Columns of a shape, and for shapes of locations the place of each column \[m\].
pub(crate) struct Made {
    pub columns: Vec<Column>,
    locations: Vec<[f64; 3]>,
}

/// How what named effects leave goes with channels and locations.
pub(crate) fn structure(field: &Field<'_>, before: &[f32], left: &[f32]) -> Structure {
    structure::of(field, before, left)
}

#[cfg(test)]
mod tests {
    use dermis_skin::Phase;

    use super::*;
    use crate::samples::Sample;

    /// 120 locations along a row, eight samples each, three channels that see what is near.
    fn row() -> (Samples, Vec<f32>) {
        let mut samples = crate::statistics::tests::samples(&(0..960).map(|i| i / 8).collect::<Vec<_>>());
        let mut signals = Vec::new();
        for (i, s) in samples.list.iter_mut().enumerate() {
            let x = ((i / 8) as f64 * 0.618).fract() * 0.03 - 0.015;
            s.position = [x, 0.0, 0.0];
            s.force = 0.2 + 0.8 * ((i / 8) as f64 * 0.377).fract();
            s.phase = [Phase::Load, Phase::Hold, Phase::Hold, Phase::Unload][i % 4];
            s.since = 0.05 * (i % 8) as f64;
            for at in [-0.01, 0.0, 0.01] {
                signals.push((100.0 * s.force / (1.0 + ((x - at) / 0.006f64).powi(2))) as f32);
            }
        }
        (samples, signals)
    }

    fn field<'a>(samples: &'a Samples, signals: &'a [f32]) -> Field<'a> {
        Field { samples, channels: 3, signals, noise: 0.0, seed: 1 }
    }

    fn residual(samples: &Samples, signals: &[f32], of: impl Fn(&Sample, usize) -> f64) -> Vec<f32> {
        let value = |(i, s): (usize, &f32)| (of(&samples.list[i / 3], i % 3) * f64::from(*s)) as f32;
        signals.iter().enumerate().map(value).collect()
    }

    #[test]
    fn the_shape_of_a_cause_explains_it_on_other_places() {
        let (samples, signals) = row();
        let field = field(&samples, &signals);
        let soft = |s: &Sample, _: usize| -0.3 * (-((s.position[0] - 0.006) / 0.002).powi(2)).exp();
        let curve = |s: &Sample, k: usize| (0.2 - 0.1 * k as f64) * s.force;
        let late = |s: &Sample, _: usize| if s.phase == Phase::Load { -0.2 } else { 0.05 };
        let first = |of: &dyn Fn(&Sample, usize) -> f64| {
            contest(&field, &residual(&samples, &signals, of), None).swap_remove(0)
        };
        let place = first(&soft);
        assert_eq!(place.shape, Shape::Place, "{place:?}");
        assert!(
            place.explains > 0.8 && place.what.contains("near (6") || place.what.contains("near (5"),
            "{place:?}"
        );
        // Smooth fields know the force, too.
        assert!([Shape::ForceCurve, Shape::Field].contains(&first(&curve).shape));
        assert!(first(&curve).explains > 0.95 && first(&late).explains > 0.95);
        assert_eq!(first(&late).shape, Shape::Lag);
    }

    #[test]
    fn a_name_that_is_right_is_not_beaten_and_one_that_is_wrong_is() {
        let (samples, signals) = row();
        let field = field(&samples, &signals);
        let soft =
            residual(&samples, &signals, |s, _| -0.3 * (-((s.position[0] - 0.006) / 0.002).powi(2)).exp());
        let none = vec![0.0; soft.len()];
        let best = |after: &[f32]| {
            let named = Named { left: after, discrepancy: Vec::new(), prior: 1.0 };
            let all = contest(&field, &soft, Some(&named));
            all.iter().filter_map(|r| r.excess).fold(f64::NEG_INFINITY, f64::max)
        };
        assert!(best(&none) <= 0.0);
        let half: Vec<f32> = soft.iter().map(|v| 0.7 * v).collect();
        assert!(best(&half) > 0.3);
        // What is left of it lies in some locations.
        let left = structure(&field, &soft, &half);
        assert!(left.local_place > 0.2 && left.local_place > 2.0 * left.channel, "{left:?}");
        let gains = residual(&samples, &signals, |_, k| 0.1 * (k as f64 + 1.0));
        let left = structure(&field, &soft, &gains);
        assert!(left.channel > 3.0 * left.local_place.max(left.interaction), "{left:?}");
    }

    #[test]
    fn shapes_find_what_a_wrong_name_leaves_and_nothing_beside_a_right_one() {
        let (samples, signals) = row();
        let field = field(&samples, &signals);
        let soft =
            residual(&samples, &signals, |s, _| -0.3 * (-((s.position[0] - 0.006) / 0.002).powi(2)).exp());
        let part: Vec<f32> = soft.iter().map(|v| 0.5 * v).collect();
        let none = vec![0.0; soft.len()];
        let of = |left: &[f32]| remains(&field, &soft, &Named { left, discrepancy: Vec::new(), prior: 1.0 });
        let wrong = of(&part);
        let (shape, share, what) = wrong.strongest().unwrap();
        assert!(*shape == Shape::Place && *share > 0.15 && what.contains("most near ("), "{wrong:?}");
        assert!((wrong.left - 0.25).abs() < 1e-3, "{wrong:?}");
        let right = of(&none);
        assert!(
            right.left.abs() < 1e-6 && right.beyond.iter().all(|(_, share, _)| *share < 1e-6),
            "{right:?}"
        );
        // A zero that goes up through the session is one that drifts.
        let (mut samples, signals) = row();
        samples.list.iter_mut().for_each(|s| s.time = s.group as f64);
        let field = self::field(&samples, &signals);
        let set =
            residual(&samples, &vec![100.0; signals.len()], |s, k| 0.1 * (s.group as f64 / 120.0) * k as f64);
        let drifts = remains(&field, &set, &Named { left: &set, discrepancy: Vec::new(), prior: 1.0 });
        assert_eq!(drifts.strongest().unwrap().0, Shape::Zero, "{drifts:?}");
    }
}
