//! Labelled bags as tables, for people who train elsewhere.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use dermis_learn::cli::Labels;
use dermis_learn::export::{ExportOptions, Format, export_all};
use dermis_learn::{Dataset, SplitConfig, SplitKind};
use dermis_skin::SkinDescription;

/// What to export, and as what.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    #[arg(long)]
    skin: PathBuf,
    /// Folder of the tables: one file a bag and format, named like the bag.
    #[arg(short, long)]
    out: PathBuf,
    /// `parquet`, `npz`, or both.
    #[arg(long, value_delimiter = ',', default_value = "parquet")]
    format: Vec<Format>,
    /// Add readings minus their zero, as a node sees them.
    #[arg(long)]
    tared: bool,
    /// What the column `split` holds out: location, press or time.
    #[arg(long, default_value = "location")]
    split: SplitKind,
    /// Share that is held out.
    #[arg(long, default_value_t = SplitConfig::default().fraction)]
    fraction: f64,
    /// Seed of the split.
    #[arg(long, default_value_t = SplitConfig::default().seed)]
    seed: u64,
    #[command(flatten)]
    labels: Labels,
    /// One JSON object.
    #[arg(long)]
    json: bool,
    /// Labelled bags.
    #[arg(required = true)]
    bags: Vec<PathBuf>,
}

/// Exports, and says what was written.
pub fn run(options: &Options) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let data = Dataset::from_bags(&options.bags, &skin, &options.labels.options()?)?;
    for notice in data.notices() {
        eprintln!("note: {notice}");
    }
    let split = SplitConfig {
        kind: options.split,
        fraction: options.fraction,
        seed: options.seed,
        ..SplitConfig::default()
    };
    let how = ExportOptions { formats: options.format.clone(), tared: options.tared, split };
    let files = export_all(&data, &options.out, &how)?;
    let frames: usize = data.runs().iter().map(|r| r.samples.len()).sum();
    let labelled = data.labelled().count();
    if options.json {
        println!("{}", serde_json::json!({ "files": files, "frames": frames, "labelled": labelled }));
    } else {
        for file in &files {
            println!("{}", file.display());
        }
        println!(
            "{frames} frames, {labelled} of them labelled; column `split` holds out {}",
            split.describe()
        );
    }
    Ok(())
}
