//! The sensor families that this program knows: one entry each.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Result, anyhow, bail};
use dermis_inference::{Runtime, RuntimeConfig};
use dermis_launch::{NodeRequest, Refusal};
use dermis_mechanics::Case;
use dermis_model::ForwardModel;
use dermis_perception::Sensor;
use dermis_skin::{EffectInfo, Estimator, ModelError, SkinDescription, Taxel};
use dermis_studies::Families;
use serde_json::Value;

/// What the program needs of a sensor family.
pub struct Family {
    /// As skin descriptions call it in their field `sensor`.
    pub name: &'static str,
    /// Stimulus → channels, for families and skins that have one.
    pub model: fn(&SkinDescription) -> Result<Arc<dyn ForwardModel>>,
    /// What is wrong with a skin's table `medium`.
    pub medium: fn(&SkinDescription) -> Result<(), ModelError>,
    /// What the model can leave out and a device may have.
    pub effects: &'static [EffectInfo],
    /// Frame → contacts, with these model bundles.
    pub estimator: MakeEstimator,
    /// Figures of the family's physics beside their references.
    pub verify: fn() -> Result<Vec<Case>>,
    /// Where sensing elements of such a skin could be.
    pub candidates: fn(&SkinDescription) -> Result<Vec<Taxel>>,
    /// What a launch file says of a node of this family → its configuration, checked.
    pub node: MakeConfig,
}

type MakeConfig = fn(&NodeRequest<'_>) -> Result<Value, Vec<Refusal>>;
type MakeEstimator = fn(&SkinDescription, &[PathBuf]) -> Result<Box<dyn Estimator>>;

/// All families.
pub const FAMILIES: &[Family] = &[
    Family {
        name: dermis_barodome::SENSOR,
        model: |skin| Ok(dermis_barodome::model(skin)?),
        medium: dermis_barodome::medium,
        effects: dermis_barodome::effects::EFFECTS,
        estimator: |skin, bundles| estimator(&dermis_barodome::FAMILY, skin, bundles),
        verify: || {
            let mut cases = dermis_barodome::verify::cases()?;
            if dermis_mechanics::calculix::available() {
                cases.extend(dermis_barodome::verify::judged()?);
            }
            Ok(cases)
        },
        candidates: dermis_studies::placement::below_the_surface,
        node: |request| crate::nodes::config(&dermis_barodome::FAMILY, request),
    },
    Family {
        name: dermis_hapdef::SENSOR,
        model: |skin| Ok(dermis_hapdef::model(skin)?),
        medium: dermis_hapdef::medium,
        effects: dermis_hapdef::effects::EFFECTS,
        estimator: |skin, bundles| estimator(&dermis_hapdef::FAMILY, skin, bundles),
        verify: || {
            let mut cases = dermis_hapdef::verify::cases()?;
            if dermis_mechanics::calculix::available() {
                cases.extend(dermis_hapdef::verify::judged()?);
            }
            Ok(cases)
        },
        candidates: |skin| Ok(dermis_hapdef::candidates(skin)?),
        node: |request| crate::nodes::config(&dermis_hapdef::FAMILY, request),
    },
];

fn estimator(sensor: &Sensor, skin: &SkinDescription, bundles: &[PathBuf]) -> Result<Box<dyn Estimator>> {
    let runtime = Runtime::load(&RuntimeConfig::default())?;
    Ok(sensor.estimator(skin, bundles, &[], runtime)?)
}

/// The forward model of a skin that was read from `path`, effects that every skin can have included; refusals name that file.
pub fn forward(path: &Path, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>> {
    (family(skin)?.model)(skin).map_err(|error| of_file(path, error))
}

/// All families, as studies ask for them.
pub struct Registry;

impl Families for Registry {
    fn model(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>> {
        (family(skin)?.model)(skin)
    }

    fn model_of_file(&self, path: &Path, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>> {
        forward(path, skin)
    }

    fn estimator(&self, skin: &SkinDescription, bundles: &[PathBuf]) -> Result<Box<dyn Estimator>> {
        (family(skin)?.estimator)(skin, bundles)
    }

    fn candidates(&self, skin: &SkinDescription) -> Result<Vec<Taxel>> {
        (family(skin)?.candidates)(skin)
    }

    fn effects(&self, skin: &SkinDescription) -> Result<&'static [EffectInfo]> {
        Ok(family(skin)?.effects)
    }
}

/// What a family says of a skin, with the name of the file.
pub fn of_file(path: &Path, error: anyhow::Error) -> anyhow::Error {
    match error.downcast() {
        Ok(ModelError::Description { field, reason, .. }) => {
            anyhow!("skin file {}: field `{field}`: {reason}", path.display())
        }
        Ok(other) => other.into(),
        Err(error) => error,
    }
}

/// The family that reads a skin.
pub fn family(skin: &SkinDescription) -> Result<&'static Family> {
    if let Some(family) = FAMILIES.iter().find(|f| f.name == skin.sensor) {
        return Ok(family);
    }
    let known: Vec<&str> = FAMILIES.iter().map(|f| f.name).collect();
    bail!(
        "skin `{}`: field `sensor` is \"{}\", which this program does not know; it knows {}",
        skin.name,
        skin.sensor,
        known.join(", ")
    )
}
