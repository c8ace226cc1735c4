//! Recordings in which something is wrong, through the program: each fault is recognised and named, and no cause is made of it.
#![expect(clippy::unwrap_used, reason = "a test whose preparation fails should fail")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use dermis_bag::{BagQos, BagReader, BagWriter};
use dermis_integration_tests::{finish, json, program, root};
use dermis_msgs::msg::{Indentation, TaxelFrame};
use dermis_msgs::{Message, TypeSupport};
use serde_json::Value;

fn dermis(arguments: &[&str]) -> Command {
    let mut command = Command::new(program("dermis"));
    command.current_dir(root()).stdin(Stdio::null()).args(arguments);
    command
}

/// Sixty presses of a device as it was designed.
fn recording(folder: &Path, skin: &str, forces: [f64; 2], tip: f64) -> PathBuf {
    let plan = folder.join("plan.toml");
    let [low, high] = forces;
    let text = format!(
        r#"
        schema = "dermis-plan/1"
        name = "faults"
        seed = 3
        diameter = {tip}
        timing = {{ approach = [0.02, 0.04], load = [0.03, 0.06], hold = [0.1, 0.2], unload = [0.03, 0.06], gap = [0.05, 0.1] }}
        [[steps]]
        kind = "idle"
        duration = 1.0
        [[steps]]
        kind = "presses"
        count = 60
        force = [{low:?}, {high:?}]
        "#
    );
    std::fs::write(&plan, text).unwrap();
    let bag = folder.join("whole");
    let mut command = dermis(&["collect", skin, "--json", "--plan"]);
    finish(command.arg(&plan).arg("--out").arg(&bag));
    bag
}

/// The same recording with another word in every message; a message for which `false` comes back is left out.
fn altered(
    from: &Path,
    name: &str,
    mut frame: impl FnMut(usize, &mut TaxelFrame) -> bool,
    mut truth: impl FnMut(&mut Indentation) -> bool,
) -> PathBuf {
    let to = from.with_file_name(name);
    let bag = BagReader::open(from).unwrap();
    let mut writer = BagWriter::create(&to).unwrap();
    writer.add_topic("taxels", TypeSupport::of::<TaxelFrame>(), BagQos::sensor_data()).unwrap();
    writer.add_topic("ground_truth", TypeSupport::of::<Indentation>(), BagQos::sensor_data()).unwrap();
    let mut index = 0;
    for message in bag.messages() {
        let message = message.unwrap();
        if *message.type_name == *TaxelFrame::TYPE_NAME {
            let mut frame_message: TaxelFrame = message.decode().unwrap();
            if frame(index, &mut frame_message) {
                writer.write("taxels", &frame_message, message.log_time).unwrap();
            }
            index += 1;
        } else if *message.type_name == *Indentation::TYPE_NAME {
            let mut label: Indentation = message.decode().unwrap();
            if truth(&mut label) {
                writer.write("ground_truth", &label, message.log_time).unwrap();
            }
        }
    }
    writer.finish().unwrap();
    to
}

fn diagnosis(skin: &str, bag: &Path) -> Value {
    let mut command = dermis(&["gap", "diagnose", "--json", "--resamples", "2", "--skin", skin, "--real"]);
    json(&finish(command.arg(bag).arg("--cache").arg(bag.with_file_name("kept"))))
}

/// The report names the problem; where it is fatal nothing else is claimed.
fn named(skin: &str, bag: &Path, code: &str, fatal: bool) -> Value {
    let report = diagnosis(skin, bag);
    let problems = report["data"]["problems"].as_array().unwrap();
    let found = problems.iter().find(|p| p["code"] == code);
    let found = found.unwrap_or_else(|| panic!("{code} is not among {problems:?}: {}", report["sentence"]));
    assert_eq!(found["fatal"], fatal, "{found}");
    if fatal {
        assert_eq!(report["verdict"], "unusable-recording", "{}", report["sentence"]);
        assert!(report["effects"].as_array().unwrap().is_empty() && report["residual_reduction"].is_null());
        let sentence = report["sentence"].as_str().unwrap();
        assert!(sentence.starts_with("This recording cannot be diagnosed: "), "{sentence}");
    }
    report
}

/// A recording as it should be, after those made of it that nothing can be said of are named.
fn fatal_faults(folder: &Path, skin: &str, forces: [f64; 2], tip: f64) -> PathBuf {
    let whole = recording(folder, skin, forces, tip);
    let frames = |_: usize, _: &mut TaxelFrame| true;
    let truths = |_: &mut Indentation| true;

    let clock = altered(
        &whole,
        "clock",
        |i, f| {
            if i % 1000 > 900 {
                f.header.stamp.sec -= 3;
            }
            true
        },
        truths,
    );
    named(skin, &clock, "clock", true);

    let ten = altered(&whole, "ten", frames, |t| t.press <= 10);
    named(skin, &ten, "few-contacts", true);

    let millimetres = altered(&whole, "millimetres", frames, |t| {
        for c in &mut t.contacts {
            (c.position.x, c.position.y, c.position.z) =
                (c.position.x * 1e3, c.position.y * 1e3, c.position.z * 1e3);
        }
        true
    });
    named(skin, &millimetres, "frame", true);

    let turned = altered(&whole, "turned", frames, |t| {
        for c in &mut t.contacts {
            (c.position.x, c.force.x, c.normal.x) = (-c.position.x, -c.force.x, -c.normal.x);
        }
        true
    });
    named(skin, &turned, "frame", true);

    let units = altered(
        &whole,
        "units",
        |_, f| {
            f.values.iter_mut().for_each(|v| *v *= 1e-3);
            true
        },
        truths,
    );
    named(skin, &units, "units", true);

    whole
}

/// Readings of one channel that are missing for a while.
fn sparse(i: usize, f: &mut TaxelFrame) {
    if (1500..1900).contains(&i) {
        f.values[2] = f32::NAN;
    }
}

fn exchanged(f: &mut TaxelFrame) {
    f.values.swap(0, 4);
    f.values.swap(1, 3);
}

fn only_the_order(report: &Value) {
    let effects = report["effects"].as_array().unwrap();
    assert_eq!(
        (effects.len(), &effects[0]["label"]),
        (1, &Value::from("channel-order")),
        "{}",
        report["sentence"]
    );
}

#[test]
fn faults_of_a_recording_of_barometers_are_named() {
    let skin = "launch/skins/baro-line.toml";
    let folder = tempfile::tempdir().unwrap();
    let whole = fatal_faults(folder.path(), skin, [0.1, 0.8], 0.004);
    let missing = altered(
        &whole,
        "sparse",
        |i, f| {
            sparse(i, f);
            true
        },
        |_| true,
    );
    let report = named(skin, &missing, "not-finite", false);
    assert_eq!(report["verdict"], "no-gap-beyond-noise", "{}", report["sentence"]);
    let order = altered(
        &whole,
        "order",
        |_, f| {
            exchanged(f);
            true
        },
        |_| true,
    );
    only_the_order(&named(skin, &order, "channel-order", false));
}

/// A whole diagnosis of a limb computes shells for a minute: both faults that allow one are in one recording.
#[test]
fn faults_of_a_recording_of_a_limb_are_named() {
    let skin = "launch/skins/hapdef-shin.toml";
    let folder = tempfile::tempdir().unwrap();
    let whole = fatal_faults(folder.path(), skin, [2.0, 8.0], 0.010);
    let both = altered(
        &whole,
        "both",
        |i, f| {
            sparse(i, f);
            exchanged(f);
            true
        },
        |_| true,
    );
    let report = named(skin, &both, "channel-order", false);
    let problems = report["data"]["problems"].as_array().unwrap();
    assert!(problems.iter().any(|p| p["code"] == "not-finite" && p["fatal"] == false), "{problems:?}");
    only_the_order(&report);
}
