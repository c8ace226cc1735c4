//! Networks on pictures of the soft thumb: the thesis' ResNet-18 beside a small one.
//!
//! Problem: what does a network make of pictures, where the node inverts the forward model, and at which cost? Method: `dermis collect`
//! presses the simulated thumb by the plan that networks learn from, and by the one that everything is measured on; PyTorch fits both
//! networks to the same pictures (`benches/python/insight_pictures.py`); `dermis evaluate --answers` measures what they say, as it
//! measures what the node finds in the very same frames (`cargo xtask measure insight`). Cost: on two cores hours for 600 locations
//! and 32 epochs, minutes on a GPU. An interrupted run goes on with its bags.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use clap::Args;
use serde_json::{Map, Value, json};
use toml::Value as Toml;

use super::insight::{BINS, MAP_PLAN, SKIN, summary};
use super::{at_once, collected, evaluation, fingerprint, read_toml};
use crate::run::run as execute;
use crate::{environment, programs};

const EVALUATION: &str = "launch/plans/insight-thumb-evaluate.toml";
const SCRIPT: &str = "benches/python/insight_pictures.py";
const NETWORKS: [&str; 2] = ["small", "resnet18"];
const THESIS_LOCATIONS: u32 = 3800;
const THESIS_EPOCHS: u32 = 32;
/// Across and down, of the pictures and of what the thesis' network sees.
const PIXELS: [u32; 2] = [410, 308];
/// Steps of the plan that press.
const PRESSING: u32 = 2;
/// Share of the untouched frames, which are alike and half of all, that every epoch learns from, drawn anew.
const UNTOUCHED: f64 = 0.3;

/// How much of it is done.
#[derive(Args)]
pub struct Options {
    /// Locations that are learned from, a quarter of them to choose by.
    #[arg(long, default_value_t = 600)]
    locations: u32,
    /// Passes over the training part.
    #[arg(long, default_value_t = THESIS_EPOCHS)]
    epochs: u32,
    /// The ResNet learns from means of this many pixels across and down: 4 is what two cores learn from in an hour.
    #[arg(long, default_value_t = 1)]
    shrink: u32,
    /// Bags that the locations are shared among, collected at once; other parts are other locations.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    /// What PyTorch trains on: `cpu` or `cuda`.
    #[arg(long, default_value = "cpu")]
    device: String,
    /// Python that has what benches/python/pictures.lock.txt names, e.g. with a PyTorch for a GPU; an environment of its own where absent.
    #[arg(long)]
    python: Option<PathBuf>,
}

/// Collects, fits and measures.
pub(super) fn networks(root: &Path, options: &Options) -> Result<Value> {
    let jobs = u32::try_from(options.jobs).unwrap_or(u32::MAX);
    if options.epochs == 0 || options.shrink == 0 || jobs == 0 || options.locations / jobs < 4 {
        bail!("--epochs, --shrink and --jobs are at least 1, and --locations at least 4 for each job");
    }
    let python = options.python.clone().map_or_else(|| environment::pictures(root), Ok)?;
    let dermis = programs::dermis(root)?;
    let plan = read_toml(&root.join(MAP_PLAN))?;
    let files = [SKIN, MAP_PLAN, EVALUATION].map(PathBuf::from);
    // Of another commit the program that collects may differ.
    let name = fingerprint(root, &files, (crate::record::commit(root)?, options.locations, jobs))?;
    let dir = root.join(".dermis/measure/insight-pictures").join(format!("{name:016x}"));
    std::fs::create_dir_all(&dir)?;

    let parts: Vec<(String, Toml)> = (0..jobs)
        .map(|part| (format!("train-{part}"), part_of(&plan, options.locations, part, jobs)))
        .chain([("evaluate".to_owned(), Toml::Table(read_toml(&root.join(EVALUATION))?))])
        .collect();
    let mut bags = at_once(options.jobs, &parts, |(name, plan)| {
        let file = dir.join(format!("{name}.toml"));
        std::fs::write(&file, toml::to_string(plan)?)?;
        let mut collect = Command::new(&dermis);
        collect.args(["collect", SKIN, "--plan"]).arg(&file).current_dir(root);
        let bag = dir.join(name);
        collected(&mut collect, &bag)?;
        Ok(bag)
    })?;
    let evaluated = bags.pop().context("no bag was collected")?;

    let learned = dir.join("learned.json");
    let mut answers = evaluated.clone().into_os_string();
    answers.push("=");
    answers.push(dir.join("{network}.jsonl"));
    let mut learn = Command::new(&python);
    learn.arg(root.join(SCRIPT)).args(NETWORKS.iter().flat_map(|name| ["--network", name]));
    learn.arg("--train").args(&bags).arg("--answer").arg(answers).arg("--out").arg(&learned);
    learn.args(["--device", &options.device, "--epochs", &options.epochs.to_string()]);
    learn.args(["--untouched", &UNTOUCHED.to_string(), "--shrink", &options.shrink.to_string()]);
    execute(learn.current_dir(root))?;
    let mut learned = crate::record::read(&learned)?;

    let mut found = Map::new();
    for name in NETWORKS {
        let mut evaluate = Command::new(&dermis);
        evaluate.args(["evaluate", "--json", "--skin", SKIN, "--bins", BINS, "--answers"]);
        evaluate.arg(dir.join(format!("{name}.jsonl"))).arg(&evaluated).current_dir(root);
        let said = evaluation(&mut evaluate)?;
        let mut of = summary(&said)?;
        of["false_contacts"] = said["false_contacts"].clone();
        of["learned"] = learned["networks"][name].take();
        let seconds = of["learned"]["one_frame_one_thread_s"].as_f64();
        of["frames_per_cpu_second"] = json!(seconds.map(f64::recip));
        found.insert(name.to_owned(), of);
    }
    if let Some(learned) = learned.as_object_mut() {
        learned.remove("networks");
    }
    Ok(json!({
        "reduced": {
            "locations": { "here": options.locations, "thesis": THESIS_LOCATIONS },
            "epochs": { "here": options.epochs, "thesis": THESIS_EPOCHS },
            "resnet18_pixels": { "here": PIXELS.map(|n| n / options.shrink), "thesis": PIXELS },
        },
        "training": learned,
        "networks": found,
    }))
}

/// The plan with a part of all locations, which no other part has.
fn part_of(plan: &toml::Table, locations: u32, part: u32, parts: u32) -> Toml {
    let mut plan = plan.clone();
    let seed = plan.get("seed").and_then(Toml::as_integer).unwrap_or_default();
    // Other plans that ship have the numbers beside it.
    plan.insert("seed".into(), Toml::Integer(seed * 1000 + i64::from(part)));
    let count = locations / parts + u32::from(part < locations % parts);
    let mut left = count;
    for step in plan.get_mut("steps").and_then(Toml::as_array_mut).into_iter().flatten() {
        if let Some(number) = step.get_mut("count") {
            let of_step = left.min(count.div_ceil(PRESSING));
            *number = Toml::Integer(of_step.into());
            left -= of_step;
        }
    }
    Toml::Table(plan)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_all_locations_and_seeds_of_their_own() {
        let plan = read_toml(&Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(MAP_PLAN)).unwrap();
        let parts: Vec<Toml> = (0..3).map(|part| part_of(&plan, 50, part, 3)).collect();
        let counts: Vec<Vec<i64>> = parts
            .iter()
            .map(|plan| {
                let steps = plan["steps"].as_array().unwrap().iter();
                steps.filter_map(|step| step.get("count")?.as_integer()).collect()
            })
            .collect();
        assert_eq!(counts, [[9, 8], [9, 8], [8, 8]]);
        let seeds: Vec<i64> = parts.iter().map(|plan| plan["seed"].as_integer().unwrap()).collect();
        assert_eq!(seeds, [260_000, 260_001, 260_002]);
    }
}
