//! Measurements behind `targets.toml`; each prints one line of JSON at the end.

use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use serde_json::{Value, json};

use crate::run::{cargo, output, run as execute, target_dir};
use crate::test::{BUILD, WITHOUT_ROS};

/// What can be measured.
#[derive(Subcommand)]
pub enum Measurement {
    /// CPU minutes and wall minutes of the README's first command on a fresh clone with an empty target folder.
    ColdBuild,
    /// Localisation on a recorded magnetic skin: import, train on one run, evaluate on held-out presses, on unseen
    /// locations and on the other run.
    Localisation,
    /// Normal force on the same kind of skin: import, train on the first part of a trial, evaluate on its end and on
    /// the other trial.
    Force,
    /// Position and force by the model bundles that ship for the simulated barometer skins, on places and forces that
    /// they were not trained on, against the Cramér–Rao bound.
    Accuracy,
    /// The same by networks that are trained and measured on devices with the default effects, against what the thesis
    /// measured on its real ones (Table 5.2).
    Realism,
    /// Single contacts on the limb with strain gauges by the bundle that ships: as designed, with one dead gauge that nobody
    /// told the node of, and on a device with the default effects; as designed beside support vectors, nearest neighbours and a
    /// network that learn from the same presses.
    Limb,
    /// One and two contacts on a limb with the default effects: all ways, learned from recorded single contacts.
    Real2sim,
    /// Seconds from `kill -9` of a node under `launch` to the contacts of the one that comes after it.
    Restart,
    /// Seconds from the start of a node's process until a subscriber has contacts with status OK, with an empty and with a warm
    /// cache.
    Start,
    /// The diagnosis of gaps on packs with withheld causes, for the row of barometers, the pad and the limb.
    Gap,
}

/// Skins that gaps are diagnosed on, and the seeds of their packs: of all kinds, and of controls only.
const GAPS: [(&str, &str, [&str; 2]); 3] = [
    ("line", "launch/skins/baro-line.toml", ["50521", "50531"]),
    ("grid", "crates/gap-benchmark/skins/baro-grid-wide.toml", ["50502", "50512"]),
    ("shin", LIMB, ["50503", "50513"]),
];
/// Share of the full proportions, and controls that make up for what lacks of them.
const GAP_SHARE: &str = "0.5";
const GAP_CONTROLS: &str = "50";

pub fn run(root: &Path, measurement: &Measurement) -> Result<()> {
    let value = match measurement {
        Measurement::ColdBuild => cold_build(root)?,
        Measurement::Localisation => recorded(root, "position", "spatial_resolution")?,
        Measurement::Accuracy => accuracy(root)?,
        Measurement::Realism => realism(root)?,
        Measurement::Limb => limb(root)?,
        Measurement::Real2sim => real2sim(root)?,
        Measurement::Start => start(root)?,
        Measurement::Gap => gap(root)?,
        Measurement::Restart => restart(root)?,
        Measurement::Force => recorded(root, "force", "normal_force")?,
    };
    println!("{value}");
    Ok(())
}

fn scratch(root: &Path, name: &str) -> Result<PathBuf> {
    let dir = root.join(".dermis/measure").join(name);
    if dir.exists() {
        std::fs::remove_dir_all(&dir)?;
    }
    std::fs::create_dir_all(&dir)?;
    Ok(dir)
}

/// What a command with `--json` prints in its last line.
fn evaluation(command: &mut Command) -> Result<Value> {
    let text = output(command)?;
    serde_json::from_str(text.trim().lines().last().unwrap_or_default())
        .context("a command with --json printed no JSON")
}

/// CPU seconds of all children that ended so far.
fn children_cpu() -> Result<f64> {
    use nix::sys::resource::{UsageWho, getrusage};
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN)?;
    let seconds = |t: nix::sys::time::TimeVal| t.tv_sec() as f64 + t.tv_usec() as f64 * 1e-6;
    Ok(seconds(usage.user_time()) + seconds(usage.system_time()))
}

/// By the programs that are measured for speed, with the bundles that ship.
fn start(root: &Path) -> Result<Value> {
    execute(cargo(root).args(PROGRAM))?;
    execute(cargo(root).args(["build", "--release", "-p", "dermis-benches"]))?;
    let programs = target_dir(root).join("release");
    let mut bench = Command::new(programs.join("dermis-bench"));
    evaluation(bench.arg("start").arg("--programs").arg(&programs).arg("--root").arg(root).current_dir(root))
}

fn cold_build(root: &Path) -> Result<Value> {
    let dir = scratch(root, "cold-build")?;
    let clone = dir.join("dermis");
    execute(Command::new("git").args(["clone", "--quiet", "--no-local"]).arg(root).arg(&clone))?;
    // Downloading is not building.
    execute(cargo(&clone).arg("fetch").arg("--quiet"))?;
    let (cpu, wall) = (children_cpu()?, Instant::now());
    execute(cargo(&clone).args(["build", "--release"]).env("CARGO_TARGET_DIR", dir.join("target")))?;
    let value = json!({
        "cpu_minutes": (children_cpu()? - cpu) / 60.0,
        "wall_minutes": wall.elapsed().as_secs_f64() / 60.0,
    });
    std::fs::remove_dir_all(&dir)?;
    Ok(value)
}

/// Force [N] from which on the simulated skins are held to their bounds, and where further bins begin (thesis, Table 5.2).
const BINS: &str = "0.2,0.4,0.6,0.9,1.2";

/// Evaluates the bundles that ship on freshly collected bags.
fn accuracy(root: &Path) -> Result<Value> {
    execute(cargo(root).args(BUILD).args(WITHOUT_ROS))?;
    let dermis = target_dir(root).join("release/dermis");
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
        let evaluate = |bins: &str, in_range: bool| -> Result<Value> {
            evaluation(
                Command::new(&dermis)
                    .arg("evaluate")
                    .args(in_range.then_some("--in-range"))
                    .args(["--skin".as_ref(), skin.as_os_str()])
                    .args(["--model".as_ref(), root.join(format!("models/baro-{name}")).as_os_str()])
                    .args(["--bins", bins, "--json"])
                    .arg(&bag),
            )
        };
        let (whole, binned) = (evaluate("0.2", true)?, evaluate(BINS, true)?);
        // Saturation is an effect of the device: its cost stands apart.
        let saturated = evaluate("0.2", false)?;
        let above = |quantity: &str| whole["by_force"][quantity][0]["rms"].as_f64();
        let rms = |bins: &Value, from: &Value| {
            bins.as_array().into_iter().flatten().find(|b| b["from"] == *from).and_then(|b| b["rms"].as_f64())
        };
        let ratios: Vec<f64> = binned["bound"]["position"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|bin| {
                Some(rms(&binned["by_force"]["position"], &bin["from"])? / bin["rms"].as_f64()?)
            })
            .collect();
        let component = |axis: &str| whole["figures"][format!("force_{axis}_median")].as_f64();
        all.insert(
            name.to_owned(),
            json!({
                "position_rms_mm": above("position").map(|v| v * 1e3),
                "position_rms_with_saturation_mm":
                    saturated["by_force"]["position"][0]["rms"].as_f64().map(|v| v * 1e3),
                "force_rms_n": above("force.normal"),
                "worst_ratio_to_bound": ratios.iter().copied().fold(f64::NAN, f64::max),
                "position_median_mm": whole["figures"]["position_median"].as_f64().map(|v| v * 1e3),
                "force_median_n": whole["figures"]["force_median"].as_f64(),
                "force_component_medians_n": [component("x"), component("y"), component("z")],
                "count_right": whole["count_right"],
                "position": binned["by_force"]["position"],
                "bound": binned["bound"]["position"],
                "several": { "position": binned["by_force"]["position of 2"], "of_3": binned["by_force"]["position of 3"] },
            }),
        );
    }
    Ok(Value::Object(all))
}

/// What measures the limb: only the program itself.
const PROGRAM: [&str; 4] = ["build", "--release", "--package", "dermis"];
/// The limb's skin, and a file of its effects as a command takes it.
const LIMB: &str = "launch/skins/hapdef-shin.toml";
const LIMB_EFFECTS: &str = "launch/effects/hapdef-default.toml";

/// A bag of the limb under a plan, made anew only where the skin, the plan or what makes the device differ have changed since.
fn limb_bag(root: &Path, dermis: &Path, plan: &str, device: &[&str]) -> Result<PathBuf> {
    let plan = root.join(format!("launch/plans/hapdef-shin-{plan}.toml"));
    let mut hasher = std::hash::DefaultHasher::new();
    for file in [&root.join(LIMB), &plan, &root.join(LIMB_EFFECTS)] {
        std::fs::read(file).with_context(|| format!("{} cannot be read", file.display()))?.hash(&mut hasher);
    }
    device.hash(&mut hasher);
    let folder = root.join(".dermis/measure/bags");
    std::fs::create_dir_all(&folder)?;
    let bag = folder.join(format!("limb-{:016x}", hasher.finish()));
    if !bag.exists() {
        // Under another name until it is whole: an interrupted one has metadata, too.
        let partial = bag.with_extension("partial");
        if partial.exists() {
            std::fs::remove_dir_all(&partial)?;
        }
        let mut collect = Command::new(dermis);
        collect.arg("collect").arg(LIMB).arg("--plan").arg(&plan).args(device).arg("--json");
        let report = evaluation(collect.arg("--out").arg(&partial).current_dir(root))?;
        if report["interrupted"] != false {
            bail!("collecting {} was interrupted: run the measurement again", plan.display());
        }
        std::fs::rename(&partial, &bag)?;
    }
    Ok(bag)
}

/// Evaluates the limb's bundle in the bins of force of the thesis' Table 2.2.
fn limb(root: &Path) -> Result<Value> {
    execute(cargo(root).args(PROGRAM))?;
    let dermis = target_dir(root).join("release/dermis");
    let devices: [(&str, &[&str]); 3] = [
        ("designed", &[]),
        ("one dead gauge", &["--effect", "dead-gauge=1", "--seed", "3"]),
        ("default effects", &["--effects", LIMB_EFFECTS, "--seed", "7"]),
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
                let by = &other["evaluation"]["by_force"];
                let row = json!({
                    "settings": other["settings"], "position": by["position"], "force": by["force.normal"],
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
                "position": found["by_force"]["position"],
                "force": found["by_force"]["force.normal"],
                "bound": found["bound"],
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
    let ours = errors(&all["designed"]);
    let margin = all["designed"]["beside"].as_object().into_iter().flatten().flat_map(|(_, row)| {
        errors(row).into_iter().zip(&ours).map(|(other, own)| other / own).collect::<Vec<_>>()
    });
    let margin = margin.fold(f64::INFINITY, f64::min);
    all.insert("margin".to_owned(), json!(margin));
    Ok(Value::Object(all))
}

/// Learns from single contacts of one device with the default effects, and compares all ways on its doubles.
fn gap(root: &Path) -> Result<Value> {
    execute(cargo(root).args(PROGRAM))?;
    let dermis = target_dir(root).join("release/dermis");
    let dir = scratch(root, "gap")?;
    let mut found = serde_json::Map::new();
    for (name, skin, seeds) in GAPS {
        let folder = |what: &str| dir.join(format!("{name}{what}"));
        let kinds: [&[&str]; 2] = [&["--share", GAP_SHARE], &["--kind", "controls", "--count", GAP_CONTROLS]];
        let mut check = Command::new(&dermis);
        check.args(["gap", "benchmark", "run", "--jobs", "2", "--out"]).arg(folder("-out"));
        for ((kind, seed), of) in kinds.into_iter().zip(seeds).zip(["", "-controls"]) {
            let (pack, secret) = (folder(of), folder(&format!("{of}-secret")));
            let mut make = Command::new(&dermis);
            make.args(["gap", "benchmark", "generate", "--skin", skin, "--seed", seed]).args(kind);
            execute(make.arg("--secret").arg(&secret).arg("-o").arg(&pack).current_dir(root))?;
            check.arg("--pack").arg(pack).arg("--secret").arg(secret);
        }
        execute(check.current_dir(root))?;
        let summary = std::fs::read(folder("-out").join("summary.json"))?;
        found.insert(name.to_owned(), serde_json::from_slice(&summary)?);
    }
    Ok(Value::Object(found))
}

/// Kills a node under `launch`, and waits for its contacts.
fn restart(root: &Path) -> Result<Value> {
    execute(cargo(root).args(BUILD).args(WITHOUT_ROS))?;
    let bench = target_dir(root).join("release/dermis-bench");
    evaluation(Command::new(bench).arg("restart").current_dir(root))
}

fn real2sim(root: &Path) -> Result<Value> {
    execute(cargo(root).args(PROGRAM))?;
    let dermis = target_dir(root).join("release/dermis");
    let dir = scratch(root, "real2sim")?;
    let device = ["--effects", LIMB_EFFECTS, "--seed", "7"];
    let (train, doubles) =
        (limb_bag(root, &dermis, "train", &device)?, limb_bag(root, &dermis, "doubles", &device)?);
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
                            "count_right": row["count_right"], "frames": row["frames"] }),
                );
            }
        }
        let double = json!({ "position_mean_mm": place / frames * 1e3, "force_mean_n": force / frames });
        all.insert("double".to_owned(), double);
        Value::Object(all)
    };
    Ok(json!({
        "corrected": rows("corrected model, all pairs"),
        "hapdefx": rows("hapdef-shin-real2sim: peaks"),
        "asks": found["asks"],
    }))
}

/// Table 5.2 of the thesis: RMS errors [mm] of its networks on real sensors, in the bins of [`BINS`].
const THESIS: [(&str, [f64; 5]); 2] =
    [("line", [0.051, 0.032, 0.024, 0.019, 0.018]), ("grid", [0.158, 0.120, 0.107, 0.107, 0.120])];

/// Trains and evaluates on one device with the default effects.
fn realism(root: &Path) -> Result<Value> {
    execute(cargo(root).args(BUILD).args(WITHOUT_ROS))?;
    let dermis = target_dir(root).join("release/dermis");
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
                "position_median_mm": found["figures"]["position_median"].as_f64().map(|v| v * 1e3),
            }),
        );
    }
    Ok(Value::Object(all))
}

/// Trains on each of the recorded runs with `launch/train/eflesh-<what>.toml` and evaluates.
fn recorded(root: &Path, what: &str, folder: &str) -> Result<Value> {
    let data = std::env::var("DERMIS_DATA").map_or_else(|_| root.join("../shared/data"), PathBuf::from);
    let source = data.join("eflesh").join(folder);
    let mut runs: Vec<PathBuf> = std::fs::read_dir(&source)
        .with_context(|| format!("{} is missing: set DERMIS_DATA", source.display()))?
        .map(|e| e.map(|e| e.path()))
        .collect::<Result<_, _>>()?;
    runs.sort();
    execute(cargo(root).args(BUILD).args(WITHOUT_ROS))?;
    let dermis = target_dir(root).join("release/dermis");
    let dir = scratch(root, what)?;
    let mut bags = Vec::new();
    for run in &runs {
        let bag = dir.join(run.file_name().unwrap_or_default());
        execute(Command::new(&dermis).arg("import").arg(run).arg("-o").arg(&bag).current_dir(root))?;
        bags.push(bag);
    }
    let config = root.join(format!("launch/train/eflesh-{what}.toml"));
    let skin = root.join("launch/skins/eflesh.toml");
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
            "press_mean_mm": worst("press", "position_mean", 1e3),
            "press_rms_mm": worst("press", "position_rms", 1e3),
            "location_mean_mm": worst("location", "position_mean", 1e3),
            "location_rms_mm": worst("location", "position_rms", 1e3),
            "other_run_mean_mm": worst("other run", "position_mean", 1e3),
            "rows": rows,
        })
    } else {
        json!({
            "time_rms_n": worst("time", "force_normal_rms", 1.0),
            "other_run_rms_n": worst("other run", "force_normal_rms", 1.0),
            "rows": rows,
        })
    })
}
