//! Which presses to record: the first protocol of a skin, and the next presses after a diagnosis.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_gap::protocol::design::{DesignOptions, Separation, design};
use dermis_gap::protocol::open::{Open, open};
use dermis_gap::protocol::{Block, BlockKind, PlannedPress, menu};
use dermis_gap::{Report, Simulator, Verdict};
use dermis_skin::SkinDescription;
use indicatif::ProgressBar;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::protocol::{Protocol, range, spread};
use crate::Families;

/// Locations that a protocol chooses from.
const LOCATIONS: usize = 96;

/// The first protocol of a skin.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanRequest {
    /// Skin description.
    pub skin: PathBuf,
    /// Minutes of pressing; ways of the rig come on top.
    #[arg(long, default_value_t = ten(), value_parser = minutes)]
    #[serde(default = "ten")]
    pub minutes: f64,
    /// Seed of what instruments add to the ground truth.
    #[arg(long, default_value_t = 1)]
    #[serde(default)]
    pub seed: u64,
}

/// The next presses after a diagnosis.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NextRequest {
    /// report.json of `dermis gap diagnose`, or the folder that holds it.
    pub report: PathBuf,
    /// Skin description that was diagnosed; where absent, the skin.toml beside the report without what it corrects.
    #[arg(long)]
    #[serde(default)]
    pub skin: Option<PathBuf>,
    /// Minutes on the rig.
    #[arg(long, default_value_t = five(), value_parser = minutes)]
    #[serde(default = "five")]
    pub minutes: f64,
    /// Seed of what instruments add to the ground truth.
    #[arg(long, default_value_t = 2)]
    #[serde(default)]
    pub seed: u64,
}

fn ten() -> f64 {
    10.0
}

fn five() -> f64 {
    5.0
}

fn minutes(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(minutes) if (1.0..=600.0).contains(&minutes) => Ok(minutes),
        _ => Err(format!("`{text}` is no time to press for: write minutes from 1 to 600")),
    }
}

/// Presses to come, and what they do.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Planned {
    /// The presses.
    #[serde(flatten)]
    pub protocol: Protocol,
    /// Minutes that they last, without ways of the rig.
    pub minutes: f64,
    /// Number of presses.
    pub presses: usize,
    /// What they tell apart; none for a first protocol.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub separations: Vec<Separation>,
    /// Share of the time that serves what no hypothesis explains; none for a first protocol.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown: Option<f64>,
}

impl Planned {
    fn of(protocol: Protocol, separations: Vec<Separation>, unknown: Option<f64>) -> Self {
        Self { minutes: protocol.minutes(), presses: protocol.presses(), protocol, separations, unknown }
    }
}

/// How the first minutes are spent: kind of block, and share of the time.
const FIRST: [(BlockKind, f64); 4] = [
    (BlockKind::Ladder, 0.45),
    (BlockKind::HoldAndRest, 0.15),
    (BlockKind::Again, 0.08),
    (BlockKind::TwoTips, 0.08),
];
/// Locations of the reference presses, which are done before, between and after everything else.
const REFERENCES: usize = 3;

/// Designs the first protocol of a skin: a force ladder at two speeds, a hold with a rest, repeats, a second tip, reference presses that show
/// how the skin warms up, and single presses spread over the surface. All blocks share their locations as far as they go, so that a second
/// session with the same plan crosses locations and sessions.
///
/// # Errors
///
/// Where the skin cannot be read, has no model, or cannot be pressed anywhere.
pub fn plan(request: &PlanRequest, families: &Families) -> Result<Planned> {
    let skin = SkinDescription::load(&request.skin)?;
    let model = families.model_of_file(&request.skin, &skin)?;
    let range = range(&skin, model.as_ref());
    let locations = spread(&skin, &model, &range, LOCATIONS)?;
    let description =
        "first protocol: ladder at two speeds, hold and rest, repeats, second tip, warm-up, spread"
            .to_owned();
    let mut protocol =
        Protocol::new(&format!("{}-first", skin.name), description, &skin, range, request.seed);
    let budget = 60.0 * request.minutes;
    let references: Vec<Block> = locations
        .iter()
        .take(REFERENCES)
        .map(|at| Block { kind: BlockKind::Single, at: *at, presses: vec![range.press(0.6)] })
        .collect();
    let mut blocks: Vec<Vec<Block>> = Vec::new();
    for (kind, share) in FIRST {
        let of = |at: &Point3<f64>| -> Vec<Block> {
            let block = menu(&range, *at).into_iter().find(|b| b.kind == kind);
            // The ladder is climbed slowly, and once more quickly.
            let quick = block.clone().filter(|_| kind == BlockKind::Ladder).map(|b| Block {
                presses: b
                    .presses
                    .iter()
                    .map(|p| PlannedPress { load: 0.05, unload: 0.05, hold: 0.3, ..*p })
                    .collect(),
                ..b
            });
            block.into_iter().chain(quick).collect()
        };
        let cost = |at: &Point3<f64>| {
            of(at).iter().flat_map(|b| &b.presses).map(PlannedPress::duration).sum::<f64>()
        };
        let Some(one) = locations.first().map(cost).filter(|cost| *cost > 0.0) else { continue };
        let count = ((share * budget / one) as usize).clamp(1, locations.len());
        blocks.push(locations[..count].iter().flat_map(of).collect());
    }
    // What is left goes to single presses at other locations, at forces that go through the range.
    protocol.refer(&references);
    for of in &blocks {
        protocol.add(of);
        protocol.refer(&references);
    }
    let left = budget - 60.0 * protocol.minutes();
    let one = range.press(0.6).duration() + 0.1;
    let count = (left / one).max(0.0) as usize;
    let shares = [0.3, 0.6, 0.9];
    let mut singles = Vec::new();
    for (number, at) in locations.iter().rev().cycle().take(count.min(2 * locations.len())).enumerate() {
        let round = number / locations.len();
        let press = range.press(shares[(number + round) % shares.len()]);
        singles.push(Block { kind: BlockKind::Single, at: *at, presses: vec![press] });
    }
    protocol.add(&singles);
    protocol.refer(&references);
    // A tip is changed once: what is pressed with another one comes last.
    let usual = range.tip;
    protocol.steps.sort_by_key(|s| !s.at.is_empty() && s.tip != usual);
    protocol.end();
    protocol.plan()?;
    Ok(Planned::of(protocol, Vec::new(), None))
}

/// Designs the presses that tell apart best what a report leaves open.
///
/// # Errors
///
/// Where the report cannot be read, the skin is another one, or it has no model.
pub fn next(
    request: &NextRequest,
    families: &Families,
    progress: &ProgressBar,
    stop: &Arc<AtomicBool>,
) -> Result<Planned> {
    let (report, beside) = read(&request.report)?;
    if !asks(report.verdict) {
        bail!("the report leaves nothing open that presses could settle: {}", report.sentence);
    }
    let skin = diagnosed(request.skin.as_deref(), &beside, &report)?;
    let make = |skin: &SkinDescription| families.model(skin).map_err(|e| format!("{e:#}"));
    let effects = families.of(&skin)?.effects();
    let simulator = Simulator { skin: &skin, effects, make: &make };
    let model = families.model(&skin)?;
    let range = range(&skin, model.as_ref());
    let locations = spread(&skin, &model, &range, LOCATIONS)?;
    let Open { hypotheses, beside, unknown } = open(&report, effects);
    let options = DesignOptions { minutes: request.minutes, range, beside, unknown };
    let found = design(&simulator, &hypotheses, &locations, &options, stop, progress)?;
    if found.blocks.is_empty() {
        bail!("no press fits into {} min: allow more with --minutes", request.minutes);
    }
    let names: Vec<&str> = hypotheses.iter().map(|h| h.name.as_str()).collect();
    let description = if names.len() > 1 {
        format!("tells apart {}", names.join(", "))
    } else {
        "shows whether the gap comes again, and where it lies".to_owned()
    };
    let mut protocol = Protocol::new(&format!("{}-next", skin.name), description, &skin, range, request.seed);
    protocol.add(&found.blocks);
    protocol.end();
    protocol.plan()?;
    Ok(Planned::of(protocol, found.separations, Some(unknown)))
}

/// Whether a verdict leaves something open that presses can settle.
pub(super) fn asks(verdict: Verdict) -> bool {
    !matches!(verdict, Verdict::NoGapBeyondNoise | Verdict::UnusableRecording)
}

/// A report, and the folder that it lies in.
pub(super) fn read(path: &Path) -> Result<(Report, PathBuf)> {
    let file = if path.is_dir() { path.join("report.json") } else { path.to_owned() };
    let text = dermis_io::read(&file, dermis_io::REPORT)
        .with_context(|| format!("{} cannot be read", file.display()))?;
    let report: Report = serde_json::from_slice(&text).with_context(|| {
        format!("{} is no report of `dermis gap diagnose --out` or `--json`", file.display())
    })?;
    let folder = file.parent().map(Path::to_owned).unwrap_or_default();
    Ok((report, folder))
}

/// The design that a report is of.
fn diagnosed(named: Option<&Path>, folder: &Path, report: &Report) -> Result<SkinDescription> {
    let beside = folder.join("skin.toml");
    let path = named.unwrap_or(&beside);
    if !path.exists() {
        bail!("{} is not there: name the skin that was diagnosed with --skin", path.display());
    }
    let mut skin = SkinDescription::load(path)?;
    if named.is_none() {
        skin.effects.retain(|e| !report.corrected.iter().any(|c| c.name == e.name));
    }
    if !skin.is_type(&report.data.skin_hash, &report.data.skin) {
        bail!(
            "{}: is another skin than `{}`, which the report is of: name that one with --skin",
            path.display(),
            report.data.skin
        );
    }
    Ok(skin)
}
