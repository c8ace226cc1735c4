//! `dermis train`.

use anyhow::{Result, anyhow};

pub use dermis_learn::train::command::Options;

/// Trains in this process.
pub fn run(options: &Options) -> Result<()> {
    let find = |path: &std::path::Path, skin: &dermis_skin::SkinDescription| {
        crate::registry::forward(path, skin).map_err(|error| format!("{error:#}"))
    };
    dermis_learn::train::command::train(options, Some(&find)).map_err(|error| anyhow!(error))
}
