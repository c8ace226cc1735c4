//! How far a device and its forward model are apart.

use dermis_skin::{ForwardModel, ModelError, Stimulus};

/// Channel gains and what remains beyond the noise, measured on readings of known stimuli.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Reading of the device per reading of the model, one a channel.
    pub gains: Vec<f64>,
    /// Share of a signal by which they still differ (standard deviation).
    pub model_error: f64,
    /// Readings that were used.
    pub frames: usize,
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// Too little was seen.
    #[error("channel {channel} was never pressed hard enough to measure its gain; press over all of the skin")]
    Unseen {
        /// Index of the channel.
        channel: usize,
    },
    /// The model has no answer.
    #[error("frame {frame}: the forward model has no answer: {source}")]
    Model {
        /// Index of the frame.
        frame: usize,
        /// What it says.
        source: ModelError,
    },
}

/// Signals count for gains from this many noise deviations on.
const STRONG: f64 = 5.0;

impl Calibration {
    /// Measures on pairs of a stimulus and what the channels read minus their untouched readings (`NaN`: not known),
    /// in the unit of the skin.
    ///
    /// # Errors
    ///
    /// [`CalibrationError`] names the channel that was never pressed, or the frame that the model does not know.
    pub fn measure<'a>(
        model: &dyn ForwardModel,
        frames: impl Iterator<Item = (&'a Stimulus, &'a [f32])> + Clone,
    ) -> Result<Self, CalibrationError> {
        let channels = model.channels();
        let noise = model.noise();
        let mut rest = vec![0.0; channels];
        let ask = |frame: usize, stimulus: &Stimulus, out: &mut [f64]| {
            model.response(stimulus, out).map_err(|source| CalibrationError::Model { frame, source })
        };
        ask(0, &Stimulus::default(), &mut rest)?;
        let mut out = vec![0.0; channels];
        let (mut products, mut squares) = (vec![0.0; channels], vec![0.0; channels]);
        let mut count = 0;
        for (frame, (stimulus, signal)) in frames.clone().enumerate() {
            ask(frame, stimulus, &mut out)?;
            count += 1;
            for i in 0..channels {
                let (expected, read) = (out[i] - rest[i], f64::from(signal[i]));
                if read.is_finite() && expected.abs() > STRONG * noise[i] {
                    // Errors in proportion to the signal: every strong signal counts the same.
                    products[i] += read / expected;
                    squares[i] += 1.0;
                }
            }
        }
        if let Some(channel) = squares.iter().position(|s| *s < 10.0) {
            return Err(CalibrationError::Unseen { channel });
        }
        let gains: Vec<f64> = products.iter().zip(&squares).map(|(p, s)| p / s).collect();
        // Squared deviation beyond the noise, over the squared signal.
        let (mut beyond, mut signal_square) = (0.0, 0.0);
        for (frame, (stimulus, signal)) in frames.enumerate() {
            ask(frame, stimulus, &mut out)?;
            for i in 0..channels {
                let (expected, read) = ((out[i] - rest[i]) * gains[i], f64::from(signal[i]));
                if read.is_finite() && expected.abs() > STRONG * noise[i] {
                    beyond += (read - expected).powi(2) - noise[i] * noise[i];
                    signal_square += expected * expected;
                }
            }
        }
        let share = if signal_square > 0.0 { (beyond / signal_square).max(0.0).sqrt() } else { 0.0 };
        // Below this, a sample of readings does not tell an error of the model from chance.
        let model_error = if share < 1e-3 { 0.0 } else { share };
        Ok(Self { gains, model_error, frames: count })
    }
}
