//! Has the virtual testbed press a modelled skin, and writes a labelled bag.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Args;
use dermis_sensor::Registry;
use dermis_skin::SkinDescription;
use dermis_testbed::{CollectOptions, CollectReport, Plan};
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};

use crate::effects::Chosen;
use crate::{OperateError, model_of_file};

/// What to press, and where to put it.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description.
    pub skin: PathBuf,
    /// Plan of the presses.
    #[arg(long)]
    pub plan: PathBuf,
    /// What makes the device differ from its design.
    #[command(flatten)]
    pub chosen: Chosen,
    /// Seed of everything random, the device's own effects included; the plan's where absent.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Standard deviation of the ground truth's force along each axis [N]; the plan's where absent.
    #[arg(long, value_name = "N", value_parser = noise)]
    pub force_noise: Option<f64>,
    /// Standard deviation of the ground truth's position along each axis [m]; the plan's where absent.
    #[arg(long, value_name = "M", value_parser = noise)]
    pub stage_noise: Option<f64>,
    /// Stamp of the first frame [ns since 1970]; now where absent. With it the bag's messages are the same every time.
    #[arg(long, value_name = "NS", value_parser = clap::value_parser!(i64).range(0..))]
    pub start: Option<i64>,
    /// Leave the pictures of a skin that a camera reads out of the bag: the numbers that are made of them stay. A picture takes a thousand
    /// times the room.
    #[arg(long)]
    pub no_images: bool,
    /// Go on with a bag that was interrupted, by whatever; the finished bag is the same as one that was not.
    #[arg(long)]
    pub resume: bool,
    /// Folder of the bag to write; must not exist yet, but for --resume.
    #[arg(short, long)]
    pub out: PathBuf,
}

/// Reads a standard deviation.
fn noise(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(sigma) if sigma.is_finite() && sigma >= 0.0 => Ok(sigma),
        _ => Err(format!("`{text}` is no standard deviation: write 0 or a positive number")),
    }
}

/// What was collected.
#[derive(Debug, Clone, Serialize)]
pub struct Findings {
    /// The bag.
    pub bag: PathBuf,
    /// Frames in it, each with its ground truth.
    pub frames: u64,
    /// Of these, frames that were there already.
    pub resumed: u64,
    /// Presses that were begun.
    pub presses: u64,
    /// \[s\] of recorded time.
    pub duration_s: f64,
    /// Seed that was used.
    pub seed: u64,
    /// Whether it was stopped before the plan's end.
    pub interrupted: bool,
    /// Name of the skin.
    #[serde(skip)]
    pub skin: String,
}

/// Collects; the bar shows frames. Set `stop` to end early with a valid bag.
///
/// # Errors
///
/// Where a file cannot be used, the skin has no forward model, or the testbed refuses.
pub fn collect(
    request: &Request,
    sensors: &Registry,
    stop: Arc<AtomicBool>,
    progress: &ProgressBar,
) -> Result<Findings, OperateError> {
    let mut skin = SkinDescription::load(&request.skin)?;
    let plan = Plan::load(&request.plan)?;
    request.chosen.apply(&mut skin, request.seed.unwrap_or(plan.seed))?;
    let model = model_of_file(&request.skin, &skin, sensors)?;
    progress.set_message(skin.name.clone());
    let options = CollectOptions {
        seed: request.seed,
        start: request.start,
        force_noise: request.force_noise,
        stage_noise: request.stage_noise,
        images: !request.no_images,
        resume: request.resume,
        stop,
        progress: progress.clone(),
    };
    let report = dermis_testbed::collect(&model, &skin, &plan, &request.out, &options)?;
    let CollectReport { path, frames, resumed, presses, duration, seed, interrupted } = report;
    Ok(Findings {
        bag: path,
        frames,
        resumed,
        presses,
        duration_s: duration,
        seed,
        interrupted,
        skin: skin.name,
    })
}
