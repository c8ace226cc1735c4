//! From one conditioned frame to contacts: every way that there is, behind one trait.
//!
//! The node's [`SkinEstimator`](crate::SkinEstimator) makes its contacts with the functions of this module, and so do
//! comparisons: `regressed` for the outputs of models, `peaks` for a map, `solve` and `refined` for a forward
//! model, `spread_forces` for maps. The estimator adds what depends on earlier frames or on several bundles: presence, identities,
//! confidence. [`finder_of`] says which finder reads a bundle.
//!
//! | finder | from | to |
//! |---|---|---|
//! | [`NetworkFinder`] | a bundle that gives position and force | one contact |
//! | [`MapFinder`] | a bundle that gives a map of displacements or forces | the peaks of the map |
//! | [`InversionFinder`] | a forward model | contacts of maximum likelihood |
//! | [`RegressionFinder`] | any function of the whitened readings | one contact |
//!
//! A finder does not judge whether something touches: who asks it for the contacts of an untouched frame gets what the noise
//! looks like to it.

mod before;
mod choice;
mod inversion;
mod map;
mod network;
mod regression;
mod spread;

use dermis_inference::FeatureError;
use dermis_inversion::{InverterError, Reading};
use dermis_skin::{ChannelFlags, Contact, Estimate, ImageGrid, Stamp};

pub(crate) use before::Before;
pub use choice::{finder_of, learned_finder_of};
pub use inversion::{InversionFinder, Start};
pub(crate) use inversion::{Learned, follow, provisional, refined, search, solve};
pub use map::MapFinder;
pub(crate) use map::{Peaks, peaks};
pub use network::NetworkFinder;
pub(crate) use network::{Regressed, is_flat, regressed};
pub use regression::{Regress, RegressionFinder};
pub use spread::GivenMaps;
pub(crate) use spread::{REACH, given_displacements, given_forces, spread_forces};

/// One frame after conditioning.
#[derive(Debug, Clone, Copy)]
pub struct ConditionedFrame<'a> {
    /// When it was measured.
    pub stamp: Stamp,
    /// Readings in the unit of the skin; NaN where a channel has none.
    pub reading: &'a [f32],
    /// The same without the zero.
    pub signal: &'a [f32],
    /// What is wrong with each channel.
    pub flags: &'a [ChannelFlags],
    /// The coarse image that a finder takes ([`ContactFinder::image`]); empty where none is made.
    pub image: &'a [f32],
    /// The same without its zero.
    pub image_signal: &'a [f32],
}

/// Why a finder has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FindError {
    /// A frame does not fit the features of a bundle.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// A model failed, or gave what its bundle does not say; the sentence names the bundle.
    #[error("{0}")]
    Model(String),
    /// The forward model has no answer.
    #[error(transparent)]
    Inversion(#[from] InverterError),
    /// A bundle that looks at several frames has not seen enough of them, or no channel has a reading.
    #[error(
        "model {0}: there is no input for this frame: no channel has a reading, or the model looks at several frames and \
         has not seen enough of them since the last pause or tare"
    )]
    History(String),
    /// A regression failed, or gave another number of values.
    #[error("a regression {0}")]
    Regression(String),
}

/// Finds contacts in frames of one device that come in their order.
pub trait ContactFinder: Send {
    /// The contacts of a frame; empty where there are none.
    ///
    /// # Errors
    ///
    /// [`FindError`] says what failed.
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError>;

    /// Maps that a model gave by itself for the latest frame whose contacts were requested; none by default.
    fn given_maps(&self) -> GivenMaps {
        GivenMaps::default()
    }

    /// The contacts of a frame with their maps, as a node publishes them: those that a model gives by itself or, where it gives no
    /// forces, the forces of contacts that are peaks or that a forward model refined, spread over the surface.
    ///
    /// # Errors
    ///
    /// As [`find`](Self::find).
    fn estimate(&mut self, frame: &ConditionedFrame<'_>) -> Result<Estimate, FindError> {
        let contacts = self.find(frame)?;
        let GivenMaps { force: force_map, displacement: displacement_map } = self.given_maps();
        Ok(Estimate { contacts, force_map, displacement_map })
    }

    /// Takes a frame whose contacts nobody asks for into the history of what looks at several frames.
    ///
    /// # Errors
    ///
    /// [`FindError::Features`] where the frame is of another skin.
    fn pass(&mut self, _frame: &ConditionedFrame<'_>) -> Result<(), FindError> {
        Ok(())
    }

    /// Forgets the frames before: what comes next is another recording, or has another zero.
    fn reset(&mut self) {}

    /// The image that it takes in place of the channels, of a skin with a camera.
    fn image(&self) -> Option<ImageGrid> {
        None
    }

    /// Whether it finds every contact, so that a forward model can be begun at all of them together.
    fn complete(&self) -> bool {
        false
    }

    /// Whether it answers with one contact, whatever touches.
    fn single(&self) -> bool {
        false
    }
}

/// The signal of a frame, as an inverter takes it.
pub(crate) fn readings<'a>(
    signal: &'a [f32],
    flags: &'a [ChannelFlags],
) -> impl Iterator<Item = Reading> + 'a {
    signal.iter().zip(flags).map(|(value, flags)| Reading::of(*value, *flags))
}

#[cfg(test)]
mod tests;
