//! `dermis validate`, and what the program says of skins that cannot be.

use std::process::{Command, Output};

use dermis_integration_tests::{program, root};

fn dermis(arguments: &[&str]) -> Output {
    Command::new(program("dermis")).args(arguments).output().expect("the program starts")
}

fn sentence(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(output.stdout.is_empty(), "{output:?}");
    String::from_utf8(output.stderr.clone()).expect("text")
}

/// Without other programs the closed forms remain. CalculiX runs in unit tests of the families and of `dermis-mechanics`.
#[test]
fn barometers_meet_their_references() {
    let alone = |arguments: &[&str]| {
        let mut command = Command::new(program("dermis"));
        let output = command.args(["validate", "baro"]).args(arguments).env("PATH", "").output().unwrap();
        assert!(output.status.success(), "{output:?}");
        output
    };
    let output = alone(&["--json"]);
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["failed"], 0);
    let cases = summary["cases"].as_array().unwrap();
    for id in ["B1", "B2", "B3", "B4", "B5", "B6"] {
        let of = |c: &&serde_json::Value| c["id"].as_str().is_some_and(|name| name.starts_with(id));
        assert!(cases.iter().any(|c| of(&c)), "{id} is missing");
    }
    for case in cases {
        let number = |key: &str| case[key].as_f64().unwrap();
        assert!((number("got") - number("reference")).abs() <= number("tolerance"), "{case}");
    }
    let output = alone(&[]);
    let [table, said] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(table.contains("Boussinesq") && table.contains("within their tolerance"), "{table}");
    assert!(said.contains("left out what CalculiX judges"), "{said}");
}

#[test]
fn what_another_program_says_when_it_fails_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let ccx = folder.path().join("ccx");
    std::fs::write(&ccx, "#!/bin/sh\n[ \"$1\" = -v ] && exit 0\necho no licence is left\nexit 3\n").unwrap();
    std::fs::set_permissions(&ccx, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    let mut command = Command::new(program("dermis"));
    let output = command.args(["validate", "baro"]).env("PATH", folder.path()).output().unwrap();
    let said = sentence(&output);
    assert!(said.contains("ccx failed (exit status: 3): no licence is left"), "{said}");
}

#[test]
fn a_family_that_is_not_there_is_named() {
    let said = sentence(&dermis(&["validate", "camera"]));
    assert!(said.contains("camera") && said.contains("barodome"), "{said}");
}

#[test]
fn impossible_skins_are_refused_in_one_sentence() {
    let text = std::fs::read_to_string(root().join("launch/skins/baro-grid.toml")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for (from, to, field) in [
        ("thickness = 0.010", "thickness = -0.010", "medium.thickness"),
        ("thickness = 0.010", "thickness = 0.010\nthicknes = 0.010", "medium.thicknes"),
        ("[-0.0130, -0.0130, -0.005]", "[-0.0130, -0.0130, -0.011]", "taxels[0].position"),
        ("base = \"bonded\"", "base = 2", "medium.base"),
        ("unit = \"Pa\"", "unit = \"Pa\"\ncolour = \"red\"", "colour"),
    ] {
        assert!(text.contains(from), "{from} is not in the file");
        let path = folder.path().join("bad.toml");
        std::fs::write(&path, text.replace(from, to)).unwrap();
        let out = folder.path().join("out");
        let said =
            sentence(&dermis(&["bounds", &path.display().to_string(), "-o", &out.display().to_string()]));
        assert!(said.contains(field) && said.contains("bad.toml"), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(!out.exists(), "something was written for {field}");
    }
}
