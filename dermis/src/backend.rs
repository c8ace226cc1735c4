//! Which ROS 2 implementation a command talks through.

use std::sync::Arc;

use anyhow::Result;
use clap::ValueEnum;
use dermis_node::backend::Backend;

/// ROS 2 implementation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Choice {
    /// Embedded: the wire of rmw_zenoh, without a ROS installation and without a router.
    #[default]
    Hiroz,
    /// The ROS 2 that is installed and sourced, with its RMW (feature `ros2`).
    Ros2,
}

impl Choice {
    /// The implementation.
    pub fn open(self) -> Result<Arc<dyn Backend>> {
        match self {
            Self::Hiroz => Ok(Arc::new(dermis_node::HirozBackend::default())),
            #[cfg(feature = "ros2")]
            Self::Ros2 => Ok(Arc::new(dermis_node_r2r::R2rBackend)),
            #[cfg(not(feature = "ros2"))]
            Self::Ros2 => anyhow::bail!(
                "this program was built without the feature `ros2`: source your ROS 2 and build it with `cargo build --release --features ros2`"
            ),
        }
    }
}
