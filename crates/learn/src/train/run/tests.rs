use dermis_estimate::ContactFinder;
use dermis_estimate::finder::NetworkFinder;
use dermis_inference::{Bundle, RuntimeChoice, RuntimeConfig};

use super::*;
use crate::dataset::tests::{presses, samples, skin};
use crate::{SplitConfig, SplitKind};

fn config() -> TrainConfig {
    let mut config = TrainConfig::from_toml(
        r#"
        targets = ["position.x", "position.y", "force.normal", "contact"]
        [network]
        hidden = [12]
        members = 2
        [training]
        epochs = 150
        batch = 32
        learning_rate = 0.02
        "#,
        "c.toml",
    )
    .unwrap();
    config.split = SplitConfig { kind: SplitKind::Location, ..Default::default() };
    config
}

fn runtime() -> &'static Runtime {
    Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Embedded, library: None }).unwrap()
}

fn request<'a>(data: &'a Dataset, config: &'a TrainConfig, out: &'a Path) -> Request<'a> {
    Request {
        data,
        others: &[],
        config,
        model: None,
        out,
        resume: false,
        threads: 1,
        processor: Processor::Cpu,
        runtime: runtime(),
    }
}

#[test]
fn a_trained_bundle_answers_as_it_was_measured() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("model");
    let (data, config) = (presses(40, 2), config());
    let others = [("again".to_owned(), presses(10, 1))];
    let request = Request { others: &others, ..request(&data, &config, &out) };
    let outcome = run(&request, &AtomicBool::new(false), &|_| {}).unwrap();
    let figures = outcome.held_out.figures();
    assert!(figures["position_found_rms"] < 5e-4, "{}", outcome.held_out);
    assert!(figures["force_normal_rms"] < 0.3, "{}", outcome.held_out);
    assert!(figures["missed"] < 0.05 && figures["false_contacts"] < 0.05, "{}", outcome.held_out);
    assert_eq!(outcome.others.len(), 1);
    assert!(!partial(&out).exists());
    assert!(out.join("report.html").is_file());

    let bundle = Bundle::load(&out, &skin()).unwrap();
    let manifest = bundle.manifest();
    assert_eq!(manifest.output.values.len(), 4);
    approx::assert_relative_eq!(manifest.metrics["position_rmse_m"], figures["position_rms"]);
    assert_eq!(manifest.force_range, Some([1.0, 5.0]));
    let card: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("card.json")).unwrap()).unwrap();
    let split: SplitConfig = serde_json::from_value(card["split"].clone()).unwrap();
    let held_out = split.apply(&data).unwrap().test;
    assert_eq!(card["samples"]["held_out"]["all"], held_out.len());

    // A node that loads the bundle gives what the card says.
    let mut finder = NetworkFinder::new(&bundle, &skin(), runtime()).unwrap();
    let (mut squares, mut count) = (0.0, 0.0);
    for (i, sample) in samples(&data).iter().enumerate() {
        let known = sample.truth.as_ref().and_then(|t| t.value("position.x"));
        match known.filter(|_| held_out.contains(&SampleId { run: 0, sample: i })) {
            Some(x) => {
                let contact = finder.contact(&sample.conditioned()).unwrap();
                // Of what it does not find it gives no place.
                if finder.outputs().contact().unwrap() > 0.5 {
                    squares += (contact.position.x - x).powi(2);
                    count += 1.0;
                }
            }
            None => finder.pass(&sample.conditioned()).unwrap(),
        }
    }
    approx::assert_relative_eq!(f64::sqrt(squares / count), figures["position_x_rms"], max_relative = 1e-6);
}

#[test]
fn an_interrupted_training_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let (data, mut config) = (presses(20, 2), config());
    config.training.epochs = 6;
    let whole = dir.path().join("whole");
    run(&request(&data, &config, &whole), &AtomicBool::new(false), &|_| {}).unwrap();

    let out = dir.path().join("part");
    let stop = AtomicBool::new(false);
    let error = run(&request(&data, &config, &out), &stop, &|p| {
        stop.store(p.member == 1 && p.epoch == 2, Ordering::Relaxed);
    })
    .unwrap_err();
    assert!(matches!(error, LearnError::Interrupted { epoch: 2, epochs: 6, .. }), "{error}");
    assert!(!out.exists());
    let request = Request { resume: true, ..request(&data, &config, &out) };
    run(&request, &AtomicBool::new(false), &|_| {}).unwrap();
    let graph = |path: &Path| std::fs::read(path.join("model.onnx")).unwrap();
    assert_eq!(graph(&whole), graph(&out));
}

#[test]
fn what_cannot_be_learned_is_refused_before_training() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("model");
    let data = presses(20, 1);
    let message = |data: &Dataset, config: &TrainConfig| {
        let never = |_: Progress| panic!("training has begun");
        let error = run(&request(data, config, &out), &AtomicBool::new(false), &never);
        error.unwrap_err().to_string()
    };
    let mut depth = config();
    depth.targets = vec!["position.z".into()];
    insta::assert_snapshot!(message(&data, &depth), @"the training part: `position.z` is the same in all 34 samples: it cannot be learned; leave it out or record other presses");

    let mut unknown = data.clone();
    let mut runs = unknown.runs().to_vec();
    for contact in runs
        .iter_mut()
        .flat_map(|r| &mut r.samples)
        .filter_map(|s| s.truth.as_mut())
        .flat_map(|t| &mut t.contacts)
    {
        contact.components = dermis_skin::ForceComponents::None;
    }
    unknown = Dataset::from_runs(unknown.skin(), runs.clone());
    insta::assert_snapshot!(message(&unknown, &config()), @"bag made.bag: `force.normal` is never known while the skin is touched; known are contact (40 samples), position.x (40 samples), position.y (40 samples), position.z (40 samples): it cannot be learned; name other targets or record them");

    // Without untouched frames there is no zero.
    for sample in runs.iter_mut().flat_map(|r| &mut r.samples) {
        sample.tare = false;
        sample.truth = sample.truth.take().filter(Truth::touched);
    }
    let mut place = config();
    place.targets = vec!["position.x".into(), "position.y".into()];
    insta::assert_snapshot!(message(&Dataset::from_runs(unknown.skin(), runs), &place), @r#"bag made.bag: no stretch of 0.03 s (and 3 frames) before the touched frames is labelled untouched: the zero is unknown; record idle frames first, or train with `baseline = "raw"`"#);
}

#[test]
fn rare_forces_count_as_much_as_plenty() {
    let outputs = ["position.x", "force.normal"];
    let mut balance = Balance::default();
    let pressed = |force| Truth {
        press: 1,
        location: 1,
        idle: false,
        contacts: vec![crate::dataset::tests::contact(0.0, 0.0, force)],
    };
    let untouched = Truth { contacts: Vec::new(), ..pressed(1.0) };
    let truths = [(90, untouched), (30, pressed(0.3)), (3, pressed(3.0))];
    for (count, truth) in &truths {
        (0..*count).for_each(|_| balance.push(truth));
    }
    let mut weights = vec![1.0; 2 * 123];
    balance.apply(&outputs, &mut weights);
    let forces: Vec<f32> = weights.iter().skip(1).step_by(2).copied().collect();
    assert!(weights.iter().step_by(2).all(|w| *w == 1.0), "positions are weighted otherwise");
    let sums = [&forces[..90], &forces[90..120], &forces[120..]].map(|part| part.iter().sum::<f32>());
    approx::assert_relative_eq!(sums[0], sums[1], max_relative = 1e-4);
    // Thirty times as rare as the untouched: as much as a weight may grow.
    approx::assert_relative_eq!(sums[2], sums[0] / 3.0, max_relative = 1e-4);
    approx::assert_relative_eq!(forces.iter().sum::<f32>(), 123.0, max_relative = 1e-4);
}

#[test]
fn a_map_is_learned_and_its_bundle_gives_it() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("model");
    let (data, mut config) = (presses(30, 2), config());
    config.targets = vec!["map.normal".into(), "force.normal".into(), "contact".into()];
    config.training.epochs = 60;
    let outcome = run(&request(&data, &config, &out), &AtomicBool::new(false), &|_| {}).unwrap();
    let errors = &outcome.held_out.maps["map.normal"];
    let (touched, untouched) = (&errors.touched, &errors.untouched);
    assert!(touched.frames > 0 && untouched.frames > 0, "{errors:?}");
    assert!(touched.relative.is_some_and(|r| r < 1.0), "better than no force anywhere: {errors:?}");
    assert!(touched.total_force.is_some() && untouched.total_force.is_some(), "{errors:?}");
    let card: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("card.json")).unwrap()).unwrap();
    assert_eq!(card["held_out"]["maps"]["map.normal"]["touched"]["frames"], touched.frames);
    let report = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains("map.normal touched"));
    let bundle = Bundle::load(&out, &skin()).unwrap();
    let points = skin().surface().points.len();
    let spec = &bundle.manifest().output.values[1];
    assert_eq!((spec.name.as_str(), spec.count, spec.sigma), ("map.normal", points, touched.rms));
    assert_eq!(Some(bundle.manifest().metrics["map_normal_rmse_n"]), touched.rms);
    let (mut model, mut outputs) = (bundle.session(runtime()).unwrap().unwrap(), bundle.outputs());
    let (mut features, mut raw, mut errors) = (bundle.features(), Vec::new(), Vec::new());
    for sample in samples(&data).iter().skip(20) {
        features.push(sample.frame.stamp, &sample.tared).unwrap();
        let Some(force) = sample.truth.as_ref().and_then(|t| t.single()?.normal_force()) else { continue };
        model.run(features.input().unwrap(), &mut raw).unwrap();
        outputs.decode(&raw).unwrap();
        let sum: f64 = outputs.values("map.normal").unwrap().iter().sum();
        errors.push((sum - force).abs() / force);
    }
    errors.sort_by(f64::total_cmp);
    assert!(
        errors[errors.len() / 2] < 0.15,
        "the points of a map sum to the force: {}",
        errors[errors.len() / 2]
    );
}

#[cfg(feature = "train")]
#[test]
fn a_picture_is_learned_and_its_bundle_gives_forces_on_the_points() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("model");
    // 12 pixels of 2 mm over a pad of 20 mm.
    let text = r#"
        targets = ["map.normal"]
        [network.image]
        pixels = [12, 12]
        pixel = 0.002
        diameter = 0.008
        [[network.image.layers]]
        kind = "linear"
        outputs = 24
        [[network.image.layers]]
        kind = "transposed"
        channels = 8
        kernel = 3
        [[network.image.layers]]
        kind = "upsample"
        factor = 2
        [[network.image.layers]]
        kind = "transposed"
        channels = 4
        kernel = 2
        stride = 2
        [[network.image.layers]]
        kind = "transposed"
        channels = 1
        kernel = 3
        padding = 1
        [training]
        epochs = 60
        batch = 16
        learning_rate = 0.01
        momentum = 0.7
    "#;
    let mut config = TrainConfig::from_toml(text, "c.toml").unwrap();
    config.split = SplitConfig { kind: SplitKind::Location, ..Default::default() };
    let data = presses(40, 2);
    let outcome = run(&request(&data, &config, &out), &AtomicBool::new(false), &|_| {}).unwrap();
    let errors = &outcome.held_out.maps["map.normal"];
    // Forces are 1 to 5 N. The picture is blurred, so that points err, and their sum does not.
    assert!(errors.touched.total_force.is_some_and(|f| f < 0.6), "{errors:?}");
    assert!(errors.touched.relative.is_some_and(|r| r < 1.0), "{errors:?}");
    let bundle = Bundle::load(&out, &skin()).unwrap();
    let spec = &bundle.manifest().output.values[0];
    assert_eq!((spec.name.as_str(), spec.count), ("map.normal", skin().surface().points.len()));

    // Noise needs the card of a transfer network.
    let mut noisy = config.clone();
    noisy.training.channel_noise = Some(super::super::ChannelNoise { bundle: out.clone(), share: 0.1 });
    let other = dir.path().join("noisy");
    let error =
        run(&request(&data, &noisy, &other), &AtomicBool::new(false), &|_| {}).unwrap_err().to_string();
    assert!(error.contains("holds no errors by channel"), "{error}");
}

#[test]
fn a_transfer_network_learns_the_signal_of_the_model_and_says_what_it_leaves() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("transfer");
    let (data, mut config) = (presses(40, 2), config());
    config.targets = vec!["signal".into()];
    // The device reads 1e4 a metre and 20 a newton; the model half of the first and twice of the second.
    let model = dermis_fixtures::Analytic::of_contacts(
        skin().surface(),
        skin().taxels.iter().map(dermis_skin::Taxel::point),
        0.5,
        |contact, _, out| {
            out[0] += contact.position.x * 5e3;
            out[1] += contact.force.norm() * 40.0;
        },
    );
    let model: Option<Arc<dyn ForwardModel>> = Some(Arc::new(model));
    let request = Request { model, ..request(&data, &config, &out) };
    let outcome = run(&request, &AtomicBool::new(false), &|_| {}).unwrap();
    let errors = &outcome.held_out.maps["signal"];
    assert_eq!(errors.unit, skin().unit);
    assert!(errors.contacts.is_empty() && errors.touched.total_force.is_none());
    let of_one = errors.by_number[&1];
    assert!(of_one.fvu.is_some_and(|fvu| fvu < 0.05), "{of_one:?}");
    let left = errors.channels.as_ref().unwrap();
    assert!(left.mean.len() == 2 && left.deviation.iter().all(|d| *d > 0.0 && *d < 20.0), "{left:?}");
    let card: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("card.json")).unwrap()).unwrap();
    assert_eq!(
        card["held_out"]["maps"]["signal"]["channels"]["deviation"][1].as_f64(),
        Some(left.deviation[1])
    );
}
