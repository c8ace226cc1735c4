//! What a skin's device would read: the model, its noise and the device's range.

use std::sync::Arc;

use dermis_skin::{ChannelFlags, ForwardModel, ModelError, SkinDescription, Stimulus};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::TestbedError;

/// Readings of a modelled skin: response plus Gaussian noise, cut off at the range of each channel.
pub struct Sampler {
    model: Arc<dyn ForwardModel>,
    ranges: Vec<Option<[f64; 2]>>,
    rng: ChaCha8Rng,
    clean: Vec<f64>,
}

impl std::fmt::Debug for Sampler {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Sampler").field("channels", &self.clean.len()).finish_non_exhaustive()
    }
}

impl Sampler {
    /// A sampler whose noise depends on `seed` only.
    ///
    /// # Errors
    ///
    /// [`TestbedError::Channels`] where model and skin don't belong together.
    pub fn new(
        model: Arc<dyn ForwardModel>,
        skin: &SkinDescription,
        seed: u64,
    ) -> Result<Self, TestbedError> {
        let channels = skin.channels().len();
        if model.channels() != channels || model.noise().len() != channels {
            return Err(TestbedError::Channels {
                model: model.channels(),
                skin: skin.name.clone(),
                channels,
            });
        }
        Ok(Self {
            model,
            ranges: skin.channels().iter().map(|c| c.range).collect(),
            rng: ChaCha8Rng::seed_from_u64(seed),
            clean: vec![0.0; channels],
        })
    }

    /// One reading of every channel, in the unit of the skin, with the flag of those that are saturated.
    ///
    /// # Errors
    ///
    /// What the model says of the stimulus.
    pub fn sample(
        &mut self,
        stimulus: &Stimulus,
        values: &mut Vec<f32>,
        flags: &mut Vec<ChannelFlags>,
    ) -> Result<(), ModelError> {
        self.model.response(stimulus, &mut self.clean)?;
        values.clear();
        flags.clear();
        for ((clean, sigma), range) in self.clean.iter().zip(self.model.noise()).zip(&self.ranges) {
            let noise: f64 = self.rng.sample(StandardNormal);
            let value = clean + sigma * noise;
            let cut = range.map_or(value, |[low, high]| value.clamp(low, high));
            let saturated = range.is_some_and(|[low, high]| cut <= low || cut >= high);
            values.push(cut as f32);
            flags.push(if saturated { ChannelFlags::SATURATED } else { ChannelFlags::OK });
        }
        Ok(())
    }
}
