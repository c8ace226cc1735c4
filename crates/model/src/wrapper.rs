//! Models around other models.
//!
//! What a wrapper does not say differently, the model in it says: [`Wrapper`] forwards every method, and the lint on its one
//! implementation of [`ForwardModel`] refuses a method of that trait that is not forwarded.

use dermis_skin::{Image, ModelError, Surface};
use nalgebra::Point3;

use crate::{DeviceState, Differences, ForwardModel, Stimulus, TipShape, Unknowns};

/// A model around another one. Every method but [`inner`](Self::inner) is that of [`ForwardModel`], and asks the inner model
/// where a wrapper does not say otherwise.
///
/// One that changes [`response`](Self::response) must answer for untouched readings, for many responses, for derivatives and for
/// [`start`](Self::start) as well: [`CHANGES_RESPONSE`](Self::CHANGES_RESPONSE) makes the first three follow.
pub trait Wrapper: Send + Sync {
    /// Whether [`response`](Self::response) is another than that of the inner model.
    const CHANGES_RESPONSE: bool;

    /// The model within.
    fn inner(&self) -> &dyn ForwardModel;

    /// As [`ForwardModel::channels`].
    fn channels(&self) -> usize {
        self.inner().channels()
    }

    /// As [`ForwardModel::surface`].
    fn surface(&self) -> &Surface {
        self.inner().surface()
    }

    /// As [`ForwardModel::response`].
    ///
    /// # Errors
    ///
    /// What the inner model says.
    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.inner().response(stimulus, out)
    }

    /// As [`ForwardModel::superposes`].
    fn superposes(&self) -> bool {
        self.inner().superposes()
    }

    /// As [`ForwardModel::noise`].
    fn noise(&self) -> &[f64] {
        self.inner().noise()
    }

    /// As [`ForwardModel::displacement`].
    ///
    /// # Errors
    ///
    /// What the inner model says.
    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        self.inner().displacement(stimulus, out)
    }

    /// As [`ForwardModel::capture`].
    ///
    /// # Errors
    ///
    /// What the inner model says.
    fn capture(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        self.inner().capture(stimulus, noise)
    }

    /// As [`ForwardModel::observe`].
    fn observe(&self, image: &Image, out: &mut [f64]) -> bool {
        self.inner().observe(image, out)
    }

    /// As [`ForwardModel::remembers`].
    fn remembers(&self) -> bool {
        self.inner().remembers()
    }

    /// As [`ForwardModel::start`].
    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        self.inner().start(seed)
    }

    /// As [`ForwardModel::force_at`].
    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        self.inner().force_at(at, diameter, depth)
    }

    /// As [`ForwardModel::depth_at`].
    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        self.inner().depth_at(at, diameter, force)
    }

    /// As [`ForwardModel::force_of_tip`]; of spheres as [`force_at`](Self::force_at).
    fn force_of_tip(&self, at: &Point3<f64>, tip: &TipShape, depth: f64) -> Option<f64> {
        match tip {
            TipShape::Sphere { diameter } => Wrapper::force_at(self, at, *diameter, depth),
            _ => self.inner().force_of_tip(at, tip, depth),
        }
    }

    /// As [`ForwardModel::depth_of_tip`]; of spheres as [`depth_at`](Self::depth_at).
    fn depth_of_tip(&self, at: &Point3<f64>, tip: &TipShape, force: f64) -> Option<f64> {
        match tip {
            TipShape::Sphere { diameter } => Wrapper::depth_at(self, at, *diameter, force),
            _ => self.inner().depth_of_tip(at, tip, force),
        }
    }
}

#[deny(clippy::missing_trait_methods)]
impl<W: Wrapper> ForwardModel for W {
    fn channels(&self) -> usize {
        Wrapper::channels(self)
    }

    fn surface(&self) -> &Surface {
        Wrapper::surface(self)
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        Wrapper::response(self, stimulus, out)
    }

    fn untouched(&self, out: &mut [f64]) -> Result<(), ModelError> {
        if W::CHANGES_RESPONSE {
            Wrapper::response(self, &Stimulus::default(), out)
        } else {
            self.inner().untouched(out)
        }
    }

    fn responses(&self, stimuli: &[Stimulus], out: &mut [f64]) -> Result<(), ModelError> {
        if !W::CHANGES_RESPONSE {
            return self.inner().responses(stimuli, out);
        }
        let channels = Wrapper::channels(self).max(1);
        let rows = stimuli.iter().zip(out.chunks_exact_mut(channels));
        rows.into_iter().try_for_each(|(stimulus, out)| Wrapper::response(self, stimulus, out))
    }

    fn jacobian(
        &self,
        stimulus: &Stimulus,
        unknowns: Unknowns,
        differences: &Differences,
        out: &mut [f64],
    ) -> Result<(), ModelError> {
        if W::CHANGES_RESPONSE {
            differences.jacobian(self, stimulus, unknowns, out)
        } else {
            self.inner().jacobian(stimulus, unknowns, differences, out)
        }
    }

    fn superposes(&self) -> bool {
        Wrapper::superposes(self)
    }

    fn noise(&self) -> &[f64] {
        Wrapper::noise(self)
    }

    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        Wrapper::displacement(self, stimulus, out)
    }

    fn capture(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        Wrapper::capture(self, stimulus, noise)
    }

    fn observe(&self, image: &Image, out: &mut [f64]) -> bool {
        Wrapper::observe(self, image, out)
    }

    fn remembers(&self) -> bool {
        Wrapper::remembers(self)
    }

    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        Wrapper::start(self, seed)
    }

    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        Wrapper::force_at(self, at, diameter, depth)
    }

    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        Wrapper::depth_at(self, at, diameter, force)
    }

    fn force_of_tip(&self, at: &Point3<f64>, tip: &TipShape, depth: f64) -> Option<f64> {
        Wrapper::force_of_tip(self, at, tip, depth)
    }

    fn depth_of_tip(&self, at: &Point3<f64>, tip: &TipShape, force: f64) -> Option<f64> {
        Wrapper::depth_of_tip(self, at, tip, force)
    }
}

/// A model with another noise.
pub struct WithNoise<'a> {
    model: &'a dyn ForwardModel,
    noise: Vec<f64>,
}

impl std::fmt::Debug for WithNoise<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WithNoise").field("noise", &self.noise).finish_non_exhaustive()
    }
}

impl<'a> WithNoise<'a> {
    /// `model` with the standard deviations `noise`, one a channel.
    #[must_use]
    pub fn new(model: &'a dyn ForwardModel, noise: Vec<f64>) -> Self {
        assert_eq!(model.channels(), noise.len());
        Self { model, noise }
    }

    /// Standard deviation of each channel's noise, to be changed.
    pub fn noise_mut(&mut self) -> &mut [f64] {
        &mut self.noise
    }
}

impl Wrapper for WithNoise<'_> {
    const CHANGES_RESPONSE: bool = false;

    fn inner(&self) -> &dyn ForwardModel {
        self.model
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}
