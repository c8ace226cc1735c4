//! A thumb from when it was switched on.

use dermis_model::{DeviceState, Stimulus};
use dermis_skin::{Image, ModelError};

use super::{ThumbModel, seed};
use crate::effects::Started;
use crate::elastic::basis::Field;
use crate::optics::displaced::Displaced;
use crate::optics::shading::Changes;

/// The state of a thumb.
pub(super) struct Device<'a> {
    model: &'a ThumbModel,
    effects: Started,
    field: Field,
    /// What has crept of the inside's displacement, node by node.
    crept: Vec<f32>,
    displaced: Displaced,
    changes: Changes,
    /// Of the frame before.
    before: Changes,
    /// \[s\] of the latest frame.
    last: Option<f64>,
    /// Share of the time between frames that the first row is read before the last.
    skew: f64,
}

impl<'a> Device<'a> {
    pub fn new(model: &'a ThumbModel, effects: Started) -> Self {
        Self {
            model,
            effects,
            field: Field::default(),
            crept: Vec::new(),
            displaced: Displaced::default(),
            changes: Changes::default(),
            before: Changes::default(),
            last: None,
            skew: 0.0,
        }
    }

    /// Moves the inside to where it is at `time`.
    fn advance(&mut self, time: f64, stimulus: &Stimulus) -> Result<(), ModelError> {
        let model = self.model;
        model.displace(stimulus, &mut self.field)?;
        // A clock that jumps back makes no time.
        let dt = self.last.map(|last| (time - last).max(0.0));
        self.last = Some(time);
        if let Some((share, duration)) = self.effects.creep() {
            self.crept.resize(self.field.values.len(), 0.0);
            let left = dt.map_or(1.0, |dt| (-dt / duration).exp()) as f32;
            let share = share as f32;
            for (u, crept) in self.field.values.iter_mut().zip(&mut self.crept) {
                *crept = *u + (*crept - *u) * left;
                *u += share * (*crept - *u);
            }
            // What has crept is everywhere that a touch has been.
            self.field.rows = [0, model.parameters.grid.rows];
        }
        self.skew = 0.0;
        if let Some(duration) = self.effects.shutter() {
            std::mem::swap(&mut self.changes, &mut self.before);
            self.skew = dt.map_or(0.0, |dt| if dt > 0.0 { duration / dt } else { 1.0 });
        }
        model.shading.changes(&self.field, &mut self.displaced, &mut self.changes);
        Ok(())
    }

    /// What the picture shows: of now, and of the frame before in the rows that were read early.
    fn shown(&self) -> Vec<(&Changes, f64)> {
        let mut shown = vec![(&self.changes, 1.0)];
        if self.skew > 0.0 {
            shown.push((&self.before, self.skew));
        }
        shown
    }
}

impl DeviceState for Device<'_> {
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        self.effects.drag(time, stimulus);
    }

    fn step(&mut self, time: f64, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.advance(time, stimulus)?;
        let brighter = self.model.brighter(stimulus.temperature);
        self.model.picture.respond(&self.shown(), brighter, out);
        Ok(())
    }

    fn capture(
        &mut self,
        time: f64,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        self.advance(time, stimulus)?;
        let brighter = self.model.brighter(stimulus.temperature);
        Ok(self.model.picture.capture(&self.shown(), brighter, seed(noise)))
    }
}
