use super::*;
use crate::finder::{REACH, spread_forces};
use crate::testing::{
    COMPLIANCE, Out, STRETCHED, TestBundle, load, load_for, membrane, nine, skin_with, tared_estimator,
};
use dermis_inference::MAP_NORMAL;
use dermis_inference::{Bundle, MAP_DISPLACEMENT};
use dermis_inversion::Settings;
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{Contact, ForceComponents, ForceValues};
use nalgebra::{Point3, Vector3};

mod parts;

const IDLE: f32 = 101_325.0;

fn frame(k: u64, load: [f32; 4]) -> Frame {
    // A pattern with a spread of one noise deviation and a mean of zero over four frames.
    let wiggle = [20.0, -20.0, -20.0, 20.0][(k % 4) as usize];
    let values = load.iter().enumerate().map(|(i, l)| IDLE + l + if i % 2 == 0 { wiggle } else { -wiggle });
    Frame::new(k as i64 * 10_000_000, k, values.collect())
}

fn press(estimator: &mut SkinEstimator, k: u64, load: [f32; 4]) -> Estimate {
    estimator.estimate(&frame(k, load)).unwrap()
}

#[test]
fn without_a_model_it_is_uncalibrated_and_says_so() {
    let mut estimator = SkinEstimator::new(&skin_with(""), &[]).unwrap();
    for k in 0..100 {
        assert!(press(&mut estimator, k, [0.0; 4]).contacts.is_empty());
    }
    assert_eq!(estimator.verdict().quality, Quality::Uncalibrated);
    assert!(estimator.verdict().text.contains("no model is loaded"));
    assert!(estimator.zero().is_some(), "it tares all the same");
}

#[test]
fn a_press_has_position_force_and_error_bars() {
    let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
    assert!(press(&mut estimator, 100, [0.0; 4]).contacts.is_empty());
    assert_eq!((estimator.verdict().quality, estimator.verdict().text.as_str()), (Quality::Ok, ""));

    let contacts = press(&mut estimator, 101, [2000.0, 0.0, 0.0, 0.0]).contacts;
    let [contact] = contacts.as_slice() else { panic!("{contacts:?}") };
    assert_eq!(contact.track_id, 1);
    assert!((contact.position - Point3::new(-0.01, -0.01, 0.0)).norm() < 1e-3, "{}", contact.position);
    assert_eq!(contact.normal, Vector3::z());
    assert!((contact.normal_force() - 2.0).abs() < 0.1, "{}", contact.normal_force());
    assert!(contact.force.z < 0.0, "pressing pushes into the skin");
    assert_eq!(contact.force_components, ForceComponents::Normal);
    assert!((contact.position_covariance[(0, 0)] - 1e-6).abs() < 1e-12);
    assert_eq!(contact.position_covariance[(2, 2)], 0.0);
    assert!((contact.force_covariance[(2, 2)] - 0.01).abs() < 1e-9);
    assert_eq!(contact.taxels, [0]);
    assert!(contact.confidence > 0.99 && contact.diameter.is_nan());
    assert!((estimator.force_max() - 5.0).abs() < 1e-9);

    assert_eq!(press(&mut estimator, 102, [1900.0, 0.0, 0.0, 0.0]).contacts[0].track_id, 1);
    assert!(press(&mut estimator, 103, [0.0; 4]).contacts.is_empty());
    assert_eq!(press(&mut estimator, 150, [1900.0, 0.0, 0.0, 0.0]).contacts[0].track_id, 2);
}

#[test]
fn positions_lie_on_the_surface() {
    let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
    let contact = &press(&mut estimator, 100, [8000.0, 0.0, 0.0, 0.0]).contacts[0];
    assert_eq!(contact.position, Point3::new(-0.01, -0.01, 0.0), "beyond the edge of the pad");
    assert!(contact.confidence < 0.7, "8 N where the model knows 5: {}", contact.confidence);
}

#[test]
fn the_same_frames_give_the_same_contacts() {
    let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
    estimator.reset();
    let mut run = || -> Vec<Estimate> {
        (0..400)
            .map(|k| {
                let touched = (100..300).contains(&k);
                press(&mut estimator, k, if touched { [900.0, 100.0, 0.0, 40.0] } else { [0.0; 4] })
            })
            .collect()
    };
    let first = run();
    assert!(first.iter().any(|e| !e.contacts.is_empty()));
    let (estimator_again, _dir) = tared_estimator(&TestBundle::default());
    estimator = estimator_again;
    estimator.reset();
    let second: Vec<Estimate> = (0..400)
        .map(|k| {
            let touched = (100..300).contains(&k);
            press(&mut estimator, k, if touched { [900.0, 100.0, 0.0, 40.0] } else { [0.0; 4] })
        })
        .collect();
    assert_eq!(format!("{first:?}"), format!("{second:?}"));
}

#[test]
fn impaired_channels_degrade_and_many_are_a_fault() {
    let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
    let healthy = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts[0].confidence;
    let contacts = press(&mut estimator, 101, [2000.0, 0.0, f32::NAN, 0.0]).contacts;
    assert_eq!(estimator.verdict().quality, Quality::Degraded);
    insta::assert_snapshot!(estimator.verdict().text, @"1 of 4 channels are impaired: t2 (not finite); no forward model stands in for them, so that the error of the contacts is unknown");
    assert!(contacts[0].confidence < 0.8 * healthy);
    assert!(contacts[0].position_covariance.iter().chain(&contacts[0].force_covariance).all(|v| v.is_nan()));
    let blind = press(&mut estimator, 102, [f32::NAN, f32::NAN, f32::NAN, 0.0]);
    assert!(blind.contacts.is_empty() && blind.force_map.is_none());
    assert_eq!(estimator.verdict().quality, Quality::Fault);
    assert!(
        estimator.verdict().text.starts_with("3 of 4 channels are unusable: t0 (not finite), t1"),
        "{}",
        estimator.verdict().text
    );
}

#[test]
fn an_untared_skin_is_no_untouched_skin() {
    let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
    estimator.reset();
    press(&mut estimator, 0, [0.0; 4]);
    press(&mut estimator, 1, [0.0; 4]);
    assert_eq!(estimator.verdict().quality, Quality::Uncalibrated);
    insta::assert_snapshot!(estimator.verdict().text, @"not tared yet: 0.0 of 0.5 s of untouched readings");
    for k in 2..100 {
        press(&mut estimator, k, [k as f32 * 50.0, 0.0, 0.0, 0.0]);
    }
    insta::assert_snapshot!(estimator.verdict().text, @"not tared: the readings move by 18.6 times their noise; leave the skin untouched, or correct `noise` in the skin file");
}

#[test]
fn a_model_that_says_whether_there_is_a_contact_is_believed() {
    let mut bundle = TestBundle::default();
    // One half at a sum of 1 kPa.
    bundle.outputs.push(Out::new("contact", "1", 20.0, [1.0; 4]).biased(-20.0).logistic());
    let (mut estimator, _dir) = tared_estimator(&bundle);
    assert!(press(&mut estimator, 100, [500.0, 0.0, 0.0, 0.0]).contacts.is_empty());
    assert!(estimator.conditioned().touched, "by level it is touched");
    let contacts = press(&mut estimator, 101, [1500.0, 0.0, 0.0, 0.0]).contacts;
    assert_eq!(contacts.len(), 1);
    assert!(estimator.verdict().probability.is_some_and(|p| p > 0.9));
}

#[test]
fn presence_and_force_without_position_are_reported_as_such() {
    let mut bundle = TestBundle::default();
    bundle.outputs.retain(|o| o.name == "force.normal");
    let (mut estimator, _dir) = tared_estimator(&bundle);
    let contact = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts.remove(0);
    assert!(contact.position.x.is_nan() && contact.position_covariance[(0, 0)].is_nan());
    assert!((contact.normal_force() - 2.0).abs() < 0.1, "the normal of a flat skin is known");

    let dome = skin_with("surface = { type = \"dome\", radius = 0.01, cylinder = 0.01, spacing = 0.003 }");
    let dir = tempfile::tempdir().unwrap();
    bundle.write(&dome, dir.path());
    let mut estimator = load(&dome, &[dir.path()]).unwrap();
    for k in 0..60 {
        press(&mut estimator, k, [0.0; 4]);
    }
    let contact = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts.remove(0);
    assert_eq!(contact.force_components, ForceComponents::None);
    assert!(contact.force.x.is_nan() && contact.normal.x.is_nan());
}

#[test]
fn all_three_components_follow_from_the_normal_one() {
    let mut bundle = TestBundle::default();
    bundle.outputs.retain(|o| o.name != "force.normal");
    for (axis, w) in [("x", 0.5), ("y", 0.0), ("z", -1.0)] {
        bundle.outputs.push(Out::new(&format!("force.{axis}"), "N", 1.0, [w; 4]));
    }
    let (mut estimator, _dir) = tared_estimator(&bundle);
    let contact = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts.remove(0);
    assert_eq!(contact.force_components, ForceComponents::Full);
    assert!((contact.force - Vector3::new(1.0, 0.0, -2.0)).norm() < 0.1, "{}", contact.force);
}

#[test]
fn light_contacts_are_left_out_where_requested() {
    let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
    assert!((estimator.force_threshold() - 0.1).abs() < 1e-9, "the model's own error");
    estimator.set_least_force(0.5);
    assert!((estimator.force_threshold() - 0.5).abs() < 1e-9);
    assert!(press(&mut estimator, 100, [300.0, 0.0, 0.0, 0.0]).contacts.is_empty());
    assert_eq!(press(&mut estimator, 101, [900.0, 0.0, 0.0, 0.0]).contacts.len(), 1);
}

#[test]
fn two_bundles_share_the_work_but_not_an_output() {
    let skin = skin_with("");
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut position = TestBundle::default();
    let mut force = TestBundle::default();
    position.outputs.retain(|o| o.name != "force.normal");
    force.outputs.retain(|o| o.name == "force.normal");
    position.write(&skin, a.path());
    force.write(&skin, b.path());
    let mut estimator = load(&skin, &[a.path(), b.path()]).unwrap();
    for k in 0..60 {
        press(&mut estimator, k, [0.0; 4]);
    }
    let contact = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts.remove(0);
    assert!(contact.position.x < 0.0 && contact.normal_force() > 1.0);
    let error = load(&skin, &[a.path(), a.path()]).err().unwrap().to_string();
    assert!(error.contains("both give `position.x`"), "{error}");
}

#[test]
fn a_force_map_appears_where_the_model_gives_one() {
    let points = skin_with("").surface().points.len();
    let mut bundle = TestBundle::default();
    let mut map = Out::new(MAP_NORMAL, "N", 0.1, [1.0, 0.0, 0.0, 0.0]);
    map.count = points;
    bundle.outputs.push(map);
    let (mut estimator, _dir) = tared_estimator(&bundle);
    assert!(estimator.maps().force && !estimator.maps().displacement);
    let idle = press(&mut estimator, 100, [0.0; 4]).force_map.unwrap();
    assert_eq!(idle.forces, ForceValues::Normal(vec![0.0; points]));
    let pressed = press(&mut estimator, 101, [2000.0, 0.0, 0.0, 0.0]).force_map.unwrap();
    let ForceValues::Normal(values) = pressed.forces else { panic!("vector map") };
    assert!(values.len() == points && (values[3] - 0.2).abs() < 0.01);

    bundle.outputs.last_mut().unwrap().count = 3;
    let dir = tempfile::tempdir().unwrap();
    bundle.write(&skin_with(""), dir.path());
    let error = load(&skin_with(""), &[dir.path()]).err().unwrap().to_string();
    assert!(error.contains("has 3 numbers where the surface needs 25"), "{error}");
}

/// The pad of nine with a bundle that is refined on its forward model, tared.
fn refined(outputs: &[Out], masked: &[String]) -> (SkinEstimator, tempfile::TempDir) {
    let skin = nine();
    let mut bundle = TestBundle { inversion: Some(Settings::new(0.004, 5.0)), ..TestBundle::default() };
    bundle.outputs.extend_from_slice(outputs);
    let dir = tempfile::tempdir().unwrap();
    bundle.write(&skin, dir.path());
    let mut estimator = load_for(STRETCHED, &skin, &[dir.path()], masked).unwrap();
    for k in 0..80 {
        pressed(&mut estimator, k, None, &[]);
    }
    assert!(estimator.zero().is_some());
    (estimator, dir)
}

/// One frame of that pad under a press at \[m\] with \[N\], without these channels.
fn pressed(
    estimator: &mut SkinEstimator,
    k: u64,
    press: Option<([f64; 2], f64)>,
    broken: &[usize],
) -> Estimate {
    let contacts = press.map(|([x, y], force)| {
        Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -force), 0.004)
    });
    let stimulus = Stimulus { contacts: contacts.into_iter().collect(), ..Stimulus::default() };
    let mut signal = [0.0; 9];
    membrane(&nine()).response(&stimulus, &mut signal).unwrap();
    let wiggle = |i: usize| [6.0, -6.0, -6.0, 6.0][(k as usize + i) % 4];
    let value = |(i, s): (usize, &f64)| {
        if broken.contains(&i) { f32::NAN } else { IDLE + *s as f32 + wiggle(i) }
    };
    let values = signal.iter().enumerate().map(value).collect();
    estimator.estimate(&Frame::new(k as i64 * 10_000_000, k, values)).unwrap()
}

#[test]
fn a_forward_model_does_without_a_channel_and_says_how_well() {
    let (mut whole, _dir) = refined(&[], &[]);
    let press = Some(([0.003, 0.001], 1.0));
    let place = Point3::new(0.003, 0.001, 0.0);
    let all = pressed(&mut whole, 80, press, &[]).contacts.remove(0);
    assert_eq!((whole.verdict().quality, whole.verdict().text.as_str()), (Quality::Ok, ""));
    assert!((all.position - place).norm() < 2e-4, "{}", all.position);
    // The two that feel it most: dead, then left out by the configuration.
    let (mut masked, _dir) = refined(&[], &["t4".into(), "t5".into()]);
    let without = [
        (pressed(&mut whole, 81, press, &[4, 5]).contacts.remove(0), &whole, "not finite"),
        (pressed(&mut masked, 81, press, &[]).contacts.remove(0), &masked, "masked"),
    ];
    for (contact, estimator, why) in without {
        let verdict = estimator.verdict();
        assert_eq!(verdict.quality, Quality::Degraded);
        assert_eq!(verdict.text, format!("2 of 9 channels are impaired: t4 ({why}), t5 ({why})"));
        let error = (contact.position - place).norm();
        let sigma = contact.position_covariance.trace().sqrt();
        assert!(error < 1e-3 && error < 4.0 * sigma, "{} ± {sigma}", contact.position);
        let before = all.position_covariance.trace().sqrt();
        assert!(sigma > 1.1 * before, "it knows less: {sigma} after {before}");
        assert!((contact.normal_force() - 1.0).abs() < 0.1, "{}", contact.normal_force());
        assert!(contact.confidence < all.confidence);
    }
}

#[test]
fn a_network_is_given_what_the_forward_model_expects_of_a_missing_channel() {
    // 1 N for 1 kPa on the first channel.
    let points = nine().surface().points.len();
    let mut map = Out::new(MAP_NORMAL, "N", 1.0, [1.0, 0.0, 0.0, 0.0]);
    map.count = points;
    let (mut estimator, _dir) = refined(&[map], &[]);
    let press = Some(([-0.006, -0.007], 1.0));
    let mut first = |k, broken: &[usize]| {
        let map = pressed(&mut estimator, k, press, broken).force_map.unwrap();
        let ForceValues::Normal(values) = map.forces else { panic!("vector map") };
        values[0]
    };
    let (all, without) = (first(80, &[]), first(81, &[0]));
    assert!(all > 1.5 && (without - all).abs() < 0.1, "{all} became {without}");
    assert!(pressed(&mut estimator, 82, None, &[0]).contacts.is_empty());
}

#[test]
fn maps_are_made_of_refined_contacts_where_somebody_asks() {
    let (mut estimator, _dir) = refined(&[], &[]);
    assert_eq!(estimator.maps(), Maps::ALL);
    let points = nine().surface().points.len();
    let idle = pressed(&mut estimator, 80, None, &[]);
    assert_eq!(idle.force_map.unwrap().forces, ForceValues::Normal(vec![0.0; points]));
    assert_eq!(idle.displacement_map.unwrap().displacements, vec![0.0; points]);

    let touched = pressed(&mut estimator, 81, Some(([0.004, -0.002], 2.0)), &[]);
    let contact = &touched.contacts[0];
    let ForceValues::Normal(forces) = touched.force_map.unwrap().forces else { panic!("vector map") };
    let sum: f64 = forces.iter().map(|f| f64::from(*f)).sum();
    assert!((sum - contact.normal_force()).abs() < 1e-5, "{sum} of {}", contact.normal_force());
    for (point, force) in nine().surface().points.iter().zip(&forces) {
        assert_eq!(*force > 0.0, (point - contact.position).norm() <= REACH, "at {point}");
    }
    let displacements = touched.displacement_map.unwrap().displacements;
    let most = displacements.iter().copied().fold(0.0, f32::max);
    assert!((f64::from(most) - 2.0 * COMPLIANCE).abs() < 1e-4, "{most} m inwards");

    // Made ready elsewhere, so that no frame waits for it.
    let begun = std::time::Instant::now();
    while !estimator.displacements_ready() {
        assert!(begun.elapsed().as_secs() < 30);
        std::thread::yield_now();
    }
    estimator.want_maps(Maps::NONE);
    let plain = pressed(&mut estimator, 82, Some(([0.004, -0.002], 2.0)), &[]);
    assert!(plain.contacts.len() == 1 && plain.force_map.is_none() && plain.displacement_map.is_none());
    let blind = pressed(&mut estimator, 83, None, &[0, 1, 2, 3, 4, 5]);
    assert!(blind.force_map.is_none() && estimator.verdict().quality == Quality::Fault);
}

/// One frame of the pad of nine under presses at \[m\] with \[N\].
fn both(k: u64, presses: &[([f64; 2], f64)]) -> Frame {
    let contacts = presses.iter().map(|([x, y], force)| {
        Indentation::sphere(Point3::new(*x, *y, 0.0), Vector3::new(0.0, 0.0, -force), 0.004)
    });
    let mut signal = [0.0; 9];
    let stimulus = Stimulus { contacts: contacts.collect(), ..Stimulus::default() };
    membrane(&nine()).response(&stimulus, &mut signal).unwrap();
    let wiggle = |i: usize| [6.0, -6.0, -6.0, 6.0][(k as usize + i) % 4];
    let values = signal.iter().enumerate().map(|(i, s)| IDLE + *s as f32 + wiggle(i)).collect();
    Frame::new(k as i64 * 10_000_000, k, values)
}

/// An estimator of two contacts on the pad of nine, after 80 untouched frames.
fn of_two() -> (SkinEstimator, tempfile::TempDir) {
    let skin = nine();
    let mut settings = Settings::new(0.004, 5.0);
    (settings.contacts, settings.distance) = (2, 0.006);
    settings.search = dermis_inversion::Search::Pairs;
    let bundle = TestBundle { inversion: Some(settings), ..TestBundle::default() };
    let dir = tempfile::tempdir().unwrap();
    bundle.write(&skin, dir.path());
    let mut estimator = load_for(STRETCHED, &skin, &[dir.path()], &[]).unwrap();
    for k in 0..80 {
        estimator.estimate(&both(k, &[])).unwrap();
    }
    (estimator, dir)
}

#[test]
fn two_contacts_keep_their_identities_and_both_are_in_the_maps() {
    let (mut estimator, _dir) = of_two();
    let (a, b, surface) = ([-0.007, -0.006], [0.006, 0.007], nine().surface());
    let near = |c: &Contact, [x, y]: [f64; 2]| (c.position - Point3::new(x, y, 0.0)).norm() < 1e-3;
    let one = estimator.estimate(&both(80, &[(a, 1.0)])).unwrap().contacts;
    assert!(one.len() == 1 && near(&one[0], a) && one[0].track_id == 1, "{one:?}");
    for k in 81..100 {
        // The second grows above the first.
        let second = 0.4 + 0.08 * (k - 80) as f64;
        let estimate = estimator.estimate(&both(k, &[(a, 1.0), (b, second)])).unwrap();
        let mut found = estimate.contacts;
        found.sort_by_key(|c| c.track_id);
        assert_eq!(found.iter().map(|c| c.track_id).collect::<Vec<_>>(), [1, 2], "{found:?}");
        assert!(near(&found[0], a) && near(&found[1], b), "{found:?}");
        assert!((found[1].normal_force() - second).abs() < 0.15, "{found:?}");
        assert!(!found[0].taxels.is_empty() && found[0].taxels != found[1].taxels);
        let ForceValues::Normal(forces) = estimate.force_map.unwrap().forces else { panic!("vector map") };
        let sum: f64 = forces.iter().map(|f| f64::from(*f)).sum();
        assert!((sum - found[0].normal_force() - found[1].normal_force()).abs() < 1e-4);
        let depth = estimate.displacement_map.unwrap().displacements;
        let at = |[x, y]: [f64; 2]| {
            let place = Point3::new(x, y, 0.0);
            let under = surface.points.iter().zip(&depth).filter(|(p, _)| (*p - place).norm() < 2e-3);
            under.fold(0.0, |most, (_, d)| f64::from(*d).max(most))
        };
        assert!(at(a) > 0.8 * COMPLIANCE && at(b) > 0.3 * COMPLIANCE);
    }
    // One that ends leaves the other alone; a frame that is skipped changes nothing.
    estimator.pass(&both(100, &[(a, 1.0), (b, 2.0)])).unwrap();
    assert!(estimator.verdict().touched);
    let left = estimator.estimate(&both(101, &[(b, 2.0)])).unwrap().contacts;
    assert!(left.len() == 1 && near(&left[0], b) && left[0].track_id == 2, "{left:?}");
    assert!(estimator.estimate(&both(102, &[])).unwrap().contacts.is_empty());
    assert!(
        estimator
            .undetectable_fraction()
            .is_some_and(|(force, share)| force > 0.0 && (0.0..1.0).contains(&share))
    );
}

/// Each frame has an answer while a search runs; once it has ended, the answer is what waiting for it would have given.
#[test]
fn frames_do_not_wait_for_a_search_in_the_background() {
    let (mut waits, _dir) = of_two();
    let (mut estimator, _dir) = of_two();
    estimator.search_in_background(true);
    let presses = [([-0.007, -0.006], 1.0), ([0.006, 0.007], 1.4)];
    let expected = waits.estimate(&both(80, &presses)).unwrap().contacts;
    assert_eq!(expected.len(), 2);
    let begun = std::time::Instant::now();
    let mut k = 80;
    let found = loop {
        let found = estimator.estimate(&both(k, &presses)).unwrap().contacts;
        assert!((1..=2).contains(&found.len()), "{found:?}");
        if found.len() == 2 {
            break found;
        }
        let Verdict { quality, text, .. } = estimator.verdict();
        assert!(*quality == Quality::Degraded && text.contains("first guess"), "{text}");
        assert!(begun.elapsed() < std::time::Duration::from_secs(20), "no search has ended");
        std::thread::sleep(std::time::Duration::from_millis(1));
        // The noise of a frame comes again every four.
        k += 4;
    };
    for contact in &expected {
        let same = |c: &&Contact| (c.position - contact.position).norm() < 1e-4;
        let other = found.iter().find(same).unwrap_or_else(|| panic!("{found:?}, not {expected:?}"));
        assert!((other.force - contact.force).norm() < 1e-2);
    }
    // They are followed from now on, and what is gone is forgotten.
    assert_eq!(estimator.estimate(&both(k + 1, &presses)).unwrap().contacts.len(), 2);
    assert_eq!(estimator.verdict().quality, Quality::Ok);
    assert!(estimator.estimate(&both(k + 2, &[])).unwrap().contacts.is_empty());
    let again = estimator.estimate(&both(k + 3, &presses[..1])).unwrap().contacts;
    assert!(again.len() == 1 && (again[0].position.x + 0.007).abs() < 1e-3, "{again:?}");
}

/// Frames that come fast do not wait for the search of one contact either; those that come slowly do.
#[test]
fn a_single_contact_of_fast_frames_is_searched_in_the_background() {
    let estimator = |rate: f64| {
        let mut skin = nine();
        skin.rate = rate;
        let bundle = TestBundle { inversion: Some(Settings::new(0.004, 5.0)), ..TestBundle::default() };
        let dir = tempfile::tempdir().unwrap();
        bundle.write(&skin, dir.path());
        let mut estimator = load_for(STRETCHED, &skin, &[dir.path()], &[]).unwrap();
        estimator.search_in_background(true);
        for k in 0..80 {
            estimator.estimate(&both(k, &[])).unwrap();
        }
        (estimator, dir)
    };
    let press = [([-0.007, -0.006], 1.0)];
    let (mut slow, _dir) = estimator(100.0);
    let expected = slow.estimate(&both(80, &press)).unwrap().contacts;
    assert_eq!((expected.len(), slow.verdict().quality), (1, Quality::Ok));
    let (mut fast, _dir) = estimator(1000.0);
    let first = fast.estimate(&both(80, &press)).unwrap().contacts;
    assert_eq!((first.len(), fast.verdict().quality), (1, Quality::Degraded), "{}", fast.verdict().text);
    let begun = std::time::Instant::now();
    let mut k = 80;
    let found = loop {
        std::thread::sleep(std::time::Duration::from_millis(1));
        // The noise of a frame comes again every four.
        k += 4;
        let found = fast.estimate(&both(k, &press)).unwrap().contacts;
        if fast.verdict().quality == Quality::Ok {
            break found;
        }
        assert!(begun.elapsed() < std::time::Duration::from_secs(20), "no search has ended");
    };
    assert!((found[0].position - expected[0].position).norm() < 1e-4, "{found:?}, not {expected:?}");
    assert!((found[0].force - expected[0].force).norm() < 1e-2);
    // It is followed where it goes, and forgotten where it ends.
    for step in 1..=20 {
        k += 4;
        let at = -0.006 + 3e-4 * f64::from(step);
        let moved = fast.estimate(&both(k, &[([-0.007, at], 1.0)])).unwrap().contacts;
        assert!(moved.len() == 1 && (moved[0].position.y - at).abs() < 5e-4, "{at}: {moved:?}");
    }
    assert!(fast.estimate(&both(k + 4, &[])).unwrap().contacts.is_empty());
    assert_eq!(fast.estimate(&both(k + 8, &press)).unwrap().contacts.len(), 1);
    assert_eq!(fast.verdict().quality, Quality::Degraded, "another touch is searched anew");
}

#[test]
fn dropped_frames_are_conditioned_all_the_same() {
    let bundle = TestBundle { taps: vec![0, 5], ..TestBundle::default() };
    let (mut estimator, _dir) = tared_estimator(&bundle);
    for k in 80..86 {
        estimator.pass(&frame(k, [2000.0, 0.0, 0.0, 0.0])).unwrap();
    }
    let contacts = press(&mut estimator, 86, [2000.0, 0.0, 0.0, 0.0]).contacts;
    assert_eq!(contacts.len(), 1, "the history is filled: {}", estimator.verdict().text);
    assert!(estimator.pass(&Frame::new(0, 9, vec![0.0; 5])).is_err());
}

#[test]
fn a_forward_model_is_corrected_by_what_was_recorded() {
    let skin = nine();
    let channels = skin.channels().len();
    let weights = vec![0.0_f32; channels];
    let text = |gains: &[f64]| {
        format!(
            "{{\"centres\":[[0.0,0.0,0.0]],\"length\":0.01,\"force\":1.0,\"powers\":1,\"gains\":{gains:?},\"weights\":{weights:?}}}"
        )
    };
    // Channels that read half and twice of what the design says.
    let gains: Vec<f64> = (0..channels).map(|i| if i % 2 == 0 { 0.5 } else { 2.0 }).collect();
    let bundle = TestBundle { inversion: Some(Settings::new(0.004, 5.0)), ..TestBundle::default() };
    let dir = tempfile::tempdir().unwrap();
    bundle.write(&skin, dir.path());
    let error = |corrected: bool| {
        let mut loaded = Bundle::load(dir.path(), &skin).unwrap();
        let mut manifest = loaded.manifest().clone();
        manifest.correction = corrected.then(dermis_inference::CorrectionSection::default);
        let correction = corrected.then(|| serde_json::from_str(&text(&gains)).unwrap());
        loaded.amend(manifest, correction).unwrap();
        let mut estimator = load_for(STRETCHED, &skin, &[dir.path()], &[]).unwrap();
        let device = |k: u64, presses: &[([f64; 2], f64)]| {
            let mut frame = both(k, presses);
            for (value, gain) in frame.values.iter_mut().zip(&gains) {
                *value = IDLE + (*value - IDLE) * *gain as f32;
            }
            frame
        };
        for k in 0..80 {
            estimator.estimate(&device(k, &[])).unwrap();
        }
        let found = estimator.estimate(&device(80, &[([0.003, 0.004], 1.0)])).unwrap().contacts;
        (found[0].position - Point3::new(0.003, 0.004, 0.0)).norm()
    };
    let (without, with) = (error(false), error(true));
    assert!(with < 3e-4 && without > 5.0 * with, "{without} m, {with} m with the correction");
}

#[test]
fn drift_that_a_bundle_knows_of_is_no_light_contact() {
    let skin = nine();
    let detect = |presence: f64, newtons: f64| {
        let settings = Settings { presence, ..Settings::new(0.004, 5.0) };
        let bundle = TestBundle { inversion: Some(settings), ..TestBundle::default() };
        let dir = tempfile::tempdir().unwrap();
        bundle.write(&skin, dir.path());
        let mut estimator = load_for(STRETCHED, &skin, &[dir.path()], &[]).unwrap();
        for k in 0..80 {
            estimator.estimate(&both(k, &[])).unwrap();
        }
        let contacts = estimator.estimate(&both(80, &[([0.003, 0.004], newtons)])).unwrap().contacts;
        assert_eq!(contacts.is_empty(), !estimator.verdict().touched);
        (!contacts.is_empty(), estimator.verdict().level)
    };
    // So light that the level does not show it.
    let light = (1..40).map(|k| f64::from(k) * 2e-3).find(|newtons| detect(30.0, *newtons).0).unwrap();
    let (level, threshold) = (detect(30.0, light).1, skin.condition.contact_threshold);
    assert!(level < threshold, "{light} N: {level}");
    assert!(!detect(1e4, light).0, "what untouched readings reach is no contact");
    assert!(detect(1e4, 1.0).0, "what the level shows is one, whatever the drift");
}

#[test]
fn a_displacement_map_appears_where_the_model_gives_one() {
    let points = skin_with("").surface().points.len();
    let mut bundle = TestBundle::default();
    let mut map = Out::new(MAP_DISPLACEMENT, "m", 1e-4, [1.0, 0.0, 0.0, 0.0]);
    map.count = points;
    bundle.outputs.push(map);
    let (mut estimator, _dir) = tared_estimator(&bundle);
    assert_eq!(estimator.maps(), Maps { force: false, displacement: true });
    let pressed = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]);
    let displacements = pressed.displacement_map.unwrap().displacements;
    assert!(displacements.len() == points && (displacements[7] - 2e-4).abs() < 1e-5);
    assert!(pressed.force_map.is_none());
}

#[test]
fn a_force_without_a_point_under_it_goes_to_the_nearest() {
    let surface = skin_with("").surface();
    let mut contact = Contact::at(Point3::new(0.001, 0.0, 0.0), Vector3::z());
    contact.force = Vector3::new(0.3, 0.0, -2.0);
    contact.diameter = 0.001;
    let contacts = [contact];
    let ForceValues::Normal(forces) = spread_forces(&surface, &contacts, false).forces else {
        panic!("vectors, and not what presses alone");
    };
    assert_eq!(forces.iter().filter(|f| **f > 0.0).count(), 1);
    assert!((forces.iter().sum::<f32>() - 2.0).abs() < 1e-6);
    let ForceValues::Vector(vectors) = spread_forces(&surface, &contacts, true).forces else {
        panic!("what presses alone, and no vectors");
    };
    let pressed: Vec<&[f32; 3]> = vectors.iter().filter(|f| f[2] != 0.0).collect();
    assert_eq!(pressed, [&[0.3, 0.0, -2.0]]);
}

#[test]
fn a_requested_tare_leaves_identities_and_takes_a_new_zero() {
    let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
    assert_eq!(press(&mut estimator, 80, [2000.0, 0.0, 0.0, 0.0]).contacts[0].track_id, 1);
    Estimator::tare(&mut estimator);
    assert!(press(&mut estimator, 81, [400.0, 0.0, 0.0, 0.0]).contacts.is_empty());
    assert_eq!(estimator.verdict().quality, Quality::Uncalibrated, "the old zero is known to be wrong");
    for k in 82..140 {
        press(&mut estimator, k, [400.0, 0.0, 0.0, 0.0]);
    }
    assert!((estimator.zero().unwrap()[0] - 101_725.0).abs() < 10.0);
    assert_eq!(press(&mut estimator, 140, [2400.0, 0.0, 0.0, 0.0]).contacts[0].track_id, 2);
}

#[test]
fn a_model_with_history_never_sees_two_zeros_at_once() {
    let bundle = TestBundle { taps: vec![0, 5], ..TestBundle::default() };
    let (mut estimator, _dir) = tared_estimator(&bundle);
    estimator.begin_tare(false).unwrap();
    let mut k = 80;
    while estimator.tare_state() != TareState::Done {
        press(&mut estimator, k, [0.0; 4]);
        k += 1;
    }
    press(&mut estimator, k, [2000.0, 0.0, 0.0, 0.0]);
    assert!(estimator.verdict().text.starts_with("touched, but"), "{}", estimator.verdict().text);
}

#[test]
fn frames_of_another_skin_are_refused() {
    let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
    let error = estimator.estimate(&Frame::new(0, 9, vec![0.0; 5])).unwrap_err().to_string();
    assert_eq!(error, "frame 9 has 5 channels where the skin has 4");
}

#[test]
fn a_history_that_is_not_filled_is_no_untouched_skin() {
    let bundle = TestBundle { taps: vec![0, 5], ..TestBundle::default() };
    let (mut estimator, _dir) = tared_estimator(&bundle);
    // A pause of a second empties the history.
    let estimate = press(&mut estimator, 200, [2000.0, 0.0, 0.0, 0.0]);
    assert!(estimate.contacts.is_empty());
    assert_eq!(estimator.verdict().quality, Quality::Uncalibrated);
    assert!(estimator.verdict().text.starts_with("touched, but"));
    for k in 201..206 {
        press(&mut estimator, k, [2000.0, 0.0, 0.0, 0.0]);
    }
    assert_eq!(estimator.verdict().quality, Quality::Ok);
}
