//! Conductive fabric over foam, read by electrical resistance tomography: one electrode of the lower sheet after the other is fed
//! while all are read, and a press lets current through the foam to the upper sheet.
//!
//! How a frame becomes contacts is in [`dermis_perception`], which is handed [`FAMILY`].

pub mod check;
pub mod effects;
pub mod electronics;
pub mod foam;
pub mod memory;
pub mod model;
pub mod panel;
pub mod parameters;
pub mod sheet;
pub mod verify;

use std::sync::Arc;

use dermis_model::{Case, ForwardModel};
use dermis_sensor::{FrameCheck, Sensor};
use dermis_skin::{EffectInfo, Family, FieldFault, ModelError, Rated, SkinDescription, TipKind};

/// What a skin description names in `sensor` for this family.
pub const SENSOR: &str = "ert";

/// The family.
pub const FAMILY: &dyn Sensor = &Ert;

#[derive(Debug)]
struct Ert;

impl Family for Ert {
    fn name(&self) -> &'static str {
        SENSOR
    }

    fn complete(&self, skin: &mut SkinDescription) -> Result<(), FieldFault> {
        parameters::complete(skin)
    }

    /// As chapter 4 of the thesis presses its panel.
    fn rated(&self, _: &SkinDescription) -> Rated {
        Rated { force: [5.0, 40.0], diameter: 0.02, tip: TipKind::FlatPunch }
    }
}

impl Sensor for Ert {
    fn about(&self) -> &'static str {
        "Reads a panel of conductive fabric and publishes its contacts"
    }

    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        Ok(Arc::new(model::FabricModel::new(skin)?))
    }

    fn check_medium(&self, skin: &SkinDescription) -> Result<(), ModelError> {
        skin.check_medium(|| parameters::Parameters::nominal(skin).map(drop))
    }

    fn frame_check(&self, skin: &SkinDescription) -> Result<Option<Box<dyn FrameCheck>>, ModelError> {
        if skin.medium.is_empty() {
            return Ok(None);
        }
        Ok(Some(Box::new(check::ElectrodeCheck::new(skin)?)))
    }

    fn effects(&self) -> &'static [EffectInfo] {
        effects::EFFECTS
    }

    fn validation_cases(&self) -> Result<Vec<Case>, String> {
        verify::cases().map_err(|error| error.to_string())
    }
}

/// Stimulus → voltages, for skins whose `medium` says what the panel is made of.
///
/// # Errors
///
/// [`ModelError::Description`] where the panel, or one of its electrodes, cannot be.
pub fn model(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    FAMILY.model(skin)
}
