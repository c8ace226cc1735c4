//! What needs no recording and no training: physics against references, and how well skins can know a contact at best.
//!
//! Problem: do the forward models agree with closed forms and other programs, and how far off must any estimator be? Method: `dermis
//! validate` of every sensor family that has cases, `dermis bounds` of the panel and of the row of barometers. Assumptions: CalculiX is
//! installed; what it judges is left out otherwise, which the record says (`calculix`). Cost: minutes of CPU time, of which the limb's
//! solids are most.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use serde_json::{Map, Value};

use super::evaluation;
use crate::programs;
use crate::record;

/// Records of the validation, one of each family.
pub(super) const VALIDATIONS: [&str; 4] =
    ["barodome-validation", "hapdef-validation", "ert-validation", "insight-validation"];
/// Records of bounds, each of a skin under launch/skins.
pub(super) const BOUNDS: [&str; 2] = ["ert-panel-bounds", "baro-line-bounds"];

/// Physics of each family against references; fails where a case does.
pub(super) fn validation(root: &Path) -> Result<Value> {
    each(root, &VALIDATIONS, "-validation", |command, family| {
        command.args(["validate", family]);
    })
}

/// Bounds of one and two contacts, and super-resolution factors of rows.
pub(super) fn bounds(root: &Path) -> Result<Value> {
    each(root, &BOUNDS, "-bounds", |command, skin| {
        command.arg("bounds").arg(format!("launch/skins/{skin}.toml"));
    })
}

/// What the program says with `--json` of each subject, written as soon as it is there. A record is the name of its subject and `end`.
fn each(root: &Path, records: &[&str], end: &str, with: impl Fn(&mut Command, &str)) -> Result<Value> {
    let dermis = programs::dermis(root)?;
    let mut all = Map::new();
    for name in records {
        let subject = name.strip_suffix(end).unwrap_or(name);
        let mut command = Command::new(&dermis);
        with(&mut command, subject);
        let found = evaluation(command.arg("--json").current_dir(root))?;
        record::keep(root, name, &found)?;
        all.insert(subject.to_owned(), found);
    }
    Ok(Value::Object(all))
}
