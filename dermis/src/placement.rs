//! Where to put k sensing elements, of thousands of locations where they could be.

use anyhow::Result;
use clap::Args;
use dermis_report::placement as report;
use dermis_studies::placement::{self, Request};

use crate::output::{self, Output};
use crate::registry::families;
use crate::steps::Steps;

/// What to place where.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    request: Request,
    #[command(flatten)]
    output: Output,
}

/// Places, judges, and says what was found; the elements of each method are written as a skin file names them.
pub fn run(options: &Options) -> Result<()> {
    let steps = Steps::stoppable("{msg} {wide_bar} {percent} %, {eta} left")?;
    let findings = placement::place(&options.request, &families(), &steps)?;
    steps.finish();
    let text = report::text(&findings);
    if let Some(folder) = &options.output.out {
        let json = serde_json::to_string_pretty(&findings)? + "\n";
        output::save(
            folder,
            &[("placement.json", json), ("placement.html", report::html(&findings, &text)?)],
        )?;
        for choice in &findings.choices {
            let name = format!("taxels-{}.toml", choice.method.name());
            output::save(folder, &[(&name, report::taxels(choice, &findings.skin.name))])?;
        }
    }
    output::print(options.output.json, &findings, &text)
}
