//! The way over the bus: a process that publishes, and `dermis record` in another.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_msgs::msg::TaxelFrame;
use dermis_msgs::sensor_msgs::msg::PointCloud2;
use dermis_msgs::{Message, TypeSupport};
use dermis_node::{HirozBackend, History, Node, NodeOptions, Qos, RawPublisher};
use serde_json::{Value, json};

use super::{FRAMES, cloud, frame};
use crate::machine::{Process, cpu_time, interrupt, wait};
use crate::subscriber::isolated;

/// Bytes of a large message.
const LARGE: usize = 900_000;
/// How long processes have to find each other, and the recorder to write what it holds.
const PATIENCE: Duration = Duration::from_secs(60);

/// What to publish.
#[derive(Debug, Args)]
pub struct SourceOptions {
    /// Seconds.
    #[arg(long)]
    seconds: f64,
    /// Rate \[MB/s\].
    #[arg(long)]
    rate: f64,
    /// Small messages only.
    #[arg(long)]
    small: bool,
}

/// Publishes at a rate, then says how much it was. Ends when its standard input does: what is on its way arrives first.
///
/// # Errors
///
/// Where the node does not open, or nobody subscribes.
pub fn source(options: &SourceOptions) -> Result<()> {
    let node_options = NodeOptions::new("bench_source").diagnostics(false);
    let node = Node::open(node_options, &HirozBackend::default())?;
    // The publisher waits where the network does, so that what is lost was lost behind it.
    let qos = Qos { history: History::KeepAll, ..Qos::reliable(1) };
    let large = node.publisher_raw("/load/large", TypeSupport::of::<PointCloud2>(), qos)?;
    let small = node.publisher_raw("/load/small", TypeSupport::of::<TaxelFrame>(), qos)?;
    let begun = Instant::now();
    while large.subscriber_count() == 0 || small.subscriber_count() == 0 {
        if begun.elapsed() > PATIENCE {
            bail!("nobody subscribed within {PATIENCE:?}");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let images: Vec<Vec<u8>> = (0..8).map(|seed| cloud(seed, LARGE).to_cdr()).collect();
    let frames: Vec<Vec<u8>> = (0..256).map(|index| frame(index).to_cdr()).collect();
    let begun = Instant::now();
    let (mut bytes, mut messages) = (0_u64, 0_u64);
    let mut send = |to: &RawPublisher, data: &[u8]| -> Result<u64> {
        to.publish_cdr(data)?;
        messages += 1;
        bytes += data.len() as u64;
        Ok(bytes)
    };
    let mut count = 0;
    while begun.elapsed().as_secs_f64() < options.seconds {
        let mut sent = 0;
        if !options.small {
            send(&large, &images[count % images.len()])?;
        }
        for index in 0..2 * FRAMES {
            sent = send(&small, &frames[(count * FRAMES + index) % frames.len()])?;
        }
        count += 1;
        let due = Duration::from_secs_f64(sent as f64 / (options.rate * 1e6));
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
    }
    let seconds = begun.elapsed().as_secs_f64();
    println!("{}", json!({ "messages": messages, "bytes": bytes, "seconds": seconds }));
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    Ok(())
}

/// Records large and small messages at the rate, then small ones at a twentieth of it.
pub(super) fn run(dermis: &Path, folder: &Path, rate: f64, seconds: f64) -> Result<Value> {
    let large = record(dermis, &folder.join("large"), rate, seconds, false)?;
    let small = record(dermis, &folder.join("small"), rate / 20.0, seconds, true)?;
    Ok(json!({ "large": large, "small": small }))
}

fn record(dermis: &Path, bag: &Path, rate: f64, seconds: f64, small: bool) -> Result<Value> {
    let domain = 100 + (std::process::id() % 20) as u16;
    let start = |command: &mut Command| -> Result<Process> {
        isolated(command, domain).stdin(Stdio::piped()).stdout(Stdio::piped());
        command.spawn().map(Process).with_context(|| format!("{command:?} does not start"))
    };
    let mut recorder =
        start(Command::new(dermis).args(["record", "--regex", "^/load/", "--json", "--out"]).arg(bag))?;
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["recording-source", "--seconds", &seconds.to_string(), "--rate", &rate.to_string()]);
    if small {
        command.arg("--small");
    }
    let mut source = start(&mut command)?;
    let sent = line(&mut source.0).context("the source ended without a word")?;
    let cpu = [cpu_time(&recorder.0)?, cpu_time(&source.0)?].map(|time| time.as_secs_f64());
    // All has arrived when what is written stops growing.
    let size = || {
        std::fs::read_dir(bag).map_or(0, |files| {
            files.flatten().filter_map(|f| f.metadata().ok()).map(|m| m.len()).sum::<u64>()
        })
    };
    let (mut last, begun) = (0, Instant::now());
    while size() != last && begun.elapsed() < PATIENCE {
        last = size();
        std::thread::sleep(Duration::from_millis(1500));
    }
    interrupt(&recorder.0)?;
    let said = line(&mut recorder.0).context("the recorder ended without a word")?;
    wait(&mut recorder.0, PATIENCE)?;
    drop(source.0.stdin.take());
    wait(&mut source.0, PATIENCE)?;
    std::fs::remove_dir_all(bag)?;

    let number = |value: &Value, key: &str| value[key].as_f64().unwrap_or(f64::NAN);
    let published = number(&sent, "messages");
    let recorded = number(&said, "messages");
    let took = number(&sent, "seconds");
    let reached = number(&sent, "bytes") * 1e-6 / took;
    eprintln!(
        "bus to file, {}: {reached:.0} of {rate:.0} MB/s, {published} published, {recorded} recorded, {} dropped by the recorder, {:.2} cores to record, {:.2} to publish",
        if small { "small" } else { "large" },
        said["dropped"],
        cpu[0] / took,
        cpu[1] / took
    );
    Ok(json!({
        "target_mb_s": rate, "mb_s": reached, "published": published, "recorded": recorded,
        "dropped_by_recorder": said["dropped"], "lost": published - recorded,
        "stored_share": number(&said, "stored_bytes") / number(&said, "payload_bytes"),
        "recorder_cores": cpu[0] / took, "source_cores": cpu[1] / took,
    }))
}

/// The first line of JSON that a process prints.
fn line(child: &mut Child) -> Option<Value> {
    let out = child.stdout.as_mut()?;
    // One line is all that comes, so that a reader's buffer may be thrown away.
    let mut lines = BufReader::new(out).lines().map_while(Result::ok);
    lines.find_map(|line| serde_json::from_str(&line).ok())
}
