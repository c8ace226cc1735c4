//! Strain gauges on the inner side of a shell that is clamped at its ends, as in a robot's limb: a touch bends all of it, so
//! that ten gauges feel the whole.
//!
//! How a frame becomes contacts is in [`dermis_perception`], which is handed [`FAMILY`].

mod candidates;
pub mod effects;
pub mod model;
mod parameters;
pub mod verify;

use std::sync::Arc;

pub use candidates::candidates;
use dermis_model::{Case, ForwardModel};
use dermis_sensor::Sensor;
use dermis_skin::{EffectInfo, Family, ModelError, Rated, SkinDescription, Taxel, TipKind};

/// What a skin description names in `sensor` for this family.
pub const SENSOR: &str = "hapdef";

/// The family.
pub const FAMILY: &dyn Sensor = &Hapdef;

#[derive(Debug)]
struct Hapdef;

impl Family for Hapdef {
    /// A ball of 10 mm, as the rigs of chapters 2 and 3 of the thesis press a limb, up to what its stage reaches.
    fn rated(&self, _: &SkinDescription) -> Rated {
        Rated { force: [1.0, 34.0], diameter: 0.01, tip: TipKind::Sphere }
    }

    fn name(&self) -> &'static str {
        SENSOR
    }
}

impl Sensor for Hapdef {
    fn about(&self) -> &'static str {
        "Reads the strain gauges of a shell and publishes its contacts"
    }

    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        Ok(Arc::new(model::ShellModel::new(skin)?))
    }

    fn check_medium(&self, skin: &SkinDescription) -> Result<(), ModelError> {
        skin.check_medium(|| parameters::Parameters::nominal(skin).map(drop))
    }

    fn effects(&self) -> &'static [EffectInfo] {
        effects::EFFECTS
    }

    fn candidates(&self, skin: &SkinDescription) -> Result<Vec<Taxel>, ModelError> {
        candidates(skin)
    }

    fn validation_cases(&self) -> Result<Vec<Case>, String> {
        let mut cases = verify::cases().map_err(|error| error.to_string())?;
        if dermis_mechanics::calculix::available() {
            cases.extend(verify::judged().map_err(|error| error.to_string())?);
        }
        Ok(cases)
    }
}

/// Stimulus → strains, for skins whose `medium` says what the shell is made of.
///
/// # Errors
///
/// [`ModelError::Description`] where the shell, or one of its gauges, cannot be.
pub fn model(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    FAMILY.model(skin)
}
