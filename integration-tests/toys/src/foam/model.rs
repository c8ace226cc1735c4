//! Stimulus → voltages, as changes against the untouched skin: what a model answers is 0 where nothing touches.

use dermis_model::{DeviceState, ForwardModel, Memory, Stepped, Stimulus};
use dermis_skin::{ModelError, SkinDescription, Surface};
use nalgebra::Point3;
use serde::Deserialize;

use super::effects;

/// \[N\] of a press that `sensitivity` speaks of.
const UNIT_FORCE: f64 = 10.0;
/// Exponent of the force: foams stiffen.
const EXPONENT: f64 = 0.7;

/// What lies between surface and electrodes.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Medium {
    /// \[m\] over which a press spreads.
    reach: f64,
    /// \[V\] of a press of 10 N right above an electrode.
    pub sensitivity: f64,
    /// By which a press takes from all others.
    stiffening: f64,
    /// Share of a reading that follows slowly.
    pub fade: f64,
    /// \[s\] time constant of that.
    time: f64,
}

impl Medium {
    /// As the skin description says, without effects.
    pub fn of(skin: &SkinDescription) -> Result<Self, ModelError> {
        let medium: Self = skin.medium_as()?;
        for (field, value, [low, high]) in [
            ("reach", medium.reach, [1e-3, 1.0]),
            ("sensitivity", medium.sensitivity, [1e-3, 10.0]),
            ("stiffening", medium.stiffening, [0.0, 10.0]),
            ("fade", medium.fade, [0.0, 0.9]),
            ("time", medium.time, [1e-3, 1e3]),
        ] {
            if !(low..=high).contains(&value) {
                return Err(ModelError::Description {
                    skin: skin.name.clone(),
                    field: format!("medium.{field}"),
                    reason: format!("is {value} and must be {low} to {high}"),
                });
            }
        }
        Ok(medium)
    }
}

/// Voltages of a foam over electrodes, each driven in turn.
pub struct FoamModel {
    surface: Surface,
    electrodes: Vec<Point3<f64>>,
    medium: Medium,
    noise: Vec<f64>,
}

impl FoamModel {
    /// The model of a skin.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        let medium = effects::apply(skin, Medium::of(skin)?)?;
        let electrodes: Vec<Point3<f64>> = skin.taxels.iter().map(dermis_skin::Taxel::point).collect();
        if skin.channels().len() != electrodes.len().pow(2) {
            return Err(ModelError::Description {
                skin: skin.name.clone(),
                field: "channels".into(),
                reason: format!("must be {} for {} electrodes", electrodes.len().pow(2), electrodes.len()),
            });
        }
        Ok(Self { surface: skin.surface(), medium, noise: skin.channel_noise(), electrodes })
    }
}

impl ForwardModel for FoamModel {
    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        let mut presses = Vec::with_capacity(stimulus.contacts.len());
        let mut load = 0.0;
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            let normal = contact.check(index, &self.surface)?;
            let pressing = (-contact.force.dot(&normal)).max(0.0) / UNIT_FORCE;
            let conductance = pressing.powf(EXPONENT);
            load += conductance;
            let spread = |e: &Point3<f64>| (-(e - contact.position).norm() / self.medium.reach).exp();
            presses.push((conductance, self.electrodes.iter().map(spread).collect::<Vec<f64>>()));
        }
        // What all of them press together takes from each: two presses are not the sum of one and one.
        let scale = self.medium.sensitivity / (1.0 + self.medium.stiffening * load);
        let n = self.electrodes.len();
        for (conductance, spread) in &presses {
            for (driven, a) in spread.iter().enumerate() {
                for (read, b) in spread.iter().enumerate() {
                    out[driven * n + read] -= scale * conductance * a * b;
                }
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// Presses take from each other.
    fn superposes(&self) -> bool {
        false
    }

    fn remembers(&self) -> bool {
        self.medium.fade > 0.0
    }

    fn start(&self, _: u64) -> Box<dyn DeviceState + '_> {
        let creep = Creep {
            slow: vec![0.0; self.noise.len()],
            fade: self.medium.fade,
            time: self.medium.time,
            last: None,
        };
        Box::new(Stepped::new(self, creep))
    }
}

/// The share of every reading that follows slowly.
struct Creep {
    slow: Vec<f64>,
    fade: f64,
    time: f64,
    last: Option<f64>,
}

impl Memory for Creep {
    fn apply_transducer(&mut self, time: f64, _: &Stimulus, readings: &mut [f64]) {
        let step =
            self.last.replace(time).map_or(0.0, |last| 1.0 - (-(time - last).max(0.0) / self.time).exp());
        for (reading, slow) in readings.iter_mut().zip(&mut self.slow) {
            *slow += step * (*reading - *slow);
            *reading = (1.0 - self.fade) * *reading + self.fade * *slow;
        }
    }
}
