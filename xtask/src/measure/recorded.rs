//! Recordings that others made of a magnetic skin (eFlesh): what a node learns from one run, and what of it holds in another.
//!
//! Problem: readings of one run teach its own lattice, zero and depth, and a figure of held-out frames of the same run says little of the
//! next one. Method: train on one run, judge on what was held out of it and on all of another, by the node's own estimator. Assumptions:
//! both runs are of one skin. Cost: some minutes of CPU time each.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::{evaluation, read_toml, recordings, scratch};
use crate::programs;
use crate::run::run as execute;

/// What is learned, of which recordings, and the figure of the result that transfers are judged by.
pub(super) struct Quantity {
    /// Configuration `launch/train/eflesh-<name>.toml`.
    name: &'static str,
    folder: &'static str,
    skin: &'static str,
    figure: &'static str,
    /// Unit of the figure that is written, and how many of it are one SI unit.
    unit: (&'static str, f64),
    /// Whether the last part of the same run is a transfer, too: forces creep with time, locations do not.
    same_run: bool,
}

pub(super) const POSITION: Quantity = Quantity {
    name: "position",
    folder: "spatial_resolution",
    skin: "eflesh",
    figure: "position_mean",
    unit: ("mm", 1e3),
    same_run: false,
};
pub(super) const FORCE: Quantity = Quantity {
    name: "force",
    folder: "normal_force",
    skin: "eflesh",
    figure: "force_normal_rms",
    unit: ("N", 1.0),
    same_run: true,
};
pub(super) const SHEAR: Quantity = Quantity {
    name: "shear",
    folder: "shear_force",
    skin: "eflesh-shear",
    figure: "force_x_rms",
    unit: ("N", 1.0),
    same_run: true,
};

impl Quantity {
    fn config(&self, root: &Path) -> PathBuf {
        root.join(format!("launch/train/eflesh-{}.toml", self.name))
    }
}

/// The program, and one kind of recording.
struct Work<'a> {
    root: &'a Path,
    dermis: PathBuf,
    skin: PathBuf,
    bags: Vec<PathBuf>,
}

impl<'a> Work<'a> {
    /// Builds the program, and imports the recordings into a folder.
    fn begin(root: &'a Path, quantity: &Quantity, dir: &Path) -> Result<Self> {
        let dermis = programs::dermis(root)?;
        let bags = import(root, &dermis, quantity.folder, dir)?;
        Ok(Self { root, dermis, skin: root.join(format!("launch/skins/{}.toml", quantity.skin)), bags })
    }

    /// Learns a model from a bag.
    fn train(&self, config: &Path, bag: &Path, model: &Path, split: Option<&str>) -> Result<()> {
        let mut train = Command::new(&self.dermis);
        train.args(["train", "--config"]).arg(config).arg("--skin").arg(&self.skin);
        train.args(split.map(|split| ["--split", split]).iter().flatten()).arg("--out").arg(model).arg(bag);
        execute(train.current_dir(self.root))
    }

    /// Evaluates a model on a bag, or on what was held out of it.
    fn evaluate(&self, model: &Path, bag: &Path, held_out: bool) -> Result<Value> {
        let mut evaluate = Command::new(&self.dermis);
        evaluate.args(["evaluate", "--json", "--skin"]).arg(&self.skin).arg("--model").arg(model);
        if held_out {
            evaluate.arg("--held-out");
        }
        evaluation(evaluate.arg(bag).current_dir(self.root))
    }
}

/// Bags of all runs in a folder of recordings, in the order of their names.
fn import(root: &Path, dermis: &Path, folder: &str, dir: &Path) -> Result<Vec<PathBuf>> {
    let source = recordings(root).join("eflesh").join(folder);
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

/// Trains on each of the recorded runs with the shipped configuration and evaluates.
pub(super) fn recorded(root: &Path, quantity: &Quantity) -> Result<Value> {
    let dir = scratch(root, quantity.name)?;
    let work = Work::begin(root, quantity, &dir)?;
    let config = quantity.config(root);
    let of_position = quantity.name == POSITION.name;
    // The figures that the authors state hold out presses (or the end of a trial); ours hold out locations too.
    let splits: &[&str] = if of_position { &["press", "location"] } else { &["time"] };
    let mut rows = Vec::new();
    for (i, train) in work.bags.iter().enumerate() {
        for split in splits {
            let model = dir.join(format!("model-{i}-{split}"));
            work.train(&config, train, &model, Some(split))?;
            for (j, bag) in work.bags.iter().enumerate() {
                if i != j && *split == "press" {
                    continue;
                }
                let mut result = work.evaluate(&model, bag, i == j)?;
                shorten(&mut result);
                rows.push(json!({
                    "trained_on": name(train),
                    "tested_on": name(bag),
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
    Ok(if of_position {
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

/// Leaves of an evaluation what tables show.
fn shorten(evaluation: &mut Value) {
    let kept = ["frames", "missed", "false_contacts", "not_found", "figures", "quantities"];
    if let Some(object) = evaluation.as_object_mut() {
        object.retain(|key, _| kept.contains(&key.as_str()));
    }
}

/// Regressors that a bundle can hold, each alone; the shipped configuration lets `dermis train` choose among them.
const CANDIDATES: [&str; 3] = ["network", "vectors", "gaussian"];
/// What is called so is chosen among them.
const CHOSEN: &str = "chosen";

/// What `dermis train` chooses beside each regressor alone, on another run and on the end of the same.
pub(super) fn transfers(root: &Path) -> Result<Value> {
    let dir = scratch(root, "transfers")?;
    let mut rows = Vec::new();
    for quantity in [&POSITION, &FORCE, &SHEAR] {
        let work = Work::begin(root, quantity, &dir)?;
        for (i, bag) in work.bags.iter().enumerate() {
            let models = learn(&work, quantity, bag, &dir.join(format!("{}-{i}", quantity.name)))?;
            for (j, other) in work.bags.iter().enumerate().filter(|(j, _)| i != *j || quantity.same_run) {
                let mut errors = serde_json::Map::new();
                for (candidate, model) in &models {
                    let result = work.evaluate(model, other, i == j)?;
                    errors.insert((*candidate).into(), json!(error(&result, quantity)?));
                }
                rows.push(row(quantity, bag, other, &errors));
            }
        }
    }
    let ratios = || rows.iter().filter_map(|row| row["ratio_to_best"].as_f64());
    Ok(json!({
        "worst_ratio_to_best": ratios().fold(f64::NAN, f64::max),
        "best_chosen": ratios().filter(|ratio| *ratio <= 1.0).count(),
        "transfers": rows,
    }))
}

/// Models of one run in a folder: by the shipped configuration, which chooses, and by each regressor alone.
fn learn(
    work: &Work<'_>,
    quantity: &Quantity,
    bag: &Path,
    folder: &Path,
) -> Result<Vec<(&'static str, PathBuf)>> {
    std::fs::create_dir_all(folder)?;
    let shipped = read_toml(&quantity.config(work.root))?;
    let learn = |candidate: &'static str| {
        let mut config = shipped.clone();
        if candidate != CHOSEN {
            config.insert("model".into(), toml::toml! { candidates = [candidate] }.into());
        }
        let (file, model) = (folder.join(format!("{candidate}.toml")), folder.join(candidate));
        std::fs::write(&file, config.to_string())?;
        work.train(&file, bag, &model, None)?;
        Ok((candidate, model))
    };
    std::iter::once(CHOSEN).chain(CANDIDATES).map(learn).collect()
}

/// What positions are learned from: the ratios between channels and, in the second, the logarithm of their magnitude besides.
const INPUTS: [&str; 2] = ["ratios", "direction"];

/// A Gaussian process by each of [`INPUTS`], learned from each run: its mean error \[mm\] on unseen locations of that run and on the other.
pub(super) fn inputs(root: &Path) -> Result<Value> {
    let dir = scratch(root, "inputs")?;
    let work = Work::begin(root, &POSITION, &dir)?;
    let mut config = read_toml(&POSITION.config(root))?;
    config.insert("model".into(), toml::toml! { candidates = ["gaussian"] }.into());
    let mut rows = Vec::new();
    for (i, bag) in work.bags.iter().enumerate() {
        let mut learn = |input: &'static str| -> Result<_> {
            config["network"]["input"] = input.into();
            let (file, model) = (dir.join(format!("{input}-{i}.toml")), dir.join(format!("{input}-{i}")));
            std::fs::write(&file, config.to_string())?;
            work.train(&file, bag, &model, Some("location"))?;
            Ok((input, model))
        };
        let models = INPUTS.into_iter().map(&mut learn).collect::<Result<Vec<_>>>()?;
        for (j, other) in work.bags.iter().enumerate() {
            let mut errors = serde_json::Map::new();
            for (input, model) in &models {
                let result = work.evaluate(model, other, i == j)?;
                errors.insert((*input).into(), json!(error(&result, &POSITION)?));
            }
            rows.push(json!({
                "trained_on": name(bag),
                "tested_on": if i == j { Some("its unseen locations".to_owned()) } else { name(other) },
                "errors_mm": errors,
            }));
        }
    }
    Ok(json!({ "rows": rows }))
}

/// The figure of an evaluation that transfers are judged by, in its unit.
fn error(result: &Value, quantity: &Quantity) -> Result<f64> {
    let figure = result["figures"][quantity.figure].as_f64();
    Ok(figure.with_context(|| format!("no {} was measured", quantity.figure))? * quantity.unit.1)
}

fn name(bag: &Path) -> Option<String> {
    bag.file_name().map(|n| n.to_string_lossy().into_owned())
}

/// Errors of one transfer, and what is chosen over the best of those that were alone.
fn row(quantity: &Quantity, from: &Path, to: &Path, errors: &serde_json::Map<String, Value>) -> Value {
    let of = |candidate: &str| errors.get(candidate).and_then(Value::as_f64);
    let best = CANDIDATES.iter().filter_map(|c| of(c)).fold(f64::NAN, f64::min);
    json!({
        "quantity": quantity.name,
        "figure": quantity.figure,
        "unit": quantity.unit.0,
        "trained_on": name(from),
        "tested_on": if from == to { Some("its last part, held out".to_owned()) } else { name(to) },
        "ratio_to_best": of(CHOSEN).map(|chosen| chosen / best),
        "errors": errors,
    })
}
