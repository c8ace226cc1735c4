//! Taxels in an elastic medium: barometers under rubber, magnetometers under a magnetised lattice, and every other skin
//! whose channels respond smoothly to where and how hard it is pressed.
//!
//! Here are the forward model and the effects that it leaves out; how a frame becomes contacts is in
//! [`dermis_perception`], which [`FAMILY`] is handed to.

pub mod effects;
pub mod model;
mod parameters;
pub mod verify;

use std::sync::Arc;

use dermis_model::ForwardModel;
use dermis_perception::Sensor;
use dermis_skin::{ModelError, SkinDescription};

/// What a skin description names in `sensor` for this family.
pub const SENSOR: &str = "barodome";

/// The family, as node and estimator need it.
pub const FAMILY: Sensor = Sensor { name: SENSOR, model, medium };

/// Stimulus → channels, for skins whose `medium` says what lies between surface and taxels.
///
/// # Errors
///
/// [`ModelError::Description`] where the medium is unknown, or one that the model does not cover.
pub fn model(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    dermis_model::device(skin, |inner| Ok(Arc::new(model::BarometerModel::new(inner)?)))
}

/// What is wrong with the table `medium` of a skin that has one; nothing is computed.
///
/// # Errors
///
/// [`ModelError::Description`] names the field.
pub fn medium(skin: &SkinDescription) -> Result<(), ModelError> {
    skin.check_medium(|| parameters::Parameters::nominal(skin).map(drop))
}
