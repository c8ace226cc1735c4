//! Measurements of the limb with strain gauges.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::{LIMB, collected, evaluation, fingerprint, scratch};
use crate::programs;
use crate::run::run as execute;

/// A file of the limb's effects as a command takes it.
const LIMB_EFFECTS: &str = "launch/effects/hapdef-default.toml";
/// The device with the default effects that all measurements of the limb take.
pub(super) const DIFFERING: [&str; 4] = ["--effects", LIMB_EFFECTS, "--seed", "7"];

/// A bag of the limb under a plan, made anew only where the skin, the plan or what makes the device differ have changed since.
pub(super) fn limb_bag(root: &Path, dermis: &Path, plan: &str, device: &[&str]) -> Result<PathBuf> {
    let plan = root.join(format!("launch/plans/hapdef-shin-{plan}.toml"));
    let made_of = fingerprint(root, &[LIMB.into(), plan.clone(), LIMB_EFFECTS.into()], device)?;
    let folder = root.join(".dermis/measure/bags");
    std::fs::create_dir_all(&folder)?;
    let bag = folder.join(format!("limb-{made_of:016x}"));
    let mut collect = Command::new(dermis);
    collect.arg("collect").arg(LIMB).arg("--plan").arg(&plan).args(device);
    collected(collect.current_dir(root), &bag)?;
    Ok(bag)
}

/// Evaluates the limb's bundle in the bins of force of the thesis' Table 2.2.
pub(super) fn limb(root: &Path) -> Result<Value> {
    let dermis = programs::dermis(root)?;
    let devices: [(&str, &[&str]); 3] = [
        ("designed", &[]),
        ("one dead gauge", &["--effect", "dead-gauge=1", "--seed", "3"]),
        ("default effects", &DIFFERING),
    ];
    let mut all = serde_json::Map::new();
    for (name, device) in devices {
        let bag = limb_bag(root, &dermis, "evaluate", device)?;
        let mut evaluate = Command::new(&dermis);
        evaluate.arg("evaluate").args(["--skin", LIMB, "--model", "models/hapdef-shin"]).current_dir(root);
        if device.is_empty() {
            evaluate.arg("--beside").arg(limb_bag(root, &dermis, "train", device)?);
        }
        let found =
            evaluation(evaluate.args(["--bins", "0.5,4.9,9.8,19.6,34.3", "--in-range", "--json"]).arg(bag))?;
        let mm = |key: &str| found["figures"][key].as_f64().map(|v| v * 1e3);
        let beside: serde_json::Map<String, Value> = found["beside"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|other| {
                let (of, by) = (&other["evaluation"], &other["evaluation"]["by_force"]);
                let row = json!({
                    "settings": other["settings"], "position": by["position"], "force": by["force.normal"],
                    "not_found": of["not_found"],
                });
                Some((other["method"].as_str()?.to_owned(), row))
            })
            .collect();
        all.insert(
            name.to_owned(),
            json!({
                "position_mean_mm": mm("position_mean"),
                "position_median_mm": mm("position_median"),
                "force_mean_n": found["figures"]["force_normal_mean"],
                "missed": found["missed"],
                "not_found": found["not_found"],
                "left_out": found["left_out"],
                "with_everything": {
                    "position": found["with_everything"]["by_force"]["position"],
                    "force": found["with_everything"]["by_force"]["force.normal"],
                    "against_bound": found["with_everything"]["against_bound"],
                },
                "position": found["by_force"]["position"],
                "position_found": found["by_force"]["position found"],
                "force": found["by_force"]["force.normal"],
                "bound": found["bound"],
                "against_bound": found["against_bound"],
                "consistency": found["consistency"],
                // On the very frames that the other ways answer.
                "same_frames": {
                    "position": found["own_beside"]["by_force"]["position"],
                    "force": found["own_beside"]["by_force"]["force.normal"],
                    "against_bound": found["own_beside"]["against_bound"],
                },
                "beside": beside,
            }),
        );
    }
    let mean = |device: &str| all[device]["position_mean_mm"].as_f64();
    let cost = mean("one dead gauge").zip(mean("designed")).map(|(dead, whole)| dead - whole);
    all.insert("dead_gauge_costs_mm".to_owned(), json!(cost));
    // The least of how many times further off the best other way is, over the bins.
    let errors = |row: &Value| -> Vec<f64> {
        row["position"].as_array().into_iter().flatten().take(4).filter_map(|b| b["mean"].as_f64()).collect()
    };
    let ours = errors(&all["designed"]["same_frames"]);
    let margin = all["designed"]["beside"].as_object().into_iter().flatten().flat_map(|(_, row)| {
        errors(row).into_iter().zip(&ours).map(|(other, own)| other / own).collect::<Vec<_>>()
    });
    let margin = margin.fold(f64::INFINITY, f64::min);
    all.insert("margin".to_owned(), json!(margin));
    // Where the bound is below 3 mm: the most that the RMS is times the bound in any bin.
    let bins = super::beside_bound(&all["designed"], 1, "position")["well_determined"]["by_force"].clone();
    let worst = |of: &dyn Fn(&Value) -> Option<f64>| {
        bins.as_array().into_iter().flatten().filter_map(of).fold(f64::NAN, f64::max)
    };
    all.insert("tail".to_owned(), json!(worst(&|bin| bin["ratio_of_rms"].as_f64())));
    // And the most that what the estimator states of these contacts is times the bound.
    let stated = worst(&|bin| Some(bin["stated_rms"].as_f64()? / bin["bound_rms"].as_f64()?));
    all.insert("tail_stated".to_owned(), json!(stated));
    Ok(Value::Object(all))
}

/// Evaluates the limb's bundle for two contacts on presses of two and of one.
pub(super) fn doubles(root: &Path) -> Result<Value> {
    let dermis = programs::dermis(root)?;
    let devices: [(&str, &[&str]); 2] = [("designed", &[]), ("default effects", &DIFFERING)];
    let mut all = serde_json::Map::new();
    for (name, device) in devices {
        let bag = limb_bag(root, &dermis, "doubles", device)?;
        let mut evaluate = Command::new(&dermis);
        evaluate.args(["evaluate", "--skin", LIMB, "--model", "models/hapdef-shin-two", "--json"]);
        let found = evaluation(evaluate.arg(bag).current_dir(root))?;
        let keys =
            ["frames", "count_right", "missed", "not_found", "false_contacts", "figures", "consistency"];
        let kept = keys.into_iter().map(|key| (key.to_owned(), found[key].clone()));
        all.insert(name.to_owned(), kept.collect::<serde_json::Map<_, _>>().into());
    }
    Ok(Value::Object(all))
}

/// Learns from single contacts of one device with the default effects, and compares all ways on its doubles.
pub(super) fn real2sim(root: &Path) -> Result<Value> {
    let dermis = programs::dermis(root)?;
    let dir = scratch(root, "real2sim")?;
    let (train, doubles) =
        (limb_bag(root, &dermis, "train", &DIFFERING)?, limb_bag(root, &dermis, "doubles", &DIFFERING)?);
    let bundle = dir.join("hapdef-shin-real2sim");
    let mut learn = Command::new(&dermis);
    learn.args(["real2sim", "train", "--skin", LIMB, "--settings", "launch/real2sim/hapdef-shin.toml"]);
    execute(learn.arg("--out").arg(&bundle).arg(&train).current_dir(root))?;
    let mut compare = Command::new(&dermis);
    compare.args(["real2sim", "compare", "--skin", LIMB, "--model"]).arg(&bundle).arg("--train").arg(&train);
    compare.args(["--most", "250", "--learn", "12000", "--vectors", "1500", "--json"]);
    let found = evaluation(compare.arg(&doubles).current_dir(root))?;
    let rows = |method: &str| -> Value {
        let of = found["rows"].as_array().into_iter().flatten().filter(|row| row["method"] == method);
        let (mut frames, mut place, mut force) = (0.0, 0.0, 0.0);
        let mut all = serde_json::Map::new();
        for row in of {
            if let Some(kind) = row["kind"].as_str() {
                let number = |key: &str| row[key].as_f64().unwrap_or(f64::NAN);
                if kind != "single" {
                    frames += number("frames");
                    place += number("frames") * number("position_mean");
                    force += number("frames") * number("force_mean");
                }
                all.insert(
                    kind.to_owned(),
                    json!({ "position_mean_mm": number("position_mean") * 1e3, "force_mean_n": number("force_mean"),
                            "count_right": row["count_right"], "frames": row["frames"], "lost": row["lost"],
                            "with_everything": row["with_everything"], "found": row["found"] }),
                );
            }
        }
        let double = json!({ "position_mean_mm": place / frames * 1e3, "force_mean_n": force / frames });
        all.insert("double".to_owned(), double);
        Value::Object(all)
    };
    let mut record = found.as_object().cloned().context("the comparison is no object")?;
    record.get_mut("rows").and_then(Value::as_array_mut).into_iter().flatten().for_each(shorten);
    for (key, value) in [
        ("corrected", rows("corrected model, all pairs")),
        // Reduced: `cargo xtask measure hapdefx` has the sizes of the thesis.
        ("hapdefx", rows("hapdef-shin-real2sim: peaks")),
    ] {
        record.insert(key.to_owned(), value);
    }
    Ok(Value::Object(record))
}

/// Leaves of the evaluation of a row what tables show: errors by force and, over all forces, beside their bounds.
fn shorten(row: &mut Value) {
    let Some(evaluation) = row.get_mut("evaluation").and_then(Value::as_object_mut) else { return };
    let kept = ["frames", "count_right", "missed", "not_found", "by_force", "against_bound"];
    evaluation.retain(|key, _| kept.contains(&key.as_str()));
    if let Some(by_force) = evaluation.get_mut("by_force").and_then(Value::as_object_mut) {
        by_force.retain(|key, _| ["position", "force.normal"].contains(&key.as_str()));
    }
    let against = evaluation.get_mut("against_bound").and_then(Value::as_array_mut);
    for of in against.into_iter().flatten().filter_map(Value::as_object_mut) {
        of.retain(|key, _| !["by_force", "well_determined"].contains(&key.as_str()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_keeps_what_tables_show() {
        let of = json!({ "contacts": 1, "all": { "error_rms": 1.0 }, "by_force": [], "well_determined": {} });
        let mut row = json!({ "method": "m", "evaluation": {
            "frames": 3, "quantities": {}, "by_force": { "position": [1], "force.x": [2] }, "against_bound": [of] } });
        shorten(&mut row);
        let kept = json!({ "method": "m", "evaluation": { "frames": 3, "by_force": { "position": [1] },
            "against_bound": [{ "contacts": 1, "all": { "error_rms": 1.0 } }] } });
        assert_eq!(row, kept);
    }
}
