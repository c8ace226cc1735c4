//! A long run: four simulated skins at full rate and a recorder of everything, watched from outside.
//!
//! Memory is what the system counts as resident, latency is from the stamp of acquisition to a subscriber in this
//! process, and a drop is a step in the sequence numbers: at the subscriber, or in the bag.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_figures::{Axes, COLOURS, Curve, Pen, column, curves};
use dermis_msgs::msg::ContactArray;
use dermis_node::{HirozBackend, History, Node, NodeOptions, Qos};
use dermis_transport::now_ns;
use serde_json::{Value, json};

use crate::machine::{self, Process};
use crate::node::percentile;
use crate::subscriber::isolated;

/// Share of the run that is warm-up: caches fill, buffers find their size.
const WARM_UP: f64 = 0.1;
/// Share of the run at either end of the rest that is compared.
const END: f64 = 0.2;
/// Most that memory may grow, as a share.
const MEMORY_BOUND: f64 = 0.05;
/// \[ms\] most that the median latency may grow.
const DRIFT_BOUND: f64 = 0.1;
/// Longest wait for all skins to speak.
const PATIENCE: Duration = Duration::from_secs(60);
const SKINS: usize = 4;

/// How long, and where.
#[derive(Debug, Args)]
pub struct Options {
    /// Length of the run.
    #[arg(long, default_value_t = 30.0)]
    minutes: f64,
    /// Program under test; beside this one where absent.
    #[arg(long)]
    dermis: Option<PathBuf>,
    /// Launch file of the four skins and the recorder.
    #[arg(long, default_value = "launch/four-skins.launch.yaml")]
    launch: PathBuf,
    /// File for the plot (SVG).
    #[arg(long)]
    plot: Option<PathBuf>,
    /// Folder of the bag, which is kept; a temporary one where absent.
    #[arg(long)]
    bag: Option<PathBuf>,
    /// Exit with 1 where memory grows, latency drifts or a message is lost.
    #[arg(long)]
    check: bool,
}

/// One second of the run.
struct Second {
    /// \[s\] since the start.
    t: f64,
    /// \[KiB\] resident, by process.
    memory: BTreeMap<String, u64>,
    /// \[ms\] latency at the subscriber: median, 99th percentile and maximum.
    latency: [f64; 3],
}

#[derive(Default)]
struct Listener {
    latencies: Vec<f64>,
    last: [Option<u64>; SKINS],
    received: [u64; SKINS],
    lost: [u64; SKINS],
}

impl Listener {
    fn take(&mut self, skin: usize, array: &ContactArray) {
        self.latencies.push((now_ns() - array.header.stamp.as_nanos()) as f64 * 1e-6);
        // While a skin says that it is blind, no frame stands behind its message.
        if array.status == ContactArray::STATUS_STALE {
            return;
        }
        if let Some(last) = self.last[skin] {
            self.lost[skin] += array.sequence.saturating_sub(last).saturating_sub(1);
        }
        self.last[skin] = Some(array.sequence);
        self.received[skin] += 1;
    }
}

/// Runs, and says what happened.
///
/// # Errors
///
/// Where a process ends early, or, with `--check`, a bound is missed.
pub fn run(options: &Options) -> Result<Value> {
    let scratch = tempfile::tempdir()?;
    let bag = options.bag.clone().unwrap_or_else(|| scratch.path().join("bag"));
    let dermis = match &options.dermis {
        Some(path) => path.clone(),
        None => std::env::current_exe()?
            .parent()
            .map(|p| p.join("dermis"))
            .context("this program has no folder")?,
    };
    let domain = 120 + (std::process::id() % 40) as u16;
    let listener = Arc::new(Mutex::new(Listener::default()));
    let mut node_options = NodeOptions::new("soak");
    node_options.domain_id = Some(domain);
    node_options = node_options.localhost_only(true);
    let node = Node::open(node_options, &HirozBackend::default())?;
    let qos = Qos { history: History::KeepLast(1000), ..Qos::sensor_data() };
    let mut subscriptions = Vec::new();
    for skin in 0..SKINS {
        let listener = Arc::clone(&listener);
        let topic = format!("/skin_{}/contacts", skin + 1);
        subscriptions.push(node.subscribe::<ContactArray>(&topic, qos, move |array, _| {
            listener.lock().unwrap_or_else(PoisonError::into_inner).take(skin, &array);
        })?);
    }

    let mut command = Command::new(&dermis);
    command.arg("launch").arg(&options.launch).arg(format!("out:={}", bag.display()));
    let launch = isolated(&mut command, domain).stdout(Stdio::null()).spawn();
    let mut launch = Process(launch.with_context(|| format!("{} cannot be started", dermis.display()))?);
    wait_for_skins(&mut launch, &listener)?;
    let seconds = watch(&mut launch, &listener, options.minutes)?;
    drop(subscriptions);
    let (received, lost) = {
        let listener = listener.lock().unwrap_or_else(PoisonError::into_inner);
        (listener.received, listener.lost)
    };
    machine::interrupt(&launch.0)?;
    let status = machine::wait(&mut launch.0, Duration::from_secs(60))?;
    if !status.success() {
        bail!("the launch ended with {status} when it was requested to stop");
    }
    let check = checked(&dermis, &bag)?;
    let summary = summary(&seconds, &received, &lost, &check);
    if let Some(path) = &options.plot {
        plot(path, &seconds)?;
    }
    let failures = failures(&summary);
    for failure in &failures {
        eprintln!("MISSED: {failure}");
    }
    if options.check && !failures.is_empty() {
        bail!("{} of the bounds of the long run are missed", failures.len());
    }
    Ok(summary)
}

/// Waits until every skin has spoken.
fn wait_for_skins(launch: &mut Process, listener: &Mutex<Listener>) -> Result<()> {
    let begun = Instant::now();
    while listener.lock().unwrap_or_else(PoisonError::into_inner).received.contains(&0) {
        if let Some(status) = launch.0.try_wait()? {
            bail!("the launch ended with {status} before all skins spoke");
        }
        if begun.elapsed() > PATIENCE {
            bail!("not all skins spoke within {} s", PATIENCE.as_secs());
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    Ok(())
}

/// Looks at memory and latencies once a second.
fn watch(launch: &mut Process, listener: &Mutex<Listener>, minutes: f64) -> Result<Vec<Second>> {
    let whole = minutes * 60.0;
    let begun = Instant::now();
    let mut seconds: Vec<Second> = Vec::new();
    while begun.elapsed().as_secs_f64() < whole {
        let next = Duration::from_secs(seconds.len() as u64 + 1);
        std::thread::sleep(next.saturating_sub(begun.elapsed()));
        if let Some(status) = launch.0.try_wait()? {
            bail!("the launch ended with {status} after {:.0} s", begun.elapsed().as_secs_f64());
        }
        let mut latencies =
            std::mem::take(&mut listener.lock().unwrap_or_else(PoisonError::into_inner).latencies);
        latencies.sort_by(f64::total_cmp);
        seconds.push(Second {
            t: begun.elapsed().as_secs_f64(),
            memory: machine::family_memory(launch.0.id()),
            latency: [50.0, 99.0, 100.0].map(|p| percentile(&latencies, p)),
        });
        if seconds.len().is_multiple_of(60) {
            eprintln!("{} of {minutes} min", seconds.len() / 60);
        }
    }
    Ok(seconds)
}

/// What `dermis bag check` says about the recording.
fn checked(dermis: &Path, bag: &Path) -> Result<Value> {
    let out = Command::new(dermis).args(["bag", "check", "--json"]).arg(bag).output()?;
    let mut said: Value = serde_json::from_slice(&out.stdout).with_context(|| {
        format!("`dermis bag check` gave no JSON: {}", String::from_utf8_lossy(&out.stderr).trim())
    })?;
    // A record says nothing of folders of the machine.
    if let Some(object) = said.as_object_mut() {
        object.remove("path");
    }
    Ok(said)
}

/// Both ends of the run after its warm-up.
fn ends(seconds: &[Second]) -> (&[Second], &[Second]) {
    let warm = (seconds.len() as f64 * WARM_UP) as usize;
    let width = ((seconds.len() as f64 * END) as usize).max(1);
    let first = &seconds[warm.min(seconds.len())..(warm + width).min(seconds.len())];
    (first, &seconds[seconds.len().saturating_sub(width)..])
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    percentile(&values, 50.0)
}

fn summary(seconds: &[Second], received: &[u64], lost: &[u64], check: &Value) -> Value {
    let (first, last) = ends(seconds);
    let names: Vec<&String> = seconds.last().map(|s| s.memory.keys().collect()).unwrap_or_default();
    let memory_of = |part: &[Second], name: &str| {
        median(part.iter().filter_map(|s| s.memory.get(name).map(|kib| *kib as f64)).collect())
    };
    let total_of =
        |part: &[Second]| median(part.iter().map(|s| s.memory.values().sum::<u64>() as f64).collect());
    let processes: BTreeMap<&str, Value> = names
        .iter()
        .map(|name| {
            let (a, b) = (memory_of(first, name), memory_of(last, name));
            (name.as_str(), json!({ "first_kib": a, "last_kib": b, "growth": b / a - 1.0 }))
        })
        .collect();
    let latency_of = |part: &[Second], i: usize| median(part.iter().map(|s| s.latency[i]).collect());
    let worst_p99 = seconds.iter().map(|s| s.latency[1]).fold(0.0, f64::max);
    json!({
        "minutes": seconds.len() as f64 / 60.0,
        "skins": SKINS,
        "received": received,
        "lost": lost.iter().sum::<u64>(),
        "bag": check,
        "memory": {
            "first_kib": total_of(first),
            "last_kib": total_of(last),
            "growth": total_of(last) / total_of(first) - 1.0,
            "processes": processes,
        },
        "latency_ms": {
            "first_p50": latency_of(first, 0),
            "last_p50": latency_of(last, 0),
            "drift": latency_of(last, 0) - latency_of(first, 0),
            "first_p99": latency_of(first, 1),
            "last_p99": latency_of(last, 1),
            "worst_second_p99": worst_p99,
        },
    })
}

/// A sentence for each bound that is missed.
fn failures(summary: &Value) -> Vec<String> {
    let mut found = Vec::new();
    let growth = summary["memory"]["growth"].as_f64().unwrap_or(f64::NAN);
    if growth.is_nan() || growth.abs() > MEMORY_BOUND {
        found.push(format!("memory changed by {:.1} %", growth * 100.0));
    }
    let lost = summary["lost"].as_u64().unwrap_or(u64::MAX);
    if lost != 0 {
        found.push(format!("{lost} messages did not reach the subscriber"));
    }
    let drift = summary["latency_ms"]["drift"].as_f64().unwrap_or(f64::NAN);
    if drift.is_nan() || drift > DRIFT_BOUND {
        found.push(format!("the median latency grew by {drift:.3} ms"));
    }
    if summary["bag"]["findings"] != json!([]) {
        found.push(format!("the bag is not whole: {}", summary["bag"]));
    }
    found
}

/// Memory and latency over the run, one below the other.
fn plot(path: &Path, seconds: &[Second]) -> Result<()> {
    let names: Vec<&String> = seconds.last().map(|s| s.memory.keys().collect()).unwrap_or_default();
    let minutes = |s: &Second| s.t / 60.0;
    let memory: Vec<Curve> = names
        .iter()
        .enumerate()
        .map(|(i, name)| {
            let points =
                seconds.iter().filter_map(|s| Some((minutes(s), *s.memory.get(*name)? as f64 / 1024.0)));
            // Colours come again after seven.
            let pen = if i < COLOURS.len() { Pen::Line } else { Pen::Dashed };
            Curve::new(name.as_str(), i, points.collect()).pen(pen)
        })
        .collect();
    let latency: Vec<Curve> = [(1, "99th percentile"), (0, "median")]
        .map(|(i, name)| Curve::new(name, i, seconds.iter().map(|s| (minutes(s), s.latency[i])).collect()))
        .into();
    let axes = |title: &str, y: &str, curves: &[Curve]| {
        let most = curves.iter().flat_map(|c| &c.points).map(|p| p.1).fold(0.1, f64::max);
        Axes { size: (900, 350), y_range: Some((0.0, most * 1.1)), ..Axes::new(title, "min", y) }
    };
    let pictures = [
        curves(&axes("Resident memory by process", "MiB", &memory), &memory)?,
        curves(&axes("Latency from acquisition to a subscriber, each second", "ms", &latency), &latency)?,
    ];
    std::fs::write(path, column(&pictures)).with_context(|| format!("{} cannot be written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(memory: impl Fn(usize) -> u64, latency: impl Fn(usize) -> f64) -> Vec<Second> {
        (0..100)
            .map(|i| Second {
                t: i as f64 + 1.0,
                memory: BTreeMap::from([("barodome 1".to_owned(), memory(i)), ("record".to_owned(), 1000)]),
                latency: [latency(i), latency(i) * 2.0, latency(i) * 3.0],
            })
            .collect()
    }

    #[test]
    fn growth_and_drift_are_found() {
        let good = json!({ "findings": [] });
        // What is used up while warming up is no growth.
        let flat = summary(&seconds(|i| if i < 5 { 500 } else { 1000 }, |_| 0.2), &[1; 4], &[0; 4], &good);
        assert_eq!(failures(&flat), Vec::<String>::new());
        let grown = summary(&seconds(|i| 1000 + 3 * i as u64, |_| 0.2), &[1; 4], &[0; 4], &good);
        assert_eq!(failures(&grown).len(), 1, "{grown}");
        let drifted = summary(&seconds(|_| 1000, |i| 0.2 + i as f64 * 0.01), &[1; 4], &[0, 2, 0, 0], &good);
        assert_eq!(failures(&drifted).len(), 2, "{drifted}");
        let broken = summary(
            &seconds(|_| 1000, |_| 0.2),
            &[1; 4],
            &[0; 4],
            &json!({ "findings": ["a chunk is damaged"] }),
        );
        assert_eq!(failures(&broken).len(), 1);
    }

    #[test]
    fn steps_of_the_sequence_are_losses() {
        let mut listener = Listener::default();
        for sequence in [7, 8, 11, 12] {
            listener.take(2, &ContactArray { sequence, ..ContactArray::default() });
        }
        listener.take(
            2,
            &ContactArray { status: ContactArray::STATUS_STALE, sequence: 90, ..ContactArray::default() },
        );
        assert_eq!((listener.lost[2], listener.received[2], listener.latencies.len()), (2, 4, 5));
    }

    #[test]
    fn the_plot_is_an_svg() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("soak.svg");
        plot(&path, &seconds(|_| 1000, |_| 0.2)).unwrap();
        let text = std::fs::read_to_string(path).unwrap();
        assert!(text.contains("<svg") && text.contains("barodome 1") && text.contains("99th percentile"));
    }
}
