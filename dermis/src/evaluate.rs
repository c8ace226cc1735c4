//! Measuring model bundles on labelled bags.

use anyhow::Result;
use clap::Args;
use dermis_studies::evaluation::{Request, evaluate};

use crate::output;
use crate::registry::families;
use crate::steps::Steps;

/// What to measure on what.
#[derive(Args)]
pub struct Options {
    /// One JSON object.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    request: Request,
}

/// Evaluates, and fails where a requirement is missed.
pub fn run(options: &Options) -> Result<()> {
    let steps = Steps::new("{msg:40} {spinner} {elapsed}")?;
    let findings = evaluate(&options.request, &families(), &steps)?;
    steps.finish();
    output::print(options.json, &findings, &dermis_report::evaluation::text(&findings))?;
    Ok(findings.verdicts.require()?)
}
