use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_inference::{Interface, Model, Runtime, RuntimeChoice, RuntimeConfig, TensorPort};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::picture::Mixing;
use crate::train::image::tests::{RECON_NET, shipped};

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
    let message = run(&other, Some((&path, true)), &AtomicBool::new(false)).unwrap_err().to_string();
    let message = message.replace(&path.display().to_string(), "FILE");
    insta::assert_snapshot!(message, @"checkpoint FILE: belongs to another network or another configuration; train without `--resume` to begin anew");
}

/// Sums round differently there, and each step builds on the one before: losses agree, numbers do not.
#[cfg(feature = "gpu")]
#[test]
fn a_gpu_learns_what_the_processor_learns() {
    let on = |processor| run(&ConvTraining { processor, ..training() }, None, &AtomicBool::new(false));
    let cpu = on(crate::train::Processor::Cpu).unwrap();
    let gpu = match on(crate::train::Processor::Gpu(None)) {
        Ok(fitted) => fitted,
        Err(error) => {
            eprintln!("not tested: {error}");
            return;
        }
    };
    assert!(
        (gpu.validation / cpu.validation - 1.0).abs() < 0.02,
        "{} and {}",
        gpu.validation,
        cpu.validation
    );
}

/// Its layers have more positions than weights: their gradients are split there.
#[cfg(feature = "gpu")]
#[test]
fn a_gpu_draws_what_the_processor_draws() {
    let on = |processor| draws(&ConvTraining { processor, ..training() });
    let cpu = on(crate::train::Processor::Cpu).unwrap();
    match on(crate::train::Processor::Gpu(None)) {
        Ok(gpu) => {
            let ratio = gpu.validation / cpu.validation;
            assert!((ratio - 1.0).abs() < 0.05, "{} and {}", gpu.validation, cpu.validation);
        }
        Err(error) => eprintln!("not tested: {error}"),
    }
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

/// Every kind of layer; heights and widths 1, 5, 15, 40, 40, 40.
fn sequence() -> ConvSpec {
    let transposed =
        |channels, kernel, stride, padding| Layer::Transposed { channels, kernel, stride, padding };
    ConvSpec {
        input: "input".into(),
        shape: [9, 1, 1],
        encoder: Vec::new(),
        hidden: 0,
        heads: vec![Head { name: "map".into(), form: Form::Map([1, 40, 40]), logit: false }],
        layers: vec![
            Layer::Linear { outputs: 12 },
            transposed(6, 5, 1, 0),
            Layer::Upsample { factor: 3 },
            transposed(4, 6, 3, 4),
            transposed(2, 3, 1, 1),
            transposed(1, 3, 1, 1),
        ],
    }
}

/// Nine numbers that say where a spot is, and a picture of it.
fn drawn(count: usize, seed: u64) -> Vec<TensorSample> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut one = || {
        let (x, y) = (rng.random_range(5.0..35.0_f32), rng.random_range(5.0..35.0_f32));
        let near = |i: usize| {
            let (a, b) = (5.0 + 15.0 * (i % 3) as f32, 5.0 + 15.0 * (i / 3) as f32);
            (-((x - a).powi(2) + (y - b).powi(2)) / 200.0).exp()
        };
        let spot =
            |i: usize| (-((i % 40) as f32 - x).powi(2) / 20.0 - ((i / 40) as f32 - y).powi(2) / 20.0).exp();
        TensorSample {
            input: (0..9).map(near).collect(),
            targets: vec![(0..1600).map(spot).collect()],
            weights: Vec::new(),
        }
    };
    (0..count).map(|_| one()).collect()
}

fn draws(training: &ConvTraining) -> Result<Fitted, LearnError> {
    let (train, validation) = (drawn(160, 1), drawn(32, 2));
    fit(&sequence(), training, (&train, &validation), None, &AtomicBool::new(false), &mut |_| {})
}

/// Largest difference between a graph of these outputs and what burn says of inputs.
fn apart(
    runtime: &'static Runtime,
    network: &ConvNetwork,
    graph: &[u8],
    expected: &dyn Fn(&[f32]) -> Vec<f64>,
) -> f64 {
    let inputs = network.spec().input_len();
    let outputs = expected(&vec![0.0; inputs]).len();
    let port = |name: &str, shape: &[usize]| TensorPort { name: name.into(), shape: shape.to_vec() };
    let output = if outputs == network.spec().heads[0].form.len() {
        let Form::Map([c, h, w]) = network.spec().heads[0].form else { panic!("a map") };
        port(&network.spec().heads[0].name, &[1, c, h, w])
    } else {
        port(&network.spec().heads[0].name, &[1, outputs])
    };
    let [c, h, w] = network.spec().shape;
    let interface = Interface::of(&[port("input", &[1, c, h, w])], &[output]);
    let mut model = Model::load(runtime, graph, &interface).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut raw, mut most) = (Vec::new(), 0.0_f64);
    for _ in 0..5 {
        let input: Vec<f32> = (0..inputs).map(|_| rng.random_range(-1.0..1.0)).collect();
        model.run(&input, &mut raw).unwrap();
        let wanted = expected(&input);
        assert_eq!(raw.len(), wanted.len());
        assert!(wanted.iter().any(|v| v.abs() > 1e-2), "nothing comes out");
        most = raw.iter().zip(&wanted).fold(most, |most, (a, b)| most.max((f64::from(*a) - b).abs()));
    }
    most
}

fn by_burn(network: &ConvNetwork) -> impl Fn(&[f32]) -> Vec<f64> + '_ {
    |input| network.evaluate(input).unwrap().into_iter().flatten().map(f64::from).collect()
}

/// Of a sequence that has learned a little, and of the thesis' network as it is drawn, with its pixels mixed onto a panel.
fn graphs_answer_as_burn_does(runtime: &'static Runtime) {
    let network = draws(&ConvTraining { epochs: 1, ..training() }).unwrap().network;
    let most = apart(runtime, &network, &network.to_onnx("drawn").unwrap(), &by_burn(&network));
    assert!(most < 1e-4, "{most} apart");

    let (_, config) = shipped(RECON_NET);
    let config = config.network.image.unwrap();
    let thesis = ConvNetwork::new(&config.spec("map.normal", 784), 3).unwrap();
    let panel = dermis_skin::SurfaceSpec::Rectangle { size: [0.54, 0.56], spacing: 0.01 };
    let mixing = Mixing::new(&config.picture(), &dermis_skin::Surface::from_spec(&panel)).unwrap();
    let burn = by_burn(&thesis);
    let mixed = |input: &[f32]| mixing.apply(&burn(input));
    let graph = thesis.to_onnx_mixed("thesis", &mixing).unwrap();
    let most = apart(runtime, &thesis, &graph, &mixed);
    assert!(most < 1e-4, "{most} apart");
    assert!(network.to_onnx_mixed("drawn", &mixing).is_err(), "another number of pixels");
}

#[test]
fn the_embedded_runtime_draws_as_burn_does() {
    let embedded = RuntimeConfig { choice: RuntimeChoice::Embedded, library: None };
    graphs_answer_as_burn_does(Runtime::load(&embedded).unwrap());
}

#[test]
fn the_native_runtime_draws_as_burn_does() {
    match Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Native, library: None }) {
        Ok(native) => graphs_answer_as_burn_does(native),
        Err(why) => eprintln!("skipped: {why}"),
    }
}

#[test]
fn a_transposed_convolution_is_what_its_definition_says() {
    let spec = ConvSpec {
        layers: vec![
            Layer::Linear { outputs: 2 },
            Layer::Transposed { channels: 2, kernel: 4, stride: 1, padding: 0 },
            Layer::Transposed { channels: 1, kernel: 6, stride: 3, padding: 4 },
        ],
        heads: vec![Head { name: "map".into(), form: Form::Map([1, 7, 7]), logit: false }],
        shape: [3, 1, 1],
        ..sequence()
    };
    // Of some seeds the first layer is silent for this input.
    let seen = (1..=6).filter(|seed| draws_as_defined(&ConvNetwork::new(&spec, *seed).unwrap())).count();
    assert!(seen >= 2, "{seen} of 6 drew anything");
}

/// Whether a network of a linear layer and two transposed convolutions draws anything; it draws what their definition says.
fn draws_as_defined(network: &ConvNetwork) -> bool {
    let input = [0.3, -0.8, 0.5];
    let mut planes: Vec<f32> = input.to_vec();
    let mut size = 1;
    for (k, pair) in network.parameters.chunks(2).enumerate() {
        let (weight, bias) = (&pair[0], &pair[1].values);
        if k == 0 {
            let dense = |o: usize| (0..3).map(|i| input[i] * weight.values[i * 2 + o]).sum::<f32>() + bias[o];
            planes = (0..2).map(|o| dense(o).max(0.0)).collect();
            continue;
        }
        let (kernel, stride, padding) = if k == 1 { (4, 1, 0) } else { (6, 3, 4) };
        let (from, to) = (weight.shape[0], weight.shape[1]);
        let made = (size - 1) * stride + kernel - 2 * padding;
        let mut out = vec![0.0; to * made * made];
        for (o, plane) in out.chunks_mut(made * made).enumerate() {
            plane.fill(bias[o]);
        }
        // Every number of the input adds its kernel to the output.
        for (i, o) in (0..from).flat_map(|i| (0..to).map(move |o| (i, o))) {
            for (y, x, a, b) in (0..size * size * kernel * kernel).map(|n| {
                let (place, within) = (n / (kernel * kernel), n % (kernel * kernel));
                (place / size, place % size, within / kernel, within % kernel)
            }) {
                let (row, column) = (y * stride + a, x * stride + b);
                let inside = |v: usize| v >= padding && v < made + padding;
                if inside(row) && inside(column) {
                    let w = weight.values[((i * to + o) * kernel + a) * kernel + b];
                    out[o * made * made + (row - padding) * made + column - padding] +=
                        w * planes[i * size * size + y * size + x];
                }
            }
        }
        if k == 1 {
            out.iter_mut().for_each(|v| *v = v.max(0.0));
        }
        (planes, size) = (out, made);
    }
    let burn = network.evaluate(&input).unwrap().swap_remove(0);
    assert_eq!(burn.len(), planes.len());
    for (a, b) in burn.iter().zip(&planes) {
        assert!((a - b).abs() < 1e-5, "{burn:?} {planes:?}");
    }
    planes.iter().any(|v| (v - planes[0]).abs() > 1e-3)
}

#[test]
fn upsampling_repeats_rows_and_columns() {
    let with = |layers: Vec<Layer>, size: usize| {
        let heads = vec![Head { name: "map".into(), form: Form::Map([1, size, size]), logit: false }];
        let network = ConvNetwork::new(&ConvSpec { heads, layers, ..sequence() }, 4).unwrap();
        network.evaluate(&[0.1, 0.9, -0.4, 0.2, 0.3, 0.5, -0.6, 0.7, 0.8]).unwrap().swap_remove(0)
    };
    let layers = vec![
        Layer::Linear { outputs: 4 },
        Layer::Transposed { channels: 1, kernel: 3, stride: 1, padding: 0 },
    ];
    let (small, large) =
        (with(layers.clone(), 3), with([layers, vec![Layer::Upsample { factor: 4 }]].concat(), 12));
    assert!(small.iter().any(|v| *v != small[0]));
    for (i, value) in large.iter().enumerate() {
        assert_eq!(*value, small[i / 12 / 4 * 3 + i % 12 / 4]);
    }
}

#[test]
fn a_sequence_learns_to_draw_and_noise_is_repeatable() {
    let plain = ConvTraining { epochs: 8, batch: 8, momentum: 0.7, ..training() };
    let (first, last) =
        (draws(&ConvTraining { epochs: 1, ..plain.clone() }).unwrap(), draws(&plain).unwrap());
    let blank: f32 =
        drawn(32, 2).iter().flat_map(|s| &s.targets[0]).map(|v| v * v).sum::<f32>() / (32.0 * 1600.0);
    // Thirty-two pictures in eight passes: the place is not learned yet, that something is drawn is.
    assert!(last.validation < 0.95 * f64::from(blank), "{} of {blank}", last.validation);
    assert!(last.validation < first.validation);
    let noisy = ConvTraining { epochs: 2, noise: vec![0.1; 9], ..plain.clone() };
    let [a, b] = [draws(&noisy).unwrap(), draws(&noisy).unwrap()];
    assert_eq!(a, b);
    let quiet = draws(&ConvTraining { epochs: 2, ..plain.clone() }).unwrap();
    assert_ne!(a.network, quiet.network);
    let nothing = draws(&ConvTraining { epochs: 2, noise: vec![0.0; 9], ..plain.clone() }).unwrap();
    assert_eq!(nothing.network, quiet.network, "noise does not change what is drawn otherwise");
    insta::assert_snapshot!(draws(&ConvTraining { noise: vec![0.1; 8], ..plain.clone() }).unwrap_err(), @"training: noise has 8 standard deviations where inputs have 9 numbers, or one that is negative");
    insta::assert_snapshot!(draws(&ConvTraining { momentum: 1.0, ..plain }).unwrap_err(), @"training: `training.epochs` and `training.batch` must be at least 1, `training.learning_rate` positive, and `training.momentum` from 0 to below 1");
}
