//! The panel of conductive fabric: its sheet beside pyEIT's, and its way through the program.

use std::path::PathBuf;
use std::process::Command;

use dermis_ert::sheet::{Design, Grid, Sheet};
use dermis_integration_tests::{finish, isolate, json, program, refused, root};

const SKIN: &str = "launch/skins/ert-panel.toml";

fn dermis(arguments: &[&str]) -> Command {
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()).args(arguments));
    command
}

/// Python with pyEIT: that of `cargo xtask bench ert`, or one that is made in `folder`; prints why where there is none.
fn pyeit(folder: &std::path::Path) -> Option<PathBuf> {
    let works = |python: &PathBuf| {
        Command::new(python).args(["-c", "import pyeit"]).output().is_ok_and(|out| out.status.success())
    };
    let there = root().join(".dermis/pyeit/bin/python");
    if works(&there) {
        return Some(there);
    }
    let made = folder.join("pyeit");
    let python = made.join("bin/python");
    let ends_well = |command: &mut Command| command.output().is_ok_and(|out| out.status.success());
    let ready = ends_well(Command::new("python3").args(["-m", "venv"]).arg(&made))
        && ends_well(
            Command::new(&python)
                .args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"])
                .arg(root().join("benches/python/pyeit.lock.txt")),
        );
    if ready && works(&python) {
        return Some(python);
    }
    eprintln!("skipped: pyEIT cannot be installed (pip install pyeit)");
    None
}

#[test]
fn the_sheet_is_that_of_pyeit() {
    let folder = tempfile::tempdir().unwrap();
    let Some(python) = pyeit(folder.path()) else { return };
    let grid = Grid { size: [0.54, 0.56], cells: [90, 90] };
    let square = 1e4;
    // So small a leak shows in no difference.
    let design = Design { grid, resistance: [square; 2], leak: 1e-12, field: None };
    let sheet = Sheet::new(&design, &[]).unwrap();
    let nodes = [[15, 18], [75, 72], [45, 45], [30, 60], [89, 3]].map(|place| grid.number(place));
    let mut command = Command::new(python);
    command.arg(root().join("integration-tests/python/ert/pair.py"));
    command.args(["90", "90", "0.54", "0.56", "1e4"]).args(nodes.map(|node| node.to_string()));
    let theirs: Vec<f64> = serde_json::from_value(json(&finish(&mut command))).unwrap();
    let pairs = (0..nodes.len()).flat_map(|a| (a + 1..nodes.len()).map(move |b| (nodes[a], nodes[b])));
    let ours: Vec<f64> =
        pairs.map(|(a, b)| sheet.green(a, a) - 2.0 * sheet.green(a, b) + sheet.green(b, b)).collect();
    assert_eq!(ours.len(), theirs.len());
    for (a, b) in ours.iter().zip(&theirs) {
        assert!((a / b - 1.0).abs() < 1e-4, "{a} Ω here, {b} Ω in pyEIT");
    }
}

#[test]
fn its_physics_meets_its_references() {
    let summary = json(&finish(&mut dermis(&["validate", "ert", "--json"])));
    assert_eq!(summary["failed"], 0, "{summary}");
    let cases = summary["cases"].as_array().unwrap();
    for id in ["E1", "E2", "E3", "E4", "E5", "E6", "E7"] {
        let of = |c: &serde_json::Value| c["id"].as_str().is_some_and(|name| name.starts_with(id));
        assert!(cases.iter().any(of), "{id} is missing");
    }
}

#[test]
fn a_panel_is_described_and_collected_with_and_without_effects() {
    let skin = json(&finish(&mut dermis(&["skin", SKIN, "--json"])));
    assert_eq!((skin["taxels"].as_u64(), skin["channels"].as_u64()), (Some(28), Some(784)));
    assert_eq!(skin["forward_model"], "yes");
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.toml");
    let text = "schema = 'dermis-plan/1'\nname = 'panel'\nseed = 3\ndiameter = 0.02\nmargin = 0.02\n\
                [timing]\napproach = [0.1, 0.2]\nload = [0.1, 0.2]\nhold = [0.2, 0.3]\nunload = [0.1, 0.2]\ngap = [0.2, 0.3]\n\
                [[steps]]\nkind = 'idle'\nduration = 2.0\n[[steps]]\nkind = 'presses'\ncount = 3\nforce = [5.0, 40.0]\n";
    std::fs::write(&plan, text).unwrap();
    for effects in [None, Some("launch/effects/ert-default.toml")] {
        let bag = folder.path().join(if effects.is_some() { "real" } else { "ideal" });
        let mut collect = dermis(&["collect", SKIN, "--plan"]);
        collect.arg(&plan).arg("--out").arg(&bag);
        effects.iter().for_each(|file| _ = collect.args(["--effects", file, "--seed", "7"]));
        finish(&mut collect);
        let info = json(&finish(dermis(&["bag", "info", "--json"]).arg(&bag)));
        let topics = info["topics"].as_array().unwrap();
        let frames = topics.iter().find(|t| t["name"] == "/taxels").unwrap()["messages"].as_u64().unwrap();
        assert!(frames > 200, "{info}");
    }
}

/// What `demo` finds on a skin.
fn shown(skin: &str) -> serde_json::Value {
    let mut command = dermis(&["demo", "--skin", skin, "--duration", "9s", "--json", "--no-bridge"]);
    command.env("ROS_DOMAIN_ID", dermis_integration_tests::domain().to_string());
    let found = json(&finish(&mut command));
    assert!(number(&found, "/touched") > 0.0 && number(&found, "/compared") > 10.0, "{found}");
    assert_eq!(number(&found, "/status/fault"), 0.0, "{found}");
    found
}

fn number(found: &serde_json::Value, at: &str) -> f64 {
    found.pointer(at).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN)
}

/// The panel is shown without a bundle: contacts come from its forward model, nearer to the truth than half of the distance between two
/// electrodes.
#[test]
fn the_demo_shows_the_panel() {
    let found = shown("ert-panel");
    assert!(number(&found, "/position_error_mm/p50") < 45.0, "{found}");
    assert!(number(&found, "/force_error_n/p50") < 10.0, "{found}");
}

/// On a limb, whose normals point all about, forces are compared along them.
#[test]
fn the_demo_shows_a_limb() {
    let found = shown("hapdef-shin");
    assert!(number(&found, "/position_error_mm/p50") < 5.0, "{found}");
    assert!(number(&found, "/force_error_n/p50") < 1.0, "{found}");
}

#[test]
fn a_skin_that_does_not_ship_is_refused_with_those_that_do() {
    let said = refused(&mut dermis(&["demo", "--skin", "ert-pannel"]));
    assert!(
        said.contains("ert-pannel") && said.contains("baro-grid") && said.contains("or give the path"),
        "{said}"
    );
}
