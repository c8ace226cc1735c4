//! From a device's bytes to contacts on ROS topics, for every skin whose channels are read together.
//!
//! A frame goes one way: bytes → [`Decoder`](dermis_sensor::Decoder) (wire, unit, time of acquisition) → [`SkinEstimator`](dermis_estimate::SkinEstimator) (channel health,
//! zero, touch, learned models, forward model, contacts, identities) → [`messages`] → bus. The
//! estimator is the same struct in the node and in offline evaluation.
//!
//! What differs between sensor families is in a [`Sensor`]: its decoder, its forward model, its effects.

pub mod cli;
mod commands;
mod config;
mod folders;
pub mod messages;
mod node;
pub mod remote;

use dermis_node::Backend;
use dermis_sensor::Sensor;

pub use crate::config::{CacheConfig, Config, ConfigError};
pub use commands::{Command, Commands, UnknownCommand};
pub use node::{RunError, SkinNode};

/// Whether a node would start with this configuration, as far as can be checked without starting it: skin, source,
/// masked channels and parameters. Models are looked for, not loaded; the device is not opened. What is wrong is as the node
/// itself would say it, each for itself; nothing where it would start.
#[must_use]
pub fn check(sensor: &'static dyn Sensor, config: &Config) -> Vec<RunError> {
    node::check(sensor, config)
}

/// Runs a node until it is stopped by a signal or through its lifecycle.
///
/// # Errors
///
/// [`RunError`] says in one sentence why it does not start.
pub async fn run(
    sensor: &'static dyn Sensor,
    config: &Config,
    backend: &dyn Backend,
) -> Result<(), RunError> {
    // Before the first message: a signal that nobody listens to ends the process without a last word.
    dermis_node::end_all_nodes_on_signal()?;
    let running = SkinNode::start(sensor, config, backend)?;
    running.node().wait_for_shutdown().await?;
    running.stop();
    Ok(())
}
