//! The sensor families that this program knows.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use anyhow::Result;
use dermis_model::ForwardModel;
use dermis_sensor::{Registry, Sensor};
use dermis_skin::SkinDescription;
use dermis_studies::Families;

/// The families that ship, one line each.
pub static SHIPPED: Registry = Registry::new(&[
    dermis_barodome::FAMILY,
    dermis_hapdef::FAMILY,
    dermis_ert::FAMILY,
    dermis_insight::FAMILY,
]);

static CHOSEN: OnceLock<&'static Registry> = OnceLock::new();

/// Makes these the families of the program; the first call counts.
pub fn choose(sensors: &'static Registry) {
    CHOSEN.get_or_init(|| sensors).install();
}

/// The families of the program.
pub fn sensors() -> &'static Registry {
    CHOSEN.get().copied().unwrap_or(&SHIPPED)
}

/// The same, as studies ask for them.
pub fn families() -> Families {
    Families::new(sensors())
}

/// The forward model of a skin that was read from `path`, effects that every skin can have included; refusals name that file.
pub fn forward(path: &Path, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>> {
    families().model_of_file(path, skin)
}

/// The family that reads a skin.
pub fn family(skin: &SkinDescription) -> Result<&'static dyn Sensor> {
    families().of(skin)
}
