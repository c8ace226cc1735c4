//! A forward model that presses at known locations have corrected.

use std::sync::Arc;

use dermis_model::{DeviceState, ForwardModel, Indentation, Stimulus, Untouched, Wrapper};
use dermis_skin::{Image, ModelError};
use nalgebra::{DMatrix, Point3};
use serde::{Deserialize, Serialize};

use crate::InverterError;

/// What is learned of how a device differs from its model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CorrectionSettings {
    /// \[m\] over which the difference varies.
    pub length: f64,
    /// Strength of the prior that there is no difference, relative to the information in one press per place.
    pub ridge: f64,
    /// Centres at most.
    pub centres: usize,
    /// Powers of the force that the difference per newton has, 0 included: 0 for a device that is linear.
    pub powers: usize,
}

impl Default for CorrectionSettings {
    fn default() -> Self {
        Self { length: 0.015, ridge: 1e-2, centres: 350, powers: 2 }
    }
}

/// How the readings of a device differ from those of its forward model, as a function of place and force: a sum of Gaussians
/// about locations of the surface for each channel. What gains cannot say (elements that sit elsewhere, a wall that is thinner
/// here and there, a clamp that gives way) varies smoothly with the place of a contact, and presses all over the skin show it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Correction {
    /// \[m\] centres of the Gaussians.
    centres: Vec<[f64; 3]>,
    /// \[m\] standard deviation of the Gaussians.
    length: f64,
    /// \[N\] that forces are divided by.
    force: f64,
    powers: usize,
    /// Reading of the device per reading of the model, one a channel.
    gains: Vec<f64>,
    /// (centres × powers) × channels: unit of the skin per newton.
    weights: Vec<f32>,
}

/// One labelled press: what pressed, and what the channels read minus their untouched readings (`NaN`: not known).
pub type Press<'a> = (&'a Indentation, &'a [f32]);

impl Correction {
    /// Learns from single contacts. `gains` come from a [`Calibration`](crate::Calibration); 1 for each channel will do.
    ///
    /// # Errors
    ///
    /// [`ModelError`] where the model has no answer for a press.
    pub fn fit(
        model: &dyn ForwardModel,
        presses: &[Press<'_>],
        gains: &[f64],
        settings: &CorrectionSettings,
    ) -> Result<Self, ModelError> {
        let channels = model.channels();
        let force = presses.iter().map(|(c, _)| c.force.norm()).fold(0.0, f64::max).max(1e-9);
        let all: Vec<Point3<f64>> = presses.iter().map(|(c, _)| c.position).collect();
        let mut fitted = Self {
            centres: centres(&all, settings.length * 0.5, settings.centres),
            length: settings.length,
            force,
            powers: settings.powers + 1,
            gains: gains.to_vec(),
            weights: Vec::new(),
        };
        let width = fitted.centres.len() * fitted.powers;
        let untouched = Untouched::of(model)?;
        let (mut gram, mut sums) =
            (DMatrix::<f64>::zeros(width, width), DMatrix::<f64>::zeros(width, channels));
        // Rows in blocks: products of whole matrices are many times as fast as sums of outer products.
        const BLOCK: usize = 512;
        let mut expected = vec![0.0; channels];
        for block in presses.chunks(BLOCK) {
            let mut basis = DMatrix::<f64>::zeros(block.len(), width);
            let mut left = DMatrix::<f64>::zeros(block.len(), channels);
            let mut row = vec![0.0; width];
            for (i, (contact, signal)) in block.iter().enumerate() {
                // A channel that is not known there leaves the whole press out: the rows are shared.
                if signal.iter().any(|v| !v.is_finite()) {
                    continue;
                }
                let stimulus = Stimulus { contacts: vec![(*contact).clone()], ..Stimulus::default() };
                model.response(&stimulus, &mut expected)?;
                untouched.subtract(&mut expected);
                fitted.basis(contact, &mut row);
                // The row is what the difference in the unit of the skin is made of, so that a press counts as much as its
                // force makes it stand out of the noise.
                basis.row_mut(i).iter_mut().zip(&row).for_each(|(b, r)| *b = *r);
                for (c, signal) in signal.iter().enumerate() {
                    left[(i, c)] = f64::from(*signal) - gains[c] * expected[c];
                }
            }
            gram += basis.tr_mul(&basis);
            sums += basis.tr_mul(&left);
        }
        let scale = (0..width).map(|i| gram[(i, i)]).sum::<f64>() / width.max(1) as f64;
        for i in 0..width {
            gram[(i, i)] += settings.ridge * scale.max(1e-30);
        }
        let weights = gram.cholesky().map(|factor| factor.solve(&sums));
        fitted.weights = match weights {
            Some(weights) => weights.transpose().iter().map(|w| *w as f32).collect(),
            None => vec![0.0; width * channels],
        };
        Ok(fitted)
    }

    /// Says what is impossible for a skin of `channels`.
    ///
    /// # Errors
    ///
    /// [`InverterError::Correction`] for one of another number of channels, [`InverterError::CorrectionValue`] names the field
    /// that cannot be.
    pub fn check(&self, channels: usize) -> Result<(), InverterError> {
        let found = self.gains.len();
        if found != channels {
            return Err(InverterError::Correction { found, expected: channels });
        }
        let wrong = |field, reason: String| Err(InverterError::CorrectionValue { field, reason });
        for (field, value) in [("length", self.length), ("force", self.force)] {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, format!("is {value} and must be positive"));
            }
        }
        let expected = self.centres.len().checked_mul(self.powers).and_then(|n| n.checked_mul(channels));
        if Some(self.weights.len()) != expected {
            let reason = format!(
                "has {} numbers where {} centres, {} powers of the force and {channels} channels need another number",
                self.weights.len(),
                self.centres.len(),
                self.powers
            );
            return wrong("weights", reason);
        }
        let off = |i: usize| format!("number {i} is not finite");
        if let Some(i) = self.gains.iter().position(|v| !v.is_finite()) {
            return wrong("gains", off(i));
        }
        if let Some(i) = self.weights.iter().position(|v| !v.is_finite()) {
            return wrong("weights", off(i));
        }
        if let Some(i) = self.centres.iter().position(|c| !c.iter().all(|v| v.is_finite())) {
            return wrong("centres", off(i));
        }
        Ok(())
    }

    /// Root mean square of what remains of `presses`, in units of the noise, over channels that are known.
    ///
    /// # Errors
    ///
    /// [`ModelError`] where the model has no answer for a press.
    pub fn remainder(&self, model: &dyn ForwardModel, presses: &[Press<'_>]) -> Result<f64, ModelError> {
        let untouched = Untouched::of(model)?;
        let mut expected = vec![0.0; model.channels()];
        let (mut sum, mut count) = (0.0, 0usize);
        for (contact, signal) in presses {
            let stimulus = Stimulus { contacts: vec![(*contact).clone()], ..Stimulus::default() };
            model.response(&stimulus, &mut expected)?;
            untouched.subtract(&mut expected);
            expected.iter_mut().zip(&self.gains).for_each(|(e, gain)| *e *= gain);
            self.add(contact, &mut expected);
            for ((e, v), n) in expected.iter().zip(*signal).zip(model.noise()) {
                if v.is_finite() {
                    sum += ((f64::from(*v) - e) / n).powi(2);
                    count += 1;
                }
            }
        }
        Ok((sum / count.max(1) as f64).sqrt())
    }

    /// Values of all basis functions for one contact, times its force.
    fn basis(&self, contact: &Indentation, out: &mut [f64]) {
        let force = contact.force.norm();
        let share = force / self.force;
        for (centre, out) in self.centres.iter().zip(out.chunks_exact_mut(self.powers)) {
            let distance = (Point3::from(*centre) - contact.position).norm_squared();
            let mut value = force * (-distance / (2.0 * self.length * self.length)).exp();
            for o in out {
                *o = value;
                value *= share;
            }
        }
    }

    /// Adds the difference that one contact makes to `out`, in the unit of the skin.
    fn add(&self, contact: &Indentation, out: &mut [f64]) {
        let force = contact.force.norm();
        let share = force / self.force;
        // Beyond this many lengths a Gaussian is below what any channel could show.
        let reach = (6.0 * self.length).powi(2);
        let channels = out.len();
        for (k, centre) in self.centres.iter().enumerate() {
            let distance = (Point3::from(*centre) - contact.position).norm_squared();
            if distance > reach {
                continue;
            }
            let mut value = force * (-distance / (2.0 * self.length * self.length)).exp();
            for power in 0..self.powers {
                let start = (k * self.powers + power) * channels;
                for (o, w) in out.iter_mut().zip(&self.weights[start..start + channels]) {
                    *o += value * f64::from(*w);
                }
                value *= share;
            }
        }
    }
}

/// Of these points, `most` at most that are `apart` \[m\] or more from one another; farther, where there would be more.
fn centres(points: &[Point3<f64>], mut apart: f64, most: usize) -> Vec<[f64; 3]> {
    loop {
        let mut chosen: Vec<Point3<f64>> = Vec::new();
        for point in points {
            if chosen.iter().all(|c| (c - point).norm() >= apart) {
                chosen.push(*point);
            }
            if chosen.len() > most {
                break;
            }
        }
        if chosen.len() <= most {
            return chosen.iter().map(|p| p.coords.into()).collect();
        }
        apart *= 1.1;
    }
}

/// A forward model with a [`Correction`]: the signals of contacts add up in what differs.
///
/// A device that remembers is corrected after its memory: its readings are first those of the inner device, history included, and
/// then corrected for what touches now. The gains were measured on readings, so they belong after everything that makes a reading;
/// they scale about the untouched reading of the model. For memory that is linear in the signal (creep, a low-pass filter) the order
/// does not matter for the gains. The part of the correction that depends on the place is added at once and does not creep. It is a
/// few per cent of a signal and creep a few per cent of that. A zero that drifts inside the inner device is scaled by the gains, too.
pub struct Corrected {
    model: Arc<dyn ForwardModel>,
    correction: Correction,
    untouched: Untouched,
}

impl std::fmt::Debug for Corrected {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let centres = self.correction.centres.len();
        f.debug_struct("Corrected").field("centres", &centres).finish_non_exhaustive()
    }
}

impl Corrected {
    /// The corrected model.
    ///
    /// # Errors
    ///
    /// As [`Correction::check`].
    pub fn new(model: Arc<dyn ForwardModel>, correction: Correction) -> Result<Self, InverterError> {
        correction.check(model.channels())?;
        let untouched = Untouched::of(model.as_ref())?;
        Ok(Self { model, correction, untouched })
    }
}

impl Corrected {
    /// Makes readings of the device of those of its model, for what touches.
    fn correct(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        if stimulus.contacts.len() > 1 && !self.model.superposes() {
            return Err(ModelError::Stimulus {
                index: 1,
                reason: "this model's readings of several contacts do not add up, and a correction that was learned from \
                         single presses cannot say more: leave the correction out, or ask for one contact"
                    .to_owned(),
            });
        }
        let untouched = self.untouched.readings();
        for ((o, rest), gain) in out.iter_mut().zip(untouched).zip(&self.correction.gains) {
            *o = rest + (*o - rest) * gain;
        }
        for contact in &stimulus.contacts {
            self.correction.add(contact, out);
        }
        Ok(())
    }
}

impl Wrapper for Corrected {
    const CHANGES_RESPONSE: bool = true;

    fn inner(&self) -> &dyn ForwardModel {
        self.model.as_ref()
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.model.response(stimulus, out)?;
        self.correct(stimulus, out)
    }

    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        Box::new(CorrectedState { inner: self.model.start(seed), corrected: self })
    }
}

/// A device whose readings, with all that it remembers, are corrected.
struct CorrectedState<'a> {
    inner: Box<dyn DeviceState + 'a>,
    corrected: &'a Corrected,
}

#[deny(clippy::missing_trait_methods)]
impl DeviceState for CorrectedState<'_> {
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        self.inner.apply_to_stimulus(time, stimulus);
    }

    fn step(&mut self, time: f64, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.inner.step(time, stimulus, out)?;
        self.corrected.correct(stimulus, out)
    }

    fn capture(
        &mut self,
        time: f64,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        self.inner.capture(time, stimulus, noise)
    }

    fn quantize(&mut self, readings: &mut [f64]) {
        self.inner.quantize(readings);
    }
}

#[cfg(test)]
mod tests {
    use dermis_fixtures::Analytic;
    use rand::Rng;

    use super::*;
    use crate::testing::{grid, press, random, read};
    use crate::{Inverter, Reading, Settings};

    /// Readings of a device whose taxels sit up to 0.4 mm elsewhere and are off in gain.
    fn device(noise: f64) -> Analytic {
        let mut random = random(5);
        let mut toy = grid(noise);
        for element in &mut toy.elements {
            element.at.x += random.random_range(-4e-4..4e-4);
            element.at.y += random.random_range(-4e-4..4e-4);
            element.gain = random.random_range(0.9..1.1);
        }
        toy
    }

    #[test]
    fn a_corrected_model_forwards_what_it_does_not_correct() {
        let probe: Arc<dyn ForwardModel> = Arc::new(dermis_model::suite::Probe::default());
        let nothing =
            Correction::fit(probe.as_ref(), &[], &[1.0; 2], &CorrectionSettings::default()).unwrap();
        let corrected = Corrected::new(Arc::clone(&probe), nothing).unwrap();
        dermis_model::suite::forwards_everything(&corrected, probe.noise(), false);
        // The probe's contacts do not add up: a correction has nothing to say of two.
        let contacts = vec![press(0.0, 0.0, 1.0), press(0.004, 0.0, 1.0)];
        let stimulus = Stimulus { contacts, ..Stimulus::default() };
        let refused = ForwardModel::response(&corrected, &stimulus, &mut [0.0; 2]).unwrap_err().to_string();
        assert!(refused.contains("do not add up"), "{refused}");
    }

    #[test]
    fn a_corrected_device_is_corrected_after_what_it_remembers() {
        let probe: Arc<dyn ForwardModel> = Arc::new(dermis_model::suite::Probe::that_superposes());
        let nothing =
            Correction::fit(probe.as_ref(), &[], &[2.0; 2], &CorrectionSettings::default()).unwrap();
        let corrected = Corrected::new(probe, nothing).unwrap();
        let (mut state, mut out) = (ForwardModel::start(&corrected, 10), [0.0; 2]);
        state.step(0.5, &Stimulus::default(), &mut out).unwrap();
        // The probe counts its steps from the seed on, and reads 17 untouched.
        assert_eq!(out[0], 17.0 + 2.0 * (11.5 - 17.0));
    }

    #[test]
    fn presses_correct_a_model() {
        let (model, device) = (Arc::new(grid(1e-3)), device(1e-3));
        let mut random = random(2);
        let mut at = |from: f64| random.random_range(-from..from);
        let contacts: Vec<Indentation> =
            (0..1500).map(|_| press(at(0.016), at(0.016), 1.0 + at(0.8))).collect();
        let mut noise = crate::testing::random(3);
        let signals: Vec<Vec<f32>> = contacts
            .iter()
            .map(|c| {
                let read = read(&device, std::slice::from_ref(c), &mut noise);
                read.iter().map(|r| if let Reading::Exact(v) = r { *v as f32 } else { f32::NAN }).collect()
            })
            .collect();
        let presses: Vec<Press<'_>> = contacts.iter().zip(signals.iter().map(Vec::as_slice)).collect();
        let (train, test) = presses.split_at(1200);
        let settings =
            CorrectionSettings { length: 0.004, ridge: 1e-6, powers: 1, ..CorrectionSettings::default() };
        let none = Correction::fit(model.as_ref(), &[], &[1.0; 25], &settings).unwrap();
        let before = none.remainder(model.as_ref(), test).unwrap();
        let fitted = Correction::fit(model.as_ref(), train, &[1.0; 25], &settings).unwrap();
        let after = fitted.remainder(model.as_ref(), test).unwrap();
        assert!(before > 10.0 && after < 0.1 * before, "{before} {after}");

        let text = serde_json::to_string(&fitted).unwrap();
        let fitted: Correction = serde_json::from_str(&text).unwrap();
        let corrected: Arc<dyn ForwardModel> = Arc::new(Corrected::new(model.clone(), fitted).unwrap());
        let mut settings = Settings::new(0.004, 2.0);
        settings.contacts = 2;
        let error = |model: Arc<dyn ForwardModel>| -> f64 {
            let inverter = Inverter::new(model, settings.clone()).unwrap();
            let truth = [press(0.007, 0.005, 1.0), press(-0.008, -0.006, 0.8)];
            let readings = read(&device, &truth, &mut crate::testing::random(9));
            let found = inverter.solve(&readings, None).unwrap().contacts;
            truth
                .iter()
                .map(|t| found.iter().map(|f| (f.position - t.position).norm()).fold(f64::INFINITY, f64::min))
                .sum()
        };
        let (before, after) = (error(model), error(corrected));
        assert!(after < 0.3 * before, "{before} {after}");
    }

    #[test]
    fn a_correction_of_another_skin_is_refused() {
        let model = Arc::new(grid(1e-3));
        let mut correction =
            Correction::fit(model.as_ref(), &[], &[1.0; 25], &CorrectionSettings::default()).unwrap();
        assert!(Corrected::new(model.clone(), correction.clone()).is_ok());
        correction.gains.pop();
        let refused = Corrected::new(model, correction).unwrap_err().to_string();
        insta::assert_snapshot!(refused, @"a correction of 24 channels for a model of 25; fit it anew");
    }

    #[test]
    fn a_damaged_correction_is_refused() {
        let presses = [press(0.0, 0.0, 1.0), press(0.004, 0.0, 0.5)];
        let signals: Vec<Vec<f32>> = vec![vec![0.1; 25]; 2];
        let presses: Vec<Press<'_>> = presses.iter().zip(signals.iter().map(Vec::as_slice)).collect();
        let settings = CorrectionSettings { length: 0.004, powers: 1, ..CorrectionSettings::default() };
        let good = Correction::fit(&grid(1e-3), &presses, &[1.0; 25], &settings).unwrap();
        assert!(good.check(25).is_ok());
        let refused = |change: fn(&mut Correction)| {
            let mut bad = good.clone();
            change(&mut bad);
            bad.check(25).unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused(|c| c.weights[3] = f32::NAN), @"the correction's `weights`: number 3 is not finite; fit it anew");
        insta::assert_snapshot!(refused(|c| c.length = 0.0), @"the correction's `length`: is 0 and must be positive; fit it anew");
        insta::assert_snapshot!(refused(|c| c.powers = usize::MAX), @"the correction's `weights`: has 100 numbers where 2 centres, 18446744073709551615 powers of the force and 25 channels need another number; fit it anew");
    }
}
