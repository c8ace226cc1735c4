//! Why the node does not start.

use dermis_body::RobotError;
use dermis_node::NodeError;

use super::{MAX_RATES, MOST_RATE};
use crate::fuser::FuserError;

/// Why the node does not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The robot file cannot be used.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The robot has no skins.
    #[error("robot file {path}: it has no skins, so that there is nothing to merge; add `[[skins]]`")]
    NoSkins {
        /// The robot file.
        path: std::path::PathBuf,
    },
    /// Settings or expectations cannot be.
    #[error(transparent)]
    Fuser(#[from] FuserError),
    /// The rate of answers cannot be.
    #[error("`rate`: is {rate} Hz and must be from 0 to {MOST_RATE}")]
    Rate {
        /// What it is.
        rate: f64,
    },
    /// The most answers a second cannot be.
    #[error("`max_rate`: is {rate} Hz and must be from {} to {}", MAX_RATES.start(), MAX_RATES.end())]
    MaxRate {
        /// What it is.
        rate: f64,
    },
    /// Start values of parameters that this node does not have.
    #[error("parameter `{names}` is none of this node; its parameters are {known}")]
    UnknownParameter {
        /// Names as configured.
        names: String,
        /// Parameters that exist.
        known: String,
    },
    /// ROS refused.
    #[error(transparent)]
    Node(#[from] NodeError),
}
