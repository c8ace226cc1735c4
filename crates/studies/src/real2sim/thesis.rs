//! Several contacts from few readings at the sizes and by the protocol of chapter 3 of the thesis (HapDefX).
//!
//! Problem: readings of a few gauges → locations and forces of one or two contacts, where only single contacts can be recorded.
//! Method: the three networks of [`dermis_learn::real2sim`], of whatever sizes the settings say; `launch/real2sim/thesis.toml` says
//! the thesis'. What is measured, on recordings that nothing was learned from:
//!
//! | findings | in the thesis |
//! |---|---|
//! | variance of the displacement maps that is unexplained (FVU), one and two contacts | section 3.3.2: 4 % and 29 % |
//! | the same by the number of virtual sensors and three kinds of transfer | Fig. 3.5 A |
//! | one contact by a network on the readings, by a network on the map, and by peaks | Fig. 3.8 |
//! | errors of place and force, one and two contacts | Table 3.2 |
//!
//! Assumptions: true maps are those of the nominal model under the true contacts, as in the thesis. Where the thesis is silent
//! (epochs, rates, the network from map to contact), the settings and [`methods`] say what is taken.
//!
//! Cost: one reconstruction network for each number of virtual sensors is nearly all of it. States of networks are kept, so that the
//! same request goes on where it was interrupted.

mod maps;
mod methods;
mod reduction;
mod strongest;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use dermis_inference::{Runtime, RuntimeConfig};
use dermis_learn::cli::Labels;
use dermis_learn::real2sim::{
    Compliance, Pipeline, PipelineSettings, Recorded, Scenes, Settings, Stages, Trained,
};
use dermis_learn::train::States;
use dermis_learn::{Dataset, frame_bounds};
use dermis_model::{ForwardModel, Unknowns};
use dermis_skin::SkinDescription;
use serde::{Deserialize, Serialize};

use super::compare::{self, Kind, MethodEvaluator, Row, Targets};
use super::train::parts;
use super::{nominal, sensors, watched};
use crate::{Families, LeftOut, Progress, labelled};

pub use maps::{Frames, MapRow};
pub use strongest::{Rule, Strongest};

/// Numbers of virtual sensors near each element that are tried (Fig. 3.5 A); fewer, where it is reduced.
const SENSORS: [usize; 5] = [1, 4, 12, 24, 48];

/// What to learn from, and what to measure on.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description; its forward model must know displacements.
    #[arg(long)]
    pub skin: PathBuf,
    /// Settings (TOML); `launch/real2sim/thesis.toml` has the sizes of the thesis.
    #[arg(long)]
    pub settings: Option<PathBuf>,
    /// Labelled bag with single contacts of the device, which everything is learned from.
    #[arg(long, required = true)]
    pub train: Vec<PathBuf>,
    /// Folder in which the states of networks are kept, so that the same command goes on where it was interrupted.
    #[arg(long, value_name = "DIR")]
    pub states: Option<PathBuf>,
    /// Fewer epochs, samples and numbers of virtual sensors; what was reduced is said. Networks keep their sizes.
    #[arg(long)]
    pub reduced: bool,
    /// Numbers of virtual sensors near each element that are compared.
    #[arg(long, value_delimiter = ',', default_values_t = Request::default().sensors)]
    pub sensors: Vec<usize>,
    /// Networks that are trained at once.
    #[arg(long, default_value_t = Request::default().jobs)]
    pub jobs: usize,
    /// Force [N] that every contact presses with at least.
    #[arg(long, default_value_t = Request::default().least)]
    pub least: f64,
    /// Readings of one contact, of two near each other, and of two far apart that are measured on at most.
    #[arg(long, default_value_t = Request::default().most)]
    pub most: usize,
    /// Recorded readings that support vectors are learned from at most.
    #[arg(long, default_value_t = Request::default().vectors)]
    pub vectors: usize,
    /// Ascending forces [N] at which the bins of errors by force begin.
    #[arg(long, value_delimiter = ',', default_values_t = Request::default().bins)]
    pub bins: Vec<f64>,
    /// How the bags are read.
    #[command(flatten)]
    pub labels: Labels,
    /// Labelled bags with one and two contacts of the same device, at locations and forces of other seeds.
    #[arg(required = true)]
    pub bags: Vec<PathBuf>,
}

impl Default for Request {
    fn default() -> Self {
        let compared = compare::Request::default();
        Self {
            skin: PathBuf::new(),
            settings: None,
            train: Vec::new(),
            states: None,
            reduced: false,
            sensors: SENSORS.to_vec(),
            jobs: 2,
            least: compared.least,
            most: compared.most,
            vectors: compared.vectors,
            bins: compared.bins,
            labels: Labels::default(),
            bags: Vec::new(),
        }
    }
}

/// Widths of the layers of the three networks: inputs, hidden ones, outputs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Sizes {
    /// Readings → virtual sensors.
    pub transfer: Vec<usize>,
    /// Virtual sensors → map.
    pub reconstruction: Vec<usize>,
    /// Peak → force.
    pub sensitivity: Vec<usize>,
}

impl Sizes {
    fn of(pipeline: &Pipeline) -> Self {
        let [transfer, reconstruction, sensitivity] = pipeline.layers().map(<[usize]>::to_vec);
        Self { transfer, reconstruction, sensitivity }
    }
}

/// Everything that was found.
#[derive(Debug, Serialize)]
pub struct Findings {
    /// Name of the skin.
    pub skin: String,
    /// Its hash.
    pub skin_hash: String,
    /// How the networks were made, after any reduction.
    pub settings: Settings,
    /// What was reduced, a sentence each; empty of a whole run.
    pub reduced: Vec<String>,
    /// Widths of layers.
    pub sizes: Sizes,
    /// Of the pipeline.
    pub trained: Trained,
    /// Hashes of what was learned from and of what was measured on.
    pub data: [String; 2],
    /// Frames of each kind that are measured on.
    pub frames: BTreeMap<&'static str, usize>,
    /// Touched frames that are left out, and why.
    pub left_out: Vec<LeftOut>,
    /// Maps, by number of virtual sensors and kind of transfer (Fig. 3.5 A).
    pub maps: Vec<MapRow>,
    /// Errors of contacts of each method and kind of frames; a contact that is not found counts.
    pub rows: Vec<Row>,
    /// Errors of the strongest peaks, as the thesis counts them (Table 3.2).
    pub strongest: Vec<Strongest>,
    /// The same of the true maps: how far peaks err where the map is known.
    pub strongest_of_true_maps: Vec<Strongest>,
    /// \[s\] that this run took, without what an earlier one had done.
    pub seconds: f64,
}

/// What everything is learned from.
struct Known {
    skin: SkinDescription,
    model: Arc<dyn ForwardModel>,
    settings: Settings,
    scenes: Scenes,
    recorded: Vec<Recorded>,
    choose: Vec<Recorded>,
    states: States,
}

impl Known {
    /// Settings for this number of virtual sensors near each element.
    fn settings_with(&self, each: usize) -> PipelineSettings {
        PipelineSettings { each, ..self.settings.pipeline.clone() }
    }
}

/// Trains and measures.
///
/// # Errors
///
/// Where skin, settings or bags cannot be read, or they hold nothing to learn from or to measure on.
pub fn measure(options: &Request, families: &Families, progress: &dyn Progress) -> Result<Findings> {
    let started = Instant::now();
    let (skin, model) = nominal(&options.skin, families, progress)?;
    let labels = options.labels.options()?;
    let learned = labelled(&options.train, &skin, &labels, progress)?;
    let data = labelled(&options.bags, &skin, &labels, progress)?;
    let mut settings = Settings::load(options.settings.as_deref())?;
    let mut options = options.clone();
    let reduced = if options.reduced { reduction::apply(&mut settings, &mut options) } else { Vec::new() };
    let compliance = Compliance::of(model.as_ref(), settings.scenes.diameter)?;
    let targets = Targets::of(&data, &of_comparison(&options), &compliance)?;
    let frames = Frames::of(&data, &targets, model.as_ref())?;

    let split = settings.split.apply(&learned)?;
    let (learn, choose) = parts(&learned, &split.train);
    let detectable = |ids: &[_], most: usize| {
        let mut all = Recorded::of(&learned, ids, settings.least, most)?;
        // What presses where nothing gives way shows in no reading.
        all.retain(|r| compliance.gives_way(&r.contact.position));
        anyhow::Ok(all)
    };
    let (recorded, choose) = (detectable(&learn, settings.most)?, detectable(&choose, settings.most / 3)?);
    let passing = tempfile::tempdir()?;
    let folder = options.states.clone().unwrap_or_else(|| passing.path().to_owned());
    let identity = identity(&skin, &learned, &settings)?;
    let known = Known {
        scenes: Scenes::new(model.as_ref(), &settings.scenes)?,
        states: States::new(&folder, identity)?,
        skin,
        model,
        settings,
        recorded,
        choose,
    };

    let runtime = Runtime::load(&RuntimeConfig::default())?;
    let (pipeline, trained, maps) = train(&known, &options, &frames, runtime, progress)?;
    let pipeline = Arc::new(pipeline);
    progress.begin("strongest peaks");
    let [strongest, of_true_maps] = strongest::of(&pipeline, known.model.surface(), &frames, runtime)?;
    let compared: Vec<_> = targets.compared().copied().collect();
    let bounds = frame_bounds(known.model.as_ref(), &data, Some(&compared), Unknowns::Normal)?;
    let evaluator =
        MethodEvaluator { data: &data, bounds: &bounds, bins: &options.bins, kept: targets.kept.as_ref() };
    let mut rows = Vec::new();
    for (name, mut method) in methods::all(&known, &pipeline, options.vectors, runtime, progress)? {
        progress.begin(&name);
        for (kind, ids) in &targets.all {
            if !(ids.is_empty() || (method.single() && *kind != Kind::Single)) {
                rows.push(evaluator.row(&name, method.as_mut(), (*kind, ids), progress)?);
            }
        }
    }
    Ok(Findings {
        skin: known.skin.name.clone(),
        skin_hash: known.skin.hash(),
        reduced,
        sizes: Sizes::of(&pipeline),
        trained,
        data: [learned.hash(), data.hash()],
        frames: targets.all.iter().map(|(kind, ids)| (kind.name(), ids.len())).collect(),
        left_out: targets.left_out,
        settings: known.settings,
        maps,
        rows,
        strongest,
        strongest_of_true_maps: of_true_maps,
        seconds: started.elapsed().as_secs_f64(),
    })
}

/// What all samples depend on, but for the number of virtual sensors, which states are named by.
fn identity(skin: &SkinDescription, learned: &Dataset, settings: &Settings) -> Result<String> {
    let mut settings = settings.clone();
    settings.pipeline.each = 0;
    Ok(format!("{} {} {}", skin.hash(), learned.hash(), serde_json::to_string(&settings)?))
}

/// Which frames are requested, as a comparison says it.
fn of_comparison(options: &Request) -> compare::Request {
    compare::Request { least: options.least, most: options.most, ..compare::Request::default() }
}

/// The pipeline, and maps by number of virtual sensors. So many as `jobs` says are trained at once.
fn train(
    known: &Known,
    options: &Request,
    frames: &Frames,
    runtime: &Runtime,
    progress: &dyn Progress,
) -> Result<(Pipeline, Trained, Vec<MapRow>)> {
    if options.sensors.contains(&0) || options.jobs == 0 {
        bail!("`--sensors` and `--jobs` are 1 or more");
    }
    let own = known.settings.pipeline.each;
    let watched_progress = watched(progress);
    let whole = || -> Result<(Pipeline, Trained)> {
        let virtual_sensors = sensors(&known.model, &known.skin, own)?;
        let stages = Stages {
            model: &known.model,
            sensors: &virtual_sensors,
            scenes: &known.scenes,
            settings: &known.settings.pipeline,
            states: Some(&known.states),
            progress: &watched_progress,
        };
        Ok(stages.train((&known.recorded, &known.choose), runtime)?)
    };
    // The pipeline's own number comes last: its networks are known then.
    let others: Vec<usize> = options.sensors.iter().copied().filter(|each| *each != own).collect();
    let (trained, rows) = std::thread::scope(|scope| {
        let first = (options.jobs > 1).then(|| scope.spawn(whole));
        let most = options.jobs.saturating_sub(1).max(1);
        let rows = maps::rows_of(known, &others, frames, most, &watched_progress);
        let trained = first.map_or_else(whole, |thread| match thread.join() {
            Ok(trained) => trained,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        (trained, rows)
    });
    let ((pipeline, report), mut all) = (trained?, rows?);
    if options.sensors.contains(&own) {
        all.extend(maps::rows(known, own, frames, &watched_progress)?);
    }
    all.sort_by_key(|row| row.each);
    Ok((pipeline, report, all))
}
