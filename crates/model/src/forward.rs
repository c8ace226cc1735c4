//! Stimulus → channels.

use dermis_skin::{Image, ModelError, Surface};
use nalgebra::Point3;

use crate::{DeviceState, Differences, Memoryless, Stimulus, TipShape, Unknowns};

/// What would the channels read for this stimulus? The one model behind data, bounds, training and diagnosis.
///
/// A model without memory answers with [`response`](Self::response) alone. One that remembers is started and stepped:
/// [`start`](Self::start) switches a device on, and each [`DeviceState::step`] is a frame.
///
/// # Readings and signals
///
/// A model answers what the channels read, as the device sends it. Voltages of an untouched skin need not be 0. What a skin
/// publishes as its signal is a reading minus its zero, the reading of the untouched skin. So whoever compares a model with
/// signals subtracts the model's own untouched readings, with [`Untouched`](crate::Untouched): inversion, bounds, isolines and
/// placement work on signals, and so does the diagnosis of a recording that was tared. A diagnosis of readings as they were
/// recorded compares readings with readings. Derivatives are the same either way.
pub trait ForwardModel: Send + Sync {
    /// Number of channels.
    fn channels(&self) -> usize;

    /// Surface that stimuli lie on.
    fn surface(&self) -> &Surface;

    /// Noise-free readings of a device that remembers nothing, one a channel, in the unit of the skin description, written to
    /// `out` (`out.len()` must be [`channels`](Self::channels)).
    ///
    /// # Errors
    ///
    /// [`ModelError::Stimulus`] where a contact lies off the surface or is not a number.
    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError>;

    /// What the channels read where nothing touches, at the temperature and pressure of [`Stimulus::default`]; written to `out` (one
    /// a channel, in the unit of the skin description). All 0 for many skins, whose readings are signals already.
    ///
    /// The default asks [`response`](Self::response). A model that knows these readings may say them without computing anything,
    /// but must say the same.
    ///
    /// # Errors
    ///
    /// As [`response`](Self::response).
    fn untouched(&self, out: &mut [f64]) -> Result<(), ModelError> {
        self.response(&Stimulus::default(), out)
    }

    /// [`response`](Self::response) to many stimuli, one after another in `out`
    /// (`out.len()` must be their number times [`channels`](Self::channels)).
    ///
    /// # Errors
    ///
    /// As [`response`](Self::response), for the first stimulus that has no answer.
    fn responses(&self, stimuli: &[Stimulus], out: &mut [f64]) -> Result<(), ModelError> {
        let channels = self.channels();
        assert_eq!(out.len(), stimuli.len() * channels);
        stimuli.iter().zip(out.chunks_exact_mut(channels.max(1))).try_for_each(|(s, o)| self.response(s, o))
    }

    /// Derivatives of [`response`](Self::response) by every unknown of every contact: a column of
    /// [`channels`](Self::channels) numbers for each unknown, contact by contact, in the unit of the skin per metre or newton,
    /// written to `out`. A column is 0 where the surface or the range of forces leaves no room to move.
    ///
    /// The default takes central differences with the steps of `differences`: two responses a column. A model that knows its
    /// derivatives may ignore the steps, but not how forces turn with the surface.
    ///
    /// # Errors
    ///
    /// As [`response`](Self::response), for stimuli near this one.
    fn jacobian(
        &self,
        stimulus: &Stimulus,
        unknowns: Unknowns,
        differences: &Differences,
        out: &mut [f64],
    ) -> Result<(), ModelError> {
        differences.jacobian(self, stimulus, unknowns, out)
    }

    /// Whether the signals of several contacts (readings minus [untouched](Self::untouched) ones) are those of each alone, added
    /// up: exactly, or nearly enough to make training data of recorded presses. `false` for a skin whose contacts change each
    /// other's readings: then a sum of single responses is no answer, and may only be the start of a search that is refined on
    /// [`response`](Self::response) to all contacts at once.
    fn superposes(&self) -> bool {
        true
    }

    /// Standard deviation of each channel's noise, in the unit of the skin description.
    fn noise(&self) -> &[f64];

    /// How far every point of [`surface`](Self::surface) gives way \[m\], inwards along its normal, written to `out`
    /// (one a point). `false`, and `out` as it was, where the model knows no displacements.
    ///
    /// # Errors
    ///
    /// As [`response`](Self::response).
    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        let _ = (stimulus, out);
        Ok(false)
    }

    /// The picture that the skin's camera takes of `stimulus`, with the noise of its pixels made of `noise`, which gives standard
    /// normal numbers; `None` where the skin has no camera. [`response`](Self::response) is what [`observe`](Self::observe) makes
    /// of such a picture without noise.
    ///
    /// # Errors
    ///
    /// As [`response`](Self::response).
    fn capture(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        let _ = (stimulus, noise);
        Ok(None)
    }

    /// The numbers of a frame that are made of a picture, one a channel, written to `out`. `false`, and `out` of no use, where
    /// the picture is not one of this skin.
    fn observe(&self, image: &Image, out: &mut [f64]) -> bool {
        let _ = (image, out);
        false
    }

    /// Whether steps of [`start`](Self::start) depend on the frames before them by design: a foam that creeps, say. The diagnosis
    /// steps such a model through every frame of a recording, and any other only through the frames that it compares. Effects that
    /// remember need no answer here: [`EffectInfo::stateful`](dermis_skin::EffectInfo::stateful) gives it.
    fn remembers(&self) -> bool {
        false
    }

    /// Switches a device on that has never been touched. `seed` tells one time that it is switched on from another: what
    /// drifts draws from it. 0 is the one that effects with their own seeds describe.
    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        let _ = seed;
        Box::new(Memoryless::new(self))
    }

    /// \[N\] that press a spherical tip of `diameter` \[m\] in by `depth` \[m\] at the point `at` of the surface; `None` where
    /// the model does not know, or where no force does.
    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        let _ = (at, diameter, depth);
        None
    }

    /// \[m\] that a spherical tip of `diameter` \[m\] sinks in at the point `at` of the surface when it presses with `force`
    /// \[N\]: the inverse of [`force_at`](Self::force_at).
    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        let _ = (at, diameter, force);
        None
    }

    /// As [`force_at`](Self::force_at), for a tip of any shape that stands straight on the surface. The default knows spheres only.
    fn force_of_tip(&self, at: &Point3<f64>, tip: &TipShape, depth: f64) -> Option<f64> {
        match tip {
            TipShape::Sphere { diameter } => self.force_at(at, *diameter, depth),
            _ => None,
        }
    }

    /// As [`depth_at`](Self::depth_at), for a tip of any shape that stands straight on the surface: the inverse of
    /// [`force_of_tip`](Self::force_of_tip). The default knows spheres only.
    fn depth_of_tip(&self, at: &Point3<f64>, tip: &TipShape, force: f64) -> Option<f64> {
        match tip {
            TipShape::Sphere { diameter } => self.depth_at(at, *diameter, force),
            _ => None,
        }
    }
}
