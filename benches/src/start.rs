//! How soon contacts are known: from the start of a node's process to the first array of contacts with status OK at a subscriber in
//! another process, with an empty cache and with what the first start has kept. The half second of untouched readings that
//! a tare averages is part of it.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_msgs::msg::ContactArray;
use dermis_skin::SkinDescription;
use dermis_transport::framing::NativeFormat;
use dermis_transport::now_ns;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde_json::{Value, json};

use crate::device::Device;
use crate::machine::Process;
use crate::node::{PATIENCE, Pace};
use crate::subscriber::{Arrival, Choice, isolated, start};

/// Skins with the bundles that ship for them, and the commands of their nodes.
const SKINS: [(&str, &str); 3] =
    [("baro-grid", "barodome"), ("baro-dome", "barodome"), ("hapdef-shin", "hapdef")];
/// Different untouched frames; they repeat.
const VARIETY: usize = 512;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Folder of our programs.
    #[arg(long)]
    programs: PathBuf,
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// Starts with a warm cache, each.
    #[arg(long, default_value_t = 7)]
    starts: usize,
}

/// Starts each node once with an empty cache, and then again and again.
///
/// # Errors
///
/// Where a node does not come up.
pub fn run(options: &Options) -> Result<Value> {
    let mut all = serde_json::Map::new();
    eprintln!("\n{:<14} {:>10} {:>14} {:>12}", "skin", "cold s", "warm median s", "warm max s");
    for (n, (name, command)) in SKINS.into_iter().enumerate() {
        let domain = 50 + (std::process::id() % 10) as u16 * 3 + n as u16;
        let row = measure(options, name, command, domain).with_context(|| name.to_owned())?;
        let number = |key: &str| row[key].as_f64().unwrap_or(f64::NAN);
        eprintln!(
            "{name:<14} {:>10.3} {:>14.3} {:>12.3}",
            number("cold_s"),
            number("warm_s"),
            number("warm_max_s")
        );
        all.insert(name.to_owned(), row);
    }
    let worst = all.values().filter_map(|row| row["warm_s"].as_f64()).fold(f64::NAN, f64::max);
    all.insert("warm_worst_s".to_owned(), json!(worst));
    Ok(Value::Object(all))
}

fn measure(options: &Options, name: &str, command: &str, domain: u16) -> Result<Value> {
    let file = options.root.join(format!("launch/skins/{name}.toml"));
    let skin = SkinDescription::load(&file)?;
    let mut device = untouched(&skin)?;
    let cache = tempfile::tempdir()?;
    let (_subscriber, arrivals) = start(Choice::Hiroz, domain)?;
    let mut once = || -> Result<f64> {
        let mut node = Command::new(options.programs.join("dermis"));
        node.arg(command).arg("--skin").arg(&file).arg("--model").arg(options.root.join("models").join(name));
        node.arg("--source").arg(format!("serial://{}", device.path()));
        node.args(["--backend", "hiroz"]).env("XDG_CACHE_HOME", cache.path()).env("DERMIS_LOG", "error");
        let first_sent = device.sent.len() as u64;
        arrivals.try_iter().for_each(drop);
        let begun = now_ns();
        let node = isolated(&mut node, domain).stdout(Stdio::null()).spawn().context("no node")?;
        let _node = Process(node);
        let mut pace = Pace::new(skin.rate);
        // Those of the node before may still be on their way.
        let known = |a: &Arrival| a.status == ContactArray::STATUS_OK && a.sequence >= first_sent;
        loop {
            device.send(false)?;
            pace.wait();
            if let Some(first) = arrivals.try_iter().find(known) {
                return Ok((first.received_ns - begun) as f64 * 1e-9);
            }
            if (now_ns() - begun) as u128 > PATIENCE.as_nanos() {
                bail!("contacts were not known within {} s", PATIENCE.as_secs());
            }
        }
    };
    let cold = once()?;
    let mut warm = (0..options.starts.max(1)).map(|_| once()).collect::<Result<Vec<f64>>>()?;
    warm.sort_by(f64::total_cmp);
    Ok(json!({
        "cold_s": cold, "warm_s": warm[warm.len() / 2], "warm_max_s": warm.last(), "warm_min_s": warm.first(),
        "starts": warm.len(), "kept_bytes": size(cache.path()),
    }))
}

/// A device that nothing touches.
fn untouched(skin: &SkinDescription) -> Result<Device> {
    let mut random = ChaCha8Rng::seed_from_u64(15);
    let noise = skin.channel_noise();
    // Where a converter counts, raw readings are whole numbers in its range.
    let (format, [low, high]) = match skin.wire.counts {
        Some(counts) => (NativeFormat::U16, counts.map(f64::from)),
        None => (NativeFormat::F32, [f64::MIN, f64::MAX]),
    };
    let mut frame = || -> Vec<f32> {
        let value = |sigma: &f64| {
            let raw = (sigma * random.sample::<f64, _>(StandardNormal) - skin.wire.offset) / skin.wire.scale;
            let raw = if skin.wire.counts.is_some() { raw.round() } else { raw };
            raw.clamp(low, high) as f32
        };
        noise.iter().map(value).collect()
    };
    let frames: Vec<Vec<f32>> = (0..VARIETY).map(|_| frame()).collect();
    Device::playing(format, frames.clone(), frames)
}

/// \[bytes\] of the files in a folder and those in it.
fn size(folder: &Path) -> u64 {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| match entry.metadata() {
            Ok(data) if data.is_dir() => size(&entry.path()),
            Ok(data) => data.len(),
            Err(_) => 0,
        })
        .sum()
}
