//! Experiments on skins as a library: a request goes in, findings come out, and both go through serde.
//!
//! A request says what a command line says, with the same names, units and defaults; clap reads it there, serde reads it
//! from a file. Findings serialise to the record that `--json` prints. What only a person reads (text, HTML, figures) is made
//! of them in `dermis-report`.
//!
//! No study names a sensor family: models, estimators and candidates come from [`Families`].

pub mod bounds;
pub mod comparison;
pub mod evaluation;
pub mod flat;
pub mod gap;
pub mod placement;
pub mod real2sim;
pub mod refinement;
mod regressions;
pub mod sweep;
pub mod variation;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use dermis_inference::{Runtime, RuntimeConfig};
use dermis_learn::{Dataset, DatasetOptions};
use dermis_model::ForwardModel;
use dermis_sensor::{Registry, Sensor};
use dermis_skin::{Estimator, SkinDescription};
use serde::Serialize;

/// The sensor families that studies ask for models, estimators and candidates.
#[derive(Debug, Clone, Copy)]
pub struct Families {
    sensors: &'static Registry,
}

impl Families {
    /// Those that a program knows.
    #[must_use]
    pub const fn new(sensors: &'static Registry) -> Self {
        Self { sensors }
    }

    /// The family that reads a skin.
    ///
    /// # Errors
    ///
    /// Where none does.
    pub fn of(&self, skin: &SkinDescription) -> Result<&'static dyn Sensor> {
        Ok(self.sensors.of(skin)?)
    }

    /// The forward model of a skin, with the effects that its description switches on.
    ///
    /// # Errors
    ///
    /// Where the family has no such model, or the skin cannot be.
    pub fn model(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>> {
        Ok(self.of(skin)?.model(skin)?)
    }

    /// The forward model of a skin that was read from `path`; refusals name that file.
    ///
    /// # Errors
    ///
    /// As [`model`](Self::model).
    pub fn model_of_file(&self, path: &Path, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>> {
        Ok(self.of(skin)?.model(skin).map_err(|error| error.in_file(path))?)
    }

    /// The estimator that the family's node runs with these model bundles.
    ///
    /// # Errors
    ///
    /// Where a bundle does not fit, or cannot be read.
    pub fn estimator(&self, skin: &SkinDescription, bundles: &[PathBuf]) -> Result<Box<dyn Estimator>> {
        let runtime = Runtime::load(&RuntimeConfig::default())?;
        Ok(dermis_estimate::estimator(self.of(skin)?, skin, bundles, &[], runtime)?)
    }

    /// What finds the contacts of a skin without a bundle, on its forward model.
    ///
    /// # Errors
    ///
    /// Where the skin has no forward model.
    pub fn inverting(&self, skin: &SkinDescription) -> Result<Box<dyn Estimator>> {
        Ok(dermis_estimate::inverting(self.of(skin)?, skin, &[])?)
    }
}

/// Frames that a figure leaves out, and why; the figure with everything stands before it where there is one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LeftOut {
    /// Frames.
    pub frames: usize,
    /// Share of all touched frames.
    pub share: f64,
    /// Why.
    pub reason: String,
}

impl LeftOut {
    /// Those of `all` frames that there are, by reason.
    fn list(all: usize, reasons: &[(usize, String)]) -> Vec<Self> {
        let of = |(frames, reason): &(usize, String)| Self {
            frames: *frames,
            share: *frames as f64 / all.max(1) as f64,
            reason: reason.clone(),
        };
        reasons.iter().filter(|(frames, _)| *frames > 0).map(of).collect()
    }
}

impl std::fmt::Display for LeftOut {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "left out, {:.1} % of the touched frames: {}", self.share * 100.0, self.reason)
    }
}

/// Labelled bags; a note says what of them is left out.
fn labelled(
    bags: &[PathBuf],
    skin: &SkinDescription,
    options: &DatasetOptions,
    progress: &dyn Progress,
) -> Result<Dataset> {
    let data = Dataset::from_bags(bags, skin, options)?;
    data.notices().iter().for_each(|notice| progress.note(notice));
    Ok(data)
}

/// What a bundle is called beside others: its folder.
fn called(folder: &Path) -> String {
    folder.file_name().map_or_else(|| folder.display().to_string(), |n| n.to_string_lossy().into())
}

/// Who watches a study.
pub trait Progress: Sync {
    /// A step begins.
    fn begin(&self, step: &str);

    /// This share of the step is done, from 0 to 1; `false` ends the study early, where it can end early.
    fn at(&self, share: f64) -> bool;

    /// Something that a person should know of the input.
    fn note(&self, sentence: &str);
}

/// Nobody watches; notes are lost.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unwatched;

impl Progress for Unwatched {
    fn begin(&self, _: &str) {}

    fn at(&self, _: f64) -> bool {
        true
    }

    fn note(&self, _: &str) {}
}
