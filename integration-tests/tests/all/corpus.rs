//! What fuzzing has found, tried again: the committed corpus of every fuzz target, which holds each input that once failed.

#[path = "../../../fuzz/src/lib.rs"]
#[allow(dead_code, missing_docs, reason = "a crate of its own")]
mod fuzz;

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use dermis_integration_tests::root;

/// Longest time that an input takes, on a machine at full load.
const PATIENCE: Duration = Duration::from_secs(20);
/// \[bytes\] that this process may ever hold.
const MEMORY: u64 = 1 << 30;

/// \[bytes\] that this process has held at most.
fn most_memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or_default();
    line.trim().trim_end_matches(" kB").parse::<u64>().unwrap_or(0) * 1024
}

fn replay(target: &str) {
    let (_, run) = fuzz::TARGETS.iter().find(|(name, _)| *name == target).expect("a fuzz target");
    let folder = root().join("fuzz/corpus").join(target);
    let files = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut count = 0;
    for file in files {
        let path = file.expect("an entry of the corpus").path();
        let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let begun = Instant::now();
        if std::panic::catch_unwind(|| run(&bytes)).is_err() {
            panic!("{} fails", path.display());
        }
        assert!(begun.elapsed() < PATIENCE, "{} takes {:?}", path.display(), begun.elapsed());
        assert!(most_memory() < MEMORY, "{} takes {} bytes of memory", path.display(), most_memory());
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
fn bundle() {
    replay("bundle");
}

#[test]
fn labels() {
    replay("labels");
}

#[test]
fn launch() {
    replay("launch");
}

#[test]
fn mesh() {
    replay("mesh");
}

#[test]
fn plan() {
    replay("plan");
}

#[test]
fn skin() {
    replay("skin");
}

#[test]
fn srdf() {
    replay("srdf");
}

#[test]
fn urdf() {
    replay("urdf");
}

#[test]
fn rules() {
    replay("rules");
}

#[test]
fn picture() {
    replay("picture");
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
