//! Benchmark sets with withheld causes and the check on them, through the program as anybody would call it.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::Path;
use std::process::Command;

use dermis_integration_tests::{finish, json, program, refused, root};

fn gap() -> Command {
    let mut command = Command::new(program("dermis"));
    command.arg("gap").env("XDG_CACHE_HOME", std::env::temp_dir().join("dermis-gap-check-cache"));
    command
}

fn make(what: &[&str], dir: &Path) -> serde_json::Value {
    make_of(&root().join("launch/skins/baro-line.toml"), what, dir)
}

fn make_of(skin: &Path, what: &[&str], dir: &Path) -> serde_json::Value {
    let mut command = gap();
    command.args(["benchmark", "generate", "--json", "--seed", "5", "--size", "0.3"]).args(what);
    command.arg("--skin").arg(skin);
    command.arg("--truth").arg(dir.join("truth")).arg("--out").arg(dir.join("set"));
    json(&finish(&mut command))
}

#[test]
fn a_small_benchmark_set_is_diagnosed_sealed_and_scored() {
    let dir = tempfile::tempdir().unwrap();
    let made = make(&["--kind", "singles", "--count", "2"], dir.path());
    assert_eq!(made["cases"], 2);
    let (set, truth, out) = (dir.path().join("set"), dir.path().join("truth"), dir.path().join("check"));

    // Reports first, without any ground truth. The command and its flag have had other names.
    let mut sealing = gap();
    sealing.args(["check", "--pack"]).arg(&set).arg("--out").arg(&out).args(["--", "--resamples", "0"]);
    let sealed = finish(&mut sealing);
    assert!(sealed.contains("reports sealed, sha256"), "{sealed}");

    let check = |out: &Path| {
        let mut command = gap();
        command.args(["benchmark", "run", "--json", "--set"]).arg(&set).arg("--truth").arg(&truth);
        command.arg("--out").arg(out).args(["--", "--resamples", "0"]);
        command
    };
    let scores = json(&finish(&mut check(&out)));
    assert_eq!(scores["sets"][0]["sha256"], made["sha256"]);
    let cases = scores["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 2);
    for case in cases {
        let controls = case["kind"] == "controls";
        assert!(
            controls || case["causes"][0]["what"].as_str().is_some_and(|what| !what.is_empty()),
            "{case}"
        );
    }
    assert_eq!(scores["baselines"].as_array().unwrap().len(), 4);
    assert!(scores["tool"].as_str().is_some_and(|tool| tool.starts_with("dermis ")), "{scores}");
    assert!(scores["by_gap"].as_object().is_some_and(|gaps| !gaps.is_empty()), "{scores}");
    for (name, holds) in
        [("summary.json", "gap-check/1"), ("summary.md", "| score | value |"), ("summary.svg", "</svg>")]
    {
        let text = std::fs::read_to_string(out.join(name)).unwrap();
        assert!(text.contains(holds) && !text.contains(&*dir.path().to_string_lossy()), "{name}: {text}");
    }
    crate::browser::looks_right(&out.join("summary.svg"));

    // A report that is changed once the ground truths may have been seen is refused.
    let of_reports = |p: &std::path::PathBuf| p.is_dir() && !p.ends_with("cases");
    let folder = std::fs::read_dir(&out).unwrap().map(|e| e.unwrap().path()).find(of_reports).unwrap();
    let report = folder.join("case-0001.json");
    let text = std::fs::read_to_string(&report).unwrap();
    std::fs::write(&report, format!("{text} ")).unwrap();
    let said = refused(&mut check(&out));
    assert!(said.contains("changed after they were sealed"), "{said}");
    std::fs::write(&report, text).unwrap();

    // And so is a ground truth.
    let changed = truth.join("case-0002.json");
    let text = std::fs::read_to_string(&changed).unwrap();
    std::fs::write(&changed, format!("{text} ")).unwrap();
    let said = refused(&mut check(&out));
    assert!(said.contains("changed after it was sealed"), "{said}");
}

/// Makes, seals, opens and scores two cases of a family whose device the benchmark is handed; its skin in fewer cells than what
/// ships.
fn family(skin: &str, coarser: &[(&str, &str)], kind: &str) {
    let dir = tempfile::tempdir().unwrap();
    let mut text = std::fs::read_to_string(root().join(format!("launch/skins/{skin}.toml"))).unwrap();
    for (fine, coarse) in coarser {
        assert!(text.contains(fine), "{fine}");
        text = text.replace(fine, coarse);
    }
    let file = dir.path().join("skin.toml");
    std::fs::write(&file, text).unwrap();
    let made = make_of(&file, &["--kind", kind, "--count", "2"], dir.path());
    assert_eq!(made["cases"], 2);
    let out = dir.path().join("check");
    let mut command = gap();
    command.args(["benchmark", "run", "--json", "--no-baselines", "--no-elsewhere", "--set"]);
    command.arg(dir.path().join("set")).arg("--truth").arg(dir.path().join("truth")).arg("--out").arg(&out);
    let scores = json(&finish(command.args(["--", "--zero", "start", "--resamples", "0"])));
    assert_eq!(scores["sets"][0]["sha256"], made["sha256"]);
    let cases = scores["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 2);
    for case in cases {
        assert_eq!(case["skin"], skin);
        let verdict = case["answer"]["verdict"].as_str().unwrap();
        assert!(!verdict.is_empty() && verdict != "unusable-recording", "{case}");
        // A cause that was withheld moves what it was asked to, and is described.
        for cause in case["causes"].as_array().unwrap() {
            assert!(cause["what"].as_str().is_some_and(|what| !what.is_empty()), "{case}");
        }
        let moved = case["unexplained"].as_f64().unwrap();
        assert_eq!(moved > 0.0, !case["causes"].as_array().unwrap().is_empty(), "{case}");
    }
    let summary = std::fs::read_to_string(out.join("summary.md")).unwrap();
    assert!(summary.contains("| score | value |"), "{summary}");
}

#[test]
fn a_panel_of_fabric_has_a_benchmark() {
    family("ert-panel", &[("cells = [90, 90]", "cells = [30, 30]")], "same-law");
}

#[test]
fn a_soft_thumb_has_a_benchmark() {
    let coarser = [
        ("spacing = 0.001135", "spacing = 0.005"),
        ("cells = [88, 5]", "cells = [24, 5]"),
        ("grid = 0.00125", "grid = 0.004"),
        ("size = [410, 308]", "size = [104, 80]"),
        ("blocks = [20, 15]", "blocks = [10, 8]"),
    ];
    family("insight-thumb", &coarser, "foreign");
}

#[test]
fn a_mixed_set_tells_nobody_what_a_case_holds() {
    let dir = tempfile::tempdir().unwrap();
    let made = make(&["--share", "0.01"], dir.path());
    // In the proportions of a full set, one of each kind at least.
    assert_eq!(made["cases"], 7);
    let manifest = std::fs::read_to_string(dir.path().join("set/manifest.json")).unwrap();
    for word in ["singles", "controls", "out-of-library", "pairs", "triples", "confounded"] {
        assert!(!manifest.contains(word), "{manifest}");
    }
    let manifest: serde_json::Value = serde_json::from_str(&manifest).unwrap();
    let presses: Vec<u64> =
        manifest["cases"].as_array().unwrap().iter().map(|c| c["presses"].as_u64().unwrap()).collect();
    assert!(presses.iter().collect::<std::collections::BTreeSet<_>>().len() < presses.len(), "{presses:?}");
}
