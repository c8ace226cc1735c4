//! The diagnosis of gaps between a simulated skin and a real one.
//!
//! Problem: how often does it name the right cause, and what does a corrected simulation gain? Method: benchmark sets with
//! withheld causes, scored by `dermis gap benchmark run`; and one device whose elements read half too much, diagnosed and closed
//! by `dermis gap close` as people do. Assumptions: devices are simulated. Cost: hours of CPU time for the benchmark; some minutes
//! for the other.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::{Map, Value, json};

use super::{LIMB, evaluation, scratch};
use crate::programs;
use crate::record;
use crate::run::run as execute;

/// Which skins the benchmark is made for.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Of these skins only: line, grid, shin, panel or thumb; of all where absent.
    #[arg(value_parser = name)]
    skins: Vec<&'static str>,
    /// Cases of each of the seven cells of panel and thumb.
    #[arg(long, default_value_t = 18, value_parser = clap::value_parser!(u32).range(1..=1000))]
    cells: u32,
    /// Presses of each case of panel and thumb, compared to the usual 150; 0.5 and 0.3 where absent.
    #[arg(long)]
    size: Option<f64>,
}

fn name(text: &str) -> Result<&'static str, String> {
    let found = GAPS.iter().map(|gap| gap.name).find(|name| *name == text);
    let known = GAPS.map(|gap| gap.name).join(", ");
    found.ok_or_else(|| format!("`{text}` is no skin of the benchmark; there are {known}"))
}

/// A skin that gaps are diagnosed on.
#[derive(Debug, Clone, Copy)]
struct Gap {
    name: &'static str,
    skin: &'static str,
    /// What is written in its file in place of what: a simulator in fewer cells, where a diagnosis makes dozens of it that take
    /// minutes each.
    coarser: &'static [(&'static str, &'static str)],
    sets: Sets,
}

/// Which sets are made of a skin.
#[derive(Debug, Clone, Copy)]
enum Sets {
    /// All kinds in the proportions of a full set, and controls; by these seeds.
    Full([&'static str; 2]),
    /// By cells, by this seed, with so many presses compared to the usual 150.
    Cells(&'static str, f64),
}

const GAPS: [Gap; 5] = [
    Gap {
        name: "line",
        skin: "launch/skins/baro-line.toml",
        coarser: &[],
        sets: Sets::Full(["50521", "50531"]),
    },
    Gap {
        name: "grid",
        skin: "nodes/barodome/skins/baro-grid-wide.toml",
        coarser: &[],
        sets: Sets::Full(["50502", "50512"]),
    },
    Gap { name: "shin", skin: LIMB, coarser: &[], sets: Sets::Full(["61603", "61613"]) },
    Gap { name: "panel", skin: "launch/skins/ert-panel.toml", coarser: &[], sets: Sets::Cells("50524", 0.5) },
    Gap {
        name: "thumb",
        skin: "launch/skins/insight-thumb.toml",
        coarser: COARSE_THUMB,
        sets: Sets::Cells("50505", 0.3),
    },
];
/// The thumb's elastomer in fewer cells, between points that are farther apart: a basis of seconds in place of minutes. Pictures
/// and their numbers are those of the thumb that ships.
const COARSE_THUMB: &[(&str, &str)] = &[
    ("name = \"insight-thumb\"", "name = \"insight-thumb-coarse\""),
    ("spacing = 0.001135", "spacing = 0.0025"),
    ("cells = [88, 5]", "cells = [44, 5]"),
    ("grid = 0.00125", "grid = 0.0025"),
];
/// Share of the full proportions, and controls that make up for what lacks of them.
const GAP_SHARE: &str = "0.5";
const GAP_CONTROLS: &str = "50";
/// How recordings of panel and thumb are diagnosed. They read much where nothing touches, and the benchmark measures a gap by what
/// touches change: readings are counted from what the device reads when it is switched on.
const TARED: [&str; 5] = ["--no-baselines", "--", "--zero", "start", "--resamples=4"];

impl Gap {
    /// The skin file, or a coarser copy of it in `dir`.
    fn file(&self, root: &Path, dir: &Path) -> Result<PathBuf> {
        let path = root.join(self.skin);
        if self.coarser.is_empty() {
            return Ok(path);
        }
        let mut text = dermis_io::read_text(&path, dermis_io::TEXT)
            .with_context(|| format!("{} cannot be read", path.display()))?;
        for (fine, coarse) in self.coarser {
            if !text.contains(fine) {
                bail!("{} has no `{fine}`, which its coarser copy changes", path.display());
            }
            text = text.replace(fine, coarse);
        }
        let copy = dir.join(format!("{}.toml", self.name));
        std::fs::write(&copy, text).with_context(|| format!("{} cannot be written", copy.display()))?;
        Ok(copy)
    }
}

impl Sets {
    /// What is appended to the name of each set's folder, and the arguments that make it.
    fn orders(self, options: &Options) -> Vec<(&'static str, Vec<String>)> {
        let words = |text: &str| text.split_whitespace().map(str::to_owned).collect();
        match self {
            Self::Full([kinds, controls]) => vec![
                ("", words(&format!("--seed {kinds} --share {GAP_SHARE}"))),
                ("-controls", words(&format!("--seed {controls} --kind controls --count {GAP_CONTROLS}"))),
            ],
            Self::Cells(seed, size) => {
                let (cells, size) = (options.cells, options.size.unwrap_or(size));
                vec![("", words(&format!("--seed {seed} --cells {cells} --size {size}")))]
            }
        }
    }
}

/// Diagnoses benchmark sets with withheld causes.
pub(super) fn benchmark(root: &Path, options: &Options) -> Result<Value> {
    let dermis = programs::dermis(root)?;
    let dir = scratch(root, "gap")?;
    let mut found = Map::new();
    let wanted = |gap: &&Gap| options.skins.is_empty() || options.skins.contains(&gap.name);
    for gap in GAPS.iter().filter(wanted) {
        let Gap { name, sets, .. } = gap;
        let folder = |what: &str| dir.join(format!("{name}{what}"));
        let skin = gap.file(root, &dir)?;
        let mut check = Command::new(&dermis);
        check.args(["gap", "benchmark", "run", "--jobs", "2", "--out"]).arg(folder("-out"));
        for (of, order) in sets.orders(options) {
            let (set, truth) = (folder(of), folder(&format!("{of}-truth")));
            let mut make = Command::new(&dermis);
            make.args(["gap", "benchmark", "generate", "--skin"]).arg(&skin).args(order);
            execute(make.arg("--truth").arg(&truth).arg("-o").arg(&set).current_dir(root))?;
            check.arg("--set").arg(set).arg("--truth").arg(truth);
        }
        if matches!(sets, Sets::Cells(..)) {
            check.args(TARED);
        }
        execute(check.current_dir(root))?;
        let summary = record::read(&folder("-out").join("summary.json"))?;
        let record = format!("gap-check-{name}");
        record::keep(root, &record, &summary)?;
        std::fs::copy(folder("-out").join("summary.svg"), record::path(root, &record).with_extension("svg"))?;
        found.insert((*name).to_owned(), summary);
    }
    Ok(Value::Object(found))
}

/// The row, what its device differs by from its design, and the seed of both of its recordings: it draws the device.
const ROW: &str = "launch/skins/baro-line.toml";
const EFFECT: &str = "inclusion-gain=1.5";
const SEED: &str = "5";
/// Recordings of the device, the diagnosed one and the held-out one, and their steps: forces that drive no channel to its end.
const RECORDINGS: [(&str, &str); 2] = [
    ("real", r#"kind = "presses", count = 120, force = [0.05, 0.5]"#),
    ("held-out", r#"kind = "grid", pitch = 0.0021, forces = [0.1, 0.2, 0.4], repeats = 1"#),
];
/// What reports call the errors that tables show.
const ERRORS: [(&str, &str); 4] = [
    ("position_rms_m", "root mean square error of the position [m]"),
    ("position_median_m", "median error of the position [m]"),
    ("force_rms_n", "root mean square error of the pressing force [N]"),
    ("missed", "share of missed contacts [1]"),
];

/// Diagnoses a device, and trains on the nominal and on the corrected simulation.
pub(super) fn close(root: &Path) -> Result<Value> {
    let dermis = programs::dermis(root)?;
    let dir = scratch(root, "gap-close")?;
    let mut bags = Vec::new();
    for (name, steps) in RECORDINGS {
        let (plan, bag) = (dir.join(format!("{name}.toml")), dir.join(name));
        std::fs::write(&plan, plan_of(name, steps))?;
        let mut collect = Command::new(&dermis);
        collect.args(["collect", ROW, "--effect", EFFECT, "--seed", SEED, "--plan"]).arg(plan);
        execute(collect.arg("--out").arg(&bag).current_dir(root))?;
        bags.push(bag);
    }
    let mut close = Command::new(&dermis);
    close.args(["gap", "close", "--json", "--skin", ROW, "--refine", "line"]);
    close.args(["--plan", "launch/plans/baro-line-train.toml", "--config", "launch/train/baro-line.toml"]);
    close.arg("--real").arg(&bags[0]).arg("--held-out").arg(&bags[1]).arg("--out").arg(dir.join("closed"));
    gained(&evaluation(close.current_dir(root))?)
}

/// A plan of presses with a ball of 4 mm.
fn plan_of(name: &str, steps: &str) -> String {
    format!(
        r#"schema = "dermis-plan/1"
name = "{name}"
seed = {SEED}
diameter = 0.004
timing = {{ approach = [0.03, 0.05], load = [0.05, 0.1], hold = [0.2, 0.3], unload = [0.05, 0.1], gap = [0.1, 0.2] }}
steps = [{{ kind = "idle", duration = 2.0 }}, {{ {steps} }}]
"#
    )
}

/// What was named, and the errors before and after.
fn gained(report: &Value) -> Result<Value> {
    let mut found = Map::new();
    for (name, metric) in ERRORS {
        let mut all = report["downstream"].as_array().into_iter().flatten();
        let error = all
            .find(|error| error["metric"].as_str().is_some_and(|text| text.ends_with(&format!(": {metric}"))))
            .with_context(|| format!("the report has no {metric}: {}", report["sentence"]))?;
        found.insert(name.to_owned(), json!({ "before": error["before"], "after": error["after"] }));
    }
    found.insert("device".to_owned(), json!(EFFECT));
    for key in ["verdict", "sentence", "residual_reduction"] {
        found.insert(key.to_owned(), report[key].clone());
    }
    Ok(Value::Object(found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skin_is_known_by_its_name_and_has_its_sets() {
        assert_eq!(name("thumb"), Ok("thumb"));
        assert!(name("finger").unwrap_err().contains("line, grid, shin, panel, thumb"));
        let options = Options { skins: Vec::new(), cells: 3, size: None };
        let orders = |name: &str| {
            let gap = GAPS.iter().find(|gap| gap.name == name).unwrap();
            gap.sets.orders(&options).into_iter().map(|(_, order)| order.join(" ")).collect::<Vec<_>>()
        };
        assert_eq!(orders("panel"), ["--seed 50524 --cells 3 --size 0.5"]);
        assert_eq!(orders("line"), ["--seed 50521 --share 0.5", "--seed 50531 --kind controls --count 50"]);
    }

    #[test]
    fn a_coarser_copy_is_one_of_what_ships() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let dir = tempfile::tempdir().unwrap();
        for gap in GAPS {
            let text = std::fs::read_to_string(gap.file(&root, dir.path()).unwrap()).unwrap();
            assert!(gap.coarser.iter().all(|(fine, coarse)| !text.contains(fine) && text.contains(coarse)));
        }
    }

    #[test]
    fn plans_are_toml() {
        for (name, steps) in RECORDINGS {
            let plan: toml::Table = plan_of(name, steps).parse().unwrap();
            assert_eq!(
                (plan["seed"].as_integer(), plan["steps"][1]["kind"].as_str().is_some()),
                (Some(5), true)
            );
        }
    }

    #[test]
    fn what_a_report_gained_is_found_by_its_metric() {
        let error = |metric: &str, before: f64| json!({ "metric": format!("estimator on a held-out real recording: {metric}"), "before": before, "after": 0.1 });
        let mut report = json!({
            "sentence": "s", "verdict": "named",
            "downstream": [error(ERRORS[1].1, 2.0), error(ERRORS[0].1, 1.0), error(ERRORS[2].1, 3.0), error(ERRORS[3].1, 0.2)],
        });
        let found = gained(&report).unwrap();
        assert_eq!(found["position_rms_m"], json!({ "before": 1.0, "after": 0.1 }));
        assert_eq!(found["position_median_m"]["before"], 2.0);
        report["downstream"] = json!([]);
        let error = gained(&report).unwrap_err().to_string();
        assert_eq!(error, "the report has no root mean square error of the position [m]: \"s\"");
    }
}
