//! The barometer skins' shipped bundles beside other estimators.
//!
//! Problem: what do the search on the forward model and our networks gain over what others would use on the same readings? Method:
//! `dermis compare` on the locations that were held out of the bundles' training, with the network of the thesis (10 x 100, on the row
//! 6 x 100, trained here on the same bag), regressors with settings chosen by cross-validation over locations, and isolines. Assumptions: the device is as designed.
//! Cost: a quarter of an hour of CPU time.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use serde_json::Value;

use super::{evaluation, scratch};
use crate::programs;
use crate::record;
use crate::run::run as execute;

/// Skins, and whether the thesis has a network for it.
const SKINS: [(&str, bool); 3] = [("line", true), ("grid", true), ("dome", false)];

pub(super) fn comparisons(root: &Path) -> Result<Value> {
    let (dermis, dir) = (programs::dermis(root)?, scratch(root, "comparisons")?);
    let mut all = serde_json::Map::new();
    for (name, thesis) in SKINS {
        let skin = format!("launch/skins/baro-{name}.toml");
        let bag = dir.join(name);
        let mut collect = Command::new(&dermis);
        collect.args(["collect", &skin, "--plan", &format!("launch/plans/baro-{name}-train.toml"), "--out"]);
        execute(collect.arg(&bag).current_dir(root))?;
        let mut compare = Command::new(&dermis);
        compare.args(["compare", "--json", "--skin", &skin, "--model", &format!("models/baro-{name}")]);
        if thesis {
            let model = dir.join(format!("thesis-{name}"));
            let mut train = Command::new(&dermis);
            train.args(["train", "--skin", &skin, "--config"]);
            train.arg(format!("launch/train/baro-{name}-thesis.toml")).arg("--out").arg(&model).arg(&bag);
            execute(train.current_dir(root))?;
            compare.arg("--model").arg(model);
        }
        let found = evaluation(compare.arg(&bag).current_dir(root))?;
        record::keep(root, &format!("comparison-{name}"), &found)?;
        all.insert(name.into(), found);
    }
    Ok(Value::Object(all))
}
