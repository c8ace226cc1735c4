//! Calibrates "unknown" on the library itself: devices whose cause is known, simulated along presses that were recorded, and diagnosed
//! with that cause in the library and without it.
//!
//! Problem: how much may a right name leave, and what does a wrong one leave? Both depend on the presses, on the noise and on how wrong
//! the simulator is. Method: pseudo-unknown classes (leave one class out, so that a known cause stands for one that nobody thought of;
//! cf. arXiv 2203.13238), scored by a logistic regression (ridge; Hoerl and Kennard 1970) over what is measured of names and of what
//! they leave, with thresholds that are split-conformal quantiles of right names (Vovk, Gammerman and Shafer 2005).
//!
//! | trial | what is simulated | library | counts as |
//! |---|---|---|---|
//! | right | an effect of the library, or a number of the description | whole | known |
//! | law | the same by another law: its change times a smooth function of force and course of the press | whole | known |
//! | pair | two of them | whole | known |
//! | left-out | as right and law | without it | unknown |
//! | shape | readings times a random field, a change of some locations, a share of other channels | whole | unknown |
//!
//! In all of them the numbers of the medium and the tip are off within their tolerance, and the noise is one to five times what is
//! declared. Assumptions: what an unknown cause leaves is like what a left-out effect or such a shape leaves. Cost: one simulation of all
//! frames and one or two diagnoses a trial; signatures are simulated once.

use std::collections::BTreeMap;

use dermis_model::diagnosis::Signature;
use dermis_skin::{Effect, Phase};
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::{Memory, Options, check, diagnose, signatures};
use crate::GapError;
use crate::constants::calibrate::{EARLY, LAW, NEAR, NOISES, NUMBER, OFF, SCALE, SCALINGS, SIZES, WARM_UP};
use crate::constants::signatures::TOLERANCE;
use crate::design;
use crate::effects;
use crate::recording::Recording;
use crate::report::Verdict;
use crate::rivals::{Shape, columns};
use crate::samples::Samples;
use crate::signatures::{Candidate, Signatures};
use crate::simulate::Simulator;
use crate::whitening::whiten;

/// What a trial simulates, and what its diagnosis could know.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// An effect that the library has.
    Right,
    /// The same by another law.
    Law,
    /// Two effects that the library has.
    Pair,
    /// An effect that is left out of the library.
    LeftOut,
    /// A shape that no effect has.
    Shape,
}

impl Kind {
    /// Whether the cause is outside of the library.
    #[must_use]
    pub fn unknown(self) -> bool {
        matches!(self, Self::LeftOut | Self::Shape)
    }
}

/// A simulated device and what the diagnosis made of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// What was simulated.
    pub kind: Kind,
    /// Its causes.
    pub causes: Vec<String>,
    /// Classes of what was named, the strongest first.
    pub named: Vec<Vec<String>>,
    /// What it came to.
    pub verdict: Verdict,
    /// What was measured of the names and of what they leave ([`Unknown::tests`](crate::Unknown::tests)).
    pub tests: BTreeMap<String, f64>,
}

/// What all trials along one recording share.
struct Bench<'a> {
    simulator: &'a Simulator<'a>,
    recording: &'a Recording,
    options: &'a Options,
    memory: &'a Memory,
    samples: Samples,
    signatures: std::sync::Arc<Signatures>,
    /// All frames of which something is known.
    frames: Vec<usize>,
    noise: Vec<f64>,
}

/// Simulates and diagnoses `count` devices along the presses of `recording`, whose readings are not used.
///
/// # Errors
///
/// [`GapError`] where the nominal model cannot read the stimuli of the recording.
pub fn trials(
    simulator: &Simulator<'_>,
    recording: &Recording,
    options: &Options,
    (count, seed): (usize, u64),
) -> Result<Vec<Trial>, GapError> {
    let checked = check::recording(recording, simulator.skin, &options.samples);
    let memory = Memory::default();
    let (signatures, _) = signatures::obtain(simulator, recording, &checked.samples, options, &memory)?;
    let frames = (0..recording.labels.len()).filter(|i| recording.labels[*i].stimulus.is_some()).collect();
    let bench = Bench {
        simulator,
        recording,
        options,
        memory: &memory,
        samples: checked.samples,
        signatures,
        frames,
        noise: simulator.skin.channel_noise(),
    };
    let mut found = Vec::new();
    for index in 0..count {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(index as u64);
        let kind = [Kind::Right, Kind::Law, Kind::Pair, Kind::Shape][index % 4];
        // Any other error: what was drawn no device can have.
        if let Err(GapError::Interrupted) = bench.trial(kind, &mut rng, &mut found) {
            return Err(GapError::Interrupted);
        }
    }
    Ok(found)
}

impl Bench<'_> {
    /// One device: with the whole library, and where its cause is one effect, without that.
    fn trial(&self, kind: Kind, rng: &mut ChaCha8Rng, found: &mut Vec<Trial>) -> Result<(), GapError> {
        let base = self.built(rng);
        let nominal = self.read(&base)?;
        let [least, most] = SIZES;
        let size = least * (most / least).powf(rng.random());
        let mut causes = Vec::new();
        let mut readings = nominal.clone();
        match kind {
            Kind::Shape => causes.push(self.shaped(&mut readings, size, rng)?),
            _ => {
                let parts = if kind == Kind::Pair { 2 } else { 1 };
                let mut names: Vec<&Candidate> = self.signatures.candidates.iter().collect();
                names.retain(|c| self.draw(c, rng).is_some());
                for of in names.choose_multiple(rng, parts) {
                    let changed = self.changed(of, (&base, &nominal), size, kind == Kind::Law, rng)?;
                    readings.iter_mut().zip(changed).for_each(|(r, c)| *r += c);
                    causes.push(of.name.clone());
                }
            }
        }
        let factor: f64 = *NOISES.choose(rng).unwrap_or(&1.0);
        let mut recording = self.recording.clone();
        let channels = recording.channels;
        for (row, frame) in readings.chunks_exact(channels).zip(&self.frames) {
            for (k, value) in row.iter().enumerate() {
                let noise: f64 = rng.sample(StandardNormal);
                recording.readings[frame * channels + k] = value + (factor * self.noise[k] * noise) as f32;
            }
        }
        let mut said = |kind: Kind, without: Vec<String>| -> Result<(), GapError> {
            let options = Options { without, resamples: 0, ..self.options.clone() };
            let report = diagnose(self.simulator, &recording, &options, self.memory)?.report;
            let class = |e: &crate::NamedEffect| e.class.iter().map(|a| a.name.clone()).collect();
            if !report.unknown.tests.is_empty() {
                found.push(Trial {
                    kind,
                    causes: causes.clone(),
                    named: report.effects.iter().map(class).collect(),
                    verdict: report.verdict,
                    tests: report.unknown.tests,
                });
            }
            Ok(())
        };
        said(kind, Vec::new())?;
        if matches!(kind, Kind::Right | Kind::Law) {
            said(Kind::LeftOut, causes.clone())?;
        }
        Ok(())
    }

    /// A device as it is built: numbers of the medium and the tip off within their tolerance.
    fn built(&self, rng: &mut ChaCha8Rng) -> Vec<Effect> {
        let mut off = |size: f64| 1.0 + size * TOLERANCE * rng.sample::<f64, _>(StandardNormal);
        let stated = |path: &str| path.strip_prefix("medium.").is_some_and(|key| !key.contains(['.', '[']));
        let numbers = design::numbers(self.simulator.skin).into_iter().filter(|n| stated(&n.path));
        let mut built: Vec<Effect> =
            numbers.map(|n| design::hypothesis(&n.path, n.value * off(OFF))).collect();
        let tip = effects::with(|p| p.tolerance.is_some()).next();
        let parameter = tip.and_then(|info| Some((info.name, info.diagnosis.tolerance?.0)));
        built.extend(parameter.map(|(name, parameter)| Effect::new(name).with(parameter, off(OFF))));
        built
    }

    fn read(&self, effects: &[Effect]) -> Result<Vec<f32>, GapError> {
        self.simulator.readings(&self.simulator.with(effects), self.recording, &self.frames)
    }

    /// Energy of a change, as a share of that of signals.
    fn share(&self, change: &[f32], nominal: &[f32]) -> f64 {
        let white = |values: &[f32]| whiten(values, &self.noise);
        let energy = |values: Vec<f32>| values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
        energy(white(change)) / energy(white(nominal)).max(1e-300)
    }

    /// A random device with this effect; `None` where nothing says how one is drawn.
    fn draw(&self, of: &Candidate, rng: &mut ChaCha8Rng) -> Option<Vec<Effect>> {
        if let Signature::DecayFromPowerOn { time, share } = effects::of(&of.name).signature {
            let [deviation, least, constant] = WARM_UP;
            let start = (deviation * rng.sample::<f64, _>(StandardNormal)).max(least);
            return Some(vec![Effect::new(of.name.clone()).with(time, constant).with(share.0, start)]);
        }
        if let Some(info) = self.simulator.effects.iter().find(|i| i.name == of.name) {
            let mut effect = Effect::new(info.name);
            for p in info.parameters {
                let [low, high] = p.range;
                if low.is_finite() && high > low {
                    effect = effect.with(p.name, low + (high - low) * rng.random::<f64>());
                }
            }
            return Some(vec![if info.random { effect.seed(rng.random_range(5000..9000)) } else { effect }]);
        }
        let mut drawn: Vec<Effect> = Vec::new();
        for (name, parameter, amount) in of.linear.iter().filter(|(.., amount)| *amount != 0.0) {
            let by: f64 = rng.sample(StandardNormal);
            let value = match design::value(self.simulator.skin, name) {
                Some(nominal) => design::within(nominal, nominal + NUMBER * by * amount),
                None => effects::value(effects::of(name), by, *amount),
            };
            match drawn.iter_mut().find(|e| e.name == *name) {
                Some(effect) => {
                    effect.parameters.entry(parameter.clone()).or_insert(value);
                }
                None => drawn.push(Effect::new(name.clone()).with(parameter.clone(), value)),
            }
        }
        (!drawn.is_empty()).then_some(drawn)
    }

    /// What an effect of about this size changes, by its own law or another.
    fn changed(
        &self,
        of: &Candidate,
        (base, nominal): (&[Effect], &[f32]),
        size: f64,
        other_law: bool,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<f32>, GapError> {
        let full = self.draw(of, rng).unwrap_or_default();
        let at = |scale: f64| -> Result<Vec<f32>, GapError> {
            let scaled: Vec<Effect> = full.iter().map(|e| self.scaled(e, scale)).collect();
            let mut all = base.to_vec();
            // A number is off by what it is off; a tolerance of it is no part of that.
            all.retain(|b| !scaled.iter().any(|e| e.name == b.name));
            all.extend(scaled);
            let read = self.read(&all)?;
            Ok(read.iter().zip(nominal).map(|(a, b)| a - b).collect())
        };
        let mut scale: f64 = 1.0;
        let mut change = at(scale)?;
        for _ in 0..SCALINGS {
            let share = self.share(&change, nominal);
            if share <= 0.0 || (share / size).ln().abs() < NEAR {
                break;
            }
            scale = (scale * (size / share).sqrt()).clamp(SCALE[0], SCALE[1]);
            change = at(scale)?;
        }
        if other_law {
            let factors = self.law(rng);
            let channels = self.recording.channels;
            change.iter_mut().enumerate().for_each(|(i, c)| *c *= factors[i / channels]);
        }
        Ok(change)
    }

    /// An effect so many times as large.
    fn scaled(&self, effect: &Effect, scale: f64) -> Effect {
        let mut scaled = effect.clone();
        if self.simulator.effects.iter().any(|i| i.name == effect.name) {
            scaled.strength = scale.min(1.0);
            return scaled;
        }
        let number = design::value(self.simulator.skin, &effect.name);
        let properties = effects::of(&effect.name);
        let fixed = match properties.signature {
            Signature::DecayFromPowerOn { time, .. } => Some(time),
            _ => None,
        };
        for (name, value) in scaled.parameters.iter_mut().filter(|(name, _)| fixed != Some(name.as_str())) {
            *value = match number {
                Some(nominal) if name == design::VALUE => {
                    design::within(nominal, nominal + scale * (*value - nominal))
                }
                _ => effects::value(properties, scale, *value - properties.neutral),
            };
        }
        scaled
    }

    /// By what another law of an effect differs, in each frame: a smooth function of force and course.
    fn law(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let weights: [f64; 4] = std::array::from_fn(|_| rng.sample::<f64, _>(StandardNormal));
        let labels = &self.recording.labels;
        let most = labels.iter().map(crate::FrameLabel::force).fold(1e-9, f64::max);
        let mut begun = 0.0;
        let mut touched = false;
        self.frames
            .iter()
            .map(|frame| {
                let label = &labels[*frame];
                if label.phase.touched() != touched {
                    (touched, begun) = (label.phase.touched(), label.time);
                }
                let u = 2.0 * label.force() / most - 1.0;
                let way = match label.phase {
                    Phase::Load => 1.0,
                    Phase::Unload => -1.0,
                    _ => 0.0,
                };
                let early = 2.0 * (-(label.time - begun).max(0.0) / EARLY).exp() - 1.0;
                // Legendre's polynomials have a mean square of one over these.
                let parts = [3.0f64.sqrt() * u, 5.0f64.sqrt() * 0.5 * (3.0 * u * u - 1.0), way, early];
                let sum: f64 = parts.iter().zip(weights).map(|(p, w)| p * w).sum();
                (1.0 + LAW * 0.5 * sum) as f32
            })
            .collect()
    }

    /// Adds a change of about this size that has a shape and no cause; says which.
    fn shaped(&self, readings: &mut [f32], size: f64, rng: &mut ChaCha8Rng) -> Result<String, GapError> {
        const SHAPES: [Shape; 3] = [Shape::Place, Shape::Field, Shape::Mixing];
        let shape = *SHAPES.choose(rng).unwrap_or(&Shape::Place);
        let channels = self.recording.channels;
        let frames = self.samples.frames();
        let at: BTreeMap<usize, usize> = self.frames.iter().enumerate().map(|(i, f)| (*f, i)).collect();
        let rows: Vec<usize> = frames.iter().filter_map(|f| at.get(f).copied()).collect();
        let zero = self.simulator.zero_level(self.recording)?;
        let nominal: Vec<f32> =
            rows.iter().flat_map(|r| readings[r * channels..][..channels].to_vec()).collect();
        let signals = whiten(&zero.signals(&nominal, channels), &self.noise);
        let columns = columns::of(shape, &self.samples, &signals, channels).columns;
        let mut change = vec![0.0f32; nominal.len()];
        // A place or two are changed, or everything in a pattern.
        let few = shape == Shape::Place;
        let chosen: Vec<usize> = if few && !columns.is_empty() {
            (0..1 + usize::from(rng.random::<bool>())).map(|_| rng.random_range(0..columns.len())).collect()
        } else {
            (0..columns.len()).collect()
        };
        for c in chosen {
            let column = &columns[c];
            let x: f32 = rng.sample(StandardNormal);
            for (i, value) in change.iter_mut().enumerate() {
                let (sample, k) = (i / channels, i % channels);
                match column.channel {
                    Some(own) if own == k => *value += x * column.values[sample],
                    Some(_) => {}
                    None => *value += x * column.values[i],
                }
            }
        }
        let all: f64 = signals.iter().map(|v| f64::from(*v).powi(2)).sum();
        let own: f64 = change.iter().map(|v| f64::from(*v).powi(2)).sum();
        let scale = (size * all / own.max(1e-300)).sqrt();
        for (j, row) in rows.iter().enumerate() {
            for k in 0..channels {
                readings[row * channels + k] +=
                    (scale * f64::from(change[j * channels + k]) * self.noise[k]) as f32;
            }
        }
        Ok(format!("shape:{}", shape.name()))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::with_simulator;
    use super::*;
    use crate::testing::recorded;

    #[test]
    fn devices_are_diagnosed_with_and_without_their_cause() {
        with_simulator(|simulator| {
            let recording = recorded(simulator, &[]);
            let options = Options::default();
            let found = trials(simulator, &recording, &options, (8, 3)).unwrap();
            let of = |kind: Kind| found.iter().filter(|t| t.kind == kind).collect::<Vec<_>>();
            assert!(!of(Kind::LeftOut).is_empty() && !of(Kind::Shape).is_empty(), "{found:?}");
            assert!(of(Kind::Pair).iter().all(|t| t.causes.len() == 2));
            for trial in &found {
                assert!(trial.tests.contains_key("left"), "{trial:?}");
                let named = |cause: &String| trial.named.iter().flatten().any(|n| n == cause);
                // What is left out of the library cannot be named.
                assert!(trial.kind != Kind::LeftOut || !trial.causes.iter().any(named), "{trial:?}");
            }
            // A right name leaves less than a shape that no effect has.
            let left = |kind: Kind| {
                let mut all: Vec<f64> = of(kind).iter().map(|t| t.tests["left"]).collect();
                all.sort_by(f64::total_cmp);
                all[all.len() / 2]
            };
            assert!(left(Kind::Right) < left(Kind::Shape), "{found:?}");
        });
    }

    #[test]
    fn what_is_drawn_is_as_large_as_was_asked_for() {
        with_simulator(|simulator| {
            let recording = recorded(simulator, &[]);
            let options = Options::default();
            let checked = check::recording(&recording, simulator.skin, &options.samples);
            let memory = Memory::default();
            let (signatures, _) =
                signatures::obtain(simulator, &recording, &checked.samples, &options, &memory).unwrap();
            let bench = Bench {
                simulator,
                recording: &recording,
                options: &options,
                memory: &memory,
                samples: checked.samples,
                signatures,
                frames: (0..recording.labels.len()).collect(),
                noise: simulator.skin.channel_noise(),
            };
            let nominal = bench.read(&[]).unwrap();
            let gains = bench.signatures.candidates.iter().find(|c| c.name == "channel-gain").unwrap();
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let change = bench.changed(gains, (&[], &nominal), 0.02, false, &mut rng).unwrap();
            assert!((bench.share(&change, &nominal) / 0.02).ln().abs() < 0.3);
            let mut shaped = nominal.clone();
            bench.shaped(&mut shaped, 0.02, &mut rng).unwrap();
            // Only samples are changed, and they are some of the frames.
            assert!(shaped.iter().zip(&nominal).any(|(a, b)| a != b));
            assert_eq!(shaped.len(), nominal.len());
        });
    }
}
