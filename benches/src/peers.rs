//! Peers in Python.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::Value;

/// How long peers measure, and in how many processes.
pub struct Run<'a> {
    /// Python with what the peers import.
    pub python: &'a Path,
    /// Root of the repository.
    pub root: &'a Path,
    /// \[s\] of each measurement.
    pub seconds: f64,
    /// Processes.
    pub threads: usize,
}

impl Run<'_> {
    /// As [`answers`](Self::answers), of peers that compute the same as ours: each names its `deviation` from that, which may be
    /// `deviation` at most.
    pub fn of(&self, script: &str, data: &Value, deviation: f64) -> Result<Vec<Value>> {
        let peers = self.answers(script, data)?;
        for peer in &peers {
            // A peer that computes something else is none.
            if peer["deviation"].as_f64().is_none_or(|d| d > deviation) {
                bail!("what a peer computes is not ours: {peer}");
            }
        }
        Ok(peers)
    }

    /// What the peers of `benches/python/<script>` say of themselves, given `data`.
    pub fn answers(&self, script: &str, data: &Value) -> Result<Vec<Value>> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("data.json");
        std::fs::write(&file, data.to_string())?;
        let out = Command::new(self.python)
            .arg(self.root.join("benches/python").join(script))
            .arg(&file)
            .args([self.seconds.to_string(), self.threads.to_string()])
            // Threads are counted: none besides those that are requested.
            .envs([("OMP_NUM_THREADS", "1"), ("OPENBLAS_NUM_THREADS", "1")])
            .output()
            .with_context(|| format!("{} cannot be started", self.python.display()))?;
        if !out.status.success() {
            bail!("a peer failed: {}", String::from_utf8_lossy(&out.stderr));
        }
        serde_json::from_slice(&out.stdout).context("the peers printed something else")
    }
}
