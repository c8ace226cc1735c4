//! A panel from when it was switched on.

use dermis_model::{DeviceState, Stimulus};
use dermis_skin::ModelError;

use super::{FabricModel, Scratch};
use crate::effects::Started;
use crate::memory::Remembered;

/// The state of a panel.
pub(super) struct Device<'a> {
    model: &'a FabricModel,
    foam: Option<Remembered>,
    drifting: Started,
    scratch: Scratch,
    /// Voltages of the frame before, and its time \[s\].
    before: Option<(Vec<f64>, f64)>,
}

impl<'a> Device<'a> {
    pub fn new(model: &'a FabricModel, drifting: Started) -> Self {
        let memory = model.parameters.memory;
        let foam = memory.remembers().then(|| Remembered::new(memory, model.parameters.grid.count()));
        Self { model, foam, drifting, scratch: Scratch::default(), before: None }
    }
}

impl DeviceState for Device<'_> {
    fn step(&mut self, time: f64, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        let model = self.model;
        let mut pressures = model.pressures(stimulus)?;
        if let Some(foam) = &mut self.foam {
            // It is all of the pressure that the foam remembers.
            let rest = |node| model.parameters.resting(node);
            pressures.iter_mut().for_each(|(node, p)| *p += rest(*node));
            foam.apply(time, &mut pressures);
            pressures.iter_mut().for_each(|(node, p)| *p -= rest(*node));
        }
        // A clock that jumps back makes no time.
        let dt = self.before.as_ref().map(|(_, last)| (time - last).max(0.0));
        let scale = model.scale(stimulus.temperature) * self.drifting.fabric(dt.unwrap_or(0.0));
        model.voltages(&pressures, scale, &mut self.scratch, out);
        if let Some(duration) = self.drifting.scan() {
            let now = out.to_vec();
            if let (Some((before, _)), Some(dt)) = (&self.before, dt) {
                let n = model.sheet.electrodes();
                for (k, (row, before)) in out.chunks_exact_mut(n).zip(before.chunks_exact(n)).enumerate() {
                    let lag = duration * (1.0 - k as f64 / n as f64);
                    let share = if dt > lag { lag / dt } else { 1.0 };
                    row.iter_mut().zip(before).for_each(|(v, b)| *v += share * (b - *v));
                }
            }
            self.before = Some((now, time));
        } else {
            self.before = Some((Vec::new(), time));
        }
        Ok(())
    }

    fn quantize(&mut self, readings: &mut [f64]) {
        let converter = &self.model.parameters.converter;
        for v in readings {
            *v = (v.clamp(0.0, converter.full_scale) / converter.step).round() * converter.step;
        }
    }
}
