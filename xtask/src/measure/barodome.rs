//! Measurements of the skins with barometers: as designed, and as devices with the default effects.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;
use serde_json::{Value, json};

use super::{beside_bound, evaluation, scratch};
use crate::programs;
use crate::run::run as execute;

/// Force [N] from which on the simulated skins are held to their bounds, and where further bins begin (thesis, Table 5.2).
const BINS: &str = "0.2,0.4,0.6,0.9,1.2";

/// Evaluates the bundles that ship on freshly collected bags.
pub(super) fn accuracy(root: &Path) -> Result<Value> {
    let dermis = programs::dermis(root)?;
    let dir = scratch(root, "accuracy")?;
    let mut all = serde_json::Map::new();
    for name in ["line", "grid", "dome"] {
        let skin = root.join(format!("launch/skins/baro-{name}.toml"));
        let plan = root.join(format!("launch/plans/baro-{name}-evaluate.toml"));
        let bag = dir.join(name);
        execute(Command::new(&dermis).arg("collect").arg(&skin).args([
            "--plan".as_ref(),
            plan.as_os_str(),
            "--out".as_ref(),
            bag.as_os_str(),
        ]))?;
        let evaluate = |bins: &str| -> Result<Value> {
            evaluation(
                Command::new(&dermis)
                    .arg("evaluate")
                    .arg("--in-range")
                    .args(["--skin".as_ref(), skin.as_os_str()])
                    .args(["--model".as_ref(), root.join(format!("models/baro-{name}")).as_os_str()])
                    .args(["--bins", bins, "--json"])
                    .arg(&bag),
            )
        };
        let (whole, binned) = (evaluate("0.2")?, evaluate(BINS)?);
        // Saturation is an effect of the device: what it costs shows in the figures with everything.
        let everything = &whole["with_everything"];
        let above = |of: &Value, quantity: &str| of["by_force"][quantity][0]["rms"].as_f64();
        // Of the very frames that are bounded.
        let against = beside_bound(&binned, 1, "position");
        let ratios: Vec<f64> = against["by_force"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|bin| bin["ratio_of_rms"].as_f64())
            .collect();
        let component = |axis: &str| whole["figures"][format!("force_{axis}_median")].as_f64();
        all.insert(
            name.to_owned(),
            json!({
                "position_rms_with_everything_mm": above(everything, "position").map(|v| v * 1e3),
                "force_rms_with_everything_n": above(everything, "force.normal"),
                "left_out": whole["left_out"],
                "position_rms_mm": above(&whole, "position").map(|v| v * 1e3),
                "not_found": whole["not_found"],
                "position_found_rms_mm": whole["figures"]["position_found_rms"].as_f64().map(|v| v * 1e3),
                "force_rms_n": above(&whole, "force.normal"),
                "worst_ratio_to_bound": ratios.iter().copied().fold(f64::NAN, f64::max),
                "position_median_mm": whole["figures"]["position_median"].as_f64().map(|v| v * 1e3),
                "force_median_n": whole["figures"]["force_median"].as_f64(),
                "force_component_medians_n": [component("x"), component("y"), component("z")],
                "count_right": whole["count_right"],
                "position": binned["by_force"]["position"],
                "bound": binned["bound"]["position"],
                "against_bound": binned["against_bound"],
                "without_bound": binned["bound"]["left_out"],
                "several": { "position": binned["by_force"]["position of 2"], "of_3": binned["by_force"]["position of 3"] },
            }),
        );
    }
    Ok(Value::Object(all))
}

/// Table 5.2 of the thesis: RMS errors [mm] of its networks on real sensors, in the bins of [`BINS`].
const THESIS: [(&str, [f64; 5]); 2] =
    [("line", [0.051, 0.032, 0.024, 0.019, 0.018]), ("grid", [0.158, 0.120, 0.107, 0.107, 0.120])];

/// Trains and evaluates on one device with the default effects.
pub(super) fn realism(root: &Path) -> Result<Value> {
    let dermis = programs::dermis(root)?;
    let dir = scratch(root, "realism")?;
    // One device for both bags, whose plans have seeds of their own.
    let effects = std::fs::read_to_string(root.join("launch/effects/baro-default.toml"))?;
    let seeded = |line: &str| {
        if line.starts_with("name =") { format!("{line}\nseed = 7\n") } else { format!("{line}\n") }
    };
    let device = dir.join("device.toml");
    std::fs::write(&device, effects.lines().map(seeded).collect::<String>())?;
    let mut all = serde_json::Map::new();
    for name in ["line", "grid", "dome"] {
        let skin = root.join(format!("launch/skins/baro-{name}.toml"));
        let bag = |use_: &str| -> Result<PathBuf> {
            let bag = dir.join(format!("{name}-{use_}"));
            let plan = root.join(format!("launch/plans/baro-{name}-{use_}.toml"));
            let mut collect = Command::new(&dermis);
            collect.arg("collect").arg(&skin).arg("--plan").arg(plan);
            execute(collect.arg("--effects").arg(&device).arg("--out").arg(&bag))?;
            Ok(bag)
        };
        let (train, tried) = (bag("train")?, bag("evaluate")?);
        let model = dir.join(format!("{name}-model"));
        let mut training = Command::new(&dermis);
        training.arg("train").arg("--skin").arg(&skin).arg("--out").arg(&model);
        execute(
            training.arg("--config").arg(root.join(format!("launch/train/baro-{name}.toml"))).arg(train),
        )?;
        let mut evaluate = Command::new(&dermis);
        evaluate.arg("evaluate").arg("--skin").arg(&skin).arg("--model").arg(&model);
        let found = evaluation(evaluate.args(["--bins", BINS, "--json"]).arg(tried))?;
        let position = &found["by_force"]["position"];
        let errors: Vec<f64> = position
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|b| b["rms"].as_f64())
            .map(|v| v * 1e3)
            .collect();
        // By how much they differ, whichever is larger.
        let thesis = THESIS.iter().find(|(n, _)| *n == name).map(|(_, t)| t);
        let factor = thesis.map(|thesis| {
            errors.iter().zip(thesis).map(|(ours, real)| (ours / real).max(real / ours)).fold(0.0, f64::max)
        });
        all.insert(
            name.to_owned(),
            json!({
                "position_rms_mm": errors,
                "thesis_mm": thesis,
                "factor": factor,
                "not_found": found["not_found"],
                "position_median_mm": found["figures"]["position_median"].as_f64().map(|v| v * 1e3),
            }),
        );
    }
    Ok(Value::Object(all))
}
