//! Strain gauges on the inner side of a shell that is clamped at its ends, as in a robot's limb: a touch bends all of it, so
//! that ten gauges feel the whole.
//!
//! How a frame becomes contacts is in [`dermis_perception`], which [`FAMILY`] is handed to.

use std::sync::Arc;

use dermis_perception::Sensor;
use dermis_skin::{ForwardModel, ModelError, SkinDescription};

/// What a skin description names in `sensor` for this family.
pub const SENSOR: &str = "hapdef";

/// The family, as node and estimator need it.
pub const FAMILY: Sensor = Sensor { name: SENSOR, model };

/// Stimulus → strains.
///
/// # Errors
///
/// [`ModelError::Description`]: nothing is known of the shell.
pub fn model(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    Err(ModelError::Description {
        skin: skin.name.clone(),
        field: "medium".into(),
        reason: "a shell has no forward model; its bundles must do without `inversion`".into(),
    })
}
