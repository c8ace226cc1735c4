//! Measuring model bundles on labelled bags.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use dermis_learn::plot::Report;
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
    /// Writes a page with figures, too: errors of each channel of a transfer network, and force maps of single frames beside the true ones.
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    #[command(flatten)]
    request: Request,
}

/// Evaluates, and fails where a requirement is missed.
pub fn run(options: &Options) -> Result<()> {
    let steps = Steps::new("{msg:40} {spinner} {elapsed}")?;
    let findings = evaluate(&options.request, &families(), &steps)?;
    steps.finish();
    if let Some(path) = &options.report {
        let mut page = Report::new(format!("Measured: {}", options.request.skin.display()));
        page.section(&findings.evaluation.data, &findings.evaluation, &[])?;
        std::fs::write(path, page.html())
            .with_context(|| format!("{} cannot be written; name another file", path.display()))?;
    }
    output::print(options.json, &findings, &dermis_report::evaluation::text(&findings))?;
    Ok(findings.verdicts.require()?)
}
