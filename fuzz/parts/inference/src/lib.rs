//! The manifest of a model bundle and the configuration of the runtime, as `dermis-inference` has them.

#![allow(dead_code, reason = "the rest of the crate uses more of these files")]

#[path = "../../../../crates/inference/src/correction.rs"]
mod correction;
#[path = "../../../../crates/inference/src/features.rs"]
mod features;
#[path = "../../../../crates/inference/src/force_peaks/section.rs"]
mod force_peaks;
#[path = "../../../../crates/inference/src/interface.rs"]
mod interface;
#[path = "../../../../crates/inference/src/limits.rs"]
mod limits;
#[path = "../../../../crates/inference/src/manifest.rs"]
mod manifest;
#[path = "../../../../crates/inference/src/outputs.rs"]
mod outputs;
#[path = "../../../../crates/inference/src/peaks/section.rs"]
mod peaks;
#[path = "../../../../crates/inference/src/runtime_config.rs"]
mod runtime_config;

pub use limits::Limits;
pub use manifest::Manifest;
pub use runtime_config::RuntimeConfig;
