//! What was measured on, and processes as the system sees them.

use std::collections::BTreeMap;
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

/// Unit of times under /proc on every Linux that we build for (USER_HZ).
const TICKS_PER_SECOND: f64 = 100.0;

/// The result with the machine that it was measured on: cores, processor, load at the end.
pub fn stamp(mut result: Value) -> Value {
    let dermis_io::Machine { processor, cores, load } = dermis_io::machine();
    if let Some(object) = result.as_object_mut() {
        object.insert(
            "machine".into(),
            json!({
                "processor": processor,
                "cores": cores,
                "load_1min_at_end": load,
                "profile": if cfg!(debug_assertions) { "debug" } else { "release" },
            }),
        );
    }
    result
}

/// A child that does not outlive the measurement.
#[derive(Debug)]
pub struct Process(pub Child);

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// CPU time that a process has used in all its threads.
///
/// # Errors
///
/// Where the process is gone.
pub fn cpu_time(child: &Child) -> Result<Duration> {
    let path = format!("/proc/{}/stat", child.id());
    let text = std::fs::read_to_string(&path).with_context(|| format!("{path}: the process is gone"))?;
    // The name in the second field may hold spaces; it ends at the last parenthesis.
    let fields: Vec<&str> = text.rsplit_once(')').map_or("", |(_, rest)| rest).split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<u64>().ok()).unwrap_or(0);
    Ok(Duration::from_secs_f64((ticks(11) + ticks(12)) as f64 / TICKS_PER_SECOND))
}

/// \[KiB\] resident memory of a process and of everything that it started, by what it does.
pub fn family_memory(ancestor: u32) -> BTreeMap<String, u64> {
    let mut parents = BTreeMap::new();
    for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(pid) = entry.file_name().to_str().and_then(|n| n.parse::<u32>().ok()) else { continue };
        let status = std::fs::read_to_string(entry.path().join("status")).unwrap_or_default();
        let field = |name: &str| {
            let value = status.lines().find_map(|line| line.strip_prefix(name))?;
            value.split_whitespace().next()?.parse::<u64>().ok()
        };
        if let Some((parent, resident)) = field("PPid:").zip(field("VmRSS:")) {
            parents.insert(pid, (parent as u32, resident));
        }
    }
    let of_family = |pid: u32| {
        let mut at = pid;
        while at != ancestor {
            match parents.get(&at) {
                Some((parent, _)) if *parent > 1 => at = *parent,
                _ => return false,
            }
        }
        true
    };
    let mut memory = BTreeMap::new();
    // In the order of their start, so that a process keeps its name.
    for (pid, (_, resident)) in &parents {
        if of_family(*pid) {
            let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let what = line.split(|b| *b == 0).nth(1).map(String::from_utf8_lossy).unwrap_or_default();
            let name = (1..).map(|i| format!("{what} {i}")).find(|name| !memory.contains_key(name));
            memory.insert(name.unwrap_or_default(), *resident);
        }
    }
    memory
}

/// Asks a process to end, as Ctrl-C does.
///
/// # Errors
///
/// Where it is gone.
pub fn interrupt(child: &Child) -> Result<()> {
    let pid = nix::unistd::Pid::from_raw(i32::try_from(child.id())?);
    nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGINT).context("the process is gone")
}

/// Waits for the end of a process.
///
/// # Errors
///
/// Where it does not end in time.
pub fn wait(child: &mut Child, patience: Duration) -> Result<ExitStatus> {
    let begun = Instant::now();
    while begun.elapsed() < patience {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    bail!("the process did not end within {} s", patience.as_secs())
}
