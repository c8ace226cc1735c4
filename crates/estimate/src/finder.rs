//! From one conditioned frame to contacts: every way that there is, behind one trait.
//!
//! The node's [`SkinEstimator`](crate::SkinEstimator) makes its contacts with the functions here ([`regressed`], [`inverted`],
//! [`readings`]), and so do comparisons. The finders put the same parts together for one frame by itself.
//!
//! | finder | from | to |
//! |---|---|---|
//! | [`NetworkFinder`] | a bundle that gives position and force | one contact |
//! | [`MapFinder`] | a bundle that gives a displacement map | the peaks of the map |
//! | [`InversionFinder`] | a forward model | contacts of maximum likelihood |
//! | [`RegressionFinder`] | any function of the whitened readings | one contact |

mod inversion;
mod map;
mod network;
mod regression;

use dermis_inference::{BundleError, FeatureError, ModelError, OutputError};
use dermis_inversion::{InverterError, Reading};
use dermis_skin::{ChannelFlags, Contact, Stamp};

pub use inversion::{InversionFinder, Start, inverted};
pub use map::MapFinder;
pub(crate) use network::is_flat;
pub use network::{NetworkFinder, Regressed, regressed};
pub use regression::{Regress, RegressionFinder};

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
}

/// Why a finder has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FindError {
    /// A bundle cannot be used.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// A frame does not fit the features of a bundle.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// A model failed.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// What a model gave is not what its bundle says.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The forward model has no answer.
    #[error(transparent)]
    Inversion(#[from] InverterError),
    /// A bundle that looks at several frames was asked about one.
    #[error("the bundle wants a history of frames, where this looks at one frame by itself")]
    History,
    /// A bundle without a displacement map.
    #[error("model bundle {0}: bundle.toml has no `[peaks]`: train one with `dermis real2sim train`")]
    NoPeaks(String),
    /// A regression failed, or gave another number of values.
    #[error("a regression {0}")]
    Regression(String),
}

/// Finds contacts in one frame, without what earlier frames said.
pub trait ContactFinder: Send {
    /// The contacts of a frame.
    ///
    /// # Errors
    ///
    /// [`FindError`] says what failed.
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError>;

    /// Whether it answers with one contact, whatever touches.
    fn single(&self) -> bool {
        false
    }
}

/// The signal of a frame, as an inverter takes it.
pub fn readings<'a>(signal: &'a [f32], flags: &'a [ChannelFlags]) -> impl Iterator<Item = Reading> + 'a {
    signal.iter().zip(flags).map(|(value, flags)| Reading::of(*value, *flags))
}
