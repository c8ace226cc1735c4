//! Localisation on recorded hydrogel skins.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;
use serde_json::{Value, json};

use super::{evaluation, scratch};
use crate::programs;
use crate::run::run as execute;

/// Folders of the recordings, and the mean error \[mm\] of a kernel ridge regression on the same kind of split, which is the target.
const SKINS: [(&str, &str, f64); 5] = [
    ("plain", "No Pattern", 1.7),
    ("parallel", "Parallel Lines", 1.8),
    ("radial", "Radial", 2.2),
    ("concentric", "Concentric Circles", 3.5),
    ("checkerboard", "Full CB", 4.3),
];

/// Trains and evaluates on each; the error is over all held-out presses, those where nothing was found included.
pub fn e_skins(root: &Path) -> Result<Value> {
    let source = std::env::var_os("DERMIS_E_SKINS").map(PathBuf::from).filter(|path| path.is_dir());
    let Some(source) = source else {
        return Ok(json!({
            "skipped": "DERMIS_E_SKINS names no folder: set it to a checkout of the repository DSHardman/Variable-Sensitivity-E-Skins, \
                        whose recordings state no licence and are not part of this one",
        }));
    };
    let dermis = programs::dermis(root)?;
    let dir = scratch(root, "e-skins")?;
    let skin = root.join("launch/skins/e-skin-hydrogel.toml");
    let mut all = serde_json::Map::new();
    for (name, folder, ridge) in SKINS {
        let (bag, model) = (dir.join(name), dir.join(format!("{name}-model")));
        let recording = source.join("Data").join(folder);
        execute(Command::new(&dermis).arg("import").arg(recording).arg("-o").arg(&bag).current_dir(root))?;
        let mut train = Command::new(&dermis);
        train
            .arg("train")
            .arg("--config")
            .arg(root.join("launch/train/e-skin.toml"))
            .arg("--skin")
            .arg(&skin);
        execute(train.arg("--out").arg(&model).arg(&bag).current_dir(root))?;
        let mut evaluate = Command::new(&dermis);
        evaluate.arg("evaluate").arg("--skin").arg(&skin).arg("--model").arg(&model);
        let found = evaluation(evaluate.args(["--held-out", "--json"]).arg(&bag).current_dir(root))?;
        let mean = found["figures"]["position_mean"].as_f64().map(|v| v * 1e3);
        all.insert(
            name.to_owned(),
            json!({
                "position_mean_mm": mean,
                "position_median_mm": found["figures"]["position_median"].as_f64().map(|v| v * 1e3),
                "position_rms_mm": found["figures"]["position_rms"].as_f64().map(|v| v * 1e3),
                "not_found": found["not_found"],
                "kernel_ridge_mm": ridge,
                "better": mean.is_some_and(|mean| mean < ridge),
            }),
        );
    }
    Ok(Value::Object(all))
}
