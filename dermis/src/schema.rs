//! JSON schemas of the files that people write, for editors that complete and check them.
//!
//! Skin, plan and launch files: schemas are written by hand under `launch/schemas/`, and tests compare their keys with
//! those that the readers of these files name when they refuse one. Effects: made from what the families say of theirs.

use anyhow::Result;
use clap::{Args, ValueEnum};

use crate::registry::sensors;

/// Of which files.
#[derive(Args)]
pub struct Options {
    /// Kind of file.
    #[arg(value_enum)]
    of: Kind,
}

/// A kind of file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Skin descriptions (TOML), `launch/skins/`.
    Skin,
    /// Launch files (YAML or TOML), `launch/*.launch.yaml`.
    Launch,
    /// Stimulus plans of the virtual testbed (TOML), `launch/plans/`.
    Plan,
    /// Effects that make a device differ from its design (TOML), `launch/effects/`.
    Effects,
}

/// Prints a schema.
pub fn run(options: &Options) -> Result<()> {
    print!("{}", text(options.of)?);
    Ok(())
}

fn text(kind: Kind) -> Result<String> {
    Ok(match kind {
        Kind::Skin => include_str!("../../launch/schemas/skin.schema.json").to_owned(),
        Kind::Launch => include_str!("../../launch/schemas/launch.schema.json").to_owned(),
        Kind::Plan => include_str!("../../launch/schemas/plan.schema.json").to_owned(),
        Kind::Effects => serde_json::to_string_pretty(&dermis_report::effects::schema(sensors()))? + "\n",
    })
}
