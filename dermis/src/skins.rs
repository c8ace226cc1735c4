//! Checking skin descriptions.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use dermis_report::skin as report;
use dermis_skin::SkinDescription;

use crate::output;

/// Which file.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    skin: PathBuf,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Prints what the description says, or the sentence that says what is wrong with it.
pub fn run(options: &Options) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let family = crate::registry::family(&skin)?;
    family.check(&skin).map_err(|error| error.in_file(&options.skin))?;
    let model = family.model(&skin);
    let summary = report::Summary::new(&skin, model.as_ref().err());
    output::print(options.json, &serde_json::to_value(&summary)?, &report::text(&summary))
}
