use dermis_fixtures::Analytic;

use super::*;
use crate::FORCE_BINS;
use crate::dataset::tests::presses;

/// Both channels of the made-up skin: one tells x by the force, the other the force.
fn made(skin: &dermis_skin::SkinDescription) -> Analytic {
    let locations = skin.taxels.iter().map(dermis_skin::Taxel::point);
    Analytic::of_contacts(skin.surface(), locations, 0.5, |c, _, out| {
        out[0] += c.position.x * 1e4;
        out[1] += -c.force.z * 20.0;
    })
}

#[test]
fn every_touched_sample_counts_in_its_bin() {
    let data = presses(10, 2);
    let model = made(data.skin());
    let found = frame_bounds(&model, &data, None, Unknowns::Normal).unwrap();
    let bounds = found.summary(&FORCE_BINS).unwrap();
    assert_eq!(bounds.samples, 40);
    assert_eq!(bounds.normal_force.iter().map(|b| b.samples).sum::<usize>(), 40);
    // 0.5 of noise over 20 a newton; y shows in no channel.
    assert!(bounds.normal_force.iter().all(|b| (b.rms - 0.025).abs() < 1e-9), "{bounds:?}");
    assert!(bounds.position.iter().all(|b| b.rms.is_infinite()));
    let some: Vec<SampleId> = data.labelled().take(30).map(|(id, ..)| id).collect();
    let fewer = frame_bounds(&model, &data, Some(&some), Unknowns::Normal).unwrap();
    assert!(fewer.summary(&FORCE_BINS).unwrap().samples < 40);
    // Where no channel tells the place, only the force is held against its bound.
    assert_eq!(found.left_out, Unbounded { touched: 40, undetermined: 40, ..Unbounded::default() });
    let errors = [error(data.labelled().find(|(_, _, t)| t.touched()).unwrap().0, [0, 1], 0.01, 0.05)];
    let against = found.against(&errors, &FORCE_BINS);
    let counts: Vec<(&str, usize)> = against.iter().map(|a| (&*a.quantity, a.all.samples)).collect();
    assert_eq!(counts, [("force.normal", 1)]);
    approx::assert_relative_eq!(against[0].all.ratio_of_rms, 2.0, max_relative = 1e-9);
}

#[test]
fn well_determined_positions_stand_apart() {
    let ids = [0, 1, 2].map(|sample| SampleId { run: 0, sample });
    // Bounds of 1, 2 and 10 mm.
    let frames = ids.into_iter().zip([1e-3, 2e-3, 1e-2].map(|b| vec![bound(b)])).collect();
    let bounds = FrameBounds { frames, ..FrameBounds::default() };
    let errors: Vec<ContactError> =
        ids.iter().zip([3e-3, 4e-3, 1e-2]).map(|(id, e)| error(*id, [0, 1], e, 0.1)).collect();
    let against = bounds.against(&errors, &FORCE_BINS);
    let position = against.iter().find(|a| a.quantity == "position").unwrap();
    let well = position.well_determined.as_ref().unwrap();
    assert_eq!((position.all.samples, well.all.samples, well.below), (3, 2, 3e-3));
    approx::assert_relative_eq!(well.all.ratio_of_rms, (25.0f64 / 5.0).sqrt(), max_relative = 1e-9);
    assert_eq!(well.by_force.iter().map(|b| b.ratio.samples).sum::<usize>(), 2);
    assert!(position.to_string().contains("bound < 3 mm"), "{position}");
    // Forces have none, and nothing stands apart where all are.
    assert!(against.iter().all(|a| a.quantity == "position" || a.well_determined.is_none()));
    let sharp = bounds.against(&errors[..2], &FORCE_BINS);
    assert!(sharp.iter().all(|a| a.well_determined.is_none()));
}

#[test]
fn contacts_without_a_finite_bound_are_counted() {
    let ids = [0, 1, 2, 3].map(|sample| SampleId { run: 0, sample });
    let bound_of = [1e-3, f64::INFINITY, f64::INFINITY, 2e-3];
    let frames = ids.into_iter().zip(bound_of.map(|b| vec![bound(b)])).collect();
    let bounds = FrameBounds { frames, ..FrameBounds::default() };
    let mut errors: Vec<ContactError> =
        ids.iter().zip([1e-3, 3e-3, 4e-3, 2e-3]).map(|(id, e)| error(*id, [0, 1], e, 0.1)).collect();
    // The last one presses harder, and is the only one of its bin.
    errors[3].force = 5.0;
    let against = bounds.against(&errors, &[0.5, 2.0]);
    let position = against.iter().find(|a| a.quantity == "position").unwrap();
    assert_eq!(position.all.samples, 2);
    let open = position.undetermined.as_ref().unwrap();
    assert_eq!((open.all.contacts, open.all.share), (2, 0.5));
    approx::assert_relative_eq!(open.all.error_rms, (12.5e-6_f64).sqrt(), max_relative = 1e-12);
    let bins: Vec<_> = open.by_force.iter().map(|b| (b.from, b.to, b.uncounted.contacts)).collect();
    assert_eq!(bins, [(0.5, Some(2.0), 2)]);
    approx::assert_relative_eq!(open.by_force[0].uncounted.share, 2.0 / 3.0, max_relative = 1e-12);
    let text = position.to_string();
    let line = text.lines().find(|l| l.contains("bound is infinite")).unwrap();
    insta::assert_snapshot!(line.trim(), @"left out, the bound is infinite: 2 of 4 contacts (50.0 %), error RMS 3.536; of 0.5-2 N 2 (66.7 %)");
    // Forces are bounded.
    assert!(against.iter().all(|a| a.quantity == "position" || a.undetermined.is_none()));
    let json = serde_json::to_value(&against).unwrap();
    assert_eq!(json[0]["undetermined"]["all"]["contacts"], 2);
    assert_eq!(serde_json::from_value::<Vec<AgainstBound>>(json).unwrap(), against);
}

fn error(id: SampleId, contact: [usize; 2], position: f64, normal_force: f64) -> ContactError {
    let (vector, angle) = (f64::NAN, f64::NAN);
    ContactError { id, contact, force: 1.0, position, normal_force, vector, angle, found: true, stated: None }
}

#[test]
fn all_of_a_force_stands_beside_its_bound_where_shear_is_looked_for() {
    let id = SampleId { run: 0, sample: 0 };
    let mut sheared = bound(1e-3);
    (sheared.1.normal_force, sheared.1.shear) = (0.03, Some(0.04));
    let mut found = ContactError { force: 2.0, ..error(id, [0, 1], 1e-3, 0.1) };
    (found.vector, found.angle) = (0.1, 0.01);
    let bounds = |of| FrameBounds { frames: [(id, vec![of])].into(), ..FrameBounds::default() };
    let against = bounds(sheared).against(&[found], &FORCE_BINS);
    let ratio = |name: &str| against.iter().find(|a| a.quantity == name).unwrap().all.ratio_of_rms;
    approx::assert_relative_eq!(ratio("force"), 2.0, max_relative = 1e-12);
    approx::assert_relative_eq!(ratio("angle"), 0.5, max_relative = 1e-12);
    let straight = bounds(bound(1e-3)).against(&[found], &FORCE_BINS);
    assert!(straight.iter().all(|a| a.quantity != "force" && a.quantity != "angle"));
}

fn bound(position: f64) -> (f64, ContactBound) {
    (1.0, ContactBound { position, along: [position; 2], normal_force: 0.1, shear: None })
}

#[test]
fn errors_stand_beside_the_bounds_of_their_own_frames() {
    let id = |sample| SampleId { run: 0, sample };
    let mut bounds = FrameBounds::default();
    // Bounds of frames 0 to 3 of one contact: 1, 2, 4 and 100 mm; frame 4 has two of 8 and 6 mm; frame 5 was never answered.
    for (sample, mm) in [1.0, 2.0, 4.0, 100.0].into_iter().enumerate() {
        bounds.frames.insert(id(sample), vec![bound(mm * 1e-3)]);
    }
    bounds.frames.insert(id(4), vec![bound(8e-3), bound(6e-3)]);
    bounds.frames.insert(id(5), vec![bound(5.0)]);
    let mut errors: Vec<ContactError> =
        (0..4).map(|n| error(id(n), [0, 1], [1e-3, 1e-3, 1e-3, 10e-3][n], 0.05)).collect();
    errors.extend([error(id(4), [0, 2], 4e-3, 0.1), error(id(4), [1, 2], 3e-3, 0.1)]);
    // Of frame 9 there is no bound.
    errors.push(error(id(9), [0, 1], 1.0, 1.0));
    // What is not found counts with everything, and is listed apart.
    errors[3].found = false;
    let against = bounds.against(&errors, &[0.5, 2.0]);
    let one = &against.iter().find(|a| a.contacts == 1 && a.quantity == "position").unwrap().all;
    assert_eq!((one.samples, one.not_found), (4, 0.25));
    approx::assert_relative_eq!(one.error_rms, (103e-6_f64 / 4.0).sqrt(), max_relative = 1e-12);
    approx::assert_relative_eq!(one.bound_rms, (10_021e-6_f64 / 4.0).sqrt(), max_relative = 1e-12);
    approx::assert_relative_eq!(one.bound_median, 3e-3, max_relative = 1e-12);
    approx::assert_relative_eq!(one.ratio_of_rms, (103.0_f64 / 10_021.0).sqrt(), max_relative = 1e-12);
    // Ratios 1, 0.5, 0.25 and 0.1.
    approx::assert_relative_eq!(one.median_ratio, 0.375, max_relative = 1e-12);
    let found = one.found.as_ref().unwrap();
    approx::assert_relative_eq!(found.ratio_of_rms, (3.0_f64 / 21.0).sqrt(), max_relative = 1e-12);
    assert_eq!((found.samples, found.median_ratio, &found.found), (3, 0.5, &None));
    // Several have a bound of their own.
    let two = against.iter().find(|a| a.contacts == 2 && a.quantity == "position").unwrap();
    approx::assert_relative_eq!(two.all.ratio_of_rms, 0.5, max_relative = 1e-12);
    assert_eq!(two.by_force.iter().map(|b| (b.from, b.ratio.samples)).collect::<Vec<_>>(), [(0.5, 2)]);
    let summary = bounds.summary(&[0.5, 2.0]).unwrap();
    assert_eq!((summary.samples, summary.several[&2].samples), (5, 2));
    let json = serde_json::to_value(&against).unwrap();
    assert_eq!(serde_json::from_value::<Vec<AgainstBound>>(json).unwrap(), against);
}

#[test]
fn bounds_of_before_are_read() {
    let old = r#"{ "samples": 3, "position": [{ "from": 0.2, "to": 0.4, "samples": 3, "rms": 0.001 }], "normal_force": [] }"#;
    let read: Bounds = serde_json::from_str(old).unwrap();
    assert_eq!((read.samples, read.position[0].median, read.several.len()), (3, None, 0));
}

#[test]
fn without_a_diameter_there_is_no_stimulus() {
    let mut truth = presses(1, 1).labelled().find(|(_, _, t)| t.touched()).unwrap().2.clone();
    assert!(stimulus(&truth).is_some());
    truth.contacts[0].diameter = f64::NAN;
    assert!(stimulus(&truth).is_none());
}
