//! How fast a robot is stopped: from the last byte of the first pressed frame to the stop message at a process of its own.
//!
//! Device (in this process) → node of the skin → reflexes → subscriber (in a process of its own). A trial is a pause without touch,
//! then pressed frames at the device's rate until the stop has come. The skin's node is ours in every row, over the backend of
//! the row; what follows it is our reflexes, or a subscriber in rclpy that compares forces and publishes, and does nothing else.
//! So the delay of a trial is that of the whole way. Each row is measured on the machine as it is, and beside as many busy threads
//! as it has cores.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_skin::SkinDescription;
use serde_json::{Value, json};

use crate::device::Device;
use crate::machine::{Process, cpu_time};
use crate::node::{PATIENCE, Pace, SKIN, learned_only, number, percentile, skin_node};
use crate::programs::{HIROZ, Programs, R2R, RCLPY, named};
use crate::subscriber::{Arrival, Choice, domain_of, spawn, start_stops};

/// Frames without touch between two trials, at least.
const PAUSE: usize = 80;
/// Pressed frames after which a stop that has not come counts as missed.
const LONGEST: usize = 500;
/// \[N\] of the rule; the device presses with 0.8 N.
const LIMIT: f64 = 0.3;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    programs: Programs,
    /// Python with rclpy and our messages; leaves rclpy out where absent.
    #[arg(long)]
    ros_python: Option<PathBuf>,
    /// Trials of each row.
    #[arg(long, default_value_t = 500)]
    trials: usize,
    /// \[Hz\] of the device.
    #[arg(long, default_value_t = 1000.0)]
    rate: f64,
}

/// What stops the robot.
enum Stopper {
    Ours,
    Rclpy(PathBuf),
}

struct Row {
    name: &'static str,
    backend: Choice,
    programs: PathBuf,
    stopper: Stopper,
}

/// Runs all that this machine has, and prints the table.
///
/// # Errors
///
/// Where a process does not come up.
pub fn run(options: &Options) -> Result<Value> {
    let mut rows: Vec<Row> = Vec::new();
    for (name, backend, programs) in options.programs.rows() {
        let row = |name, stopper| Row { name, backend, programs: programs.to_owned(), stopper };
        rows.push(row(name, Stopper::Ours));
        if let (R2R, Some(python)) = (name, &options.ros_python) {
            rows.push(row(RCLPY, Stopper::Rclpy(python.clone())));
        }
    }
    let bundle = learned_only(&options.programs.root)?;
    let mut measured = Vec::new();
    for (i, row) in rows.iter().enumerate() {
        eprintln!("measuring {}", row.name);
        let found = measure(options, row, bundle.path(), domain_of(i));
        measured.push(found.with_context(|| row.name.to_owned())?);
    }
    table(&measured, options);
    Ok(json!({
        "rate_hz": options.rate, "trials": options.trials, "limit_n": LIMIT,
        "rclpy_over_dermis": {
            "hiroz": over(&named(&measured, RCLPY), &named(&measured, HIROZ)),
            "r2r": over(&named(&measured, RCLPY), &named(&measured, R2R)),
        },
        "rows": measured,
    }))
}

/// How many times as long the peer's stops take as ours: above 1 where ours are faster; null where one of them was not measured.
fn over(peer: &Value, ours: &Value) -> Value {
    let ratio = |machine: &str, figure: &str| {
        let of = |row: &Value| row[machine][figure].as_f64();
        Some(of(peer)? / of(ours)?)
    };
    let of = |machine| json!({ "p50": ratio(machine, "p50_ms"), "p99": ratio(machine, "p99_ms") });
    json!({ "quiet": of("quiet"), "loaded": of("loaded") })
}

fn rules(options: &Options, folder: &Path) -> Result<PathBuf> {
    // Ends between two trials; a skin that is not tared yet does not matter here.
    let quiet = 0.02_f64.max(10.0 / options.rate);
    let text = format!(
        "schema = \"dermis-reflex/1\"\nname = \"bench\"\nstart = \"clear\"\n\
         [inputs.skin]\nkind = \"skin\"\ntopic = \"contacts\"\ntimeout = 1.0\n\
         [actions.stop]\nkind = \"bool\"\ntopic = \"stop\"\n\
         [[rules]]\nname = \"touch\"\nforce = {{ above = {LIMIT} }}\nlatch = false\nquiet = {quiet}\n\
         counts_as_touched = []\nactions = [\"stop\"]\n"
    );
    let path = folder.join("rules.toml");
    std::fs::write(&path, text)?;
    Ok(path)
}

fn measure(options: &Options, row: &Row, model: &Path, domain: u16) -> Result<Value> {
    let file = options.programs.root.join(SKIN);
    let mut device = Device::new(&SkinDescription::load(&file)?, 1)?;
    let folder = tempfile::tempdir()?;
    let (_subscriber, stops) = start_stops(row.backend, domain)?;
    let _skin = spawn(&mut skin_node(&row.programs, row.backend, (&file, model), &device), domain)?;
    let mut stopper = match &row.stopper {
        Stopper::Ours => {
            let mut command = Command::new(row.programs.join("dermis"));
            command.arg("reflex").arg(rules(options, folder.path())?);
            command.args(["--backend", row.backend.name()]).env("DERMIS_LOG", "error");
            command
        }
        Stopper::Rclpy(python) => {
            let mut command = Command::new(python);
            command.arg(options.programs.root.join("benches/python/rclpy_stop.py")).arg(LIMIT.to_string());
            command
        }
    };
    let stopper = spawn(&mut stopper, domain)?;
    warm_up(options, &mut device, &stops)?;

    let quiet = trials(options, &mut device, &stops, &stopper)?;
    let busy = Busy::start();
    let loaded = trials(options, &mut device, &stops, &stopper)?;
    drop(busy);
    Ok(json!({ "name": row.name, "quiet": quiet, "loaded": loaded }))
}

/// Until a press stops: the zero is taken, and everybody has found everybody.
fn warm_up(options: &Options, device: &mut Device, stops: &Receiver<Arrival>) -> Result<()> {
    let begun = Instant::now();
    let mut pace = Pace::new(options.rate);
    loop {
        // Long enough for a tare.
        for _ in 0..600 {
            device.send(false)?;
            pace.wait();
        }
        stops.try_iter().count();
        if stops.try_recv() == Err(TryRecvError::Disconnected) {
            bail!("the subscriber ended");
        }
        for _ in 0..LONGEST {
            device.send(true)?;
            pace.wait();
        }
        if stops.try_iter().any(|stop| stop.status == 1) {
            return Ok(());
        }
        if begun.elapsed() > PATIENCE {
            bail!("no press was answered by a stop within {} s", PATIENCE.as_secs());
        }
    }
}

fn trials(
    options: &Options,
    device: &mut Device,
    stops: &Receiver<Arrival>,
    stopper: &Process,
) -> Result<Value> {
    let mut pace = Pace::new(options.rate);
    let (cpu, begun) = (cpu_time(&stopper.0)?, Instant::now());
    let (mut ms, mut frames, mut missed) = (Vec::new(), Vec::new(), 0_u64);
    for _ in 0..options.trials {
        // What comes after the end of the trial before is an answer to this one.
        let (mut paused, mut ended) = (0, false);
        while (paused < PAUSE || !ended) && paused < LONGEST {
            device.send(false)?;
            pace.wait();
            paused += 1;
            ended = stops.try_iter().fold(ended, |_, stop| stop.status == 0);
        }
        let first = device.sent.len();
        let mut stopped = None;
        while stopped.is_none() && device.sent.len() < first + LONGEST {
            device.send(true)?;
            pace.wait();
            stopped = stops.try_iter().find(|stop| stop.status == 1 && stop.received_ns > device.sent[first]);
        }
        match stopped {
            Some(stop) => {
                ms.push((stop.received_ns - device.sent[first]) as f64 * 1e-6);
                let before = device.sent[first..].iter().filter(|sent| **sent < stop.received_ns).count();
                frames.push(before as f64);
            }
            None => missed += 1,
        }
    }
    let used = (cpu_time(&stopper.0)? - cpu).as_secs_f64() / begun.elapsed().as_secs_f64();
    ms.sort_by(f64::total_cmp);
    frames.sort_by(f64::total_cmp);
    Ok(json!({
        "p50_ms": percentile(&ms, 50.0),
        "p99_ms": percentile(&ms, 99.0),
        "max_ms": percentile(&ms, 100.0),
        "p50_frames": percentile(&frames, 50.0),
        "p99_frames": percentile(&frames, 99.0),
        "missed": missed,
        "cores": used,
    }))
}

/// Threads that compute, as many as there are cores, until they are dropped.
struct Busy(Arc<AtomicBool>);

impl Busy {
    fn start() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        for _ in 0..std::thread::available_parallelism().map_or(1, std::num::NonZero::get) {
            let stop = Arc::clone(&stop);
            std::thread::spawn(move || {
                let mut x = 1_u64;
                while !stop.load(Ordering::Relaxed) {
                    x = std::hint::black_box(x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
                }
            });
        }
        std::thread::sleep(Duration::from_millis(100));
        Self(stop)
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn table(rows: &[Value], options: &Options) {
    eprintln!(
        "\n{:<22} {:>8} {:>9} {:>9} {:>9} {:>11} {:>7} {:>7}",
        "reflexes", "machine", "p50 ms", "p99 ms", "max ms", "p50 frames", "missed", "cores"
    );
    for row in rows {
        for machine in ["quiet", "loaded"] {
            let of = &row[machine];
            eprintln!(
                "{:<22} {machine:>8} {:>9} {:>9} {:>9} {:>11} {:>7} {:>7}",
                row["name"].as_str().unwrap_or(""),
                number(&of["p50_ms"], 3),
                number(&of["p99_ms"], 3),
                number(&of["max_ms"], 3),
                number(&of["p50_frames"], 0),
                number(&of["missed"], 0),
                number(&of["cores"], 3),
            );
        }
    }
    eprintln!(
        "\n{} presses a row at {} Hz, from the last byte of the first pressed frame to the stop at another process.",
        options.trials, options.rate
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_that_takes_longer_is_above_one() {
        let row =
            |p50: f64| json!({ "quiet": { "p50_ms": p50, "p99_ms": 2.0 }, "loaded": { "p50_ms": 4.0 } });
        let expected = json!({ "quiet": { "p50": 3.0, "p99": 1.0 }, "loaded": { "p50": 1.0, "p99": null } });
        assert_eq!(over(&row(1.5), &row(0.5)), expected);
        assert_eq!(over(&Value::Null, &row(0.5))["quiet"]["p50"], Value::Null);
    }
}
