//! Programs that measurements and the book run.

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::environment;
use crate::run::{cargo, run, target_dir};
use crate::test::{WITH_ROS, WITHOUT_ROS};

/// Builds programs with the features that the tests have, and says where they are: with others, all that they depend on would be built
/// once more.
pub fn built(root: &Path, names: &[&str]) -> Result<PathBuf> {
    let selection: &[&str] = if environment::has_ros(root) { &WITH_ROS } else { &WITHOUT_ROS };
    let bins = names.iter().flat_map(|name| ["--bin", name]);
    run(cargo(root).args(["build", "--release"]).args(bins).args(selection))?;
    Ok(target_dir(root).join("release"))
}

/// The program `dermis`, so built.
pub fn dermis(root: &Path) -> Result<PathBuf> {
    Ok(built(root, &["dermis"])?.join("dermis"))
}
