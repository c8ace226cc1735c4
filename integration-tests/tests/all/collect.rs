//! The virtual testbed as a program: interrupted however it may be, and given what cannot be.
#![expect(clippy::unwrap_used, reason = "a test whose preparation fails should fail")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use dermis_bag::BagReader;
use dermis_integration_tests::{finish, json, program, refused, root};
use dermis_msgs::msg::{Indentation, TaxelFrame};

const GRID: &str = "launch/skins/baro-grid.toml";
const EFFECTS: &str = "launch/effects/baro-default.toml";

fn dermis() -> Command {
    let mut command = Command::new(program("dermis"));
    command.current_dir(root()).stdin(Stdio::null());
    command
}

fn collect(plan: &Path, out: &Path) -> Command {
    let mut command = dermis();
    command.args(["collect", GRID, "--json", "--plan"]).arg(plan).arg("--out").arg(out);
    command
}

fn plan(folder: &Path, steps: &str) -> PathBuf {
    let path = folder.join("plan.toml");
    let text = format!(
        r#"
        schema = "dermis-plan/1"
        name = "quick"
        seed = 7
        diameter = 0.004
        margin = 0.003
        timing = {{ approach = [0.02, 0.05], load = [0.04, 0.06], hold = [0.05, 0.08], unload = [0.03, 0.05], gap = [0.03, 0.05] }}
        {steps}
        "#
    );
    std::fs::write(&path, text).unwrap();
    path
}

fn messages(bag: &Path) -> Vec<(String, i64, Vec<u8>)> {
    let reader = BagReader::open(bag).unwrap_or_else(|e| panic!("{e}"));
    reader.messages().map(|m| m.unwrap()).map(|m| (m.topic.to_string(), m.log_time, m.data)).collect()
}

/// Bytes of a bag's first file; 0 where it is not there yet.
fn bytes(bag: &Path) -> u64 {
    let file = format!("{}_0.mcap", bag.file_name().unwrap().to_string_lossy());
    std::fs::metadata(bag.join(file)).map_or(0, |m| m.len())
}

/// Sends a signal to a collection once its bag has grown beyond so many bytes, and waits for its end.
fn interrupt(command: &mut Command, bag: &Path, beyond: u64, signal: &str) {
    let mut child = command.stdout(Stdio::null()).spawn().unwrap_or_else(|e| panic!("{command:?}: {e}"));
    let deadline = Instant::now() + Duration::from_secs(120);
    while bytes(bag) <= beyond {
        assert!(Instant::now() < deadline, "the bag does not grow");
        assert!(child.try_wait().unwrap().is_none(), "it ended before {beyond} bytes");
        std::thread::sleep(Duration::from_millis(1));
    }
    let sent = Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status();
    assert!(sent.unwrap().success());
    child.wait().unwrap();
}

#[test]
fn a_collection_that_is_killed_goes_on_to_the_bag_that_it_would_have_been() {
    let dir = tempfile::tempdir().unwrap();
    let [whole, bag] = ["whole", "bag"].map(|name| dir.path().join(name));
    let plan = plan(
        dir.path(),
        r#"steps = [{ kind = "idle", duration = 1.0 }, { kind = "presses", count = 800, force = [0.1, 1.2], shear = [0.0, 0.5] }]"#,
    );
    let with = |out: &Path| {
        let mut command = collect(&plan, out);
        command.args(["--effects", EFFECTS, "--effect", "read-skew=2", "--seed", "11"]);
        command
    };
    let all = json(&finish(with(&whole).args(["--start", "1700000000000000000"])));

    interrupt(with(&bag).args(["--start", "1700000000000000000"]), &bag, 200_000, "KILL");
    assert!(!bag.join("metadata.yaml").exists());
    // Again while it goes through what is there, and once beyond it.
    interrupt(with(&bag).arg("--resume"), &bag, 1_000, "KILL");
    interrupt(with(&bag).arg("--resume"), &bag, 600_000, "KILL");
    interrupt(with(&bag).arg("--resume"), &bag, 900_000, "INT");
    assert!(bag.join("metadata.yaml").exists());

    let gone_on = json(&finish(with(&bag).arg("--resume")));
    assert_eq!((&gone_on["frames"], &gone_on["interrupted"]), (&all["frames"], &false.into()));
    assert!(gone_on["resumed"].as_u64().unwrap() > 0);
    let (found, expected) = (messages(&bag), messages(&whole));
    assert_eq!(found.len(), expected.len());
    assert!(found == expected, "the messages differ");
    assert!(!dir.path().join("bag.interrupted").exists());
}

/// What a node without a bundle has to suppose of its device, labelled presses tell: no network is needed for that.
#[test]
fn labelled_presses_make_a_bundle_without_a_network() {
    let dir = tempfile::tempdir().unwrap();
    let [bag, model] = ["bag", "model"].map(|name| dir.path().join(name));
    let steps = r#"steps = [{ kind = "idle", duration = 2.0 }, { kind = "presses", count = 150, force = [0.2, 1.2] }]"#;
    finish(&mut collect(&plan(dir.path(), steps), &bag));
    let refine = |model: &Path, more: &[&str]| {
        let mut command = dermis();
        command.args(["refine", "--skin", GRID, "--model"]).arg(model).args(more).arg(&bag);
        command
    };
    let made = json(&finish(&mut refine(&model, &["--invert", "--json"])));
    // The device is as designed, where 2 % are supposed without a bundle.
    let error = made["settings"]["model_error"].as_f64().unwrap();
    assert!(error < 0.01, "{made}");
    assert!(!model.join("model.onnx").exists());
    let text = std::fs::read_to_string(model.join("bundle.toml")).unwrap();
    assert!(text.contains("[inversion]") && !text.contains("[output]"), "{text}");
    let mut evaluate = dermis();
    evaluate.args([
        "evaluate",
        "--held-out",
        "--skin",
        GRID,
        "--require",
        "position_median<=0.0002",
        "--model",
    ]);
    finish(evaluate.arg(&model).arg(&bag));
    // Nothing is taken for what it is not.
    let refusal = refused(&mut refine(&model, &[]));
    assert!(refusal.contains("has no network; say `--invert`"), "{refusal}");
    let refusal = refused(&mut refine(&root().join("models/baro-grid"), &["--invert"]));
    assert!(refusal.contains("has a network; leave out `--invert`"), "{refusal}");
    let refusal = refused(&mut refine(&model, &["--invert", "--contacts", "2"]));
    assert!(refusal.contains("--contacts"), "{refusal}");
}

#[test]
fn depth_shear_and_force_agree_in_what_is_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let plan = plan(
        dir.path(),
        r#"
        force_noise = 0.0
        stage_noise = 0.0
        [[steps]]
        kind = "grid"
        pitch = 0.007
        depths = [0.0002, 0.0006, 0.0012]
        incremental = true
        shear = 0.34
        "#,
    );
    let hardest = |extra: &[&str]| {
        let out = dir.path().join(format!("bag{}", extra.len()));
        json(&finish(collect(&plan, &out).args(extra)));
        let reader = BagReader::open(&out).unwrap();
        let mut hardest = 0.0f64;
        for label in reader.read::<Indentation>("ground_truth").unwrap() {
            for contact in label.unwrap().message.contacts {
                let (normal, along) = (-contact.force.z, contact.force.x.hypot(contact.force.y));
                assert!(contact.depth > 0.0 && contact.depth <= 0.0012 + 1e-12);
                assert!(along <= 0.34 * normal + 1e-9);
                hardest = hardest.max(normal);
            }
        }
        let frames = reader.read::<TaxelFrame>("taxels").unwrap();
        let largest = frames.flat_map(|f| f.unwrap().message.values).fold(0.0, f32::max);
        assert!(largest > 1000.0, "{largest} Pa");
        hardest
    };
    // Sneddon's half-space takes 0.215 N for 1.2 mm, the bonded layer a sixth more; a stiffer one in proportion.
    let nominal = hardest(&[]);
    assert!((0.24..0.27).contains(&nominal), "{nominal} N");
    let stiff = hardest(&["--effect", "modulus=2"]);
    assert!((stiff / nominal - 1.15f64.powi(2)).abs() < 0.01, "{stiff} N for {nominal} N");
}

#[test]
fn what_cannot_be_is_refused_before_anything_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("bag");
    let steps = |text: &str| plan(dir.path(), text);
    let says = |command: &mut Command, words: &[&str]| {
        let text = refused(command);
        for word in words {
            assert!(text.contains(word), "{word:?} is not in: {text}");
        }
        assert!(!text.contains("panicked") && !out.exists(), "{text}");
    };
    let fine = r#"steps = [{ kind = "presses", count = 3, force = [0.1, 0.2] }]"#;
    let one = |option: &str, value: &str, words: &[&str]| {
        says(collect(&steps(fine), &out).args([option, value]), words);
    };
    one("--effect", "tillt", &["effects[0].name", "tillt", "it has modulus, "]);
    one("--effect", "tilt=-1", &["tilt=-1", "is no effect"]);
    one("--effect", "relaxation=30", &["effects[0].strength", "at most 1"]);
    one("--effects", "nowhere.toml", &["nowhere.toml", "cannot be read"]);
    one("--force-noise", "-1", &["-1"]);
    let effects = dir.path().join("effects.toml");
    std::fs::write(&effects, "[[effects]]\nname = \"tilt\"\nangle = 3.0").unwrap();
    one("--effects", effects.to_str().unwrap(), &["effects[0].angle", "is 3 rad and must be 0 to 0.785 rad"]);
    std::fs::write(&effects, "[[effects]]\nname = \"tilt\"\nangel = 0.1").unwrap();
    one(
        "--effects",
        effects.to_str().unwrap(),
        &["effects[0].angel", "no parameter of tilt; it has angle, lever"],
    );

    let plans = [
        (r#"steps = [{ kind = "locations", at = [[0.02, 0.0, 0.0]], forces = [0.1] }]"#, "steps[0].at[0]"),
        (r#"steps = [{ kind = "presses", count = 1, depth = [0.02, 0.02] }]"#, "steps[0].depth"),
        (r#"steps = [{ kind = "grid", pitch = 0.01, depths = [0.001, 0.02] }]"#, "steps[0].depths"),
        (r#"steps = [{ kind = "grid", pitch = 1e-6, forces = [0.1] }]"#, "steps[0].pitch"),
        (
            r#"steps = [{ kind = "slides", count = 1, force = [0.1, 0.2], length = [0.1, 0.2], speed = [0.1, 0.2] }]"#,
            "steps[0].length",
        ),
        (
            r#"steps = [{ kind = "multi", count = 1, contacts = [2, 2], distance = 0.1, force = [0.1, 0.2] }]"#,
            "steps[0].distance",
        ),
    ];
    for (text, field) in plans {
        let plan = steps(text);
        says(&mut collect(&plan, &out), &[&plan.display().to_string(), &format!("`{field}`")]);
    }
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("notes.txt"), "").unwrap();
    let text = refused(collect(&steps(fine), &out).arg("--resume"));
    assert!(text.contains("notes.txt") && out.join("notes.txt").exists(), "{text}");
}

#[test]
fn effects_are_listed_for_people_and_programs() {
    let listed = json(&finish(dermis().args(["effects", "barodome", "--json"])));
    let effects = listed["families"][0]["effects"].as_array().unwrap().clone();
    for name in ["inclusion-gain", "mullins", "read-skew", "friction"] {
        let effect = effects.iter().find(|e| e["name"] == name).unwrap_or_else(|| panic!("no {name}"));
        let parameter = &effect["parameters"][0];
        assert!(
            parameter["unit"].is_string() && parameter["typical"].is_f64() && parameter["range"].is_array()
        );
    }
    let out = dermis().args(["effects", GRID]).output().unwrap();
    let text = String::from_utf8_lossy(&out.stdout);
    assert!(out.status.success() && text.contains("relaxation") && text.contains("Pa"), "{text}");
    assert!(
        refused(dermis().args(["effects", "eel"]))
            .contains("neither a sensor family (barodome, hapdef, ert, insight) nor")
    );
}
