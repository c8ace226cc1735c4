//! How well a skin can know a contact at best.

use anyhow::Result;
use clap::Args;
use dermis_report::bounds as report;
use dermis_studies::bounds::{self, Request};

use crate::output::{self, Output};
use crate::registry::families;
use crate::steps::Steps;

/// What to bound.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    request: Request,
    #[command(flatten)]
    output: Output,
}

/// Bounds, and says what was found.
pub fn run(options: &Options) -> Result<()> {
    // Only the page shows how other skins would be.
    let request = Request { trends: options.output.out.is_some(), ..options.request.clone() };
    let steps = Steps::new("{msg} {wide_bar} {percent} %, {eta} left")?;
    let findings = bounds::bound(&request, &families(), &steps)?;
    steps.finish();
    let text = report::text(&findings);
    if let Some(folder) = &options.output.out {
        let json = serde_json::to_string(&findings)? + "\n";
        output::save(folder, &[("bounds.json", json), ("bounds.html", report::html(&findings, &text)?)])?;
    }
    output::print(options.output.json, &bounds::summary(&findings), &text)
}
