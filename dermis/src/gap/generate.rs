//! Benchmark sets: recordings with withheld causes, for the check of the diagnosis.

use std::sync::atomic::Ordering;

use anyhow::Result;
use clap::Args;
use dermis_report::gap as report;
use dermis_studies::gap::generation::{Request, generate};
use indicatif::{ProgressBar, ProgressStyle};

use crate::output;
use crate::registry::families;

/// What to make.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    request: Request,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Makes it. Ctrl-C ends early with a smaller, valid set.
pub fn run(options: &Options) -> Result<()> {
    let progress = ProgressBar::new(options.request.order().count() as u64)
        .with_style(ProgressStyle::with_template("cases {wide_bar} {human_pos}/{human_len}, {eta} left")?);
    progress.tick();
    let stop = crate::interrupt::stop_on_interrupt()?;
    let found = generate(&options.request, &families(), |done| {
        progress.set_position(done as u64);
        !stop.load(Ordering::Acquire)
    })?;
    progress.finish_and_clear();
    output::print(options.json, &serde_json::to_value(&found)?, &report::generated(&found))
}
