//! What is promised of every effect in the table, and what each of those that remember does.

use std::sync::{Arc, LazyLock};

use dermis_model::suite::Effects;
use dermis_model::{DeviceState, ForwardModel, Indentation, Memory, Stepped, Stimulus, Wrapper};
use dermis_skin::{Effect, EffectInfo, ModelError, SkinDescription};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

use super::{Dynamics, EFFECTS, shape};
use crate::model::BarometerModel;
use crate::parameters::Parameters;

/// Four barometers in a pad.
const PAD: &str = r#"
schema = "dermis-skin/1"
name = "pad"
sensor = "barodome"
kind = "simulated"
frame_id = "pad_link"
unit = "Pa"
rate = 50.0
noise = 20.0
surface = { type = "rectangle", size = [0.02, 0.02], spacing = 0.001 }
taxels = [
    { name = "b0", position = [-0.00325, -0.00325, -0.005] },
    { name = "b1", position = [0.00325, -0.00325, -0.005] },
    { name = "b2", position = [-0.00325, 0.00325, -0.005] },
    { name = "b3", position = [0.00325, 0.00325, -0.005] },
]
[medium]
thickness = 0.010
young_modulus = 70e3
poisson_ratio = 0.49
"#;

fn skin(effects: Vec<Effect>) -> SkinDescription {
    let mut skin = SkinDescription::from_toml(PAD, "pad.toml").unwrap();
    skin.effects = effects;
    skin
}

fn refused(effects: Vec<Effect>) -> String {
    BarometerModel::new(&skin(effects)).unwrap_err().to_string()
}

/// What is done to the pad in a test.
#[derive(Debug, Clone, Copy)]
struct Act {
    /// Where it is pressed a second time, after a strong press that slides.
    place: [f64; 2],
    force: f64,
}

const ACT: Act = Act { place: [0.001, -0.004], force: 0.6 };
/// \[s\] between frames.
const DT: f64 = 0.02;

fn contact(x: f64, y: f64, force: f64) -> Indentation {
    Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -force), 0.004)
}

/// Seven seconds: a strong press above the first taxel that slides away; then, after a pause, a press beside a weaker one.
fn act(act: Act) -> Vec<Stimulus> {
    let ramp = |t: f64, from: f64, to: f64| ((t - from) / (to - from)).clamp(0.0, 1.0);
    (0..350)
        .map(|i| {
            let t = f64::from(i) * DT;
            let mut contacts = Vec::new();
            let strong = 1.8 * (ramp(t, 0.2, 0.7) - ramp(t, 2.7, 3.0));
            if strong > 0.0 {
                contacts.push(contact(-0.00325 + 0.006 * ramp(t, 1.7, 2.5), -0.00325, strong));
            }
            let level = ramp(t, 3.5, 4.0) - ramp(t, 6.0, 6.5);
            if level > 0.0 {
                contacts.push(contact(act.place[0], act.place[1], act.force * level));
                contacts.push(contact(-act.place[0], 0.008, 0.3 * level));
            }
            Stimulus { contacts, ..Stimulus::default() }
        })
        .collect()
}

static NOMINAL: LazyLock<Arc<BarometerModel>> =
    LazyLock::new(|| Arc::new(BarometerModel::new(&skin(vec![])).unwrap()));

/// The model of a pad with one effect, and what it starts with. Tables are the slow part of a model: those that an
/// effect does not change are made once.
fn device(effect: Effect) -> (Arc<BarometerModel>, Dynamics) {
    let skin = skin(vec![effect]);
    let mut parameters = Parameters::nominal(&skin).unwrap();
    shape(&skin, &mut parameters).unwrap();
    let model = if parameters == Parameters::nominal(&skin).unwrap() {
        Arc::clone(&NOMINAL)
    } else {
        Arc::new(BarometerModel::new(&skin).unwrap())
    };
    (model, Dynamics::new(&skin).unwrap())
}

/// A model that starts with other dynamics than its own.
struct Started {
    model: Arc<BarometerModel>,
    dynamics: Dynamics,
}

impl Wrapper for Started {
    const CHANGES_RESPONSE: bool = false;

    fn inner(&self) -> &dyn ForwardModel {
        self.model.as_ref()
    }

    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Stepped::new(self.model.as_ref(), self.dynamics.start(seed)))
    }
}

/// The promises that every family's effects keep.
fn suite() -> Effects<'static> {
    Effects {
        known: EFFECTS,
        skin: &skin,
        device: &|skin| {
            Effect::check(&skin.effects, EFFECTS, &skin.name)?;
            let (model, dynamics) = match &skin.effects[..] {
                [one] => device(one.clone()),
                _ => (Arc::clone(&NOMINAL), Dynamics::new(skin)?),
            };
            Ok(Arc::new(Started { model, dynamics }))
        },
        frame: DT,
    }
}

fn acts() -> impl Strategy<Value = Act> {
    ((-0.008..0.008f64), (-0.008..0.004f64), 0.1..1.2f64)
        .prop_map(|(x, y, force)| Act { place: [x, y], force })
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
    suite().are_named_and_parametrised(&act(ACT));
}

#[test]
fn a_model_starts_with_the_effects_of_its_skin() {
    let whole = Effects { device: &|skin| Ok(Arc::new(BarometerModel::new(skin)?)), ..suite() };
    let relaxing = || vec![Effect::new("relaxation")];
    let stimuli = act(ACT);
    let found = whole.readings(relaxing(), &stimuli);
    assert!(found == suite().readings(relaxing(), &stimuli));
    assert!(found != suite().readings(vec![], &stimuli));
}

#[test]
fn what_wanders_does_so_otherwise_after_another_start() {
    for name in ["trapped-air", "ambient-pressure"] {
        let dynamics = Dynamics::new(&skin(vec![Effect::new(name).seed(3)])).unwrap();
        let read = |start: u64| {
            let (mut memory, mut out) = (dynamics.start(start), [0.0; 4]);
            for t in [0.0, 3600.0] {
                out = [0.0; 4];
                memory.apply_transducer(t, &Stimulus::default(), &mut out);
            }
            out
        };
        assert_eq!(read(1), read(1), "{name}");
        assert!(read(0) != read(1) && read(1) != read(2), "{name}");
    }
}

#[test]
fn impossible_devices_are_refused_by_field() {
    insta::assert_snapshot!(refused(vec![Effect::new("tilt"), Effect::new("gain")]), @r#"skin `pad`: field `effects[1].name`: "gain" is no effect of this sensor; it has modulus, thickness, base-bonding, misplacement, tilt, footprint, inclusion-gain, package-stiffening, indenter-size, friction, mullins, hysteresis, relaxation, trapped-air, ambient-pressure, read-skew, saturation, resolution"#);
    insta::assert_snapshot!(refused(vec![Effect::new("tilt"), Effect::new("tilt")]), @r#"skin `pad`: field `effects[1].name`: "tilt" is already there"#);
    insta::assert_snapshot!(refused(vec![Effect::new("base-bonding").strength(3.0)]), @"skin `pad`: field `effects[0].strength`: is 3, and makes 1.5 of the base slip: 1 at most");
    insta::assert_snapshot!(refused(vec![Effect::new("thickness").with("change", -0.006)]), @"skin `pad`: field `effects[0].change`: leaves a taxel at a depth of 0.005000 m in 0.004000 m of elastomer");
    insta::assert_snapshot!(refused(vec![Effect::new("misplacement").strength(1000.0)]), @"skin `pad`: field `effects[0].depth`: leaves a taxel at a depth of -0.040859 m in 0.010000 m of elastomer");
    insta::assert_snapshot!(refused(vec![Effect::new("relaxation").strength(20.0)]), @"skin `pad`: field `effects[0].strength`: is 20, and takes 1.6 of a signal away: at most 1");
    insta::assert_snapshot!(refused(vec![Effect::new("tilt"), Effect::new("friction").with("mu", 1.0)]), @"skin `pad`: field `effects[1].mu`: is no parameter of friction; it has coefficient");
}

#[test]
fn another_effect_or_channel_changes_no_draw() {
    let of = |skin: &SkinDescription| {
        let mut parameters = Parameters::nominal(skin).unwrap();
        shape(skin, &mut parameters).unwrap();
        parameters.elements
    };
    let gain = Effect::new("inclusion-gain").seed(5);
    let alone = of(&skin(vec![gain.clone()]));
    let among = of(&skin(vec![Effect::new("misplacement").seed(5), gain.clone()]));
    assert!(alone.iter().zip(&among).all(|(a, b)| a.gain == b.gain && a.position != b.position));
    let mut fewer = skin(vec![gain]);
    fewer.taxels.pop();
    let fewer = toml::to_string(&fewer).unwrap();
    // Channels follow taxels where the file names none.
    let channels = fewer.find("[[channels]]").unwrap();
    let medium = fewer.find("[medium]").unwrap();
    let text = format!("{}{}", &fewer[..channels], &fewer[medium..]);
    let fewer = of(&SkinDescription::from_toml(&text, "pad.toml").unwrap());
    assert!(alone[..3].iter().zip(&fewer).all(|(a, b)| a.gain == b.gain));
}

/// What one effect makes over signals of the first channel, at these times.
fn stepped(effect: Effect, signal: impl IntoIterator<Item = (f64, f64)>) -> Vec<f64> {
    let mut memory = Dynamics::new(&skin(vec![effect])).unwrap().start(0);
    let step = |(t, s): (f64, f64)| {
        let mut readings = [s, 0.0, 0.0, s];
        memory.apply_transducer(t, &Stimulus::default(), &mut readings);
        memory.quantize(&mut readings);
        readings[0]
    };
    signal.into_iter().map(step).collect()
}

#[test]
fn relaxation_is_exact_between_corners() {
    let signal = |t: f64| 1000.0 * (t.min(1.0) - (t - 3.0).clamp(0.0, 0.5) * 2.0);
    let fine: Vec<f64> = (0..=700).map(|i| f64::from(i) * 0.01).collect();
    let coarse = [0.0, 1.0, 1.5, 3.0, 3.5, 7.0];
    let relaxation = || Effect::new("relaxation");
    let all = stepped(relaxation(), fine.iter().map(|t| (*t, signal(*t))));
    let few = stepped(relaxation(), coarse.iter().map(|t| (*t, signal(*t))));
    for (t, found) in coarse.iter().zip(few) {
        let exact = all[(t / 0.01).round() as usize];
        assert!((found - exact).abs() < 1e-9, "{t}: {found} for {exact}");
    }
    // A step that is held fades by the shares of both terms in the end.
    let held = stepped(relaxation(), [(0.0, 0.0), (1e-6, 1000.0), (1e4, 1000.0)]);
    approx::assert_relative_eq!(held[1], 1000.0, max_relative = 1e-5);
    approx::assert_relative_eq!(held[2], 920.0, max_relative = 1e-9);
}

#[test]
fn hysteresis_has_the_loop_that_was_asked_for() {
    let up = (0..=100).map(|i| f64::from(i) * 100.0);
    let cycle: Vec<f64> = up.clone().chain(up.clone().rev()).chain(up).collect();
    let out = stepped(Effect::new("hysteresis"), cycle.iter().enumerate().map(|(i, s)| (i as f64, *s)));
    // In the middle of the second loading and of the unloading before.
    approx::assert_relative_eq!(out[151] - out[252], 0.1 * 5000.0, max_relative = 1e-9);
    // Where it grows with the load it is a share of the signal, 5 and 2 kPa, but for what friction takes to turn round.
    let with_load = Effect::new("hysteresis").with("with_load", 1.0);
    let out = stepped(with_load, cycle.iter().enumerate().map(|(i, s)| (i as f64, *s)));
    for (unloading, loading, stress) in [(151, 252, 5000.0), (181, 222, 2000.0)] {
        let loop_ = out[unloading] - out[loading];
        approx::assert_relative_eq!(loop_, 0.1 * stress, max_relative = 1e-3);
    }
}

#[test]
fn softening_shows_below_the_largest_stress_only() {
    let out = stepped(Effect::new("mullins"), [(0.0, 4000.0), (1.0, 1000.0), (2.0, 4000.0), (3.0, 8000.0)]);
    assert_eq!((out[0], out[2], out[3]), (4000.0, 4000.0, 8000.0));
    approx::assert_relative_eq!(out[1], 1000.0 * (1.0 - 0.075 * 0.75 * 0.8), max_relative = 1e-12);
}

#[test]
fn channels_are_read_one_after_another() {
    let mut memory =
        Dynamics::new(&skin(vec![Effect::new("read-skew").with("delay", 0.013)])).unwrap().start(0);
    for i in 0..20 {
        let t = f64::from(i) * DT;
        let mut readings = [100.0 * t; 4];
        memory.apply_transducer(t, &Stimulus::default(), &mut readings);
        for (channel, reading) in readings.iter().enumerate() {
            let at = (t - 0.013 * (3 - channel) as f64).max(0.0);
            assert!((reading - 100.0 * at).abs() < 1e-9, "channel {channel} at {t} s: {reading}");
        }
    }
}

#[test]
fn air_expands_and_gives_way() {
    let air = Effect::new("trapped-air").with("room", 0.0).with("share", 0.2);
    let mut memory = Dynamics::new(&skin(vec![air])).unwrap().start(0);
    let mut next = |t, temperature, stress: f64| {
        let mut readings = [stress; 4];
        memory.apply_transducer(t, &Stimulus { temperature, ..Stimulus::default() }, &mut readings);
        readings
    };
    let (cold, pressed, warm) = (next(0.0, 293.15, 0.0), next(0.0, 293.15, 1000.0), next(0.0, 303.15, 0.0));
    assert_eq!(cold, [0.0; 4]);
    for (pressed, warm) in pressed.iter().zip(&warm) {
        // The same share of each port is air: 0.35 kPa/K of it.
        let share = 1.0 - pressed / 1000.0;
        assert!((0.0..=0.4).contains(&share));
        approx::assert_relative_eq!(*warm, share * 101_325.0 / 293.15 * 10.0, max_relative = 1e-9);
    }
    let later = next(1e5, 293.15, 0.0);
    assert!(later.iter().zip(&warm).all(|(heated, warm)| (heated / warm - 0.05).abs() < 1e-9), "{later:?}");
}

#[test]
fn the_weather_is_the_same_for_all_and_wanders_as_slowly_as_was_asked() {
    let weather = Effect::new("ambient-pressure").with("time", 1000.0);
    let (mut moved, mut spread, devices) = (0.0, 0.0, 400);
    for seed in 0..devices {
        let out = stepped(weather.clone().seed(seed), [(0.0, 0.0), (10.0, 0.0)]);
        moved += (out[1] - out[0]).powi(2);
        spread += out[0].powi(2);
    }
    let deviation = |squares: f64| (squares / devices as f64).sqrt();
    approx::assert_relative_eq!(deviation(spread), 1000.0, max_relative = 0.15);
    approx::assert_relative_eq!(deviation(moved), 1000.0 * f64::sqrt(2.0 * 0.01), max_relative = 0.15);
}

#[test]
fn the_converter_ends_and_counts() {
    let ends =
        |strength| stepped(Effect::new("saturation").strength(strength), [(0.0, 9000.0), (1.0, 8000.0)]);
    assert_eq!(ends(1.0), [8700.0, 8000.0]);
    assert_eq!(ends(0.5), [8850.0, 8000.0]);
    assert_eq!(ends(7.0), [8700.0, 8000.0]);
    let out = stepped(Effect::new("resolution").with("step", 2.0), [(0.0, 9000.7), (1.0, -3.2)]);
    assert_eq!(out, [9000.0, -4.0]);
}

#[test]
fn a_sliding_tip_is_dragged_along_its_way() {
    let mut memory = Dynamics::new(&skin(vec![Effect::new("friction")])).unwrap().start(0);
    let mut next = |t: f64, x: f64| {
        let mut stimulus = Stimulus { contacts: vec![contact(x, 0.0, 0.5)], ..Stimulus::default() };
        memory.apply_to_stimulus(t, &mut stimulus);
        stimulus.contacts[0].force
    };
    assert_eq!(next(0.0, 0.0), Vector3::new(0.0, 0.0, -0.5));
    assert_eq!(next(0.1, 0.0), Vector3::new(0.0, 0.0, -0.5));
    assert_eq!(next(0.2, 0.001), Vector3::new(0.4, 0.0, -0.5));
    assert_eq!(next(0.3, -0.001), Vector3::new(-0.4, 0.0, -0.5));
    // Too fast to be the same contact: another place is pressed.
    assert_eq!(next(0.301, 0.009), Vector3::new(0.0, 0.0, -0.5));
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
        let electronic = ["saturation", "resolution"].contains(&info.name);
        assert_eq!(moves(info)?, !info.stateful && !electronic, "{}", info.name);
    }
    Ok(())
}

#[test]
fn what_changes_the_elastomer_changes_how_deep_a_tip_sinks() {
    let depth = |effect: Effect| {
        device(effect).0.depth_at(&Point3::new(-0.00325, -0.00325, 0.0), 0.004, 0.5).unwrap()
    };
    let nominal = depth(Effect::new("tilt"));
    for effect in ["modulus", "package-stiffening", "indenter-size"] {
        assert!(depth(Effect::new(effect)) < nominal, "{effect}");
    }
    for effect in ["thickness", "base-bonding"] {
        assert!(depth(Effect::new(effect)) > nominal, "{effect}");
    }
    assert_eq!(NOMINAL.force_at(&Point3::origin(), 0.004, nominal).map(|f| (f * 1e9).round()), Some(5e8));
}
