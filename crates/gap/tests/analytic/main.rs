//! The engine on a small analytic skin. The devices here are made by other laws than the signatures, and by other code.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

mod device;
mod model;
mod next;
mod schema;

use dermis_gap::{Memory, Options, Recording, Report, Simulator, Tier, Verdict, diagnose};
use dermis_model::{Indentation, Stimulus};
use dermis_skin::{ModelError, SkinDescription};
use nalgebra::{Point3, Vector3};

use device::{Device, device, recorded};
use model::{EFFECTS, skin, toy};
use schema::fits;

fn options() -> Options {
    Options { resamples: 6, ..Options::default() }
}

fn diagnosed(recording: &Recording) -> Report {
    let skin = skin();
    let make = |skin: &SkinDescription| toy(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    diagnose(&simulator, recording, &options(), &Memory::default()).unwrap().report
}

fn said(device: &Device) -> Report {
    let report = diagnosed(&recorded(device, 160, 1, 11));
    println!(
        "{:?} {:?} {:?} gap {:?} unknown {:?} reduction {:?}",
        report.verdict,
        report.class(),
        report.effects.iter().map(|e| (e.label.as_str(), e.tier, e.gain)).collect::<Vec<_>>(),
        report.gap.as_ref().map(|g| (g.fvu_before, g.floor, g.systematic, g.interval)),
        (report.unknown.library, report.unknown.model_discrepancy, report.unknown.explainable),
        report.residual_reduction
    );
    report
}

#[test]
fn another_law_alone_names_no_effect_firmly() {
    for law in [0.0, 1.0, 2.0] {
        let report = said(&Device { law, ..device() });
        // A gap that matters may get a name, but never one without "or the simulator's own error".
        assert!(report.effects.iter().all(|e| e.tier == Tier::Loose), "law {law}: {}", report.sentence);
    }
}

#[test]
fn gains_are_named_and_removed() {
    let report = said(&Device { gains: [0.1, -0.08, 0.05, -0.12, 0.15, 0.0], ..device() });
    assert_eq!(report.class().first(), Some(&"gains"), "{}", report.sentence);
    assert_eq!(report.effects[0].tier, Tier::Strict);
    let reduction = report.residual_reduction.unwrap();
    assert!(reduction.achieved.unwrap() > 0.8);
    assert!((reduction.predicted - reduction.achieved.unwrap()).abs() < 0.08);
    // Written in words that a skin description knows.
    assert_eq!(report.corrected[0].name, "channel-gain");
    // The device's other law is in all of them.
    let of = |name: &str| report.corrected[0].parameters[name];
    assert!((of("a") / of("d") - 1.1 / 0.88).abs() < 0.03, "{:?}", report.corrected);
}

#[test]
fn creep_of_another_law_is_named() {
    let report = said(&Device { law: 0.3, fade: vec![(0.05, 0.15), (0.05, 0.4), (0.05, 1.0)], ..device() });
    assert_eq!(report.class(), ["creep"], "{}", report.sentence);
    let reduction = report.residual_reduction.unwrap();
    assert!(reduction.achieved.unwrap() > 0.7, "{reduction:?}");
    assert!((reduction.predicted - reduction.achieved.unwrap()).abs() < 0.08);
}

#[test]
fn taxels_that_lie_elsewhere_are_named() {
    let moved = [4e-4, -5e-4, 3e-4, -6e-4, 5e-4, 2e-4];
    let report = said(&Device { moved, ..device() });
    assert_eq!(report.class().first(), Some(&"misplacement"), "{}", report.sentence);
    let found = report.corrected[0].parameters["d.x"];
    assert!((found + 6e-4).abs() < 1.5e-4, "{found}");
}

#[test]
fn a_rig_that_is_off_is_told_from_taxels_that_are() {
    let report = said(&Device { shift: 6e-4, ..device() });
    assert_eq!(report.class().first(), Some(&"truth-shift"), "{}", report.sentence);
    // The device's other law is in it: its locations are felt a little farther than ours.
    let x = report.corrected[0].parameters["x"];
    assert!((x - 6e-4).abs() < 9e-5, "{x}");
}

#[test]
fn readings_that_come_late_are_named() {
    let report = said(&Device { late: 0.03, ..device() });
    assert!(report.class().contains(&"delay"), "{}", report.sentence);
}

#[test]
fn neighbours_that_leak_are_named() {
    let report = said(&Device { leak: 0.12, ..device() });
    assert_eq!(report.class().first(), Some(&"crosstalk"), "{}", report.sentence);
    let found = &report.corrected[0].parameters;
    assert!((found["before"] - 0.12).abs() < 0.03 && found["after"].abs() < 0.03, "{found:?}");
}

#[test]
fn a_skin_that_wears_is_named() {
    let report = said(&Device { wear: 0.25, ..device() });
    assert_eq!(report.class().first(), Some(&"ageing"), "{}", report.sentence);
    // These presses follow each other like a clock's ticks: how much is use and how much is time they do not tell.
    assert!(report.residual_reduction.unwrap().achieved.unwrap() > 0.0, "{:?}", report.residual_reduction);
}

#[test]
fn zeros_that_go_home_from_switching_on_are_named() {
    let report =
        said(&Device { cold: [3000.0, 2000.0, -1000.0, 2500.0, 1500.0, 4000.0], law: 0.0, ..device() });
    assert_eq!(report.class().first(), Some(&"warm-up"), "{}", report.sentence);
    let found = &report.corrected[0].parameters;
    let time = 30.0 / std::f64::consts::LN_2;
    assert!(
        (found["time"] / time - 1.0).abs() < 0.15 && (found["a"] / 3000.0 - 1.0).abs() < 0.15,
        "{found:?}"
    );
}

#[test]
fn interference_is_named_with_its_frequency() {
    let report = said(&Device { interference: (800.0, 7.0), law: 0.0, ..device() });
    assert_eq!(report.verdict, Verdict::Named, "{}", report.sentence);
    assert_eq!(report.class(), ["interference"], "{}", report.sentence);
    let found = &report.corrected[0].parameters;
    // The strongest line of a triangle is 8/π² of it.
    assert!((found["frequency"] - 7.0).abs() < 0.1 && (found["amplitude"] - 648.0).abs() < 50.0, "{found:?}");
}

#[test]
fn two_effects_are_both_found() {
    let report = said(&Device {
        gains: [0.15, -0.1, 0.1, -0.15, 0.1, -0.1],
        fade: vec![(0.1, 0.3), (0.06, 1.0)],
        ..device()
    });
    let found: Vec<&str> = report.effects.iter().map(|e| e.label.as_str()).collect();
    assert!(found.contains(&"gains") && found.contains(&"creep"), "{found:?} {}", report.sentence);
}

#[test]
fn a_void_is_none_of_the_known_effects_and_its_place_is_found() {
    let report = said(&Device { void: 0.5, ..device() });
    assert_eq!(report.verdict, Verdict::UnknownSystematic, "{} {:?}", report.sentence, report.unknown);
    assert!(report.effects.is_empty() && report.residual_reduction.is_none());
    let peak = report.maps[0].peak.unwrap();
    assert!((peak[0] - 0.006).hypot(peak[1]) < 0.006, "{peak:?}");
}

#[test]
fn what_differs_from_press_to_press_is_irreproducible() {
    let recording = recorded(&Device { whim: 0.1, ..device() }, 90, 2, 3);
    let report = diagnosed(&recording);
    let gap = report.gap.unwrap();
    println!("{gap:?} {}", report.sentence);
    assert!(gap.irreproducible.unwrap() > 0.5 * (gap.fvu_before - gap.systematic.max(0.0)));
    assert!(gap.systematic < 0.4 * gap.fvu_before);
    assert_eq!(report.verdict, Verdict::Unmeasured);
    assert!(report.effects.is_empty(), "{}", report.sentence);
}

fn problem<'a>(report: &'a Report, code: &str) -> &'a str {
    let found = report.data.problems.iter().find(|p| p.code == code);
    &found.unwrap_or_else(|| panic!("no {code} in {:?}", report.data.problems)).what
}

fn some() -> Recording {
    recorded(&Device { gains: [0.1, -0.08, 0.05, -0.12, 0.15, 0.0], ..device() }, 60, 1, 5)
}

#[test]
fn a_clock_that_runs_backwards_is_named() {
    let mut recording = some();
    recording.labels[500].time -= 3.0;
    let report = diagnosed(&recording);
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "clock").contains("frame 500 by 2.980 s"), "{}", report.sentence);
    assert!(report.effects.is_empty());
}

#[test]
fn readings_in_another_unit_are_named() {
    let mut recording = some();
    recording.readings.iter_mut().for_each(|v| *v *= 1e-3);
    let report = diagnosed(&recording);
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "units").contains("1e-3"), "{}", report.sentence);
}

#[test]
fn channels_in_another_order_are_put_right_and_named() {
    let mut recording = some();
    for frame in recording.readings.chunks_exact_mut(6) {
        frame.swap(0, 4);
    }
    let report = diagnosed(&recording);
    let found: Vec<&str> = report.effects.iter().map(|e| e.label.as_str()).collect();
    assert_eq!(found, ["channel-order", "gains"], "{}", report.sentence);
    assert!(problem(&report, "channel-order").contains("a carries e, e carries a"));
    let order = &report.corrected[0];
    assert_eq!((order.parameters["a"], order.parameters["e"]), (4.0, 0.0));
}

#[test]
fn ground_truth_in_a_mirrored_frame_is_named() {
    let mut recording = some();
    for label in &mut recording.labels {
        for contact in label.stimulus.iter_mut().flat_map(|s| &mut s.contacts) {
            contact.position.x = -contact.position.x;
        }
    }
    let report = diagnosed(&recording);
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "frame").contains("x is mirrored"), "{}", report.sentence);
}

#[test]
fn stretches_without_numbers_are_left_out_and_named() {
    let mut recording = some();
    for frame in 400..600 {
        recording.readings[frame * 6 + 2] = f32::NAN;
    }
    let report = diagnosed(&recording);
    assert!(problem(&report, "not-finite").contains("channel c gives no number in 200 frames"));
    assert_eq!(report.class().first(), Some(&"gains"), "{}", report.sentence);
    // A channel that never gives any is another thing.
    for frame in recording.readings.chunks_exact_mut(6) {
        frame[2] = f32::NAN;
    }
    let report = diagnosed(&recording);
    assert!(problem(&report, "dead-channel").contains("channel c never gives a number"));
    assert_eq!(report.class().first(), Some(&"gains"), "{}", report.sentence);
}

#[test]
fn ten_contacts_are_too_few() {
    let report = diagnosed(&recorded(&Device { gains: [0.3; 6], ..device() }, 10, 1, 5));
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "few-contacts").contains("10 presses only"));
}

#[test]
fn readings_of_something_else_are_named() {
    let mut recording = some();
    let half = recording.readings.len() / 12 * 6;
    recording.readings.rotate_left(half);
    let report = diagnosed(&recording);
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "unrelated").contains("next to nothing in common"), "{}", report.sentence);
}

#[test]
fn what_is_missing_says_what_it_blocks() {
    let report = diagnosed(&some());
    let missing: Vec<&str> = report.data.missing.iter().map(|m| m.what.as_str()).collect();
    insta::assert_debug_snapshot!(missing, @r#"
    [
        "repeats: presses of the same place and force, at least ten pairs",
        "a second session",
        "the temperature",
        "presses that are held for a second or more",
        "several contacts at once",
        "a second tip",
    ]
    "#);
}

#[test]
fn signatures_are_kept_on_the_disk() {
    let skin = skin();
    let make = |skin: &SkinDescription| toy(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    let dir = tempfile::tempdir().unwrap();
    let options = Options { cache: Some(dir.path().join("kept")), ..options() };
    let recording = some();
    let mut first = diagnose(&simulator, &recording, &options, &Memory::default()).unwrap().report;
    let mut again = diagnose(&simulator, &recording, &options, &Memory::default()).unwrap().report;
    assert!(first.provenance.seconds[0] > 0.0);
    assert_eq!(again.provenance.seconds[0], 0.0);
    first.provenance.seconds = [0.0; 2];
    again.provenance.seconds = [0.0; 2];
    assert_eq!(first.to_json().unwrap(), again.to_json().unwrap());
}

#[test]
fn the_corrected_skin_reads_what_the_diagnosis_says() {
    let skin = skin();
    let make = |skin: &SkinDescription| toy(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    let found = diagnose(&simulator, &some(), &options(), &Memory::default()).unwrap();
    let text = dermis_gap::skin_text(&found.corrected).unwrap();
    let read = SkinDescription::from_toml(&text, "corrected.toml").unwrap();
    assert_eq!(read.effects, found.report.corrected);
    let model = dermis_gap::device(&read, |inner: &SkinDescription| {
        toy(inner).map_err(|reason| ModelError::Description {
            skin: "toy".into(),
            field: String::new(),
            reason,
        })
    });
    let (model, nominal) = (model.unwrap(), toy(&skin).unwrap());
    let press = Indentation::sphere(Point3::new(-0.009, -0.005, 0.0), Vector3::new(0.0, 0.0, -1.0), 0.004);
    let stimulus = Stimulus { contacts: vec![press], ..Stimulus::default() };
    let (mut corrected, mut plain) = ([0.0; 6], [0.0; 6]);
    model.response(&stimulus, &mut corrected).unwrap();
    nominal.response(&stimulus, &mut plain).unwrap();
    approx::assert_relative_eq!(
        corrected[0] / plain[0],
        read.effects[0].parameters["a"],
        max_relative = 1e-9
    );
}

#[test]
fn reports_are_as_the_published_schema_says() {
    let schema: serde_json::Value = serde_json::from_str(dermis_gap::SCHEMA_JSON).unwrap();
    let unusable = diagnosed(&recorded(&device(), 5, 1, 5));
    let none = diagnosed(&recorded(&Device { law: 0.0, ..device() }, 60, 1, 5));
    assert_eq!(none.verdict, Verdict::NoGapBeyondNoise);
    for report in [diagnosed(&some()), unusable, none] {
        let value: serde_json::Value = serde_json::from_str(&report.to_json().unwrap()).unwrap();
        fits(&value, &schema, &schema, "report");
    }
}

/// Keys that `gap-report/1` called otherwise.
const OLD_KEYS: [(&str, &str); 5] = [
    ("\"consistency_checks\":", "\"parity\":"),
    ("\"residual_reduction\":", "\"closure\":"),
    ("\"model_discrepancy\":", "\"form\":"),
    ("\"beyond_discrepancy\":", "\"beyond_form\":"),
    ("\"samples\":", "\"rows\":"),
];

#[test]
fn reports_of_the_first_format_are_read() {
    let text = diagnosed(&some()).to_json().unwrap();
    let mut old = text.replace("\"gap-report/2\"", "\"gap-report/1\"");
    for (new, before) in OLD_KEYS {
        assert!(old.contains(new), "{new}");
        old = old.replace(new, before);
    }
    let read: Report = serde_json::from_str(&old).unwrap();
    assert_eq!(read.to_json().unwrap().replace("gap-report/1", "gap-report/2"), text);
    let verdict: Verdict = serde_json::from_str("\"simulator-form\"").unwrap();
    assert_eq!(verdict, Verdict::ModelDiscrepancy);
}

/// A number with four digits: another platform's exponential function changes the last ones.
fn rounded(value: f64) -> String {
    format!("{value:.3e}")
}

/// What a diagnosis comes to, in figures.
fn figures(report: &Report) -> String {
    let all = |values: &[f64]| values.iter().map(|v| rounded(*v)).collect::<Vec<_>>().join(" ");
    let mut lines = vec![format!("{:?}", report.verdict)];
    if let Some(gap) = &report.gap {
        lines.push(format!(
            "gap {}",
            all(&[gap.fvu_before, gap.floor, gap.systematic, gap.interval[0], gap.interval[1]])
        ));
    }
    for effect in &report.effects {
        let class: Vec<String> =
            effect.class.iter().map(|a| format!("{} {}", a.name, all(&[a.gain, a.p_confuse]))).collect();
        lines.push(format!("{:?} {}", effect.tier, class.join(", ")));
        let of = [effect.gain, effect.solo, effect.shapley, effect.p_max_t];
        lines.push(format!("  gain, solo, shapley, p {}", all(&of)));
        lines.extend(effect.theta.iter().map(|v| format!("  {} {}", v.name, rounded(v.value))));
    }
    if let Some(r) = &report.residual_reduction {
        let of = [r.predicted, r.achieved.unwrap_or(f64::NAN), r.interval[0], r.interval[1]];
        lines.push(format!("reduction {}", all(&of)));
    }
    let unknown = &report.unknown;
    let of = [unknown.share, unknown.library, unknown.model_discrepancy, unknown.explainable];
    lines.push(format!("unknown {}", all(&of)));
    let axes = report.axes.iter().take(3).filter(|a| a.share > 0.01);
    lines.extend(axes.map(|a| format!("{} {}", a.axis, rounded(a.share))));
    lines.join("\n")
}

#[test]
fn figures_stay_what_they_are() {
    let two = Device {
        gains: [0.15, -0.1, 0.1, -0.15, 0.1, -0.1],
        fade: vec![(0.1, 0.3), (0.06, 1.0)],
        ..device()
    };
    let cases = [
        ("nothing", Device { law: 0.0, ..device() }),
        ("gains and creep", two),
        ("a shifted rig", Device { shift: 6e-4, ..device() }),
        ("a void", Device { void: 0.5, ..device() }),
    ];
    let text: Vec<String> = cases
        .iter()
        .map(|(name, device)| format!("# {name}\n{}", figures(&diagnosed(&recorded(device, 160, 1, 11)))))
        .collect();
    insta::assert_snapshot!(text.join("\n\n"));
}
