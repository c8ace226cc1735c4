//! Model bundles of models that were trained elsewhere, and of two bundles.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, Subcommand};
use dermis_inference::{Runtime, RuntimeConfig};
use dermis_learn::cli::Labels;
use dermis_learn::import_onnx::{ImportRequest, Wiring, import_onnx};
use dermis_learn::join::{JoinRequest, join_bundles};
use dermis_learn::{Dataset, Evaluation, SplitConfig, SplitKind};
use dermis_skin::SkinDescription;
use serde_json::json;

/// Making bundles.
#[derive(Subcommand)]
pub enum Bundle {
    /// Make a bundle of an ONNX model that was trained elsewhere, for nodes and `dermis evaluate`.
    New(Box<New>),
    /// Join a transfer network (target `signal`) and a bundle that was trained on the forward model into one bundle for nodes.
    ///
    /// Readings of the device go through the transfer network, and what it gives through the other network. No error is taken over from
    /// the two: name bags of the device to measure the whole.
    Join(Box<Join>),
}

/// Which bundles become one.
#[derive(Args)]
pub struct Join {
    /// Skin description.
    #[arg(long)]
    skin: PathBuf,
    /// Folder of the bundle that turns readings of the device into those of its model.
    #[arg(long, value_name = "DIR")]
    transfer: PathBuf,
    /// Folder of the bundle that was trained on the model's readings.
    #[arg(long, value_name = "DIR")]
    reconstruction: PathBuf,
    /// Folder of the bundle; an older bundle is replaced.
    #[arg(short, long)]
    out: PathBuf,
    #[command(flatten)]
    measured: Measured,
}

/// What a bundle is measured on, and how that is said.
#[derive(Args)]
pub struct Measured {
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

impl Measured {
    /// The data, where any are named.
    fn data(&self, skin: &SkinDescription) -> Result<Option<Dataset>> {
        if self.from_bag.is_empty() {
            return Ok(None);
        }
        let data = Dataset::from_bags(&self.from_bag, skin, &self.labels.options()?)?;
        for notice in data.notices() {
            eprintln!("note: {notice}");
        }
        Ok(Some(data))
    }

    fn split(&self) -> Option<SplitConfig> {
        self.split.map(|kind| SplitConfig { kind, ..SplitConfig::default() })
    }

    /// Says what was written, and what it makes of the data.
    fn report(&self, out: &Path, runtimes: &[String], measured: Option<&Evaluation>) {
        if self.json {
            let measured = measured.map(Evaluation::to_json);
            println!("{}", json!({ "bundle": out, "runtimes": runtimes, "measured": measured }));
            return;
        }
        println!("{} runs in: {}", out.display(), runtimes.join("; "));
        match measured {
            Some(evaluation) => print!("{evaluation}"),
            None => {
                println!("not measured: name labelled bags with `--from-bag`, or its contacts have no sigma");
            }
        }
    }
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
    #[command(flatten)]
    measured: Measured,
}

/// Makes it, and says what it measured.
pub fn run(command: &Bundle) -> Result<()> {
    match command {
        Bundle::New(options) => new(options),
        Bundle::Join(options) => joined(options),
    }
}

fn new(options: &New) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let wiring = options.input.as_ref().map(Wiring::load).transpose()?.unwrap_or_default();
    let data = options.measured.data(&skin)?;
    let adopted = import_onnx(&ImportRequest {
        skin: &skin,
        onnx: &options.onnx,
        outputs: &options.outputs,
        wiring: &wiring,
        data: data.as_ref().map(|data| (data, options.measured.split())),
        out: &options.out,
        runtime: Runtime::load(&RuntimeConfig::default())?,
    })?;
    options.measured.report(&options.out, &adopted.runtimes, adopted.measured.as_ref());
    Ok(())
}

fn joined(options: &Join) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let data = options.measured.data(&skin)?;
    let runtime = Runtime::load(&RuntimeConfig::default())?;
    let measured = join_bundles(&JoinRequest {
        skin: &skin,
        transfer: &options.transfer,
        reconstruction: &options.reconstruction,
        data: data.as_ref().map(|data| (data, options.measured.split())),
        model: data.is_some().then(|| crate::registry::forward(&options.skin, &skin)).transpose()?,
        out: &options.out,
        runtime,
    })?;
    options.measured.report(&options.out, &[runtime.report().to_string()], measured.as_ref());
    Ok(())
}
