//! A sensor family's physics, computed now, against references.

use std::time::Duration;

use anyhow::{Result, bail};
use clap::Args;
use dermis_mechanics::calculix::CalculixError;
use indicatif::ProgressBar;
use serde_json::json;

use crate::output;
use crate::registry::sensors;

/// What to validate.
#[derive(Args)]
pub struct Options {
    /// Sensor family, as skin descriptions call it; its beginning is enough.
    family: String,
    /// One JSON object in place of the table.
    #[arg(long)]
    json: bool,
}

/// Computes every case; an error where one fails.
pub fn run(options: &Options) -> Result<()> {
    let matching: Vec<_> = sensors().iter().filter(|f| f.name().starts_with(&options.family)).collect();
    let [family] = matching.as_slice() else {
        let known = sensors().names();
        bail!(
            "`{}` names {} sensor families of this program; it knows {}",
            options.family,
            if matching.is_empty() { "none of the" } else { "several" },
            known.join(", ")
        );
    };
    let calculix = dermis_mechanics::calculix::available();
    if !calculix {
        eprintln!("left out what CalculiX judges: {}", CalculixError::Missing);
    }
    // Hidden where stderr is not a terminal.
    let busy = ProgressBar::new_spinner().with_message("computing, and asking others");
    busy.enable_steady_tick(Duration::from_millis(100));
    let cases = family.validation_cases();
    busy.finish_and_clear();
    let cases = cases.map_err(anyhow::Error::msg)?;
    let failed: Vec<&str> = cases.iter().filter(|c| !c.pass).map(|c| c.id.as_str()).collect();
    let record =
        json!({ "family": family.name(), "cases": cases, "failed": failed.len(), "calculix": calculix });
    output::print(options.json, &record, &dermis_report::validation::text(&cases))?;
    if !failed.is_empty() {
        bail!("{} of {} cases missed their reference: {}", failed.len(), cases.len(), failed.join("; "));
    }
    Ok(())
}
