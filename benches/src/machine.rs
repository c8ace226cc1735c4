//! What was measured on, and processes as the system sees them.

use std::process::Child;
use std::time::Duration;

use anyhow::{Context, Result};
use serde_json::{Value, json};

/// Unit of times under /proc on every Linux that we build for (USER_HZ).
const TICKS_PER_SECOND: f64 = 100.0;

/// The result with the machine that it was measured on: cores, processor, load at the end.
pub fn stamp(mut result: Value) -> Value {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let cpuinfo = read("/proc/cpuinfo");
    let model = cpuinfo
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split(": ").nth(1))
        .unwrap_or("unknown")
        .to_owned();
    let load: Option<f64> = read("/proc/loadavg").split(' ').next().and_then(|w| w.parse().ok());
    if let Some(object) = result.as_object_mut() {
        object.insert(
            "machine".into(),
            json!({
                "processor": model,
                "cores": std::thread::available_parallelism().map_or(0, std::num::NonZero::get),
                "load_1min_at_end": load,
                "profile": if cfg!(debug_assertions) { "debug" } else { "release" },
            }),
        );
    }
    result
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
