//! What a simulated device remembers from frame to frame.
//!
//! A frame of a device is four calls, in the order of the signal: [`DeviceState::apply_to_stimulus`] (what really touches),
//! [`DeviceState::step`] (the noise-free reading), the noise, [`DeviceState::quantize`] (the converter). A family whose model has
//! no memory of its own, but whose medium and transducers have, implements [`Memory`] and puts it behind its model with
//! [`Stepped`].

use dermis_skin::{Image, ModelError};

use crate::{ForwardModel, Stimulus};

/// One device from when it was switched on. Called in the order of time, once a frame. Another device, or the same one switched
/// on again, is another state.
pub trait DeviceState: Send {
    /// Changes what touches the skin at `time` \[s\]: friction drags at a tip that slides, say. What is left in `stimulus`
    /// is what really happens, and what a force cell at the indenter measures. It depends on the call before this one at
    /// most, so that the truth of an instant can be had without the way that led there.
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        let _ = (time, stimulus);
    }

    /// Noise-free readings at `time` \[s\] under `stimulus`, one a channel, in the unit of the skin, written to `out`.
    ///
    /// # Errors
    ///
    /// [`ModelError::Stimulus`] where the model has no answer.
    fn step(&mut self, time: f64, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError>;

    /// The picture that the skin's camera takes at `time` \[s\] under `stimulus`, in place of [`step`](Self::step), with what the device
    /// remembers; `noise` as for [`ForwardModel::capture`]. `None`, the default, where the model's own picture is the device's, or
    /// there is no camera.
    ///
    /// # Errors
    ///
    /// As [`step`](Self::step).
    fn capture(
        &mut self,
        time: f64,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        let _ = (time, stimulus, noise);
        Ok(None)
    }

    /// Changes noisy readings as the converter does: range, resolution.
    fn quantize(&mut self, readings: &mut [f64]) {
        let _ = readings;
    }
}

/// What lies around a model without memory and remembers. All that is left out is the identity.
pub trait Memory: Send {
    /// As [`DeviceState::apply_to_stimulus`].
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        let _ = (time, stimulus);
    }

    /// Changes the model's response at `time` \[s\] under `stimulus`, in the unit of the skin, as medium and transducers do.
    fn apply_transducer(&mut self, time: f64, stimulus: &Stimulus, readings: &mut [f64]) {
        let _ = (time, stimulus, readings);
    }

    /// As [`DeviceState::quantize`].
    fn quantize(&mut self, readings: &mut [f64]) {
        let _ = readings;
    }
}

/// The state of a model that remembers nothing.
#[derive(Debug, Clone, Copy)]
pub struct Memoryless<'a, M: ?Sized>(&'a M);

impl<'a, M: ForwardModel + ?Sized> Memoryless<'a, M> {
    /// Steps of `model` are its responses.
    #[must_use]
    pub fn new(model: &'a M) -> Self {
        Self(model)
    }
}

impl<M: ForwardModel + ?Sized> DeviceState for Memoryless<'_, M> {
    fn step(&mut self, _: f64, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.0.response(stimulus, out)
    }
}

/// A model without memory, followed by what remembers.
pub struct Stepped<'a, M: ?Sized, S> {
    model: &'a M,
    memory: S,
}

impl<'a, M: ForwardModel + ?Sized, S: Memory> Stepped<'a, M, S> {
    /// Steps of `model` are its responses as `memory` changes them.
    #[must_use]
    pub fn new(model: &'a M, memory: S) -> Self {
        Self { model, memory }
    }
}

impl<M: ForwardModel + ?Sized, S: Memory> DeviceState for Stepped<'_, M, S> {
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        self.memory.apply_to_stimulus(time, stimulus);
    }

    fn step(&mut self, time: f64, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.model.response(stimulus, out)?;
        self.memory.apply_transducer(time, stimulus, out);
        Ok(())
    }

    fn quantize(&mut self, readings: &mut [f64]) {
        self.memory.quantize(readings);
    }
}
