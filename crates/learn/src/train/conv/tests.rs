use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_inference::{Interface, Model, Runtime, RuntimeChoice, RuntimeConfig, TensorPort};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

/// Odd sizes: every level has to be cut.
const SHAPE: [usize; 3] = [2, 13, 10];

fn spec() -> ConvSpec {
    let head = |name: &str, form, logit| Head { name: name.into(), form, logit };
    ConvSpec {
        input: "image".into(),
        shape: SHAPE,
        encoder: vec![6, 8],
        hidden: 24,
        heads: vec![
            head("scalars", Form::Vector(2), false),
            head("aligned", Form::Map([1, 13, 10]), false),
            head("surface", Form::Map([2, 5, 7]), false),
            head("contact", Form::Vector(1), true),
        ],
        layers: Vec::new(),
    }
}

/// A spot in one of the channels: where it is, an image of it, and whether there is one.
fn sample(rng: &mut ChaCha8Rng) -> TensorSample {
    let [_, height, width] = SHAPE;
    let there = rng.random_bool(0.8);
    let (x, y) = (rng.random_range(2.0..8.0_f32), rng.random_range(2.0..11.0_f32));
    let spot = |r: usize, c: usize| {
        let distance = (r as f32 - y).powi(2) + (c as f32 - x).powi(2);
        if there { (-distance / 4.0).exp() } else { 0.0 }
    };
    let image: Vec<f32> = (0..height * width).map(|i| spot(i / width, i % width)).collect();
    let mut input = image.clone();
    input.extend(image.iter().map(|v| 0.5 - v));
    let place = if there { vec![(x - 5.0) / 2.0, (y - 6.0) / 3.0] } else { vec![f32::NAN; 2] };
    let coarse = (0..70).map(|i| spot(i % 35 / 7 * 3, i % 7) * if i < 35 { 1.0 } else { -1.0 }).collect();
    TensorSample { input, targets: vec![place, image, coarse, vec![f32::from(there)]], weights: Vec::new() }
}

fn samples(count: usize, seed: u64) -> Vec<TensorSample> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| sample(&mut rng)).collect()
}

fn training() -> ConvTraining {
    ConvTraining { epochs: 6, batch: 16, learning_rate: 4e-3, shuffle: 64, ..ConvTraining::default() }
}

fn run(
    training: &ConvTraining,
    state: Option<(&std::path::Path, bool)>,
    stop: &AtomicBool,
) -> Result<Fitted, LearnError> {
    let (train, validation) = (samples(96, 1), samples(32, 2));
    let interrupted = state.is_some_and(|(_, resume)| !resume);
    fit(&spec(), training, (&train, &validation), state, stop, &mut |p| {
        stop.store(interrupted && p.epoch == 2, Ordering::Relaxed);
    })
}

#[test]
fn the_graph_answers_as_burn_does() {
    let runtime = Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Embedded, library: None }).unwrap();
    let fitted = run(&ConvTraining { epochs: 2, ..training() }, None, &AtomicBool::new(false)).unwrap();
    let graph = fitted.network.to_onnx("spot").unwrap();
    let port = |name: &str, shape: &[usize]| TensorPort { name: name.into(), shape: shape.to_vec() };
    let interface = Interface::of(
        &[port("image", &[1, 2, 13, 10])],
        &[
            port("scalars", &[1, 2]),
            port("aligned", &[1, 1, 13, 10]),
            port("surface", &[1, 2, 5, 7]),
            port("contact", &[1, 1]),
        ],
    );
    let mut model = Model::load(runtime, &graph, &interface).unwrap();
    let mut raw = Vec::new();
    let mut most = 0.0_f32;
    for sample in samples(20, 3) {
        model.run(&sample.input, &mut raw).unwrap();
        let burn: Vec<f32> = fitted.network.evaluate(&sample.input).unwrap().into_iter().flatten().collect();
        assert_eq!(raw.len(), burn.len());
        for (a, b) in raw.iter().zip(&burn) {
            most = most.max((a - b).abs());
        }
        assert!(burn.iter().any(|v| v.abs() > 0.1), "nothing comes out");
    }
    assert!(most < 1e-4, "{most} apart");
}

#[test]
fn a_spot_is_found_and_drawn() {
    let (train, validation) = (samples(400, 1), samples(60, 2));
    let config = ConvTraining { epochs: 25, ..training() };
    let mut losses = Vec::new();
    let fitted = fit(&spec(), &config, (&train, &validation), None, &AtomicBool::new(false), &mut |p| {
        losses.push((p.training, p.validation));
    })
    .unwrap();
    assert!(fitted.validation < losses[0].1 / 4.0, "{losses:?}");
    let (mut place, mut drawn, mut blank, mut right) = (0.0, 0.0, 0.0, 0);
    let test = samples(60, 4);
    for sample in &test {
        let answer = fitted.network.evaluate(&sample.input).unwrap();
        if sample.targets[0][0].is_finite() {
            place += (answer[0][0] - sample.targets[0][0]).powi(2);
        }
        let squares = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
        drawn += squares(&answer[1], &sample.targets[1]);
        blank += squares(&vec![0.0; 130], &sample.targets[1]);
        right += usize::from((answer[3][0] > 0.0) == (sample.targets[3][0] > 0.5));
    }
    // The place is uniform over −1.5 .. 1.5, whose standard deviation is 0.87.
    assert!((place / 60.0).sqrt() < 0.35, "{}", (place / 60.0).sqrt());
    assert!(drawn < 0.3 * blank, "{drawn} of {blank} are left");
    assert!(right >= 57, "{right} of 60");
}

#[test]
fn an_interrupted_run_ends_where_an_undisturbed_one_does() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("conv.state");
    let whole = run(&training(), None, &AtomicBool::new(false)).unwrap();
    let error = run(&training(), Some((&path, false)), &AtomicBool::new(false)).unwrap_err();
    assert!(matches!(error, LearnError::Interrupted { epoch: 2, epochs: 6, .. }), "{error}");
    let resumed = run(&training(), Some((&path, true)), &AtomicBool::new(false)).unwrap();
    assert_eq!(resumed, whole);

    let other = ConvTraining { batch: 8, ..training() };
    let told = run(&other, Some((&path, true)), &AtomicBool::new(false)).unwrap_err().to_string();
    let told = told.replace(&path.display().to_string(), "FILE");
    insta::assert_snapshot!(told, @"checkpoint FILE: belongs to another network or another configuration; train without `--resume` to begin anew");
}

#[test]
fn training_stops_where_nothing_is_gained_and_keeps_the_best() {
    // Targets of the validation samples have nothing to do with their inputs.
    let train = samples(32, 1);
    let mut validation = samples(32, 2);
    let targets: Vec<_> = samples(32, 9).into_iter().map(|s| s.targets).collect();
    validation.iter_mut().zip(targets).for_each(|(s, t)| s.targets = t);
    let config = ConvTraining { epochs: 60, patience: 3, learning_rate: 0.01, ..training() };
    let mut losses = Vec::new();
    let fitted = fit(&spec(), &config, (&train, &validation), None, &AtomicBool::new(false), &mut |p| {
        losses.push(p.validation);
    })
    .unwrap();
    assert!(fitted.epochs < 60 && fitted.epochs == fitted.epoch + 3, "{} of {losses:?}", fitted.epochs);
    let least = losses.iter().copied().fold(f64::INFINITY, f64::min);
    assert_eq!(fitted.validation, least);
}

#[test]
fn samples_are_streamed_and_a_wrong_one_is_refused() {
    let opened = Cell::new(0);
    let stream = || -> Result<_, LearnError> {
        opened.set(opened.get() + 1);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        Ok((0..40).map(move |_| Ok(sample(&mut rng))))
    };
    let config = ConvTraining { epochs: 2, ..training() };
    let never = AtomicBool::new(false);
    fit(&spec(), &config, (&stream, &samples(8, 2)), None, &never, &mut |_| {}).unwrap();
    assert_eq!(opened.get(), 2, "once an epoch");
    let refused = |change: &dyn Fn(&mut TensorSample)| {
        let mut train = samples(4, 1);
        change(&mut train[3]);
        fit(&spec(), &config, (&train, &samples(8, 2)), None, &never, &mut |_| {}).unwrap_err().to_string()
    };
    insta::assert_snapshot!(refused(&|s| s.input.truncate(7)), @"training: a sample does not fit the network: its input has 7 numbers where [2, 13, 10] are taken");
    insta::assert_snapshot!(refused(&|s| s.input[3] = f32::NAN), @"training: a sample does not fit the network: number 3 of its input is not finite");
    insta::assert_snapshot!(refused(&|s| s.targets.truncate(2)), @"training: a sample does not fit the network: its targets have the lengths [2, 130]");
    let nothing =
        fit(&spec(), &config, (&Vec::<TensorSample>::new(), &samples(8, 2)), None, &never, &mut |_| {});
    insta::assert_snapshot!(nothing.unwrap_err(), @"training: there is no sample to train on; record more");
}
