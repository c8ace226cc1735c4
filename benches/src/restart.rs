//! From `kill -9` of a node under `dermis launch` to the first contacts of the one that comes after it, at a subscriber in
//! another process.
//!
//! The skin is simulated, so that its device goes on sending. Two times are taken: to the first message, and to the first
//! one whose status is OK, which the node gives once it has its zero (`tare_duration` of untouched readings).

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_msgs::msg::ContactArray;
use dermis_node::{HirozBackend, Node, NodeOptions, Qos};
use dermis_transport::now_ns;
use serde_json::{Value, json};

use crate::machine::Process;
use crate::node::percentile;
use crate::subscriber::isolated;

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(60);
/// \[s\] of running after which a crash is the first one again; the default is 10 s, and would make this a long run.
const STABLE: f64 = 2.0;

/// What is killed, and how often.
#[derive(Debug, Args)]
pub struct Options {
    /// How often the node is killed.
    #[arg(long, default_value_t = 20)]
    kills: usize,
    /// Program under test; beside this one where absent.
    #[arg(long)]
    dermis: Option<PathBuf>,
    /// Skin description.
    #[arg(long, default_value = "launch/skins/baro-grid.toml")]
    skin: PathBuf,
    /// Model bundle.
    #[arg(long, default_value = "models/baro-grid")]
    model: PathBuf,
    /// The node that reads it.
    #[arg(long, default_value = "barodome")]
    node: String,
}

/// Runs, and says how long it took.
///
/// # Errors
///
/// Where a process does not start, or no contacts come back.
pub fn run(options: &Options) -> Result<Value> {
    let scratch = tempfile::tempdir()?;
    let dermis = match &options.dermis {
        Some(path) => path.clone(),
        None => std::env::current_exe()?
            .parent()
            .map(|p| p.join("dermis"))
            .context("this program has no folder")?,
    };
    let (skin, model) = (options.skin.canonicalize()?, options.model.canonicalize()?);
    let file = scratch.path().join("restart.launch.yaml");
    let text = json!({ "processes": [
        { "name": "device", "dermis": ["device", "simulate", skin, "--link", "${tmp}/device"],
          "ready": { "file": "${tmp}/device" } },
        { "name": "skin", "node": options.node, "after": ["device"], "restart": "on-failure",
          "backoff": { "stable": STABLE },
          "config": { "skin": skin, "source": "serial://${tmp}/device", "models": [model] } },
    ]});
    std::fs::write(&file, text.to_string())?;

    let domain = 120 + (std::process::id() % 40) as u16;
    let mut node_options = NodeOptions::new("restart");
    node_options.domain_id = Some(domain);
    node_options = node_options.localhost_only(true);
    let node = Node::open(node_options, &HirozBackend::default())?;
    let (send, contacts) = channel();
    let _subscription = node.subscribe::<ContactArray>("contacts", Qos::sensor_data(), move |array, _| {
        let _ = send.send((now_ns(), array));
    })?;
    let mut command = Command::new(&dermis);
    command.args(["launch", "--log-format", "json"]).arg(&file);
    let launch = isolated(&mut command, domain).stdout(Stdio::piped()).spawn();
    let mut launch = Process(launch.with_context(|| format!("{} cannot be started", dermis.display()))?);
    let starts = starts(launch.0.stdout.take().context("the launch has no output")?);

    let (mut first, mut known) = (Vec::new(), Vec::new());
    for _ in 0..options.kills {
        let id = starts.recv_timeout(PATIENCE).context("the node is not started")?;
        let begun = now_ns();
        wait(&contacts, begun, true)?;
        std::thread::sleep(Duration::from_secs_f64(STABLE + 0.5));
        nix::sys::signal::kill(nix::unistd::Pid::from_raw(id), nix::sys::signal::Signal::SIGKILL)?;
        let killed = now_ns();
        // Stamps are those of the acquisition. Messages on their way may be of frames a little before.
        let after = killed + 20_000_000;
        first.push(wait(&contacts, after, false)?.saturating_sub(killed) as f64 * 1e-9);
        known.push(wait(&contacts, after, true)?.saturating_sub(killed) as f64 * 1e-9);
    }
    first.sort_by(f64::total_cmp);
    known.sort_by(f64::total_cmp);
    let summary = |times: &[f64]| json!({ "median_s": percentile(times, 50.0), "p90_s": percentile(times, 90.0), "max_s": times.last(), "all_s": times });
    println!(
        "{} kills: first message after {:.2} s (median; at most {:.2}), contacts known after {:.2} s (at most {:.2})",
        options.kills,
        percentile(&first, 50.0),
        percentile(&first, 100.0),
        percentile(&known, 50.0),
        percentile(&known, 100.0)
    );
    Ok(json!({ "kills": options.kills, "first_message": summary(&first), "contacts_known": summary(&known) }))
}

/// Process ids of the node, each when it is started.
fn starts(out: impl std::io::Read + Send + 'static) -> Receiver<i32> {
    let (send, starts) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(out).lines().map_while(Result::ok) {
            let record: Value = serde_json::from_str(&line).unwrap_or_default();
            let message = record["message"].as_str().unwrap_or_default();
            if let Some(id) = message.strip_prefix("skin started, process ").and_then(|id| id.parse().ok()) {
                let _ = send.send(id);
            }
        }
    });
    starts
}

/// When the next array of a frame after `after` \[ns\] came, with known contacts where requested.
fn wait(contacts: &Receiver<(i64, ContactArray)>, after: i64, known: bool) -> Result<i64> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let (at, array) = contacts.recv_timeout(left).context("no contacts came back")?;
        if array.header.stamp.as_nanos() > after && (!known || array.status == ContactArray::STATUS_OK) {
            return Ok(at);
        }
        if Instant::now() > deadline {
            bail!("contacts stay {}: {}", array.status, array.status_text);
        }
    }
}
