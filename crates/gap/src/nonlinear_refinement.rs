//! Values of effects, fitted on the full simulator.

use std::sync::atomic::AtomicBool;

use dermis_skin::{Effect, EffectInfo};
use indicatif::ProgressBar;

use crate::GapError;
use crate::algebra::cholesky_solve;
use crate::constants::Z90;
use crate::constants::refine::{DAMPING, ENOUGH, FAR, LAW, ROUNDS, STEP, TRIES};
use crate::recording::Recording;
use crate::samples::Samples;
use crate::simulate::Simulator;
use crate::statistics::Column;

/// A number that is fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Free {
    /// Name of the effect.
    pub effect: String,
    /// Its parameter.
    pub parameter: String,
    /// Values that can be.
    pub limits: [f64; 2],
    /// What is a large change of it.
    pub scale: f64,
    /// Value where nothing says another.
    pub typical: f64,
    /// Value that changes nothing.
    pub neutral: f64,
}

/// Numbers of a family's effect that can be fitted.
#[must_use]
pub fn free(info: &EffectInfo) -> Vec<Free> {
    info.parameters
        .iter()
        .map(|p| Free {
            effect: info.name.to_owned(),
            parameter: p.name.to_owned(),
            limits: p.limits,
            scale: (p.range[1] - p.range[0]).abs().max(1e-12),
            typical: p.typical,
            neutral: if p.unit == "1" && p.limits[0] > 0.0 { 1.0 } else { 0.0 },
        })
        .collect()
}

/// What is fitted to: readings without what is not fitted, in the unit of the skin.
pub struct Target<'a> {
    /// Recording.
    pub recording: &'a Recording,
    /// Samples.
    pub samples: &'a Samples,
    /// Readings of samples.
    pub readings: &'a [f32],
    /// Deviation of each channel's noise, infinite for channels that do not count.
    pub sigma: &'a [f64],
    /// Weight of each group.
    pub weights: &'a [f64],
    /// What the model discrepancy may make of a residual.
    pub discrepancy: &'a ModelDiscrepancy,
    /// Set it to end early.
    pub stop: &'a AtomicBool,
    /// Counts simulations.
    pub progress: &'a ProgressBar,
}

/// The model discrepancy, which makes the best of every residual under its prior.
#[derive(Debug, Clone, Default)]
pub struct ModelDiscrepancy {
    /// Columns, samples × channels, times the root of the weight of each sample's group.
    columns: Vec<Vec<f32>>,
    /// Products of columns, with the prior.
    normal: Vec<f64>,
    /// Root of the inverse variance of a coefficient.
    root: f64,
}

impl ModelDiscrepancy {
    /// From columns, the weights of groups and the inverse variance of coefficients.
    #[must_use]
    pub fn new(columns: &[&Column], samples: &Samples, channels: usize, weights: &[f64], prior: f64) -> Self {
        let columns: Vec<Vec<f32>> = columns
            .iter()
            .map(|column| {
                let mut values = vec![0.0f32; samples.list.len() * channels];
                for (i, row) in samples.list.iter().enumerate() {
                    let w = weights[row.group].sqrt() as f32;
                    for (k, v) in values[i * channels..(i + 1) * channels].iter_mut().enumerate() {
                        *v = w * match column.channel {
                            Some(own) if own == k => column.values[i],
                            Some(_) => 0.0,
                            None => column.values[i * channels + k],
                        };
                    }
                }
                values
            })
            .collect();
        let n = columns.len();
        let mut normal = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..n {
                normal[i * n + j] = crate::algebra::dot(&columns[i], &columns[j]);
            }
            normal[i * n + i] += prior;
        }
        Self { columns, normal, root: prior.sqrt() }
    }

    /// Takes the best of the model discrepancy out of a weighted residual, and appends what that costs: the energy of all is
    /// what is minimised.
    fn take(&self, residual: &mut Vec<f32>) {
        let n = self.columns.len();
        let mut x: Vec<f64> = self.columns.iter().map(|c| crate::algebra::dot(c, residual)).collect();
        if cholesky_solve(&mut self.normal.clone(), n, &mut x).is_none() {
            return;
        }
        for (column, x) in self.columns.iter().zip(&x) {
            residual.iter_mut().zip(column).for_each(|(r, c)| *r -= *x as f32 * c);
        }
        residual.extend(x.iter().map(|x| (x * self.root) as f32));
    }
}

/// What a fit on the full simulator gave.
#[derive(Debug, Clone)]
pub struct Refinement {
    /// Effects with fitted values.
    pub effects: Vec<Effect>,
    /// Simulated readings of all samples.
    pub readings: Vec<f32>,
    /// Half of the 90 % interval of each free number, over locations.
    pub halves: Vec<f64>,
}

impl Target<'_> {
    /// Weighted residual without what the model discrepancy makes of it, with what that costs at its end; and its energy.
    pub(crate) fn residual(&self, simulated: &[f32]) -> (Vec<f32>, f64) {
        let channels = self.sigma.len();
        let mut out = Vec::with_capacity(simulated.len());
        for (i, row) in self.samples.list.iter().enumerate() {
            let w = self.weights[row.group].sqrt();
            for k in 0..channels {
                let at = i * channels + k;
                let r = w * f64::from(self.readings[at] - simulated[at]) / self.sigma[k];
                // A channel that gives nothing, and a reading that was cut off, ask nothing.
                out.push(if r.is_finite() { r as f32 } else { 0.0 });
            }
        }
        self.discrepancy.take(&mut out);
        let energy = crate::algebra::dot(&out, &out);
        (out, energy)
    }
}

fn value(effects: &[Effect], free: &Free) -> f64 {
    let effect = effects.iter().find(|e| e.name == free.effect);
    effect.and_then(|e| e.parameters.get(&free.parameter)).copied().unwrap_or(free.typical)
}

fn put(effects: &mut [Effect], free: &Free, value: f64) {
    if let Some(effect) = effects.iter_mut().find(|e| e.name == free.effect) {
        effect.parameters.insert(free.parameter.clone(), value);
    }
}

/// Fits the numbers `free` of `start`, from the best of several starts.
///
/// # Errors
///
/// What the model says where no start can be simulated.
pub fn fit(
    simulator: &Simulator<'_>,
    target: &Target<'_>,
    starts: &[Vec<Effect>],
    free: &[Free],
) -> Result<Refinement, GapError> {
    let fit = Fit { simulator, target, free };
    let mut point = fit.best(starts)?;
    let mut halves = vec![f64::NAN; free.len()];
    let mut damping = DAMPING[0];
    let rounds = if free.is_empty() { 0 } else { ROUNDS };
    for _ in 0..rounds {
        let around = fit.linearised(&point)?;
        let gained = fit.step(&mut point, &around, &mut damping)?;
        halves = around.halves;
        if gained < ENOUGH {
            break;
        }
    }
    for (half, free) in halves.iter_mut().zip(free) {
        *half = half.hypot(Z90 * LAW * (value(&point.effects, free) - free.neutral).abs());
    }
    Ok(Refinement { effects: point.effects, readings: point.readings, halves })
}

/// Least squares on the full simulator, by Levenberg's and Marquardt's method.
struct Fit<'a, 's> {
    simulator: &'a Simulator<'s>,
    target: &'a Target<'s>,
    free: &'a [Free],
}

/// Values that were simulated.
struct Point {
    effects: Vec<Effect>,
    readings: Vec<f32>,
    /// Energy of the residual.
    loss: f64,
}

/// The simulator around a point, to first order in large changes of the free numbers.
struct Linearised {
    /// Values of the free numbers there.
    now: Vec<f64>,
    /// Products of slopes.
    normal: Vec<f64>,
    /// Products of slopes with the residual.
    side: Vec<f64>,
    /// Half of the 90 % interval of each number.
    halves: Vec<f64>,
}

impl Fit<'_, '_> {
    /// Readings with each of these effects.
    fn simulated(&self, all: &[Vec<Effect>]) -> Result<Vec<Result<Vec<f32>, GapError>>, GapError> {
        let Target { recording, samples, stop, progress, .. } = *self.target;
        let skins: Vec<_> = all.iter().map(|effects| self.simulator.with(effects)).collect();
        progress.inc_length(skins.len() as u64);
        self.simulator.many(&skins, recording, (samples, true), stop, progress)
    }

    /// The best of several starts.
    fn best(&self, starts: &[Vec<Effect>]) -> Result<Point, GapError> {
        let mut best: Option<Point> = None;
        let mut refused = None;
        for (effects, read) in starts.iter().zip(self.simulated(starts)?) {
            match read {
                Ok(readings) => {
                    let (_, loss) = self.target.residual(&readings);
                    if best.as_ref().is_none_or(|b| loss < b.loss) {
                        best = Some(Point { effects: effects.clone(), readings, loss });
                    }
                }
                Err(error) => refused = Some(error),
            }
        }
        best.ok_or_else(|| refused.unwrap_or(GapError::Interrupted))
    }

    /// Slopes by differences, and what follows from them.
    fn linearised(&self, point: &Point) -> Result<Linearised, GapError> {
        let (target, free, n) = (self.target, self.free, self.free.len());
        let now: Vec<f64> = free.iter().map(|f| value(&point.effects, f)).collect();
        let steps: Vec<f64> = free
            .iter()
            .zip(&now)
            .map(|(f, v)| {
                let step = STEP * f.scale;
                if v + step > f.limits[1] { -step } else { step }
            })
            .collect();
        let varied: Vec<Vec<Effect>> = (0..n)
            .map(|p| {
                let mut other = point.effects.clone();
                put(&mut other, &free[p], now[p] + steps[p]);
                other
            })
            .collect();
        let (residual, _) = target.residual(&point.readings);
        let slopes: Vec<Option<Vec<f32>>> = self
            .simulated(&varied)?
            .into_iter()
            .zip(&steps)
            .zip(free)
            .map(|((other, step), f)| {
                let other = other.ok()?;
                let (moved, _) = target.residual(&other);
                // Change of the model for a large change of the number.
                let scale = (f.scale / step) as f32;
                Some(residual.iter().zip(&moved).map(|(a, b)| (a - b) * scale).collect())
            })
            .collect();
        let nothing = vec![0.0f32; residual.len()];
        let slopes: Vec<&[f32]> = slopes.iter().map(|s| s.as_deref().unwrap_or(&nothing)).collect();
        let mut normal = vec![0.0; n * n];
        let mut side = vec![0.0; n];
        for i in 0..n {
            for j in 0..=i {
                let d = crate::algebra::dot(slopes[i], slopes[j]);
                (normal[i * n + j], normal[j * n + i]) = (d, d);
            }
            side[i] = crate::algebra::dot(slopes[i], &residual);
        }
        let halves = intervals(&normal, &slopes, &residual, target, free);
        Ok(Linearised { now, normal, side, halves })
    }

    /// Takes the first of some steps, each damped more than the one before, that reduces the residual, and says by what share of its
    /// energy; 0 where none does.
    fn step(&self, point: &mut Point, around: &Linearised, damping: &mut f64) -> Result<f64, GapError> {
        let [_, falls, least_damping, rises] = DAMPING;
        let Linearised { now, normal, side, .. } = around;
        let n = self.free.len();
        for _ in 0..TRIES {
            let mut damped = normal.clone();
            let trace = (0..n).map(|i| normal[i * n + i]).fold(0.0, f64::max);
            (0..n).for_each(|i| {
                damped[i * n + i] = damped[i * n + i] * (1.0 + *damping) + 1e-9 * trace + 1e-12;
            });
            let mut x = side.clone();
            if cholesky_solve(&mut damped, n, &mut x).is_none() {
                *damping *= rises;
                continue;
            }
            let mut effects = point.effects.clone();
            for ((free, now), x) in self.free.iter().zip(now).zip(&x) {
                let to = (now + x.clamp(-FAR, FAR) * free.scale).clamp(free.limits[0], free.limits[1]);
                put(&mut effects, free, to);
            }
            let tried = self.simulated(std::slice::from_ref(&effects))?.pop();
            if let Some(Ok(readings)) = tried {
                let (_, loss) = self.target.residual(&readings);
                if loss < point.loss {
                    let gained = (point.loss - loss) / point.loss.max(1e-300);
                    *point = Point { effects, readings, loss };
                    *damping = (*damping * falls).max(least_damping);
                    return Ok(gained);
                }
            }
            *damping *= rises;
        }
        Ok(0.0)
    }
}

/// Half of each number's 90 % interval: contacts of one place are not independent, so that scores of groups are counted.
fn intervals(a: &[f64], slopes: &[&[f32]], residual: &[f32], target: &Target<'_>, free: &[Free]) -> Vec<f64> {
    let n = slopes.len();
    let channels = target.sigma.len();
    let mut scores = vec![vec![0.0f64; n]; target.samples.groups];
    for (i, row) in target.samples.list.iter().enumerate() {
        let span = i * channels..(i + 1) * channels;
        for (p, slope) in slopes.iter().enumerate() {
            scores[row.group][p] += crate::algebra::dot(&slope[span.clone()], &residual[span.clone()]);
        }
    }
    let mean: Vec<f64> =
        (0..n).map(|p| scores.iter().map(|s| s[p]).sum::<f64>() / scores.len() as f64).collect();
    (0..n)
        .map(|p| {
            let mut damped = a.to_vec();
            let trace = (0..n).map(|i| a[i * n + i]).fold(0.0, f64::max);
            (0..n).for_each(|i| damped[i * n + i] += 1e-6 * trace + 1e-12);
            let mut row = vec![0.0; n];
            row[p] = 1.0;
            if cholesky_solve(&mut damped, n, &mut row).is_none() {
                return f64::NAN;
            }
            let variance: f64 = scores
                .iter()
                .map(|s| row.iter().zip(s).zip(&mean).map(|((r, s), m)| r * (s - m)).sum::<f64>().powi(2))
                .sum();
            Z90 * variance.sqrt() * free[p].scale
        })
        .collect()
}
