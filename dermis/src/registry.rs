//! The sensor families that this program knows.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use anyhow::{Result, anyhow};
use dermis_inference::{Runtime, RuntimeConfig};
use dermis_model::ForwardModel;
use dermis_sensor::{Registry, Sensor};
use dermis_skin::{Estimator, ModelError, SkinDescription};

/// The families that ship.
pub static SHIPPED: Registry = Registry::new(&[dermis_barodome::FAMILY, dermis_hapdef::FAMILY]);

static CHOSEN: OnceLock<&'static Registry> = OnceLock::new();

/// Makes these the families of the program; the first call counts.
pub fn choose(sensors: &'static Registry) {
    CHOSEN.get_or_init(|| sensors).install();
}

/// The families of the program.
pub fn sensors() -> &'static Registry {
    CHOSEN.get().copied().unwrap_or(&SHIPPED)
}

/// Frame → contacts, with these model bundles.
pub fn estimator(
    sensor: &dyn Sensor,
    skin: &SkinDescription,
    bundles: &[PathBuf],
) -> Result<Box<dyn Estimator>> {
    let runtime = Runtime::load(&RuntimeConfig::default())?;
    Ok(dermis_estimate::estimator(sensor, skin, bundles, &[], runtime)?)
}

/// The forward model of a skin that was read from `path`, effects that every skin can have included; refusals name that file.
pub fn forward(path: &Path, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>> {
    family(skin)?.model(skin).map_err(|error| of_file(path, error))
}

/// What a family says of a skin, with the name of the file.
pub fn of_file(path: &Path, error: ModelError) -> anyhow::Error {
    match error {
        ModelError::Description { field, reason, .. } => {
            anyhow!("skin file {}: field `{field}`: {reason}", path.display())
        }
        other => other.into(),
    }
}

/// The family that reads a skin.
pub fn family(skin: &SkinDescription) -> Result<&'static dyn Sensor> {
    Ok(sensors().of(skin)?)
}
