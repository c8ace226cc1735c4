//! Packs with withheld causes and the check on them, through the program as anybody would call it.

use std::path::Path;
use std::process::Command;

use dermis_integration_tests::{finish, json, program, refused, root};

fn gap() -> Command {
    let mut command = Command::new(program("dermis"));
    command.arg("gap").env("XDG_CACHE_HOME", std::env::temp_dir().join("dermis-gap-check-cache"));
    command
}

fn make(kind: &str, dir: &Path) -> serde_json::Value {
    let mut command = gap();
    command.args([
        "make-pack",
        "--json",
        "--kind",
        kind,
        "--count",
        "2",
        "--seed",
        "5",
        "--size",
        "0.3",
        "--skin",
    ]);
    command.arg(root().join("launch/skins/baro-line.toml"));
    command.arg("--secret").arg(dir.join("secrets")).arg("--out").arg(dir.join("pack"));
    json(&finish(&mut command))
}

#[test]
fn a_small_pack_is_diagnosed_sealed_and_scored() {
    let dir = tempfile::tempdir().unwrap();
    let made = make("singles", dir.path());
    assert_eq!(made["cases"], 2);
    let (pack, secrets, out) =
        (dir.path().join("pack"), dir.path().join("secrets"), dir.path().join("check"));

    // Reports first, without any secret.
    let mut sealing = gap();
    sealing.args(["check", "--pack"]).arg(&pack).arg("--out").arg(&out).args(["--", "--resamples", "0"]);
    let sealed = finish(&mut sealing);
    assert!(sealed.contains("reports sealed, sha256"), "{sealed}");

    let check = |out: &Path| {
        let mut command = gap();
        command.args(["check", "--json", "--pack"]).arg(&pack).arg("--secret").arg(&secrets);
        command.arg("--out").arg(out).args(["--", "--resamples", "0"]);
        command
    };
    let scores = json(&finish(&mut check(&out)));
    assert_eq!(scores["packs"][0]["sha256"], made["sha256"]);
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

    // A report that is changed once the secrets may have been seen is refused.
    let folder = std::fs::read_dir(&out).unwrap().map(|e| e.unwrap().path()).find(|p| p.is_dir()).unwrap();
    let report = folder.join("case-0001.json");
    let text = std::fs::read_to_string(&report).unwrap();
    std::fs::write(&report, format!("{text} ")).unwrap();
    let said = refused(&mut check(&out));
    assert!(said.contains("changed after they were sealed"), "{said}");
    std::fs::write(&report, text).unwrap();

    // And so is a secret.
    let secret = secrets.join("case-0002.json");
    let text = std::fs::read_to_string(&secret).unwrap();
    std::fs::write(&secret, format!("{text} ")).unwrap();
    let said = refused(&mut check(&out));
    assert!(said.contains("changed after it was sealed"), "{said}");
}
