//! The node that merges the skins of a robot.

use anyhow::Result;
use clap::Args;

use crate::backend::{Backends, Choice};

/// The robot and its skins.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    arguments: dermis_fusion::cli::Arguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

/// Runs until Ctrl-C, or until it is shut down through its lifecycle.
pub async fn run(options: Options, backends: &Backends) -> Result<()> {
    let config = options.arguments.into_config()?;
    Ok(dermis_fusion::run(&config, backends.open(options.backend)?.as_ref()).await?)
}
