//! A `dermis launch` under test.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::{Peer, program};

/// Longest wait for anything, on a machine at full load.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// A running launch, whose log lines are JSON.
pub struct Launch {
    /// The process.
    pub peer: Peer,
    /// Log lines so far.
    pub records: Vec<Value>,
    /// Its working directory.
    pub folder: tempfile::TempDir,
}

impl Launch {
    /// Starts a launch file of this text.
    ///
    /// # Panics
    ///
    /// Where it cannot be started.
    #[must_use]
    pub fn start(text: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("test.launch.yaml");
        std::fs::write(&file, text).unwrap();
        Self::open(folder, &file, &[])
    }

    /// Starts a launch file in this folder.
    ///
    /// # Panics
    ///
    /// Where it cannot be started.
    #[must_use]
    pub fn open(folder: tempfile::TempDir, file: &Path, arguments: &[&str]) -> Self {
        let peer = Peer::start(
            Command::new(program("dermis"))
                .args(["launch", "--log-format", "json"])
                .arg(file)
                .args(arguments)
                .current_dir(folder.path())
                .stderr(Stdio::null()),
        );
        Self { peer, records: Vec::new(), folder }
    }

    /// The next record of a process with this text. Every line must be JSON on the way.
    ///
    /// # Panics
    ///
    /// Where none comes in time.
    pub fn wait(&mut self, process: &str, text: &str) -> Value {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let line = self.peer.expect("", deadline.saturating_duration_since(Instant::now()));
            let record: Value = serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line}"));
            assert!(record["time"].is_string() && record["message"].is_string(), "{line}");
            self.records.push(record.clone());
            if record["process"] == process && record["message"].as_str().unwrap().contains(text) {
                return record;
            }
        }
    }

    /// What the launch said of a process, with this text.
    ///
    /// # Panics
    ///
    /// Where none comes in time.
    pub fn wait_for(&mut self, text: &str) -> String {
        self.wait("launch", text)["message"].as_str().unwrap().to_owned()
    }

    /// Waits until the launch has said this, in any order with the rest.
    ///
    /// # Panics
    ///
    /// Where none comes in time.
    pub fn ever(&mut self, text: &str) {
        let said = |r: &Value| r["process"] == "launch" && r["message"].as_str().unwrap().contains(text);
        if !self.records.iter().any(said) {
            self.wait_for(text);
        }
    }

    /// The process id in "… started, process 42".
    ///
    /// # Panics
    ///
    /// Where none comes in time.
    pub fn started(&mut self, name: &str) -> i32 {
        let text = self.wait_for(&format!("{name} started, process "));
        text.rsplit(' ').next().unwrap().parse().unwrap()
    }
}

/// Sends a signal, e.g. `-KILL`.
///
/// # Panics
///
/// Where the process is not there.
pub fn kill(id: i32, signal: &str) {
    assert!(Command::new("kill").args([signal, &id.to_string()]).status().unwrap().success());
}

/// Whether a process runs; one that nobody has waited for yet does not.
#[must_use]
pub fn runs(id: i32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
    stat.rsplit(") ").next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with(['Z', 'X']))
}

/// Waits for a condition that nothing announces.
///
/// # Panics
///
/// Where it does not hold in time.
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !holds() {
        assert!(Instant::now() < deadline, "not within {PATIENCE:?}: {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Processes that this one has started, and their command lines.
#[must_use]
pub fn children(of: i32) -> Vec<(i32, String)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(id) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let stat = std::fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
        // `42 (name) S 7 …`: the name may hold anything, the parent comes after it.
        let parent = stat.rsplit(") ").next().and_then(|rest| rest.split(' ').nth(1)?.parse::<i32>().ok());
        if parent == Some(of) && runs(id) {
            let line = std::fs::read(entry.path().join("cmdline")).unwrap_or_default();
            found.push((id, String::from_utf8_lossy(&line).replace('\0', " ").trim().to_owned()));
        }
    }
    found
}
