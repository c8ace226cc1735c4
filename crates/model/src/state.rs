//! What a simulated device remembers from frame to frame.

use crate::Stimulus;

/// A walk through time of one simulated device: what its effects remember. Called in the order of time, once a frame:
/// [`touch`](Self::touch), the model's response, [`transduce`](Self::transduce), the noise, [`convert`](Self::convert).
/// Another device, or the same one switched on again, is another trajectory.
pub trait Trajectory: Send {
    /// Changes what touches the skin at `time` \[s\]: friction drags at a tip that slides, say. What is left in `stimulus`
    /// is what really happens, and what a force cell at the indenter measures. It depends on the call before this one at
    /// most, so that the truth of an instant can be had without the way that led there.
    fn touch(&mut self, time: f64, stimulus: &mut Stimulus) {
        let _ = (time, stimulus);
    }

    /// Changes the noise-free readings at `time` \[s\] under `stimulus`, in the unit of the skin.
    fn transduce(&mut self, time: f64, stimulus: &Stimulus, readings: &mut [f64]) {
        let _ = (time, stimulus, readings);
    }

    /// Changes noisy readings as the electronics do: range, resolution.
    fn convert(&mut self, readings: &mut [f64]) {
        let _ = readings;
    }
}

/// Nothing is remembered, nothing is changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Memoryless;

impl Trajectory for Memoryless {}
