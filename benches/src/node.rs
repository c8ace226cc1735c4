//! The straight way, measured: bytes on a line → message at a subscriber in another process.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_msgs::msg::ContactArray;
use dermis_skin::SkinDescription;
use serde_json::{Value, json};

use crate::chain::Chain;
use crate::counts::{Trace, per_frame, switches};
use crate::device::Device;
use crate::machine::{Process, cpu_time};
use crate::programs::{HIROZ, Programs, R2R, named};
use crate::subscriber::{Arrival, Choice, domain_of, spawn, start, start_datagrams};

/// The pad.
pub const SKIN: &str = "launch/skins/baro-grid.toml";
/// Frames under way at most while the rate is measured: as many as a line of 4 KiB holds, several times over.
const WINDOW: u64 = 256;
/// Longest wait for a node to report its first calibrated frame.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// How long system calls are counted.
const TRACED: Duration = Duration::from_secs(3);

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    programs: Programs,
    /// Python with rclpy, our messages and ONNX Runtime; leaves the peer out where absent.
    #[arg(long)]
    ros_python: Option<PathBuf>,
    /// Folder of Python packages that the peer needs beside those of ROS: ONNX Runtime.
    #[arg(long)]
    peer_packages: Option<PathBuf>,
    /// \[s\] of each phase.
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
    /// \[Hz\] at which latency is measured.
    #[arg(long, default_value_t = 1000.0)]
    rate: f64,
    /// ONNX Runtime's library for our node, too; its embedded runtime where absent.
    #[arg(long)]
    onnxruntime: Option<PathBuf>,
}

/// One node under measurement.
struct Candidate {
    name: &'static str,
    /// Of the node and of its subscriber.
    backend: Choice,
    /// The subscriber is of the same program for all that share a backend.
    kind: Kind,
}

enum Kind {
    Ours {
        programs: PathBuf,
        onnxruntime: Option<PathBuf>,
    },
    Peer {
        python: PathBuf,
    },
    /// Its subscriber has no ROS 2, either.
    Chain(Chain),
}

/// Names of rows.
const NATIVE: &str = "dermis, hiroz, ONNX Runtime";
const PEER: &str = "rclpy + onnxruntime";
const CHAIN: &str = "chain in C";

/// Runs all that this machine has, and prints the table.
///
/// # Errors
///
/// Where a node does not come up or loses frames that it must not lose.
pub fn run(options: &Options) -> Result<Value> {
    let root = &options.programs.root;
    let bundle = learned_only(root)?;
    // The peer's library serves us, too, so that the runtimes can be distinguished from the rest.
    let library = options.onnxruntime.clone().or_else(|| library_in(options.peer_packages.as_deref()?));
    let mut candidates = Vec::new();
    for (name, backend, programs) in options.programs.rows() {
        let ours = |onnxruntime: Option<PathBuf>| Kind::Ours { programs: programs.to_owned(), onnxruntime };
        candidates.push(Candidate { name, backend, kind: ours(None) });
        if name == HIROZ && library.is_some() {
            candidates.push(Candidate { name: NATIVE, backend, kind: ours(library.clone()) });
        }
    }
    if let Some(python) = &options.ros_python {
        let kind = Kind::Peer { python: python.clone() };
        candidates.push(Candidate { name: PEER, backend: Choice::Ros2, kind });
    }
    let skin = SkinDescription::load(root.join(SKIN))?;
    let kind = Kind::Chain(Chain::build(root, &skin, bundle.path())?);
    candidates.push(Candidate { name: CHAIN, backend: Choice::Hiroz, kind });
    let mut rows = Vec::new();
    for (i, candidate) in candidates.iter().enumerate() {
        eprintln!("measuring {}", candidate.name);
        let row = measure(options, candidate, bundle.path(), domain_of(i))
            .with_context(|| candidate.name.to_owned())?;
        rows.push(row);
    }
    let (peer, chain) = (named(&rows, PEER), named(&rows, CHAIN));
    for row in &mut rows {
        // CPU time flat out, and at a rate: there each has costs that do not grow with frames.
        for (key, pointer) in [("ratio", "/cpu_us_per_frame"), ("ratio_at_rate", "/latency/cores")] {
            let over = |row: &Value, of: &Value| {
                Some(of.pointer(pointer)?.as_f64()? / row.pointer(pointer)?.as_f64()?)
            };
            row[key] = json!(over(row, &peer));
            row[format!("{key}_to_chain")] = json!(over(row, &chain).map(f64::recip));
        }
    }
    table(&rows, options);
    Ok(json!({
        "rate_hz": options.rate,
        "seconds": options.seconds,
        "hiroz": named(&rows, HIROZ),
        "hiroz_native": named(&rows, NATIVE),
        "r2r": named(&rows, R2R),
        "peer": named(&rows, PEER),
        "chain": named(&rows, CHAIN),
        "rows": rows,
    }))
}

/// ONNX Runtime's library in a folder of Python packages.
fn library_in(packages: &Path) -> Option<PathBuf> {
    std::fs::read_dir(packages.join("onnxruntime/capi")).ok()?.flatten().map(|entry| entry.path()).find(
        |path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("libonnxruntime.so")),
    )
}

/// The bundle that ships without its refinement on the forward model: both sides evaluate the same network.
pub fn learned_only(root: &Path) -> Result<tempfile::TempDir> {
    let (from, to) = (root.join("models/baro-grid"), tempfile::tempdir()?);
    for file in ["model.onnx", "card.json"] {
        std::fs::copy(from.join(file), to.path().join(file))?;
    }
    let manifest = std::fs::read_to_string(from.join("bundle.toml"))?;
    let mut inside = false;
    let kept = manifest.lines().filter(|line| {
        inside = if line.starts_with('[') { *line == "[inversion]" } else { inside };
        !inside
    });
    std::fs::write(to.path().join("bundle.toml"), kept.collect::<Vec<_>>().join("\n") + "\n")?;
    Ok(to)
}

/// Our node of the pad that a device stands for.
pub fn skin_node(
    programs: &Path,
    backend: Choice,
    (skin, model): (&Path, &Path),
    device: &Device,
) -> Command {
    let mut command = Command::new(programs.join("dermis"));
    command.arg("barodome").arg("--skin").arg(skin).arg("--model").arg(model);
    command.arg("--source").arg(format!("serial://{}", device.path()));
    command.args(["--backend", backend.name(), "--strict"]).env("DERMIS_LOG", "error");
    command
}

fn command(options: &Options, candidate: &Candidate, model: &Path, device: &Device) -> Command {
    let skin = options.programs.root.join(SKIN);
    match &candidate.kind {
        Kind::Ours { programs, onnxruntime } => {
            let mut c = skin_node(programs, candidate.backend, (&skin, model), device);
            c.env_remove("VIRTUAL_ENV");
            match onnxruntime {
                Some(library) => c.env("ORT_DYLIB_PATH", library),
                None => c.env_remove("ORT_DYLIB_PATH"),
            };
            c
        }
        Kind::Peer { python } => {
            let mut c = Command::new(python);
            c.arg(options.programs.root.join("benches/python/rclpy_node.py"));
            c.arg(skin).arg(model).arg(device.path());
            if let Some(packages) = &options.peer_packages {
                c.env("PYTHONPATH", packages);
            }
            c
        }
        Kind::Chain(chain) => chain.command(&device.path()),
    }
}

fn measure(options: &Options, candidate: &Candidate, model: &Path, domain: u16) -> Result<Value> {
    let skin = SkinDescription::load(options.programs.root.join(SKIN))?;
    let mut device = Device::new(&skin, 1)?;
    let (subscriber, arrivals) = match &candidate.kind {
        Kind::Chain(chain) => start_datagrams(&chain.socket())?,
        _ => start(candidate.backend, domain)?,
    };
    let node = spawn(&mut command(options, candidate, model, &device), domain)?;

    // The zero is taken from untouched frames.
    let begun = Instant::now();
    let mut pace = Pace::new(200.0);
    loop {
        device.send(false)?;
        pace.wait();
        if arrivals.try_iter().any(|a| a.status == ContactArray::STATUS_OK) {
            break;
        }
        if begun.elapsed() > PATIENCE {
            bail!("no calibrated frame came within {} s", PATIENCE.as_secs());
        }
    }

    let latency = latency(options, &mut device, &arrivals, &node)?;
    let calls = calls(options, &mut device, &arrivals, &node)?;
    let mut row = rate(options, &mut device, &arrivals, &node)?;
    row["name"] = json!(candidate.name);
    row["latency"] = latency;
    row["calls_per_frame"] = calls;
    drop(node);
    drop(subscriber);
    Ok(row)
}

/// At a fixed rate: from the last byte to the subscriber.
fn latency(
    options: &Options,
    device: &mut Device,
    arrivals: &Receiver<Arrival>,
    node: &Process,
) -> Result<Value> {
    let mut pace = Pace::new(options.rate);
    // Until touch and rate have settled.
    let settled = Instant::now() + Duration::from_secs(2);
    while Instant::now() < settled {
        device.send(true)?;
        pace.wait();
    }
    let first = device.sent.len() as u64;
    let before = switches(&node.0)?;
    let (cpu, begun) = (cpu_time(&node.0)?, Instant::now());
    let end = begun + Duration::from_secs_f64(options.seconds);
    let mut seen = Vec::new();
    while Instant::now() < end {
        device.send(true)?;
        pace.wait();
        seen.extend(arrivals.try_iter());
    }
    let used = (cpu_time(&node.0)? - cpu).as_secs_f64() / begun.elapsed().as_secs_f64();
    let after = switches(&node.0)?;
    let last = device.sent.len() as u64;
    let per_frame = |before: u64, after: u64| after.saturating_sub(before) as f64 / (last - first) as f64;
    // The last ones are still on their way.
    let deadline = Instant::now() + Duration::from_secs(5);
    while !seen.iter().any(|a: &Arrival| a.sequence + 1 >= last) && Instant::now() < deadline {
        match arrivals.recv_timeout(Duration::from_millis(50)) {
            Ok(arrival) => seen.push(arrival),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => bail!("the subscriber ended"),
        }
    }
    let counted: Vec<&Arrival> = seen.iter().filter(|a| (first..last).contains(&a.sequence)).collect();
    let without = counted.iter().filter(|a| a.contacts == 0).count();
    if without * 100 > counted.len() {
        bail!("{without} of {} messages hold no contact although the pad is pressed", counted.len());
    }
    let mut ms: Vec<f64> = counted
        .iter()
        .filter_map(|a| Some((a.received_ns - device.sent.get(a.sequence as usize)?) as f64 * 1e-6))
        .collect();
    ms.sort_by(f64::total_cmp);
    Ok(json!({
        "p50_ms": percentile(&ms, 50.0),
        "p99_ms": percentile(&ms, 99.0),
        "p999_ms": percentile(&ms, 99.9),
        "max_ms": percentile(&ms, 100.0),
        "frames": last - first,
        "lost": (last - first).saturating_sub(counted.len() as u64),
        "cores": used,
        "switches_per_frame": {
            "voluntary": per_frame(before.voluntary, after.voluntary),
            "forced": per_frame(before.forced, after.forced),
            "all": per_frame(before.voluntary + before.forced, after.voluntary + after.forced),
        },
    }))
}

/// System calls per frame at the rate, by strace in a phase of its own: it slows what it watches. Null where there is none.
fn calls(
    options: &Options,
    device: &mut Device,
    arrivals: &Receiver<Arrival>,
    node: &Process,
) -> Result<Value> {
    let Some(trace) = Trace::begin(&node.0)? else {
        eprintln!("system calls are not counted: apt-get install strace");
        return Ok(Value::Null);
    };
    let (mut pace, first) = (Pace::new(options.rate), device.sent.len());
    let end = Instant::now() + TRACED;
    while Instant::now() < end {
        device.send(true)?;
        pace.wait();
        arrivals.try_iter().for_each(drop);
    }
    let frames = device.sent.len() - first;
    Ok(per_frame(&trace.end()?, frames as u64))
}

/// As fast as the node takes them: frames per second of CPU time of the node.
fn rate(
    options: &Options,
    device: &mut Device,
    arrivals: &Receiver<Arrival>,
    node: &Process,
) -> Result<Value> {
    let mut acknowledged = device.sent.len() as u64;
    let mut arrived = 0_u64;
    let mut counted = None;
    let begun = Instant::now();
    let warm = Duration::from_secs(1);
    let whole = warm + Duration::from_secs_f64(options.seconds);
    while begun.elapsed() < whole {
        if counted.is_none() && begun.elapsed() >= warm {
            counted = Some((cpu_time(&node.0)?, Instant::now(), arrived, device.sent.len()));
        }
        if (device.sent.len() as u64) < acknowledged + WINDOW {
            device.send(true)?;
            for arrival in arrivals.try_iter() {
                arrived += 1;
                acknowledged = acknowledged.max(arrival.sequence + 1);
            }
            continue;
        }
        match arrivals.recv_timeout(Duration::from_millis(200)) {
            Ok(arrival) => {
                arrived += 1;
                acknowledged = acknowledged.max(arrival.sequence + 1);
            }
            // What was lost at the end of a window is never acknowledged.
            Err(RecvTimeoutError::Timeout) => acknowledged = device.sent.len() as u64,
            Err(RecvTimeoutError::Disconnected) => bail!("the subscriber ended"),
        }
    }
    let Some((cpu, since, before, sent)) = counted else { bail!("the measurement was too short") };
    let used = (cpu_time(&node.0)? - cpu).as_secs_f64();
    let frames = arrived - before;
    Ok(json!({
        "frames_per_second": frames as f64 / since.elapsed().as_secs_f64(),
        "frames_per_second_and_core": frames as f64 / used,
        "cpu_us_per_frame": used / frames as f64 * 1e6,
        "sent": device.sent.len() - sent,
        "arrived": frames,
    }))
}

/// Nearest-rank percentile of sorted numbers; NaN where there are none.
pub fn percentile(sorted: &[f64], p: f64) -> f64 {
    let rank = (p / 100.0 * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.clamp(1, sorted.len().max(1)) - 1).copied().unwrap_or(f64::NAN)
}

/// Waits so that calls come at a rate, without drift.
pub struct Pace {
    next: Instant,
    period: Duration,
}

impl Pace {
    /// \[Hz\]
    pub fn new(rate: f64) -> Self {
        Self { next: Instant::now(), period: Duration::from_secs_f64(1.0 / rate) }
    }

    /// Until the next is due.
    pub fn wait(&mut self) {
        self.next += self.period;
        let now = Instant::now();
        match self.next.checked_duration_since(now) {
            Some(left) => std::thread::sleep(left),
            // What was missed is not made up for by a burst.
            None => self.next = now,
        }
    }
}

/// A number for a table; a dash where there is none.
pub fn number(value: &Value, digits: usize) -> String {
    value.as_f64().map_or("-".into(), |x| format!("{x:.digits$}"))
}

fn table(rows: &[Value], options: &Options) {
    let columns = |cells: [String; 13]| {
        let [name, cells @ ..] = cells;
        let cells: String = cells.iter().map(|cell| format!(" {cell:>9}")).collect();
        eprintln!("{name:<28}{cells}");
    };
    eprintln!();
    let heads = [
        "node", "frames/s", "CPU us", "to rclpy", "at rate", "to C", "at rate", "p50 ms", "p99 ms", "lost",
        "cores", "switches", "calls",
    ];
    columns(heads.map(str::to_owned));
    for row in rows {
        let l = &row["latency"];
        columns([
            row["name"].as_str().unwrap_or("").to_owned(),
            number(&row["frames_per_second_and_core"], 0),
            number(&row["cpu_us_per_frame"], 1),
            number(&row["ratio"], 1),
            number(&row["ratio_at_rate"], 1),
            number(&row["ratio_to_chain"], 1),
            number(&row["ratio_at_rate_to_chain"], 1),
            number(&l["p50_ms"], 3),
            number(&l["p99_ms"], 3),
            number(&l["lost"], 0),
            number(&l["cores"], 3),
            number(&l["switches_per_frame"]["all"], 1),
            number(&row["calls_per_frame"]["all"], 1),
        ]);
    }
    eprintln!(
        "\nFrames/s are those of a core, and CPU time flat out; `to` compares CPU time, flat out and at {0} Hz. Latency at {0} Hz, from \
         the last byte of a frame to the decoded message at a subscriber in another process; switches and system calls per frame at \
         that rate.",
        options.rate
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let numbers: Vec<f64> = (1..=100).map(f64::from).collect();
        assert_eq!(percentile(&numbers, 50.0), 50.0);
        assert_eq!(percentile(&numbers, 99.0), 99.0);
        assert_eq!(percentile(&numbers, 100.0), 100.0);
        assert!(percentile(&[], 50.0).is_nan());
    }
}
