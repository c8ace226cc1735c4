//! `dermis gap` on simulated devices: what was switched on is named, and what was written is accepted again.
#![expect(clippy::unwrap_used, reason = "a test whose preparation fails should fail")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use dermis_bag::{BagReader, BagWriter};
use dermis_integration_tests::{finish, json, program, recordings, root};
use dermis_learn::LabelMap;
use dermis_msgs::Message;
use dermis_msgs::msg::{Indentation, TaxelFrame};
use dermis_skin::SkinDescription;
use nalgebra::{Point3, Vector3};
use serde_json::Value;

use crate::browser::looks_right;

const LINE: &str = "launch/skins/baro-line.toml";

fn dermis(arguments: &[&str]) -> Command {
    let mut command = Command::new(program("dermis"));
    command.current_dir(root()).stdin(Stdio::null()).args(arguments);
    command
}

fn device(folder: &Path, skin: &str, name: &str, effects: &[&str]) -> PathBuf {
    let plan = folder.join("plan.toml");
    let text = r#"
        schema = "dermis-plan/1"
        name = "gap"
        seed = 3
        diameter = 0.004
        timing = { approach = [0.05, 0.1], load = [0.05, 0.1], hold = [0.3, 0.6], unload = [0.05, 0.1], gap = [0.1, 0.3] }
        [[steps]]
        kind = "idle"
        duration = 2.0
        [[steps]]
        kind = "presses"
        count = 100
        force = [0.1, 1.0]
        [[steps]]
        kind = "idle"
        duration = 2.0
        [[steps]]
        kind = "grid"
        pitch = 0.004
        forces = [0.2, 0.6]
        repeats = 2
    "#;
    std::fs::write(&plan, text).unwrap();
    recorded(skin, &plan, folder.join(name), effects)
}

/// Records a plan on a simulated device with these effects.
fn recorded(skin: &str, plan: &Path, bag: PathBuf, effects: &[&str]) -> PathBuf {
    let mut command = dermis(&["collect", skin, "--json", "--plan"]);
    command.arg(plan).arg("--out").arg(&bag);
    effects.iter().for_each(|e| {
        command.args(["--effect", e]);
    });
    finish(&mut command);
    bag
}

fn diagnosis(folder: &Path, skin: &str, bag: &Path) -> Value {
    let mut command = dermis(&["gap", "diagnose", "--json", "--resamples", "4", "--skin", skin, "--real"]);
    command.arg(bag).arg("--cache").arg(folder.join("kept")).arg("--out").arg(folder.join("out"));
    json(&finish(&mut command))
}

#[test]
fn what_was_switched_on_is_named_and_switching_it_on_reduces_the_gap() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let bag = device(folder, LINE, "creeping", &["relaxation=2"]);
    let report = diagnosis(folder, LINE, &bag);
    assert_eq!(report["verdict"], "named", "{}", report["sentence"]);
    assert_eq!(report["effects"][0]["label"], "relaxation");
    assert!(
        report["residual_reduction"]["achieved"].as_f64().unwrap() > 0.9,
        "{}",
        report["residual_reduction"]
    );
    let page = std::fs::read_to_string(folder.join("out/report.html")).unwrap();
    assert!(page.contains("relaxation") && page.contains("Reduces the residual by"));
    looks_right(&folder.join("out/report.html"));
    // On the corrected skin there is no gap left.
    let corrected = folder.join("out/skin.toml");
    let again = folder.join("again");
    std::fs::create_dir(&again).unwrap();
    let report = diagnosis(&again, &corrected.display().to_string(), &bag);
    assert_eq!(report["verdict"], "no-gap-beyond-noise", "{}", report["sentence"]);
    // And it is a skin like any other.
    device(&again, &corrected.display().to_string(), "simulated", &[]);
}

#[test]
fn a_device_as_designed_has_no_gap() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let bag = device(folder, LINE, "designed", &[]);
    let report = diagnosis(folder, LINE, &bag);
    assert_eq!(report["verdict"], "no-gap-beyond-noise", "{}", report["sentence"]);
    assert_eq!(report["effects"].as_array().unwrap().len(), 0);
}

/// The same recording beside a robot's pose and a force sensor's wrench instead of our ground truth.
fn beside_a_rig(bag: &Path, map: &LabelMap) -> PathBuf {
    let to = bag.with_file_name("rig");
    let mut writer = BagWriter::create(&to).unwrap();
    let surface = SkinDescription::load(root().join(LINE)).unwrap().surface();
    for message in BagReader::open(bag).unwrap().messages() {
        let message = message.unwrap();
        if *message.type_name == *TaxelFrame::TYPE_NAME {
            writer.write("taxels", &message.decode::<TaxelFrame>().unwrap(), message.log_time).unwrap();
        } else if *message.type_name == *Indentation::TYPE_NAME {
            let truth: Indentation = message.decode().unwrap();
            let vector = |v: &dermis_msgs::geometry_msgs::msg::Vector3| Vector3::new(v.x, v.y, v.z);
            let (place, gap, force) =
                truth.contacts.first().map_or((Point3::origin(), 0.01, Vector3::zeros()), |c| {
                    (Point3::new(c.position.x, c.position.y, c.position.z), 0.0, vector(&c.force))
                });
            let stamp = truth.header.stamp.as_nanos();
            let (pose, wrench) = map.report(&surface, (&place, gap), &force, &Vector3::zeros(), stamp);
            writer.write(&map.robot.topic, &pose, stamp).unwrap();
            writer.write(&map.force.topic, &wrench, stamp).unwrap();
        }
    }
    writer.finish().unwrap();
    to
}

/// Trains on few presses for few epochs: enough to see which simulation is nearer to the device.
fn closed(folder: &Path, real: &Path, held: &Path, map: Option<&str>) -> Value {
    let plan = folder.join("train.toml");
    let text = r#"
        schema = "dermis-plan/1"
        name = "train"
        seed = 30
        diameter = 0.004
        timing = { approach = [0.01, 0.02], load = [0.03, 0.06], hold = [0.04, 0.08], unload = [0.03, 0.06], gap = [0.03, 0.08] }
        steps = [{ kind = "idle", duration = 2.0 }, { kind = "presses", count = 400, force = [0.05, 0.6] }]
    "#;
    std::fs::write(&plan, text).unwrap();
    let config = folder.join("config.toml");
    let quick = std::fs::read_to_string(root().join("launch/train/baro-line.toml")).unwrap();
    assert!(quick.contains("epochs = 60") && quick.contains("members = 2"));
    std::fs::write(
        &config,
        quick.replace("epochs = 60", "epochs = 20").replace("members = 2", "members = 1"),
    )
    .unwrap();
    let mut command =
        dermis(&["gap", "close", "--json", "--resamples", "2", "--refine", "line", "--skin", LINE]);
    command.arg("--real").arg(real).arg("--held-out").arg(held).arg("--plan").arg(plan).arg("--config");
    command.arg(config).arg("--cache").arg(folder.join("kept")).arg("--out").arg(folder.join("closed"));
    if let Some(map) = map {
        command.args(["--map", map]);
    }
    json(&finish(&mut command))
}

/// What an estimator does before and after.
fn downstream(report: &Value, metric: &str) -> (f64, f64) {
    let all = report["downstream"].as_array().unwrap();
    let found = all.iter().find(|d| d["metric"].as_str().unwrap().contains(metric));
    let found = found.unwrap_or_else(|| panic!("no {metric} in {all:?}"));
    (found["before"].as_f64().unwrap(), found["after"].as_f64().unwrap())
}

#[test]
fn closing_a_gap_makes_the_estimator_better() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let effects = ["inclusion-gain=1.5"];
    let real = weak(folder, "real", PRESSES, &effects);
    let held = weak(folder, "held", GRID, &effects);
    let report = closed(folder, &real, &held, None);
    let (before, after) = downstream(&report, "root mean square error of the pressing force");
    assert!(after < 0.5 * before, "{before} N before, {after} N after");
    let (before, after) = downstream(&report, "median error of the position");
    assert!(after < 0.7 * before, "{before} m before, {after} m after");
    let page = std::fs::read_to_string(folder.join("closed/report.html")).unwrap();
    assert!(page.contains("[mm]: "));
    looks_right(&folder.join("closed/report.html"));
}

#[test]
fn a_recording_beside_a_rig_is_diagnosed_like_one_beside_our_ground_truth() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let map = "launch/labels/rig.toml";
    let real = weak(folder, "real", PRESSES, &["inclusion-gain=1.5"]);
    let rig = beside_a_rig(&real, &LabelMap::load(root().join(map)).unwrap());
    let mut command =
        dermis(&["gap", "diagnose", "--json", "--resamples", "2", "--skin", LINE, "--map", map, "--real"]);
    let report = json(&finish(command.arg(rig).arg("--cache").arg(folder.join("kept"))));
    // Without repeats and a change of temperature, air in the ports acts like a gain.
    let class = report["effects"][0]["class"].as_array().unwrap();
    assert!(class.iter().any(|member| member["name"] == "inclusion-gain"), "{}", report["sentence"]);
    assert!(
        report["residual_reduction"]["achieved"].as_f64().unwrap() > 0.8,
        "{}",
        report["residual_reduction"]
    );
}

/// Steps of plans.
const PRESSES: &str = r#"kind = "presses", count = 120, force = [0.05, 0.5]"#;
const GRID: &str = r#"kind = "grid", pitch = 0.0021, forces = [0.1, 0.2, 0.4], repeats = 1"#;

/// Presses that drive no channel to its end, of one device.
fn weak(folder: &Path, name: &str, steps: &str, effects: &[&str]) -> PathBuf {
    let plan = folder.join(format!("{name}.toml"));
    let text = format!(
        r#"
        schema = "dermis-plan/1"
        name = "weak"
        seed = 7
        diameter = 0.004
        timing = {{ approach = [0.03, 0.05], load = [0.05, 0.1], hold = [0.2, 0.3], unload = [0.05, 0.1], gap = [0.1, 0.2] }}
        steps = [{{ kind = "idle", duration = 2.0 }}, {{ {steps} }}]
        "#
    );
    std::fs::write(&plan, text).unwrap();
    recorded(LINE, &plan, folder.join(name), effects)
}

/// Real recordings: each claim has its class and its interval, and the cause that is known, the oil, is no other than one that
/// remembers.
#[test]
fn real_bores_full_of_water_and_oil_are_diagnosed() {
    let Some(data) = recordings("tactile_fsi/raw_timeseries") else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for fluid in ["water", "oil"] {
        let bag = folder.join(fluid);
        let mut import = dermis(&["import", "--json"]);
        let report =
            json(&finish(import.arg(data.join(format!("1D_{fluid}_dia1_5mm.npz"))).arg("-o").arg(&bag)));
        assert!(report["presses"].as_u64().unwrap() > 300, "{report}");
        let skin = format!("launch/gap/tactile-fsi-{fluid}.toml");
        let mut command =
            dermis(&["gap", "diagnose", "--json", "--resamples", "4", "--zero", "press", "--skin"]);
        command.arg(skin).arg("--real").arg(&bag).arg("--cache").arg(folder.join("kept"));
        let report = json(&finish(&mut command));
        assert_ne!(report["verdict"], "unusable-recording", "{}", report["sentence"]);
        assert!(report["gap"]["systematic"].as_f64().unwrap() > 0.0);
        let missing = report["data"]["missing"].as_array().unwrap();
        for what in ["the temperature", "a second session"] {
            assert!(missing.iter().any(|m| m["what"] == what), "{what}: {missing:?}");
        }
        for effect in report["effects"].as_array().unwrap() {
            assert!(!effect["class"].as_array().unwrap().is_empty(), "{effect}");
            assert_eq!(report["residual_reduction"]["interval"].as_array().unwrap().len(), 2);
        }
        let best = &report["suspects"][0]["name"];
        if fluid == "oil" {
            assert!(
                ["relaxation", "low-pass", "hysteresis"].iter().any(|n| best == n),
                "{}",
                report["suspects"]
            );
        }
    }
}
