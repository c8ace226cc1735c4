//! Effects that remember, and those of the electronics.

use std::collections::VecDeque;
use std::sync::Arc;

use dermis_mechanics::{Friction, Prony, RandomDrift, Warmth, stream};
use dermis_model::{Memory, Stimulus};
use dermis_skin::{Effect, ModelError, SkinDescription};
use rand::Rng;

use super::EFFECTS;

/// \[Pa\] that gauge pressures are relative to.
const STANDARD_ATMOSPHERE: f64 = 101_325.0;
/// \[K\] at which trapped air is neutral.
const STANDARD_TEMPERATURE: f64 = 293.15;
/// Thresholds of the play operators, per scale.
const PLAYS: [f64; 4] = [0.05, 0.1, 0.2, 0.4];
/// Stress on which friction that grows with the load turns round, per scale.
const DAHL: f64 = 0.05;

/// What a device that was just switched on will remember.
#[derive(Debug, Clone)]
pub struct Dynamics {
    start: MediumMemory,
}

impl Dynamics {
    /// The effects of `skin` that remember.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] with the field `effects[i].…` where an effect or one of its parameters is unknown, has a
    /// value that cannot be, or leaves a device that cannot be.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        Effect::check(&skin.effects, EFFECTS, &skin.name)?;
        let channels = skin.channels().len();
        let mut memory = MediumMemory { channels, ..MediumMemory::default() };
        for (i, effect) in skin.effects.iter().enumerate().filter(|(_, e)| e.strength > 0.0) {
            let Some(info) = EFFECTS.iter().find(|info| info.name == effect.name) else { continue };
            let (strength, value) = (effect.strength, |name: &str| info.value(effect, name));
            // What an effect takes away is at most all there is.
            let all = |taken: f64| {
                if taken <= 1.0 {
                    return Ok(());
                }
                Err(ModelError::Description {
                    skin: skin.name.clone(),
                    field: format!("effects[{i}].strength"),
                    reason: format!("is {strength}, and takes {taken} of a signal away: at most 1"),
                })
            };
            match info.name {
                "friction" => {
                    memory.friction =
                        Some(Friction::new(strength * value("coefficient"), Arc::new(skin.surface())));
                }
                "mullins" => {
                    let loss = strength * value("loss") * value("share");
                    all(loss)?;
                    memory.mullins =
                        Some(Mullins { loss, onset: value("onset"), largest: vec![0.0; channels] });
                }
                "hysteresis" => {
                    let (width, with_load) = (strength * value("width"), value("with_load"));
                    let weight = width * (1.0 - with_load) / (2.0 * PLAYS.iter().sum::<f64>());
                    all(weight * PLAYS.len() as f64 + 0.5 * width * with_load)?;
                    memory.hysteresis = Some(Hysteresis {
                        weight,
                        thresholds: PLAYS.map(|p| p * value("scale")),
                        plays: vec![[0.0; PLAYS.len()]; channels],
                        amplitude: 0.5 * width * with_load,
                        turns: DAHL * value("scale"),
                        friction: vec![[0.0; 2]; channels],
                    });
                }
                "relaxation" => {
                    let terms = [("fast", "fast_time"), ("slow", "slow_time")];
                    let terms = terms.map(|(share, time)| (strength * value(share), value(time)));
                    all(terms.iter().map(|t| t.0).sum())?;
                    memory.relaxation = Some(Prony::new(terms, channels));
                }
                "trapped-air" => {
                    all(2.0 * strength * value("share"))?;
                    let mean = strength * value("share");
                    memory.air = Some(Air {
                        shares: (0..channels)
                            .map(|c| mean * stream(effect, c).random_range(0.0..=2.0))
                            .collect(),
                        warmth: Warmth::of(value, stream(effect, channels)),
                    });
                }
                "ambient-pressure" => {
                    let deviation = strength * value("deviation");
                    memory.weather = Some(RandomDrift::new(deviation, value("time"), stream(effect, 0)));
                }
                "read-skew" => {
                    memory.skew = Some(Skew { delay: strength * value("delay"), frames: VecDeque::new() });
                }
                "saturation" => memory.end = Some((value("limit"), (1.0 - strength).max(0.0))),
                "resolution" => memory.step = Some(strength * value("step")).filter(|s| *s > 0.0),
                _ => {}
            }
        }
        Ok(Self { start: memory })
    }

    /// Switches the device on: `seed` as in [`ForwardModel::start`](dermis_model::ForwardModel::start).
    #[must_use]
    pub fn start(&self, seed: u64) -> MediumMemory {
        let mut memory = self.start.clone();
        memory.weather = memory.weather.map(|weather| weather.restarted(seed));
        memory.air = memory.air.map(|air| Air { warmth: air.warmth.restarted(seed), ..air });
        memory
    }
}

/// One device from when it was switched on.
#[derive(Debug, Clone, Default)]
pub struct MediumMemory {
    channels: usize,
    friction: Option<Friction>,
    mullins: Option<Mullins>,
    hysteresis: Option<Hysteresis>,
    /// Here too a medium that creeps alike everywhere keeps its stress under a prescribed force. What fades is what the stiff
    /// taxel has gathered beyond that: the medium flows away from above it.
    relaxation: Option<Prony>,
    air: Option<Air>,
    weather: Option<RandomDrift>,
    skew: Option<Skew>,
    /// \[Pa\] above which readings grow by this share only.
    end: Option<(f64, f64)>,
    /// \[Pa\] of a count.
    step: Option<f64>,
    /// \[s\] of the first and of the last frame.
    times: Option<(f64, f64)>,
}

impl Memory for MediumMemory {
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        if let Some(friction) = &mut self.friction {
            friction.drag(time, stimulus);
        }
    }

    fn apply_transducer(&mut self, time: f64, stimulus: &Stimulus, readings: &mut [f64]) {
        assert_eq!(readings.len(), self.channels);
        let (first, last) = self.times.unwrap_or((time, time));
        self.times = Some((first, time));
        // A clock that jumps back makes no time.
        let dt = (time - last).max(0.0);

        // The elastomer knows nothing of the air around: its own stress is the reading without it.
        let ambient = stimulus.ambient_pressure - STANDARD_ATMOSPHERE;
        let medium = self.mullins.is_some()
            || self.hysteresis.is_some()
            || self.relaxation.is_some()
            || self.air.is_some();
        if medium {
            for (channel, reading) in readings.iter_mut().enumerate() {
                let mut stress = *reading - ambient;
                if let Some(mullins) = &mut self.mullins {
                    stress = mullins.next(channel, stress);
                }
                if let Some(hysteresis) = &mut self.hysteresis {
                    stress = hysteresis.next(channel, stress);
                }
                if let Some(relaxation) = &mut self.relaxation {
                    stress -= relaxation.faded(channel, dt, stress);
                }
                if let Some(air) = &self.air {
                    stress *= 1.0 - air.shares[channel];
                }
                *reading = stress + ambient;
            }
        }
        if let Some(air) = &mut self.air {
            let warm = air.warmth.kelvin(time - first, dt) + stimulus.temperature - STANDARD_TEMPERATURE;
            // A sealed port: the pressure of its air follows the absolute temperature.
            let pressure = STANDARD_ATMOSPHERE * warm / STANDARD_TEMPERATURE;
            for (reading, share) in readings.iter_mut().zip(&air.shares) {
                *reading += share * pressure;
            }
        }
        if let Some(weather) = &mut self.weather {
            let offset = weather.next(dt);
            readings.iter_mut().for_each(|r| *r += offset);
        }
        if let Some(skew) = &mut self.skew {
            skew.next(time, readings);
        }
    }

    fn quantize(&mut self, readings: &mut [f64]) {
        if let Some((limit, share)) = self.end {
            readings.iter_mut().filter(|r| **r > limit).for_each(|r| *r = limit + (*r - limit) * share);
        }
        if let Some(step) = self.step {
            readings.iter_mut().for_each(|r| *r = (*r / step).round() * step);
        }
    }
}

/// Softening where the medium was stretched before.
///
/// Under a prescribed force the mean stress in any plane must balance that force, however soft the medium is: softening
/// everywhere changes nothing but the size of the contact. What is seen is that the softening is local. Above a taxel that has
/// felt much, the medium has lost part of its stiffness, its surroundings have not, and they take over a share of the load, for
/// every stress below the largest so far. On the virgin curve, at the largest stress so far, nothing is lost (Ogden and
/// Roxburgh's pseudo-elasticity, here linear in the distance from that curve).
#[derive(Debug, Clone)]
struct Mullins {
    /// Of the stress, far below the largest.
    loss: f64,
    onset: f64,
    largest: Vec<f64>,
}

impl Mullins {
    fn next(&mut self, channel: usize, stress: f64) -> f64 {
        let largest = &mut self.largest[channel];
        *largest = largest.max(stress.abs());
        if *largest == 0.0 {
            return stress;
        }
        let below = 1.0 - stress.abs() / *largest;
        let come = *largest / (*largest + self.onset);
        stress * (1.0 - self.loss * below * come)
    }
}

/// Prandtl and Ishlinskii: a sum of play operators of equal weight. Beside it Dahl's friction, in proportion to the load: between
/// grains of a filler that are pressed together.
#[derive(Debug, Clone)]
struct Hysteresis {
    weight: f64,
    thresholds: [f64; PLAYS.len()],
    plays: Vec<[f64; PLAYS.len()]>,
    /// Of the signal, to either side.
    amplitude: f64,
    /// \[Pa\] on which friction turns round.
    turns: f64,
    /// Friction from -1 to 1, and the last stress \[Pa\].
    friction: Vec<[f64; 2]>,
}

impl Hysteresis {
    fn next(&mut self, channel: usize, stress: f64) -> f64 {
        let mut lag = 0.0;
        for (play, threshold) in self.plays[channel].iter_mut().zip(self.thresholds) {
            *play = play.clamp(stress - threshold, stress + threshold);
            lag += stress - *play;
        }
        let [friction, last] = &mut self.friction[channel];
        let change = stress - *last;
        *last = stress;
        // Dahl's law along a stress that goes one way is exponential in it, whatever the steps.
        let side = change.signum();
        *friction = side + (*friction - side) * (-change.abs() / self.turns).exp();
        stress * (1.0 - self.amplitude * *friction) - self.weight * lag
    }
}

/// Air in the ports.
#[derive(Debug, Clone)]
struct Air {
    /// Of the port that is air, one a channel.
    shares: Vec<f64>,
    warmth: Warmth,
}

/// Channels that are read one after another. The last one is read at the frame's time, channel i so many delays before as
/// there are channels after it; linear between frames, and before the first frame as in it. So nothing needs the future.
#[derive(Debug, Clone)]
struct Skew {
    delay: f64,
    /// Time and readings, as far back as the first channel needs.
    frames: VecDeque<(f64, Vec<f64>)>,
}

impl Skew {
    fn next(&mut self, time: f64, readings: &mut [f64]) {
        let last = readings.len().saturating_sub(1);
        let oldest = time - self.delay * last as f64;
        let mut frame = Vec::new();
        while self.frames.len() > 1 && self.frames[1].0 <= oldest {
            frame = self.frames.pop_front().map(|f| f.1).unwrap_or_default();
        }
        frame.clear();
        frame.extend_from_slice(readings);
        self.frames.push_back((time, frame));
        for (channel, reading) in readings.iter_mut().enumerate() {
            let at = time - self.delay * (last - channel) as f64;
            let after = self.frames.partition_point(|(t, _)| *t < at);
            *reading = match (after.checked_sub(1), self.frames.get(after)) {
                (Some(before), Some((t1, next))) => {
                    let (t0, ago) = &self.frames[before];
                    let part = (at - t0) / (t1 - t0);
                    ago[channel] + (next[channel] - ago[channel]) * part
                }
                (None, Some((_, next))) => next[channel],
                // The frame's own time, but for rounding.
                (_, None) => *reading,
            };
        }
    }
}
