//! What is promised of every effect in the table.

use std::sync::Arc;

use dermis_model::suite::Effects;
use dermis_model::{ForwardModel, Stimulus};
use dermis_skin::{Effect, ModelError, SkinDescription};
use nalgebra::Vector3;
use proptest::prelude::*;

use super::EFFECTS;
use crate::model::ThumbModel;
use crate::model::tests::{press, small};

fn device(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    crate::model(skin)
}

fn suite() -> Effects<'static> {
    Effects { known: EFFECTS, skin: &small, device: &device, frame: 0.03 }
}

/// A press that comes, slides and goes while it gets warmer, and another beside it.
fn act(s: f64, force: f64) -> Vec<Stimulus> {
    let model = ThumbModel::new(&small(vec![])).unwrap();
    (0..24)
        .map(|i| {
            let t = f64::from(i) / 24.0;
            let mut contacts = Vec::new();
            let level = (4.0 * t).min(1.0) - (6.0 * t - 4.5).clamp(0.0, 1.0);
            if level > 0.0 {
                contacts.push(press(&model, s + 0.004 * t, 1.0 + 0.1 * t, force * level, 0.1 * level));
            }
            if t > 0.4 {
                contacts.push(press(&model, 0.045, -1.0, 0.5 * t, 0.0));
            }
            let gravity = Vector3::new(0.0, 0.0, -9.81 * t);
            Stimulus { contacts, temperature: 293.15 + 5.0 * t, gravity, ..Stimulus::default() }
        })
        .collect()
}

#[test]
fn names_and_parameters_make_sense() {
    suite().are_named_and_parametrised(&act(0.03, 0.6)[5..8]);
}

#[test]
fn seeds_are_devices() {
    suite().are_drawn_by_their_seeds(&act(0.03, 0.6)[10..13], 11);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1))]

    #[test]
    fn effects_grow_from_nothing(s in 0.02..0.04f64, force in 0.2..1.0f64, seed in 0..1000u64) {
        suite().grow_from_nothing(&act(s, force), seed);
    }

    #[test]
    fn effects_remember_what_they_should(s in 0.02..0.04f64, force in 0.2..1.0f64, seed in 0..1000u64) {
        suite().remember_what_they_should(&act(s, force), 18, seed);
    }
}

fn refused(effect: Effect) -> String {
    ThumbModel::new(&small(vec![effect])).unwrap_err().to_string()
}

#[test]
fn impossible_devices_are_refused_by_field() {
    assert!(
        refused(Effect::new("glints").with("count", 1.5))
            .contains("`effects[0].count`: is 1.5 and must be a whole number")
    );
    let said = refused(Effect::new("thickness").with("change", -0.002));
    assert!(said.contains("`effects[0].change`: makes 0.00200 m of elastomer"), "{said}");
    let said = refused(Effect::new("skeleton-offset").with("distance", 0.002));
    assert!(said.contains("`effects[0].distance`: leaves 0.00280 m inside"), "{said}");
}

/// What creeps is in the pictures, too.
#[test]
fn pictures_remember_as_numbers_do() {
    let effect = Effect::new("creep").with("share", 0.5).with("time", 0.5);
    let model = ThumbModel::new(&small(vec![effect])).unwrap();
    let stimulus = Stimulus { contacts: vec![press(&model, 0.03, 3.0, 0.8, 0.0)], ..Stimulus::default() };
    let seen = |times: &[f64]| {
        let mut state = model.start(0);
        let mut out = vec![0.0; model.channels()];
        for t in times {
            let image = state.capture(*t, &stimulus, &mut || 0.0).unwrap().unwrap();
            assert!(model.observe(&image, &mut out));
        }
        out
    };
    let idle = {
        let mut out = vec![0.0; model.channels()];
        model.untouched(&mut out).unwrap();
        out
    };
    let [first, later] = [seen(&[0.0]), seen(&[0.0, 0.1, 2.0])];
    let off = |v: &[f64]| v.iter().zip(&idle).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    // At once half of it, after four times the time all but 0.9 %; bytes round some of both away.
    assert!(off(&later) > 1.3 * off(&first), "{} {}", off(&first), off(&later));
}

/// The rig's errors, which every family shares, reach the pictures of devices that remember.
#[test]
fn pictures_that_remember_are_of_what_really_touches() {
    let creep = || Effect::new("creep").with("share", 0.5).with("time", 0.5);
    let model = |effects| crate::model(&small(effects)).unwrap();
    let nominal = ThumbModel::new(&small(vec![])).unwrap();
    let picture = |effects: Vec<Effect>, force: f64| {
        let stimulus =
            Stimulus { contacts: vec![press(&nominal, 0.03, 1.0, force, 0.0)], ..Stimulus::default() };
        let device = model(effects);
        let mut state = device.start(0);
        state.capture(0.0, &stimulus, &mut || 0.0).unwrap().unwrap()
    };
    let said = picture(vec![creep(), Effect::new("force-scale").with("factor", 1.1)], 1.0);
    assert_eq!(said, picture(vec![creep()], 1.1));
    assert_ne!(said, picture(vec![creep()], 1.0));
}
