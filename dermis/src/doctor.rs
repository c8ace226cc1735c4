//! What this machine offers.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use dermis_inference::{Runtime, RuntimeConfig};
use dermis_node::NetworkChoice;
use serde_json::json;

/// What to look at.
#[derive(Args)]
pub struct Options {
    /// ONNX Runtime's native library, where it lies in an unusual place.
    #[arg(long)]
    onnxruntime: Option<PathBuf>,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Prints the report.
pub fn run(options: &Options) -> Result<()> {
    let config = RuntimeConfig { library: options.onnxruntime.clone(), ..RuntimeConfig::default() };
    let inference = Runtime::load(&config)?.report();
    let serial = serial_devices();
    let ros = std::env::var("ROS_DISTRO").ok();
    let rmw = std::env::var("RMW_IMPLEMENTATION").ok();
    let network = match NetworkChoice::default().resolve() {
        Ok(network) => {
            let file = network.zenoh_config.map(|file| file.display().to_string());
            format!("{} (by {})", file.unwrap_or_else(|| network.reach.to_string()), network.decided_by)
        }
        Err(error) => error.to_string(),
    };
    let domain = std::env::var("ROS_DOMAIN_ID").unwrap_or_else(|_| "0".to_owned());
    if options.json {
        println!(
            "{}",
            json!({
                "version": env!("CARGO_PKG_VERSION"),
                "features": FEATURES.iter().filter(|f| f.built).map(|f| f.name).collect::<Vec<_>>(),
                "inference": inference,
                "serial_devices": serial,
                "network": network,
                "ros": { "distro": ros, "rmw": rmw, "domain": domain, "backend_ros2": cfg!(feature = "ros2") },
                "sensor_families": crate::registry::sensors().names(),
            })
        );
        return Ok(());
    }
    println!("dermis {}", env!("CARGO_PKG_VERSION"));
    println!("features      {}", features(&FEATURES));
    println!("inference     {inference}");
    println!(
        "serial        {}",
        if serial.is_empty() {
            "no device (/dev/ttyACM*, /dev/ttyUSB*)".to_owned()
        } else {
            serial.join(", ")
        }
    );
    println!(
        "ROS 2         {}, domain {domain}, backends: hiroz{}",
        ros.map_or_else(|| "none sourced (not needed)".to_owned(), |d| format!("{d} sourced")),
        if cfg!(feature = "ros2") { ", ros2" } else { " (ros2: build with --features ros2)" },
    );
    println!(
        "              peers see us with RMW_IMPLEMENTATION=rmw_zenoh_cpp over hiroz, with any RMW over ros2"
    );
    println!("network       {network}");
    let families = crate::registry::sensors().names();
    println!("sensors       {}", families.join(", "));
    Ok(())
}

/// What a program may be built with.
struct Feature {
    name: &'static str,
    /// What it adds.
    adds: &'static str,
    built: bool,
}

/// The optional features of this program.
const FEATURES: [Feature; 3] = [
    Feature { name: "train", adds: "trains convolutional networks", built: dermis_learn::CONVOLUTIONAL },
    Feature { name: "gpu", adds: "trains them on a GPU", built: dermis_learn::GPU },
    Feature { name: "ros2", adds: "talks through the ROS 2 that is sourced", built: cfg!(feature = "ros2") },
];

/// The features that this program has, and those that it lacks.
fn features(all: &[Feature]) -> String {
    let listed = |built: bool| -> Vec<String> {
        all.iter().filter(|f| f.built == built).map(|f| format!("{} ({})", f.name, f.adds)).collect()
    };
    let parts = [("", listed(true)), ("without ", listed(false))];
    let parts = parts.iter().filter(|(_, names)| !names.is_empty());
    parts.map(|(word, names)| format!("{word}{}", names.join(", "))).collect::<Vec<_>>().join("; ")
}

fn serial_devices() -> Vec<String> {
    let Ok(entries) = std::fs::read_dir("/dev") else { return Vec::new() };
    let mut devices: Vec<String> = entries
        .flatten()
        .filter_map(|e| e.file_name().into_string().ok())
        .filter(|n| ["ttyACM", "ttyUSB", "ttyAMA"].iter().any(|p| n.starts_with(p)))
        .map(|n| format!("/dev/{n}"))
        .collect();
    devices.sort();
    devices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_are_named_with_what_they_add() {
        let with = |built: [bool; 3]| {
            let all: Vec<Feature> = FEATURES
                .into_iter()
                .zip(built)
                .map(|(feature, built)| Feature { built, ..feature })
                .collect();
            features(&all)
        };
        insta::assert_snapshot!(with([false; 3]), @"without train (trains convolutional networks), gpu (trains them on a GPU), ros2 (talks through the ROS 2 that is sourced)");
        insta::assert_snapshot!(with([true, false, true]), @"train (trains convolutional networks), ros2 (talks through the ROS 2 that is sourced); without gpu (trains them on a GPU)");
        insta::assert_snapshot!(with([true; 3]), @"train (trains convolutional networks), gpu (trains them on a GPU), ros2 (talks through the ROS 2 that is sourced)");
    }
}
