//! `dermis watch` beside skins that run: what it prints, whom it finds, and what it says where there is nothing.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use dermis_integration_tests::{Pad, Peer, domain, isolate, json, program, root};
use serde_json::Value;

const SOON: Duration = Duration::from_secs(60);

fn dermis() -> Command {
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()));
    command
}

fn watch(arguments: &[&str]) -> Peer {
    Peer::start(dermis().arg("watch").args(arguments))
}

/// The first object with all of these skins, by topic, and contacts known.
fn expect(watch: &mut Peer, topics: &[&str], holds: impl Fn(&Value) -> bool) -> Value {
    let begun = Instant::now();
    loop {
        let seen = json(&watch.expect("{", SOON));
        let skins = seen["skins"].as_array().unwrap_or_else(|| panic!("{seen}"));
        let all = topics.iter().all(|topic| skins.iter().any(|s| s["topic"] == *topic));
        if all && holds(&seen) {
            return seen;
        }
        assert!(begun.elapsed() < SOON, "{seen}");
    }
}

#[test]
fn a_running_demo_is_shown_by_another_process() {
    let scratch = tempfile::tempdir().unwrap();
    let mut demo = Peer::start(
        dermis().args(["demo", "--duration", "150s", "--json", "--no-bridge"]).env("TMPDIR", scratch.path()),
    );
    let mut as_json = watch(&["--json", "--within", "40s"]);
    let seen = expect(&mut as_json, &["/contacts"], |seen| {
        let skin = &seen["skins"][0];
        skin["latest"]["contacts"].as_array().is_some_and(|c| !c.is_empty()) && skin["node"].is_string()
    });
    let skin = &seen["skins"][0];
    assert_eq!((&skin["skin"], &skin["node"]), (&"baro-grid".into(), &"/baro_grid".into()), "{seen}");
    assert!(skin["rate_hz"].as_f64().unwrap() > 1.0 && skin["latency_ms"]["p50"].is_number(), "{seen}");
    assert_eq!(skin["latest"]["header"]["frame_id"], "baro_grid_link");

    // The table, as in a log: a line a second.
    let mut table = watch(&["baro-grid", "--within", "40s"]);
    let line = table.expect("baro-grid ", SOON);
    assert!(line.contains(" frames/s  latency "), "{line}");

    // Who is not there is named, and so is who is.
    let out = dermis()
        .args(["watch", "elbow", "--within", "8s"])
        .env("ROS_DOMAIN_ID", domain().to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success(), "{said}");
    assert!(said.contains("skin `elbow` was not heard") && said.contains("there are baro-grid"), "{said}");

    // Ended as a supervisor ends programs, both are done with what they do, and the demo's files are gone.
    assert_ne!(std::fs::read_dir(scratch.path()).unwrap().count(), 0);
    as_json.signal("TERM");
    assert!(as_json.end(SOON).success());
    demo.signal("TERM");
    let found = json(&demo.expect("{", SOON));
    assert!(found["arrays"].as_u64().is_some_and(|arrays| arrays > 0), "{found}");
    assert!(demo.end(SOON).success());
    let left: Vec<_> = std::fs::read_dir(scratch.path()).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn two_skins_are_tared_and_shown_apart() {
    let folder = tempfile::tempdir().unwrap();
    let _left = Pad::start(folder.path(), &["--namespace", "/left"]);
    let _right = Pad::start(folder.path(), &["--namespace", "/right"]);
    let mut both =
        Peer::start(dermis().args(["watch", "--tare", "--json", "--within", "60s"]).stderr(Stdio::inherit()));
    let topics = ["/left/contacts", "/right/contacts"];
    // Status 0: tared, and not touched.
    let seen = expect(&mut both, &topics, |seen| {
        seen["skins"].as_array().unwrap().iter().all(|s| s["latest"]["status"] == 0)
    });
    for (skin, namespace) in seen["skins"].as_array().unwrap().iter().zip(["/left", "/right"]) {
        assert_eq!(skin["node"], format!("{namespace}/baro_grid"), "{seen}");
    }
    both.kill();

    // What a tare did is reported, each skin for itself; the end says whether all were obeyed.
    let out = dermis()
        .args(["watch", "--tare", "--duration", "12s", "--within", "30s"])
        .env("ROS_DOMAIN_ID", domain().to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .output()
        .unwrap();
    let (table, said) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert!(out.status.success(), "{said}");
    for device in ["left_baro_grid", "right_baro_grid"] {
        assert!(said.contains(&format!("{device}: tared over ")), "{said}");
        assert!(table.contains(&format!("{device}  ")), "{table}");
    }
    assert!(table.contains("not touched"), "{table}");
}

#[test]
fn nothing_to_watch_is_said_with_what_to_check() {
    let out = dermis()
        .args(["watch", "--within", "2s"])
        .env("ROS_DOMAIN_ID", domain().to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success() && out.stdout.is_empty(), "{said}");
    let domain = format!("no skin was heard within 2 s in ROS domain {} over hiroz", domain());
    for part in [domain.as_str(), "ROS_DOMAIN_ID", "network", "--backend"] {
        assert!(said.contains(part), "{part} is missing in: {said}");
    }
}
