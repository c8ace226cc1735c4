//! What a skin would gain from being built otherwise.

use anyhow::Result;
use clap::Args;
use dermis_report::sweep as report;
use dermis_studies::sweep::{self, Request};

use crate::output::{self, Output};
use crate::registry::families;
use crate::steps::Steps;

/// What to vary.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    request: Request,
    #[command(flatten)]
    output: Output,
}

/// Varies, and says what helps.
pub fn run(options: &Options) -> Result<()> {
    let steps = Steps::new("{msg} {wide_bar} {percent} %, {eta} left")?;
    let findings = sweep::sweep(&options.request, &families(), &steps)?;
    steps.finish();
    let text = report::text(&findings);
    if let Some(folder) = &options.output.out {
        let json = serde_json::to_string(&findings)? + "\n";
        output::save(folder, &[("sweep.html", report::html(&findings, &text)?), ("sweep.json", json)])?;
    }
    output::print(options.output.json, &findings, &text)
}
