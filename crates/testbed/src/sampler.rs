//! What a skin's device would read: the model, its effects, its noise and the device's range.

use dermis_model::{DeviceState, ForwardModel, Stage, Stimulus, common_effect};
use dermis_skin::{ChannelFlags, Frame, ModelError, SkinDescription};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::TestbedError;

/// Readings of a modelled skin, frame after frame from when it was switched on: the steps of the model plus
/// Gaussian noise, quantized, and cut off at the range of each channel.
pub struct Sampler<'a> {
    model: &'a dyn ForwardModel,
    state: Box<dyn DeviceState + 'a>,
    ranges: Vec<Option<[f64; 2]>>,
    rng: ChaCha8Rng,
    clean: Vec<f64>,
}

impl std::fmt::Debug for Sampler<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Sampler").field("channels", &self.clean.len()).finish_non_exhaustive()
    }
}

impl<'a> Sampler<'a> {
    /// A sampler whose noise depends on `seed` only.
    ///
    /// # Errors
    ///
    /// [`TestbedError::Channels`] where model and skin don't belong together; [`TestbedError::Simulated`] names an effect on channels
    /// where the skin is read by a camera, whose numbers are made of the image.
    pub fn new(model: &'a dyn ForwardModel, skin: &SkinDescription, seed: u64) -> Result<Self, TestbedError> {
        let channels = skin.channels().len();
        if model.channels() != channels || model.noise().len() != channels {
            return Err(TestbedError::Channels {
                model: model.channels(),
                skin: skin.name.clone(),
                channels,
            });
        }
        let on_channels = skin.effects.iter().position(|e| {
            common_effect(&e.name).is_some_and(|c| c.stage != Stage::Rig && c.stage != Stage::Medium)
        });
        if let Some(i) = on_channels
            && model.capture(&Stimulus::default(), &mut || 0.0)?.is_some()
        {
            return Err(TestbedError::Simulated(ModelError::Description {
                skin: skin.name.clone(),
                field: format!("effects[{i}]"),
                reason: format!(
                    "`{}` acts on channels, and the numbers of this skin are made of what its camera sees; name an effect of \
                     the rig or of its family",
                    skin.effects[i].name
                ),
            }));
        }
        Ok(Self {
            state: model.start(0),
            model,
            ranges: skin.channels().iter().map(|c| c.range).collect(),
            rng: ChaCha8Rng::seed_from_u64(seed),
            clean: vec![0.0; channels],
        })
    }

    /// Lets the model make ready for a stimulus, which it may do when it meets one of its kind for the first time.
    ///
    /// # Errors
    ///
    /// What the model says of the stimulus.
    pub fn warm_up(&mut self, stimulus: &Stimulus) -> Result<(), ModelError> {
        self.model.response(stimulus, &mut self.clean)
    }

    /// One reading of every channel at `time` \[s\], in the unit of the skin, with the flag of those that are saturated, written
    /// into `frame`; with a picture where the skin is read by a camera, whose numbers are then the readings. What is left in
    /// `stimulus` is what really touched. Times rise from call to call.
    ///
    /// # Errors
    ///
    /// What the model says of the stimulus.
    pub fn sample(
        &mut self,
        time: f64,
        stimulus: &mut Stimulus,
        frame: &mut Frame,
    ) -> Result<(), ModelError> {
        self.state.apply_to_stimulus(time, stimulus);
        let rng = &mut self.rng;
        let mut noise = || rng.sample(StandardNormal);
        frame.image = match self.state.capture(time, stimulus, &mut noise)? {
            Some(image) => Some(image),
            None => self.model.capture(stimulus, &mut noise)?,
        };
        let seen = frame.image.as_ref().is_some_and(|image| self.model.observe(image, &mut self.clean));
        if !seen {
            self.state.step(time, stimulus, &mut self.clean)?;
            for (value, sigma) in self.clean.iter_mut().zip(self.model.noise()) {
                *value += sigma * self.rng.sample::<f64, _>(StandardNormal);
            }
        }
        self.state.quantize(&mut self.clean);
        let Frame { values, flags, .. } = frame;
        values.clear();
        flags.clear();
        for (value, range) in self.clean.iter().zip(&self.ranges) {
            let cut = range.map_or(*value, |[low, high]| value.clamp(low, high));
            let saturated = range.is_some_and(|[low, high]| cut <= low || cut >= high);
            values.push(cut as f32);
            flags.push(if saturated { ChannelFlags::SATURATED } else { ChannelFlags::OK });
        }
        Ok(())
    }
}
