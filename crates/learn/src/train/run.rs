//! From a data set to a bundle.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use dermis_inference::{
    Baseline, BundleWriter, FeatureConfig, Interface, Link, Manifest, Model, OutputConfig, OutputSpec,
    Outputs, Runtime, TrainingSection,
};
use serde_json::json;
use sha2::{Digest, Sha256};

use super::checkpoint;
use super::config::{Scaling, TrainConfig};
use super::network::{Batch, Mlp, Progress, State, advance, seed_of};
use super::prepare::Preparation;
use crate::dataset::{Dataset, SampleId, Truth, hex};
use crate::evaluate::Evaluation;
use crate::findings::Findings;
use crate::judge::Judge;
use crate::metrics::{FORCE_BINS, bin_of};
use crate::plot::Report;
use crate::split::Split;
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
    /// Folder of the bundle. Unfinished training lies beside it, in a folder of its name with `.partial` added.
    pub out: &'a Path,
    /// Goes on from an earlier, interrupted call.
    pub resume: bool,
    /// Networks that are fitted at the same time.
    pub threads: usize,
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
    /// \[s\] that fitting took.
    pub seconds: f64,
}

/// Folder in which the state of an unfinished bundle lies.
fn partial(out: &Path) -> PathBuf {
    let mut name = out.file_name().unwrap_or_default().to_os_string();
    name.push(".partial");
    out.with_file_name(name)
}

/// Trains, evaluates on what was held out, and writes the bundle with its card and a report.
///
/// `told` is called after every epoch of every network, from several threads. When `stop` is set, the state is
/// saved and training ends.
///
/// # Errors
///
/// [`LearnError::Interrupted`] says how to go on; every other variant says what is wrong with data, configuration
/// or files.
pub fn run(
    request: &Request<'_>,
    stop: &AtomicBool,
    told: &(dyn Fn(Progress) + Sync),
) -> Result<Outcome, LearnError> {
    let (data, config) = (request.data, request.config);
    let outputs = config.outputs();
    let findings = data.check(&outputs, config.baseline, &config.split);
    if findings.is_fatal() {
        return Err(LearnError::Unfit(findings));
    }
    let split = config.split.apply(data)?;
    let features = measure_features(data, config, &split)?;
    let (ids, rows) = data.inputs(&features, config.baseline)?;
    let width = features.input_len();
    let held_out: BTreeSet<SampleId> = split.test.iter().copied().collect();
    let specs = measure_outputs(data, &outputs, &split)?;
    let decoder = Outputs::new(specs.clone())?;

    let mut batch =
        Batch { outputs: outputs.len(), logit: outputs.last() == Some(&"contact"), ..Batch::default() };
    let mut balance = Balance::default();
    for (id, row) in ids.iter().zip(rows.chunks_exact(width)) {
        if held_out.contains(id) {
            continue;
        }
        let Some(truth) = data.sample(*id).and_then(|s| s.truth.as_ref()) else { continue };
        let targets: Vec<f32> = outputs.iter().map(|name| target(truth, name, config, &decoder)).collect();
        if targets.iter().any(|t| !t.is_nan()) {
            batch.inputs.extend_from_slice(row);
            batch.targets.extend(targets);
            batch.weights.extend(outputs.iter().map(|name| weight(truth, name, config)));
            balance.push(truth);
        }
    }
    if config.balance_force {
        balance.apply(&outputs, &mut batch.weights);
    }
    if batch.is_empty() {
        return Err(no_rows());
    }
    let noise = data.skin().channel_noise();
    let preparation = Preparation::measure(config.network.input, &features, &noise, &batch.inputs);
    batch.inputs = preparation.apply(&batch.inputs);
    batch.width = preparation.columns();

    let started = Instant::now();
    let signature = signature(data, config)?;
    let networks = fit_all(request, &batch, &signature, stop, told)?;
    let seconds = started.elapsed().as_secs_f64();
    let graph = Mlp::to_onnx(&networks, &preparation, "dermis")
        .map_err(|e| LearnError::Training { reason: format!("the graph cannot be written: {e}") })?;

    let interface = Interface::flat(width, outputs.len());
    let mut judge = Judge {
        model: Model::load(request.runtime, &graph, &interface)?,
        outputs: decoder,
        features: &features,
        baseline: config.baseline,
    };
    let (evaluation, points) = judge.evaluate(data, Some(&held_out), config.split.describe())?;
    let mut others = Vec::new();
    for (name, other) in request.others {
        let (evaluation, points) = judge.evaluate(other, None, format!("other run: {name}"))?;
        others.push((name.clone(), evaluation, points));
    }

    let outcome = Outcome {
        held_out: evaluation,
        others: others.iter().map(|(name, e, _)| (name.clone(), e.clone())).collect(),
        samples: batch.len(),
        seconds,
    };
    let mut report = Report::new(format!("Model for skin {}", data.skin().name));
    report.data(data, Some(&config.split));
    report.section(&format!("Held out: {}", config.split.describe()), &outcome.held_out, &points);
    for (name, evaluation, points) in &others {
        report.section(&format!("Other run: {name}"), evaluation, points);
    }
    write_bundle(request, &split, features, specs, &graph, &outcome)?;
    let path = request.out.join("report.html");
    std::fs::write(&path, report.html()).map_err(LearnError::io(&path, "written"))?;
    // Best effort: what is left over does no harm, and the bundle is written.
    let _ = std::fs::remove_dir_all(partial(request.out));
    Ok(outcome)
}

fn no_rows() -> LearnError {
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

/// How much a target counts.
fn weight(truth: &Truth, name: &str, config: &TrainConfig) -> f32 {
    let full = config.position_full_force;
    match truth.value("force.normal").filter(|_| name.starts_with("position.") && full > 0.0) {
        Some(force) => (force / full).clamp(0.0, 1.0).powi(2) as f32,
        None => 1.0,
    }
}

/// Largest factor between the weights of two samples of different force: a range of few samples must not become the
/// noise of every step.
const MOST_BALANCE: f32 = 10.0;

/// How many samples each range of force has.
#[derive(Default)]
struct Balance {
    /// Range of every sample; `None` where its force is unknown.
    ranges: Vec<Option<usize>>,
    counts: [usize; FORCE_BINS.len() + 1],
}

impl Balance {
    fn push(&mut self, truth: &Truth) {
        let range = match truth.value("force.normal") {
            Some(_) if !truth.touched() => Some(0),
            Some(force) => Some(bin_of(force) + 1),
            None => None,
        };
        if let Some(range) = range {
            self.counts[range] += 1;
        }
        self.ranges.push(range);
    }

    /// Makes every range count alike for the forces; the mean weight stays what it was.
    fn apply(&self, outputs: &[&'static str], weights: &mut [f32]) {
        let most = self.counts.iter().copied().max().unwrap_or(0) as f32;
        let factor = |range: usize| (most / self.counts[range] as f32).min(MOST_BALANCE);
        let total: f32 = self.ranges.iter().map(|r| r.map_or(1.0, factor)).sum();
        let mean = total / self.ranges.len().max(1) as f32;
        for (range, row) in self.ranges.iter().zip(weights.chunks_exact_mut(outputs.len())) {
            let factor = range.map_or(1.0, factor) / mean;
            for (weight, _) in row.iter_mut().zip(outputs).filter(|(_, o)| o.starts_with("force.")) {
                *weight *= factor;
            }
        }
    }
}

#[derive(Default, Clone, Copy)]
struct Moments {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Moments {
    fn push(&mut self, value: f64) {
        self.count += 1.0;
        let delta = value - self.mean;
        self.mean += delta / self.count;
        self.squares += delta * (value - self.mean);
    }

    fn deviation(&self) -> f64 {
        if self.count > 1.0 { (self.squares / self.count).sqrt() } else { 0.0 }
    }
}

/// Mean and scale of every channel over the touched samples of the training part.
fn measure_features(
    data: &Dataset,
    config: &TrainConfig,
    split: &Split,
) -> Result<FeatureConfig, LearnError> {
    let noise = data.skin().channel_noise();
    let mut moments = vec![Moments::default(); noise.len()];
    for id in &split.train {
        let Some(sample) = data.sample(*id) else { continue };
        if !sample.truth.as_ref().is_some_and(Truth::touched) {
            continue;
        }
        let values = match config.baseline {
            Baseline::Tared => &sample.tared,
            Baseline::Raw => &sample.frame.values,
        };
        for (m, v) in moments.iter_mut().zip(values).filter(|(_, v)| v.is_finite()) {
            m.push(f64::from(*v));
        }
    }
    if moments.iter().all(|m| m.count == 0.0) {
        return Err(no_rows());
    }
    let mean = moments.iter().map(|m| m.mean as f32).collect();
    let common = (moments.iter().map(|m| m.deviation().powi(2)).sum::<f64>() / moments.len() as f64).sqrt();
    let scale = moments
        .iter()
        .zip(&noise)
        .map(|(m, noise)| {
            let scale = match config.features.scaling {
                Scaling::Channel => m.deviation(),
                Scaling::Common => common,
            };
            // A channel that never moved would blow its noise up.
            scale.max(*noise) as f32
        })
        .collect();
    let features = config.features.with(mean, scale);
    features.validate()?;
    Ok(features)
}

/// De-normalisation of every output over the training part.
fn measure_outputs(
    data: &Dataset,
    outputs: &[&'static str],
    split: &Split,
) -> Result<OutputConfig, LearnError> {
    // The positions share a scale, so that an error counts the same in every direction; so do the forces.
    let mut moments: BTreeMap<&str, Moments> = BTreeMap::new();
    for truth in split.train.iter().filter_map(|id| data.sample(*id)?.truth.as_ref()) {
        for name in outputs {
            if let Some(value) = truth.value(name) {
                moments.entry(name).or_default().push(value);
            }
        }
    }
    let mut specs = Vec::new();
    for name in outputs {
        if *name == "contact" {
            let mut spec = OutputSpec::new(*name, "1", 0.0, 1.0);
            spec.link = Link::Logistic;
            specs.push(spec);
            continue;
        }
        let family = if name.starts_with("position.") { "position." } else { "force." };
        let scale = moments
            .iter()
            .filter(|(n, _)| n.starts_with(family))
            .map(|(_, m)| m.deviation())
            .fold(0.0, f64::max);
        if scale <= 0.0 {
            let mut findings = Findings::default();
            findings.fatal(
                "the training part",
                format!("`{name}` is the same in all {} samples", moments.get(name).map_or(0.0, |m| m.count)),
                "it cannot be learned; leave it out or record other presses",
            );
            return Err(LearnError::Unfit(findings));
        }
        let mean = moments.get(name).map_or(0.0, |m| m.mean);
        let unit = if family == "position." { "m" } else { "N" };
        specs.push(OutputSpec::new(*name, unit, mean, scale));
    }
    let specs = OutputConfig { values: specs };
    specs.validate()?;
    Ok(specs)
}

/// Names everything that a checkpoint depends on.
fn signature(data: &Dataset, config: &TrainConfig) -> Result<String, LearnError> {
    let mut hasher = Sha256::new();
    hasher.update(data.skin().hash().as_bytes());
    hasher.update(data.hash().as_bytes());
    let config = serde_json::to_vec(config).map_err(|e| LearnError::Training { reason: e.to_string() })?;
    hasher.update(config);
    Ok(hex(&hasher.finalize()))
}

fn fit_all(
    request: &Request<'_>,
    batch: &Batch,
    signature: &str,
    stop: &AtomicBool,
    told: &(dyn Fn(Progress) + Sync),
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
            let result = fit_member(request, batch, &folder, signature, member, stop, told);
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
    told: &(dyn Fn(Progress) + Sync),
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
    advance(&mut state, batch, &config.training, member, stop, &mut |state, progress| {
        told(progress);
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
    graph: &[u8],
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
    let mut writer = BundleWriter::new(manifest);
    writer.card = card::of_data(data);
    let card = [
        (
            "samples",
            json!({
                "training": { "all": split.train.len(), "touched": touched(&split.train), "used": outcome.samples },
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
    ];
    writer.card.extend(card.into_iter().map(|(key, value)| (key.to_owned(), value)));
    writer.write(request.out, graph)?;
    Ok(())
}

#[cfg(test)]
mod tests;
