//! What a benchmark's cases answer after they have asked for presses: report → `gap next` → the reference device presses → diagnosis of
//! all recordings.
//!
//! The reference device presses in a process that has opened the ground truth; the diagnosis sees skin and
//! bags only, as the first one did. A follow-up is recorded after the device was switched on anew, on
//! material as it was at first: wear and set of the presses before are not carried over.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use dermis_gap_benchmark::Designs;
use dermis_gap_benchmark::set::{self, GroundTruth};
use dermis_skin::SkinDescription;
use indicatif::ProgressBar;

use super::benchmark::Diagnose;
use super::planning::{NextRequest, asks, next, read};
use crate::Families;

/// One case that asks.
pub(super) struct Asking<'a> {
    pub skin_file: &'a Path,
    pub skin: &'a SkinDescription,
    pub truth: &'a GroundTruth,
    pub bag: &'a Path,
    /// Its first report.
    pub report: PathBuf,
    /// Folder for what follows.
    pub folder: PathBuf,
}

/// Asks so many times, and gives the last report. What lies in the folder already is not made again.
pub(super) fn ask(
    case: &Asking<'_>,
    (times, minutes): (usize, f64),
    more: &[String],
    families: &Families,
    diagnosis: Diagnose<'_>,
) -> Result<PathBuf> {
    std::fs::create_dir_all(&case.folder)
        .with_context(|| format!("{} cannot be made", case.folder.display()))?;
    let mut report = case.report.clone();
    let mut bags: Vec<PathBuf> = Vec::new();
    let make = |skin: &SkinDescription| families.model(skin).map_err(|e| format!("{e:#}"));
    let designs = Designs::new(&make);
    for time in 1..=times {
        let bag = case.folder.join(format!("bag-{time}"));
        let answer = case.folder.join(format!("report-{time}.json"));
        if !answer.exists() && !asks(read(&report)?.0.verdict) {
            return Ok(report);
        }
        if !answer.exists() {
            // What an interrupted run has left is no recording.
            let _ = std::fs::remove_dir_all(&bag);
            let request = NextRequest {
                report: report.clone(),
                skin: Some(case.skin_file.to_owned()),
                minutes,
                seed: time as u64,
            };
            let planned = next(&request, families, &ProgressBar::hidden(), &std::sync::Arc::default())?;
            let plan = planned.protocol.plan_text();
            set::press(case.skin, case.truth, &designs, &plan, time as u64, &bag)?;
            let mut arguments = more.to_vec();
            for bag in bags.iter().chain([&bag]) {
                arguments.extend(["--and".to_owned(), bag.display().to_string()]);
            }
            let said = diagnosis(case.skin_file, case.bag, &arguments)?;
            let part = answer.with_extension("part");
            std::fs::write(&part, &said).with_context(|| format!("{} cannot be written", part.display()))?;
            std::fs::rename(&part, &answer)
                .with_context(|| format!("{} cannot be made", answer.display()))?;
        }
        bags.push(bag);
        report = answer;
    }
    Ok(report)
}
