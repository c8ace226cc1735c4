//! Models that were trained elsewhere: an ONNX graph becomes a bundle that a node loads.

use std::collections::BTreeMap;
use std::path::Path;

use dermis_inference::onnx::{GraphTensor, Signature, listed, with_batch_of_one};
use dermis_inference::{
    Baseline, BundleWriter, FeatureConfig, Interface, Limits, Link, Manifest, Missing, Model, OutputConfig,
    OutputSpec, Outputs, Runtime, RuntimeKind, Taps, TensorPort, TrainingSection, rehearse_embedded,
};
use dermis_skin::{ImageGrid, SkinDescription};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::dataset::{Dataset, SampleId, Truth};
use crate::evaluate::Evaluation;
use crate::evaluator::GraphEvaluator;
use crate::findings::Findings;
use crate::plot::{Point, Report};
use crate::target::Maps;
use crate::{LearnError, SplitConfig, card};

/// One number for all channels, or one each.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PerChannel {
    /// The same for all.
    All(f32),
    /// In the order of the channels.
    Each(Vec<f32>),
}

impl PerChannel {
    fn over(&self, channels: usize) -> Vec<f32> {
        match self {
            Self::All(value) => vec![*value; channels],
            Self::Each(values) => values.clone(),
        }
    }
}

/// How one output becomes a value in SI units: `raw · scale + mean`, and a logistic function of it where it is a
/// logit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputScaling {
    /// Added after scaling.
    pub mean: f64,
    /// Factor.
    pub scale: f64,
    /// How the raw output becomes a value.
    pub link: Link,
}

impl Default for OutputScaling {
    fn default() -> Self {
        Self { mean: 0.0, scale: 1.0, link: Link::Linear }
    }
}

/// What a model takes and gives, where that is not the newest tared reading in the unit of the skin and SI units. A
/// file is TOML; unknown keys are errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Wiring {
    /// Free text for the bundle.
    pub description: String,
    /// Whether it takes readings minus their zero, or as they are.
    pub baseline: Baseline,
    /// Subtracted from the readings.
    pub mean: PerChannel,
    /// What they are divided by after that.
    pub scale: PerChannel,
    /// Frames that it sees.
    pub taps: Taps,
    /// \[s\] time constants of low-passed copies.
    pub low_pass: Vec<f64>,
    /// \[s\] spans of differences.
    pub difference: Vec<f64>,
    /// What stands in for an invalid channel.
    pub missing: Missing,
    /// \[s\] without a frame after which history starts anew.
    pub max_gap: f64,
    /// The image that it sees in place of the channels.
    pub image: Option<ImageGrid>,
    /// By the name of the output.
    pub outputs: BTreeMap<String, OutputScaling>,
}

impl Default for Wiring {
    fn default() -> Self {
        let newest = FeatureConfig::newest(Vec::new(), Vec::new());
        Self {
            description: String::new(),
            baseline: Baseline::Tared,
            mean: PerChannel::All(0.0),
            scale: PerChannel::All(1.0),
            taps: newest.taps,
            low_pass: newest.low_pass,
            difference: newest.difference,
            missing: newest.missing,
            max_gap: newest.max_gap,
            image: None,
            outputs: BTreeMap::new(),
        }
    }
}

impl Wiring {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// [`LearnError`] names the file and the field, or line and column.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, LearnError> {
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT).map_err(LearnError::io(path, "read"))?;
        let file = path.display().to_string();
        LearnError::of_toml(&text, &file)
    }

    fn features(&self, channels: usize) -> FeatureConfig {
        FeatureConfig {
            mean: self.mean.over(channels),
            scale: self.scale.over(channels),
            taps: self.taps.clone(),
            low_pass: self.low_pass.clone(),
            difference: self.difference.clone(),
            missing: self.missing,
            max_gap: self.max_gap,
            image: self.image,
        }
    }
}

/// What to make a bundle of.
pub struct ImportRequest<'a> {
    /// Skin that the model is for.
    pub skin: &'a SkinDescription,
    /// The `.onnx` file.
    pub onnx: &'a Path,
    /// Names of its outputs, in order.
    pub outputs: &'a [String],
    /// What it takes and gives.
    pub wiring: &'a Wiring,
    /// Data to measure it on, and the part that counts; all of them where it is `None`.
    pub data: Option<(&'a Dataset, Option<SplitConfig>)>,
    /// Folder of the bundle; an older bundle is replaced.
    pub out: &'a Path,
    /// Runtime of this process.
    pub runtime: &'a Runtime,
}

/// What became of it.
#[derive(Debug, Clone)]
pub struct Imported {
    /// Runtimes that ran the model.
    pub runtimes: Vec<String>,
    /// What it makes of the data, where there are some.
    pub measured: Option<Evaluation>,
}

/// Largest relative difference between two runtimes that is rounding.
const ROUNDING: f32 = 1e-3;

/// Checks a graph against the skin, runs it once in every runtime that is there, measures it where there are data, and
/// writes the bundle.
///
/// # Errors
///
/// [`LearnError::Unfit`] says all that does not fit and what to do.
pub fn import_onnx(request: &ImportRequest<'_>) -> Result<Imported, LearnError> {
    let place = format!("model file {}", request.onnx.display());
    let raw =
        dermis_io::read(request.onnx, dermis_io::TABLE).map_err(LearnError::io(request.onnx, "read"))?;
    let fitting = check(request, &raw, &place)?;
    let (model, runtimes) = trial(request, &fitting.graph, &fitting.interface, &fitting.signature, &place)?;
    let measured = measure(request, &fitting, model)?;
    write_bundle(request, fitting, measured.as_ref(), &runtimes)?;
    Ok(Imported { runtimes, measured: measured.map(|m| m.evaluation) })
}

/// A graph that fits the skin, and what it takes and gives.
struct Fitting {
    graph: Vec<u8>,
    signature: Signature,
    interface: Interface,
    features: FeatureConfig,
    outputs: OutputConfig,
}

/// Whether a graph takes what the skin gives and gives what was named.
fn check(request: &ImportRequest<'_>, raw: &[u8], place: &str) -> Result<Fitting, LearnError> {
    let (skin, wiring) = (request.skin, request.wiring);
    let mut findings = Findings::default();
    // A grid that is too large is refused before anything is made of its size.
    let numbers = wiring.image.map_or(skin.channels().len(), |grid| grid.numbers().min(ImageGrid::MOST + 1));
    let given = wiring.image.map_or_else(
        || format!("skin `{}` has {numbers} channels", skin.name),
        |_| format!("`image` has {numbers} numbers"),
    );
    let features = wiring.features(numbers);
    let outputs = outputs(request.outputs, wiring, &mut findings);
    if let Err(error) = features.validate() {
        findings.fatal("the model's input", error.to_string(), "correct the file of `--input`");
    } else if features.channels() != numbers {
        findings.fatal(
            "the model's input",
            format!("`mean` has {} entries where {given}", features.channels()),
            "give one number for all, or one each",
        );
    }
    let read = with_batch_of_one(raw).and_then(|graph| Ok((Signature::read(&graph)?, graph)));
    let (signature, graph) = match read {
        Ok(read) => read,
        Err(error) => {
            findings.fatal(place, error.to_string(), "");
            return Err(LearnError::Unfit(findings));
        }
    };
    let of = if wiring.image.is_some() { "numbers of `image`" } else { "channels" };
    let wanted = format!("{} numbers for the {numbers} {of} of skin `{}`", features.input_len(), skin.name);
    let inputs = ports(&signature.inputs, "input", features.input_len(), &wanted, place, &mut findings);
    let wanted = format!("{} numbers for {}", outputs.len(), request.outputs.join(", "));
    let outs = ports(&signature.outputs, "output", outputs.len(), &wanted, place, &mut findings);
    let foreign: Vec<String> = signature
        .opsets
        .iter()
        .filter(|(domain, _)| !matches!(domain.as_str(), "" | "ai.onnx" | "ai.onnx.ml"))
        .map(|(domain, version)| format!("{domain} {version}"))
        .collect();
    if !foreign.is_empty() {
        findings.notice(
            place,
            format!("imports the operators of {}", foreign.join(", ")),
            "not every runtime knows them",
        );
    }
    let (Some(inputs), Some(outs), false) = (inputs, outs, findings.is_fatal()) else {
        return Err(LearnError::Unfit(findings));
    };
    let interface = Interface::of(&inputs, &outs);
    Ok(Fitting { graph, signature, interface, features, outputs })
}

/// What a model makes of data.
struct Measured<'a> {
    data: &'a Dataset,
    split: Option<SplitConfig>,
    evaluation: Evaluation,
    points: Vec<Point>,
}

/// Measures the model, where there are data.
fn measure<'a>(
    request: &ImportRequest<'a>,
    fitting: &Fitting,
    model: Model,
) -> Result<Option<Measured<'a>>, LearnError> {
    let baseline = request.wiring.baseline;
    let decoder = Outputs::new(fitting.outputs.clone())?;
    let taken = (&fitting.features, baseline);
    let mut evaluator = GraphEvaluator::new(request.onnx, (model, decoder), taken, request.skin)?;
    let Some((data, split)) = request.data else { return Ok(None) };
    let targets = request.outputs.iter().map(String::as_str);
    let known: Vec<&str> = targets.filter(|t| Truth::TARGETS.contains(t)).collect();
    let found = data.check(&known, baseline, &split.unwrap_or_default());
    if split.is_some() && found.is_fatal() {
        return Err(LearnError::Unfit(found));
    }
    let (held_out, name) = SplitConfig::evaluated(split, data)?;
    // There is no forward model here: displacements are not compared.
    let maps = Maps::new(data.skin(), None, &[])?;
    let (evaluation, points) = evaluator.evaluate(data, held_out.as_deref(), maps, name)?;
    Ok(Some(Measured { data, split, evaluation, points }))
}

/// Writes the bundle, with what was measured of it.
fn write_bundle(
    request: &ImportRequest<'_>,
    fitting: Fitting,
    measured: Option<&Measured<'_>>,
    runtimes: &[String],
) -> Result<(), LearnError> {
    let (skin, wiring) = (request.skin, request.wiring);
    let Fitting { graph, signature, interface, features, outputs } = fitting;
    let training = TrainingSection {
        data_hash: measured.map(|m| m.data.hash()).unwrap_or_default(),
        held_out: measured.map(|m| m.evaluation.data.clone()).unwrap_or_default(),
        ..TrainingSection::default()
    };
    let mut manifest = Manifest::new(skin.name.clone(), skin, wiring.baseline, features, outputs, training);
    manifest.description.clone_from(&wiring.description);
    let mut report = Report::new(format!("Model for skin {}", skin.name));
    let mut card = BTreeMap::new();
    if let Some(Measured { data, split, evaluation, points }) = measured {
        card::measured(&mut manifest, evaluation);
        let ids: Vec<SampleId> = data.labelled().map(|(id, ..)| id).collect();
        manifest.force_range = card::force_range(data, &ids);
        card = card::of_measured(data, *split, evaluation)?;
        report.data(data, split.as_ref())?;
        report.section(&format!("Measured on: {}", evaluation.data), evaluation, points)?;
    }
    card.insert("origin".into(), json!({
        "file": request.onnx.file_name().map(|n| n.to_string_lossy()),
        "opsets": signature.opsets.iter().map(|(d, v)| json!({ "domain": d, "version": v })).collect::<Vec<_>>(),
        "runtimes": runtimes,
        "trained_by": "someone else: dermis knows only what it measured",
    }));
    card.insert("program".into(), json!(format!("dermis {}", env!("CARGO_PKG_VERSION"))));
    let mut writer = BundleWriter::new(manifest).with_interface(interface);
    writer.card = card;
    writer.write(request.out, &graph)?;
    if measured.is_some() {
        let path = request.out.join("report.html");
        std::fs::write(&path, report.html()).map_err(LearnError::io(&path, "written"))?;
    }
    Ok(())
}

/// Runs the graph once in the embedded runtime and once in the native one, where that is there.
fn trial(
    request: &ImportRequest<'_>,
    graph: &[u8],
    interface: &Interface,
    signature: &Signature,
    place: &str,
) -> Result<(Model, Vec<String>), LearnError> {
    let mut findings = Findings::default();
    let opset = signature.opsets.iter().find(|(d, _)| d.is_empty() || d == "ai.onnx").map_or(0, |(_, v)| *v);
    let refused = |findings: &mut Findings, error: &dyn std::fmt::Display| {
        findings.fatal(
            place,
            error.to_string(),
            format!("it is written in operator set {opset}; export it with opset 17, which every runtime here reads"),
        );
    };
    // It comes from outside: whether it can be run at all shows in a process of its own.
    let candidate = dermis_inference::trial::Candidate { graph, interface, ranges: &[] };
    if let Err(error) = dermis_inference::trial::check(request.runtime, &candidate, &Limits::default()) {
        refused(&mut findings, &error);
        return Err(LearnError::Unfit(findings));
    }
    let input: Vec<f32> =
        (0..interface.input_len().unwrap_or(0)).map(|i| (i % 7) as f32 * 0.1 - 0.3).collect();
    let embedded = rehearse_embedded(graph, interface, &input).map_err(|e| refused(&mut findings, &e)).ok();
    let model = Model::load(request.runtime, graph, interface).map_err(|e| refused(&mut findings, &e)).ok();
    let (Some(embedded), Some(mut model)) = (embedded, model) else {
        return Err(LearnError::Unfit(findings));
    };
    let mut runtimes = vec!["embedded".to_owned()];
    if request.runtime.report().kind == RuntimeKind::Native {
        let mut native = Vec::new();
        model.run(&input, &mut native)?;
        let differ = native.iter().zip(&embedded).any(|(a, b)| (a - b).abs() > ROUNDING * (1.0 + a.abs()));
        if differ {
            findings.fatal(
                place,
                format!("gives {native:?} in the native runtime and {embedded:?} in the embedded one for the same input"),
                "a bundle must not depend on the runtime; export it with opset 17 and without random operators",
            );
            return Err(LearnError::Unfit(findings));
        }
        runtimes.push(request.runtime.report().to_string());
    }
    Ok((model, runtimes))
}

fn outputs(names: &[String], wiring: &Wiring, findings: &mut Findings) -> OutputConfig {
    let mut values = Vec::new();
    for name in names {
        let unit = match name.split('.').next() {
            Some("position") => "m",
            Some("force") => "N",
            _ => "1",
        };
        if !Truth::TARGETS.contains(&name.as_str()) {
            findings.fatal(
                "the model's outputs",
                format!("`{name}` is none of {}", Truth::TARGETS.join(", ")),
                "name each number that comes out, in order",
            );
        }
        let scaling = wiring.outputs.get(name).copied().unwrap_or_default();
        let mut spec = OutputSpec::new(name.clone(), unit, scaling.mean, scaling.scale);
        spec.link = scaling.link;
        values.push(spec);
    }
    for name in wiring.outputs.keys().filter(|name| !names.contains(name)) {
        findings.fatal(
            "the model's outputs",
            format!("`{name}` is scaled but not given"),
            "name it in `--outputs`",
        );
    }
    let config = OutputConfig { values };
    if let Err(error) = config.validate() {
        findings.fatal(
            "the model's outputs",
            error.to_string(),
            "correct `--outputs` or the file of `--input`",
        );
    }
    config
}

/// The tensors on one side of a graph, in its order, where they have as many numbers together as are needed. Readings go into one.
fn ports(
    tensors: &[GraphTensor],
    side: &str,
    numbers: usize,
    wanted: &str,
    place: &str,
    findings: &mut Findings,
) -> Option<Vec<TensorPort>> {
    let wrong = match tensors {
        [] => Some("one is needed"),
        [_, _, ..] if side == "input" => {
            Some("one is needed; concatenate them along their last axis before the export")
        }
        _ => None,
    };
    if let Some(needed) = wrong {
        findings.fatal(
            place,
            format!("has {} {side}s: {}", tensors.len(), listed(tensors)),
            format!("{needed}, with {wanted}"),
        );
        return None;
    }
    let mut ports = Vec::new();
    for tensor in tensors {
        let Some(shape) = tensor.fixed().filter(|_| tensor.is_float()) else {
            let what = if tensor.is_float() { "leaves dimensions free" } else { "is not of 32-bit floats" };
            findings.fatal(
                place,
                format!("{side} {tensor} {what}"),
                "export it with float32 tensors of fixed shapes; only the batch, the first dimension, may be free",
            );
            continue;
        };
        ports.push(TensorPort { name: tensor.name.clone(), shape });
    }
    if ports.len() < tensors.len() {
        return None;
    }
    let found = ports.iter().map(|port| port.shape.iter().product::<usize>()).fold(0, usize::saturating_add);
    if found != numbers {
        let hint = if side == "input" {
            "train it on those channels, or say in a file of `--input` which taps, low_pass and difference it takes"
        } else {
            "name each number that comes out, in order, in `--outputs`"
        };
        let has = if let [tensor] = tensors {
            format!("{side} {tensor} has {found} numbers")
        } else {
            format!("{side}s {} have {found} numbers together", listed(tensors))
        };
        findings.fatal(place, format!("{has} where there are {wanted}"), hint);
        return None;
    }
    Some(ports)
}

#[cfg(test)]
mod tests;
