//! What a model reads where nothing touches.

use dermis_skin::ModelError;

use crate::ForwardModel;

/// The untouched readings of a model, computed once: a signal is a reading minus these.
///
/// Where all of them are 0, as for skins whose readings are signals already, nothing is subtracted, so that signals are readings
/// bit for bit.
#[derive(Debug, Clone, PartialEq)]
pub struct Untouched {
    readings: Vec<f64>,
    zero: bool,
}

impl Untouched {
    /// Asks a model; costs one response at most.
    ///
    /// # Errors
    ///
    /// [`ModelError::Stimulus`] where the model has no answer.
    pub fn of<M: ForwardModel + ?Sized>(model: &M) -> Result<Self, ModelError> {
        let mut readings = vec![0.0; model.channels()];
        model.untouched(&mut readings)?;
        Ok(Self::from(readings))
    }

    /// One number a channel, in the unit of the skin description.
    #[must_use]
    pub fn readings(&self) -> &[f64] {
        &self.readings
    }

    /// Whether all of them are 0, so that readings are signals.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        self.zero
    }

    /// Makes signals of readings, channel after channel, of one frame or of many.
    pub fn subtract(&self, readings: &mut [f64]) {
        if self.zero {
            return;
        }
        for frame in readings.chunks_exact_mut(self.readings.len()) {
            frame.iter_mut().zip(&self.readings).for_each(|(reading, untouched)| *reading -= untouched);
        }
    }
}

impl From<Vec<f64>> for Untouched {
    fn from(readings: Vec<f64>) -> Self {
        Self { zero: readings.iter().all(|r| *r == 0.0), readings }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::suite::Probe;

    #[test]
    fn a_model_is_asked_for_its_untouched_readings() {
        // The probe says others than its response to nothing.
        let untouched = Untouched::of(&Probe::default()).unwrap();
        assert_eq!(untouched.readings(), [17.0, 19.0]);
        assert!(!untouched.is_zero());
        let mut frames = [20.0, 20.0, 17.0, f64::NAN];
        untouched.subtract(&mut frames);
        assert_eq!(frames[..3], [3.0, 1.0, 0.0]);
        assert!(frames[3].is_nan());
    }

    #[test]
    fn where_nothing_is_read_signals_are_readings_bit_for_bit() {
        let untouched = Untouched::from(vec![0.0, -0.0]);
        assert!(untouched.is_zero());
        let mut frames = [-0.0, 1e-300];
        untouched.subtract(&mut frames);
        assert_eq!(frames.map(f64::to_bits), [-0.0f64, 1e-300].map(f64::to_bits));
    }
}
