//! The reflex node: rules that act on touch.

use anyhow::Result;
use clap::Args;
use dermis_reflex::cli::Arguments;

use crate::backend::{Backends, Choice};

/// Rules, and where they act.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    arguments: Arguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

/// Runs until Ctrl-C, or until it is shut down through its lifecycle.
pub async fn run(options: Options, backends: &Backends) -> Result<()> {
    let check = options.arguments.check;
    let config = options.arguments.into_config();
    if check {
        println!("{}", dermis_reflex::check(&config)?);
        return Ok(());
    }
    Ok(dermis_reflex::run(&config, backends.open(options.backend)?.as_ref()).await?)
}
