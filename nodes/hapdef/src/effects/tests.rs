//! What is promised of every effect in the table, and what each of those that remember does.

use std::sync::Arc;

use approx::assert_relative_eq;
use dermis_model::suite::Effects;
use dermis_model::{ForwardModel, Indentation, Memory, Stimulus};
use dermis_skin::{Effect, EffectInfo, ModelError, SkinDescription};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

use super::{Dynamics, EFFECTS, shape};
use crate::model::ShellModel;
use crate::parameters::Parameters;

/// A panel with four gauges, coarse enough to be solved in milliseconds; its readings are not counted, so that the smallest change
/// shows.
const PANEL: &str = r#"
schema = "dermis-skin/1"
name = "panel"
sensor = "hapdef"
kind = "simulated"
frame_id = "panel_link"
unit = "1"
rate = 100.0
noise = 3e-6
surface = { type = "panel", radius = 0.045, size = [0.1, 0.06], spacing = 0.006, margin = 0.02, rail = 0.012, cells = [2, 1], beam = [0.02, 0.0] }
taxels = [
    { name = "g0", position = [0.0, 0.0, 0.043], axis = [1.0, 0.0, 0.0] },
    { name = "g1", position = [0.0, 0.0, 0.043], axis = [0.0, 1.0, 0.0] },
    { name = "g2", position = [-0.04, 0.0, 0.043], axis = [1.0, 0.0, 0.0] },
    { name = "g3", position = [0.038, 0.0, 0.043], axis = [0.0, 1.0, 0.0] },
]
[medium]
thickness = 0.002
young_modulus = 1.7e9
poisson_ratio = 0.394
gauge = [0.008, 0.005]
"#;

/// \[s\] between frames.
const DT: f64 = 0.02;

fn skin(effects: Vec<Effect>) -> SkinDescription {
    let mut skin = SkinDescription::from_toml(PANEL, "panel.toml").unwrap();
    skin.effects = effects;
    skin
}

fn device(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    Ok(Arc::new(ShellModel::new(skin)?))
}

/// The promises that every family's effects keep.
fn suite() -> Effects<'static> {
    Effects { known: EFFECTS, skin: &skin, device: &device, frame: DT }
}

fn refused(effect: Effect) -> String {
    ShellModel::new(&skin(vec![effect])).unwrap_err().to_string()
}

/// What is done to the panel in a test.
#[derive(Debug, Clone, Copy)]
struct Act {
    /// \[m\] around the panel where a beam is pressed.
    arc: f64,
    force: f64,
}

fn contact(x: f64, arc: f64, force: f64) -> Indentation {
    let (sin, cos) = (arc / 0.045).sin_cos();
    let normal = Vector3::new(0.0, sin, cos);
    Indentation::sphere(Point3::from(normal * 0.045) + Vector3::x() * x, -normal * force, 0.01)
}

/// Seven seconds: a strong press on the middle beam that slides around it; then, after a pause, two at once.
fn act(act: Act) -> Vec<Stimulus> {
    let ramp = |t: f64, from: f64, to: f64| ((t - from) / (to - from)).clamp(0.0, 1.0);
    (0..350)
        .map(|i| {
            let t = f64::from(i) * DT;
            let mut contacts = Vec::new();
            let strong = 300.0 * (ramp(t, 0.2, 0.7) - ramp(t, 2.7, 3.0));
            if strong > 0.0 {
                contacts.push(contact(0.0, -0.005 + 0.01 * ramp(t, 1.7, 2.5), strong));
            }
            let level = ramp(t, 3.5, 4.0) - ramp(t, 6.0, 6.5);
            if level > 0.0 {
                contacts.push(contact(0.002, act.arc, act.force * level));
                contacts.push(contact(-0.035, 0.010, 5.0 * level));
            }
            Stimulus { contacts, ..Stimulus::default() }
        })
        .collect()
}

fn acts() -> impl Strategy<Value = Act> {
    (-0.01..0.01f64, 2.0..30.0f64).prop_map(|(arc, force)| Act { arc, force })
}

proptest! {
    // Each case builds dozens of models.
    #![proptest_config(ProptestConfig::with_cases(3))]

    #[test]
    fn every_effect_is_the_identity_at_0_and_grows_with_its_strength(acted in acts(), seed in any::<u64>()) {
        suite().grow_from_nothing(&act(acted), seed);
    }

    #[test]
    fn every_effect_is_drawn_by_its_seed_where_it_is_random(acted in acts(), seed in any::<u64>()) {
        suite().are_drawn_by_their_seeds(&act(acted), seed);
    }

    #[test]
    fn every_stateful_effect_remembers_and_no_other_does(acted in acts(), seed in any::<u64>()) {
        // In the middle of the slide, which is reached by pressing or all at once.
        suite().remember_what_they_should(&act(acted), 105, seed);
    }
}

#[test]
fn every_effect_is_named_and_parametrised() {
    suite().are_named_and_parametrised(&act(Act { arc: 0.0, force: 10.0 }));
}

/// What a device with this effect reads of one gauge without a touch, or with it (strain), at times \[s\].
fn stepped(effect: Effect, readings: impl IntoIterator<Item = (f64, f64)>) -> Vec<f64> {
    let mut memory = Dynamics::new(&skin(vec![effect]), None).unwrap().start(0);
    let next = |(t, strain): (f64, f64)| {
        let mut readings = [strain; 4];
        memory.apply_transducer(t, &Stimulus::default(), &mut readings);
        memory.quantize(&mut readings);
        readings[0]
    };
    readings.into_iter().map(next).collect()
}

#[test]
fn plastic_goes_on_giving_way() {
    let out =
        stepped(Effect::new("creep"), [(0.0, 0.0), (1e-6, 1e-3), (1e5, 1e-3), (1e5 + 1e-6, 0.0), (3e5, 0.0)]);
    assert_relative_eq!(out[1], 1e-3, max_relative = 1e-5);
    assert_relative_eq!(out[2], 1.07e-3, max_relative = 1e-6);
    assert_relative_eq!(out[3], 0.07e-3, max_relative = 1e-5);
    assert!(out[4].abs() < 1e-12);
}

#[test]
fn zeros_drift_as_far_as_was_asked() {
    let devices = 400;
    let squares: f64 = (0..devices)
        .map(|seed| stepped(Effect::new("zero-drift").seed(seed), [(0.0, 0.0), (3600.0, 0.0)])[1].powi(2))
        .sum();
    assert_relative_eq!((squares / devices as f64).sqrt(), 1e-5, max_relative = 0.15);
}

#[test]
fn warmth_reads_as_strain() {
    let effect = Effect::new("temperature").with("room", 0.0).with("self_heating", 0.0);
    let mut memory = Dynamics::new(&skin(vec![effect]), None).unwrap().start(0);
    let mut readings = [0.0; 4];
    memory.apply_transducer(0.0, &Stimulus { temperature: 303.15, ..Stimulus::default() }, &mut readings);
    // 10 K of 60 microstrain each, of which 5 % are left on average, and at most twice that.
    assert!(readings.iter().all(|r| (0.0..=6e-5).contains(r)), "{readings:?}");
    assert!(readings.iter().any(|r| *r > 1e-6));
}

#[test]
fn the_amplifier_ends() {
    let ends = |strength| {
        stepped(Effect::new("saturation").strength(strength), [(0.0, 3e-3), (1.0, -3e-3), (2.0, 1e-3)])
    };
    assert_eq!(ends(1.0), [2e-3, -2e-3, 1e-3]);
    assert_eq!(ends(0.5), [2.5e-3, -2.5e-3, 1e-3]);
}

#[test]
fn counts_are_those_of_the_bridge() {
    let text =
        format!("{PANEL}bridge = {{ gain = 330.0, gauge_factor = 2.1, active_arms = 1.0, bits = 12 }}\n");
    let skin = SkinDescription::from_toml(&text, "panel.toml").unwrap();
    let model = ShellModel::new(&skin).unwrap();
    let mut state = model.start(0);
    let mut readings = [2e-6, -2e-6, 0.0, 1e-4];
    state.quantize(&mut readings);
    let count = 4.0 / (330.0 * 2.1 * 4096.0);
    for (found, counts) in readings.iter().zip([1.0, -1.0, 0.0, 71.0]) {
        assert_relative_eq!(*found, counts * count, max_relative = 1e-12);
    }
}

#[test]
fn an_oblique_force_presses_as_hard_as_before() {
    let mut memory = Dynamics::new(&skin(vec![Effect::new("oblique-force")]), None).unwrap().start(0);
    let straight = contact(0.0, 0.004, 10.0);
    let mut stimulus = Stimulus { contacts: vec![straight.clone()], ..Stimulus::default() };
    memory.apply_to_stimulus(0.0, &mut stimulus);
    let normal = -straight.force.normalize();
    let force = stimulus.contacts[0].force;
    assert_relative_eq!(-force.dot(&normal), 10.0, max_relative = 1e-9);
    assert_relative_eq!((force + normal * 10.0).norm(), 10.0 * 0.1f64.tan(), max_relative = 1e-9);
}

#[test]
fn impossible_devices_are_refused_by_field() {
    insta::assert_snapshot!(refused(Effect::new("dead-gauge").with("count", 1.5)), @"skin `panel`: field `effects[0].count`: is 1.5 and must be a whole number, 4 at most");
    insta::assert_snapshot!(refused(Effect::new("dead-gauge").with("count", 5.0)), @"skin `panel`: field `effects[0].count`: is 5 and must be a whole number, 4 at most");
    insta::assert_snapshot!(refused(Effect::new("gauge")), @r#"skin `panel`: field `effects[0].name`: "gauge" is no effect of this sensor; it has modulus, thickness-field, print-anisotropy, clamp-compliance, geometric-stiffening, gauge-gain, misplacement, misalignment, transverse-sensitivity, dead-gauge, oblique-force, friction, creep, temperature, zero-drift, saturation"#);
    // A gauge that was glued over an opening.
    let text = refused(Effect::new("misplacement").with("distance", 0.02).seed(3));
    assert!(text.contains("lie on the shell") || text.contains("lies on no material"), "{text}");
}

#[test]
fn what_wanders_does_so_otherwise_after_another_start() {
    for name in ["temperature", "zero-drift"] {
        let model = ShellModel::new(&skin(vec![Effect::new(name).seed(3)])).unwrap();
        let read = |start: u64| {
            let (mut state, mut out) = (model.start(start), [0.0; 4]);
            for t in [0.0, 3600.0] {
                state.step(t, &Stimulus::default(), &mut out).unwrap();
            }
            out
        };
        assert_eq!(read(1), read(1), "{name}");
        assert!(read(0) != read(1) && read(1) != read(2), "{name}");
    }
}

/// Keeps the table honest about what acts where.
#[test]
fn what_is_not_static_remembers() -> Result<(), ModelError> {
    let moves = |info: &EffectInfo| -> Result<bool, ModelError> {
        let skin = skin(vec![Effect::new(info.name)]);
        let mut parameters = Parameters::nominal(&skin)?;
        shape(&skin, &mut parameters)?;
        Ok(parameters != Parameters::nominal(&skin)?)
    };
    for info in EFFECTS {
        let outside = ["oblique-force", "saturation"].contains(&info.name);
        assert_eq!(moves(info)?, !info.stateful && !outside, "{}", info.name);
    }
    Ok(())
}

#[test]
fn a_softer_device_reads_more() {
    let stimuli = [Stimulus { contacts: vec![contact(0.0, 0.004, 10.0)], ..Stimulus::default() }];
    let of = |effects| suite().readings(effects, &stimuli)[0].abs();
    let nominal = of(vec![]);
    assert!(of(vec![Effect::new("modulus")]) < nominal);
    assert!(of(vec![Effect::new("geometric-stiffening")]) < nominal);
    assert!(of(vec![Effect::new("clamp-compliance")]) > 0.0);
    assert_eq!(of(vec![Effect::new("dead-gauge").with("count", 4.0)]), 0.0);
}
