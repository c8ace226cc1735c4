//! Recordings that others made of a magnetic skin (eFlesh): what a node learns from one run, and what of it holds in another.
//!
//! Problem: readings of one run teach its own lattice, zero and depth, and a figure of held-out frames of the same run says little of the
//! next one. Method: train on one run, judge on what was held out of it and on all of another, by the node's own estimator. Assumptions:
//! both runs are of one skin. Cost: some minutes of CPU time each.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::{evaluation, scratch};
use crate::run::{cargo, output, run as execute, target_dir};

/// Folder of the recordings.
fn recordings(root: &Path) -> PathBuf {
    std::env::var("DERMIS_DATA").map_or_else(|_| root.join("../shared/data"), PathBuf::from).join("eflesh")
}

/// Bags of all runs in a folder of recordings, in the order of their names.
fn import(root: &Path, dermis: &Path, folder: &str, dir: &Path) -> Result<Vec<PathBuf>> {
    let source = recordings(root).join(folder);
    let mut runs: Vec<PathBuf> = std::fs::read_dir(&source)
        .with_context(|| format!("{} is missing: set DERMIS_DATA", source.display()))?
        .map(|e| e.map(|e| e.path()))
        .collect::<Result<_, _>>()?;
    runs.sort();
    let mut bags = Vec::new();
    for run in &runs {
        let bag = dir.join(run.file_name().unwrap_or_default());
        execute(Command::new(dermis).arg("import").arg(run).arg("-o").arg(&bag).current_dir(root))?;
        bags.push(bag);
    }
    Ok(bags)
}

/// Trains on each of the recorded runs with `launch/train/eflesh-<what>.toml` and evaluates.
pub(super) fn recorded(root: &Path, what: &str, folder: &str) -> Result<Value> {
    execute(cargo(root).args(super::PROGRAM))?;
    let dermis = target_dir(root).join("release/dermis");
    let dir = scratch(root, what)?;
    let bags = import(root, &dermis, folder, &dir)?;
    let config = root.join(format!("launch/train/eflesh-{what}.toml"));
    let skin = if what == "shear" { "eflesh-shear" } else { "eflesh" };
    let skin = root.join(format!("launch/skins/{skin}.toml"));
    // The figures that the authors state hold out presses (or the end of a trial); ours hold out locations too.
    let splits: &[&str] = if what == "position" { &["press", "location"] } else { &["time"] };
    let mut rows = Vec::new();
    for (i, train) in bags.iter().enumerate() {
        for split in splits {
            let model = dir.join(format!("model-{i}-{split}"));
            execute(
                Command::new(&dermis)
                    .arg("train")
                    .args(["--config".as_ref(), config.as_os_str()])
                    .args(["--skin".as_ref(), skin.as_os_str()])
                    .args(["--split", split])
                    .args(["--out".as_ref(), model.as_os_str()])
                    .arg(train)
                    .current_dir(root),
            )?;
            for (j, bag) in bags.iter().enumerate() {
                if i != j && *split == "press" {
                    continue;
                }
                let mut evaluate = Command::new(&dermis);
                evaluate.arg("evaluate").args(["--skin".as_ref(), skin.as_os_str()]).current_dir(root);
                evaluate.args(["--model".as_ref(), model.as_os_str()]).arg("--json");
                if i == j {
                    evaluate.arg("--held-out");
                }
                evaluate.arg(bag);
                let result = evaluation(&mut evaluate)?;
                rows.push(json!({
                    "trained_on": train.file_name().map(|n| n.to_string_lossy()),
                    "tested_on": bag.file_name().map(|n| n.to_string_lossy()),
                    "split": if i == j { split } else { &"other run" },
                    "result": result,
                }));
            }
        }
    }
    // The worst of the runs counts.
    let worst = |split: &str, figure: &str, factor: f64| {
        let of = |row: &Value| row["result"]["figures"][figure].as_f64().filter(|_| row["split"] == split);
        rows.iter().filter_map(of).fold(f64::NAN, f64::max) * factor
    };
    Ok(if what == "position" {
        json!({
            "press_not_found": worst("press", "not_found", 1.0),
            "press_found_mean_mm": worst("press", "position_found_mean", 1e3),
            "other_run_not_found": worst("other run", "not_found", 1.0),
            "press_mean_mm": worst("press", "position_mean", 1e3),
            "press_rms_mm": worst("press", "position_rms", 1e3),
            "location_mean_mm": worst("location", "position_mean", 1e3),
            "location_rms_mm": worst("location", "position_rms", 1e3),
            "other_run_mean_mm": worst("other run", "position_mean", 1e3),
            "rows": rows,
        })
    } else {
        json!({
            "time_not_found": worst("time", "not_found", 1.0),
            "time_force_x_rms_n": worst("time", "force_x_rms", 1.0),
            "time_rms_n": worst("time", "force_normal_rms", 1.0),
            "other_run_rms_n": worst("other run", "force_normal_rms", 1.0),
            "rows": rows,
        })
    })
}

/// One transfer: what is learned, of which recordings, the figure of the result that is judged, and how many of its units are one here.
struct Quantity {
    /// Configuration `launch/train/eflesh-<name>.toml`.
    name: &'static str,
    folder: &'static str,
    skin: &'static str,
    figure: &'static str,
    /// Unit that is written, and how many of it are one SI unit.
    unit: (&'static str, f64),
    /// Whether the last part of the very run is a transfer, too: forces creep with time, places do not.
    same_run: bool,
}

const QUANTITIES: [Quantity; 3] = [
    Quantity {
        name: "position",
        folder: "spatial_resolution",
        skin: "eflesh",
        figure: "position_mean",
        unit: ("mm", 1e3),
        same_run: false,
    },
    Quantity {
        name: "force",
        folder: "normal_force",
        skin: "eflesh",
        figure: "force_normal_rms",
        unit: ("N", 1.0),
        same_run: true,
    },
    Quantity {
        name: "shear",
        folder: "shear_force",
        skin: "eflesh-shear",
        figure: "force_x_rms",
        unit: ("N", 1.0),
        same_run: true,
    },
];
/// Regressors that a bundle can hold, each alone; the shipped configuration lets `dermis train` choose among them.
const CANDIDATES: [&str; 3] = ["network", "vectors", "gaussian"];
const RESULT: &str = "benches/results/transfers.json";

/// What `dermis train` chooses beside each regressor alone, on another run and on the end of the same.
pub(super) fn transfers(root: &Path) -> Result<Value> {
    execute(cargo(root).args(super::PROGRAM))?;
    let (dermis, dir) = (target_dir(root).join("release/dermis"), scratch(root, "transfers")?);
    let mut rows = Vec::new();
    for quantity in &QUANTITIES {
        let bags = import(root, &dermis, quantity.folder, &dir)?;
        let shipped = root.join(format!("launch/train/eflesh-{}.toml", quantity.name));
        let text =
            dermis_io::read_text(&shipped, dermis_io::TEXT).map_err(|error| anyhow::anyhow!("{error}"))?;
        let skin = root.join(format!("launch/skins/{}.toml", quantity.skin));
        for (i, bag) in bags.iter().enumerate() {
            let mut models = vec![("chosen", dir.join(format!("{}-{i}-chosen", quantity.name)))];
            for candidate in CANDIDATES {
                models.push((candidate, dir.join(format!("{}-{i}-{candidate}", quantity.name))));
            }
            for (candidate, model) in &models {
                let mut config: toml::Table = text.parse()?;
                if *candidate != "chosen" {
                    config.insert("model".into(), toml::toml! { candidates = [(*candidate)] }.into());
                }
                let file = model.with_extension("toml");
                std::fs::write(&file, config.to_string())?;
                let mut train = Command::new(&dermis);
                train.args(["train", "--config"]).arg(&file).arg("--skin").arg(&skin);
                execute(train.arg("--out").arg(model).arg(bag).current_dir(root))?;
            }
            for (j, other) in bags.iter().enumerate() {
                if i == j && !quantity.same_run {
                    continue;
                }
                let mut errors = serde_json::Map::new();
                for (candidate, model) in &models {
                    let mut evaluate = Command::new(&dermis);
                    evaluate.args(["evaluate", "--json", "--skin"]).arg(&skin).arg("--model").arg(model);
                    if i == j {
                        evaluate.arg("--held-out");
                    }
                    let result = evaluation(evaluate.arg(other).current_dir(root))?;
                    let error = result["figures"][quantity.figure]
                        .as_f64()
                        .with_context(|| format!("no {} was measured", quantity.figure))?;
                    errors.insert((*candidate).into(), json!(error * quantity.unit.1));
                }
                rows.push(row(quantity, bag, other, &errors));
            }
        }
    }
    let ratios = || rows.iter().filter_map(|row| row["ratio_to_best"].as_f64());
    let commit = output(Command::new("git").args(["rev-parse", "--short", "HEAD"]).current_dir(root))?;
    let record = json!({
        "command": "cargo xtask measure transfers",
        "commit": commit.trim(),
        "worst_ratio_to_best": ratios().fold(f64::NAN, f64::max),
        "best_chosen": ratios().filter(|ratio| *ratio <= 1.0).count(),
        "transfers": rows,
    });
    super::ert::write(root, RESULT, &record)?;
    Ok(record)
}

/// Errors of one transfer, and what is chosen over the best of those that were alone.
fn row(quantity: &Quantity, from: &Path, to: &Path, errors: &serde_json::Map<String, Value>) -> Value {
    let name = |bag: &Path| bag.file_name().map(|n| n.to_string_lossy().into_owned());
    let of = |candidate: &str| errors.get(candidate).and_then(Value::as_f64);
    let best = CANDIDATES.iter().filter_map(|c| of(c)).fold(f64::NAN, f64::min);
    json!({
        "quantity": quantity.name,
        "figure": quantity.figure,
        "unit": quantity.unit.0,
        "trained_on": name(from),
        "tested_on": if from == to { Some("its last part, held out".to_owned()) } else { name(to) },
        "ratio_to_best": of("chosen").map(|chosen| chosen / best),
        "errors": errors,
    })
}
