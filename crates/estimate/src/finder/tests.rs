use std::path::Path;
use std::sync::Arc;

use dermis_inference::{Baseline, Bundle, Runtime, RuntimeConfig};
use dermis_inversion::{Inverter, Search, Settings, SparseSettings};
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{Estimator, ForceComponents, Frame, SkinDescription};
use nalgebra::{Point3, Vector3};

use super::*;
use crate::testing::{
    STRETCHED, TestBundle, load_for, membrane, nine, skin_with, tared_estimator, write_force_map, write_map,
};
use crate::{SetupError, SkinEstimator};

const MS: Stamp = 1_000_000;

fn runtime() -> &'static Runtime {
    Runtime::load(&RuntimeConfig::default()).unwrap()
}

/// A frame at [ms] whose zero is 0.
fn frame<'a>(at: i64, signal: &'a [f32], flags: &'a [ChannelFlags]) -> ConditionedFrame<'a> {
    ConditionedFrame { stamp: at * MS, reading: signal, signal, flags, image: &[], image_signal: &[] }
}

/// What a finder finds where every channel is well.
fn found(finder: &mut dyn ContactFinder, signal: &[f32]) -> Result<Vec<Contact>, FindError> {
    finder.find(&frame(0, signal, &vec![ChannelFlags::default(); signal.len()]))
}

/// What the pad of nine reads of presses at \[m\] with \[N\].
fn nine_read(presses: &[([f64; 2], f64)]) -> Vec<f32> {
    let press = |([x, y], force): &([f64; 2], f64)| {
        Indentation::sphere(Point3::new(*x, *y, 0.0), Vector3::new(0.0, 0.0, -force), 0.004)
    };
    let stimulus = Stimulus { contacts: presses.iter().map(press).collect(), ..Stimulus::default() };
    let mut signal = [0.0; 9];
    membrane(&nine()).response(&stimulus, &mut signal).unwrap();
    signal.iter().map(|v| *v as f32).collect()
}

/// Whether these contacts are those presses, in the order of their locations.
#[track_caller]
fn assert_are(contacts: &[Contact], presses: &[([f64; 2], f64)], metres: f64, newtons: f64) {
    let mut sorted = contacts.to_vec();
    sorted.sort_by(|a, b| a.position.x.total_cmp(&b.position.x));
    assert_eq!(sorted.len(), presses.len(), "{sorted:?}");
    for (contact, ([x, y], force)) in sorted.iter().zip(presses) {
        let off = (contact.position - Point3::new(*x, *y, 0.0)).norm();
        assert!(off < metres, "{} is {off} m from {x}, {y}", contact.position);
        assert!((contact.normal_force() - force).abs() < newtons, "{} for {force} N", contact.force);
        assert_eq!(contact.force_components, ForceComponents::Normal);
    }
}

/// A finder on the pad of four, of a bundle.
fn network(bundle: &TestBundle) -> (NetworkFinder, tempfile::TempDir) {
    let (skin, dir) = (skin_with(""), tempfile::tempdir().unwrap());
    bundle.write(&skin, dir.path());
    let loaded = Bundle::load(dir.path(), &skin).unwrap();
    (NetworkFinder::new(&loaded, &skin, runtime()).unwrap(), dir)
}

#[test]
fn a_network_gives_one_contact_whatever_touches() {
    let (mut finder, _dir) = network(&TestBundle::default());
    assert!(finder.single());
    // 2 kPa on the first taxel are 2 N, 10 mm out on both axes.
    let contacts = found(&mut finder, &[2000.0, 0.0, 0.0, 0.0]).unwrap();
    assert_are(&contacts, &[([-0.01, -0.01], 2.0)], 1e-6, 1e-5);
    assert!((contacts[0].position_covariance[(0, 0)] - 1e-6).abs() < 1e-12);
    assert!((contacts[0].force_covariance[(2, 2)] - 0.01).abs() < 1e-9);
    // Two presses of 1 N across the diagonal: one of 2 N between them.
    let between = found(&mut finder, &[1000.0, 0.0, 0.0, 1000.0]).unwrap();
    assert_are(&between, &[([0.0, 0.0], 2.0)], 1e-6, 1e-5);
    // It does not judge whether anything touches.
    assert_are(&found(&mut finder, &[0.0; 4]).unwrap(), &[([0.0, 0.0], 0.0)], 1e-6, 1e-5);

    let mut force = TestBundle::default();
    force.outputs.retain(|o| o.name == "force.normal");
    let (mut finder, _dir) = network(&force);
    assert!(found(&mut finder, &[2000.0, 0.0, 0.0, 0.0]).unwrap().is_empty(), "a force without a place");
}

#[test]
fn a_network_does_without_a_channel_but_not_without_all_or_with_others() {
    let (mut finder, _dir) = network(&TestBundle::default());
    let mut flags = [ChannelFlags::default(); 4];
    flags[2] = ChannelFlags::NOT_FINITE;
    let contacts = finder.find(&frame(0, &[2000.0, 0.0, f32::NAN, 0.0], &flags)).unwrap();
    assert_are(&contacts, &[([-0.01, -0.01], 2.0)], 1e-6, 1e-5);
    assert!(matches!(found(&mut finder, &[f32::NAN; 4]), Err(FindError::History(_))));
    let error = found(&mut finder, &[0.0; 5]).unwrap_err();
    assert!(matches!(error, FindError::Features(_)), "{error}");
    assert!(finder.pass(&frame(0, &[0.0; 3], &flags)).is_err());
    assert_eq!(found(&mut finder, &[0.0; 4]).unwrap().len(), 1, "a refusal ends nothing");
}

#[test]
fn a_network_takes_the_readings_that_its_bundle_asks_for() {
    let (mut finder, _dir) = network(&TestBundle { baseline: Baseline::Raw, ..TestBundle::default() });
    let flags = [ChannelFlags::default(); 4];
    let raw = ConditionedFrame { reading: &[1000.0, 0.0, 0.0, 0.0], ..frame(0, &[0.0; 4], &flags) };
    assert_are(&finder.find(&raw).unwrap(), &[([-0.005, -0.005], 1.0)], 1e-6, 1e-5);
}

#[test]
fn a_network_of_several_frames_waits_for_them() {
    let (mut finder, dir) = network(&TestBundle { taps: vec![0, 2], ..TestBundle::default() });
    let (signal, flags) = ([2000.0, 0.0, 0.0, 0.0], [ChannelFlags::default(); 4]);
    let early = finder.find(&frame(0, &signal, &flags)).unwrap_err().to_string();
    assert!(early.contains(&dir.path().display().to_string()) && early.contains("several frames"), "{early}");
    finder.pass(&frame(10, &signal, &flags)).unwrap();
    let contacts = finder.find(&frame(20, &signal, &flags)).unwrap();
    assert_are(&contacts, &[([-0.01, -0.01], 2.0)], 1e-6, 1e-5);
    finder.reset();
    assert!(matches!(finder.find(&frame(30, &signal, &flags)), Err(FindError::History(_))));
}

#[test]
fn a_map_gives_a_contact_for_every_peak() {
    let (skin, dir) = (nine(), tempfile::tempdir().unwrap());
    write_map(&skin, dir.path(), None);
    let bundle = Bundle::load(dir.path(), &skin).unwrap();
    let mut finder = MapFinder::new(&bundle, &skin, runtime()).unwrap();
    assert!(!finder.single());
    assert!(found(&mut finder, &[0.0; 9]).unwrap().is_empty());
    let one = [([-0.008, -0.008], 1.0)];
    let contacts = found(&mut finder, &nine_read(&one)).unwrap();
    assert_are(&contacts, &one, 1e-9, 1e-3);
    assert!((contacts[0].force_covariance[(2, 2)] - 0.01).abs() < 1e-9);
    // Each adds less than 0.2 % to what the other reads.
    let two = [([-0.008, -0.008], 1.0), ([0.008, 0.008], 1.5)];
    assert_are(&found(&mut finder, &nine_read(&two)).unwrap(), &two, 1e-9, 3e-3);

    let signal = nine_read(&two);
    let map = finder.map(&frame(0, &signal, &[ChannelFlags::default(); 9])).unwrap();
    assert_eq!(map.len(), skin.surface().points.len());
    let most = map.iter().copied().fold(0.0, f64::max);
    assert!((most - 3e-3).abs() < 1e-5, "{most} m under 1.5 N");

    // A channel that is missing gives way by nothing, wherever else is pressed.
    let mut broken = nine_read(&two);
    broken[8] = f32::NAN;
    let near = found(&mut finder, &broken).unwrap();
    assert!(near.iter().any(|c| (c.position - Point3::new(-0.008, -0.008, 0.0)).norm() < 1e-9), "{near:?}");
    assert!(near.iter().all(|c| (c.position - Point3::new(0.008, 0.008, 0.0)).norm() > 1e-3), "{near:?}");
    assert!(matches!(found(&mut finder, &[0.0; 4]), Err(FindError::Features(_))));
    assert!(finder.pass(&frame(0, &[0.0; 4], &[])).is_err());
}

#[test]
fn a_bundle_that_gives_no_map_of_this_surface_is_no_map_finder() {
    let (skin, dir) = (skin_with(""), tempfile::tempdir().unwrap());
    TestBundle::default().write(&skin, dir.path());
    let bundle = Bundle::load(dir.path(), &skin).unwrap();
    let error = MapFinder::new(&bundle, &skin, runtime()).err().unwrap();
    assert!(matches!(error, SetupError::NoPeaks { .. }), "{error}");
    assert!(error.to_string().contains("bundle.toml has no `[peaks]`"), "{error}");

    let (skin, dir) = (nine(), tempfile::tempdir().unwrap());
    write_map(&skin, dir.path(), None);
    let bundle = Bundle::load(dir.path(), &skin).unwrap();
    let error = MapFinder::new(&bundle, &skin_with(""), runtime()).err().unwrap();
    assert!(error.to_string().contains("has 169 numbers where the surface needs 25"), "{error}");
}

/// Says the same of every frame, and remembers its calls.
struct Fixed(Vec<Contact>, Arc<std::sync::Mutex<Vec<&'static str>>>);

impl ContactFinder for Fixed {
    fn find(&mut self, _: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        Ok(self.0.clone())
    }

    fn pass(&mut self, _: &ConditionedFrame<'_>) -> Result<(), FindError> {
        self.1.lock().unwrap().push("pass");
        Ok(())
    }

    fn reset(&mut self) {
        self.1.lock().unwrap().push("reset");
    }
}

fn fixed(presses: &[([f64; 2], f64)]) -> Box<Fixed> {
    let contact = |([x, y], force): &([f64; 2], f64)| {
        let mut contact = Contact::at(Point3::new(*x, *y, 0.0), Vector3::z());
        contact.force = Vector3::new(0.0, 0.0, -force);
        contact.force_components = ForceComponents::Normal;
        contact
    };
    Box::new(Fixed(presses.iter().map(contact).collect(), Arc::default()))
}

fn inversion(start: Start) -> InversionFinder {
    let mut settings = Settings::new(0.004, 5.0);
    (settings.contacts, settings.distance) = (2, 0.006);
    InversionFinder::new(Inverter::new(Arc::new(membrane(&nine())), settings).unwrap(), start)
}

/// Every way to begin; those that call others receive locations some millimetres off.
fn ways(presses: &[([f64; 2], f64)]) -> Vec<(&'static str, InversionFinder)> {
    let rough: Vec<_> = presses.iter().map(|([x, y], force)| ([x + 0.002, y - 0.001], force * 0.8)).collect();
    [
        ("greedy", Start::Greedy),
        ("pairs", Start::Pairs),
        ("refine", Start::Refine(fixed(&rough))),
        ("bundle", Start::Bundle(fixed(&rough))),
        ("sparse", Start::Sparse(SparseSettings::default())),
        ("sparse only", Start::SparseOnly(SparseSettings::default())),
    ]
    .into_iter()
    .map(|(name, start)| (name, inversion(start)))
    .collect()
}

#[test]
fn an_inversion_finds_one_contact_and_two_wherever_it_begins() {
    let one = [([0.003, 0.001], 1.0)];
    let two = [([-0.007, -0.006], 1.0), ([0.006, 0.007], 1.2)];
    for presses in [&one[..], &two[..]] {
        for (name, mut finder) in ways(presses) {
            assert!(!finder.single());
            let contacts = found(&mut finder, &nine_read(presses)).unwrap();
            // A sparse recovery knows the points of its grid, 2 mm apart, and pays for every force.
            let (metres, newtons) = if name == "sparse only" { (1e-3, 0.1) } else { (2e-4, 0.02) };
            assert_are(&contacts, presses, metres, newtons);
            let known = contacts.iter().all(|c| c.position_covariance[(0, 0)] > 0.0);
            assert_eq!(known, name != "sparse only", "{name}");
        }
    }
}

#[test]
fn an_inversion_of_nothing_is_nothing_or_as_light_as_noise() {
    for (name, mut finder) in ways(&[]) {
        let contacts = found(&mut finder, &[0.0; 9]).unwrap();
        match name {
            // The first contact is there because it was requested; 20 Pa of noise are 0.01 N.
            "greedy" | "pairs" | "bundle" => {
                assert!(contacts.len() <= 1, "{name}: {contacts:?}");
                assert!(contacts.iter().all(|c| c.normal_force().abs() < 0.05), "{name}: {contacts:?}");
            }
            _ => assert!(contacts.is_empty(), "{name}: {contacts:?}"),
        }
    }
    // Of no reading at all nothing can be said: the answer of the other stands.
    let learned = [([0.003, 0.001], 1.0)];
    let mut finder = inversion(Start::Bundle(fixed(&learned)));
    assert_are(&found(&mut finder, &[f32::NAN; 9]).unwrap(), &learned, 1e-9, 1e-9);
}

#[test]
fn an_inversion_does_without_a_channel_but_not_with_others() {
    let press = [([0.003, 0.001], 1.0)];
    let mut signal = nine_read(&press);
    signal[4] = f32::NAN;
    let mut flags = [ChannelFlags::default(); 9];
    flags[4] = ChannelFlags::NOT_FINITE;
    // A reading that is there and wrong counts as missing where its flag says so.
    let mut wrong = nine_read(&press);
    wrong[4] = -5000.0;
    for (name, mut finder) in ways(&press) {
        if name == "sparse only" {
            continue;
        }
        for signal in [&signal, &wrong] {
            let contacts = finder.find(&frame(0, signal, &flags)).unwrap();
            assert_are(&contacts[..1], &press, 5e-4, 0.05);
        }
        let error = found(&mut finder, &[0.0; 4]).unwrap_err();
        assert!(matches!(error, FindError::Inversion(_)), "{name}: {error}");
    }
}

#[test]
fn an_inversion_hands_frames_and_resets_on() {
    let other = fixed(&[]);
    let calls = Arc::clone(&other.1);
    let mut finder = inversion(Start::Refine(other));
    finder.pass(&frame(0, &[0.0; 9], &[ChannelFlags::default(); 9])).unwrap();
    finder.reset();
    assert_eq!(*calls.lock().unwrap(), ["pass", "reset"]);
}

/// A regression on the pad of four, whose noise is 20 Pa.
fn regression(
    regress: impl Fn(&[f64]) -> Result<Vec<f64>, String> + Send + 'static,
) -> Result<Vec<Contact>, FindError> {
    let mut finder = RegressionFinder::new(&skin_with(""), Box::new(regress));
    assert!(finder.single());
    found(&mut finder, &[40.0, f32::NAN, 0.0, -20.0])
}

#[test]
fn a_regression_takes_whitened_readings_and_gives_a_contact_on_the_surface() {
    let contacts = regression(|row| {
        assert_eq!(
            row,
            [2.0, 0.0, 0.0, -1.0],
            "in deviations of the noise, and 0 where a channel is missing"
        );
        Ok(vec![0.003, -0.002, 0.004, 1.5])
    });
    assert_are(&contacts.unwrap(), &[([0.003, -0.002], 1.5)], 1e-9, 1e-9);
    let pulls = regression(|_| Ok(vec![0.003, -0.002, 0.0, -1.5])).unwrap();
    assert_are(&pulls, &[([0.003, -0.002], 0.0)], 1e-9, 1e-9);
    let full = regression(|_| Ok(vec![0.003, -0.002, 0.0, 0.1, 0.2, -1.5])).unwrap();
    assert_eq!(full[0].force_components, ForceComponents::Full);
    assert_eq!(full[0].force, Vector3::new(0.1, 0.2, -1.5));
}

#[test]
fn a_regression_that_fails_says_so() {
    let message = |answer: Result<Vec<Contact>, FindError>| answer.unwrap_err().to_string();
    insta::assert_snapshot!(message(regression(|_| Err("failed: no rows".into()))), @"a regression failed: no rows");
    insta::assert_snapshot!(message(regression(|_| Ok(vec![0.0; 3]))), @"a regression gave 3 numbers where 4 or 6 are expected");
    let mut finder = RegressionFinder::new(&skin_with(""), Box::new(|_| Ok(vec![0.0; 4])));
    insta::assert_snapshot!(message(found(&mut finder, &[0.0; 3])), @"a regression was given 3 channels where its skin has 4");
}

/// Whether a finder gives the very contacts, and the force map, that the estimator of a node gave.
#[track_caller]
fn assert_same(estimator: &SkinEstimator, finder: &mut dyn ContactFinder, estimate: &Estimate) {
    let found = finder.estimate(&estimator.conditioned().frame()).unwrap();
    assert_eq!(found.contacts.len(), estimate.contacts.len());
    for (found, contact) in found.contacts.iter().zip(&estimate.contacts) {
        assert_eq!((found.position, found.force), (contact.position, contact.force));
        assert_eq!(found.position_covariance, contact.position_covariance);
        assert_eq!(found.force_covariance, contact.force_covariance);
        assert_eq!(found.force_components, contact.force_components);
    }
    assert_eq!(found.force_map, estimate.force_map);
    if found.displacement_map.is_some() {
        assert_eq!(found.displacement_map, estimate.displacement_map);
    }
}

/// A node of the pad of nine with this bundle, and what it makes of the first touch after a tare.
fn node(folder: &Path, skin: &SkinDescription, press: &[f32]) -> (SkinEstimator, Estimate) {
    let mut estimator = load_for(STRETCHED, skin, &[folder], &[]).unwrap();
    for k in 0..80_u64 {
        let wiggle = |i: usize| [6.0, -6.0, -6.0, 6.0][(k as usize + i) % 4];
        let values = (0..9).map(|i| 101_325.0 + wiggle(i)).collect();
        estimator.estimate(&Frame::new(k as i64 * 10 * MS, k, values)).unwrap();
    }
    let values = press.iter().map(|v| 101_325.0 + v).collect();
    let estimate = estimator.estimate(&Frame::new(800 * MS, 80, values)).unwrap();
    (estimator, estimate)
}

#[test]
fn finders_give_what_the_estimator_of_a_node_gives() {
    let bundle = TestBundle::default();
    let (mut estimator, kept) = tared_estimator(&bundle);
    let values = [2000.0, 300.0, 0.0, 100.0].map(|load| 101_325.0 + load).to_vec();
    let estimate = estimator.estimate(&Frame::new(100 * 10 * MS, 100, values)).unwrap();
    assert_eq!(estimate.contacts.len(), 1);
    let (mut finder, _dir) = network(&bundle);
    assert_same(&estimator, &mut finder, &estimate);
    let skin = skin_with("");
    let loaded = Bundle::load(kept.path(), &skin).unwrap();
    let mut finder = finder_of(&loaded, &skin, || panic!("no model was requested"), runtime()).unwrap();
    assert!(finder.single());
    assert_same(&estimator, finder.as_mut(), &estimate);
}

#[test]
fn the_finder_of_a_bundle_gives_what_a_node_with_it_gives() {
    let (skin, press) = (nine(), nine_read(&[([-0.007, -0.006], 1.0), ([0.006, 0.007], 1.2)]));
    type Write = fn(&SkinDescription, &Path, Option<Settings>);
    let network: Write =
        |skin, folder, inversion| TestBundle { inversion, ..TestBundle::default() }.write(skin, folder);
    let bundles: [(&str, Write); 3] =
        [("network", network), ("displacements", write_map), ("forces", write_force_map)];
    let searches = [None, Some(Search::Greedy), Some(Search::Pairs)];
    for ((name, write), search) in bundles.into_iter().flat_map(|b| searches.map(|search| (b, search))) {
        let inversion = search.map(|search| {
            let mut settings = Settings::new(0.004, 5.0);
            (settings.contacts, settings.distance, settings.search) = (2, 0.006, search);
            settings
        });
        let (dir, inverts) = (tempfile::tempdir().unwrap(), inversion.is_some());
        write(&skin, dir.path(), inversion);
        let (estimator, estimate) = node(dir.path(), &skin, &press);
        let contacts = &estimate.contacts;
        let one = name == "network" && !inverts;
        assert_eq!(contacts.len(), if one { 1 } else { 2 }, "{name}, {search:?}: {contacts:?}");
        // A network gives no map, and nothing spreads the force of its contact.
        assert_eq!(estimate.force_map.is_none(), one, "{name}, {search:?}");
        let loaded = Bundle::load(dir.path(), &skin).unwrap();
        let mut finder = finder_of(&loaded, &skin, || STRETCHED.model(&skin), runtime()).unwrap();
        assert_eq!(finder.single(), one, "{name}, {search:?}");
        assert_same(&estimator, finder.as_mut(), &estimate);
        // What the bundle gives by itself does not depend on what refines it.
        let mut learned = learned_finder_of(&loaded, &skin, runtime()).unwrap().unwrap();
        assert_eq!(learned.single(), name == "network");
        if !inverts {
            assert_same(&estimator, learned.as_mut(), &estimate);
        }
    }
}

#[test]
fn a_bundle_asks_for_an_inverter_or_does_not() {
    let (skin, dir) = (nine(), tempfile::tempdir().unwrap());
    let load = || Bundle::load(dir.path(), &skin).unwrap();
    TestBundle::default().write(&skin, dir.path());
    let unused = crate::inverter(&load(), || panic!("no model was requested"));
    assert!(unused.unwrap().is_none());
    TestBundle { inversion: Some(Settings::new(0.004, 5.0)), ..TestBundle::default() }
        .write(&skin, dir.path());
    let error = crate::inverter(&load(), || crate::testing::PAD.model(&skin)).err().unwrap();
    assert!(matches!(error, SetupError::NoForwardModel { .. }), "{error}");
    assert!(crate::inverter(&load(), || STRETCHED.model(&skin)).unwrap().is_some());
}
