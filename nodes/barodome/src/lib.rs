//! Taxels in an elastic medium: barometers under rubber, magnetometers under a magnetised lattice, and every other skin
//! whose channels respond smoothly to where and how hard it is pressed.
//!
//! Here are the forward model and the effects that it leaves out; how a frame becomes contacts is in
//! [`dermis_perception`], which is handed [`FAMILY`].

pub mod effects;
pub mod model;
mod parameters;
pub mod verify;

use std::sync::Arc;

use dermis_model::{Case, ForwardModel};
use dermis_sensor::Sensor;
use dermis_skin::{EffectInfo, Family, ModelError, SkinDescription};

/// What a skin description names in `sensor` for this family.
pub const SENSOR: &str = "barodome";

/// The family.
pub const FAMILY: &dyn Sensor = &Barodome;

#[derive(Debug)]
struct Barodome;

impl Family for Barodome {
    fn name(&self) -> &'static str {
        SENSOR
    }
}

impl Sensor for Barodome {
    fn about(&self) -> &'static str {
        "Reads a skin of taxels in an elastic medium and publishes its contacts"
    }

    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        Ok(Arc::new(model::BarometerModel::new(skin)?))
    }

    fn check_medium(&self, skin: &SkinDescription) -> Result<(), ModelError> {
        skin.check_medium(|| parameters::Parameters::nominal(skin).map(drop))
    }

    fn effects(&self) -> &'static [EffectInfo] {
        effects::EFFECTS
    }

    fn validation_cases(&self) -> Result<Vec<Case>, String> {
        let mut cases = verify::cases().map_err(|error| error.to_string())?;
        if dermis_mechanics::calculix::available() {
            cases.extend(verify::judged().map_err(|error| error.to_string())?);
        }
        Ok(cases)
    }
}

/// Stimulus → channels, for skins whose `medium` says what lies between surface and taxels.
///
/// # Errors
///
/// [`ModelError::Description`] where the medium is unknown, or one that the model does not cover.
pub fn model(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    FAMILY.model(skin)
}
