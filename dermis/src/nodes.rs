//! The nodes, one command each.

use anyhow::Result;
use clap::Args;

use crate::backend::Choice;

/// The node of a skin of taxels in an elastic medium.
#[derive(Args)]
pub struct Barodome {
    #[command(flatten)]
    arguments: dermis_barodome::cli::Arguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

/// Runs until Ctrl-C, or until it is shut down through its lifecycle.
pub async fn barodome(options: Barodome) -> Result<()> {
    let config = options.arguments.into_config()?;
    Ok(dermis_barodome::run(config, options.backend.open()?.as_ref()).await?)
}
