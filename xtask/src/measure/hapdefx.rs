//! Chapter 3 of the thesis at its sizes, on the limb with strain gauges.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::{Map, Value, json};

use super::limb::{DIFFERING, limb_bag};
use super::{LIMB, evaluation};
use crate::programs;
use crate::record::{commit, sign, write};

/// How much is measured.
#[derive(Args)]
pub struct Options {
    /// A sixth of the epochs, a quarter of the samples and frames, and 4 and 24 virtual sensors a gauge only; networks keep their
    /// sizes. Some ten minutes of CPU time, counted and not measured. The record and its tables say what was reduced, and it takes the place of none
    /// that is more whole.
    #[arg(long)]
    reduced: bool,
    /// Numbers of virtual sensors a gauge that are measured (Fig. 3.5 A); 24, those of the thesis, take two fifths of the time of all. The record
    /// says which there were.
    #[arg(long, value_delimiter = ',', conflicts_with = "reduced")]
    sensors: Vec<usize>,
    /// Networks that are trained at once.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
}

/// The record that the tables are made from.
const RECORD: &str = "benches/results/hapdefx-shin.json";
/// Sizes of the thesis.
const SETTINGS: &str = "launch/real2sim/thesis.toml";
/// Virtual sensors near each gauge, as the table lists them.
const SENSORS: [&str; 5] = ["1", "4", "12", "24", "48"];

/// What the thesis found: unexplained variance of maps (section 3.3.2); errors [mm, N] by support vectors, by a network, and by
/// HapDefX of one contact and of two by the strongest peaks and by its rule of the next (section 3.3.4 and Table 3.2).
fn thesis() -> Value {
    json!({
        "fvu": { "single": 0.04, "double": 0.29 },
        "support_vectors": { "position_mean": 0.008, "force_mean": 1.6 },
        "network": { "position_mean": 0.003, "force_mean": 1.5 },
        "single": { "position_mean": 0.005, "force_mean": 3.0 },
        "double_strongest": { "position_mean": 0.014, "force_mean": 6.0 },
        "double_next": { "position_mean": 0.010, "force_mean": 6.0 },
    })
}

pub(super) fn run(root: &Path, options: &Options) -> Result<Value> {
    let dermis = programs::dermis(root)?;
    let (train, doubles) =
        (limb_bag(root, &dermis, "train", &DIFFERING)?, limb_bag(root, &dermis, "doubles", &DIFFERING)?);
    // States of networks stay: an interrupted run goes on from them.
    let states = root.join(".dermis/measure/hapdefx");
    let mut measure = Command::new(&dermis);
    measure.args(["real2sim", "thesis", "--skin", LIMB, "--settings", SETTINGS, "--json"]);
    measure.args(["--jobs", &options.jobs.to_string()]);
    if options.reduced {
        measure.arg("--reduced");
    }
    let sensors: Vec<String> = options.sensors.iter().map(usize::to_string).collect();
    let sensors = sensors.join(",");
    if !sensors.is_empty() {
        measure.args(["--sensors", &sensors]);
    }
    measure.arg("--states").arg(&states).arg("--train").arg(&train).arg(&doubles);
    let found = evaluation(measure.current_dir(root))?;
    let mut record = Value::Object(recorded(&found, &sensors)?);
    let flag = match (options.reduced, sensors.as_str()) {
        (true, _) => " --reduced".to_owned(),
        (false, "") => String::new(),
        (false, sensors) => format!(" --sensors {sensors}"),
    };
    sign(&mut record, &format!("cargo xtask measure hapdefx{flag}"), &commit(root)?)?;
    keep(&root.join(RECORD), &record)?;
    Ok(record)
}

/// Writes a record, unless it would take the place of one that is more whole.
fn keep(path: &Path, record: &Value) -> Result<()> {
    if let Ok(text) = std::fs::read(path)
        && let Ok(known) = serde_json::from_slice::<Value>(&text)
        && wholeness(record) < wholeness(&known)
    {
        eprintln!("{} is of a run that is more whole, and stays", path.display());
        return Ok(());
    }
    write(path, record)
}

/// 0 for a reduced run, 1 for a whole one of some numbers of virtual sensors, 2 for a whole one.
fn wholeness(record: &Value) -> u8 {
    let reduced = record["reduced"].as_array().is_some_and(|sentences| !sentences.is_empty());
    match (reduced, record["sensors"].is_null()) {
        (true, _) => 0,
        (false, false) => 1,
        (false, true) => 2,
    }
}

/// What `dermis real2sim thesis --json` prints, where tables look for it.
fn recorded(found: &Value, sensors: &str) -> Result<Map<String, Value>> {
    let mut record = Map::new();
    for key in
        ["skin", "skin_hash", "settings", "reduced", "trained", "data", "frames", "left_out", "seconds"]
    {
        record.insert(key.into(), found[key].clone());
    }
    let sentences: Vec<&str> =
        found["reduced"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let run = match (sentences.as_slice(), sensors) {
        ([], "") => "whole".into(),
        ([], sensors) => {
            record.insert("sensors".into(), json!(sensors));
            format!("whole, for {sensors} virtual sensors a gauge")
        }
        (said, _) => format!("reduced: {}", said.join("; ")),
    };
    record.insert("run".into(), json!(run));
    let sizes = found["sizes"].as_object().context("the study gave no sizes of networks")?;
    let widths = |of: &Value| -> String {
        of.as_array().into_iter().flatten().map(Value::to_string).collect::<Vec<_>>().join("-")
    };
    record.insert("sizes".into(), sizes.iter().map(|(name, of)| (name.clone(), json!(widths(of)))).collect());
    record.insert("maps".into(), maps(found));
    record.insert("methods".into(), methods(found));
    let strongest = |key: &str, contacts: u64, rule: &str| {
        let rows = found[key].as_array().into_iter().flatten();
        let fits = |row: &&Value| row["contacts"] == contacts && row["rule"] == rule;
        rows.clone().find(fits).cloned().unwrap_or(Value::Null)
    };
    for key in ["strongest", "strongest_of_true_maps"] {
        let of = json!({
            "single": strongest(key, 1, "strongest"),
            "double": strongest(key, 2, "strongest"),
            "double_next": strongest(key, 2, "next_within_tenth"),
        });
        record.insert(key.into(), of);
    }
    record.insert("thesis".into(), thesis());
    Ok(record)
}

/// Unexplained variance and errors of maps by transfer and number of virtual sensors; null where a number was not measured.
fn maps(found: &Value) -> Value {
    let mut all = Map::new();
    for transfer in ["linear", "neighbours", "network"] {
        let mut of = Map::new();
        for kind in ["single", "double"] {
            for figure in ["fvu", "rms"] {
                let cell = |each: &str| {
                    let rows = found["maps"].as_array().into_iter().flatten();
                    let fits = |row: &&Value| {
                        row["transfer"] == transfer && row["each"].as_u64() == each.parse().ok()
                    };
                    rows.clone().find(fits).map_or(Value::Null, |row| row[kind][figure].clone())
                };
                let cells: Map<String, Value> =
                    SENSORS.iter().map(|each| ((*each).to_owned(), cell(each))).collect();
                of.insert(format!("{kind}_{figure}"), Value::Object(cells));
            }
        }
        all.insert(transfer.into(), Value::Object(of));
    }
    Value::Object(all)
}

/// Errors by method: of one contact, also by force; of two, of both kinds of frames together.
fn methods(found: &Value) -> Value {
    let mut all = Map::new();
    for row in found["rows"].as_array().into_iter().flatten() {
        let (Some(method), Some(kind)) = (row["method"].as_str(), row["kind"].as_str()) else { continue };
        let by_force = &row["evaluation"]["by_force"];
        let mut of = Map::new();
        for key in [
            "frames",
            "position_mean",
            "position_rms",
            "position_median",
            "force_mean",
            "count_right",
            "lost",
        ] {
            of.insert(key.into(), row[key].clone());
        }
        of.insert("with_everything".into(), row["with_everything"].clone());
        of.insert("position".into(), by_force["position"].clone());
        of.insert("force".into(), by_force["force.normal"].clone());
        let kinds = all.entry(method).or_insert_with(|| json!({}));
        if let Some(kinds) = kinds.as_object_mut() {
            kinds.insert(kind.into(), Value::Object(of));
        }
    }
    for kinds in all.values_mut().filter_map(Value::as_object_mut) {
        let both: Vec<Value> =
            ["double_near", "double_far"].iter().filter_map(|k| kinds.get(*k).cloned()).collect();
        if !both.is_empty() {
            let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or(f64::NAN);
            let frames: f64 = both.iter().map(|row| number(row, "frames")).sum();
            let mean = |key: &str| {
                json!(both.iter().map(|row| number(row, "frames") * number(row, key)).sum::<f64>() / frames)
            };
            let keys = ["position_mean", "force_mean", "count_right", "lost"];
            let double: Map<String, Value> = keys.iter().map(|key| ((*key).to_owned(), mean(key))).collect();
            kinds.insert("double".into(), Value::Object(double));
        }
    }
    Value::Object(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found() -> Value {
        let row = |kind: &str, frames: u32, place: f64| {
            json!({ "method": "peaks of maps", "kind": kind, "frames": frames, "position_mean": place, "force_mean": 2.0,
                    "count_right": 0.5, "lost": 0.0,
                    "evaluation": { "by_force": { "position": [{ "mean": place }], "force.normal": [{ "mean": 2.0 }] } } })
        };
        let map = |each: u32| {
            json!({ "each": each, "transfer": "network", "single": { "fvu": 0.1, "rms": 1e-5 },
                    "double": { "fvu": f64::from(each) / 100.0, "rms": 2e-5 } })
        };
        json!({
            "skin": "limb", "reduced": ["1 of 6 epochs", "2 of 5 numbers"],
            "sizes": { "transfer": [10, 250, 240] },
            "maps": [map(4), map(24)],
            "rows": [row("single", 10, 0.004), row("double_near", 10, 0.020), row("double_far", 30, 0.008)],
            "strongest": [
                { "contacts": 1, "rule": "strongest", "position_mean": 0.004 },
                { "contacts": 2, "rule": "next_within_tenth", "position_mean": 0.010 },
            ],
            "strongest_of_true_maps": [{ "contacts": 1, "rule": "strongest", "position_mean": 0.002 }],
        })
    }

    #[test]
    fn figures_are_where_tables_look_for_them() {
        let record = Value::Object(recorded(&found(), "").unwrap());
        assert_eq!(record["run"], "reduced: 1 of 6 epochs; 2 of 5 numbers");
        let mut whole = found();
        whole["reduced"] = json!([]);
        assert_eq!(recorded(&whole, "").unwrap()["run"], "whole");
        assert_eq!(recorded(&whole, "24").unwrap()["run"], "whole, for 24 virtual sensors a gauge");
        assert_eq!(record["sizes"]["transfer"], "10-250-240");
        assert_eq!(
            record["maps"]["network"]["double_fvu"],
            json!({ "1": null, "4": 0.04, "12": null, "24": 0.24, "48": null })
        );
        assert_eq!(record["maps"]["linear"]["single_rms"]["24"], Value::Null);
        let peaks = &record["methods"]["peaks of maps"];
        assert_eq!(peaks["single"]["position"][0]["mean"], 0.004);
        let double = peaks["double"]["position_mean"].as_f64().unwrap();
        assert!((double - 0.011).abs() < 1e-12, "{double}");
        assert_eq!(record["strongest"]["double_next"]["position_mean"], 0.010);
        assert_eq!(record["strongest"]["double"], Value::Null);
        assert_eq!(record["strongest_of_true_maps"]["single"]["position_mean"], 0.002);
    }

    #[test]
    fn a_record_takes_the_place_of_none_that_is_more_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("record.json");
        let read = || serde_json::from_slice::<Value>(&std::fs::read(&path).unwrap()).unwrap();
        let (reduced, whole) = (json!({ "reduced": ["epochs"], "n": 1 }), json!({ "reduced": [], "n": 2 }));
        let some = json!({ "reduced": [], "sensors": "24", "n": 3 });
        for (record, expected) in
            [(&reduced, 1), (&some, 3), (&reduced, 3), (&whole, 2), (&reduced, 2), (&some, 2), (&whole, 2)]
        {
            keep(&path, record).unwrap();
            assert_eq!(read()["n"], expected);
        }
    }
}
