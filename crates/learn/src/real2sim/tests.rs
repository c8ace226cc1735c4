use std::path::Path;
use std::sync::Arc;

use dermis_fixtures::{Analytic, SkinFile};
use dermis_inference::{Interface, Model, Runtime, RuntimeChoice, RuntimeConfig};
use dermis_model::{ForwardModel, Indentation};
use dermis_skin::{SkinDescription, Surface, SurfaceSpec};
use nalgebra::Point3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::*;
use crate::train::{Activation, NetworkConfig, TrainingConfig};

const BUMP: f64 = 0.008;
const REACH: f64 = 0.020;

/// Bump of this width at a distance whose square is given.
fn bump(square: f64, width: f64) -> f64 {
    (-square / (2.0 * width * width)).exp()
}

/// A made-up sheet that is stiff: its elements feel a bump about each contact. `off` is how far gains (times 0.1) and locations
/// \[mm\] are off.
fn stiff_sheet(off: f64) -> Analytic {
    let spec = SurfaceSpec::Rectangle { size: [0.10, 0.06], spacing: 0.004 };
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut by = |size: f64| size * rng.random_range(-1.0..1.0);
    let mut at = |i: u32| {
        let (x, y) = (f64::from(i % 5) - 2.0, f64::from(i / 5) - 1.0);
        Point3::new(x * 0.022 + by(off * 1e-3), y * 0.022 + by(off * 1e-3), 0.0)
    };
    let locations: Vec<_> = (0..15).map(&mut at).collect();
    let gains: Vec<_> = (0..15).map(|_| 1.0 + by(0.1 * off)).collect();
    let mut sheet = Analytic::new(Surface::from_spec(&spec), locations, 1e-3, |c, element| {
        -c.force.z * bump((c.position - element).xy().norm_squared(), REACH)
    });
    sheet.elements.iter_mut().zip(gains).for_each(|(element, gain)| element.gain = gain);
    sheet.resting_at(|_| 0.5)
}

/// The same sheet on springs: it gives way in a bump about each contact, and is softer towards one end.
fn sheet(off: f64) -> Analytic {
    stiff_sheet(off).displaced(|c, point| {
        let soft = 1.0 + 5.0 * c.position.x;
        -1e-4 * c.force.z * soft * bump((c.position - point).norm_squared(), BUMP)
    })
}

fn skin() -> SkinDescription {
    let locations = sheet(0.0).locations();
    SkinFile::new("sheet")
        .set("sensor", "\"sheet\"")
        .set("unit", "\"1\"")
        .set("noise", "1e-3")
        .rectangle([0.10, 0.06], 0.004)
        .taxels(locations.iter().enumerate().map(|(i, at)| (format!("e{i}"), [at.x, at.y, 0.0])))
        .read()
}

fn scenes(model: &dyn ForwardModel) -> Scenes {
    let settings =
        SceneSettings { force: [1.0, 10.0], locations: 1500, distance: 0.02, ..SceneSettings::default() };
    Scenes::new(model, &settings).unwrap()
}

fn recorded(device: &Analytic, count: usize, seed: u64) -> Vec<Recorded> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|i| {
            let at = |half: f64, rng: &mut ChaCha8Rng| rng.random_range(-half..half);
            let position = Point3::new(at(0.05, &mut rng), at(0.03, &mut rng), 0.0);
            let force = nalgebra::Vector3::new(0.0, 0.0, -rng.random_range(1.0..10.0));
            let contact = Indentation::sphere(position, force, 0.01);
            let signal = device
                .read(std::slice::from_ref(&contact))
                .into_iter()
                .map(|v| (v - 0.5 + 1e-3 * rng.sample::<f64, _>(StandardNormal)) as f32);
            Recorded { contact, signal: signal.collect(), location: i as u32 }
        })
        .collect()
}

fn runtime() -> &'static Runtime {
    Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Embedded, library: None }).unwrap()
}

#[test]
fn locations_are_parted_and_scenes_drawn_alike() {
    let model = sheet(0.0);
    let scenes = scenes(&model);
    let key = |p: &Point3<f64>| format!("{:?}", p.coords);
    let locations = |part| -> std::collections::BTreeSet<String> {
        scenes.locations(part).iter().map(|(p, _)| key(p)).collect()
    };
    let [train, validation, test] = [Part::Train, Part::Validation, Part::Test].map(locations);
    assert!(train.is_disjoint(&validation) && train.is_disjoint(&test) && validation.is_disjoint(&test));
    assert!(train.len() > 2 * test.len() && test.len() > 100, "{} {}", train.len(), test.len());
    for scene in scenes.draw(Part::Test, 3, 50) {
        assert_eq!(scene.contacts.len(), 3);
        for (i, a) in scene.contacts.iter().enumerate() {
            assert!(test.contains(&key(&a.position)) && (1.0..10.0).contains(&a.force.norm()));
            assert!(scene.contacts[..i].iter().all(|b| (a.position - b.position).norm() >= 0.02));
        }
    }
    assert_eq!(scenes.draw(Part::Train, 2, 5), scenes.draw(Part::Train, 2, 5));
}

#[test]
fn the_number_of_locations_is_read_by_its_old_key_too() {
    let scenes = |key: &str| {
        let text = format!("[scenes]\n{key} = 60\n");
        toml::from_str::<Settings>(&text).unwrap().scenes
    };
    assert_eq!(scenes("sites"), scenes("locations"));
    assert_eq!(scenes("sites").locations, 60);
}

#[test]
fn a_skin_without_displacements_is_refused() {
    let refused = Scenes::new(&stiff_sheet(0.0), &SceneSettings::default()).unwrap_err();
    insta::assert_snapshot!(refused, @"training: the forward model of this skin knows no displacements, which real2sim goes by; it is for skins whose surface bends");
    let none = SceneSettings { force: [3.0, 3.0], ..SceneSettings::default() };
    insta::assert_snapshot!(Scenes::new(&sheet(0.0), &none).unwrap_err(), @"training: scenes of 3 to 3 N, a tip of 0.01 m and a distance of 0.012 m cannot be simulated: all must be positive, and the range of forces not empty");
}

#[test]
fn weighted_maps_peak_at_a_single_contact() {
    let model = sheet(0.0);
    let weights = Compliance::of(&model, 0.01).unwrap().weights();
    let surface = model.surface();
    assert_eq!(weights.len(), surface.points.len());
    // One end is half as soft again as the other.
    let (left, right) = (weights[0], weights[25]);
    assert!(left > right && right > 0.0, "{left} {right}");
}

#[test]
fn the_table_has_every_cell_and_learned_numbers_are_the_best_known() {
    let model: Arc<dyn ForwardModel> = Arc::new(sheet(0.0));
    let sensors = VirtualSensors::displacements(model.as_ref(), &skin(), 6);
    assert_eq!(sensors.count(), 90);
    let settings = TableSettings {
        samples: [1200, 500, 500, 500],
        tests: 150,
        network: NetworkConfig { hidden: vec![48], ..NetworkConfig::default() },
        training: TrainingConfig { epochs: 30, learning_rate: 3e-3, ..TrainingConfig::default() },
        ..TableSettings::default()
    };
    let table = table(model.as_ref(), &sensors, &scenes(model.as_ref()), &settings, &|_, _| {}).unwrap();
    assert_eq!(table.cells.len(), 48);
    assert!(table.kept > 0.999 && table.rank > 20 && table.rank < 200, "{} {}", table.rank, table.kept);
    let fvu = |method, trained, tested| table.cell(method, trained, tested).unwrap().error.fvu;
    for method in Table::METHODS {
        assert!(fvu(method, 1, 1) < 0.6, "{method}: {}", fvu(method, 1, 1));
    }
    // What neighbours never saw they cannot answer; what adds up, a line can.
    assert!(fvu("neighbours", 1, 3) > fvu("linear", 1, 3));
    assert!(fvu("network", 4, 3) < fvu("network", 1, 3));
}

#[test]
fn several_contacts_of_a_device_are_found_and_the_graph_says_the_same() {
    let model: Arc<dyn ForwardModel> = Arc::new(sheet(0.0));
    let device = sheet(1.0);
    let sensors = VirtualSensors::channels(Arc::clone(&model)).unwrap();
    let training = |epochs| TrainingConfig { epochs, learning_rate: 3e-3, ..TrainingConfig::default() };
    let settings = PipelineSettings {
        each: 0,
        samples: [1500, 1500, 500, 500],
        transfer: NetworkConfig { hidden: vec![32], ..NetworkConfig::default() },
        transfer_training: training(30),
        linear_transfer: true,
        reconstruction: NetworkConfig { hidden: vec![96, 96], ..NetworkConfig::default() },
        reconstruction_training: training(40),
        sensitivity: NetworkConfig { hidden: vec![16], ..NetworkConfig::default() },
        sensitivity_training: training(30),
        ..PipelineSettings::default()
    };
    let (all, held) = (recorded(&device, 1000, 1), recorded(&device, 200, 2));
    let scenes = scenes(model.as_ref());
    let (pipeline, trained) =
        train(&model, &sensors, &scenes, (&all, &held), &settings, runtime(), &|_, _| {}).unwrap();
    assert!(trained.transfer_error < 0.2, "{trained:?}");
    assert_eq!(trained.map_rms.len(), 4);

    let mut reader = pipeline.contacts(model.surface(), runtime()).unwrap();
    let fresh = recorded(&device, 300, 7);
    for contacts in [1, 2] {
        let (mut distance, mut force, mut count) = (0.0, 0.0, 0);
        let frames = superpose(model.as_ref(), &fresh, contacts, 150, 0.035, 4);
        let mut right = 0;
        for (stimulus, signal) in &frames {
            let found = reader.contacts(&pipeline.map(signal).unwrap()).unwrap();
            right += usize::from(found.len() == contacts);
            for (t, index) in matched(&stimulus.contacts, &found, 0.05).into_iter().enumerate() {
                let Some(contact) = index.map(|i| &found[i]) else { continue };
                distance += (contact.position - stimulus.contacts[t].position).norm();
                force += (contact.normal_force() - stimulus.contacts[t].force.norm()).abs();
                count += 1;
            }
        }
        let (distance, force) = (distance / f64::from(count), force / f64::from(count));
        assert!(distance < 0.006 && force < 1.5, "{contacts}: {distance} m, {force} N");
        assert!(right * 10 >= frames.len() * 7, "{contacts}: {right} of {}", frames.len());
    }

    let interface = pipeline.interface();
    assert_eq!(interface, Interface::flat(15, model.surface().points.len()));
    let mut graph = Model::load(runtime(), &pipeline.to_onnx().unwrap(), &interface).unwrap();
    let mut out = Vec::new();
    let signal = &fresh[0].signal;
    let input: Vec<f32> = signal.iter().map(|v| v / pipeline.input_scale()).collect();
    graph.run(&input, &mut out).unwrap();
    let map = pipeline.map(signal).unwrap();
    let largest = map.iter().copied().fold(0.0, f64::max);
    for (a, b) in out.iter().zip(&map) {
        assert!((f64::from(a * pipeline.output_scale()) - b).abs() < 1e-4 * largest);
    }
    assert!(pipeline.map(&signal[1..]).is_err());
}

#[test]
fn the_settings_of_the_thesis_make_networks_of_its_sizes() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch/real2sim/thesis.toml");
    let mut settings = Settings::load(Some(&path)).unwrap().pipeline;
    assert_eq!((settings.each, settings.superpose, settings.sensitivity_contacts), (24, 1, 1));
    assert!(settings.whole_maps && !settings.residuals && !settings.weighted && !settings.linear_transfer);
    assert_eq!(settings.sensitivity_output, SensitivityOutput::Force);
    assert_eq!(settings.peaks.radius, 0.010);
    let activations =
        [&settings.transfer, &settings.reconstruction, &settings.sensitivity].map(|n| n.activation);
    assert_eq!(activations, [Activation::Tanh, Activation::Relu, Activation::Relu]);
    // 3 of 5 parts of 27 000, 6 000, 6 000 and 6 000.
    assert_eq!(settings.samples, [16_200, 3600, 3600, 3600]);

    // Sizes do not depend on samples and epochs.
    settings.samples = [60, 10, 10, 10];
    for training in [
        &mut settings.transfer_training,
        &mut settings.reconstruction_training,
        &mut settings.sensitivity_training,
    ] {
        training.epochs = 2;
    }
    let model: Arc<dyn ForwardModel> = Arc::new(sheet(0.0));
    let sensors = VirtualSensors::displacements(model.as_ref(), &skin(), settings.each);
    let (all, held) = (recorded(&sheet(1.0), 60, 1), recorded(&sheet(1.0), 20, 2));
    let scenes = scenes(model.as_ref());
    let (pipeline, trained) =
        train(&model, &sensors, &scenes, (&all, &held), &settings, runtime(), &|_, _| {}).unwrap();
    let points = model.surface().points.len();
    // The sheet has 15 elements.
    assert_eq!((trained.virtual_sensors, trained.rank, trained.kept), (360, points, 1.0));
    let [transfer, reconstruction, sensitivity] = pipeline.layers();
    assert_eq!(transfer, [15, 250, 250, 250, 250, 250, 250, 360]);
    assert_eq!(reconstruction, [360, 600, 1200, 1800, points]);
    assert_eq!(sensitivity, [4, 250, 250, 250, 250, 1]);

    let mut graph = Model::load(runtime(), &pipeline.to_onnx().unwrap(), &pipeline.interface()).unwrap();
    let signal = &all[0].signal;
    let input: Vec<f32> = signal.iter().map(|v| v / pipeline.input_scale()).collect();
    let mut out = Vec::new();
    graph.run(&input, &mut out).unwrap();
    let map = pipeline.map(signal).unwrap();
    let largest = map.iter().fold(0.0, |most: f64, d| most.max(d.abs()));
    assert!(largest > 0.0);
    for (a, b) in out.iter().zip(&map) {
        assert!((f64::from(a * pipeline.output_scale()) - b).abs() < 1e-4 * largest);
    }
}

#[test]
fn settings_that_cannot_be_are_refused_by_name() {
    let message = |change: fn(&mut PipelineSettings)| {
        let mut settings = PipelineSettings::default();
        change(&mut settings);
        settings.validate("s.toml").unwrap_err().to_string()
    };
    insta::assert_snapshot!(message(|s| s.superpose = 5), @"s.toml: field `superpose`: is 5 and must be 1 to 4");
    insta::assert_snapshot!(message(|s| s.sensitivity_contacts = 0), @"s.toml: field `sensitivity_contacts`: is 0 and must be 1 to 4");
    insta::assert_snapshot!(message(|s| s.kept = 1.0), @"s.toml: field `kept`: is 1 and must lie between 0 and 1");
}
