//! The programs under `examples/`, as their pages say to run them.
#![expect(clippy::unwrap_used, reason = "a test whose preparation fails should fail")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use dermis_integration_tests::{Peer, client_python, finish, isolate, json, program, root};
use dermis_transport::framing::{DecodedFrame, FrameDecoder, NativeDecoder};

const SOON: Duration = Duration::from_secs(60);
const SKIN: &str = "launch/skins/baro-grid.toml";

fn dermis() -> Command {
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()));
    command
}

fn example(path: &str) -> PathBuf {
    root().join("examples").join(path)
}

fn demo() -> Peer {
    Peer::start(dermis().args(["demo", "--duration", "120s", "--json"]))
}

#[test]
fn a_device_in_python_is_detected_in_the_middle() {
    let Some(python) = client_python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("pad");
    let mut device =
        Peer::start(Command::new(python).arg(example("own-device/device.py")).arg(&link).arg("120"));
    device.expect("sending to", SOON);
    let source = format!("serial://{}", link.display());
    let _node = Peer::start(dermis().args([
        "barodome",
        "--skin",
        SKIN,
        "--model",
        "models/baro-grid",
        "--source",
        &source,
    ]));
    let mut watch = Peer::start(dermis().args(["watch", "--json", "--within", "60s"]));
    let begun = Instant::now();
    loop {
        let seen = json(&watch.expect("{", SOON));
        let latest = &seen["skins"][0]["latest"];
        if let Some(contact) = latest["contacts"].as_array().and_then(|all| all.first()) {
            let [x, y] = ["x", "y"].map(|axis| contact["position"][axis].as_f64().unwrap());
            assert!(x.abs() < 2e-3 && y.abs() < 2e-3, "{latest}");
            break;
        }
        assert!(begun.elapsed() < SOON, "{seen}");
    }
}

#[test]
fn a_device_in_c_sends_frames_that_are_whole() {
    let folder = tempfile::tempdir().unwrap();
    let [device, line] = ["device", "line"].map(|name| folder.path().join(name));
    let firmware = root().join("crates/transport/firmware");
    finish(
        Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()))
            .args(["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-O2", "-I"])
            .arg(&firmware)
            .arg("-o")
            .arg(&device)
            .arg(example("own-device/device.c"))
            .arg(firmware.join("dermis_wire.c")),
    );
    finish(Command::new(&device).arg(&line).arg("250"));
    let mut frames: Vec<DecodedFrame> = Vec::new();
    NativeDecoder::new(Some(25)).push(&std::fs::read(&line).unwrap(), 0, &mut frames);
    assert_eq!(frames.len(), 250);
    for (i, frame) in frames.iter().enumerate() {
        assert_eq!(frame.sequence, i as u64);
        let pressed = i / 100 % 2 == 1;
        assert_eq!(frame.values[12] > 1000.0, pressed, "{i}: {:?}", frame.values);
    }
}

#[test]
fn a_model_of_ones_own_becomes_a_bundle() {
    let Some(python) = client_python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let [onnx, bundle] = ["centre.onnx", "centre"].map(|name| folder.path().join(name));
    let script = example("own-model/make_model.py");
    finish(Command::new(python).arg(script).arg(root().join(SKIN)).arg(&onnx));
    let mut new = dermis();
    new.args(["bundle", "new", "--skin", SKIN, "--outputs", "position.x,position.y,force.normal", "--json"]);
    let made = json(&finish(new.arg("--onnx").arg(&onnx).arg("--out").arg(&bundle)));
    assert!(made["runtimes"].as_array().is_some_and(|all| !all.is_empty()), "{made}");
    assert!(bundle.join("bundle.toml").is_file());
}

fn plan(folder: &Path) -> PathBuf {
    let path = folder.join("plan.toml");
    let text = r#"
        schema = "dermis-plan/1"
        name = "quick"
        seed = 7
        diameter = 0.004
        margin = 0.003
        timing = { approach = [0.03, 0.05], load = [0.04, 0.06], hold = [0.05, 0.08], unload = [0.03, 0.05], gap = [0.03, 0.05] }
        steps = [
            { kind = "idle", duration = 2.0 },
            { kind = "presses", count = 300, force = [0.3, 1.2] },
        ]
    "#;
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn what_was_trained_in_python_knows_where_it_is_pressed() {
    let Some(python) = client_python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let [bag, tables, onnx, bundle] =
        ["presses", "tables", "model.onnx", "model"].map(|name| folder.path().join(name));
    finish(dermis().args(["collect", SKIN, "--plan"]).arg(plan(folder.path())).arg("--out").arg(&bag));
    let mut export = dermis();
    export.args(["bag", "export", "--skin", SKIN, "--format", "npz", "--tared", "--out"]);
    finish(export.arg(&tables).arg(&bag));
    let script = example("training-python/train.py");
    finish(Command::new(python).arg(script).arg(tables.join("presses.npz")).arg(&onnx));
    let mut new = dermis();
    new.args(["bundle", "new", "--skin", SKIN, "--outputs", "position.x,position.y,force.normal", "--json"]);
    new.args(["--split", "location", "--from-bag"]).arg(&bag);
    let made = json(&finish(new.arg("--onnx").arg(&onnx).arg("--out").arg(&bundle)));
    let error = |name: &str| made["measured"]["quantities"][name]["rms"].as_f64().unwrap();
    // The pad is 34 mm wide, and forces are 0.3 to 1.2 N.
    assert!(error("position.x") < 4e-3 && error("position.y") < 4e-3, "{made}");
    assert!(error("force.normal") < 0.15, "{made}");
}

#[test]
fn the_zenoh_client_prints_status_and_contacts() {
    let Some(python) = client_python() else { return };
    let _demo = demo();
    let script = example("zenoh-client/client.py");
    let mut client =
        Peer::start(Command::new(python).arg(script).args(["--seconds", "100"]).current_dir(root()));
    // Domains other than 0 are part of the robot's name.
    let line = client.expect("status demo", SOON);
    assert!(line.contains(" baro-grid "), "{line}");
    let line = client.expect("contact baro-grid ", SOON);
    assert_eq!(line.split(' ').count(), 7, "{line}");
}

#[test]
fn the_planner_in_rust_stops_and_goes_on() {
    let planner = program("examples/planner");
    assert!(
        planner.is_file(),
        "{} is missing: `cargo build --release -p dermis-node --example planner`",
        planner.display()
    );
    let _demo = demo();
    let mut planner = Peer::start(Command::new(planner).arg("0.05"));
    planner.expect("GO ", SOON);
    let line = planner.expect("STOP baro-grid ", SOON);
    assert!(line.contains(" N at ") && line.ends_with("in baro_grid_link"), "{line}");
    planner.expect("GO ", SOON);
}
