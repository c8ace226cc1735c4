//! Joint torques as a sense: what pushes the robot, as its joints feel it, less what its skins explain.
//!
//! Problem: the torques of drives, from `/joint_states`, hold the robot's own motion and weight, and what it touches. Method: the
//! generalized-momentum observer (De Luca and Mattone, *Actuator failure detection and isolation using generalized momenta*, ICRA 2003;
//! Haddadin, De Luca and Albu-Schäffer, *Robot collisions: a survey on detection, isolation, and identification*, IEEE T-RO 33(6),
//! 2017, §IV-D). Its residual follows the external torque of each joint as a filter of first order with the
//! [gain](TorqueSettings::gain) K, without accelerations:
//!
//! dr/dt = K (d/dt p − (τ − τ_f) − ∂T/∂q − g − r), with the terms of [`dermis_body::Momentum`] and the [friction](JointFriction) τ_f of the joint.
//!
//! The torques Jᵀf of the skins' contacts go through the same filter, at the same instants, and are taken away.
//!
//! Variance of a joint, the sum of:
//!
//! - noise of its torque and of all velocities through the filter. Both are measured, by the second differences of what comes, so that a
//!   steady change does not count;
//! - the square of its [deviation](TorqueSettings::deviation_share): offsets, inertias and friction that are not those of the files;
//! - at rest, the square of its Coulomb friction, whose direction is not known there;
//! - the covariances of the skins' forces and locations through the Jacobian; of skins that measure the normal component only, friction on
//!   their surface;
//! - the time by which skins may be late, times the rate of change of what they explain.
//!
//! Assumptions: those of [`Poses::momentum`]; above all, a base that does not accelerate.
//!
//! Cost: one pass over the links a joint state, and one more a coordinate for the variance, once an answer.

use std::collections::VecDeque;

use dermis_body::{JointKind, Poses, Robot, Wrench};
use dermis_skin::{ForceComponents, Stamp};
use nalgebra::{Matrix3, Vector3};

use crate::touch::BodyTouch;
use crate::track::seconds;

mod settings;

pub use settings::{JointFriction, TorqueError, TorqueSettings};

/// \[s\] over which noise is measured.
const NOISE_TIME: f64 = 1.0;
/// Values of which a noise is known.
const NOISE_SAMPLES: u32 = 10;
/// \[s\] without a joint state after which the observer begins anew.
const GAP: f64 = 0.1;
/// Time constants of the filter after which its residual is one.
const WARM: f64 = 4.0;
/// Joint states that wait for the skins' reports of their time.
const MOST_WAITING: usize = 1024;

/// Torques \[N m\] or \[N\], one a coordinate, and their variances.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Torques {
    /// NaN where not known.
    pub values: Vec<f64>,
    /// Square of the standard deviation of each; NaN where not known.
    pub variances: Vec<f64>,
}

/// What contacts put on the joints, the expected ones included. `shear` as [`TorqueSettings::unmeasured_shear`].
pub(crate) fn explained(robot: &Robot, poses: &Poses<'_>, touches: &[BodyTouch], shear: f64) -> Torques {
    let n = robot.body.coordinates().len();
    let mut sum = Torques { values: vec![0.0; n], variances: vec![0.0; n] };
    for touch in touches {
        let (contact, root_from_link) = (&touch.contact, poses.root_from(touch.link));
        let turn = root_from_link.rotation.to_rotation_matrix();
        let mut spread = contact.force_covariance;
        if contact.force_components == ForceComponents::Normal {
            let across = Matrix3::identity() - contact.normal * contact.normal.transpose();
            spread += across * (shear * touch.measured.norm()).powi(2);
        }
        let [spread, place] = [spread, contact.position_covariance].map(|c| turn * c * turn.transpose());
        let (force, at) = (root_from_link.rotation * touch.measured, root_from_link * contact.position);
        let of_force = poses.torques(touch.link, &Wrench::of_force(force, at));
        let jacobian = poses.jacobian(touch.link, &at);
        for (i, column) in jacobian.column_iter().enumerate() {
            let linear = column.fixed_rows::<3>(0).into_owned();
            let angular = column.fixed_rows::<3>(3).into_owned();
            // Joints that are not above the contact feel nothing of it, whatever is not known of it.
            if linear == Vector3::zeros() && angular == Vector3::zeros() {
                continue;
            }
            let lever = force.cross(&angular);
            sum.values[i] += of_force[i];
            sum.variances[i] += linear.dot(&(spread * linear)) + lever.dot(&(place * lever));
        }
    }
    sum
}

/// How much the values of a row scatter about a steady change.
#[derive(Debug, Clone, Default)]
struct Noise {
    last: Option<(f64, f64)>,
    variance: f64,
    samples: u32,
}

impl Noise {
    fn take(&mut self, value: f64, dt: f64) {
        if !value.is_finite() {
            *self = Self::default();
            return;
        }
        let before = self.last.map(|(one, two)| (value - 2.0 * one + two).powi(2) / 6.0);
        if let Some(square) = before.filter(|s| s.is_finite()) {
            self.samples = self.samples.saturating_add(1);
            let weight = (1.0 / f64::from(self.samples)).max(1.0 - (-dt / NOISE_TIME).exp());
            self.variance += weight * (square - self.variance);
        }
        self.last = Some((value, self.last.map_or(f64::NAN, |(one, _)| one)));
    }

    fn variance(&self) -> Option<f64> {
        (self.samples >= NOISE_SAMPLES).then_some(self.variance)
    }
}

/// What is known of a joint.
#[derive(Debug, Clone, Default)]
struct Latest {
    stamp: Option<Stamp>,
    position: f64,
    rate: f64,
    effort: f64,
    rates: Noise,
    efforts: Noise,
}

/// Every joint at an instant.
#[derive(Debug, Clone)]
struct Sample {
    stamp: Stamp,
    positions: Vec<f64>,
    rates: Vec<f64>,
    efforts: Vec<f64>,
}

/// One joint of the observer.
#[derive(Debug, Clone, Copy, Default)]
struct Residual {
    /// External torque.
    value: f64,
    /// What skins explain, through the same filter.
    explained: f64,
    /// \[s\] for which it has run.
    age: f64,
}

/// The terms of the last joint state.
#[derive(Debug, Clone)]
struct Last {
    sample: Sample,
    /// p.
    momentum: Vec<f64>,
    /// τ − τ_f + ∂T/∂q + g.
    drive: Vec<f64>,
    /// \[s\] since the one before.
    dt: f64,
}

/// The observer of all joints of a robot.
#[derive(Debug)]
pub(crate) struct Observer {
    settings: TorqueSettings,
    /// Standard deviation of each joint's model; `None` where its torque does not count.
    deviations: Vec<Option<f64>>,
    friction: Vec<JointFriction>,
    carries_mass: Vec<bool>,
    impossible: Option<String>,
    latest: Vec<Latest>,
    waiting: VecDeque<Sample>,
    last: Option<Last>,
    residuals: Vec<Residual>,
    /// What skins explained at the last answer.
    load: Option<(Stamp, Torques)>,
    refused: Option<String>,
}

impl Observer {
    pub(crate) fn new(robot: &Robot, settings: TorqueSettings) -> Result<Self, TorqueError> {
        settings.check(robot)?;
        let n = robot.body.coordinates().len();
        Ok(Self {
            deviations: robot
                .body
                .coordinates()
                .map(|j| settings.deviation(j).filter(|_| settings.counts(j)))
                .collect(),
            friction: robot.body.coordinates().map(|j| settings.friction(j)).collect(),
            carries_mass: robot.body.carries_mass(),
            impossible: robot.body.impossible_inertia().map(str::to_owned),
            latest: vec![Latest::unknown(); n],
            waiting: VecDeque::new(),
            last: None,
            residuals: vec![Residual::default(); n],
            load: None,
            refused: None,
            settings,
        })
    }

    pub(crate) fn settings(&self) -> &TorqueSettings {
        &self.settings
    }

    /// Whether any joint state with efforts has come.
    pub(crate) fn hears(&self) -> bool {
        self.last.is_some() || !self.waiting.is_empty()
    }

    /// Begins anew.
    pub(crate) fn reset(&mut self) {
        self.latest.fill(Latest::unknown());
        self.waiting.clear();
        self.residuals.fill(Residual::default());
        (self.last, self.load, self.refused) = (None, None, None);
    }

    /// Takes a joint state whose positions are good. Without velocities, those are the differences of positions. `rest` are positions of
    /// joints that no state tells.
    pub(crate) fn take(
        &mut self,
        robot: &Robot,
        stamp: Stamp,
        state: &JointValues<'_>,
        rest: Option<&[f64]>,
    ) {
        let count = state.names.len();
        let fits = |values: &[f64]| values.is_empty() || values.len() == count;
        if !fits(state.velocities) || !fits(state.efforts) {
            self.refused = Some(format!(
                "a joint state has {count} names, {} velocities and {} efforts; the publisher must give one of each a name, or none",
                state.velocities.len(),
                state.efforts.len()
            ));
            return;
        }
        self.refused = None;
        // A publisher that goes back by so much begins another run.
        if self.newest().is_some_and(|newest| seconds(stamp, newest) > 10.0 * GAP) {
            self.reset();
        }
        for (i, joint) in robot.body.coordinates().enumerate() {
            let Some(k) = state.names.iter().position(|name| *name == joint.name) else { continue };
            self.latest[i].take(
                stamp,
                state.positions[k],
                state.velocities.get(k).copied(),
                state.efforts.get(k).copied(),
                joint.kind == JointKind::Continuous,
            );
        }
        if self.latest.iter().all(|l| !l.effort.is_finite()) || self.newest().is_some_and(|s| stamp <= s) {
            return;
        }
        let fresh = |l: &Latest| l.stamp.is_some_and(|at| (0.0..=GAP).contains(&seconds(at, stamp)));
        let rest = |i: usize| rest.and_then(|rest| rest.get(i)).copied().unwrap_or(f64::NAN);
        let pick = |value: fn(&Latest) -> f64, none: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let each = self.latest.iter().enumerate();
            each.map(|(i, l)| if fresh(l) { value(l) } else { none(i) }).collect()
        };
        let sample = Sample {
            stamp,
            positions: pick(|l| l.position, &rest),
            rates: pick(|l| l.rate, &|i| if rest(i).is_finite() { 0.0 } else { f64::NAN }),
            efforts: pick(|l| l.effort, &|_| f64::NAN),
        };
        if sample.positions.iter().chain(&sample.rates).all(|v| v.is_finite()) {
            if self.waiting.len() >= MOST_WAITING {
                self.waiting.pop_front();
            }
            self.waiting.push_back(sample);
        }
    }

    fn newest(&self) -> Option<Stamp> {
        self.waiting.back().or(self.last.as_ref().map(|l| &l.sample)).map(|s| s.stamp)
    }

    /// Works in the joint states up to `until`, of which `load` is what skins explain.
    pub(crate) fn advance(&mut self, robot: &Robot, until: Stamp, load: Torques) {
        while self.waiting.front().is_some_and(|s| s.stamp <= until) {
            let Some(sample) = self.waiting.pop_front() else { break };
            let share = self.load.as_ref().map_or(1.0, |(from, _)| {
                let whole = seconds(*from, until);
                if whole > 0.0 { (seconds(*from, sample.stamp) / whole).clamp(0.0, 1.0) } else { 1.0 }
            });
            let at = |i: usize| {
                let now = load.values[i];
                self.load
                    .as_ref()
                    .map_or(now, |(_, before)| before.values[i] + share * (now - before.values[i]))
            };
            let explained: Vec<f64> = (0..load.values.len()).map(at).collect();
            self.step(robot, sample, &explained);
        }
        self.load = Some((until, load));
    }

    fn step(&mut self, robot: &Robot, sample: Sample, explained: &[f64]) {
        let poses = robot.body.poses(&sample.positions);
        let gravity = poses.root_from(robot.base).rotation * Vector3::from(self.settings.gravity);
        let terms = poses.momentum(&sample.rates, &gravity);
        let drive: Vec<f64> = (0..sample.efforts.len())
            .map(|i| {
                let friction = self.friction[i].effort(sample.rates[i], self.settings.standstill);
                sample.efforts[i] - friction + terms.kinetic[i] + terms.weight[i]
            })
            .collect();
        let dt = self.last.as_ref().map_or(f64::INFINITY, |last| seconds(last.sample.stamp, sample.stamp));
        match &self.last {
            Some(last) if dt > 0.0 && dt <= GAP => {
                let share = 1.0 - (-self.settings.gain * dt).exp();
                for (i, residual) in self.residuals.iter_mut().enumerate() {
                    let external =
                        (terms.generalized[i] - last.momentum[i]) / dt - 0.5 * (drive[i] + last.drive[i]);
                    residual.step(external, explained[i], share, dt);
                }
            }
            _ => self.residuals.fill(Residual::default()),
        }
        self.last = Some(Last { sample, momentum: terms.generalized, drive, dt });
    }

    /// What joints feel and skins do not explain; `None` where there is nothing of it. It is that of the last joint state.
    pub(crate) fn unexplained(&self, robot: &Robot, late: f64) -> Option<Torques> {
        let (last, (_, load)) = (self.last.as_ref()?, self.load.as_ref()?);
        if self.impossible.is_some() {
            return None;
        }
        let poses = robot.body.poses(&last.sample.positions);
        let gain = self.settings.gain;
        let share = 1.0 - (-gain * last.dt).exp();
        let n = self.residuals.len();
        // σ² of p: columns of the mass matrix are momenta at unit velocities.
        let mut spread = vec![0.0; n];
        for (j, latest) in self.latest.iter().enumerate() {
            let noise = latest.rates.variance().unwrap_or(0.0);
            if noise > 0.0 {
                let unit: Vec<f64> = (0..n).map(|i| f64::from(u8::from(i == j))).collect();
                let column = poses.momentum(&unit, &Vector3::zeros()).generalized;
                spread.iter_mut().zip(column).for_each(|(sum, m)| *sum += m * m * noise);
            }
        }
        let mut found = Torques { values: vec![f64::NAN; n], variances: vec![f64::NAN; n] };
        for (i, residual) in self.residuals.iter().enumerate() {
            if residual.age * gain < WARM || !self.carries_mass[i] {
                continue;
            }
            found.values[i] = residual.value - residual.explained;
            let (Some(deviation), Some(noise)) = (self.deviations[i], self.latest[i].efforts.variance())
            else {
                continue;
            };
            let lag = late * gain * (load.values[i] - residual.explained);
            found.variances[i] = noise * share / (2.0 - share)
                + spread[i] * (share / last.dt).powi(2) * 2.0 / (2.0 - share)
                + deviation.powi(2)
                + self.friction[i].variance(last.sample.rates[i], self.settings.standstill)
                + load.variances[i]
                + lag.powi(2);
        }
        Some(found)
    }

    /// Joint positions that the residuals are for.
    pub(crate) fn positions(&self) -> Option<(Stamp, &[f64])> {
        self.last.as_ref().map(|l| (l.sample.stamp, l.sample.positions.as_slice()))
    }

    /// Why some joint's torque tells nothing, in one sentence; `None` where each does.
    pub(crate) fn sentence(&self, robot: &Robot) -> Option<String> {
        if let Some(link) = &self.impossible {
            return Some(format!(
                "no external torques: no body has the inertia of link \"{link}\" in the URDF; correct its `inertial`"
            ));
        }
        if let Some(refused) = &self.refused {
            return Some(refused.clone());
        }
        let names = |lacks: &dyn Fn(usize) -> bool| -> Option<String> {
            let all: Vec<&str> = robot
                .body
                .coordinates()
                .enumerate()
                .filter(|(i, _)| lacks(*i))
                .map(|(_, joint)| joint.name.as_str())
                .collect();
            let rest = all.len().saturating_sub(5);
            let more = if rest > 0 { format!(" and {rest} more") } else { String::new() };
            (!all.is_empty()).then(|| format!("{}{more}", all[..all.len().min(5)].join(", ")))
        };
        let counts =
            |i: usize| robot.body.coordinates().nth(i).is_some_and(|joint| self.settings.counts(joint));
        names(&|i| counts(i) && !self.carries_mass[i])
            .map(|of| format!("no external torques of {of}: the URDF gives no masses of what they move; add `inertial`"))
            .or_else(|| {
                names(&|i| counts(i) && !self.latest[i].effort.is_finite()).map(|of| {
                    format!("no external torques of {of}: /joint_states brings no efforts of them; publish them where the robot measures torques")
                })
            })
            .or_else(|| {
                names(&|i| counts(i) && self.deviations[i].is_none()).map(|of| {
                    format!("the variance of external torques of {of} is not known: the URDF gives no effort limit; add `torques.deviations`")
                })
            })
    }
}

/// The fields of a joint state.
#[derive(Debug, Clone, Copy)]
pub struct JointValues<'a> {
    /// Names of the joints.
    pub names: &'a [String],
    /// \[rad\] or \[m\], one a joint.
    pub positions: &'a [f64],
    /// \[rad/s\] or \[m/s\], one a joint, or none.
    pub velocities: &'a [f64],
    /// \[N m\] or \[N\] of the drives, one a joint, or none.
    pub efforts: &'a [f64],
}

impl Latest {
    /// Of a joint that no state has reported.
    fn unknown() -> Self {
        Self { rate: f64::NAN, effort: f64::NAN, ..Self::default() }
    }

    fn take(&mut self, stamp: Stamp, position: f64, rate: Option<f64>, effort: Option<f64>, wraps: bool) {
        let dt = self.stamp.map_or(f64::INFINITY, |before| seconds(before, stamp));
        if dt == 0.0 || (dt < 0.0 && dt > -GAP) {
            return;
        }
        if !(0.0..=GAP).contains(&dt) {
            *self = Self::default();
        }
        let mut way = position - self.position;
        if wraps {
            way = (way + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
        }
        let known = self.stamp.is_some();
        self.rate = rate.unwrap_or(if known { way / dt } else { f64::NAN });
        self.effort = effort.unwrap_or(f64::NAN);
        (self.stamp, self.position) = (Some(stamp), position);
        let dt = if known { dt } else { 0.0 };
        self.rates.take(self.rate, dt);
        self.efforts.take(self.effort, dt);
    }
}

impl Residual {
    fn step(&mut self, external: f64, explained: f64, share: f64, dt: f64) {
        if external.is_finite() {
            self.value += share * (external - self.value);
            self.age += dt;
        } else {
            (self.value, self.age) = (0.0, 0.0);
        }
        if self.explained.is_finite() {
            self.explained += share * (explained - self.explained);
        } else {
            self.explained = explained;
        }
    }
}

#[cfg(test)]
mod tests;
