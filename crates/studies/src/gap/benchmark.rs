//! The check of the diagnosis: reports first, sealed by their hash; then the ground truths are opened and the reports scored.

mod reports;
mod scoring;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;
use dermis_gap_benchmark::score::{Mapping, Scorecard};
use dermis_gap_benchmark::set::Manifest;
use dermis_skin::SkinDescription;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

use self::scoring::Scoring;
use super::scorecard;
use crate::{Families, Progress};

/// Which benchmark sets to check on.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Folder of a benchmark set; several are scored together, of one skin or of several.
    #[arg(long, alias = "pack", required = true, value_name = "DIR")]
    #[serde(alias = "pack")]
    pub set: Vec<PathBuf>,
    /// Folder of the ground truths of each set, in the same order. Without them the reports are written and sealed, and nothing is
    /// opened.
    #[arg(long, alias = "secret", value_name = "DIR")]
    #[serde(alias = "secret")]
    pub truth: Vec<PathBuf>,
    /// Folder for reports, their hashes, scores.json (every case) and summary.json, .md and .svg; reports that are there already
    /// are not made again.
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Diagnoses at once.
    #[arg(long, default_value_t = Request::default().jobs)]
    pub jobs: usize,
    /// Leave the baselines out.
    #[arg(long)]
    pub no_baselines: bool,
    /// Do not try what reports switch on in another recording of the same reference device.
    #[arg(long)]
    pub no_elsewhere: bool,
    /// How often each case may ask for presses (`dermis gap next`), which its reference device does, before it answers again; scored beside
    /// the first answers. Needs the ground truths.
    #[arg(long, value_name = "K", default_value_t = 0)]
    pub follow_ups: usize,
    /// Minutes of pressing that a case may ask for each time.
    #[arg(long, value_name = "MIN", default_value_t = Request::default().follow_up_minutes)]
    pub follow_up_minutes: f64,
    /// Passed on to every diagnosis, e.g. --resamples 0.
    #[arg(last = true)]
    pub diagnose: Vec<String>,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            set: Vec::new(),
            truth: Vec::new(),
            out: PathBuf::new(),
            jobs: 1,
            no_baselines: false,
            no_elsewhere: false,
            follow_ups: 0,
            follow_up_minutes: 3.0,
            diagnose: Vec::new(),
        }
    }
}

/// Skin file, bag and further options of one diagnosis → its report as JSON.
pub type Diagnose<'a> = &'a (dyn Fn(&Path, &Path, &[String]) -> Result<Vec<u8>> + Sync);

/// What became of the sets.
pub enum Findings {
    /// Nothing was opened: the folder of the reports of each set, and the hash of their list.
    Sealed(Vec<(PathBuf, String)>),
    /// The scores.
    Scored(Box<BenchmarkScores>),
}

/// Scores of opened sets.
pub struct BenchmarkScores {
    /// Which tool, command and sets.
    pub head: Value,
    /// Name of the skin.
    pub skin: String,
    /// Of the diagnosis.
    pub scorecard: Scorecard,
    /// After each number of follow-ups, from one on.
    pub followed: Vec<Scorecard>,
    /// Of simpler ways.
    pub baselines: Vec<(String, Scorecard)>,
    /// Every case with its answer.
    pub cases: Value,
}

impl BenchmarkScores {
    /// Without the single cases.
    #[must_use]
    pub fn summary(&self) -> Value {
        scorecard::json(&self.head, &self.scorecard, &self.followed, &self.baselines)
    }
}

impl Serialize for BenchmarkScores {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut whole = self.summary();
        whole["cases"] = self.cases.clone();
        whole.serialize(serializer)
    }
}

/// Diagnoses, seals, opens, scores.
///
/// # Errors
///
/// Where a set or its ground truths cannot be read, a diagnosis fails, or reports were changed after they were sealed.
pub fn run(
    options: &Request,
    families: &Families,
    diagnosis: Diagnose<'_>,
    progress: &dyn Progress,
) -> Result<Findings> {
    if !options.truth.is_empty() && options.truth.len() != options.set.len() {
        bail!(
            "{} benchmark sets and {} folders of ground truths: name one for each set, or none to seal the reports only",
            options.set.len(),
            options.truth.len()
        );
    }
    let manifests: Vec<Manifest> =
        options.set.iter().map(|dir| Manifest::load(dir)).collect::<Result<_, _>>()?;
    let seals = reports::sealed(options, &manifests, diagnosis, progress)?;
    if options.truth.is_empty() {
        return Ok(Findings::Sealed(seals));
    }
    // From here on the reports must not change: their hashes lie on the disk.
    let mapping = Mapping::from_toml(Mapping::TEXT).map_err(anyhow::Error::msg)?;
    let mut cases = reports::opened(options, &manifests, &seals)?;
    let library = reports::library(&cases);
    let skins: Vec<SkinDescription> = options
        .set
        .iter()
        .map(|folder| SkinDescription::load(folder.join("skin.toml")))
        .collect::<Result<_, _>>()?;
    let scoring = Scoring { options, families, progress, skins, mapping, library };
    if !options.no_elsewhere {
        scoring.elsewhere(&mut cases)?;
    }
    let scorecard = scoring.scorecard(&cases, cases.iter().map(|c| &c.answer));
    let mut followed = Vec::new();
    for times in 1..=options.follow_ups {
        let answers = scoring.follow(times, &cases, &seals, diagnosis)?;
        followed.push(scoring.scorecard(&cases, &answers));
    }
    let baselines = if options.no_baselines { Vec::new() } else { scoring.baselines(&cases)? };
    Ok(Findings::Scored(Box::new(BenchmarkScores {
        head: scoring.head(&manifests, &seals)?,
        skin: scoring.skin(),
        scorecard,
        followed,
        baselines,
        cases: scoring.answered(&cases),
    })))
}
