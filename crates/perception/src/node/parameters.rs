//! The ROS parameters of a node.
//!
//! Read-only ones say how the node was configured; the others set thresholds and times of the estimator while it runs.

use std::sync::Arc;

use dermis_estimate::SkinEstimator;
use dermis_node::{NodeError, ParameterDescriptor, ParameterValue, Parameters};
use dermis_skin::{Mount, SkinDescription};

use super::RunError;
use super::shared::Shared;
use crate::config::Config;

/// Parameters that say how a node was configured, and the key that decides each.
const FIXED: [(&str, &str); 10] = [
    ("skin", "instance"),
    ("skin_type", "skin"),
    ("skin_hash", "skin"),
    ("frame_id", "frame_id"),
    ("mount_parent", "mount"),
    ("mount_pose", "mount"),
    ("masked", "masked"),
    ("correction", "correction"),
    ("source", "source"),
    ("models", "models"),
];

/// Declares the parameters and takes their start values over into the estimator.
pub(super) fn declare(
    parameters: &Parameters,
    config: &Config,
    skin: &SkinDescription,
    estimator: &mut SkinEstimator,
) -> Result<(), RunError> {
    if let Some((name, key)) = FIXED.into_iter().find(|(name, _)| config.parameters.contains_key(*name)) {
        return Err(RunError::FixedParameter { name, key });
    }
    declare_fixed(parameters, config, skin)?;
    declare_live(parameters, config, skin)?;
    let unused = parameters.unused_overrides();
    if !unused.is_empty() {
        return Err(RunError::UnknownParameter {
            names: unused.join("`, `"),
            known: parameters.names().join(", "),
        });
    }
    for name in parameters.names() {
        if let Some(value) = parameters.get(&name) {
            apply(estimator, &name, &value);
        }
    }
    Ok(())
}

/// How the node was configured.
fn declare_fixed(parameters: &Parameters, config: &Config, skin: &SkinDescription) -> Result<(), NodeError> {
    let fixed = |text: &str| ParameterDescriptor::new(text).read_only();
    parameters.declare("skin", skin.name.as_str(), fixed("name of this skin, unique on the robot"))?;
    parameters.declare("skin_type", skin.type_name(), fixed("name of the skin file's"))?;
    parameters.declare(
        "skin_hash",
        skin.hash(),
        fixed("identity of the type; models are trained for one"),
    )?;
    parameters.declare("frame_id", skin.frame_id.as_str(), fixed("coordinate frame of this skin"))?;
    let mount = config.mount.as_ref();
    let parent = mount.map(Mount::parent).unwrap_or_default();
    parameters.declare(
        "mount_parent",
        parent,
        fixed("link that this skin is fixed to; empty: not known here"),
    )?;
    let pose = mount.map(|m| [&m.translation()[..], &m.rotation()[..]].concat()).unwrap_or_default();
    parameters.declare(
        "mount_pose",
        pose,
        fixed("pose of `frame_id` in `mount_parent`: x, y, z [m] and quaternion x, y, z, w; empty: not known here"),
    )?;
    parameters.declare("masked", config.masked.clone(), fixed("channels that are left out"))?;
    let correction = config.correction.as_ref().map(|file| file.display().to_string()).unwrap_or_default();
    parameters.declare(
        "correction",
        correction,
        fixed("file of how this skin differs from its forward model; empty: as its models say"),
    )?;
    parameters.declare("source", config.source.as_str(), fixed("where the bytes come from"))?;
    let models: Vec<String> = config.models.iter().map(|m| m.display().to_string()).collect();
    parameters.declare("models", models, fixed("model bundles at start; ~/load_model replaces them"))?;
    Ok(())
}

/// What can be set while the node runs.
fn declare_live(parameters: &Parameters, config: &Config, skin: &SkinDescription) -> Result<(), NodeError> {
    let live = |text: &str, from: f64, to: f64| ParameterDescriptor::new(text).float_range(from, to);
    let c = &skin.condition;
    for (name, value, descriptor) in [
        (
            "contact_threshold",
            c.contact_threshold,
            live("a contact is assumed above this many noise deviations (rms of the channels)", 0.1, 1e6),
        ),
        (
            "drift_time",
            c.drift_time,
            live("[s] with which the zero follows drift while untouched", 1e-3, 1e6),
        ),
        (
            "release_share",
            c.release_share,
            live(
                "share of a contact's peak below which a signal at rest becomes the new zero; 0: never",
                0.0,
                0.99,
            ),
        ),
        (
            "tare_duration",
            c.tare_duration,
            live("[s] of untouched readings that a tare averages", 1e-3, 600.0),
        ),
        (
            "stuck_time",
            c.stuck_time,
            live("[s] without change after which a channel is stuck; 0: off", 0.0, 1e6),
        ),
        ("stale_time", c.stale_time, live("[s] without a frame after which the skin is stale", 1e-3, 1e4)),
        ("force_threshold", config.force_threshold, live("[N] lighter contacts are not reported", 0.0, 1e6)),
    ] {
        parameters.declare(name, value, descriptor)?;
    }
    parameters.declare(
        "tare_while_touched",
        false,
        ParameterDescriptor::new(
            "whether ~/tare is obeyed where the skin reads as touched: its zero has drifted",
        ),
    )?;
    Ok(())
}

/// Takes one parameter over into the estimator.
fn apply(estimator: &mut SkinEstimator, name: &str, value: &ParameterValue) {
    let Some(value) = value.as_f64() else { return };
    let mut condition = estimator.condition().clone();
    match name {
        "contact_threshold" => condition.contact_threshold = value,
        "drift_time" => condition.drift_time = value,
        "release_share" => condition.release_share = value,
        "tare_duration" => condition.tare_duration = value,
        "stuck_time" => condition.stuck_time = value,
        "stale_time" => condition.stale_time = value,
        "force_threshold" => return estimator.set_least_force(value),
        _ => return,
    }
    estimator.set_condition(condition);
}

impl Shared {
    /// Hands every later change to the estimator.
    pub(super) fn follow_parameters(self: &Arc<Self>) {
        let shared = Arc::downgrade(self);
        self.node.parameters().on_changed(move |name, value| {
            if let Some(shared) = shared.upgrade() {
                apply(&mut shared.lock().estimator, name, value);
            }
        });
    }
}
