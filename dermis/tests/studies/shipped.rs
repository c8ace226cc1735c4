//! Whether the plans and effects that ship fit the skins that ship.

use std::path::{Path, PathBuf};

use dermis_operate::effects::Chosen;
use dermis_skin::{Effect, SkinDescription};
use dermis_testbed::{Plan, Timeline};

use crate::{SENSORS, load};

fn files(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch").join(folder);
    std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
}

fn skin(name: &str) -> SkinDescription {
    load(&format!("{name}.toml"))
}

#[test]
fn every_plan_that_ships_can_be_carried_out_on_its_skin() {
    for path in files("plans") {
        let plan = Plan::load(&path).unwrap_or_else(|e| panic!("{e}"));
        let named = ["baro-line", "baro-dome", "hapdef-shin", "ert-panel"];
        let of = named.into_iter().find(|skin| plan.name.starts_with(skin));
        let skin = skin(of.unwrap_or("baro-grid"));
        let model = SENSORS.of(&skin).unwrap().model(&skin).unwrap();
        Timeline::new(&plan, &model, plan.seed).unwrap_or_else(|e| panic!("{e}"));
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
