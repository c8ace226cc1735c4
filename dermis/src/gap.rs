//! Where a simulated skin and a real one differ, which effect makes them, and how far it closes the gap.

mod baselines;
mod check;
mod close;
mod pack;
mod page;
mod summary;
mod text;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use dermis_gap::{Diagnosis, Memory, Report, Simulator};
use dermis_learn::LabelMap;
use dermis_skin::SkinDescription;
use indicatif::{ProgressBar, ProgressStyle};

/// What to do about a gap.
#[derive(Subcommand)]
pub enum Gap {
    /// Say whether a recording of a real skin differs from its model beyond noise, where, and which effect makes that.
    Diagnose(Box<Diagnose>),
    /// Diagnose, switch on in the skin's description what was found, and train on the corrected simulation.
    Close(Box<close::Close>),
    /// Make recordings of skins with withheld effects, sealed, for the check of the diagnosis.
    MakePack(pack::Options),
    /// Diagnose a pack, seal the reports, then open its secrets and score.
    Check(check::Options),
    /// Print the JSON schema of reports.
    Schema,
}

/// Which recording of which skin.
#[derive(Args, Clone)]
pub struct Diagnose {
    /// Skin description: the model by design.
    #[arg(long)]
    skin: PathBuf,
    /// Labelled bag of the real skin; several are sessions of one skin.
    #[arg(long, required = true, value_name = "BAG")]
    real: Vec<PathBuf>,
    /// Take the ground truth from a robot's pose and a force sensor's wrench, as this file maps them; see launch/labels/.
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Which device, where a bag holds several of the skin's type; `dermis bag info` lists them.
    #[arg(long, value_name = "NAME")]
    skin_instance: Option<String>,
    /// Zero of readings: as they were recorded, from the first second of a run, or from before each press.
    #[arg(long, value_enum, default_value_t = Zero::AsRead)]
    zero: Zero,
    /// Folder for report.html, report.json and the corrected skin.toml.
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Systematic gap [share of the readings' variance] below which there is none that matters.
    #[arg(long, default_value_t = 0.005, value_parser = share)]
    margin: f64,
    /// Of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Times that selection and fit are run again on other places, for the interval of what is closed.
    #[arg(long, default_value_t = 16)]
    resamples: usize,
    /// Folder that keeps simulated signatures; the user's cache folder where absent.
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// The report as JSON.
    #[arg(long)]
    json: bool,
}

/// What readings are counted from.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Zero {
    /// As they were recorded: an offset is part of the gap.
    AsRead,
    /// From what was read untouched in the first second of a run.
    Start,
    /// From what was read in the half second before each press.
    Press,
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(share) if (0.0..1.0).contains(&share) => Ok(share),
        _ => Err(format!("`{text}` is no share: write a number from 0 to 1")),
    }
}

/// Does it.
pub fn run(gap: &Gap) -> Result<()> {
    match gap {
        Gap::Diagnose(options) => {
            let found = diagnose(options)?;
            if let Some(out) = &options.out {
                write(out, &found)?;
            }
            print(&found.report, options.json)
        }
        Gap::Close(options) => close::run(options),
        Gap::MakePack(options) => pack::run(options),
        Gap::Check(options) => check::run(options),
        Gap::Schema => {
            print!("{}", dermis_gap::SCHEMA_JSON);
            Ok(())
        }
    }
}

fn print(report: &Report, json: bool) -> Result<()> {
    if json {
        println!("{}", report.to_json()?);
    } else {
        print!("{}", text::text(report));
    }
    Ok(())
}

/// Reads the bags and diagnoses them.
fn diagnose(options: &Diagnose) -> Result<Diagnosis> {
    let skin = SkinDescription::load(&options.skin)?;
    let family = crate::registry::family(&skin)?;
    let map = options.map.as_ref().map(LabelMap::load).transpose()?;
    let mut recording =
        dermis_gap::read(&options.real, &skin, map.as_ref(), options.skin_instance.as_deref())?;
    recording.tare(match options.zero {
        Zero::AsRead => dermis_gap::Zero::AsRead,
        Zero::Start => dermis_gap::Zero::Start,
        Zero::Press => dermis_gap::Zero::Press,
    });
    let progress = ProgressBar::new(0)
        .with_style(ProgressStyle::with_template("{msg} {wide_bar} {human_pos}/{human_len}, {eta} left")?);
    progress.set_message("simulating effects");
    let make = |skin: &SkinDescription| (family.model)(skin).map_err(|e| format!("{e:#}"));
    let simulator = Simulator { skin: &skin, effects: family.effects, make: &make };
    let mut how = dermis_gap::Options {
        resamples: options.resamples,
        cache: options.cache.clone().or_else(cache),
        stop: crate::collect::stop_on_interrupt()?,
        progress: progress.clone(),
        ..dermis_gap::Options::default()
    };
    // What an effect must explain at least goes with what matters at all.
    how.select.floor *= options.margin / how.select.margin;
    how.select.margin = options.margin;
    how.select.seed = options.seed;
    how.samples.seed = options.seed;
    let found = dermis_gap::diagnose(&simulator, &recording, &how, &Memory::default())?;
    progress.finish_and_clear();
    Ok(found)
}

/// Where programs of this user keep what they can make again.
fn cache() -> Option<PathBuf> {
    let home = || std::env::var_os("HOME").map(|home| Path::new(&home).join(".cache"));
    let folder =
        std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from).filter(|p| p.is_absolute()).or_else(home)?;
    Some(folder.join("dermis").join("gap"))
}

/// Writes page, report and corrected skin.
fn write(out: &Path, found: &Diagnosis) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("{} cannot be made", out.display()))?;
    let put = |name: &str, text: &str| {
        let path = out.join(name);
        std::fs::write(&path, text).with_context(|| format!("{} cannot be written", path.display()))
    };
    put("report.json", &found.report.to_json()?)?;
    put("report.html", &page::html(&found.report)?)?;
    let comment: String =
        format!("{}\n", found.report.sentence).lines().map(|line| format!("# {line}\n")).collect();
    put("skin.toml", &format!("{comment}{}", dermis_gap::skin_text(&found.corrected)?))
}
