//! Frame → contacts, for every skin whose channels are read together.
//!
//! A frame goes through [`Conditioner`] (channel health, zero, touch), the features and the sessions of the loaded [`Models`],
//! the forward model where a bundle asks for it, and [`Tracker`] (identities that last). [`SkinEstimator`] is all of that in one
//! struct: the same in a node, in evaluation and in comparisons, so that an offline figure is the online figure.

mod condition;
mod contacts;
mod estimator;
pub mod finder;
mod models;
#[cfg(any(test, feature = "test-suite"))]
pub mod testing;

use std::path::PathBuf;

use dermis_inference::{Bundle, Runtime};
use dermis_sensor::{FrameCheck, Sensor};
use dermis_skin::{Estimator, SkinDescription};

pub use condition::{ConditionError, Conditioned, Conditioner, TareRefusal};
pub use contacts::{TaxelShares, Tracker};
pub use estimator::{Maps, Quality, SkinEstimator, Verdict};
pub use finder::{ConditionedFrame, ContactFinder, FindError};
pub use models::{Models, SetupError, UnpackedModel, inverter, is_pictured, settings_without_bundle};

/// What finds faults of a device in whole frames; of the design, whatever effects the description switches on.
///
/// # Errors
///
/// [`SetupError::FrameCheck`] where the skin does not say what that takes.
pub fn frame_check(
    sensor: &dyn Sensor,
    skin: &SkinDescription,
) -> Result<Option<Box<dyn FrameCheck>>, SetupError> {
    sensor.frame_check(skin).map_err(SetupError::FrameCheck)
}

/// Frame → contacts and maps, with these bundles; `masked` names channels to leave out. Force maps are those that a node publishes;
/// displacements are those that a model gives by itself, because a forward model takes far longer for them than for a frame.
///
/// # Errors
///
/// [`SetupError`] names the bundle, output or channel that does not fit.
pub fn estimator(
    sensor: &dyn Sensor,
    skin: &SkinDescription,
    bundles: &[PathBuf],
    masked: &[String],
    runtime: &Runtime,
) -> Result<Box<dyn Estimator>, SetupError> {
    let bundles = bundles.iter().map(|folder| Bundle::load(folder, skin)).collect::<Result<Vec<_>, _>>()?;
    let models = Models::load(sensor, skin, &bundles, runtime)?;
    ready(sensor, skin, masked, models)
}

/// The estimator of a skin that has no bundle: contacts are found on its forward model.
///
/// # Errors
///
/// As [`SkinEstimator::new`] and [`Models::inverted`].
pub fn inverting(
    sensor: &dyn Sensor,
    skin: &SkinDescription,
    masked: &[String],
) -> Result<Box<dyn Estimator>, SetupError> {
    ready(sensor, skin, masked, Models::inverted(sensor, skin)?)
}

/// An estimator with its models and their maps.
fn ready(
    sensor: &dyn Sensor,
    skin: &SkinDescription,
    masked: &[String],
    models: Models,
) -> Result<Box<dyn Estimator>, SetupError> {
    let mut estimator = SkinEstimator::new(skin, masked)?;
    estimator.set_check(frame_check(sensor, skin)?);
    let maps = Maps { force: models.maps().force, displacement: models.own_maps().displacement };
    estimator.set_models(models);
    estimator.want_maps(maps);
    Ok(Box::new(estimator))
}
