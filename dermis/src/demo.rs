//! The main job without hardware: a simulated skin behind a pseudo-terminal, the node, and what a subscriber gets.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_bridge_zenoh::{Bridge, BridgeConfig};
use dermis_msgs::geometry_msgs::msg::Point;
use dermis_msgs::msg::ContactArray;
use dermis_node::{Node, NodeOptions, Qos};
use dermis_perception::cli::NetworkArguments;
use dermis_perception::{Config, SkinNode};
use dermis_skin::SkinDescription;
use dermis_testbed::{Outlet, Plan, VirtualDevice};
use serde_json::json;

use crate::backend::Choice;
use crate::stats::Samples;
use crate::table::{DRAW, Felt, Table, pressing};

/// How to show it.
#[derive(Args)]
pub struct Options {
    /// End after this long, e.g. `10s` or `2m`; until Ctrl-C where absent.
    #[arg(long, value_parser = duration)]
    duration: Option<Duration>,
    /// Print one JSON object at the end instead of a table.
    #[arg(long)]
    json: bool,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
    /// Without JSON over zenoh.
    #[arg(long)]
    no_bridge: bool,
    #[command(flatten)]
    network: NetworkArguments,
    /// Seed of the touches and the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// A time as people write it.
pub fn duration(text: &str) -> Result<Duration, String> {
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    let factor = match unit {
        "" | "s" => 1.0,
        "ms" => 1e-3,
        "m" | "min" => 60.0,
        _ => {
            return Err(format!(
                "`{text}` has the unit `{unit}`; write seconds, e.g. `10s`, or minutes, e.g. `2m`"
            ));
        }
    };
    match number.parse::<f64>() {
        Ok(n) if n > 0.0 && n.is_finite() => Ok(Duration::from_secs_f64(n * factor)),
        _ => Err(format!("`{text}` is not a duration; write seconds, e.g. `10s`")),
    }
}

const SKIN: &str = include_str!("../../launch/skins/baro-grid.toml");
const PLAN: &str = include_str!("../../launch/plans/demo.toml");
/// The model bundle that ships, inside of the program: the demo needs no file beside it.
const BUNDLE: [(&str, &[u8]); 3] = [
    ("bundle.toml", include_bytes!("../../models/baro-grid/bundle.toml")),
    ("model.onnx", include_bytes!("../../models/baro-grid/model.onnx")),
    ("card.json", include_bytes!("../../models/baro-grid/card.json")),
];

/// Truth and estimate are compared where the press is at least this strong \[N\].
const COMPARED: f64 = 0.1;

/// Runs the demo.
pub fn run(options: &Options) -> Result<()> {
    let skin = SkinDescription::from_toml(SKIN, "baro-grid.toml")?;
    let plan = Plan::from_toml(PLAN, "demo.toml")?;
    let scratch = tempfile::tempdir().context("no temporary folder for the demo's skin and model")?;
    let skin_path = scratch.path().join("baro-grid.toml");
    std::fs::write(&skin_path, SKIN)?;
    let bundle = scratch.path().join("baro-grid");
    std::fs::create_dir(&bundle)?;
    for (name, bytes) in BUNDLE {
        std::fs::write(bundle.join(name), bytes)?;
    }
    crate::block_on(async { play(options, &skin, &plan, &skin_path, &bundle).await })
}

async fn play(
    options: &Options,
    skin: &SkinDescription,
    plan: &Plan,
    skin_path: &Path,
    bundle: &Path,
) -> Result<()> {
    let model = dermis_barodome::model(skin)?;
    let device = VirtualDevice::start(model, skin, plan, options.seed, &Outlet::Pty)?;
    let backend = options.backend.open()?;

    let mut config = Config::new(skin_path, device.url());
    config.models = vec![bundle.to_path_buf()];
    let network = options.network.choice();
    (config.network, config.zenoh_config) = (network.network, network.zenoh_config.clone());
    let node = SkinNode::start(dermis_barodome::FAMILY, &config, backend.as_ref())?;

    let watcher = Node::open(NodeOptions::new("dermis_demo").network(network.clone()), backend.as_ref())?;
    eprintln!("{}", watcher.open_to());
    let seen = Arc::new(Mutex::new(Seen::new()));
    let sink = Arc::clone(&seen);
    let _subscription =
        watcher.subscribe::<ContactArray>("contacts", Qos::sensor_data(), move |array, info| {
            sink.lock().unwrap_or_else(PoisonError::into_inner).take(array, info.received_ns);
        })?;
    let bridge = if options.no_bridge {
        None
    } else {
        let config = BridgeConfig { robot: "demo".into(), network, ..BridgeConfig::default() };
        // The table is worth more than the JSON beside it.
        Bridge::open(&watcher, config)
            .await
            .inspect(|bridge| eprintln!("{}", bridge.open_to()))
            .inspect_err(|e| eprintln!("note: no JSON over zenoh: {e}"))
            .ok()
    };

    let mut table = Table::begin();
    loop {
        tokio::select! {
            () = tokio::time::sleep(DRAW) => {}
            result = tokio::signal::ctrl_c() => { result?; break; }
        }
        let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
        seen.compare(&device);
        if !options.json {
            crate::table::shown(table.draw(std::iter::once(&seen.felt)))?;
        }
        if options.duration.is_some_and(|d| table.elapsed() >= d) {
            break;
        }
        if !device.running() {
            bail!("the simulated device stopped by itself");
        }
    }

    let elapsed = table.elapsed().as_secs_f64();
    if let Some(bridge) = bridge {
        bridge.close().await;
    }
    node.stop();
    watcher.shutdown();
    let sent = device.stop()?;
    let seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
    if options.json {
        println!("{}", seen.summary(elapsed, sent.frames));
    } else {
        let s = seen.summary(elapsed, sent.frames);
        println!(
            "\n{} frames in {elapsed:.1} s, {} with a contact; median error {} mm and {} N over {} frames stronger than {COMPARED} N",
            s["arrays"],
            s["touched"],
            rounded(&s["position_error_mm"]["p50"]),
            rounded(&s["force_error_n"]["p50"]),
            s["compared"],
        );
    }
    if seen.felt.arrays == 0 {
        bail!(
            "no contact array arrived in {elapsed:.0} s: run with DERMIS_LOG=info to see what the node says"
        );
    }
    Ok(())
}

fn rounded(value: &serde_json::Value) -> String {
    value.as_f64().map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"))
}

/// What came over the bus, and how far it is from what the device knows.
struct Seen {
    felt: Felt,
    waiting: Vec<ContactArray>,
    position_error_mm: Samples,
    force_error_n: Samples,
}

impl Seen {
    fn new() -> Self {
        Self {
            felt: Felt::new("baro-grid"),
            waiting: Vec::new(),
            position_error_mm: Samples::default(),
            force_error_n: Samples::default(),
        }
    }

    fn take(&mut self, array: ContactArray, received_ns: i64) {
        if array.contacts.len() == 1 {
            self.waiting.push(array.clone());
        }
        self.felt.take(array, received_ns);
    }

    /// Compares what came since the last call with what the device knows.
    fn compare(&mut self, device: &VirtualDevice) {
        for array in std::mem::take(&mut self.waiting) {
            let Some(moment) = device.truth(array.header.stamp.as_nanos()) else { continue };
            let [truth] = moment.stimulus.contacts.as_slice() else { continue };
            let force = -truth.force.z;
            if force < COMPARED {
                continue;
            }
            let contact = &array.contacts[0];
            self.position_error_mm.push(distance_mm(&contact.position, &truth.position));
            self.force_error_n.push((pressing(contact) - force).abs());
        }
    }

    fn summary(&self, elapsed: f64, sent: u64) -> serde_json::Value {
        let spread = |samples: &Samples| json!({ "p50": samples.percentile(50.0), "p90": samples.percentile(90.0), "p99": samples.percentile(99.0) });
        let felt = &self.felt;
        json!({
            "seconds": elapsed,
            "frames_sent": sent,
            "arrays": felt.arrays,
            "touched": felt.touched,
            "rate_hz": felt.rate(),
            "latency_ms": spread(&felt.latency_ms),
            "compared": self.position_error_mm.len(),
            "position_error_mm": spread(&self.position_error_mm),
            "force_error_n": spread(&self.force_error_n),
            "status": {
                "ok": felt.statuses[0], "degraded": felt.statuses[1], "stale": felt.statuses[2],
                "uncalibrated": felt.statuses[3], "fault": felt.statuses[4],
            },
        })
    }
}

fn distance_mm(a: &Point, b: &nalgebra::Point3<f64>) -> f64 {
    ((a.x - b.x).powi(2) + (a.y - b.y).powi(2) + (a.z - b.z).powi(2)).sqrt() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_read_as_people_write_them() {
        assert_eq!(duration("10s"), Ok(Duration::from_secs(10)));
        assert_eq!(duration("1.5"), Ok(Duration::from_millis(1500)));
        assert_eq!(duration("2m"), Ok(Duration::from_secs(120)));
        for bad in ["", "s", "-1s", "3h", "NaN", "inf"] {
            assert!(duration(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn what_ships_inside_fits_together() {
        let skin = SkinDescription::from_toml(SKIN, "baro-grid.toml").unwrap();
        Plan::from_toml(PLAN, "demo.toml").unwrap();
        dermis_barodome::model(&skin).unwrap();
        let dir = tempfile::tempdir().unwrap();
        for (name, bytes) in BUNDLE {
            std::fs::write(dir.path().join(name), bytes).unwrap();
        }
        dermis_inference::Bundle::load(dir.path(), &skin).unwrap();
    }
}
