//! Which ROS 2 implementation a command talks through, and whether it shares its session with others.

use std::sync::Arc;

use anyhow::Result;
use clap::ValueEnum;
use dermis_node::HirozBackend;
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
    /// The implementation, for nodes that share nothing.
    pub fn open(self) -> Result<Arc<dyn Backend>> {
        Backends::default().open(self)
    }
}

/// The implementations, as the nodes of a process use them.
#[derive(Debug, Clone, Default)]
pub struct Backends {
    hiroz: HirozBackend,
}

impl Backends {
    /// Nodes share a session of the embedded one. ROS 2 that is installed is joined once by a process anyway.
    pub fn one_session() -> Self {
        Self { hiroz: HirozBackend::default().one_session() }
    }

    /// One of them.
    pub fn open(&self, choice: Choice) -> Result<Arc<dyn Backend>> {
        match choice {
            Choice::Hiroz => Ok(Arc::new(self.hiroz.clone())),
            #[cfg(feature = "ros2")]
            Choice::Ros2 => Ok(Arc::new(dermis_node_r2r::R2rBackend)),
            #[cfg(not(feature = "ros2"))]
            Choice::Ros2 => anyhow::bail!(
                "this program was built without the feature `ros2`: source your ROS 2 and build it with `cargo build --release --features ros2`"
            ),
        }
    }
}
