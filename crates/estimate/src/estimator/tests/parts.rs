//! Parts of a device that are out of order, and contacts without a bundle.

use dermis_sensor::{ElementFault, FrameCheck};

use super::*;
use crate::models::Models;
use crate::testing::PAD;

/// The pad of nine without a bundle, tared.
fn without_bundle() -> SkinEstimator {
    let mut estimator = SkinEstimator::new(&nine(), &[]).unwrap();
    estimator.set_models(Models::inverted(STRETCHED, &nine()).unwrap());
    for k in 0..80 {
        pressed(&mut estimator, k, None, &[]);
    }
    estimator
}

#[test]
fn contacts_are_found_without_a_bundle() {
    let mut estimator = without_bundle();
    assert!(pressed(&mut estimator, 80, None, &[]).contacts.is_empty());
    assert_eq!(estimator.verdict().quality, Quality::Ok, "{}", estimator.verdict().text);
    let found = pressed(&mut estimator, 81, Some(([0.003, 0.001], 0.8)), &[]);
    let [contact] = found.contacts.as_slice() else { panic!("{found:?}") };
    assert!((contact.position - Point3::new(0.003, 0.001, 0.0)).norm() < 1e-3, "{}", contact.position);
    assert!((contact.normal_force() - 0.8).abs() < 0.1, "{}", contact.normal_force());
    assert!(found.force_map.is_some() && found.displacement_map.is_some() && estimator.gives_force());
    // What the skin is rated for, and a little more.
    assert!((estimator.force_max() - 1.2).abs() < 1e-9, "{}", estimator.force_max());
    // A bundle takes its place.
    let dir = tempfile::tempdir().unwrap();
    TestBundle::default().write(&nine(), dir.path());
    let runtime = dermis_inference::Runtime::load(&dermis_inference::RuntimeConfig::default()).unwrap();
    let bundle = Bundle::load(dir.path(), &nine()).unwrap();
    estimator.replace_models(Models::load(STRETCHED, &nine(), &[bundle], runtime).unwrap());
    assert_eq!(estimator.models().map(|(name, _)| name).collect::<Vec<_>>(), ["linear"]);
}

#[test]
fn without_a_forward_model_there_is_nothing_to_find_contacts_on() {
    let error = Models::inverted(PAD, &nine()).err().unwrap().to_string();
    assert!(error.contains("there is no model bundle, and no forward model to find contacts on"), "{error}");
}

/// A wire to two elements, which is broken where the first of all reads nothing at all.
struct Wire;

impl FrameCheck for Wire {
    fn check(&mut self, frame: &Frame, faults: &mut Vec<ElementFault>) {
        if frame.values[0] == 0.0 {
            faults.push(ElementFault {
                element: "wire 1".into(),
                sentence: "is broken: mend it".into(),
                // One too many, which nobody may stumble over.
                channels: vec![0, 1, 99],
            });
        }
    }
}

#[test]
fn a_part_that_is_out_of_order_is_left_out_and_named() {
    let mut estimator = without_bundle();
    assert_eq!(estimator.element_faults(), None);
    estimator.set_check(Some(Box::new(Wire)));
    let press = Some(([0.006, 0.006], 0.8));
    pressed(&mut estimator, 80, press, &[]);
    assert_eq!((estimator.verdict().quality, estimator.element_faults()), (Quality::Ok, Some(&[][..])));
    // The frame as the device sends it: nothing from the first element, anything from the second.
    let mut frame = estimator.conditioned().reading.clone();
    frame.sequence = 81;
    frame.stamp += 10_000_000;
    (frame.values[0], frame.values[1]) = (0.0, 2.0 * IDLE);
    let found = estimator.estimate(&frame).unwrap();
    assert_eq!(estimator.verdict().quality, Quality::Degraded);
    insta::assert_snapshot!(estimator.verdict().text, @"2 of 9 channels are impaired: wire 1 is broken: mend it");
    assert_eq!(estimator.element_faults().unwrap()[0].element, "wire 1");
    let [contact] = found.contacts.as_slice() else { panic!("{found:?}") };
    assert!((contact.position - Point3::new(0.006, 0.006, 0.0)).norm() < 1.5e-3, "{}", contact.position);
    // It is believed again with the first frame in which it is well.
    pressed(&mut estimator, 82, press, &[]);
    assert_eq!(estimator.verdict().quality, Quality::Ok, "{}", estimator.verdict().text);
}
