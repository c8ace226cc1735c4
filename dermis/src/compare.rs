//! Estimators side by side on the same held-out readings.

use anyhow::Result;
use clap::Args;
use dermis_report::comparison as report;
use dermis_studies::comparison::{self, Request};

use crate::output::{self, Output};
use crate::registry::families;
use crate::steps::Steps;

/// What to compare on what.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    output: Output,
    #[command(flatten)]
    request: Request,
}

/// Compares, and says what was found.
pub fn run(options: &Options) -> Result<()> {
    let steps = Steps::new("{msg} {wide_bar} {eta} left")?;
    let findings = comparison::compare(&options.request, &families(), &steps)?;
    steps.finish();
    let text = report::text(&findings)?;
    if let Some(folder) = &options.output.out {
        let json = serde_json::to_string_pretty(&serde_json::to_value(&findings)?)? + "\n";
        output::save(
            folder,
            &[("comparison.json", json), ("comparison.html", report::html(&findings, &text))],
        )?;
    }
    output::print(options.output.json, &findings, &text)
}
