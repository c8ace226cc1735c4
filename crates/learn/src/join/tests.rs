use dermis_inference::onnx::GraphBuilder;
use dermis_inference::{
    Baseline, BundleWriter, FeatureConfig, Features, Interface, Manifest, OutputConfig, OutputSpec,
    RuntimeChoice, RuntimeConfig, SIGNAL, Taps, TrainingSection,
};

use super::*;
use crate::dataset::tests::{presses, skin};
use crate::target::MAP_NORMAL;

fn runtime() -> &'static Runtime {
    Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Embedded, library: None }).unwrap()
}

/// Weights that are not regular.
fn weights(count: usize, seed: f32) -> Vec<f32> {
    (0..count).map(|i| 0.6 * ((i as f32 + seed) * 2.3).sin()).collect()
}

/// A dense network with one hidden layer, or that many numbers shaped as a picture before it.
fn network(sizes: [usize; 3], output: &str, seed: f32, picture: bool) -> Vec<u8> {
    let [inputs, hidden, outputs] = sizes;
    let mut g = GraphBuilder::new("tiny");
    let shape = if picture { vec![1, inputs, 1, 1] } else { vec![1, inputs] };
    let x = g.input("input", &shape);
    let row = if picture { g.reshape(&x, &[1, inputs]) } else { x };
    let first = g.constant("first", &[inputs, hidden], &weights(inputs * hidden, seed));
    let second = g.constant("second", &[hidden, outputs], &weights(hidden * outputs, seed + 7.0));
    let bias = g.constant("bias", &[outputs], &weights(outputs, seed + 3.0));
    let y = g.matmul(&row, &first);
    let y = g.tanh(&y);
    let y = g.gemm(&y, &second, Some(&bias));
    g.output(output, &y, &[1, outputs]);
    g.finish().unwrap()
}

fn spec(name: &str, unit: &str, count: usize, (mean, scale): (f64, f64)) -> OutputSpec {
    let mut spec = OutputSpec::new(name, unit, mean, scale);
    spec.count = count;
    spec.sigma = Some(0.5);
    spec
}

/// Two bundles of the made-up skin, of two channels: readings → signal, and signal → forces on the surface's points.
struct Both {
    dir: tempfile::TempDir,
    skin: SkinDescription,
    points: usize,
}

impl Both {
    fn new() -> Self {
        let skin = skin();
        let both = Self { dir: tempfile::tempdir().unwrap(), points: skin.surface().points.len(), skin };
        both.transfer(FeatureConfig::newest(vec![40.0, 60.0], vec![30.0, 45.0]));
        both.reconstruction(FeatureConfig::newest(vec![52.0, 58.0], vec![21.0, 17.0]), Baseline::Tared);
        both
    }

    fn folder(&self, name: &str) -> std::path::PathBuf {
        self.dir.path().join(name)
    }

    fn write(
        &self,
        name: &str,
        (input, baseline): (FeatureConfig, Baseline),
        (output, interface, graph): (OutputSpec, Interface, &[u8]),
    ) {
        let output = OutputConfig { values: vec![output] };
        let training = TrainingSection::default();
        let manifest = Manifest::new(name, &self.skin, baseline, input, output, training);
        let mut writer = BundleWriter::new(manifest).with_interface(interface);
        writer.manifest.metrics.insert("of_its_own".into(), 1.0);
        writer.write(self.folder(name), graph).unwrap();
    }

    fn transfer(&self, input: FeatureConfig) {
        let graph = network([input.input_len(), 5, 2], "output", 1.0, false);
        let interface = Interface::flat(input.input_len(), 2);
        let output = spec(SIGNAL, &self.skin.unit, 2, (55.0, 19.0));
        self.write("transfer", (input, Baseline::Raw), (output, interface, &graph));
    }

    fn reconstruction(&self, input: FeatureConfig, baseline: Baseline) {
        let inputs = input.input_len();
        let graph = network([inputs, 6, self.points], MAP_NORMAL, 2.0, true);
        let output = MAP_NORMAL.to_owned();
        let interface =
            Interface { input_shape: vec![1, inputs, 1, 1], output, ..Interface::flat(inputs, self.points) };
        let output = spec(MAP_NORMAL, "N", self.points, (0.0, 0.7));
        self.write("reconstruction", (input, baseline), (output, interface, &graph));
    }

    fn join(&self, data: Option<&Dataset>) -> Result<Option<Evaluation>, LearnError> {
        join_bundles(&JoinRequest {
            skin: &self.skin,
            transfer: &self.folder("transfer"),
            reconstruction: &self.folder("reconstruction"),
            data: data.map(|data| (data, None)),
            model: None,
            out: &self.folder("joined"),
            runtime: runtime(),
        })
    }

    fn refused(&self) -> String {
        let text = self.join(None).unwrap_err().to_string();
        assert!(!self.folder("joined").exists());
        text.replace(self.dir.path().to_str().unwrap(), "")
    }
}

/// What a bundle makes of a frame.
struct Chained {
    features: Features,
    model: Model,
    outputs: Outputs,
}

impl Chained {
    fn of(bundle: &Bundle) -> Self {
        let model = bundle.session(runtime()).unwrap().unwrap();
        Self { features: bundle.features(), model, outputs: bundle.outputs() }
    }

    /// `None` before there are as many frames as the bundle sees.
    fn answer(&mut self, stamp: i64, frame: &[f32]) -> Option<Vec<f64>> {
        self.features.push(stamp, frame).unwrap();
        let mut raw = Vec::new();
        self.model.run(self.features.input()?, &mut raw).unwrap();
        self.outputs.decode(&raw).unwrap();
        Some(self.outputs.all().to_vec())
    }
}

#[test]
fn the_joined_bundle_answers_as_the_two_do_one_after_the_other() {
    let both = Both::new();
    // The transfer network may see more than the newest frame: the whole takes what it takes.
    let mut seen = FeatureConfig::newest(vec![40.0, 60.0], vec![30.0, 45.0]);
    seen.taps = Taps::Frames(vec![0, 1]);
    both.transfer(seen);
    assert!(both.join(None).unwrap().is_none());
    let load = |name: &str| Bundle::load(both.folder(name), &both.skin).unwrap();
    let joined = load("joined");
    let manifest = joined.manifest();
    assert_eq!((manifest.baseline, manifest.input.input_len()), (Baseline::Raw, 4));
    assert!(manifest.metrics.is_empty() && manifest.output.values[0].sigma.is_none());

    let mut whole = Chained::of(&joined);
    let (mut first, mut second) = (Chained::of(&load("transfer")), Chained::of(&load("reconstruction")));
    let mut answers: Vec<Vec<f64>> = Vec::new();
    for step in 0..20_i64 {
        // A channel that has no reading is the transfer network's to replace.
        let missing = if step % 5 == 4 { f32::NAN } else { 55.0 };
        let frame = [40.0 + 30.0 * (step as f32).sin(), missing];
        let stamp = step * 10_000_000;
        let signal = first.answer(stamp, &frame);
        let expected = signal.and_then(|signal| {
            let signal: Vec<f32> = signal.iter().map(|v| *v as f32).collect();
            second.answer(stamp, &signal)
        });
        let got = whole.answer(stamp, &frame);
        assert_eq!(got.is_some(), expected.is_some(), "frame {step}");
        let Some((got, expected)) = got.zip(expected) else { continue };
        assert_eq!(got.len(), both.points);
        let most = expected.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        for (got, expected) in got.iter().zip(&expected) {
            assert!((got - expected).abs() < 1e-5 * most, "{got} {expected}");
        }
        answers.push(got);
    }
    assert!(answers.len() >= 18, "{}", answers.len());
    // Another input gives another answer: what is compared is more than biases.
    let (one, other) = (&answers[1], &answers[4]);
    assert!(one.iter().zip(other).any(|(a, b)| (a - b).abs() > 1e-2), "{one:?} {other:?}");
}

#[test]
fn the_whole_is_measured_on_the_device() {
    let both = Both::new();
    let data = presses(10, 1);
    let measured = both.join(Some(&data)).unwrap().unwrap();
    let rms = measured.maps[MAP_NORMAL].touched.rms.unwrap();
    let joined = Bundle::load(both.folder("joined"), &both.skin).unwrap();
    assert_eq!(joined.manifest().output.values[0].sigma, Some(rms));
    assert_eq!(joined.manifest().training.data_hash, data.hash());
    assert_eq!(joined.manifest().training.held_out, "all labelled frames");
    let card = std::fs::read(both.folder("joined").join("card.json")).unwrap();
    let card: serde_json::Value = serde_json::from_slice(&card).unwrap();
    assert_eq!(card["transfer"]["name"], "transfer");
    assert_eq!(card["reconstruction"]["metrics"]["of_its_own"], 1.0);
    assert!(card["held_out"]["maps"][MAP_NORMAL].is_object(), "{card}");
}

#[test]
fn bundles_that_do_not_fit_are_named() {
    let both = Both::new();
    let newest = || FeatureConfig::newest(vec![52.0, 58.0], vec![21.0, 17.0]);
    both.reconstruction(newest(), Baseline::Raw);
    insta::assert_snapshot!(both.refused(), @r#"model bundle /reconstruction: takes readings with their zero, which a transfer network does not give; train it with `baseline = "tared"`"#);
    let mut seen = newest();
    seen.taps = Taps::Frames(vec![0, 2]);
    both.reconstruction(seen, Baseline::Tared);
    insta::assert_snapshot!(both.refused(), @"model bundle /reconstruction: takes more than the newest frame of the channels; train it without `[features]`, and give those to the transfer network");
    both.reconstruction(newest(), Baseline::Tared);
    std::fs::remove_dir_all(both.folder("transfer")).unwrap();
    std::fs::rename(both.folder("reconstruction"), both.folder("transfer")).unwrap();
    both.reconstruction(newest(), Baseline::Tared);
    insta::assert_snapshot!(both.refused(), @r#"model bundle /transfer: gives map.normal and not `signal` alone, one number for each of 2 channels; train it with `targets = ["signal"]`"#);
}
