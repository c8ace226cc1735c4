//! What the channels of a skin read over locations and forces: of a forward model, or of a recording.
//!
//! Readings here are signals: the zero of a recording is subtracted, and so are a model's own untouched readings. They are oriented:
//! a channel that a force changes most downwards (a foam whose voltage falls, a gauge that is compressed) counts with its sign turned
//! ([`Responses::orientation`]), so that every channel rises where it is pressed most. The thesis' definition of an isoline, the force
//! at a place that makes a channel read one value, then holds for both signs. Where a signal rises and falls again, the isoline is its
//! first branch, the least of these forces: it is the one that bounds from which force on a contact can be located. What a channel
//! reads on its weaker side (the negative wings of a barometer) has no isoline.

use dermis_model::{ForwardModel, Indentation, Stimulus, Untouched, tangents};
use dermis_skin::Surface;
use nalgebra::{DMatrix, Point3};

use crate::TheoryError;
use crate::surface::positive;

/// Samples that a place and a force need for a curved regression.
const CURVED: usize = 12;
/// Samples that they need at all.
const STRAIGHT: usize = 5;
/// Share of the trace that is added to the diagonal: what the samples leave open (across a line, say) becomes 0.
const RIDGE: f64 = 1e-6;

/// One press of a recording: where, how hard, and what the channels read.
#[derive(Debug, Clone, PartialEq)]
pub struct Press {
    /// \[m\] on the surface.
    pub position: Point3<f64>,
    /// \[N\] pressing.
    pub force: f64,
    /// In the unit of the skin with the zero subtracted, one a channel; NaN where a channel is invalid.
    pub readings: Vec<f64>,
}

/// Readings at locations of a surface over ascending forces that begin at 0. What is not known is NaN.
#[derive(Debug, Clone, PartialEq)]
pub struct Responses {
    points: Vec<Point3<f64>>,
    forces: Vec<f64>,
    channels: usize,
    /// Of a place, of a channel, of a force; oriented.
    values: Vec<f64>,
    noise: Vec<f64>,
    /// Of a channel: 1, or −1 where its readings count with their sign turned.
    orientation: Vec<f64>,
}

/// `count` forces from 0 to `most` \[N\], closer together where they are small.
#[must_use]
pub fn force_ladder(most: f64, count: usize) -> Vec<f64> {
    (0..count.max(2)).map(|i| most * (i as f64 / (count.max(2) - 1) as f64).powf(1.5)).collect()
}

/// A force between two of a curve's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bracket {
    above: usize,
    /// Share of the step to the force above.
    share: f64,
}

impl Bracket {
    /// Reading of a curve at the force, on the straight line between its neighbours.
    pub(crate) fn of(&self, curve: &[f64]) -> f64 {
        curve[self.above - 1] + self.share * (curve[self.above] - curve[self.above - 1])
    }
}

impl Responses {
    /// What a model reads for a tip of `diameter` \[m\] that presses along the normal, at locations of its surface.
    ///
    /// # Errors
    ///
    /// [`TheoryError`] where the model has no answer, or where forces do not ascend from 0.
    pub fn of_model(
        model: &dyn ForwardModel,
        points: &[Point3<f64>],
        forces: &[f64],
        diameter: f64,
    ) -> Result<Self, TheoryError> {
        positive("diameter of the tip [m]", diameter)?;
        check(forces)?;
        let channels = model.channels();
        let untouched = Untouched::of(model)?;
        let mut values = vec![0.0; points.len() * channels * forces.len()];
        let mut out = vec![0.0; channels * forces.len()];
        for (point, values) in points.iter().zip(values.chunks_exact_mut((channels * forces.len()).max(1))) {
            let normal = model.surface().project(point).1;
            let press = |force: &f64| {
                let contact = Indentation::sphere(*point, -normal * *force, diameter);
                Stimulus { contacts: vec![contact], ..Stimulus::default() }
            };
            model.responses(&forces.iter().map(press).collect::<Vec<_>>(), &mut out)?;
            untouched.subtract(&mut out);
            for (k, read) in out.chunks_exact(channels.max(1)).enumerate() {
                for (channel, value) in read.iter().enumerate() {
                    values[channel * forces.len() + k] = *value;
                }
            }
        }
        let (points, forces, noise) = (points.to_vec(), forces.to_vec(), model.noise().to_vec());
        Ok(Self { points, forces, channels, values, noise, orientation: vec![1.0; channels] }.oriented())
    }

    /// What a recording says: at every place and force a local regression of the presses within `reach` \[m\] and one step
    /// of force, quadratic in the place and linear in the force, so that noise averages out and presses at other locations than
    /// these do no harm. `noise` is that of the channels, in the unit of the skin.
    ///
    /// # Errors
    ///
    /// [`TheoryError`] where forces do not ascend from 0, or the presses belong to another number of channels.
    pub fn of_presses(
        presses: &[Press],
        noise: &[f64],
        surface: &Surface,
        points: &[Point3<f64>],
        forces: &[f64],
        reach: f64,
    ) -> Result<Self, TheoryError> {
        positive("reach of the regression [m]", reach)?;
        check(forces)?;
        let channels = noise.len();
        if let Some(press) = presses.iter().find(|p| p.readings.len() != channels) {
            return Err(TheoryError::Channels { found: press.readings.len(), expected: channels });
        }
        let mut by_x: Vec<&Press> = presses.iter().filter(|p| p.force.is_finite()).collect();
        by_x.sort_by(|a, b| a.position.x.total_cmp(&b.position.x));
        let mut values = vec![f64::NAN; points.len() * channels * forces.len()];
        for (location, point) in points.iter().enumerate() {
            let [first, second] = tangents(&surface.project(point).1);
            let begin = by_x.partition_point(|p| p.position.x < point.x - reach);
            let end = by_x.partition_point(|p| p.position.x <= point.x + reach);
            let near: Vec<(&Press, [f64; 2])> = by_x[begin..end]
                .iter()
                .filter(|p| (p.position - point).norm() <= reach)
                .map(|p| {
                    let offset = (p.position - point) / reach;
                    (*p, [offset.dot(&first), offset.dot(&second)])
                })
                .collect();
            for (k, force) in forces.iter().enumerate() {
                let out =
                    &mut values[location * channels * forces.len()..(location + 1) * channels * forces.len()];
                if *force == 0.0 {
                    (0..channels).for_each(|c| out[c * forces.len() + k] = 0.0);
                    continue;
                }
                let below = force - forces[k - 1];
                let above = forces.get(k + 1).map_or(below, |f| f - force);
                let window: Vec<(&Press, [f64; 2], f64)> = near
                    .iter()
                    .map(|(p, at)| {
                        (*p, *at, (p.force - force) / if p.force < *force { below } else { above })
                    })
                    .filter(|(_, _, off)| off.abs() < 1.0)
                    .collect();
                if let Some(fitted) = regress(&window, channels) {
                    for (channel, value) in fitted.into_iter().enumerate() {
                        out[channel * forces.len() + k] = value;
                    }
                }
            }
        }
        let (points, forces, noise) = (points.to_vec(), forces.to_vec(), noise.to_vec());
        Ok(Self { points, forces, channels, values, noise, orientation: vec![1.0; channels] }.oriented())
    }

    /// Turns the sign of every channel that a force changes most downwards.
    fn oriented(mut self) -> Self {
        for channel in 0..self.channels {
            let changes = |location| {
                let curve = self.curve(location, channel);
                curve.iter().map(|value| value - curve[0])
            };
            let known = (0..self.points.len()).flat_map(changes).filter(|change| change.is_finite());
            let (low, high) = known.fold((0.0, 0.0), |(low, high): (f64, f64), v| (low.min(v), high.max(v)));
            if -low > high {
                self.turn(channel);
            }
        }
        self
    }

    fn turn(&mut self, channel: usize) {
        self.orientation[channel] = -self.orientation[channel];
        let step = self.forces.len();
        for curve in self.values.chunks_exact_mut(step).skip(channel).step_by(self.channels) {
            curve.iter_mut().for_each(|value| *value = -*value);
        }
    }

    /// The same, every channel oriented as in `other`, a table of like channels: for values that are compared between both.
    #[must_use]
    pub fn oriented_as(mut self, other: &Self) -> Self {
        for channel in 0..self.channels.min(other.channels) {
            if self.orientation[channel] != other.orientation[channel] {
                self.turn(channel);
            }
        }
        self
    }

    /// 1 for a channel whose readings count as they are, −1 for one that a force changes most downwards: its readings here are those
    /// of the device with their sign turned.
    #[must_use]
    pub fn orientation(&self, channel: usize) -> f64 {
        self.orientation[channel]
    }

    /// \[m\] locations.
    #[must_use]
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// \[N\] ascending from 0.
    #[must_use]
    pub fn forces(&self) -> &[f64] {
        &self.forces
    }

    /// Number of channels.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Standard deviation of each channel's noise, in the unit of the skin.
    #[must_use]
    pub fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// Oriented readings of a channel at a place, one a force.
    #[must_use]
    pub fn curve(&self, location: usize, channel: usize) -> &[f64] {
        let at = (location * self.channels + channel) * self.forces.len();
        &self.values[at..at + self.forces.len()]
    }

    /// Oriented reading of a channel at a place under `force` \[N\]; NaN where it is not known.
    #[must_use]
    pub fn reading(&self, location: usize, channel: usize, force: f64) -> f64 {
        self.bracket(force).map_or(f64::NAN, |bracket| bracket.of(self.curve(location, channel)))
    }

    /// Where a force \[N\] lies among those of the curves; `None` where it is none of theirs.
    pub(crate) fn bracket(&self, force: f64) -> Option<Bracket> {
        if !(force >= 0.0 && force <= self.forces[self.forces.len() - 1]) {
            return None;
        }
        let above = self.forces.partition_point(|f| *f <= force).clamp(1, self.forces.len() - 1);
        let share = (force - self.forces[above - 1]) / (self.forces[above] - self.forces[above - 1]);
        Some(Bracket { above, share })
    }

    /// Least force \[N\] at which a channel's oriented reading at a place rises to `value`: one point of a taxel value isoline.
    #[must_use]
    pub fn force_for(&self, location: usize, channel: usize, value: f64) -> Option<f64> {
        let curve = self.curve(location, channel);
        let mut below: Option<(f64, f64)> = None;
        for (force, reading) in self.forces.iter().zip(curve) {
            if reading.is_nan() {
                continue;
            }
            if *reading >= value {
                return Some(match below {
                    Some((f, r)) => f + (value - r) / (reading - r) * (force - f),
                    None => *force,
                });
            }
            below = Some((*force, *reading));
        }
        None
    }

    /// c(d) = dF/dS of a channel at a place, where it reads `value` (5.17): newtons per unit of the skin.
    #[must_use]
    pub fn slope(&self, location: usize, channel: usize, value: f64) -> Option<f64> {
        // Over a span that a table's corners do not show in.
        let span = (0.05 * value.abs()).max(f64::MIN_POSITIVE);
        let high = self.force_for(location, channel, value + span)?;
        let low = self.force_for(location, channel, value - span)?;
        Some((high - low) / (2.0 * span))
    }

    /// Place where a channel reads most for a given force, the largest known to all: what lies above its taxel.
    #[must_use]
    pub fn peak(&self, channel: usize) -> usize {
        let strongest = |location: usize| {
            let force = self.forces[self.forces.len() / 2];
            self.reading(location, channel, force)
        };
        let known = (0..self.points.len()).filter(|p| strongest(*p).is_finite());
        known.max_by(|a, b| strongest(*a).total_cmp(&strongest(*b))).unwrap_or_default()
    }

    /// Least force \[N\] at a place from which on at least `needed` channels read `least` or more: F_S, the force from
    /// which on a contact there can be located (thesis 5.3). Two are needed along a line, three on a surface.
    #[must_use]
    pub fn minimum_force(&self, location: usize, least: f64, needed: usize) -> Option<f64> {
        let mut forces: Vec<f64> =
            (0..self.channels).filter_map(|c| self.force_for(location, c, least)).collect();
        forces.sort_by(f64::total_cmp);
        forces.get(needed.max(1) - 1).copied()
    }

    /// Channels that read `least` or more at a place under `force` \[N\].
    #[must_use]
    pub fn active(&self, location: usize, force: f64, least: f64) -> Vec<usize> {
        (0..self.channels).filter(|c| self.reading(location, *c, force) >= least).collect()
    }
}

fn check(forces: &[f64]) -> Result<(), TheoryError> {
    let ascend = forces.first() == Some(&0.0) && forces.len() > 1 && forces.windows(2).all(|w| w[1] > w[0]);
    if ascend { Ok(()) } else { Err(TheoryError::Forces) }
}

/// Readings at the middle of a window: weighted least squares on (1, u, v, f, u², uv, v²), or on its first four.
fn regress(window: &[(&Press, [f64; 2], f64)], channels: usize) -> Option<Vec<f64>> {
    let columns = match window.len() {
        n if n >= CURVED => 7,
        n if n >= STRAIGHT => 4,
        _ => return None,
    };
    let mut normal = DMatrix::<f64>::zeros(columns, columns);
    let mut side = DMatrix::<f64>::zeros(columns, channels);
    for (press, [u, v], off) in window {
        let row = [1.0, *u, *v, *off, u * u, u * v, v * v];
        // Falls to 0 at the window's ends, so that the fit does not jump from place to place.
        let weight = (1.0 - off.abs()) * (1.0 - (u * u + v * v)).max(0.0) + 1e-9;
        for i in 0..columns {
            for j in 0..columns {
                normal[(i, j)] += weight * row[i] * row[j];
            }
            for (channel, reading) in press.readings.iter().enumerate() {
                side[(i, channel)] += weight * row[i] * reading;
            }
        }
    }
    let ridge = RIDGE * normal[(0, 0)];
    // The constant is the result: it must not be drawn to 0.
    (1..columns).for_each(|i| normal[(i, i)] += ridge);
    let solved = normal.cholesky()?.solve(&side);
    Some(solved.row(0).iter().copied().collect())
}

/// Standard deviation of each channel's noise from stretches of frames in which nothing changes: from the differences of
/// consecutive frames, so that slow drift does not count. `None` where there are no two frames in a row.
///
/// Invalid values are NaN.
#[must_use]
pub fn noise_of_repeats<'a>(
    stretches: impl IntoIterator<Item = &'a [Vec<f64>]>,
    channels: usize,
) -> Option<Vec<f64>> {
    let mut sums = vec![(0.0, 0u64); channels];
    for stretch in stretches {
        for pair in stretch.windows(2) {
            for (channel, (sum, count)) in sums.iter_mut().enumerate() {
                let (Some(a), Some(b)) = (pair[0].get(channel), pair[1].get(channel)) else { continue };
                let step = b - a;
                if step.is_finite() {
                    *sum += step * step / 2.0;
                    *count += 1;
                }
            }
        }
    }
    sums.into_iter().map(|(sum, count)| (count > 0).then(|| (sum / count as f64).sqrt())).collect()
}

#[cfg(test)]
mod tests;
