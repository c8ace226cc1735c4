//! Programs that measurements and the book run.

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::environment;
use crate::run::{cargo, run, target_dir};
use crate::test::{WITH_ROS, select};

/// Builds programs with the features that the tests have, and says where they are: with others, all that they depend on would be built
/// once more.
pub fn built(root: &Path, names: &[&str]) -> Result<PathBuf> {
    let mut build = cargo(root);
    build.args(["build", "--release"]).args(names.iter().flat_map(|name| ["--bin", name]));
    let ros = environment::has_ros(root).then(|| environment::ros(root)).transpose()?;
    select(&mut build, WITH_ROS, ros.as_ref());
    run(&mut build)?;
    Ok(target_dir(root).join("release"))
}

/// The program `dermis`, so built.
pub fn dermis(root: &Path) -> Result<PathBuf> {
    Ok(built(root, &["dermis"])?.join("dermis"))
}
