//! Whether the plans and effects that ship fit the skins that ship.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dermis_operate::effects::Chosen;
use dermis_skin::{Effect, SkinDescription};
use dermis_testbed::{Plan, Timeline};

use crate::{SENSORS, load, path};

fn files(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch").join(folder);
    std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
}

fn skin(name: &str) -> SkinDescription {
    load(&format!("{name}.toml"))
}

/// The thumb in few points and cells: what the one that ships does takes its elastomer a minute.
fn coarse_thumb() -> SkinDescription {
    let mut text = std::fs::read_to_string(path("insight-thumb.toml")).unwrap();
    for (fine, coarse) in [
        ("spacing = 0.001135", "spacing = 0.005"),
        ("cells = [88, 5]", "cells = [24, 5]"),
        ("grid = 0.00125", "grid = 0.004"),
        ("size = [410, 308]", "size = [104, 80]"),
    ] {
        assert!(text.contains(fine), "{fine}");
        text = text.replace(fine, coarse);
    }
    SkinDescription::from_toml(&text, "insight-thumb.toml").unwrap()
}

#[test]
fn every_plan_that_ships_can_be_carried_out_on_its_skin() {
    // Of each skin once: a model takes longer than most plans.
    let mut models = BTreeMap::new();
    for file in files("plans") {
        let plan = Plan::load(&file).unwrap_or_else(|e| panic!("{e}"));
        let named = ["baro-line", "baro-dome", "hapdef-shin", "ert-panel", "insight-thumb"];
        let of = named.into_iter().find(|skin| plan.name.starts_with(skin));
        let name = of.unwrap_or("baro-grid");
        let model = models.entry(name).or_insert_with(|| {
            let skin = if name == "insight-thumb" { coarse_thumb() } else { skin(name) };
            SENSORS.of(&skin).unwrap().model(&skin).unwrap()
        });
        Timeline::new(&plan, model, plan.seed).unwrap_or_else(|e| panic!("{e}"));
    }
}

#[test]
fn every_set_of_effects_that_ships_makes_a_device_of_every_skin() {
    let mut tried = 0;
    for path in files("effects") {
        // A set is called by the skins that it is for: baro-default, of baro-line and others.
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        let family = stem.split('-').next().unwrap();
        for name in ["baro-line", "baro-grid", "baro-dome", "hapdef-shin", "ert-panel"] {
            if !name.starts_with(family) {
                continue;
            }
            tried += 1;
            let mut skin = skin(name);
            let chosen = Chosen { effects: vec![path.clone()], effect: vec![] };
            chosen.apply(&mut skin, 7).unwrap();
            assert_eq!(skin.effects.len(), Effect::load(&path).unwrap().len());
            let model = SENSORS.of(&skin).unwrap().model(&skin);
            model.unwrap_or_else(|e| panic!("{name}, {}: {e}", path.display()));
        }
    }
    assert!(tried >= 5, "{tried}");
}
