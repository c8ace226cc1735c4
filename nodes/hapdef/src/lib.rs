//! Strain gauges on the inner side of a shell that is clamped at its ends, as in a robot's limb: a touch bends all of it, so
//! that ten gauges feel the whole.
//!
//! How a frame becomes contacts is in [`dermis_perception`], which [`FAMILY`] is handed to.

mod candidates;
pub mod effects;
pub mod model;
mod parameters;
pub mod verify;

use std::sync::Arc;

pub use candidates::candidates;
use dermis_model::ForwardModel;
use dermis_perception::Sensor;
use dermis_skin::{ModelError, SkinDescription};

/// What a skin description names in `sensor` for this family.
pub const SENSOR: &str = "hapdef";

/// The family, as node and estimator need it.
pub const FAMILY: Sensor = Sensor { name: SENSOR, model, medium };

/// Stimulus → strains, for skins whose `medium` says what the shell is made of.
///
/// # Errors
///
/// [`ModelError::Description`] where the shell, or one of its gauges, cannot be.
pub fn model(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    dermis_model::device(skin, |inner| Ok(Arc::new(model::ShellModel::new(inner)?)))
}

/// What is wrong with the table `medium` of a skin that has one; nothing is computed.
///
/// # Errors
///
/// [`ModelError::Description`] names the field.
pub fn medium(skin: &SkinDescription) -> Result<(), ModelError> {
    skin.check_medium(|| parameters::Parameters::nominal(skin).map(drop))
}
