//! `dermis gap` on simulated devices: what was switched on is named, and what was written is accepted again.
#![expect(clippy::unwrap_used, reason = "a test whose preparation fails should fail")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use dermis_integration_tests::{finish, json, program, root};
use serde_json::Value;

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
    let bag = folder.join(name);
    let mut command = dermis(&["collect", skin, "--json", "--plan"]);
    command.arg(&plan).arg("--out").arg(&bag);
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
fn what_was_switched_on_is_named_and_switching_it_on_closes_the_gap() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let bag = device(folder, LINE, "creeping", &["relaxation=2"]);
    let report = diagnosis(folder, LINE, &bag);
    assert_eq!(report["verdict"], "named", "{}", report["sentence"]);
    assert_eq!(report["effects"][0]["label"], "relaxation");
    assert!(report["closure"]["achieved"].as_f64().unwrap() > 0.9, "{}", report["closure"]);
    let page = std::fs::read_to_string(folder.join("out/report.html")).unwrap();
    assert!(page.contains("relaxation") && page.contains("Closes"));
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
