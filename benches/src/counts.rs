//! How often a process is put to sleep and woken, and what it asks of the system.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::machine::{Process, interrupt, wait};

/// Switches of context of a process.
#[derive(Debug, Clone, Copy, Default)]
pub struct Switches {
    /// It waited for something.
    pub voluntary: u64,
    /// Another one had its turn.
    pub forced: u64,
}

/// Those of all threads that a process has now, since each began.
///
/// # Errors
///
/// Where the process is gone.
pub fn switches(child: &Child) -> Result<Switches> {
    let folder = format!("/proc/{}/task", child.id());
    let mut all = Switches::default();
    for task in
        std::fs::read_dir(&folder).with_context(|| format!("{folder}: the process is gone"))?.flatten()
    {
        // A thread may have ended meanwhile.
        let text = std::fs::read_to_string(task.path().join("status")).unwrap_or_default();
        let number = |name: &str| {
            text.lines().find_map(|line| line.strip_prefix(name)?.trim().parse::<u64>().ok()).unwrap_or(0)
        };
        all.voluntary += number("voluntary_ctxt_switches:");
        all.forced += number("nonvoluntary_ctxt_switches:");
    }
    Ok(all)
}

/// strace at work on a process.
pub struct Trace {
    process: Process,
    summary: tempfile::NamedTempFile,
}

impl Trace {
    /// Begins to count the system calls of a process and its threads; `None` where there is no strace.
    ///
    /// # Errors
    ///
    /// Where it cannot write.
    pub fn begin(child: &Child) -> Result<Option<Self>> {
        let summary = tempfile::NamedTempFile::new()?;
        let started = Command::new("strace")
            .args(["-c", "-f", "-q", "-p", &child.id().to_string(), "-o"])
            .arg(summary.path())
            .stderr(Stdio::null())
            .spawn();
        let Ok(started) = started else { return Ok(None) };
        // Until it has attached to every thread.
        std::thread::sleep(Duration::from_millis(500));
        Ok(Some(Self { process: Process(started), summary }))
    }

    /// Ends it; calls by name.
    ///
    /// # Errors
    ///
    /// Where strace says nothing.
    pub fn end(mut self) -> Result<Vec<(String, u64)>> {
        interrupt(&self.process.0)?;
        wait(&mut self.process.0, Duration::from_secs(10))?;
        read(self.summary.path())
    }
}

fn read(path: &Path) -> Result<Vec<(String, u64)>> {
    let calls = calls(&std::fs::read_to_string(path)?);
    if calls.is_empty() {
        bail!("strace counted nothing; may it attach to other processes (kernel.yama.ptrace_scope)?");
    }
    Ok(calls)
}

/// Of strace's table: most calls first, without their sum.
fn calls(table: &str) -> Vec<(String, u64)> {
    let mut rows: Vec<(String, u64)> = table
        .lines()
        .filter_map(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let (name, count) = (*words.last()?, words.get(3)?.parse().ok()?);
            (name != "total").then(|| (name.to_owned(), count))
        })
        .collect();
    rows.sort_by_key(|(_, calls)| std::cmp::Reverse(*calls));
    rows
}

/// Calls per frame, in all and by name where they are at least one in fifty frames.
pub fn per_frame(calls: &[(String, u64)], frames: u64) -> Value {
    let rate = |calls: u64| calls as f64 / frames as f64;
    let by_name: serde_json::Map<String, Value> = calls
        .iter()
        .filter(|(_, calls)| rate(*calls) >= 0.02)
        .map(|(name, calls)| (name.clone(), json!(rate(*calls))))
        .collect();
    json!({ "all": rate(calls.iter().map(|(_, calls)| calls).sum()), "by_name": by_name })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_of_strace_is_read() {
        let table = "% time     seconds  usecs/call     calls    errors syscall\n\
                     ------ ----------- ----------- --------- --------- ----------------\n \
                     60.00    0.000030           1        20           read\n \
                     40.00    0.000020           1        40        12 futex\n\
                     ------ ----------- ----------- --------- --------- ----------------\n\
                     100.00    0.000050           1        60        12 total\n";
        let calls = calls(table);
        assert_eq!(calls, [("futex".to_owned(), 40), ("read".to_owned(), 20)]);
        assert_eq!(per_frame(&calls, 20)["all"], 3.0);
        assert_eq!(per_frame(&calls, 20)["by_name"]["futex"], 2.0);
    }
}
