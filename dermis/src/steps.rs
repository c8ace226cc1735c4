//! A bar that shows the steps of long work one after the other.

use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::ProgressBar;

/// The steps of the work on a terminal.
pub struct Steps<'a> {
    /// A thousand long.
    pub bar: ProgressBar,
    /// Set when the work is to end.
    pub stop: &'a AtomicBool,
}

impl Steps<'_> {
    /// Begins a step.
    pub fn begin(&self, what: &str) {
        self.bar.set_message(what.to_owned());
        self.bar.set_position(0);
        self.bar.reset_eta();
    }

    /// Shows how far the step is; whether it goes on.
    pub fn at(&self, share: f64) -> bool {
        self.bar.set_position((1000.0 * share) as u64);
        !self.stop.load(Ordering::Acquire)
    }
}
