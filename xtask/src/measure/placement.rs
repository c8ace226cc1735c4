//! Placement of ten gauges on the limb by five methods.
//!
//! Problem: which method places gauges such that contacts are found with the least error, and how long does it search? Method: `dermis
//! optimize-placement` on one split of the locations; one evaluation for all methods, on locations that none of them saw. Assumptions: the limb is
//! as designed. Cost: some minutes of CPU time, of which greedy support vectors take two.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::{Map, Value, json};

use super::{LIMB, evaluation};
use crate::programs;

/// Seed of the split and of everything random. It was drawn after the criterion and the evaluation were frozen.
const SEED: &str = "21";

pub(super) fn placement(root: &Path) -> Result<Value> {
    let mut place = Command::new(programs::dermis(root)?);
    place.args(["optimize-placement", LIMB, "--seed", SEED, "--json"]);
    recorded(&evaluation(place.current_dir(root))?)
}

/// What tables show of the five methods, where they look for it; errors \[m\] are means.
fn recorded(found: &Value) -> Result<Value> {
    let methods = found["methods"].as_array().context("no methods were compared")?;
    let against = &found["crlb_against_greedy_svr"];
    let mut of_seed = Map::new();
    for method in methods {
        let name = method["method"].as_str().context("a method has no name")?;
        let errors = |by: &str, key: &str| -> Vec<Value> {
            method["evaluation"][by]
                .as_array()
                .into_iter()
                .flatten()
                .map(|error| error[key].clone())
                .collect()
        };
        let row = json!({
            "cpu_s": method["seconds"],
            "rim_m": method["rim"],
            "outwardness": method["outwardness"],
            "by_count": errors("by_count", "mean"),
            "by_failures": errors("by_failures", "mean"),
            "interval_by_count": errors("by_count", "interval"),
            "interval_by_failures": errors("by_failures", "interval"),
        });
        of_seed.insert(name.to_owned(), row);
    }
    for key in ["candidates", "forces_n", "locations"] {
        of_seed.insert(key.to_owned(), found[key].clone());
    }
    of_seed.insert("times_faster".to_owned(), against["times_faster"].clone());
    Ok(json!({
        "rim_of_candidates_m": found["rim_of_candidates"],
        "seeds": { SEED: of_seed },
        "crlb_against_greedy_svr": against,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_go_by_their_names() {
        let error = |mean: f64| json!({ "mean": mean, "interval": 0.1 });
        let found = json!({
            "methods": [{
                "method": "crlb", "seconds": 0.4, "rim": 0.02, "outwardness": 1.0,
                "evaluation": { "by_count": [error(3.0), error(2.0)], "by_failures": [error(2.0)] },
            }],
            "rim_of_candidates": 0.027,
            "crlb_against_greedy_svr": { "times_faster": 258.0, "error_by_count": [0.9] },
        });
        let record = recorded(&found).unwrap();
        assert_eq!(record["seeds"]["21"]["crlb"]["by_count"], json!([3.0, 2.0]));
        assert_eq!(record["seeds"]["21"]["crlb"]["interval_by_failures"], json!([0.1]));
        assert_eq!(record["crlb_against_greedy_svr"]["error_by_count"][0], 0.9);
        assert!(recorded(&json!({})).is_err());
    }
}
