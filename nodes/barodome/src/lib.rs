//! Node for taxels in an elastic medium: barometers under rubber, magnetometers under a magnetised lattice, and every
//! other skin whose channels respond smoothly to where and how hard it is pressed.
//!
//! A frame goes one way: bytes → [`FrameReader`] (wire, unit, time of acquisition) → [`Conditioner`] (channel health,
//! zero, touch) → [`BarodomeEstimator`] (learned models, contacts, identities) → [`messages`] → bus. The estimator is
//! the same struct in the node and in offline evaluation.
//!
//! The program registers the sensor with what is on the top level here: [`SENSOR`], [`estimator`], [`model()`] and
//! [`run`].

pub mod cli;
mod condition;
mod config;
mod contacts;
pub mod effects;
mod estimator;
mod frame;
pub mod messages;
pub mod model;
mod node;
mod parameters;
#[cfg(test)]
mod testing;
pub mod verify;

use std::path::PathBuf;
use std::sync::Arc;

use dermis_inference::{Bundle, Runtime};
use dermis_skin::{Estimator, ForwardModel, ModelError, SkinDescription};

pub use crate::config::{Config, ConfigError};
pub use condition::{ConditionError, Conditioned, Conditioner, TareRefusal};
pub use contacts::{TaxelShares, Tracker};
pub use estimator::{BarodomeEstimator, Models, Quality, SetupError, Verdict};
pub use frame::FrameReader;
pub use node::{BarodomeNode, RunError, check, run};

/// What a skin description names in `sensor` for this family.
pub const SENSOR: &str = "barodome";

/// Frame → contacts with these model bundles; `masked` names channels to leave out.
///
/// # Errors
///
/// [`SetupError`] names the bundle, output or channel that does not fit.
pub fn estimator(
    skin: &SkinDescription,
    bundles: &[PathBuf],
    masked: &[String],
    runtime: &Runtime,
) -> Result<Box<dyn Estimator>, SetupError> {
    let bundles = bundles.iter().map(|folder| Bundle::load(folder, skin)).collect::<Result<Vec<_>, _>>()?;
    let mut estimator = BarodomeEstimator::new(skin, masked)?;
    estimator.set_models(Models::load(skin, &bundles, runtime)?);
    Ok(Box::new(estimator))
}

/// Stimulus → channels, for skins whose `medium` says what lies between surface and taxels.
///
/// # Errors
///
/// [`ModelError::Description`] where the medium is unknown, or one that the model does not cover.
pub fn model(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    Ok(Arc::new(model::BarometerModel::new(skin)?))
}
