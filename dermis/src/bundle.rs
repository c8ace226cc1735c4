//! Model bundles of models that were trained elsewhere.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use dermis_inference::{Runtime, RuntimeConfig};
use dermis_learn::cli::Labels;
use dermis_learn::import_onnx::{ImportRequest, Wiring, import_onnx};
use dermis_learn::{Dataset, SplitConfig, SplitKind};
use dermis_skin::SkinDescription;

/// Making bundles.
#[derive(Subcommand)]
pub enum Bundle {
    /// Make a bundle of an ONNX model that was trained elsewhere, for nodes and `dermis evaluate`.
    New(Box<New>),
}

/// What to make a bundle of.
#[derive(Args)]
pub struct New {
    /// Skin description.
    #[arg(long)]
    skin: PathBuf,
    /// The model: one input with the readings, 32-bit floats, batch of 1 or free. Of several outputs, the numbers are taken in its order.
    #[arg(long)]
    onnx: PathBuf,
    /// What each number of its outputs is, in order, e.g. `position.x,position.y,force.normal`.
    #[arg(long, required = true, value_delimiter = ',')]
    outputs: Vec<String>,
    /// Folder of the bundle; an older bundle is replaced.
    #[arg(short, long)]
    out: PathBuf,
    /// TOML file that says what it takes and gives, where that is not the newest tared reading in the unit of the
    /// skin and SI units: baseline, mean, scale, taps, low_pass, difference, outputs.
    #[arg(long, value_name = "FILE")]
    input: Option<PathBuf>,
    /// Labelled bag to measure it on, for its sigma and its card; may be repeated.
    #[arg(long, value_name = "BAG")]
    from_bag: Vec<PathBuf>,
    /// Measure only on the held-out part of this split (location, press, time), as `dermis bag export` marks it.
    #[arg(long, requires = "from_bag")]
    split: Option<SplitKind>,
    #[command(flatten)]
    labels: Labels,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Makes it, and says what it measured.
pub fn run(command: &Bundle) -> Result<()> {
    let Bundle::New(options) = command;
    let skin = SkinDescription::load(&options.skin)?;
    let wiring = options.input.as_ref().map(Wiring::load).transpose()?.unwrap_or_default();
    let data = if options.from_bag.is_empty() {
        None
    } else {
        Some(Dataset::from_bags(&options.from_bag, &skin, &options.labels.options()?)?)
    };
    for notice in data.iter().flat_map(Dataset::notices) {
        eprintln!("note: {notice}");
    }
    let split = options.split.map(|kind| SplitConfig { kind, ..SplitConfig::default() });
    let adopted = import_onnx(&ImportRequest {
        skin: &skin,
        onnx: &options.onnx,
        outputs: &options.outputs,
        wiring: &wiring,
        data: data.as_ref().map(|d| (d, split)),
        out: &options.out,
        runtime: Runtime::load(&RuntimeConfig::default())?,
    })?;
    if options.json {
        let measured = adopted.measured.as_ref().map(dermis_learn::Evaluation::to_json);
        println!(
            "{}",
            serde_json::json!({ "bundle": options.out, "runtimes": adopted.runtimes, "measured": measured })
        );
        return Ok(());
    }
    println!("{} runs in: {}", options.out.display(), adopted.runtimes.join("; "));
    match &adopted.measured {
        Some(evaluation) => print!("{evaluation}"),
        None => println!("not measured: name labelled bags with `--from-bag`, or its contacts have no sigma"),
    }
    Ok(())
}
