//! What fuzzing has found, tried again: the committed corpus of every fuzz target, which holds each input that once failed.

#[path = "../../fuzz/src/lib.rs"]
#[allow(dead_code, missing_docs, reason = "a crate of its own")]
mod fuzz;

use std::collections::BTreeSet;

use dermis_integration_tests::root;

fn replay(target: &str) {
    let (_, run) = fuzz::TARGETS.iter().find(|(name, _)| *name == target).expect("a fuzz target");
    let folder = root().join("fuzz/corpus").join(target);
    let files = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut count = 0;
    for file in files {
        let path = file.expect("an entry of the corpus").path();
        let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        if std::panic::catch_unwind(|| run(&bytes)).is_err() {
            panic!("{} fails", path.display());
        }
        count += 1;
    }
    println!("{count} inputs of {target}");
    assert!(count > 0, "{} is empty", folder.display());
}

#[test]
fn frames() {
    replay("frames");
}

#[test]
fn cdr() {
    replay("cdr");
}

#[test]
fn json() {
    replay("json");
}

#[test]
fn bag() {
    replay("bag");
}

#[test]
fn metadata() {
    replay("metadata");
}

#[test]
fn config() {
    replay("config");
}

#[test]
fn every_target_is_replayed_and_every_message_is_fuzzed() {
    let folders = std::fs::read_dir(root().join("fuzz/corpus")).expect("a corpus");
    let folders: BTreeSet<String> =
        folders.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    assert_eq!(folders, fuzz::TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect());
    let fuzzed: BTreeSet<&str> = fuzz::messages::kinds().iter().map(|k| k.support.name).collect();
    let all: BTreeSet<&str> = dermis_msgs::type_supports().iter().map(|s| s.name).collect();
    assert_eq!(fuzzed, all, "fuzz/src/messages.rs lists every type");
}
