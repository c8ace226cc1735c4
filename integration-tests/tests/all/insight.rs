//! The camera in a soft thumb, through the program.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::process::Command;
use std::sync::Arc;

use dermis_integration_tests::{finish, isolate, json, program, root};
use dermis_inversion::{Inverter, Reading, Search, Settings};
use dermis_model::{ForwardModel, Indentation, Stimulus, Unknowns};
use dermis_skin::SkinDescription;
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn dermis(arguments: &[&str]) -> Command {
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()).args(arguments));
    command
}

#[test]
fn its_physics_meets_its_references() {
    let summary = json(&finish(&mut dermis(&["validate", "insight", "--json"])));
    assert_eq!(summary["failed"], 0, "{summary}");
    let cases = summary["cases"].as_array().unwrap();
    for id in ["I1", "I3", "I4", "I5"] {
        let of = |c: &serde_json::Value| c["id"].as_str().is_some_and(|name| name.starts_with(id));
        assert!(cases.iter().any(of), "{id} is missing");
    }
}

/// Blocks of its picture are its numbers.
#[test]
fn the_thumb_that_ships_is_described() {
    let skin = json(&finish(&mut dermis(&["skin", "launch/skins/insight-thumb.toml", "--json"])));
    assert_eq!((skin["taxels"].as_u64(), skin["channels"].as_u64()), (Some(300), Some(1500)));
    assert_eq!(skin["forward_model"], "yes");
}

/// What a frame of these contacts says beyond an untouched one, with the noise of its numbers.
fn frame(model: &dyn ForwardModel, contacts: Vec<Indentation>, rng: &mut ChaCha8Rng) -> Vec<Reading> {
    let of = |contacts| {
        let mut out = vec![0.0; model.channels()];
        model.response(&Stimulus { contacts, ..Stimulus::default() }, &mut out).unwrap();
        out
    };
    let (touched, untouched) = (of(contacts), of(Vec::new()));
    // Twelve numbers between 0 and 1 add up to one that is nearly normal, of variance 1.
    let mut normal = || (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0;
    touched
        .iter()
        .zip(&untouched)
        .zip(model.noise())
        .map(|((a, b), sigma)| Reading::Exact(a - b + sigma * normal()))
        .collect()
}

/// On the fovea, a nail of thin elastomer. Presses are found lightly first and followed as they grow. It stretches, so that frames change ever
/// less as forces grow, and minima lie beside one another: half of the presses at least come out as likely as from the truth.
#[test]
fn presses_on_the_fovea_are_followed_as_they_grow() {
    dermis_skin::register(dermis_insight::FAMILY);
    let skin = SkinDescription::load(root().join("launch/skins/insight-thumb.toml")).unwrap();
    let model = dermis_insight::model(&skin).unwrap();
    let settings = Settings {
        contacts: 6,
        unknowns: Unknowns::Full,
        distance: 0.004,
        shear: Some(0.3),
        search: Search::Near,
        ..Settings::new(0.004, 2.14)
    };
    let inverter = Inverter::new(Arc::clone(&model), settings).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(19);
    let (mut light, mut strong, mut as_likely) = (Vec::new(), Vec::new(), 0);
    for _ in 0..8 {
        // The region of `insight-thumb-fovea.toml`.
        let [x, y, z] = [(-0.0045, 0.0045), (0.0100, 0.0110), (0.0490, 0.0595)]
            .map(|(low, high)| rng.random_range(low..high));
        let (at, normal) = model.surface().project(&Point3::new(x, y, z));
        let share = Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2f64));
        let shear = share - normal * share.dot(&normal);
        let press = |newtons: f64| Indentation::sphere(at, (shear - normal) * newtons, 0.004);
        let mut before = Vec::new();
        let mut follow = |newtons: f64| {
            let readings = frame(model.as_ref(), vec![press(newtons)], &mut rng);
            let found = inverter.search_near(&readings, &before, &[]).unwrap();
            let off = found.contacts.iter().map(|c| (c.position - at).norm()).fold(f64::INFINITY, f64::min);
            before.clone_from(&found.contacts);
            let from_truth = inverter.refine(&readings, &[press(newtons)]).unwrap();
            (off, found.chi2 < from_truth.chi2 + 10.0)
        };
        follow(0.08);
        light.push(follow(0.25).0);
        follow(0.6);
        let (off, likely) = follow(0.6);
        strong.push(off);
        as_likely += usize::from(likely);
    }
    light.sort_by(f64::total_cmp);
    strong.sort_by(f64::total_cmp);
    println!("{light:?} m at 0.25 N, {strong:?} m at 0.6 N; {as_likely} of 8 as likely as from the truth");
    // Bounds of 0.2 to 0.5 and 0.1 to 0.4 mm.
    assert!(light[4] < 6e-4, "{light:?} m");
    assert!(strong[4] < 8e-4, "{strong:?} m");
    assert!(as_likely >= 4, "{as_likely} of 8");
}
