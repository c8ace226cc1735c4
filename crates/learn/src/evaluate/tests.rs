use dermis_skin::{Contact, Estimate, EstimateError, ForceComponents, Frame};
use nalgebra::{Point3, Vector3};

use super::*;
use crate::dataset::tests::presses;
use crate::metrics::MapPart;
use crate::target::Maps;

/// Reads position and force off the two channels of the made-up skin, whose zero is 1000; 0.5 mm off in x.
struct Known;

impl Estimator for Known {
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
        let [x, force] = [frame.values[0] - 1000.0, frame.values[1] - 1000.0].map(f64::from);
        let mut estimate = Estimate::default();
        if force > 1.0 {
            let mut contact = Contact::at(Point3::new(x * 1e-4 + 0.0005, 0.0, 0.0), Vector3::z());
            contact.force = Vector3::new(0.0, 0.0, -force / 20.0 * 1.1);
            contact.force_components = ForceComponents::Normal;
            estimate.contacts.push(contact);
        }
        Ok(estimate)
    }

    fn reset(&mut self) {}
}

#[test]
fn people_read_a_table() {
    let data = presses(10, 2);
    let result = evaluate(&mut Known, &data, None, "made-up presses").unwrap();
    insta::assert_snapshot!(result, @r"
    made-up presses: 180 frames, zero taken 20 times
                                        RMS       95 % interval     mean   median      p95   frames
      force.normal               N    0.332      0.243 .. 0.409    0.300    0.300    0.500       40
      force.normal untouched     N    0.000      0.000 .. 0.000    0.000    0.000    0.000      140
      position                  mm    0.500      0.500 .. 0.500    0.500    0.500    0.500       40
      position.x                mm    0.500      0.500 .. 0.500    0.500    0.500    0.500       40
      position.y                mm    0.000      0.000 .. 0.000    0.000    0.000    0.000       40
      intervals: whole locations resampled (10)
      force.normal RMS [N] by force [N]:  1-2: 0.100  2-5: 0.311  5-10: 0.500
      position RMS [mm] by force [N]:  1-2: 0.500  2-5: 0.500  5-10: 0.500
      missed contacts 0.00 %, false contacts 0.00 %
    ");
    let figures = result.figures();
    approx::assert_relative_eq!(figures["position_rms"], 0.0005, max_relative = 1e-3);
    let again: Evaluation = serde_json::from_value(result.to_json()).unwrap();
    assert_eq!(again.frames, result.frames);
    let verdict = |text: &str| text.parse::<Requirement>().unwrap().check(&result);
    assert!(verdict("position_rms <= 0.00051").met && verdict("missed<=0").met);
    insta::assert_snapshot!(verdict("position_rms<=0.0004"), @"MISSED: position_rms<=0.0004 (measured 0.000500)");
    insta::assert_snapshot!(verdict("force_x_rms<=1"), @"MISSED: force_x_rms<=1 (no such figure here)");
}

/// As [`Known`], with a map: the force at the point nearest to x = y = 0, and nothing where it has no zero.
struct Mapping;

impl Estimator for Mapping {
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
        let mut estimate = Known.estimate(frame)?;
        let mut values = vec![0.0; 25];
        values[12] = (frame.values[1] - 1000.0) / 20.0;
        let forces = dermis_skin::ForceValues::Normal(values);
        // Every tenth frame has no map.
        if !frame.sequence.is_multiple_of(10) {
            estimate.force_map = Some(dermis_skin::ForceMap { indices: None, forces });
        }
        Ok(estimate)
    }

    fn reset(&mut self) {}
}

#[test]
fn maps_are_scored_where_they_are_given() {
    let data = presses(10, 2);
    let maps = Maps::new(data.skin(), None, &[]).unwrap();
    let result =
        evaluate_by(Evaluator::new().with_maps(maps), &mut Mapping, &data, None, "made-up maps").unwrap();
    let errors = &result.maps["map.normal"];
    // Of 240 frames every tenth has no map; 40 are touched, two after ten untouched ones each.
    assert_eq!(errors.touched.frames + errors.touched.unanswered, 40);
    assert_eq!(errors.untouched.frames + errors.untouched.unanswered, 140, "those whose zero is known");
    assert!(errors.touched.unanswered > 0 && errors.untouched.unanswered > 0);
    // Locations up to 2.5 mm are nearest to the middle, farther ones to its neighbour 5 mm beside it.
    assert!(errors.touched.relative.is_some_and(|r| r > 0.5 && r < 2.0_f64.sqrt()), "{errors:?}");
    assert!(errors.touched.total_force.is_some_and(|f| f < 1e-5), "the sums are right: {errors:?}");
    assert_eq!((errors.untouched.rms, errors.untouched.relative), (Some(0.0), None));
    let figures = result.figures();
    assert_eq!(figures["map_normal_rms"], errors.touched.rms.unwrap());
    let unanswered = (errors.touched.unanswered + errors.untouched.unanswered) as f64 / 180.0;
    approx::assert_relative_eq!(figures["map_normal_unanswered"], unanswered, max_relative = 1e-12);
    let again: Evaluation = serde_json::from_value(result.to_json()).unwrap();
    let read = again.figures();
    assert!(read.keys().eq(figures.keys()), "{read:?}");
    // JSON keeps all digits but the last.
    assert!(figures.iter().all(|(name, v)| (read[name] - v).abs() <= 1e-12 * v.abs()), "{read:?}");
    assert_eq!(again.maps["map.normal"].by_number.keys().copied().collect::<Vec<_>>(), [1]);
    let without_maps = evaluate(&mut Mapping, &data, None, "x").unwrap();
    assert!(without_maps.maps.is_empty());
}

#[test]
fn people_read_errors_of_maps() {
    let part = |frames, unanswered| MapPart {
        frames,
        unanswered,
        rms: (frames > 0).then_some(0.0123),
        relative: (frames > 2).then_some(0.341),
        total_force: (frames > 0).then_some(0.21),
    };
    let of = |unit: &str, touched, untouched| MapErrors {
        unit: unit.into(),
        touched,
        untouched,
        by_number: BTreeMap::new(),
        contacts: Vec::new(),
        strongest: None,
        channels: None,
        examples: Vec::new(),
    };
    let mut depths = of("m", part(40, 0), part(0, 0));
    depths.touched = MapPart { rms: Some(12.5e-6), total_force: None, ..depths.touched };
    let mut evaluation = Evaluation::of(&Scores::default(), "made up", 42, 0, 0);
    evaluation.maps.insert("map.displacement".into(), depths);
    evaluation.maps.insert("map.normal".into(), of("N", part(40, 3), part(2, 0)));
    insta::assert_snapshot!(evaluation, @r"
    made up: 42 frames
                                        RMS       95 % interval     mean   median      p95   frames
      maps, over all points                    RMS  of the truth total force [N]   frames  unanswered
      map.displacement touched      µm      12.500        34.1 %               -       40           0
      map.normal touched            mN      12.300        34.1 %           0.210       40           3
      map.normal untouched          mN      12.300             -           0.210        2           0
    ");
}

/// As [`Known`], but it finds nothing beyond 5 mm.
struct Shy;

impl Estimator for Shy {
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
        let mut estimate = Known.estimate(frame)?;
        estimate.contacts.retain(|c| c.position.x < 0.0055 + 1e-9);
        Ok(estimate)
    }

    fn reset(&mut self) {}
}

#[test]
fn what_is_not_found_counts() {
    let data = presses(10, 2);
    let result = evaluate(&mut Shy, &data, None, "shy").unwrap();
    // Locations are 0 to 9 mm: 6 to 9 mm are not found. The middle of the surface is the origin.
    assert_eq!((result.missed, result.not_found), (Some(0.4), Some(0.4)));
    let [all, found] = ["position", "position found"].map(|name| &result.quantities[name]);
    assert_eq!((all.samples, found.samples), (40, 24));
    approx::assert_relative_eq!(found.rms, 0.0005, max_relative = 1e-3);
    let squares: f64 = [6.0_f64, 7.0, 8.0, 9.0].iter().map(|mm| mm * mm).sum::<f64>() + 6.0 * 0.25;
    approx::assert_relative_eq!(all.rms, (squares / 10.0).sqrt() * 1e-3, max_relative = 1e-3);
    let figures = result.figures();
    assert_eq!((figures["position_found_rms"], figures["not_found"]), (found.rms, 0.4));
    assert!(result.to_string().contains("contacts that were not found, 40.00 %, count as far away as"));
    // Where everything is found, both figures are the same.
    let figures = evaluate(&mut Known, &data, None, "known").unwrap().figures();
    assert_eq!(figures["position_found_rms"], figures["position_rms"]);
    assert_eq!(figures["not_found"], 0.0);
}

/// Gives the force along x only, as a model of a recording whose load cell has one axis does.
struct Shear;

impl Estimator for Shear {
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
        let mut estimate = Known.estimate(frame)?;
        for contact in &mut estimate.contacts {
            contact.position = Point3::new(f64::NAN, f64::NAN, f64::NAN);
            contact.force = Vector3::new(0.25, f64::NAN, f64::NAN);
            contact.force_components = ForceComponents::Full;
        }
        Ok(estimate)
    }

    fn reset(&mut self) {}
}

#[test]
fn one_component_of_a_force_is_a_figure() {
    let result = evaluate(&mut Shear, &presses(10, 2), None, "shear").unwrap();
    // The presses have no shear.
    assert_eq!(result.quantities.keys().collect::<Vec<_>>(), ["force.x"]);
    assert_eq!((result.quantities["force.x"].samples, result.figures()["force_x_rms"]), (40, 0.25));
}

/// Says that something touches, and nothing of it.
struct Blunt;

impl Estimator for Blunt {
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
        let mut estimate = Shear.estimate(frame)?;
        for contact in &mut estimate.contacts {
            contact.force_components = ForceComponents::None;
        }
        Ok(estimate)
    }

    fn reset(&mut self) {}
}

#[test]
fn an_empty_table_has_a_sentence() {
    let result = evaluate(&mut Blunt, &presses(10, 2), None, "blunt").unwrap();
    assert!(result.quantities.is_empty());
    let text = result.to_string();
    assert!(text.contains("nothing could be compared: no quantity that the model gives is known"), "{text}");
}

#[test]
fn a_part_of_the_answers_is_summed_up_alone() {
    let data = presses(10, 2);
    let mut evaluator = Evaluator::of(&data);
    evaluator.run(&mut Shy, &data, None).unwrap();
    let touched: Vec<SampleId> =
        data.labelled().filter(|(_, _, t)| t.touched()).map(|(id, ..)| id).take(4).collect();
    let part = evaluator.restricted(&touched).finish("part");
    assert_eq!((part.frames, part.not_found), (4, Some(0.0)));
    assert_eq!(evaluator.finish("all").not_found, Some(0.4));
}

#[test]
fn only_the_requested_samples_count() {
    let data = presses(10, 2);
    let held_out = crate::SplitConfig::default().apply(&data).unwrap().test;
    let result = evaluate(&mut Known, &data, Some(&held_out), "held out").unwrap();
    let read = data.gather(&held_out).unwrap();
    let has_zero = read.iter().filter(|(_, sample)| sample.tared[0].is_finite()).count();
    assert_eq!((result.frames, result.unanswered), (has_zero, 0));
    assert!(result.frames < data.labelled().count());
}

#[test]
fn parts_are_evaluated_by_themselves_and_without_what_nobody_asks_for() {
    let data = presses(10, 2);
    let held_out = crate::SplitConfig::default().apply(&data).unwrap().test;
    let (one, two) = held_out.split_at(held_out.len() / 2);
    let halves = [("one", one), ("two", two)];
    let by_bins = || Evaluator::of(&data).by_force(&FORCE_BINS);
    let parts = || halves.map(|(name, ids)| (by_bins(), name, ids)).into();
    let both = evaluate_parts(&mut Known, &data, parts(), &|_| true).unwrap().unwrap();
    for ((name, ids), found) in halves.iter().zip(&both) {
        // As text: a contact's error is NaN in what nobody measured, and NaN is not equal to itself.
        let alone = evaluate(&mut Known, &data, Some(ids), *name).unwrap();
        assert_eq!(format!("{found:#?}"), format!("{alone:#?}"));
    }
    // It counts its calls.
    struct Counted(usize);
    impl Estimator for Counted {
        fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
            self.0 += 1;
            Known.estimate(frame)
        }
        fn reset(&mut self) {}
    }
    let mut counted = Counted(0);
    evaluate_parts(&mut counted, &data, parts(), &|_| true).unwrap();
    let all: usize = data.runs().iter().map(|r| r.samples.len()).sum();
    assert!(counted.0 < all && counted.0 >= held_out.len(), "{} of {all}", counted.0);
    assert_eq!(evaluate_parts(&mut Known, &data, parts(), &|share| share < 0.5).unwrap(), None);
}
