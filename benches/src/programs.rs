//! Our programs under measurement, and the backends that this machine has for them.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::Value;

use crate::subscriber::Choice;

/// Where our programs are.
#[derive(Debug, Args)]
pub struct Programs {
    /// Folder of our programs without ROS 2.
    #[arg(long)]
    pub programs: PathBuf,
    /// Folder of our programs with ROS 2 in them; leaves ROS 2, and what is compared over it, out where absent.
    #[arg(long)]
    pub ros_programs: Option<PathBuf>,
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    pub root: PathBuf,
}

/// Names of rows.
pub const HIROZ: &str = "dermis, hiroz";
pub const R2R: &str = "dermis, r2r";
/// Ours over r2r, and a node in rclpy in place of one of ours.
pub const RCLPY: &str = "dermis, r2r + rclpy";

impl Programs {
    /// Ours over each backend that this machine has: name of the row, backend, folder of the programs.
    pub fn rows(&self) -> impl Iterator<Item = (&'static str, Choice, &Path)> {
        let with_ros = self.ros_programs.iter().map(|folder| (R2R, Choice::Ros2, folder.as_path()));
        std::iter::once((HIROZ, Choice::Hiroz, self.programs.as_path())).chain(with_ros)
    }
}

/// The row of this name; null where it was not measured.
pub fn named(rows: &[Value], name: &str) -> Value {
    rows.iter().find(|row| row["name"] == name).cloned().unwrap_or(Value::Null)
}
