//! Mutation testing: changes the code in small ways and says which changes no test notices.

use std::path::Path;

use anyhow::{Result, bail};
use clap::Args;

use crate::environment;
use crate::run::cargo;

/// The crates whose arithmetic everything else stands on.
const CRATES: [&str; 3] = ["dermis-skin", "dermis-model", "dermis-inversion"];

/// What to change.
#[derive(Args)]
pub struct Options {
    /// Crates whose code is changed and whose own tests must notice.
    #[arg(long = "package", short, default_values_t = CRATES.map(str::to_owned))]
    packages: Vec<String>,
    /// Only files whose path fits this pattern, e.g. `crates/model/src/effects/*.rs`.
    #[arg(long)]
    file: Vec<String>,
    /// A part of all changes, e.g. `0/8`: hours become one.
    #[arg(long)]
    shard: Option<String>,
    /// List the changes and try none.
    #[arg(long)]
    list: bool,
}

pub fn run(root: &Path, options: &Options) -> Result<()> {
    environment::subcommand(root, "mutants", "27.1.0")?;
    environment::subcommand(root, "nextest", "0.9.143")?;
    let out = crate::run::target_dir(root).join("mutants");
    let mut command = cargo(root);
    // On a copy of the tree, so that the one that people edit stays as it is.
    command
        .args(["mutants", "--test-tool=nextest", "--baseline=run", "--colors=never", "--output"])
        .arg(&out);
    options.packages.iter().for_each(|name| {
        command.args(["--package", name]);
    });
    options.file.iter().for_each(|pattern| {
        command.args(["--file", pattern]);
    });
    if let Some(shard) = &options.shard {
        command.args(["--shard", shard]);
    }
    if options.list {
        command.arg("--list");
    }
    let status = command.status()?;
    // 2: some changes were not noticed; 3: some tests did not end in time.
    match status.code() {
        Some(0) => Ok(()),
        Some(2) => {
            bail!("some changes were noticed by no test: {}", out.join("mutants.out/missed.txt").display())
        }
        Some(3) => bail!(
            "with some changes the tests did not end: {}",
            out.join("mutants.out/timeout.txt").display()
        ),
        _ => bail!("cargo mutants ended with {status}"),
    }
}
