//! The reader of frames and the configuration of the node, as `dermis-barodome` has them.

#![allow(dead_code, reason = "the rest of the crate uses more of these files")]

#[path = "../../../../nodes/barodome/src/config.rs"]
mod config;
#[path = "../../../../nodes/barodome/src/frame.rs"]
mod frame;

pub use crate::config::Config;
pub use frame::FrameReader;
