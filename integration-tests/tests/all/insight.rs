//! The camera in a soft thumb, through the program.

use std::process::Command;

use dermis_integration_tests::{finish, isolate, json, program, root};

fn dermis(arguments: &[&str]) -> Command {
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()).args(arguments));
    command
}

#[test]
fn its_physics_meets_its_references() {
    let summary = json(&finish(&mut dermis(&["validate", "insight", "--json"])));
    assert_eq!(summary["failed"], 0, "{summary}");
    let cases = summary["cases"].as_array().unwrap();
    for id in ["I1", "I3", "I4", "I5"] {
        let of = |c: &serde_json::Value| c["id"].as_str().is_some_and(|name| name.starts_with(id));
        assert!(cases.iter().any(of), "{id} is missing");
    }
}

/// Blocks of its picture are its numbers.
#[test]
fn the_thumb_that_ships_is_described() {
    let skin = json(&finish(&mut dermis(&["skin", "launch/skins/insight-thumb.toml", "--json"])));
    assert_eq!((skin["taxels"].as_u64(), skin["channels"].as_u64()), (Some(300), Some(1500)));
    assert_eq!(skin["forward_model"], "yes");
}
