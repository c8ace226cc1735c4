//! Effects that remember, and those of the electronics.

use std::sync::Arc;

use dermis_mechanics::{Friction, Prony, RandomWalk, Warmth, stream};
use dermis_model::{Memory, Stimulus, tangents};
use dermis_skin::{Effect, ModelError, SkinDescription, Surface};
use nalgebra::{Unit, UnitQuaternion};
use rand::Rng;

use super::EFFECTS;
use crate::parameters::Bridge;

/// \[K\] at which gauges are balanced.
const STANDARD_TEMPERATURE: f64 = 293.15;

/// What a device that was just switched on will remember.
#[derive(Debug, Clone)]
pub struct Dynamics {
    start: ShellMemory,
}

impl Dynamics {
    /// The effects of `skin` that remember, and the `bridge` that counts.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] with the field `effects[i].…` where an effect or one of its parameters is unknown, or has a
    /// value that cannot be.
    pub fn new(skin: &SkinDescription, bridge: Option<Bridge>) -> Result<Self, ModelError> {
        Effect::check(&skin.effects, EFFECTS, &skin.name)?;
        let channels = skin.channels().len();
        let mut memory = ShellMemory { step: bridge.map(|b| b.count()), ..ShellMemory::default() };
        for effect in skin.effects.iter().filter(|e| e.strength > 0.0) {
            let Some(info) = EFFECTS.iter().find(|info| info.name == effect.name) else { continue };
            let (strength, value) = (effect.strength, |name: &str| info.value(effect, name));
            match info.name {
                "oblique-force" => {
                    let direction = stream(effect, 0).random_range(0.0..std::f64::consts::TAU);
                    memory.oblique = Some(Oblique {
                        angle: strength * value("angle"),
                        direction,
                        surface: Arc::new(skin.surface()),
                    });
                }
                "friction" => {
                    memory.friction =
                        Some(Friction::new(strength * value("coefficient"), Arc::new(skin.surface())));
                }
                "creep" => {
                    let terms = [("fast", "fast_time"), ("slow", "slow_time")];
                    let terms = terms.map(|(share, time)| (strength * value(share), value(time)));
                    memory.creep = Some(Prony::new(terms, channels));
                }
                "temperature" => {
                    // Each gauge keeps 0 to twice what is left on average.
                    let left = strength * value("expansion") * (1.0 - value("compensation"));
                    let per_kelvin =
                        (0..channels).map(|c| left * stream(effect, c).random_range(0.0..=2.0)).collect();
                    memory.warmth = Some((Warmth::of(value, stream(effect, channels)), per_kelvin));
                }
                "zero-drift" => {
                    let rate = strength * value("rate") / 3600f64.sqrt();
                    memory.drift = (0..channels).map(|c| RandomWalk::new(rate, stream(effect, c))).collect();
                }
                "saturation" => memory.end = Some((value("limit"), (1.0 - strength).max(0.0))),
                _ => {}
            }
        }
        Ok(Self { start: memory })
    }

    /// Switches the device on: `seed` as in [`ForwardModel::start`](dermis_model::ForwardModel::start).
    #[must_use]
    pub fn start(&self, seed: u64) -> ShellMemory {
        let mut memory = self.start.clone();
        memory.drift = memory.drift.iter().map(|drift| drift.restarted(seed)).collect();
        memory.warmth = memory.warmth.map(|(warmth, per_kelvin)| (warmth.restarted(seed), per_kelvin));
        memory
    }
}

/// One device from when it was switched on.
#[derive(Debug, Clone, Default)]
pub struct ShellMemory {
    oblique: Option<Oblique>,
    friction: Option<Friction>,
    creep: Option<Prony>,
    /// And strain per kelvin that is left of the expansion, one a channel.
    warmth: Option<(Warmth, Vec<f64>)>,
    drift: Vec<RandomWalk>,
    /// Strain either way beyond which readings grow by this share only.
    end: Option<(f64, f64)>,
    /// Strain of a count.
    step: Option<f64>,
    /// \[s\] of the first and of the last frame.
    times: Option<(f64, f64)>,
}

impl Memory for ShellMemory {
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        if let Some(oblique) = &self.oblique {
            oblique.turn(stimulus);
        }
        if let Some(friction) = &mut self.friction {
            friction.drag(time, stimulus);
        }
    }

    fn apply_transducer(&mut self, time: f64, stimulus: &Stimulus, readings: &mut [f64]) {
        let (first, last) = self.times.unwrap_or((time, time));
        self.times = Some((first, time));
        // A clock that jumps back makes no time.
        let dt = (time - last).max(0.0);
        if let Some(creep) = &mut self.creep {
            for (channel, reading) in readings.iter_mut().enumerate() {
                *reading += creep.faded(channel, dt, *reading);
            }
        }
        if let Some((warmth, per_kelvin)) = &mut self.warmth {
            let warm = warmth.kelvin(time - first, dt) + stimulus.temperature - STANDARD_TEMPERATURE;
            for (reading, per_kelvin) in readings.iter_mut().zip(per_kelvin) {
                *reading += *per_kelvin * warm;
            }
        }
        for (reading, drift) in readings.iter_mut().zip(&mut self.drift) {
            *reading += drift.next(dt);
        }
    }

    fn quantize(&mut self, readings: &mut [f64]) {
        if let Some((limit, share)) = self.end {
            for r in readings.iter_mut().filter(|r| r.abs() > limit) {
                *r = r.signum() * (limit + (r.abs() - limit) * share);
            }
        }
        if let Some(step) = self.step {
            readings.iter_mut().for_each(|r| *r = (*r / step).round() * step);
        }
    }
}

/// An indenter that stands askew.
#[derive(Debug, Clone)]
struct Oblique {
    /// \[rad\] from the normal.
    angle: f64,
    /// \[rad\] along the surface, from its first tangent.
    direction: f64,
    surface: Arc<Surface>,
}

impl Oblique {
    /// Turns forces; how hard they press stays what a plan asks for.
    fn turn(&self, stimulus: &mut Stimulus) {
        for contact in &mut stimulus.contacts {
            let (_, normal) = self.surface.project(&contact.position);
            let [first, second] = tangents(&normal);
            let (sin, cos) = self.direction.sin_cos();
            let axis = Unit::new_normalize(second * cos - first * sin);
            let turned = UnitQuaternion::from_axis_angle(&axis, self.angle) * contact.force;
            contact.force = turned / self.angle.cos();
        }
    }
}
