//! Contacts for clients that know no ROS: zenoh's own Python client against the demo and the bridge.

use std::net::TcpListener;
use std::process::Command;
use std::time::Duration;

use dermis_integration_tests::{Pad, Peer, Recorded, client_python, program, root};

const SOON: Duration = Duration::from_secs(60);

fn script(name: &str) -> std::path::PathBuf {
    root().join("integration-tests/python/zenoh").join(name)
}

#[test]
fn the_ten_lines_of_the_readme_print_contacts() {
    let Some(python) = client_python() else { return };
    let _demo = Peer::start(Command::new(program("dermis")).args(["demo", "--duration", "90s", "--json"]));
    let mut client =
        Peer::start(Command::new(python).arg(script("contacts.py")).arg("80").current_dir(root()));
    let line = client.expect("contact ", SOON);
    let numbers: Vec<f64> = line.split(' ').skip(1).map(|n| n.parse().unwrap()).collect();
    assert!(
        numbers[0].abs() < 0.02 && numbers[1].abs() < 0.02 && (-3.0..=0.0).contains(&numbers[2]),
        "{line}"
    );
}

#[test]
fn readme_and_script_are_the_same() {
    let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
    let text = std::fs::read_to_string(script("contacts.py")).unwrap();
    let body = text.lines().skip_while(|l| l.starts_with("\"\"\"")).collect::<Vec<_>>().join("\n");
    assert!(readme.contains(body.trim()), "README.md must show integration-tests/python/zenoh/contacts.py");
}

#[test]
fn a_peer_gets_streams_latest_values_presence_and_schemas() {
    let Some(python) = client_python() else { return };
    let _demo = Peer::start(Command::new(program("dermis")).args(["demo", "--duration", "90s", "--json"]));
    let mut client = Peer::start(Command::new(python).arg(script("everything.py")).arg("peer"));
    client.expect("DONE", SOON);
}

#[test]
fn a_client_behind_a_router_gets_them_too() {
    let Some(python) = client_python() else { return };
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let mut router = Peer::start(Command::new(&python).arg(script("router.py")).arg(&endpoint));
    router.expect("READY", SOON);
    // The demo without its own bridge finds peers; this bridge talks through the router only.
    let _demo = Peer::start(Command::new(program("dermis")).args([
        "demo",
        "--duration",
        "90s",
        "--json",
        "--no-bridge",
    ]));
    let _bridge = Peer::start(Command::new(program("dermis")).args([
        "bridge",
        "--robot",
        "demo",
        "--mode",
        "client",
        "--connect",
        &endpoint,
    ]));
    let mut client =
        Peer::start(Command::new(python).arg(script("everything.py")).args(["client", &endpoint]));
    client.expect("DONE", SOON);
}

#[test]
fn a_recorded_skin_is_heard_without_ros() {
    let Some(python) = client_python() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let Some(_skin) = Recorded::start(scratch.path(), &[]) else { return };
    let _bridge = Peer::start(Command::new(program("dermis")).args(["bridge", "--robot", "rig"]));
    let mut client =
        Peer::start(Command::new(python).arg(script("contacts.py")).arg("80").current_dir(root()));
    let line = client.expect("contact ", SOON);
    let place: Vec<f64> = line.split(' ').skip(1).take(2).map(|n| n.parse().unwrap()).collect();
    assert!(place.iter().all(|p| p.abs() < 0.016), "the robot pressed a square of 30 mm: {line}");
}

/// Tare, switch and load, each with an answer; looking around commands nothing, and a bridge that only shows offers none.
#[test]
fn a_client_commands_a_skin_and_hears_what_came_of_it() {
    let Some(python) = client_python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let _pad = Pad::start(folder.path(), &["--name", "untouched"]);
    // Robots of no other test.
    let [arm, window] = ["arm", "window"].map(|name| format!("{name}-{}", std::process::id()));
    let _bridge = Peer::start(Command::new(program("dermis")).args(["bridge", "--robot", &arm]));
    let _shows =
        Peer::start(Command::new(program("dermis")).args(["bridge", "--read-only", "--robot", &window]));
    let mut client = Peer::start(Command::new(python).arg(script("commands.py")).args([&arm, &window]));
    client.expect("DONE", SOON);
}
