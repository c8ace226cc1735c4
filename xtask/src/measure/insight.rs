//! The soft thumb: contacts by inversion of its forward model.
//!
//! Problem: how far off are place and force of one contact on the simulated thumb, how often is the number of several right, and what can
//! frames say at best? Method: frames of the plans that ship, at locations that nothing was fitted to, answered by the node's own estimator
//! with the bundle that ships, which has no network; the Cramér–Rao bound of the very same frames beside. Assumptions: the device is as designed. Cost: some minutes of CPU
//! time on two cores.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::{children_cpu, evaluation, read_toml, scratch};
use crate::programs;
use crate::record;
use crate::run::run as execute;

pub(super) const SKIN: &str = "launch/skins/insight-thumb.toml";
const MODEL: &str = "models/insight-thumb";
/// Plan, record, what is less than in the thesis or than was requested; in the order in which they are measured: the longest last.
const PLANS: [(&str, &str, &str); 4] = [
    (
        "evaluate",
        "insight-accuracy",
        "150 locations with two presses each; the thesis has 187,358 samples at 3,800 locations",
    ),
    ("fovea", "insight-fovea", "60 locations with two presses each"),
    (
        "contacts",
        "insight-contacts",
        "ten presses of each number of contacts, each with some ten touched frames",
    ),
    ("large-tip", "insight-large-tip", "100 locations with two presses each; widths are not estimated"),
];
/// \[N\] at which bins begin.
pub(super) const BINS: &str = "0.03,0.1,0.3,1";

/// Measures, and writes each result beside the others as soon as it is there.
pub(super) fn accuracy(root: &Path) -> Result<Value> {
    let (dermis, dir) = (programs::dermis(root)?, scratch(root, "insight")?);
    let mut all = serde_json::Map::new();
    for (plan, result, reduced) in PLANS {
        let (bag, file) = (dir.join(plan), format!("launch/plans/insight-thumb-{plan}.toml"));
        let mut collect = Command::new(&dermis);
        collect.args(["collect", SKIN, "--plan", &file, "--no-images", "--out"]).arg(&bag);
        execute(collect.current_dir(root))?;
        let mut evaluate = Command::new(&dermis);
        evaluate.args(["evaluate", "--model", MODEL, "--json", "--skin", SKIN, "--bins", BINS]).arg(&bag);
        let cpu = children_cpu()?;
        let found = evaluation(evaluate.current_dir(root))?;
        let seconds = children_cpu()? - cpu;
        let mut of = summary(&found).with_context(|| format!("what was measured by {file}"))?;
        // A lower bound of what a node answers: the start of the program and the bounds of all frames are in it.
        let touched = found["bound"]["left_out"]["touched"].as_f64();
        of["touched_frames_per_cpu_second"] = json!(touched.map(|frames| frames / seconds));
        of["cpu_seconds"] = json!(seconds);
        of["seed"] = json!(seed(root, &file)?);
        of["reduced"] = json!(reduced);
        of["evaluation"] = found;
        record::keep(root, result, &of)?;
        all.insert(plan.to_owned(), of);
    }
    Ok(Value::Object(all))
}

/// Ways to spread a ball's force over points, and what the thesis found with each: median errors of place \[mm\], force \[N\] and angle \[°\], and
/// widths \[mm\] of the contact by points above 0.02 and 0.01 N (Table 6.6).
const PROFILES: [(&str, [f64; 5]); 5] = [
    ("uniform", [1.9, 0.10, 11.1, 2.4, 2.9]),
    ("hertz", [1.8, 0.11, 12.4, 2.4, 2.7]),
    ("gaussian", [0.7, 0.10, 11.7, 2.6, 3.7]),
    ("laplacian1", [0.6, 0.08, 10.2, 2.4, 4.2]),
    ("laplacian2", [0.7, 0.12, 13.7, 2.2, 3.5]),
];
pub(super) const MAP_PLAN: &str = "launch/plans/insight-thumb-train.toml";
const MAP_CONFIG: &str = "launch/train/insight-thumb-map.toml";

/// One network for each way to spread a force (Table 6.6 of the thesis), each by itself at the same held-out locations.
pub(super) fn maps(root: &Path) -> Result<Value> {
    let (dermis, dir) = (programs::dermis(root)?, scratch(root, "insight-maps")?);
    let train = dir.join("train");
    let mut collect = Command::new(&dermis);
    collect.args(["collect", SKIN, "--plan", MAP_PLAN, "--no-images", "--out"]).arg(&train);
    execute(collect.current_dir(root))?;
    let mut config = read_toml(&root.join(MAP_CONFIG))?;
    let mut found = serde_json::Map::new();
    for (profile, thesis) in PROFILES {
        config.insert("force_profile".into(), profile.into());
        let (file, model) = (dir.join(format!("{profile}.toml")), dir.join(profile));
        std::fs::write(&file, config.to_string())?;
        let mut fit = Command::new(&dermis);
        fit.args(["train", "--skin", SKIN, "--config"]).arg(&file).arg("--out").arg(&model).arg(&train);
        let cpu = children_cpu()?;
        execute(fit.current_dir(root))?;
        let seconds = children_cpu()? - cpu;
        // Of the network alone, at the locations that were held out: a node with nothing else would have to know that something touches.
        let card = std::fs::read_to_string(model.join("card.json"))
            .with_context(|| format!("the card of {} cannot be read", model.display()))?;
        let mut of = strongest(&serde_json::from_str::<Value>(&card)?["held_out"])?;
        of["thesis"] = row(thesis);
        of["cpu_seconds"] = json!(seconds);
        found.insert(profile.into(), of);
    }
    Ok(json!({
        "reduced": "600 locations, a quarter of them held out, and a dense network of 128 and 128 on 1500 numbers; the thesis has 187,358 samples at 3,800 locations and a \
                    residual network on pictures of 410 x 308 pixels",
        "seed": seed(root, MAP_PLAN)?,
        "maps": found,
    }))
}

/// Errors of one contact by the strongest points of the force map, in millimetres, newtons and degrees.
fn strongest(found: &Value) -> Result<Value> {
    let of = &found["maps"]["map.force"]["strongest"];
    let number = |part: &Value, name: &str| {
        part[name].as_f64().with_context(|| format!("no {name} of a map was measured"))
    };
    let part = |part: &Value| -> Result<Value> {
        let wide = |k: usize| part["diameters"][k].as_f64().context("no width was measured");
        let angle = number(part, "angle")?.to_degrees();
        let all = [
            number(part, "position")? * 1e3,
            number(part, "amplitude")?,
            angle,
            wide(0)? * 1e3,
            wide(1)? * 1e3,
        ];
        let mut row = row(all);
        row["frames"] = part["frames"].clone();
        row["from"] = part["from"].clone();
        row["force_vector"] = part["force"].clone();
        Ok(row)
    };
    let by_force: Vec<Value> =
        of["by_force"].as_array().into_iter().flatten().map(part).collect::<Result<_>>()?;
    let touched = &found["maps"]["map.force"]["touched"];
    Ok(json!({
        "all": part(&of["all"])?, "by_force": by_force, "left_out": of["left_out"],
        "unanswered": touched["unanswered"], "frames": touched["frames"],
    }))
}

fn row([position, force, angle, wide, wider]: [f64; 5]) -> Value {
    json!({ "position": position, "force": force, "angle": angle, "diameters": [wide, wider] })
}

fn seed(root: &Path, plan: &str) -> Result<Option<i64>> {
    Ok(read_toml(&root.join(plan))?.get("seed").and_then(toml::Value::as_integer))
}

/// What tables show, in millimetres, newtons and degrees: by number of contacts and force.
pub(super) fn summary(found: &Value) -> Result<Value> {
    let mut numbers = serde_json::Map::new();
    for against in found["against_bound"].as_array().context("there are no bounds")? {
        let quantity = against["quantity"].as_str().context("a bound has no quantity")?;
        let factor = match quantity {
            "position" => 1e3,
            "angle" => 180.0 / std::f64::consts::PI,
            _ => 1.0,
        };
        let of = |ratio: &Value| -> Value {
            let scaled = |name: &str| ratio[name].as_f64().map(|v| v * factor);
            json!({
                "contacts": ratio["samples"], "not_found_percent": ratio["not_found"].as_f64().map(|v| v * 100.0),
                "median": scaled("error_median"), "bound_median": scaled("bound_median"),
                "median_ratio": ratio["median_ratio"],
            })
        };
        let bins: Vec<Value> = against["by_force"].as_array().into_iter().flatten().map(of).collect();
        let number = numbers.entry(against["contacts"].to_string()).or_insert_with(|| json!({}));
        number[quantity.replace('.', "_")] = json!({ "all": of(&against["all"]), "by_force": bins });
    }
    for (number, share) in found["count_right"].as_object().into_iter().flatten() {
        let of = numbers.entry(number.clone()).or_insert_with(|| json!({}));
        of["right_percent"] = json!(share.as_f64().map(|v| v * 100.0));
    }
    let right = numbers.values().filter_map(|of| of["right_percent"].as_f64());
    Ok(json!({ "worst_right_percent": right.reduce(f64::min), "numbers": numbers }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_shown_in_their_units() {
        let part = json!({
            "from": 0.0, "frames": 3, "position": 6e-4, "force": 0.09, "amplitude": 0.08, "angle": 0.1, "diameters": [2e-3, 4e-3],
        });
        let found = json!({
            "maps": { "map.force": {
                "touched": { "frames": 3, "unanswered": 1 }, "strongest": { "all": part, "by_force": [part], "left_out": 0.25 },
            } },
        });
        let shown = strongest(&found).unwrap();
        assert!((shown["all"]["position"].as_f64().unwrap() - 0.6).abs() < 1e-12);
        assert!((shown["by_force"][0]["angle"].as_f64().unwrap() - 5.7296).abs() < 1e-3);
        assert_eq!((&shown["all"]["force"], &shown["left_out"]), (&json!(0.08), &json!(0.25)));
        assert!(strongest(&json!({})).is_err());
    }

    #[test]
    fn what_tables_show_is_in_their_units() {
        let ratio = |median: f64| {
            json!({
                "samples": 10, "not_found": 0.1, "error_median": median, "bound_median": median / 2.0, "median_ratio": 2.0,
            })
        };
        let of = |quantity: &str, median: f64| json!({ "contacts": 1, "quantity": quantity, "all": ratio(median), "by_force": [ratio(3.0 * median)] });
        let found = json!({
            "against_bound": [of("position", 4e-4), of("force.normal", 0.02), of("angle", 0.1)],
            "count_right": { "1": 0.95, "2": 0.85 },
        });
        let summary = summary(&found).unwrap();
        let one = &summary["numbers"]["1"];
        assert!((one["position"]["all"]["median"].as_f64().unwrap() - 0.4).abs() < 1e-12);
        assert_eq!(one["position"]["by_force"][0]["contacts"], 10);
        assert_eq!(one["force_normal"]["all"]["bound_median"], 0.01);
        assert!((one["angle"]["all"]["median"].as_f64().unwrap() - 5.7296).abs() < 1e-3);
        assert_eq!(one["right_percent"], 95.0);
        assert_eq!(summary["worst_right_percent"], 85.0);
        assert!(super::summary(&json!({})).is_err());
    }
}
