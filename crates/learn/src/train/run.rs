//! From a data set to a bundle.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dermis_inference::{
    BundleWriter, FeatureConfig, Interface, Manifest, Model, OutputConfig, Outputs, Runtime, TrainingSection,
};
use dermis_model::ForwardModel;
use serde_json::json;

use super::balance::Balance;
use super::candidates::Candidate;
use super::checkpoint::{self, signature};
use super::choose::{self, Choice, Table};
use super::config::TrainConfig;
use super::measure::{measure_features, measure_outputs};
use super::network::{Batch, Mlp, Progress, State, advance, seed_of};
use super::prepare::Preparation;
use super::processor::Processor;
use super::rows;
use crate::dataset::{Dataset, SampleId, Truth};
use crate::evaluate::Evaluation;
use crate::evaluator::GraphEvaluator;
use crate::plot::Report;
use crate::split::Split;
use crate::target::{MapTarget, Maps, Target};
use crate::{LearnError, card};

/// How often the state is saved.
const SAVE_EVERY: Duration = Duration::from_secs(10);

/// What to train, and where it goes.
pub struct Request<'a> {
    /// Labelled recordings.
    pub data: &'a Dataset,
    /// Recordings of other runs to report on, with a name each.
    pub others: &'a [(String, Dataset)],
    /// How.
    pub config: &'a TrainConfig,
    /// Forward model of the skin, for targets that it computes.
    pub model: Option<Arc<dyn ForwardModel>>,
    /// Folder of the bundle. Unfinished training lies beside it, in a folder of its name with `.partial` added.
    pub out: &'a Path,
    /// Goes on from an earlier, interrupted call.
    pub resume: bool,
    /// Networks that are fitted at the same time.
    pub threads: usize,
    /// What a convolutional network is fitted on.
    pub processor: Processor,
    /// Evaluates the graph on what was held out.
    pub runtime: &'a Runtime,
}

/// What came out.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// On what was held out.
    pub held_out: Evaluation,
    /// On the other runs, by name.
    pub others: Vec<(String, Evaluation)>,
    /// Samples trained on.
    pub samples: usize,
    /// Of so many labelled frames to learn from, one was: more than 1 where their rows would take more than 4 GiB.
    pub every: usize,
    /// \[s\] that fitting took.
    pub seconds: f64,
    /// Which regressors were judged, and which kept; of a configuration that names several.
    pub choice: Option<Choice>,
}

/// Folder in which the state of an unfinished bundle lies.
pub(super) fn partial(out: &Path) -> PathBuf {
    let mut name = out.file_name().unwrap_or_default().to_os_string();
    name.push(".partial");
    out.with_file_name(name)
}

/// Trains, evaluates on what was held out, and writes the bundle with its card and a report.
///
/// `progress` is called after every epoch of every network, from several threads. When `stop` is set, the state is
/// saved and training ends.
///
/// # Errors
///
/// [`LearnError::Interrupted`] says how to go on; every other variant says what is wrong with data, configuration
/// or files.
pub fn run(
    request: &Request<'_>,
    stop: &AtomicBool,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Outcome, LearnError> {
    let (data, config) = (request.data, request.config);
    check_framework(config)?;
    let outputs = config.outputs();
    let findings = data.check(&config.scalars(), config.baseline, &config.split);
    if findings.is_fatal() {
        return Err(LearnError::Unfit(findings));
    }
    let split = config.split.apply(data)?;
    let features = measure_features(data, config, &split)?;
    let mut maps =
        Maps::new(data.skin(), request.model.clone(), &config.maps())?.spread_by(config.force_profile);
    let specs = measure_outputs(data, &outputs, &split, &mut maps)?;
    let decoder = Outputs::new(specs.clone())?;
    let job = Job { request, split: &split, features: &features, outputs: &outputs, decoder: &decoder };
    let started = Instant::now();
    let Trained { graph, interface, samples, every, choice } =
        match (&config.network.conv, &config.network.image) {
            (None, None) => fit_dense(&job, &mut maps, stop, progress)?,
            (Some(conv), _) => fit_conv(&job, conv, maps, stop, progress)?,
            (None, Some(image)) => fit_image(&job, image, stop, progress)?,
        };
    let seconds = started.elapsed().as_secs_f64();
    let model = Model::load(request.runtime, &graph, &interface)?;
    let input = (&features, config.baseline);
    let mut evaluator = GraphEvaluator::new(request.out, (model, decoder), input, data.skin())?;
    let true_maps = || Maps::new(data.skin(), request.model.clone(), &config.maps());
    let (evaluation, points) =
        evaluator.evaluate(data, Some(&split.test), true_maps()?, config.split.describe())?;
    let mut others = Vec::new();
    for (name, other) in request.others {
        let (evaluation, points) =
            evaluator.evaluate(other, None, true_maps()?, format!("other run: {name}"))?;
        others.push((name.clone(), evaluation, points));
    }

    let outcome = Outcome {
        held_out: evaluation,
        others: others.iter().map(|(name, e, _)| (name.clone(), e.clone())).collect(),
        samples,
        every,
        seconds,
        choice,
    };
    let mut report = Report::new(format!("Model for skin {}", data.skin().name));
    report.data(data, Some(&config.split))?;
    report.section(&format!("Held out: {}", config.split.describe()), &outcome.held_out, &points)?;
    for (name, evaluation, points) in &others {
        report.section(&format!("Other run: {name}"), evaluation, points)?;
    }
    write_bundle(request, &split, features, specs, (&graph, interface), &outcome)?;
    let path = request.out.join("report.html");
    std::fs::write(&path, report.html()).map_err(LearnError::io(&path, "written"))?;
    // Best effort: what is left over does no harm, and the bundle is written.
    let _ = std::fs::remove_dir_all(partial(request.out));
    Ok(outcome)
}

/// What is fitted to what.
pub(super) struct Job<'a> {
    pub(super) request: &'a Request<'a>,
    pub(super) split: &'a Split,
    pub(super) features: &'a FeatureConfig,
    /// Names of the outputs, in order.
    pub(super) outputs: &'a [&'static str],
    pub(super) decoder: &'a Outputs,
}

/// A finished graph.
pub(super) struct Trained {
    pub(super) graph: Vec<u8>,
    pub(super) interface: Interface,
    /// Samples that it was fitted to: of so many, one.
    pub(super) samples: usize,
    pub(super) every: usize,
    pub(super) choice: Option<Choice>,
}

impl Job<'_> {
    /// A name for every number that comes out.
    pub(super) fn columns(&self) -> Vec<&'static str> {
        let specs = &self.decoder.config().values;
        let names = self.outputs.iter().zip(specs);
        names.flat_map(|(name, spec)| std::iter::repeat_n(*name, spec.count)).collect()
    }

    /// What should come out, in normalised units; NaN where it is not known.
    pub(super) fn targets(&self, truth: &Truth, maps: &mut Maps) -> Result<Vec<f32>, LearnError> {
        let mut targets = Vec::with_capacity(self.decoder.config().len());
        for name in self.outputs {
            match Target::of(name) {
                Some(Target::Map(map)) => encoded_map(maps, map, truth, self.decoder, &mut targets)?,
                _ => targets.push(target(truth, name, self.request.config, self.decoder)),
            }
        }
        Ok(targets)
    }

    /// How much each of them counts.
    pub(super) fn weights(&self, truth: &Truth, columns: &[&'static str]) -> Vec<f32> {
        columns.iter().map(|name| weight(truth, name, self.request.config, self.decoder)).collect()
    }
}

/// Fits the members of a dense network.
fn fit_dense(
    job: &Job<'_>,
    maps: &mut Maps,
    stop: &AtomicBool,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Trained, LearnError> {
    let (data, config) = (job.request.data, job.request.config);
    let held_out: BTreeSet<SampleId> = job.split.test.iter().copied().collect();
    let columns = job.columns();
    let width = job.features.input_len();
    let mut batch =
        Batch { outputs: columns.len(), logit: columns.last() == Some(&"contact"), ..Batch::default() };
    let mut balance = Balance::default();
    let mut ids = Vec::new();
    let every = rows::every(job.split.train.len(), width, columns.len());
    let mut seen = 0_usize;
    data.each_input(job.features, config.baseline, |id, row| {
        let truth = data.sample(id).and_then(|s| s.truth.as_ref());
        let Some(truth) = truth.filter(|_| !held_out.contains(&id)) else { return Ok(()) };
        seen += 1;
        if !(seen - 1).is_multiple_of(every) {
            return Ok(());
        }
        let targets = job.targets(truth, maps)?;
        if targets.iter().any(|t| !t.is_nan()) {
            ids.push(id);
            batch.inputs.extend_from_slice(row);
            batch.targets.extend(targets);
            batch.weights.extend(job.weights(truth, &columns));
            balance.push(truth);
        }
        Ok(())
    })?;
    if config.balance_force {
        balance.apply(&columns, &mut batch.weights);
    }
    if batch.is_empty() {
        return Err(no_rows());
    }
    let noise = data.skin().channel_noise();
    let preparation = Preparation::measure(config.network.input, job.features, &noise, &batch.inputs);
    batch.inputs = preparation.apply(&batch.inputs);
    batch.width = preparation.columns();
    let signature = signature(data, config)?;
    let written = |e| LearnError::Training { reason: format!("the graph cannot be written: {e}") };
    let interface = Interface::flat(width, columns.len());
    let samples = batch.len();
    if config.model.candidates.as_slice() == [Candidate::Network] {
        let networks = fit_all(job.request, &batch, &signature, stop, progress)?;
        let graph = Mlp::to_onnx(&networks, &preparation, "dermis").map_err(written)?;
        return Ok(Trained { graph, interface, samples, every, choice: None });
    }
    let table = Table::new(data, &batch, &ids, &columns, config)?;
    let Some(choice) = table.choose(config, stop)? else {
        let path = partial(job.request.out);
        return Err(LearnError::Interrupted { epoch: 0, epochs: config.training.epochs, path });
    };
    let networks = if choose::needs_network(&choice) {
        fit_all(job.request, &batch, &signature, stop, progress)?
    } else {
        Vec::new()
    };
    let kept = table
        .groups()
        .iter()
        .map(|group| Ok((group.clone(), table.kept(group, &choice, config.model.most)?)))
        .collect::<Result<Vec<_>, LearnError>>()?;
    let graph = choose::to_onnx(&networks, &kept, &preparation, columns.len()).map_err(written)?;
    Ok(Trained { graph, interface, samples, every, choice: Some(choice) })
}

#[cfg(feature = "train")]
use super::fit_image::fit_image;
#[cfg(feature = "train")]
use super::run_conv::fit_conv;

/// Refuses: the framework is not in this program.
#[cfg(not(feature = "train"))]
fn fit_conv(
    _: &Job<'_>,
    _: &super::ConvConfig,
    _: Maps,
    _: &AtomicBool,
    _: &(dyn Fn(Progress) + Sync),
) -> Result<Trained, LearnError> {
    Err(without_framework())
}

/// As [`fit_conv`].
#[cfg(not(feature = "train"))]
fn fit_image(
    _: &Job<'_>,
    _: &super::ImageConfig,
    _: &AtomicBool,
    _: &(dyn Fn(Progress) + Sync),
) -> Result<Trained, LearnError> {
    Err(without_framework())
}

/// What a program without the framework says before it reads anything.
pub(super) fn check_framework(config: &TrainConfig) -> Result<(), LearnError> {
    if (config.network.conv.is_some() || config.network.image.is_some()) && cfg!(not(feature = "train")) {
        return Err(without_framework());
    }
    Ok(())
}

fn without_framework() -> LearnError {
    LearnError::Training {
        reason: "`network.conv` and `network.image` ask for a convolutional network, and this program was built without the framework \
                 that fits them; build it with `cargo build --release -p dermis --features train`, or leave them out"
            .into(),
    }
}

pub(super) fn no_rows() -> LearnError {
    LearnError::Training {
        reason: "no sample of the training part has a long enough history; shorten `features` or raise \
                 `features.max_gap`"
            .into(),
    }
}

/// Value that the network should give, in normalised units; NaN where it does not matter.
fn target(truth: &Truth, name: &str, config: &TrainConfig, outputs: &Outputs) -> f32 {
    let Some(value) = truth.value(name) else { return f32::NAN };
    if name == "contact" {
        return value as f32;
    }
    let light = truth.value("force.normal").is_some_and(|f| f < config.position_min_force);
    if name.starts_with("position.") && light {
        return f32::NAN;
    }
    outputs.encode(name, value).unwrap_or(f32::NAN)
}

/// Appends a map in normalised units; NaN where it is not known.
fn encoded_map(
    maps: &mut Maps,
    map: MapTarget,
    truth: &Truth,
    outputs: &Outputs,
    targets: &mut Vec<f32>,
) -> Result<(), LearnError> {
    let mut values = Vec::with_capacity(maps.len(map));
    maps.append(map, truth, &mut values)?;
    targets.extend(values.into_iter().map(|v| outputs.encode(map.name(), v).unwrap_or(f32::NAN)));
    Ok(())
}

/// How much a target counts. A map counts as much as a scalar, whatever its number of points.
fn weight(truth: &Truth, name: &str, config: &TrainConfig, outputs: &Outputs) -> f32 {
    if matches!(Target::of(name), Some(Target::Map(_))) {
        return 1.0 / outputs.values(name).map_or(1, <[f64]>::len).max(1) as f32;
    }
    let full = config.position_full_force;
    match truth.value("force.normal").filter(|_| name.starts_with("position.") && full > 0.0) {
        Some(force) => (force / full).clamp(0.0, 1.0).powi(2) as f32,
        None => 1.0,
    }
}

fn fit_all(
    request: &Request<'_>,
    batch: &Batch,
    signature: &str,
    stop: &AtomicBool,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Vec<Mlp>, LearnError> {
    let config = request.config;
    let folder = partial(request.out);
    if !request.resume && folder.exists() {
        std::fs::remove_dir_all(&folder).map_err(LearnError::io(&folder, "written"))?;
    }
    std::fs::create_dir_all(&folder).map_err(LearnError::io(&folder, "written"))?;
    let members = config.network.members;
    let done: Vec<Mutex<Option<Result<State, LearnError>>>> =
        (0..members).map(|_| Mutex::new(None)).collect();
    let next = AtomicUsize::new(0);
    let work = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let (Some(slot), Ok(member)) = (done.get(index), u32::try_from(index)) else { return };
            let result = fit_member(request, batch, &folder, signature, member, stop, progress);
            if result.is_err() {
                stop.store(true, Ordering::Relaxed);
            }
            if let Ok(mut slot) = slot.lock() {
                *slot = Some(result);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..request.threads.clamp(1, members as usize) {
            scope.spawn(work);
        }
    });
    let states: Vec<State> =
        done.into_iter().filter_map(|slot| slot.into_inner().ok().flatten()).collect::<Result<_, _>>()?;
    let least = states.iter().map(|s| s.epoch).min().unwrap_or(0);
    if least < config.training.epochs || states.len() < members as usize {
        return Err(LearnError::Interrupted { epoch: least, epochs: config.training.epochs, path: folder });
    }
    Ok(states.into_iter().map(|s| s.network).collect())
}

fn fit_member(
    request: &Request<'_>,
    batch: &Batch,
    folder: &Path,
    signature: &str,
    member: u32,
    stop: &AtomicBool,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<State, LearnError> {
    let config = request.config;
    let fresh = Mlp::new(batch.width, batch.outputs, &config.network, seed_of(&config.training, member, 0));
    let file = checkpoint::path(folder, member);
    let mut state = if request.resume && file.exists() {
        checkpoint::load(&file, fresh, signature)?
    } else {
        State::new(fresh)
    };
    let mut saved = Instant::now();
    advance(&mut state, batch, &config.training, member, stop, &mut |state, epoch| {
        progress(epoch);
        if saved.elapsed() >= SAVE_EVERY {
            checkpoint::save(&file, state, signature)?;
            saved = Instant::now();
        }
        Ok(())
    })?;
    checkpoint::save(&file, &state, signature)?;
    Ok(state)
}

fn write_bundle(
    request: &Request<'_>,
    split: &Split,
    features: FeatureConfig,
    outputs: OutputConfig,
    (graph, interface): (&[u8], Interface),
    outcome: &Outcome,
) -> Result<(), LearnError> {
    let (data, config) = (request.data, request.config);
    let training = TrainingSection {
        data_hash: data.hash(),
        seed: config.training.seed,
        samples: outcome.samples as u64,
        held_out: config.split.describe(),
    };
    let mut manifest =
        Manifest::new(data.skin().name.clone(), data.skin(), config.baseline, features, outputs, training);
    manifest.description.clone_from(&config.description);
    card::measured(&mut manifest, &outcome.held_out);
    manifest.force_range = card::force_range(data, &split.train);

    let touched = |ids: &[SampleId]| {
        ids.iter().filter_map(|id| data.sample(*id)?.truth.as_ref()).filter(|t| t.touched()).count()
    };
    let mut writer = BundleWriter::new(manifest).with_interface(interface);
    writer.card = card::of_data(data)?;
    let card = [
        (
            "samples",
            json!({
                "training": { "all": split.train.len(), "touched": touched(&split.train), "used": outcome.samples, "every": outcome.every },
                "held_out": { "all": split.test.len(), "touched": touched(&split.test) },
            }),
        ),
        ("split", json!(config.split)),
        ("split_in_words", json!(config.split.describe())),
        ("config", json!(config)),
        ("seed", json!(config.training.seed)),
        ("held_out", outcome.held_out.to_json()),
        (
            "other_runs",
            outcome.others.iter().map(|(name, e)| json!({ "name": name, "result": e.to_json() })).collect(),
        ),
        ("fit_seconds", json!(outcome.seconds)),
        ("processor", json!(request.processor.to_string())),
    ];
    let choice = outcome.choice.as_ref().map(|choice| ("choice", json!(choice)));
    let card = card.into_iter().chain(choice);
    writer.card.extend(card.map(|(key, value)| (key.to_owned(), value)));
    writer.write(request.out, graph)?;
    Ok(())
}

#[cfg(test)]
mod tests;
