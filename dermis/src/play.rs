//! `dermis play`: a bag, published again.

use std::sync::Arc;

use anyhow::Result;
use clap::Args;
use dermis_operate::play::{Request, play};

use crate::backend::Choice;
use crate::output::StandardError;

/// What to play, and how.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    request: Request,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

/// Plays to the end of the bag, or until Ctrl-C.
pub async fn run(options: Options) -> Result<()> {
    let backend = options.backend.open()?;
    let Some(found) = play(options.request, backend.as_ref(), Arc::new(StandardError)).await? else {
        return Ok(());
    };
    if options.json {
        println!("{}", serde_json::to_value(&found)?);
    } else {
        println!("{} messages, {:.1} MB", found.messages, found.bytes as f64 * 1e-6);
    }
    Ok(())
}
