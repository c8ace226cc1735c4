//! From a recording to a model: recorded on the bus with ground truth of both kinds, trained here, and trained elsewhere.
#![expect(clippy::unwrap_used, reason = "a test whose preparation fails should fail")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use dermis_integration_tests::{Peer, client_python, finish, isolate, json, program, refused, root};
use dermis_learn::{Dataset, DatasetOptions, LabelMap};
use dermis_skin::SkinDescription;

use crate::browser::looks_right;

const SOON: Duration = Duration::from_secs(60);
const SKIN: &str = "launch/skins/baro-grid.toml";
const MAP: &str = "launch/labels/rig.toml";

fn dermis() -> Command {
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()));
    command
}

fn plan(folder: &Path, presses: u32, force: [f64; 2]) -> PathBuf {
    let path = folder.join("plan.toml");
    let text = format!(
        r#"
        schema = "dermis-plan/1"
        name = "quick"
        seed = 7
        diameter = 0.004
        margin = 0.003
        timing = {{ approach = [0.03, 0.05], load = [0.04, 0.06], hold = [0.05, 0.08], unload = [0.03, 0.05], gap = [0.03, 0.05] }}
        steps = [
            {{ kind = "idle", duration = 2.0 }},
            {{ kind = "presses", count = {presses}, force = [{}, {}] }},
        ]
        "#,
        force[0], force[1]
    );
    std::fs::write(&path, text).unwrap();
    path
}

fn serial(link: &Path) -> String {
    format!("serial://{}", link.display())
}

#[test]
fn a_recording_beside_a_rig_trains_as_well_as_one_beside_our_ground_truth() {
    let dir = tempfile::tempdir().unwrap();
    let [bag, link, ours, theirs] = ["bag", "device", "ours", "theirs"].map(|n| dir.path().join(n));
    let plan = plan(dir.path(), 500, [0.1, 1.2]);
    let mut device = Peer::start(
        dermis()
            .args(["device", "simulate", SKIN, "--ground-truth", "ground_truth", "--rig", MAP, "--plan"])
            .arg(plan)
            .arg("--link")
            .arg(&link),
    );
    device.expect("", SOON);
    let node = Peer::start(dermis().args(["barodome", "--skin", SKIN, "--source"]).arg(serial(&link)));
    // Long enough for a hundred locations.
    finish(
        dermis()
            .args(["record", "taxels", "ground_truth", "/tool_pose", "/wrench", "--duration", "24s", "--out"])
            .arg(&bag),
    );
    drop((node, device));

    // The rig tells the same as the ground truth, but for the noise of its force sensor.
    let skin = SkinDescription::load(root().join(SKIN)).unwrap();
    let read = |map: Option<LabelMap>| {
        Dataset::from_bags(&[&bag], &skin, &DatasetOptions { map, ..DatasetOptions::default() }).unwrap()
    };
    let (known, measured) = (read(None), read(Some(LabelMap::load(root().join(MAP)).unwrap())));
    let (mut count, mut squares, mut worst) = (0.0, 0.0, 0.0_f64);
    for (ours, rig) in known.runs()[0].samples.iter().zip(&measured.runs()[0].samples) {
        assert_eq!(ours.stamp, rig.stamp);
        let (Some(a), Some(b)) = (&ours.truth, &rig.truth) else { continue };
        let (Some(a), Some(b)) = (a.single(), b.single()) else { continue };
        let force = a.normal_force().unwrap();
        if force > 0.2 {
            count += 1.0;
            squares += (b.normal_force().unwrap() - force).powi(2);
            worst = worst.max((a.position - b.position).norm());
        }
    }
    assert!(count > 300.0, "{count} frames have both");
    println!("{count} frames: {} N and {worst} m apart", f64::sqrt(squares / count));
    // 4 mN of noise, and as much again for what changes between two readings of 250 Hz.
    assert!(f64::sqrt(squares / count) < 0.012, "{} N apart", f64::sqrt(squares / count));
    assert!(worst < 2e-5, "{worst} m apart");

    let mut figures = Vec::new();
    for (out, map) in [(&ours, false), (&theirs, true)] {
        let with_map = |command: &mut Command| {
            if map {
                command.args(["--map", MAP]);
            }
        };
        let mut train = dermis();
        train.args(["train", "--config", "launch/train/baro-grid.toml", "--members", "1", "--epochs", "40"]);
        train.args(["--skin", SKIN, "--out"]).arg(out);
        with_map(&mut train);
        finish(train.arg(&bag));
        let card = json(&std::fs::read_to_string(out.join("card.json")).unwrap());
        assert!(card["locations"].as_u64() > Some(60), "{}", card["locations"]);
        assert_eq!(card["map"].is_null(), !map);
        looks_right(&out.join("report.html"));
        // Both are measured against our ground truth, on all that was recorded.
        let text =
            finish(dermis().args(["evaluate", "--json", "--skin", SKIN, "--model"]).arg(out).arg(&bag));
        figures.push(json(&text)["figures"].clone());
    }
    let [a, b] = ["position_median", "force_normal_rms"].map(|name| {
        let both = [0, 1].map(|i| figures[i][name].as_f64().unwrap_or(f64::NAN));
        println!("{name}: {both:?}");
        both
    });
    // Networks of two trainings on labels that differ by noise scatter by some tens of per cent.
    assert!(a[0] < 3e-3 && a[1] < 3e-3 && (a[0] - a[1]).abs() < 0.5 * a[0], "{figures:?}");
    assert!(b[0] < 0.1 && b[1] < 0.1 && (b[0] - b[1]).abs() < 0.5 * b[0].max(0.02), "{figures:?}");
}

#[test]
fn a_model_that_was_trained_elsewhere_runs_in_the_node() {
    let Some(python) = client_python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let [bag, table, onnx, bundle, link, seen] =
        ["presses", "table", "linear.onnx", "bundle", "device", "seen"].map(|n| dir.path().join(n));
    let plan = plan(dir.path(), 150, [0.4, 1.2]);
    finish(dermis().args(["collect", SKIN, "--plan"]).arg(plan).arg("--out").arg(&bag));
    finish(
        dermis()
            .args(["bag", "export", "--skin", SKIN, "--format", "parquet,npz", "--tared", "--out"])
            .arg(&table)
            .arg(&bag),
    );
    let script = |name: &str| root().join("integration-tests/python/training").join(name);
    let output = finish(Command::new(&python).arg(script("fit.py")).arg(&table).arg("presses").arg(&onnx));
    let fit = json(output.trim().strip_prefix("FIT ").unwrap());

    let wiring = dir.path().join("wiring.toml");
    let text = "baseline = \"raw\"\nscale = 1000.0\n[outputs.\"position.x\"]\nscale = 1e-3\n[outputs.\"position.y\"]\nscale = 1e-3\n";
    std::fs::write(&wiring, text).unwrap();
    let new = |outputs: &str| {
        let mut command = dermis();
        command.args([
            "bundle",
            "new",
            "--skin",
            SKIN,
            "--outputs",
            outputs,
            "--split",
            "location",
            "--json",
        ]);
        command.arg("--onnx").arg(&onnx).arg("--input").arg(&wiring).arg("--from-bag").arg(&bag);
        command.arg("--out").arg(&bundle);
        command
    };
    let wrong = refused(&mut new("position.x,position.y"));
    assert!(wrong.contains("has 3 numbers where there are 2 numbers for position.x, position.y"), "{wrong}");
    assert!(!bundle.exists());
    let made = json(&finish(&mut new("position.x,position.y,force.normal")));
    for name in ["position.x", "position.y", "force.normal"] {
        let measured = &made["measured"]["quantities"][name];
        let (ours, numpys) = (measured["rms"].as_f64().unwrap(), fit[name].as_f64().unwrap());
        // Contacts are moved to the edge of the surface where the line leads beyond it; NumPy does not.
        let least = if name == "force.normal" { 0.999 } else { 0.98 };
        assert!((least..1.001).contains(&(ours / numpys)), "{name}: {ours} here, {numpys} in NumPy");
        assert_eq!(measured["samples"], fit["rows"]);
    }
    // With the node's own estimator around it, light contacts may be missed; otherwise it is the same.
    let text = finish(
        dermis()
            .args(["evaluate", "--json", "--split", "location", "--skin", SKIN, "--model"])
            .arg(&bundle)
            .arg(&bag),
    );
    let (ours, numpys) =
        (json(&text)["figures"]["force_normal_rms"].as_f64().unwrap(), fit["force.normal"].as_f64().unwrap());
    assert!((ours - numpys).abs() < 0.2 * numpys, "{ours} N in the estimator, {numpys} N in NumPy");

    let mut device =
        Peer::start(dermis().args(["device", "replay", "--skin", SKIN, "--link"]).arg(&link).arg(&bag));
    device.expect("", SOON);
    let _node = Peer::start(
        dermis()
            .args(["barodome", "--skin", SKIN, "--source"])
            .arg(serial(&link))
            .arg("--model")
            .arg(&bundle),
    );
    finish(dermis().args(["record", "taxels", "contacts", "--duration", "10s", "--out"]).arg(&seen));
    finish(
        Command::new(&python)
            .arg(script("check.py"))
            .arg(seen.join("seen_0.mcap"))
            .arg(table.join("fit.npz")),
    );
}

#[test]
fn a_bag_that_cannot_be_learned_from_says_all_that_it_lacks() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let plan = plan(dir.path(), 5, [0.4, 1.2]);
    finish(dermis().args(["collect", SKIN, "--plan"]).arg(plan).arg("--out").arg(&bag));
    let check = |arguments: &[&str]| {
        let mut command = dermis();
        command.args(["train", "--check", "--skin", SKIN, "--config", "launch/train/baro-grid.toml"]);
        command.args(arguments).arg(&bag);
        command
    };
    finish(&mut check(&["--split", "time"]));
    let error = refused(&mut check(&["--map", MAP]));
    for part in
        ["2 things are in the way", "holds nothing usable on /tool_pose", "holds nothing usable on /wrench"]
    {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
}
