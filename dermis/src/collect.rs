//! The virtual testbed on the command line.

use anyhow::Result;
use clap::Args;
use dermis_operate::collect::{Request, collect};
use indicatif::{ProgressBar, ProgressStyle};

use crate::interrupt::stop_on_interrupt;
use crate::registry::sensors;

/// What to press, and where to put it.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    request: Request,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Collects, and says what was collected. Ctrl-C ends early with a valid bag.
pub fn run(options: &Options) -> Result<()> {
    let progress = ProgressBar::new(0).with_style(ProgressStyle::with_template(
        "{msg} {wide_bar} {human_pos}/{human_len} frames, {eta} left",
    )?);
    let found = collect(&options.request, sensors(), stop_on_interrupt()?, &progress)?;
    progress.finish_and_clear();
    if options.json {
        println!("{}", serde_json::to_value(&found)?);
    } else {
        print!("{}", dermis_report::collection::text(&found));
    }
    Ok(())
}
