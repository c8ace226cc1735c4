//! From a device's bytes to contacts on ROS topics, for every skin whose channels are read together.
//!
//! A frame goes one way: bytes → [`FrameReader`] (wire, unit, time of acquisition) → [`Conditioner`] (channel health,
//! zero, touch) → [`SkinEstimator`] (learned models, forward model, contacts, identities) → [`messages`] → bus. The
//! estimator is the same struct in the node and in offline evaluation.
//!
//! What differs between sensor families is in a [`Sensor`]: what skin descriptions call it, and its forward model.

pub mod cli;
mod commands;
mod condition;
mod config;
mod contacts;
mod estimator;
mod folders;
mod frame;
pub mod messages;
mod node;
#[cfg(test)]
mod testing;

use std::path::PathBuf;
use std::sync::Arc;

use dermis_inference::{Bundle, Runtime};
use dermis_model::ForwardModel;
use dermis_node::Backend;
use dermis_skin::{Estimator, ModelError, SkinDescription};

pub use crate::config::{CacheConfig, Config, ConfigError};
pub use commands::{Command, Commands, UnknownCommand};
pub use condition::{ConditionError, Conditioned, Conditioner, TareRefusal};
pub use contacts::{TaxelShares, Tracker};
pub use estimator::{Maps, Models, Quality, SetupError, SkinEstimator, Verdict};
pub use frame::FrameReader;
pub use node::{RunError, SkinNode};

/// A family of sensors, as far as reading one needs it.
#[derive(Debug, Clone, Copy)]
pub struct Sensor {
    /// What skin descriptions name in `sensor`.
    pub name: &'static str,
    /// Stimulus → channels; an error where the family, or that skin, has no forward model.
    pub model: fn(&SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError>,
    /// What is wrong with the table `medium` of a skin that has one, found without computing anything: a key that the family does
    /// not know, or a value that cannot be.
    pub medium: fn(&SkinDescription) -> Result<(), ModelError>,
}

impl Sensor {
    /// Frame → contacts, without maps, with these model bundles; `masked` names channels to leave out.
    ///
    /// # Errors
    ///
    /// [`SetupError`] names the bundle, output or channel that does not fit.
    pub fn estimator(
        &self,
        skin: &SkinDescription,
        bundles: &[PathBuf],
        masked: &[String],
        runtime: &Runtime,
    ) -> Result<Box<dyn Estimator>, SetupError> {
        let bundles =
            bundles.iter().map(|folder| Bundle::load(folder, skin)).collect::<Result<Vec<_>, _>>()?;
        let mut estimator = SkinEstimator::new(skin, masked)?;
        estimator.set_models(Models::load(self, skin, &bundles, runtime)?);
        estimator.want_maps(Maps::NONE);
        Ok(Box::new(estimator))
    }

    /// Whether a node would start with this configuration, as far as can be told without starting it: skin, source,
    /// masked channels and parameters. Models are looked for, not loaded; the device is not opened. What is wrong is as the node
    /// itself would say it, each for itself; nothing where it would start.
    #[must_use]
    pub fn check(&self, config: &Config) -> Vec<RunError> {
        node::check(self, config)
    }

    /// Runs a node until it is stopped by a signal or through its lifecycle.
    ///
    /// # Errors
    ///
    /// [`RunError`] says in one sentence why it does not start.
    pub async fn run(&self, config: &Config, backend: &dyn Backend) -> Result<(), RunError> {
        let running = SkinNode::start(self, config, backend)?;
        running.node().wait_for_shutdown().await?;
        running.stop();
        Ok(())
    }
}
