//! Programs that measurements and the book run.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;

use crate::environment;
use crate::run::{cargo, run, target_dir};
use crate::test::{WITH_ROS, select};

/// What cargo does with everything that the tests are made of: with other features, all that they depend on would be built once more.
pub fn everything(root: &Path, arguments: &[&str]) -> Result<Command> {
    let mut command = cargo(root);
    command.args(arguments);
    let ros = environment::has_ros(root).then(|| environment::ros(root)).transpose()?;
    select(&mut command, WITH_ROS, ros.as_ref());
    Ok(command)
}

/// Builds programs, and says where they are.
pub fn built(root: &Path, names: &[&str]) -> Result<PathBuf> {
    let mut build = everything(root, &["build", "--release"])?;
    run(build.args(names.iter().flat_map(|name| ["--bin", name])))?;
    Ok(target_dir(root).join("release"))
}

/// The program `dermis`, so built.
pub fn dermis(root: &Path) -> Result<PathBuf> {
    Ok(built(root, &["dermis"])?.join("dermis"))
}
