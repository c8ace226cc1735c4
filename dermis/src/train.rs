//! Training is a program of its own: the training framework takes longer to build than everything else.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Result, bail};
use clap::Args;

const PROGRAM: &str = "dermis-train";

/// Handed on as they are.
#[derive(Args)]
pub struct Options {
    /// Arguments of dermis-train; `--help` lists them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

/// Becomes `dermis-train`.
pub fn run(options: &Options) -> Result<()> {
    let beside =
        std::env::current_exe().ok().and_then(|p| Some(p.parent()?.join(PROGRAM))).filter(|p| p.is_file());
    let program = beside.unwrap_or_else(|| PathBuf::from(PROGRAM));
    let error = Command::new(&program).args(&options.arguments).exec();
    if error.kind() == std::io::ErrorKind::NotFound {
        bail!(
            "{PROGRAM} lies neither beside this program nor on the path: build it with \
             `cargo build --release -p dermis-learn --features train` (it brings the training framework with it)"
        );
    }
    bail!("{} cannot be started: {error}", program.display())
}
