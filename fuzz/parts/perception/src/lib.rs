//! The configuration of the node, as `dermis-perception` has them.

#![allow(dead_code, reason = "the rest of the crate uses more of these files")]

#[path = "../../../../crates/perception/src/commands.rs"]
mod commands;
#[path = "../../../../crates/perception/src/config.rs"]
mod config;

pub use crate::config::Config;
