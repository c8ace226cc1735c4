//! What a body costs: eight skins at 1 kHz, a node for each, the fusion, and a subscriber: processes of their own, and twice more with
//! nodes and fusion in one process; and once with a fusion in rclpy and numpy in place of ours.
//!
//! Device (in this process) → node of the skin → fusion → subscriber. The delay of a frame is from its last byte to the first message of
//! the body that says of its skin that this was its latest frame: until the fusion publishes it (inside, where the publisher stamps its
//! messages), and until the subscriber has decoded it. The fusion answers so many times a second at most, and a frame that a later one
//! of its skin overtakes on the way stands in no message: such frames are counted.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use dermis_skin::SkinDescription;
use dermis_transport::now_ns;
use serde_json::{Value, json};

use crate::device::Device;
use crate::fusion::write_robot;
use crate::machine::{Process, cpu_time};
use crate::node::{PATIENCE, Pace, SKIN, learned_only, number, percentile, skin_node};
use crate::programs::{HIROZ, Programs, R2R, RCLPY, named};
use crate::subscriber::{Arrival, Choice, domain_of, spawn, start_body};

/// Skins of the robot, each on a link of its own.
const SKINS: usize = 8;
/// Until every zero is taken and touch has settled.
const SETTLING: Duration = Duration::from_secs(3);
/// \[ns\] How much earlier than its last byte a frame may be stamped: clocks are mapped by the fastest frames.
const EARLY: i64 = 300_000;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    programs: Programs,
    /// Python with rclpy and our messages; leaves the fusion in rclpy and numpy out where absent.
    #[arg(long)]
    ros_python: Option<PathBuf>,
    /// Folder of Python packages that it needs beside those of ROS: scipy.
    #[arg(long)]
    peer_packages: Option<PathBuf>,
    /// \[s\] of each row.
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
    /// \[Hz\] of each device.
    #[arg(long, default_value_t = 1000.0)]
    rate: f64,
}

/// How the nodes are started.
#[derive(Debug, Clone, Copy)]
enum Layout<'a> {
    /// Each in a process of its own.
    Apart,
    /// Each in a process of its own, the fusion in this Python with rclpy.
    Rclpy(&'a Path),
    /// All in one, where the fusion answers so many times a second at most \[Hz\].
    Together(&'static str),
}

/// Names of the rows where all nodes share a process: as the fusion is by default, and answering twice as often.
const TOGETHER: &str = "one process";
const TOGETHER_FAST: &str = "one process, 2 kHz";

/// Runs it over each backend that this machine has, once with the fusion in rclpy, and twice in one process, and prints the table.
///
/// # Errors
///
/// Where a process does not come up.
pub fn run(options: &Options) -> Result<Value> {
    let bundle = learned_only(&options.programs.root)?;
    let mut measured = Vec::new();
    let apart =
        options.programs.rows().map(|(name, backend, programs)| (name, backend, programs, Layout::Apart));
    let together = [(TOGETHER, "1000"), (TOGETHER_FAST, "2000")].map(|(name, rate)| {
        (name, Choice::Hiroz, options.programs.programs.as_path(), Layout::Together(rate))
    });
    let peer = options.programs.ros_programs.as_deref().zip(options.ros_python.as_deref());
    let peer = peer.map(|(programs, python)| (RCLPY, Choice::Ros2, programs, Layout::Rclpy(python)));
    for (i, (name, backend, programs, layout)) in apart.chain(peer).chain(together).enumerate() {
        eprintln!("measuring {name}");
        let mut row = measure(options, (backend, programs, layout), bundle.path(), domain_of(i))
            .with_context(|| name.to_owned())?;
        row["name"] = json!(name);
        measured.push(row);
    }
    eprintln!(
        "\n{:<19} {:>13} {:>13} {:>8} {:>8} {:>8} {:>10} {:>12} {:>13} {:>10}",
        "",
        "inside p50 ms",
        "inside p99 ms",
        "p50 ms",
        "p99 ms",
        "max ms",
        "overtaken",
        "nodes, cores",
        "fusion, cores",
        "all, cores"
    );
    for row in &measured {
        eprintln!(
            "{:<19} {:>13} {:>13} {:>8} {:>8} {:>8} {:>10} {:>12} {:>13} {:>10}",
            row["name"].as_str().unwrap_or_default(),
            number(&row["inside_p50_ms"], 3),
            number(&row["inside_p99_ms"], 3),
            number(&row["p50_ms"], 3),
            number(&row["p99_ms"], 3),
            number(&row["max_ms"], 3),
            number(&row["overtaken"], 4),
            number(&row["nodes_cores"], 3),
            number(&row["fusion_cores"], 3),
            number(&row["cores"], 3),
        );
    }
    let (ours, peer) = (named(&measured, R2R), named(&measured, RCLPY));
    let over = |key: &str| Some(peer[key].as_f64()? / ours[key].as_f64()?);
    Ok(json!({
        "skins": SKINS, "rate_hz": options.rate, "seconds": options.seconds,
        "rclpy": peer, "rclpy_over_r2r": { "p50": over("p50_ms"), "p99": over("p99_ms"), "fusion_cores": over("fusion_cores") },
        "hiroz": named(&measured, HIROZ), "r2r": named(&measured, R2R), "one_process": named(&measured, TOGETHER),
        "one_process_2khz": named(&measured, TOGETHER_FAST),
        "rows": measured,
    }))
}

/// A device that sends by itself; when each frame was sent.
struct Sender {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<Vec<i64>>>,
}

impl Sender {
    /// A pause without touch, then pressed frames until it is stopped.
    fn start(mut device: Device, rate: f64, pressed: Arc<AtomicBool>) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut pace = Pace::new(rate);
            while !stopped.load(Ordering::Relaxed) {
                device.send(pressed.load(Ordering::Relaxed))?;
                pace.wait();
            }
            Ok(device.sent)
        });
        Self { stop, thread }
    }

    fn end(self) -> Result<Vec<i64>> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().map_err(|_| anyhow!("a device's thread panicked"))?
    }
}

/// The fusion in rclpy and numpy.
fn rclpy_fusion(options: &Options, python: &Path, robot: &Path) -> Command {
    let mut command = Command::new(python);
    command.arg(options.programs.root.join("benches/python/rclpy_fusion.py")).arg(robot).arg("--assume-rest");
    // Threads of numpy's libraries wait for each other, and gain nothing on small arrays.
    command.envs([("OMP_NUM_THREADS", "1"), ("OPENBLAS_NUM_THREADS", "1")]);
    if let Some(packages) = &options.peer_packages {
        command.env("PYTHONPATH", packages);
    }
    command
}

fn measure(
    options: &Options,
    (backend, programs, layout): (Choice, &Path, Layout<'_>),
    model: &Path,
    domain: u16,
) -> Result<Value> {
    let file = options.programs.root.join(SKIN);
    let skin = SkinDescription::load(&file)?;
    let folder = tempfile::tempdir()?;
    let robot = write_robot(folder.path(), SKINS)?;
    let (_subscriber, arrivals) = start_body(backend, domain, "/body_contacts")?;
    let program = || {
        let mut command = Command::new(programs.join("dermis"));
        command.env("DERMIS_LOG", "error");
        command
    };
    let mut fusion = program();
    fusion.arg("fusion").arg("--robot").arg(&robot).arg("--assume-rest").args(["--backend", backend.name()]);
    if let Layout::Rclpy(python) = layout {
        fusion = rclpy_fusion(options, python, &robot);
    }
    let pressed = Arc::new(AtomicBool::new(false));
    let (mut commands, mut devices) = (Vec::new(), Vec::new());
    for i in 0..SKINS {
        let device = Device::new(&skin, i as u64 + 1)?;
        let mut node = skin_node(programs, backend, (&file, model), &device);
        node.args(["--namespace", &format!("/s{i}"), "--instance", &format!("s{i}")]);
        node.args(["--frame-id", &format!("s{i}_skin")]);
        commands.push(node);
        devices.push(device);
    }
    let (nodes, fusion) = match layout {
        Layout::Apart | Layout::Rclpy(_) => {
            let fusion = spawn(&mut fusion, domain)?;
            let nodes = commands.iter_mut().map(|node| spawn(node, domain)).collect::<Result<Vec<_>>>()?;
            (nodes, Some(fusion))
        }
        Layout::Together(rate) => {
            let mut container = program();
            container.arg("container").args(fusion.args(["--max-rate", rate]).get_args());
            for node in &commands {
                container.arg("--").args(node.get_args());
            }
            (vec![spawn(&mut container, domain)?], None)
        }
    };
    let senders: Vec<Sender> =
        devices.into_iter().map(|device| Sender::start(device, options.rate, Arc::clone(&pressed))).collect();
    let found = observe(options, &arrivals, &pressed, &nodes, fusion.as_ref());
    let sent: Vec<Vec<i64>> = senders.into_iter().map(Sender::end).collect::<Result<_>>()?;
    let Observed { seen, within, mut row } = found?;
    let (mut ms, mut inside, mut frames) = (Vec::new(), Vec::new(), 0_usize);
    for (place, sent) in sent.iter().enumerate() {
        let counted = |at: i64| within.contains(&at);
        frames += sent.iter().filter(|at| counted(**at)).count();
        let mut latest = None;
        for arrival in seen.iter().filter(|a| usize::from(a.status) == place) {
            let stamp = i64::try_from(arrival.sequence)?;
            // The last frame that had been sent by then.
            let Some(k) = sent.partition_point(|at| *at - EARLY <= stamp).checked_sub(1) else { continue };
            if latest.replace(k) != Some(k) && counted(sent[k]) {
                ms.push((arrival.received_ns - sent[k]) as f64 * 1e-6);
                if arrival.published_ns != 0 {
                    inside.push((arrival.published_ns - sent[k]) as f64 * 1e-6);
                }
            }
        }
    }
    row["frames"] = json!(frames);
    row["overtaken"] = json!(1.0 - ms.len() as f64 / frames.max(1) as f64);
    for (of, delays) in [("", &mut ms), ("inside_", &mut inside)] {
        delays.sort_by(f64::total_cmp);
        for (key, p) in [("p50", 50.0), ("p99", 99.0), ("p999", 99.9), ("max", 100.0)] {
            row[format!("{of}{key}_ms")] = json!(percentile(delays, p));
        }
    }
    Ok(row)
}

/// What was heard in the time of a row.
struct Observed {
    /// One of each skin for each message.
    seen: Vec<Arrival>,
    /// \[ns since the epoch\] Frames that count were sent then.
    within: Range<i64>,
    /// What can be said without the frames.
    row: Value,
}

/// Waits until all feel, lets all press, and listens for the time of a row.
fn observe(
    options: &Options,
    arrivals: &Receiver<Arrival>,
    pressed: &AtomicBool,
    nodes: &[Process],
    fusion: Option<&Process>,
) -> Result<Observed> {
    std::thread::sleep(SETTLING);
    pressed.store(true, Ordering::Relaxed);
    let begun = Instant::now();
    // Every skin is pressed at one place of its own.
    while !arrivals.try_iter().any(|arrival| usize::from(arrival.contacts) == SKINS) {
        if begun.elapsed() > PATIENCE {
            bail!("not all {SKINS} skins reported contact within {} s", PATIENCE.as_secs());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    std::thread::sleep(SETTLING);
    arrivals.try_iter().for_each(drop);
    let of_nodes = || nodes.iter().map(|p| cpu_time(&p.0)).sum::<Result<Duration>>();
    let of_fusion = || fusion.map(|p| cpu_time(&p.0)).transpose();
    let before = (of_nodes()?, of_fusion()?);
    let (first, begun) = (now_ns(), Instant::now());
    std::thread::sleep(Duration::from_secs_f64(options.seconds));
    let within = first..now_ns();
    let wall = begun.elapsed().as_secs_f64();
    let cores = |spent: Duration| spent.as_secs_f64() / wall;
    let nodes_cores = cores(of_nodes()? - before.0);
    let fusion_cores = of_fusion()?.zip(before.1).map(|(now, before)| cores(now - before));
    // The last ones are still on their way.
    std::thread::sleep(Duration::from_millis(200));
    let seen: Vec<Arrival> = arrivals.try_iter().collect();
    let without = seen.iter().filter(|a| usize::from(a.contacts) != SKINS).count();
    let row = json!({
        "messages_per_s": seen.len() as f64 / SKINS as f64 / wall,
        "not_all_detected": without as f64 / seen.len().max(1) as f64,
        "nodes_cores": nodes_cores,
        "fusion_cores": fusion_cores,
        "cores": nodes_cores + fusion_cores.unwrap_or(0.0),
    });
    Ok(Observed { seen, within, row })
}
