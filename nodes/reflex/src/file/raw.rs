//! Keys and values as they stand in a rule file.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::actions::RawAction;
use crate::rules::{AtEnd, Cause, Loss, Slip, Start};

#[derive(Deserialize)]
pub(super) struct RawRules {
    pub(super) schema: String,
    pub(super) name: String,
    #[serde(default)]
    pub(super) placeholders: bool,
    #[serde(default)]
    pub(super) start: Start,
    #[serde(default)]
    pub(super) at_end: AtEnd,
    pub(super) inputs: BTreeMap<String, RawInput>,
    #[serde(default)]
    pub(super) regions: BTreeMap<String, RawRegion>,
    #[serde(default)]
    pub(super) limits: BTreeMap<String, RawLimits>,
    pub(super) actions: BTreeMap<String, RawAction>,
    pub(super) rules: Vec<RawRule>,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum RawInputKind {
    Body,
    Skin,
}

#[derive(Deserialize)]
pub(super) struct RawInput {
    pub(super) kind: RawInputKind,
    pub(super) topic: String,
    pub(super) skin: Option<String>,
    pub(super) link: Option<String>,
    pub(super) timeout: f64,
    pub(super) max_age: Option<f64>,
}

#[derive(Deserialize)]
pub(super) struct RawRegion {
    #[serde(default)]
    pub(super) links: Vec<String>,
    #[serde(default)]
    pub(super) skins: Vec<String>,
}

#[derive(Default, Deserialize)]
pub(super) struct RawPair {
    pub(super) force: Option<f64>,
    pub(super) pressure: Option<f64>,
}

#[derive(Deserialize)]
pub(super) struct RawLimits {
    pub(super) quasi_static: RawPair,
    #[serde(default)]
    pub(super) transient: RawPair,
    pub(super) time_to_quasi_static: f64,
    pub(super) release_ratio: Option<f64>,
}

#[derive(Deserialize)]
pub(super) struct RawThreshold {
    pub(super) above: f64,
    pub(super) release: Option<f64>,
}

#[derive(Deserialize)]
pub(super) struct RawRule {
    pub(super) name: String,
    pub(super) region: Option<String>,
    pub(super) inputs: Option<Vec<String>>,
    pub(super) force: Option<RawThreshold>,
    pub(super) pressure: Option<RawThreshold>,
    pub(super) speed: Option<RawThreshold>,
    pub(super) slip: Option<Slip>,
    pub(super) limits: Option<String>,
    pub(super) counts_as_touched: Option<Vec<Loss>>,
    #[serde(default)]
    pub(super) ignore: Vec<Cause>,
    pub(super) least_confidence: Option<f64>,
    pub(super) sigmas: Option<f64>,
    pub(super) peak_over_mean: Option<f64>,
    pub(super) hold: Option<f64>,
    pub(super) quiet: Option<f64>,
    pub(super) latch: Option<bool>,
    pub(super) actions: Vec<String>,
}
