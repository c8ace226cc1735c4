//! Whether a recording differs from its model beyond noise, where, and which effect makes that; the work is done in `dermis-gap`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use clap::{Args, ValueEnum};
use dermis_gap::{Diagnosis, Memory, Simulator};
use dermis_learn::LabelMap;
use dermis_skin::SkinDescription;
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};

use crate::Families;

/// Which recording of which skin.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description: the model by design.
    #[arg(long)]
    pub skin: PathBuf,
    /// Labelled bag of the real skin; several are sessions of one skin.
    #[arg(long, required = true, value_name = "BAG")]
    pub real: Vec<PathBuf>,
    /// Another bag of the same device, recorded later: presses that `dermis gap next` proposed, say. All are diagnosed together, each
    /// with its own zero, session and time; a location that several have is one location.
    #[arg(long, value_name = "BAG")]
    pub and: Vec<PathBuf>,
    /// Take the ground truth from a robot's pose and a force sensor's wrench, as this file maps them; see launch/labels/.
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
    /// Which device, where a bag holds several of the skin's type; `dermis bag info` lists them.
    #[arg(long, value_name = "NAME")]
    pub skin_instance: Option<String>,
    /// Zero of readings: as they were recorded, from the first second of a run, or from before each press.
    #[arg(long, value_enum, default_value_t = Request::default().zero)]
    pub zero: Zero,
    /// Systematic gap [share of the readings' variance] below which there is none that matters.
    #[arg(long, default_value_t = Request::default().margin, value_parser = share)]
    pub margin: f64,
    /// Of everything random.
    #[arg(long, default_value_t = Request::default().seed)]
    pub seed: u64,
    /// Times that selection and fit are run again on other locations, for the interval of the residual
    /// reduction.
    #[arg(long, default_value_t = Request::default().resamples)]
    pub resamples: usize,
    /// Folder that keeps simulated signatures; the user's cache folder where absent.
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            skin: PathBuf::new(),
            real: Vec::new(),
            and: Vec::new(),
            map: None,
            skin_instance: None,
            zero: Zero::AsRead,
            margin: 0.005,
            seed: 1,
            resamples: 16,
            cache: None,
        }
    }
}

/// What readings are counted from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Zero {
    /// As they were recorded: an offset is part of the gap.
    AsRead,
    /// From what was read untouched in the first second of a run.
    Start,
    /// From what was read in the half second before each press.
    Press,
}

impl From<Zero> for dermis_gap::Zero {
    fn from(zero: Zero) -> Self {
        match zero {
            Zero::AsRead => Self::AsRead,
            Zero::Start => Self::Start,
            Zero::Press => Self::Press,
        }
    }
}

impl Zero {
    /// What the arguments of a diagnosis count readings from; what they do by default, where they do not say it.
    #[must_use]
    pub fn of_arguments(arguments: &[String]) -> Self {
        let after = arguments.iter().position(|a| a == "--zero").and_then(|at| arguments.get(at + 1));
        let within = arguments.iter().find_map(|a| a.strip_prefix("--zero="));
        let said = within.or(after.map(String::as_str)).and_then(|text| Self::from_str(text, false).ok());
        said.unwrap_or(Request::default().zero)
    }
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(share) if (0.0..1.0).contains(&share) => Ok(share),
        _ => Err(format!("`{text}` is no share: write a number from 0 to 1")),
    }
}

/// Reads the bags and diagnoses them.
///
/// # Errors
///
/// Where skin or bags cannot be read; what is wrong with a recording is a verdict.
pub fn diagnose(
    options: &Request,
    families: &Families,
    progress: ProgressBar,
    stop: Arc<AtomicBool>,
) -> Result<Diagnosis> {
    let skin = SkinDescription::load(&options.skin)?;
    let map = options.map.as_ref().map(LabelMap::load).transpose()?;
    let bags: Vec<&PathBuf> = options.real.iter().chain(&options.and).collect();
    let mut recording = dermis_gap::read(&bags, &skin, map.as_ref(), options.skin_instance.as_deref())?;
    recording.tare(options.zero.into());
    let make = |skin: &SkinDescription| families.model(skin).map_err(|e| format!("{e:#}"));
    let simulator = Simulator { skin: &skin, effects: families.of(&skin)?.effects(), make: &make };
    let mut how = dermis_gap::Options {
        resamples: options.resamples,
        cache: options.cache.clone().or_else(cache),
        stop,
        progress,
        ..dermis_gap::Options::default()
    };
    // What an effect must explain at least goes with what matters at all.
    how.select.floor *= options.margin / how.select.margin;
    how.select.margin = options.margin;
    how.select.seed = options.seed;
    how.samples.seed = options.seed;
    Ok(dermis_gap::diagnose(&simulator, &recording, &how, &Memory::default())?)
}

/// Where programs of this user keep what they can make again.
pub(super) fn cache() -> Option<PathBuf> {
    let home = || std::env::var_os("HOME").map(|home| Path::new(&home).join(".cache"));
    let folder =
        std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from).filter(|p| p.is_absolute()).or_else(home)?;
    Some(folder.join("dermis").join("gap"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_say_what_readings_are_counted_from() {
        let of = |text: &str| {
            let arguments: Vec<String> = text.split_whitespace().map(str::to_owned).collect();
            Zero::of_arguments(&arguments)
        };
        assert_eq!(of("--resamples 4"), Zero::AsRead);
        assert_eq!(of("--zero start --resamples 4"), Zero::Start);
        assert_eq!(of("--resamples 4 --zero=press"), Zero::Press);
    }
}
