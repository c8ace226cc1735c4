use dermis_learn::{MapErrors, MapPart, Scores};

use super::*;

fn evaluation(position: Option<f64>, map: Option<f64>) -> Evaluation {
    let mut evaluation = Evaluation::of(&Scores::default(), "held out", 10, 0, 0);
    let bin = |from, rms| Bin { from, to: None, samples: 5, rms, mean: rms, median: None };
    if let Some(rms) = position {
        evaluation.by_force.insert("position".into(), vec![bin(0.02, 100.0 * rms), bin(0.4, rms)]);
    }
    if let Some(rms) = map {
        let touched = MapPart { frames: 5, rms: Some(rms), ..MapPart::default() };
        let errors = MapErrors { unit: "N".into(), touched, ..MapErrors::default() };
        evaluation.maps.insert("map.normal".into(), errors);
    }
    evaluation
}

#[test]
fn what_gives_maps_alone_is_judged_by_its_maps() {
    let of = |with, without| ratio(&with, &without);
    let half = of(evaluation(None, Some(0.01)), evaluation(None, Some(0.02)));
    approx::assert_relative_eq!(half.unwrap(), 0.5, max_relative = 1e-12);
    // Locations come first, and light contacts do not count.
    let twice = of(evaluation(Some(0.002), Some(0.01)), evaluation(Some(0.001), Some(0.02)));
    approx::assert_relative_eq!(twice.unwrap(), 2.0, max_relative = 1e-12);
    assert_eq!(of(evaluation(Some(0.002), None), evaluation(None, Some(0.02))), None);
    assert_eq!(of(evaluation(None, None), evaluation(None, None)), None);
}

#[test]
fn what_is_done_is_gone_on_with_by_the_same_command_alone() {
    let folder = tempfile::tempdir().unwrap();
    let bundle = folder.path();
    let mut done = Done::of(bundle, json!({ "data": "one" }));
    let settings = Settings::new(0.004, 2.0);
    done.refinement = Some(Refinement { settings: settings.clone(), correction: None });
    done.keep().unwrap();
    let again = Done::of(bundle, json!({ "data": "one" }));
    assert_eq!(again.refinement.map(|r| r.settings), Some(settings));
    assert!(again.without.is_none() && again.path == bundle.join(DONE));
    assert!(Done::of(bundle, json!({ "data": "another" })).refinement.is_none());
    // What was cut off half way says nothing.
    std::fs::write(bundle.join(DONE), "{").unwrap();
    let fresh = Done::of(bundle, json!({ "data": "one" }));
    assert!(fresh.refinement.is_none());
    let message = interrupted(&fresh).to_string();
    assert!(message.starts_with("interrupted") && message.ends_with("goes on from there"), "{message}");
    fresh.keep().unwrap();
    fresh.forget().unwrap();
    assert!(!bundle.join(DONE).exists());
}
