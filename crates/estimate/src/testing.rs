//! Small skins, models and bundles for tests.

#![allow(clippy::unwrap_used, clippy::missing_panics_doc, missing_docs, reason = "for tests only")]

use std::path::Path;
use std::sync::Arc;

use dermis_fixtures::{Analytic, SkinFile};
use dermis_inference::onnx::GraphBuilder;
use dermis_inference::{
    Baseline, Bundle, BundleWriter, FeatureConfig, ForcePeakSection, Link, MAP_DISPLACEMENT, MAP_NORMAL,
    Manifest, ModelSection, OutputConfig, OutputSpec, PeakSection, Runtime, RuntimeConfig, Taps,
    TrainingSection,
};
use dermis_inversion::{PeakSettings, Settings};
use dermis_model::{ForwardModel, Indentation};
use dermis_skin::{Estimator, Family, Frame, ModelError, SkinDescription};
use nalgebra::Point3;

use crate::{Models, SetupError, SkinEstimator};
use dermis_sensor::Sensor;

/// A family without a forward model.
pub const PAD: &dyn Sensor = &Pad;

struct Pad;

impl Family for Pad {
    fn name(&self) -> &'static str {
        "pad"
    }
}

impl Sensor for Pad {
    fn about(&self) -> &'static str {
        "Reads a pad of a test"
    }

    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        Err(ModelError::Description {
            skin: skin.name.clone(),
            field: "sensor".into(),
            reason: "has no forward model".into(),
        })
    }
}

/// A family whose forward model is a [`membrane`].
pub const STRETCHED: &dyn Sensor = &Stretched;

struct Stretched;

impl Family for Stretched {
    fn name(&self) -> &'static str {
        "pad"
    }
}

impl Sensor for Stretched {
    fn about(&self) -> &'static str {
        "Reads a membrane of a test"
    }

    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        Ok(Arc::new(membrane(skin)))
    }
}

/// \[m\] standard deviation of a bell.
const WIDTH: f64 = 0.006;
/// \[Pa/N\] of a [`membrane`] right above an element.
pub const GAIN: f64 = 2000.0;
/// \[m/N\] of a [`membrane`] right under a press.
pub const COMPLIANCE: f64 = 1e-3;

/// A soft skin: its elements read presses, and its surface is pushed in, as bells about them.
pub fn membrane(skin: &SkinDescription) -> Analytic {
    let bell = |c: &Indentation, at: &Point3<f64>| {
        -c.force.z * (-(c.position - at).norm_squared() / (2.0 * WIDTH * WIDTH)).exp()
    };
    let on_surface = |at: &Point3<f64>| Point3::new(at.x, at.y, 0.0);
    Analytic::of_skin(skin, move |c, at| GAIN * bell(c, &on_surface(at)))
        .displaced(move |c, at| COMPLIANCE * bell(c, at))
}

/// A pad of 3×3 elements, 8 mm apart.
pub fn nine() -> SkinDescription {
    let at = |i: usize| [i % 3, i / 3].map(|k| (k as f64 - 1.0) * 0.008);
    SkinFile::four_barometers()
        .rectangle([0.024, 0.024], 0.002)
        .taxels((0..9).map(|i| (format!("t{i}"), [at(i)[0], at(i)[1], -0.005])))
        .read()
}

/// [`SkinFile::four_barometers`], of which lines of `extra` replace or add top-level keys.
pub fn skin_with(extra: &str) -> SkinDescription {
    SkinFile::four_barometers().lines(extra).read()
}

/// The file of [`skin_with`].
pub fn skin_text(extra: &str) -> String {
    SkinFile::four_barometers().lines(extra).to_string()
}

/// Standard normal numbers, the same in every run (xorshift and Box–Muller).
pub struct Noise(u64);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        ((self.0 >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        let (u, v) = (self.uniform(), self.uniform());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
}

/// One output of a linear model: `scale · Σ weight · (signal / 1 kPa) + bias` over the channels of the newest frame.
#[derive(Clone)]
pub struct Out {
    pub name: String,
    unit: &'static str,
    scale: f64,
    bias: f64,
    weights: [f32; 4],
    pub count: usize,
    link: Link,
}

impl Out {
    pub fn new(name: &str, unit: &'static str, scale: f64, weights: [f32; 4]) -> Self {
        Self { name: name.into(), unit, scale, bias: 0.0, weights, count: 1, link: Link::Linear }
    }

    pub fn biased(mut self, bias: f64) -> Self {
        self.bias = bias;
        self
    }

    pub fn logistic(mut self) -> Self {
        self.link = Link::Logistic;
        self
    }
}

/// A bundle that takes the pad's signal apart linearly: 1 kPa on one taxel is a press of 1 N, 5 mm out per axis.
#[derive(Clone)]
pub struct TestBundle {
    pub outputs: Vec<Out>,
    pub taps: Vec<u32>,
    pub baseline: Baseline,
    pub inversion: Option<Settings>,
}

impl Default for TestBundle {
    fn default() -> Self {
        Self {
            outputs: vec![
                Out::new("position.x", "m", 0.005, [-1.0, 1.0, -1.0, 1.0]),
                Out::new("position.y", "m", 0.005, [-1.0, -1.0, 1.0, 1.0]),
                Out::new("position.z", "m", 0.005, [0.0; 4]),
                Out::new("force.normal", "N", 1.0, [1.0; 4]),
            ],
            taps: vec![0],
            baseline: Baseline::Tared,
            inversion: None,
        }
    }
}

impl TestBundle {
    pub fn write(&self, skin: &SkinDescription, folder: &Path) {
        let channels = skin.channels().len();
        let mut input = FeatureConfig::newest(vec![0.0; channels], vec![1000.0; channels]);
        input.taps = Taps::Frames(self.taps.clone());
        let output = OutputConfig {
            values: self
                .outputs
                .iter()
                .map(|o| {
                    let mut spec = OutputSpec::new(&o.name, o.unit, o.bias, o.scale);
                    spec.count = o.count;
                    spec.link = o.link;
                    spec.sigma = match o.unit {
                        "m" => Some(0.001),
                        "N" => Some(0.1),
                        _ => None,
                    };
                    spec
                })
                .collect(),
        };
        let (inputs, outputs) = (input.input_len(), output.len());
        let mut weights = vec![0.0; inputs * outputs];
        let mut column = 0;
        for out in &self.outputs {
            for _ in 0..out.count {
                for (row, w) in out.weights.iter().enumerate() {
                    weights[row * outputs + column] = *w;
                }
                column += 1;
            }
        }
        let mut manifest =
            Manifest::new("linear", skin, self.baseline, input, output, TrainingSection::default());
        manifest.force_range = Some([0.0, 5.0]);
        manifest.inversion.clone_from(&self.inversion);
        BundleWriter::new(manifest)
            .write(folder, &linear_graph("linear", [inputs, outputs], &weights))
            .unwrap();
    }
}

/// A bundle of the pad of [`nine`] that gives a map and contacts as its peaks: the point above an element gives way by 1 mm for
/// 1 kPa, and presses with 500 N/m.
pub fn write_map(skin: &SkinDescription, folder: &Path, inversion: Option<Settings>) {
    let map = OutputSpec::new(MAP_DISPLACEMENT, "m", 0.0, 1e-3);
    let (mut manifest, graph) = map_above(skin, map);
    manifest.inversion = inversion;
    manifest.peaks = Some(PeakSection {
        settings: PeakSettings::default(),
        weights: Vec::new(),
        position_sigma: Some(1e-3),
        force_sigma: Some(0.1),
        sensitivity: ModelSection { interface: PeakSection::interface(), ..ModelSection::default() },
    });
    let mut writer = BundleWriter::new(manifest);
    writer.sensitivity = Some(linear_graph("sensitivity", [4, 1], &[0.0, 0.0, 0.0, 500.0]));
    writer.write(folder, &graph).unwrap();
}

/// The same of forces: the point above an element bears 0.5 N for 1 kPa.
pub fn write_force_map(skin: &SkinDescription, folder: &Path, inversion: Option<Settings>) {
    let (mut manifest, graph) = map_above(skin, OutputSpec::new(MAP_NORMAL, "N", 0.0, 0.5));
    manifest.inversion = inversion;
    manifest.force_peaks = Some(ForcePeakSection {
        disc: 0.018,
        threshold: 0.3,
        most: 2,
        position_sigma: Some(1e-3),
        force_sigma: Some(0.1),
    });
    BundleWriter::new(manifest).write(folder, &graph).unwrap();
}

/// Manifest and graph of a model whose only output is one a kPa on the point above each element.
fn map_above(skin: &SkinDescription, mut map: OutputSpec) -> (Manifest, Vec<u8>) {
    let (surface, channels) = (skin.surface(), skin.channels().len());
    let points = surface.points.len();
    let mut weights = vec![0.0; channels * points];
    for (channel, taxel) in skin.taxels.iter().enumerate() {
        let distance = |p: &Point3<f64>| (p.x - taxel.position[0]).hypot(p.y - taxel.position[1]);
        let above = (0..points)
            .min_by(|a, b| distance(&surface.points[*a]).total_cmp(&distance(&surface.points[*b])))
            .unwrap();
        weights[channel * points + above] = 1.0;
    }
    map.count = points;
    let input = FeatureConfig::newest(vec![0.0; channels], vec![1000.0; channels]);
    let output = OutputConfig { values: vec![map] };
    let manifest = Manifest::new("map", skin, Baseline::Tared, input, output, TrainingSection::default());
    (manifest, linear_graph("map", [channels, points], &weights))
}

/// A graph that multiplies `input` by weights (inputs × outputs, row by row): an ONNX file.
pub fn linear_graph(name: &str, [inputs, outputs]: [usize; 2], weights: &[f32]) -> Vec<u8> {
    let mut graph = GraphBuilder::new(name);
    let x = graph.input("input", &[1, inputs]);
    let w = graph.constant("weight", &[inputs, outputs], weights);
    let y = graph.matmul(&x, &w);
    graph.output("output", &y, &[1, outputs]);
    graph.finish().unwrap()
}

/// An estimator with these bundles.
pub fn load(skin: &SkinDescription, folders: &[&Path]) -> Result<SkinEstimator, SetupError> {
    load_for(PAD, skin, folders, &[])
}

/// An estimator of a family with these bundles and without these channels.
pub fn load_for(
    sensor: &dyn Sensor,
    skin: &SkinDescription,
    folders: &[&Path],
    masked: &[String],
) -> Result<SkinEstimator, SetupError> {
    let runtime = Runtime::load(&RuntimeConfig::default()).unwrap();
    let bundles: Vec<Bundle> = folders.iter().map(|f| Bundle::load(f, skin).unwrap()).collect();
    let mut estimator = SkinEstimator::new(skin, masked)?;
    estimator.set_models(Models::load(sensor, skin, &bundles, runtime)?);
    Ok(estimator)
}

/// An estimator for [`skin_with`]`("")` that has seen 0.8 s of quiet frames at 101 325 Pa.
pub fn tared_estimator(bundle: &TestBundle) -> (SkinEstimator, tempfile::TempDir) {
    let skin = skin_with("");
    let folder = tempfile::tempdir().unwrap();
    bundle.write(&skin, folder.path());
    let mut estimator = load(&skin, &[folder.path()]).unwrap();
    for k in 0..80_u64 {
        let wiggle = [20.0, -20.0, -20.0, 20.0][(k % 4) as usize];
        let values = (0..4).map(|i| 101_325.0 + if i % 2 == 0 { wiggle } else { -wiggle }).collect();
        estimator.estimate(&Frame::new(k as i64 * 10_000_000, k, values)).unwrap();
    }
    assert!(estimator.zero().is_some());
    (estimator, folder)
}
