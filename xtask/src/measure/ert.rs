//! Tables 4.3 to 4.5 of the thesis on the simulated conductive panel, and Figs. 4.2 to 4.6: transfer, structure, reconstruction, and the whole.
//!
//! Problem: how well networks carry a device's voltages over to its model, for numbers of contacts that they have and have not seen
//! (Table 4.3), and how pixel and width of a contact decide what a map of forces is worth (Table 4.5). Method: collect → train →
//! evaluate with the program itself; the "real" device has the family's default effects, the simulated one has none. Table 4.4 is
//! counted from the configuration. Cost at share 1: hours on two cores for Table 4.3, days for Table 4.5; `--share` and `--epochs`
//! make it less, and the result says what is reduced. An interrupted run goes on: bags, checkpoints and rows stay in
//! `.dermis/measure`, apart for each commit, size and content of the files that they are made from. Bags depend on no network: those of a
//! share serve all maps, epochs and processors. Once a GPU has fitted a map, one core evaluates it frame
//! by frame; with `--jobs` others are fitted meanwhile.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use clap::Args;
use serde_json::{Map, Value, json};
use toml::{Table, Value as Toml};

mod figures;
mod networks;
mod pipeline;
mod variance;

use self::networks::{MAPS, THESIS, configuration, structure};
use super::{at_once, collected, evaluation, fingerprint, read_toml, scratch};
use crate::programs;
use crate::record::{commit, sign, write};
use crate::run::run as execute;

const SKIN: &str = "launch/skins/ert-panel.toml";
/// What makes the "real" device differ from its design.
const EFFECTS: &str = "launch/effects/ert-default.toml";
const TRANSFER: &str = "launch/train/ert-panel-transfer.toml";
const RESULT: &str = "benches/results/ert-tables.json";
/// Plans that are scaled.
const PLANS: [&str; 3] = ["hex-train", "hex-evaluate", "random-train"];

/// Locations of each number of contacts, and random presses, in the thesis.
const THESIS_LOCATIONS: u32 = 3000;
const THESIS_RANDOM: u32 = 200_000;
const THESIS_EPOCHS: u32 = 1024;
/// \[N\] the lightest contact that the thesis has: manual loads of 4.905 N.
const LIGHTEST: &str = "4.9";

/// How much of it is done.
#[derive(Args)]
pub struct Sizes {
    /// Share of the presses of the plans that ship, above 0 and up to 1.
    #[arg(long, default_value_t = 0.1)]
    share: f64,
    /// Passes over the training part of each network.
    #[arg(long, default_value_t = 5)]
    epochs: u32,
    /// Maps of Table 4.5, by number; all where absent.
    #[arg(long, value_delimiter = ',')]
    maps: Vec<usize>,
    /// Tables that are measured; the record keeps what it has of the others.
    #[arg(long, value_delimiter = ',', default_values_t = [TableName::Transfer, TableName::Maps])]
    tables: Vec<TableName>,
    /// Bags that are collected, and networks that are trained and evaluated, at once.
    #[arg(long, default_value_t = 1)]
    jobs: usize,
    /// What the networks of Table 4.5 are trained on, as `dermis train` has it: `gpu` in programs that were built for it. The record
    /// says which.
    #[arg(long, default_value = "cpu")]
    processor: String,
}

/// A table that networks are trained for.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum TableName {
    /// Table 4.3.
    #[value(name = "4.3")]
    Transfer,
    /// Table 4.5.
    #[value(name = "4.5")]
    Maps,
    /// Figs. 4.5 and 4.6: transfer and reconstruction as one bundle on the "real" device; sixteen networks. Never measured unless named.
    #[value(name = "pipeline")]
    Pipeline,
}

impl std::fmt::Display for TableName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Transfer => "4.3",
            Self::Maps => "4.5",
            Self::Pipeline => "pipeline",
        })
    }
}

/// The program, its working directory, and its arguments.
struct Work<'a> {
    root: &'a Path,
    dermis: PathBuf,
    dir: PathBuf,
    /// Of the bags, which depend on the share only.
    data: PathBuf,
    sizes: &'a Sizes,
}

/// Measures, and writes the result beside the others.
pub(super) fn tables(root: &Path, sizes: &Sizes) -> Result<Value> {
    if !(sizes.share > 0.0 && sizes.share <= 1.0) || sizes.epochs == 0 || sizes.jobs == 0 {
        bail!("--share is above 0 and up to 1, and --epochs and --jobs at least 1");
    }
    if let Some(bad) = sizes.maps.iter().find(|map| !(1..=MAPS.len()).contains(*map)) {
        bail!("--maps: there is no map {bad}, but 1 to {}", MAPS.len());
    }
    for file in [SKIN, EFFECTS] {
        if !root.join(file).is_file() {
            bail!("{file} is missing: these tables need the family of the conductive panel");
        }
    }
    let dermis = programs::dermis(root)?;
    let folders = folders(root, sizes)?;
    folders.iter().try_for_each(std::fs::create_dir_all)?;
    let [dir, data] = folders;
    let work = Work { root, dermis, dir, data, sizes };
    let file = root.join(RESULT);
    let mut record: Map<String, Value> = match std::fs::read(&file) {
        Ok(text) => {
            serde_json::from_slice(&text).with_context(|| format!("{} is no record", file.display()))?
        }
        Err(_) => Map::new(),
    };
    record.insert("table_4_4".into(), structure(root)?);
    for table in &sizes.tables {
        let (key, rows) = match table {
            TableName::Transfer => ("table_4_3", work.transfer()?),
            TableName::Maps => ("table_4_5", work.maps()?),
            TableName::Pipeline => ("pipeline", work.pipeline()?),
        };
        let mut of = json!({ "reduced": reduced(root, sizes)?, "rows": rows });
        sign(&mut of, &work.command(*table), &commit(root)?)?;
        if *table == TableName::Pipeline {
            of["variance"] = pipeline::variances(&of["rows"]);
            of["pages"] = json!(work.dir.strip_prefix(root).unwrap_or(&work.dir));
        }
        record.insert(key.into(), of);
        write(&file, &Value::Object(record.clone()))?;
    }
    for figure in figures::draw(file.parent().unwrap_or(root), &Value::Object(record.clone()))? {
        eprintln!("{} is drawn", figure.display());
    }
    Ok(Value::Object(record))
}

/// Folders of networks and rows of this size, and of the bags of this share. What was done of the same size and the same files is not done
/// again; of another commit the measuring code may differ.
fn folders(root: &Path, sizes: &Sizes) -> Result<[PathBuf; 2]> {
    let Sizes { share, epochs, processor, .. } = sizes;
    let plans = PLANS.into_iter().chain([pipeline::UNSEEN]).map(|name| plan_file(Path::new(""), name));
    let of_bags: Vec<PathBuf> = [SKIN, EFFECTS].map(PathBuf::from).into_iter().chain(plans).collect();
    let of_networks = [of_bags.clone(), [THESIS, TRANSFER].map(PathBuf::from).to_vec()].concat();
    let commit = commit(root)?;
    let networks = fingerprint(root, &of_networks, (&commit, share.to_bits(), epochs, processor))?;
    let bags = fingerprint(root, &of_bags, (&commit, share.to_bits()))?;
    let folder = |name: String| root.join(".dermis/measure/ert-tables").join(name);
    Ok([folder(format!("{networks:016x}")), folder(format!("bags-{bags:016x}"))])
}

/// Contacts by inversion of the forward model on the presses of the plan that models are measured on.
pub(super) fn inversion(root: &Path) -> Result<Value> {
    let (dermis, bag) = (programs::dermis(root)?, scratch(root, "panel")?.join("hex"));
    let mut collect = Command::new(&dermis);
    collect.args(["collect", SKIN, "--plan", "launch/plans/ert-panel-hex-evaluate.toml", "--out"]).arg(&bag);
    execute(collect.current_dir(root))?;
    let mut evaluate = Command::new(&dermis);
    evaluate.args(["evaluate", "--invert", "--json", "--skin", SKIN]).arg(&bag).current_dir(root);
    evaluation(&mut evaluate)
}

/// What is less than in the thesis, in words and numbers.
fn reduced(root: &Path, sizes: &Sizes) -> Result<Value> {
    let locations = scaled(&plan(root, "hex-train")?, "hex", Some(1), sizes.share).1;
    let random = scaled(&plan(root, "random-train")?, "multi", None, sizes.share).1;
    Ok(json!({
        "share_of_the_plans": sizes.share,
        "locations_of_each_number": { "here": locations, "thesis": THESIS_LOCATIONS },
        "random_presses": { "here": random, "thesis": THESIS_RANDOM },
        "epochs": { "here": sizes.epochs, "thesis": THESIS_EPOCHS },
        "processor": sizes.processor,
        "maps": if sizes.maps.is_empty() { (1..=MAPS.len()).collect() } else { sizes.maps.clone() },
        "real_device": "the simulated panel with the default effects of its family",
    }))
}

fn plan_file(root: &Path, name: &str) -> PathBuf {
    root.join(format!("launch/plans/ert-panel-{name}.toml"))
}

fn plan(root: &Path, name: &str) -> Result<Table> {
    read_toml(&plan_file(root, name))
}

/// A plan with a share of the presses of each step, of one number of contacts or of all; and how many presses of the kind it has.
fn scaled(plan: &Table, kind: &str, number: Option<i64>, share: f64) -> (Table, u64) {
    let (mut plan, mut presses) = (plan.clone(), 0);
    if let Some(Toml::Array(steps)) = plan.get_mut("steps") {
        let contacts = |step: &Toml| step.get("contacts")?.get(0)?.as_integer();
        steps.retain(|step| number.is_none() || contacts(step).is_none() || contacts(step) == number);
        for step in steps.iter_mut().filter_map(Toml::as_table_mut) {
            let of_kind = step.get("kind").and_then(Toml::as_str) == Some(kind);
            if let Some(Toml::Integer(count)) = step.get_mut("count") {
                *count = (*count as f64 * share).ceil() as i64;
                presses += if of_kind { count.unsigned_abs() } else { 0 };
            }
        }
    }
    (plan, presses)
}

impl Work<'_> {
    /// The command that measures a table in this size.
    fn command(&self, table: TableName) -> String {
        let Sizes { share, epochs, maps, processor, .. } = self.sizes;
        let mut text =
            format!("cargo xtask measure ert-tables --tables {table} --share {share} --epochs {epochs}");
        if table != TableName::Transfer && !maps.is_empty() {
            let maps: Vec<String> = maps.iter().map(usize::to_string).collect();
            text += &format!(" --maps {}", maps.join(","));
        }
        if table != TableName::Transfer && processor != "cpu" {
            text += &format!(" --processor {processor}");
        }
        text
    }

    /// A row: as an earlier run left it or, where none did, as `measured` now.
    fn row(&self, name: &str, measured: impl FnOnce() -> Result<Value>) -> Result<Value> {
        let file = self.dir.join(format!("{name}-row.json"));
        if let Ok(text) = std::fs::read(&file) {
            return serde_json::from_slice(&text).with_context(|| format!("{} is no row", file.display()));
        }
        let row = measured()?;
        write(&file, &row)?;
        Ok(row)
    }

    /// A bag of a scaled plan.
    fn bag(&self, plan_name: &str, number: Option<i64>, real: bool) -> Result<PathBuf> {
        let (mut plan, _) = scaled(&plan(self.root, plan_name)?, "hex", number, self.sizes.share);
        let of = number.map_or_else(String::new, |n| format!("-of-{n}"));
        let name = format!("{plan_name}{of}{}", if real { "-real" } else { "" });
        let bag = self.data.join(&name);
        plan.insert("name".into(), Toml::String(name.clone()));
        let file = self.data.join(format!("{name}.toml"));
        std::fs::write(&file, toml::to_string(&plan)?)?;
        let mut collect = Command::new(&self.dermis);
        collect.arg("collect").arg(SKIN).arg("--plan").arg(&file).current_dir(self.root);
        if real {
            collect.args(["--effects", EFFECTS, "--seed", "7"]);
        }
        collected(&mut collect, &bag)?;
        Ok(bag)
    }

    /// Bags of scaled plans of the device or of its model, so many at once as there are jobs.
    fn bags(&self, plans: &[(&str, Option<i64>)], real: bool) -> Result<Vec<PathBuf>> {
        at_once(self.sizes.jobs, plans, |(plan, number)| self.bag(plan, *number, real))
    }

    /// Trains by a configuration; what `train --json` says.
    fn train(&self, name: &str, config: &Table, bags: &[PathBuf], tests: &[PathBuf]) -> Result<Value> {
        let file = self.dir.join(format!("{name}-train.toml"));
        std::fs::write(&file, toml::to_string(config)?)?;
        let mut train = Command::new(&self.dermis);
        train.arg("train").args(["--skin", SKIN, "--json", "--config"]).arg(&file);
        train.arg("--out").arg(self.dir.join(name)).args(["--epochs", &self.sizes.epochs.to_string()]);
        train.arg("--resume");
        if config["network"].get("image").is_some() {
            train.args(["--processor", &self.sizes.processor]);
        }
        for test in tests {
            train.arg("--test").arg(test);
        }
        evaluation(train.args(bags).current_dir(self.root))
    }

    /// Table 4.3: transfer networks of one number of contacts to all six, each on every number.
    fn transfer(&self) -> Result<Value> {
        let config = read_toml(&self.root.join(TRANSFER))?;
        let of = |plan| (1..=6).map(move |n| (plan, Some(n)));
        let bags = self.bags(&of("hex-train").chain(of("hex-evaluate")).collect::<Vec<_>>(), true)?;
        let (trains, tests) = bags.split_at(6);
        // What learns from most takes longest: it begins first.
        let mut rows = at_once(self.sizes.jobs, &[6, 5, 4, 3, 2, 1], |&up_to| {
            let name = format!("transfer-up-to-{up_to}");
            self.row(&name, || self.transferred(&name, &config, &trains[..up_to], tests))
        })?;
        rows.reverse();
        Ok(Value::Array(rows))
    }

    /// A row of Table 4.3: a network that learned from `trains`, on each of `tests`.
    fn transferred(
        &self,
        name: &str,
        config: &Table,
        trains: &[PathBuf],
        tests: &[PathBuf],
    ) -> Result<Value> {
        let found = self.train(name, config, trains, tests)?;
        let others = found["other_runs"].as_object().cloned().unwrap_or_default();
        let mut columns = Map::new();
        for (n, test) in tests.iter().enumerate() {
            let test = test.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let number = (n + 1).to_string();
            let errors = &others.get(&test).unwrap_or(&Value::Null)["maps"]["signal"]["by_number"][&number];
            if errors.is_null() {
                bail!(
                    "`dermis train` has no errors of the signal on {test}: its plan may have lost every trial below 5 N"
                );
            }
            let cell = json!({
                "frames": errors["frames"], "rmse_v": errors["rms"], "fvu": errors["fvu"],
                "seen_in_training": n < trains.len(),
            });
            columns.insert(number, cell);
        }
        Ok(json!({
            "trained_on_up_to": trains.len(),
            "samples": found["samples"],
            "seconds": found["seconds"],
            "held_out_of_training": found["held_out"]["maps"]["signal"]["by_number"],
            "test": columns,
        }))
    }

    /// Table 4.5: reconstruction on the simulated device, at locations that training has not seen.
    fn maps(&self) -> Result<Value> {
        let thesis = read_toml(&self.root.join(THESIS))?;
        let plans = PLANS.map(|plan| (plan, None));
        let all = self.bags(&plans, false)?;
        let [hex, test, random] = <[PathBuf; 3]>::try_from(all).expect("a bag for each plan");
        let bags = [random, hex];
        let chosen = |number: &usize| self.sizes.maps.is_empty() || self.sizes.maps.contains(number);
        let numbers: Vec<usize> = (1..=MAPS.len()).filter(chosen).collect();
        let rows = at_once(self.sizes.jobs, &numbers, |&number| {
            let name = format!("map-{number}");
            self.row(&name, || {
                self.drawn(&name, number, &configuration(&thesis, MAPS[number - 1])?, (&bags, &test))
            })
        })?;
        Ok(Value::Array(rows))
    }

    /// A row of Table 4.5: a map that was learned from bags, on another one.
    fn drawn(
        &self,
        name: &str,
        number: usize,
        config: &Table,
        (bags, test): (&[PathBuf], &Path),
    ) -> Result<Value> {
        let [pixel, diameter] = MAPS[number - 1];
        let trained = self.train(name, config, bags, &[])?;
        let mut evaluate = Command::new(&self.dermis);
        evaluate.arg("evaluate").args(["--skin", SKIN, "--map-least-force", LIGHTEST, "--json"]);
        evaluate.arg("--model").arg(self.dir.join(name)).arg(test).current_dir(self.root);
        let found = evaluation(&mut evaluate)?;
        let errors = &found["maps"]["map.normal"];
        Ok(json!({
            "map": number,
            "pixel_mm": pixel,
            "diameter_mm": diameter,
            "samples": trained["samples"],
            "seconds": trained["seconds"],
            "contacts": errors["contacts"],
            "rms_n_and_fvu_by_number": errors["by_number"],
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn root() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
    }

    fn sizes(share: f64, epochs: u32, maps: &[usize]) -> Sizes {
        Sizes {
            share,
            epochs,
            maps: maps.to_vec(),
            tables: vec![TableName::Transfer, TableName::Maps],
            jobs: 1,
            processor: "cpu".into(),
        }
    }

    #[test]
    fn a_share_of_a_plan_has_a_share_of_its_presses() {
        let plan = plan(&root(), "hex-train").unwrap();
        let (all, presses) = scaled(&plan, "hex", None, 0.1);
        assert_eq!(presses, 6 * 30);
        let (three, presses) = scaled(&plan, "hex", Some(3), 0.1);
        assert_eq!(presses, 30);
        let hexes = |plan: &Table| {
            let steps = plan["steps"].as_array().unwrap();
            steps.iter().filter(|s| s["kind"].as_str() == Some("hex")).count()
        };
        assert_eq!((hexes(&all), hexes(&three)), (6, 1));
        let text = toml::to_string(&three).unwrap();
        assert!(text.parse::<Table>().is_ok(), "{text}");
        let record = reduced(&root(), &sizes(0.1, 5, &[])).unwrap();
        assert_eq!(record["locations_of_each_number"], json!({ "here": 30, "thesis": 3000 }));
        assert_eq!(record["random_presses"], json!({ "here": 800, "thesis": 200_000 }));
    }

    #[test]
    fn maps_epochs_and_processors_share_their_bags() {
        let of = |change: &dyn Fn(&mut Sizes)| {
            let mut sizes = sizes(0.1, 5, &[]);
            change(&mut sizes);
            folders(&root(), &sizes).unwrap()
        };
        let [networks, bags] = of(&|_| {});
        assert_eq!(of(&|s| s.maps = vec![3]), [networks.clone(), bags.clone()]);
        for change in [|s: &mut Sizes| s.epochs = 6, |s: &mut Sizes| s.processor = "gpu".into()] {
            let [others, same] = of(&change);
            assert_ne!(others, networks);
            assert_eq!(same, bags);
        }
        let [others, further] = of(&|s| s.share = 0.2);
        assert!(others != networks && further != bags);
    }

    #[test]
    fn impossible_sizes_are_refused() {
        let message = |sizes: Sizes| tables(Path::new("/nowhere"), &sizes).unwrap_err().to_string();
        assert!(message(sizes(0.0, 1, &[])).starts_with("--share"));
        assert!(message(sizes(1.0, 1, &[13])).contains("no map 13"));
        assert!(message(sizes(1.0, 1, &[12])).contains("ert-panel.toml is missing"));
    }
}
