//! The sensor families that this program knows: one line each.

use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use dermis_model::ForwardModel;
use dermis_sensor::{Registry, Sensor};
use dermis_skin::SkinDescription;
use dermis_studies::Families;

/// All families.
pub const SENSORS: Registry = Registry::new(&[dermis_barodome::FAMILY, dermis_hapdef::FAMILY]);

/// The same, as studies ask for them.
pub const FAMILIES: Families = Families::new(&SENSORS);

/// The forward model of a skin that was read from `path`, effects that every skin can have included; refusals name that file.
pub fn forward(path: &Path, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>> {
    FAMILIES.model_of_file(path, skin)
}

/// The family that reads a skin.
pub fn family(skin: &SkinDescription) -> Result<&'static dyn Sensor> {
    FAMILIES.of(skin)
}
