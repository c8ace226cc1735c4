//! `dermis train`.

use anyhow::{Result, anyhow};

pub use dermis_learn::train::command::Options;

/// Trains in this process.
pub fn run(options: &Options) -> Result<()> {
    dermis_learn::train::command::train(options).map_err(|error| anyhow!(error))
}
