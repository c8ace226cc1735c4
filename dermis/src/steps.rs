//! A bar that shows the steps of long work one after the other.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use dermis_studies::Progress;
use indicatif::{ProgressBar, ProgressStyle};

/// The steps of a study on a terminal; hidden where stderr is none.
pub struct Steps {
    /// A thousand long.
    bar: ProgressBar,
    /// Set when the work is to end.
    stop: Arc<AtomicBool>,
}

impl Steps {
    /// A bar of this look; Ctrl-C ends the program.
    pub fn new(template: &str) -> Result<Self> {
        let bar = ProgressBar::new(1000).with_style(ProgressStyle::with_template(template)?);
        Ok(Self { bar, stop: Arc::default() })
    }

    /// A bar of this look; Ctrl-C ends the study early.
    pub fn stoppable(template: &str) -> Result<Self> {
        Ok(Self { stop: crate::interrupt::stop_on_interrupt()?, ..Self::new(template)? })
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Progress for Steps {
    fn begin(&self, step: &str) {
        self.bar.set_message(step.to_owned());
        self.bar.set_position(0);
        self.bar.reset_eta();
    }

    fn at(&self, share: f64) -> bool {
        self.bar.set_position((1000.0 * share) as u64);
        !self.stop.load(Ordering::Acquire)
    }

    fn note(&self, sentence: &str) {
        self.bar.suspend(|| eprintln!("note: {sentence}"));
    }
}
