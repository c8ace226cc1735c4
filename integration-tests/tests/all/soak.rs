//! The long run, two minutes of it: memory, losses and latency of four skins and a recorder.

use std::process::Command;

use dermis_integration_tests::{program, root};

#[test]
fn two_minutes_lose_nothing_and_grow_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let plot = folder.path().join("soak.svg");
    let out = Command::new(program("dermis-bench"))
        .args(["soak", "--minutes", "2", "--check", "--dermis"])
        .arg(program("dermis"))
        .arg("--plot")
        .arg(&plot)
        .current_dir(root())
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{text}\n{}", String::from_utf8_lossy(&out.stdout));
    let summary: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    // A hundred frames a second from each skin: that nothing was lost means nothing where nothing came.
    for received in summary["received"].as_array().unwrap() {
        assert!(received.as_u64().unwrap() > 11_000, "{summary}");
    }
    assert!(std::fs::read_to_string(plot).unwrap().contains("record"));
}
