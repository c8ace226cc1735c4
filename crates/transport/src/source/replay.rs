//! Recordings as a source.

use std::path::Path;

use super::Stop;
use super::queue::Queue;

pub(super) struct Plan<'a> {
    pub(super) path: &'a Path,
    pub(super) speed: f64,
    pub(super) topic: Option<&'a str>,
    pub(super) repeat: bool,
}

pub(super) fn run(plan: &Plan<'_>, _queue: &Queue, _stop: &Stop) -> Result<(), String> {
    Err(format!("cannot open {}", plan.path.display()))
}
