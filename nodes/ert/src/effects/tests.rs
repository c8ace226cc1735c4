//! What is promised of every effect in the table, and what some of them do.

use std::sync::Arc;

use dermis_model::suite::Effects;
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{Effect, ModelError, SkinDescription};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

use super::EFFECTS;
use crate::model::FabricModel;
use crate::model::tests::{SMALL, small};

/// A panel that remembers nothing by itself, so that effects show what they remember, and whose converter hides nothing of them.
fn skin(effects: Vec<Effect>) -> SkinDescription {
    let text = SMALL.replace("hysteresis = 0.1, creep = 0.02", "hysteresis = 0.0, creep = 0.0");
    let mut skin = small(&text.replace("bits = 12", "bits = 30"));
    skin.effects = effects;
    skin
}

fn device(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    crate::model(skin)
}

fn suite() -> Effects<'static> {
    Effects { known: EFFECTS, skin: &skin, device: &device, frame: 0.01 }
}

fn contact(x: f64, y: f64, force: f64) -> Indentation {
    Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -force), 0.02)
}

/// A press that comes, moves and goes while it gets warmer, and another beside it.
fn act([x, y]: [f64; 2], force: f64) -> Vec<Stimulus> {
    (0..60)
        .map(|i| {
            let t = f64::from(i) / 60.0;
            let mut contacts = Vec::new();
            let level = (4.0 * t).min(1.0) - (6.0 * t - 4.5).clamp(0.0, 1.0);
            if level > 0.0 {
                contacts.push(contact(x + 0.01 * t, y, force * level));
            }
            if t > 0.4 {
                contacts.push(contact(-x, 0.05, 12.0 * t));
            }
            Stimulus { contacts, temperature: 293.15 + 5.0 * t, ..Stimulus::default() }
        })
        .collect()
}

#[test]
fn names_and_parameters_make_sense() {
    suite().are_named_and_parametrised(&act([0.03, -0.02], 20.0)[..20]);
}

#[test]
fn seeds_are_devices() {
    suite().are_drawn_by_their_seeds(&act([0.03, -0.02], 20.0)[20..30], 11);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3))]

    #[test]
    fn effects_grow_from_nothing(at in proptest::array::uniform2(0.02..0.06f64), force in 8.0..40.0f64, seed in 0..1000u64) {
        suite().grow_from_nothing(&act(at, force), seed);
    }

    #[test]
    fn effects_remember_what_they_should(at in proptest::array::uniform2(0.02..0.06f64), force in 8.0..40.0f64, seed in 0..1000u64) {
        suite().remember_what_they_should(&act(at, force), 48, seed);
    }
}

fn refused(effect: Effect) -> String {
    FabricModel::new(&skin(vec![effect])).unwrap_err().to_string()
}

#[test]
fn impossible_devices_are_refused_by_field() {
    insta::assert_snapshot!(refused(Effect::new("open-electrode").with("count", 10.0)), @"skin `small`: field `effects[0].count`: is 10 and must be a whole number, 9 at most");
    insta::assert_snapshot!(refused(Effect::new("exchanged-electrodes").with("count", 1.5)), @"skin `small`: field `effects[0].count`: is 1.5 and must be a whole number, 4 at most");
    insta::assert_snapshot!(refused(Effect::new("wrinkles").with("count", 1.5)), @"skin `small`: field `effects[0].count`: is 1.5 and must be a whole number");
    insta::assert_snapshot!(refused(Effect::new("foam-creep").strength(20.0)), @"skin `small`: field `effects[0].share`: makes 0.600 in all with what the skin has, and must be 0.3 at most");
}

fn read(effects: Vec<Effect>) -> Vec<f64> {
    let stimulus = Stimulus { contacts: vec![contact(0.02, 0.03, 20.0)], ..Stimulus::default() };
    suite().readings(effects, &[stimulus])
}

#[test]
fn an_open_electrode_is_silent() {
    let found = read(vec![Effect::new("open-electrode").seed(4)]);
    let silent: Vec<usize> = (0..9).filter(|e| found[9 * e..9 * e + 9].iter().all(|v| *v == 0.0)).collect();
    let [one] = silent[..] else { panic!("{silent:?}") };
    assert!((0..9).all(|k| found[9 * k + one] == 0.0));
    assert_eq!(found.iter().filter(|v| **v == 0.0).count(), 17);
}

#[test]
fn exchanged_wires_exchange_rows_and_columns() {
    let (nominal, found) = (read(vec![]), read(vec![Effect::new("exchanged-electrodes").seed(2)]));
    let same = |a: usize, b: usize| (0..9).filter(|j| nominal[9 * a + j] == found[9 * b + j]).count() >= 7;
    let moved: Vec<usize> = (0..9).filter(|&e| !same(e, e)).collect();
    let [a, b] = moved[..] else { panic!("{moved:?}") };
    assert!(same(a, b) && same(b, a));
}

#[test]
fn a_short_takes_the_panel_with_it() {
    let mean = |effects: Vec<Effect>| read(effects).iter().sum::<f64>() / 81.0;
    let (nominal, shorted) = (mean(vec![]), mean(vec![Effect::new("shorted-electrode").seed(1)]));
    assert!(shorted < 0.9 * nominal, "{shorted} V of {nominal} V");
}
