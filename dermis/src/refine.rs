//! Has a bundle's answers refined on the skin's forward model.

use anyhow::Result;
use clap::Args;
use dermis_studies::refinement::{Request, refine_bundle};

use crate::output;
use crate::registry::families;
use crate::steps::Steps;

/// What to refine, and on what it is measured.
#[derive(Args)]
pub struct Options {
    /// One JSON object.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    request: Request,
}

/// Refines, and says what that is worth.
pub fn run(options: &Options) -> Result<()> {
    let steps = Steps::stoppable("{msg:36} {wide_bar} {percent} %, {elapsed} gone")?;
    let findings = refine_bundle(&options.request, &families(), &steps)?;
    steps.finish();
    output::print(options.json, &findings, &dermis_report::refinement::text(&findings))
}
