use std::sync::Arc;

use dermis_fixtures::SkinFile;
use dermis_skin::{Effect, ModelError, SkinDescription, Surface};
use nalgebra::{Point3, Vector3};

use super::diagnosis::{Evidence, Signature, SignatureSample};
use super::{Act, Settings};
use crate::{
    COMMON, CommonEffect, CommonParameters, DeviceState, ForwardModel, Indentation, Memory,
    NEUTRAL_TEMPERATURE, Stage, Stepped, Stimulus, Wrapper, common_effect, device, full_scale,
};

/// Reads force over distance.
struct Plain {
    surface: Surface,
    taxels: Vec<Point3<f64>>,
}

impl ForwardModel for Plain {
    fn channels(&self) -> usize {
        self.taxels.len()
    }
    fn surface(&self) -> &Surface {
        &self.surface
    }
    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        for (o, t) in out.iter_mut().zip(&self.taxels) {
            let felt = |c: &Indentation| c.force.norm() / (c.position - t).norm() * (c.diameter() / 0.004);
            *o = stimulus.contacts.iter().map(felt).sum();
        }
        Ok(())
    }
    fn noise(&self) -> &[f64] {
        &[1.0, 1.0]
    }
    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        for (o, point) in out.iter_mut().zip(&self.surface.points) {
            let sunk = |c: &Indentation| c.force.norm() / (1.0 + (c.position - point).norm());
            *o = stimulus.contacts.iter().map(sunk).sum();
        }
        Ok(true)
    }
    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        Some(depth * diameter * (1.0 + at.x))
    }
    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        Some(force / (diameter * (1.0 + at.x)))
    }
}

fn made(effects: Vec<Effect>) -> Result<Arc<dyn ForwardModel>, ModelError> {
    let mut skin = SkinFile::new("pad").read();
    skin.effects = effects;
    device(&skin, |inner| {
        assert!(inner.effects.iter().all(|e| e.name == "inner"));
        Ok(Arc::new(Plain {
            surface: inner.surface(),
            taxels: inner.taxels.iter().map(dermis_skin::Taxel::point).collect(),
        }))
    })
}

fn press(x: f64, force: f64) -> Stimulus {
    let contact = Indentation::sphere(Point3::new(x, 0.0, 0.0), Vector3::new(0.0, 0.0, -force), 0.004);
    Stimulus { contacts: vec![contact], ..Stimulus::default() }
}

fn read(effects: Vec<Effect>, stimulus: &Stimulus) -> [f64; 2] {
    let mut out = [0.0; 2];
    made(effects).unwrap().response(stimulus, &mut out).unwrap();
    out
}

#[test]
fn nothing_is_around_a_skin_without_common_effects() {
    assert_eq!(read(vec![Effect::new("inner")], &press(0.001, 1.0)), read(vec![], &press(0.001, 1.0)));
}

#[test]
fn electronics_come_after_the_medium() {
    let plain = read(vec![], &press(0.0, 1.0));
    let effects = vec![
        Effect::new("channel-gain").with("a", 1.2).strength(0.5),
        Effect::new("channel-offset").with("b", 3.0),
        Effect::new("channel-order").with("a", 1.0).with("b", 0.0),
    ];
    let changed = read(effects, &press(0.0, 1.0));
    approx::assert_relative_eq!(changed[0], plain[1] + 3.0, max_relative = 1e-12);
    approx::assert_relative_eq!(changed[1], plain[0] * 1.1, max_relative = 1e-12);
}

#[test]
fn what_the_rig_says_is_not_what_touches() {
    let shifted = read(vec![Effect::new("truth-shift").with("x", 0.002)], &press(0.001, 1.0));
    assert_eq!(shifted, read(vec![], &press(0.003, 1.0)));
    let stronger =
        vec![Effect::new("force-scale").with("factor", 1.5), Effect::new("force-zero").with("force", 0.1)];
    let (found, wanted) = (read(stronger, &press(0.001, 1.0)), read(vec![], &press(0.001, 1.6)));
    approx::assert_relative_eq!(found[0], wanted[0], max_relative = 1e-12);
}

fn displaced(effects: Vec<Effect>, stimulus: &Stimulus) -> Vec<f64> {
    let model = made(effects).unwrap();
    let mut out = vec![0.0; model.surface().points.len()];
    assert!(model.displacement(stimulus, &mut out).unwrap());
    out
}

#[test]
fn a_device_with_common_effects_has_a_displacement_map() {
    let plain = displaced(vec![], &press(0.003, 1.5));
    assert_eq!(displaced(vec![Effect::new("channel-offset").with("b", 3.0)], &press(0.003, 1.5)), plain);
    let rig =
        vec![Effect::new("truth-shift").with("x", 0.002), Effect::new("force-scale").with("factor", 1.5)];
    assert_eq!(displaced(rig, &press(0.001, 1.0)), plain);
}

#[test]
fn forces_and_depths_are_those_that_the_rig_states() {
    let (at, tip) = (Point3::new(0.001, 0.0, 0.0), 0.004);
    let plain = made(vec![]).unwrap();
    let rig = made(vec![
        Effect::new("truth-shift").with("x", 0.002),
        Effect::new("tip-scale").with("factor", 1.25),
        Effect::new("force-scale").with("factor", 1.5),
        Effect::new("force-zero").with("force", 0.1),
    ])
    .unwrap();
    let depth = 100.0;
    let stated = rig.force_at(&at, tip, depth).unwrap();
    let real = plain.force_at(&Point3::new(0.003, 0.0, 0.0), tip * 1.25, depth).unwrap();
    approx::assert_relative_eq!(stated * 1.5 + 0.1, real, max_relative = 1e-12);
    approx::assert_relative_eq!(rig.depth_at(&at, tip, stated).unwrap(), depth, max_relative = 1e-12);
    // The cell says nothing yet, though the tip touches.
    assert_eq!(rig.force_at(&at, tip, 1.0), None);
}

#[test]
fn taxels_move() {
    let moved = read(vec![Effect::new("taxel-position").with("a.x", 0.005)], &press(0.0, 1.0));
    approx::assert_relative_eq!(moved[0], 1.0 / 0.005, max_relative = 1e-12);
}

#[test]
fn a_delay_is_one_of_all_readings() {
    let model = made(vec![Effect::new("delay").with("time", 0.015)]).unwrap();
    let mut state = model.start(0);
    let mut last = [0.0; 2];
    for frame in 0..10 {
        let stimulus = press(0.0, f64::from(frame));
        state.step(f64::from(frame) * 0.01, &stimulus, &mut last).unwrap();
    }
    let before = read(vec![], &press(0.0, 7.5));
    approx::assert_relative_eq!(last[0], before[0], max_relative = 1e-9);
}

/// What every common effect is switched on by in a test.
fn switched_on(info: &CommonEffect) -> Effect {
    let effect = Effect::new(info.name);
    match (info.name, info.parameters) {
        ("channel-gain", _) => effect.with("a", 1.3),
        ("channel-order", _) => effect.with("a", 1.0).with("b", 0.0),
        (_, CommonParameters::Channels | CommonParameters::ChannelsAnd(_)) => {
            effect.with("a", 0.02).with("b", -0.03)
        }
        (_, CommonParameters::Taxels) => effect.with("a.x", 1e-3).with("b.y", 2e-3),
        (_, CommonParameters::Named(named)) => named.iter().fold(effect, |effect, p| {
            let far = p.range[1];
            effect.with(p.name, if p.name == "frequency" { 13.0 } else { far })
        }),
    }
}

/// Readings of a warm skin that is pressed by more and more.
fn along(effects: Vec<Effect>) -> Vec<f64> {
    let model = made(effects).unwrap();
    let mut state = model.start(0);
    let mut all = Vec::new();
    for frame in 1..40 {
        let mut read = [0.0; 2];
        let t = 0.01 * f64::from(frame);
        let stimulus =
            Stimulus { temperature: 300.0, ..press(0.002, if frame > 10 { 3.0 * t } else { 0.0 }) };
        state.step(t, &stimulus, &mut read).unwrap();
        all.extend(read);
    }
    all
}

#[test]
fn every_effect_grows_from_nothing() {
    let plain = along(vec![]);
    let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    for info in COMMON {
        assert!(!info.what.is_empty() && !info.source.is_empty(), "{}", info.name);
        // Nothing is said, or nothing of it is switched on.
        assert_eq!(bits(&along(vec![Effect::new(info.name)])), bits(&plain), "{}", info.name);
        let on = switched_on(info);
        assert_eq!(bits(&along(vec![on.clone().strength(0.0)])), bits(&plain), "{}", info.name);
        let mut last = 0.0;
        for strength in [0.25, 0.5, 1.0] {
            let read = along(vec![on.clone().strength(strength)]);
            let off: f64 = read.iter().zip(&plain).map(|(a, b)| (a - b).powi(2)).sum();
            let grows = off > last || info.name == "channel-order" && off > 0.0;
            assert!(grows, "{} at {strength}: {off} after {last}", info.name);
            last = off;
        }
    }
}

#[test]
fn every_effect_remembers_what_it_should() {
    for info in COMMON {
        let model = made(vec![switched_on(info)]).unwrap();
        let mut still = [0.0; 2];
        let after = along(vec![switched_on(info)]);
        // The same stimulus as the last of that way.
        let stimulus = Stimulus { temperature: 300.0, ..press(0.002, 3.0 * 0.01 * 39.0) };
        model.response(&stimulus, &mut still).unwrap();
        let apart = after[after.len() - 2..].iter().zip(still).any(|(a, b)| (a - b).abs() > 1e-9 * b.abs());
        assert_eq!(apart, info.stateful, "{}", info.name);
    }
}

#[test]
fn every_named_parameter_has_a_sense_and_survives_a_file() {
    for info in COMMON {
        for p in info.named() {
            let nested = p.limits[0] <= p.range[0] && p.range[0] <= p.range[1] && p.range[1] <= p.limits[1];
            let inside = (p.limits[0]..=p.limits[1]).contains(&p.typical);
            assert!(nested && inside && !p.what.is_empty(), "{}.{}", info.name, p.name);
            assert_eq!(info.unit_of(p.name), p.unit);
        }
        let mut skin = SkinFile::new("pad").read();
        skin.effects = vec![switched_on(info)];
        let text = toml::to_string(&skin).unwrap();
        assert_eq!(SkinDescription::from_toml(&text, "written").unwrap().effects, skin.effects);
    }
}

#[test]
fn neighbours_on_the_bus_read_each_other() {
    let plain = read(vec![], &press(0.001, 1.0));
    let coupled = read(vec![Effect::new("crosstalk").with("before", 0.2)], &press(0.001, 1.0));
    assert_eq!(coupled[0], plain[0]);
    approx::assert_relative_eq!(coupled[1], plain[1] + 0.2 * plain[0], max_relative = 1e-12);
}

/// Remembers the largest reading, as a medium does: what comes after it in the device must not reach it.
struct Largest(Vec<f64>);

impl Memory for Largest {
    fn apply_transducer(&mut self, _: f64, _: &Stimulus, readings: &mut [f64]) {
        for (largest, r) in self.0.iter_mut().zip(readings) {
            *largest = largest.max(*r);
            *r = *largest;
        }
    }
}

struct Remembering(Arc<dyn ForwardModel>);

impl Wrapper for Remembering {
    const CHANGES_RESPONSE: bool = false;
    fn inner(&self) -> &dyn ForwardModel {
        self.0.as_ref()
    }
    fn start(&self, _: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Stepped::new(self, Largest(vec![0.0; 2])))
    }
}

#[test]
fn electronics_come_after_what_the_medium_remembers() {
    let mut skin = SkinFile::new("pad").read();
    // Far beyond the vertex: what came out could never be taken back.
    skin.effects =
        vec![Effect::new("channel-curvature").with("a", -3.0), Effect::new("channel-offset").with("a", 7.0)];
    let nominal = SkinFile::new("pad").read();
    let plain = |inner: &SkinDescription| -> Arc<dyn ForwardModel> {
        Arc::new(Plain {
            surface: inner.surface(),
            taxels: inner.taxels.iter().map(dermis_skin::Taxel::point).collect(),
        })
    };
    let make = |inner: &SkinDescription| -> Result<Arc<dyn ForwardModel>, ModelError> {
        Ok(Arc::new(Remembering(plain(inner))))
    };
    let model = device(&skin, make).unwrap();
    let mut state = model.start(0);
    let mut out = [0.0; 2];
    let mut felt = [0.0; 2];
    plain(&nominal).response(&press(0.001, 1.5), &mut felt).unwrap();
    for force in [0.5, 1.5, 0.2] {
        state.step(0.0, &press(0.001, force), &mut out).unwrap();
    }
    let full = full_scale(&skin.channels()[0], skin.noise);
    let straight = felt[0].min(full / 6.0);
    approx::assert_relative_eq!(
        out[0],
        straight - 3.0 * straight * straight / full + 7.0,
        max_relative = 1e-12
    );
    approx::assert_relative_eq!(out[1], felt[1], max_relative = 1e-12);
}

#[test]
fn acts_come_in_the_order_of_the_signal() {
    for pair in COMMON.windows(2) {
        // Warm-up acts at two stages.
        let next = pair[1].stage >= pair[0].stage;
        assert!(next, "{} stands before {}", pair[0].name, pair[1].name);
    }
    for info in COMMON {
        assert_eq!(info.rig, info.stage == Stage::Rig, "{}", info.name);
    }
}

#[test]
fn a_signature_is_the_slope_of_its_effect() {
    let stimulus = Stimulus { temperature: 299.0, ..press(0.001, 1.3) };
    let skin = SkinFile::new("pad").read();
    let sample = SignatureSample {
        reading: read(vec![], &stimulus)[0],
        full_scale: full_scale(&skin.channels()[0], skin.noise),
        warmer: 299.0 - NEUTRAL_TEMPERATURE,
        uptime: 40.0,
        presses: 1.0,
    };
    let mut seen = 0;
    for info in COMMON {
        let step = |parameter: &str, time: f64| {
            let at = |by: f64| {
                let effect = Effect::new(info.name).with(parameter, info.diagnosis.neutral + by);
                let (model, mut out) = (made(vec![effect]).unwrap(), [0.0; 2]);
                model.start(0).step(time, &stimulus, &mut out).unwrap();
                out[0]
            };
            (at(1e-5) - at(-1e-5)) / 2e-5
        };
        match info.diagnosis.signature {
            Signature::Channels { slope, .. } => {
                approx::assert_relative_eq!(step("a", 0.0), slope(&sample), max_relative = 1e-6);
                seen += 1;
            }
            Signature::Shares(shares) => {
                for share in shares {
                    let expected = (share.slope)(&sample) * sample.reading;
                    approx::assert_relative_eq!(step(share.parameter, 40.0), expected, max_relative = 1e-6);
                    seen += 1;
                }
            }
            _ => {}
        }
    }
    assert_eq!(seen, 8);
}

#[test]
fn what_a_diagnosis_is_said_fits_the_parameters() {
    for info in COMMON {
        let of = &info.diagnosis;
        let has = |name: &str| info.named().iter().any(|p| p.name == name);
        match of.signature {
            Signature::Simulated(variations) => {
                assert!(variations.iter().all(|v| has(v.parameter)), "{}", info.name);
            }
            Signature::Shares(shares) => assert!(shares.iter().all(|s| has(s.parameter)), "{}", info.name),
            Signature::DecayFromPowerOn { time, share } => assert!(has(time) && has(share.0)),
            Signature::Channels { .. } | Signature::Taxels => assert!(info.per_channel(), "{}", info.name),
            Signature::None => assert_ne!(of.evidence, Evidence::Residual, "nothing shows {}", info.name),
        }
        if let Evidence::Spectrum { amplitude, frequency } = of.evidence {
            assert!(has(amplitude) && has(frequency));
        }
        assert!(of.free.iter().filter_map(|f| f.parameter).all(has), "{}", info.name);
        assert!(of.tolerance.is_none_or(|(parameter, _)| has(parameter)), "{}", info.name);
        assert!(of.addition_to.is_none_or(|other| common_effect(other).is_some()), "{}", info.name);
        // The value that changes nothing is the one that files may leave out.
        let typical = info.named().iter().map(|p| p.typical);
        if matches!(of.signature, Signature::Simulated(_)) {
            assert!(typical.into_iter().all(|value| value == of.neutral), "{}", info.name);
        }
    }
}

#[test]
fn what_is_not_straight_does_not_turn_back() {
    let skin = SkinFile::new("pad").read();
    for curvature in [-3.0, -0.4, 0.4, 3.0] {
        let full = full_scale(&skin.channels()[0], skin.noise);
        let effect = Effect::new("channel-curvature").with("a", curvature);
        let info = common_effect("channel-curvature").unwrap();
        let acts = (info.acts)(&Settings::new(info, &effect, &skin).unwrap()).unwrap();
        let [Act::Reading(Stage::Transducer, act)] = &acts[..] else { panic!("one act on readings") };
        let read = |share: f64| {
            let mut readings = [share * full; 2];
            act.apply(0.0, &mut readings);
            readings[0] / full
        };
        approx::assert_relative_eq!(read(0.1), 0.1 + 0.01 * curvature, max_relative = 1e-12);
        let all: Vec<f64> = (-20..=20).map(|i| read(0.1 * f64::from(i))).collect();
        assert!(all.windows(2).all(|w| w[1] >= w[0]), "{curvature}: {all:?}");
    }
}

#[test]
fn time_since_power_on_matters_to_what_warms_and_what_wears() {
    let at = |effect: Effect, time: f64, force: f64| {
        let model = made(vec![effect]).unwrap();
        let (stimulus, mut out) = (press(0.001, force), [0.0; 2]);
        model.start(0).step(time, &stimulus, &mut out).unwrap();
        out
    };
    let cold = || Effect::new("warm-up").with("a", 5.0).with("time", 100.0);
    approx::assert_relative_eq!(at(cold(), 100.0, 0.0)[0], 5.0 / 1.0f64.exp(), max_relative = 1e-12);
    assert_eq!(at(cold(), 100.0, 0.0)[1], 0.0);
    let plain = read(vec![], &press(0.001, 2.0));
    let worn = at(Effect::new("ageing").with("rate", 1e-3), 500.0, 2.0);
    approx::assert_relative_eq!(worn[0], plain[0] * (-0.5f64).exp(), max_relative = 1e-12);
    let pressed = at(Effect::new("ageing").with("wear", 0.1), 500.0, 2.0);
    approx::assert_relative_eq!(pressed[0], plain[0] * (-0.1f64).exp(), max_relative = 1e-12);
    let warm = at(Effect::new("warm-up").with("span", 0.2).with("time", 100.0), 100.0, 2.0);
    approx::assert_relative_eq!(warm[0], plain[0] * (1.0 + 0.2 / 1.0f64.exp()), max_relative = 1e-12);
    let mains = Effect::new("interference").with("amplitude", 3.0).with("frequency", 10.0);
    approx::assert_relative_eq!(at(mains, 0.025, 2.0)[1], plain[1] + 3.0, max_relative = 1e-12);
}

#[test]
fn refusals_name_the_parameter() {
    let refused = |effect| made(vec![effect]).err().unwrap().to_string();
    insta::assert_snapshot!(refused(Effect::new("channel-gain").with("c", 1.0)), @"skin `pad`: field `effects[0].c`: is no channel of this skin; it has a, b");
    insta::assert_snapshot!(refused(Effect::new("channel-gain").with("a", 0.0)), @"skin `pad`: field `effects[0].a`: is 0 and must not be 0: mask a dead channel");
    insta::assert_snapshot!(refused(Effect::new("delay").with("time", -1.0)), @"skin `pad`: field `effects[0].time`: is -1 s and must be 0 or positive");
    insta::assert_snapshot!(refused(Effect::new("truth-shift").with("w", 1.0)), @"skin `pad`: field `effects[0].w`: is no parameter of truth-shift; it has x, y, z, turn");
    insta::assert_snapshot!(refused(Effect::new("taxel-position").with("a", 1.0)), @r#"skin `pad`: field `effects[0].a`: names a taxel and an axis, e.g. "t0.x""#);
    insta::assert_snapshot!(refused(Effect::new("crosstalk").with("before", 0.7)), @"skin `pad`: field `effects[0].before`: is 0.7 and must be -0.49 to 0.49");
    insta::assert_snapshot!(refused(Effect::new("crosstalk").with("after", 0.3).strength(2.0)), @"skin `pad`: field `effects[0].after`: is 0.6 at this strength and must stay below 0.5");
    insta::assert_snapshot!(refused(Effect::new("warm-up").with("time", 0.0)), @"skin `pad`: field `effects[0].time`: is 0 s and must be 1 to 100000");
    insta::assert_snapshot!(refused(Effect::new("channel-order").with("a", 7.0)), @"skin `pad`: field `effects[0].a`: is 7 and must be a place from 0 to 1");
}

#[test]
fn wrappers_forward_everything() {
    use crate::WithNoise;
    use crate::suite::{Probe, forwards_everything};
    let probe = Probe::default();
    forwards_everything(&probe, &[0.25, 0.5], true);
    forwards_everything(&WithNoise::new(&probe, vec![3.0, 4.0]), &[3.0, 4.0], true);
    let mut skin = SkinFile::new("pad").read();
    // Interference of 0 Hz and phase 0 is there, and adds nothing.
    let silent = Effect::new("interference").with("amplitude", 3.0).with("frequency", 0.0);
    skin.effects = vec![silent];
    let made = |skin: &SkinDescription| -> Result<Arc<dyn ForwardModel>, ModelError> {
        device(skin, |_| Ok(Arc::new(Probe::default())))
    };
    forwards_everything(made(&skin).unwrap().as_ref(), &[0.25, 0.5], false);

    // Pictures show what the rig really does: 2 N, where it says 1 N.
    skin.effects = vec![Effect::new("force-scale").with("factor", 2.0)];
    let model = made(&skin).unwrap();
    let image = model.start(1).capture(0.0, &press(0.0, 1.0), &mut || 0.0).unwrap().unwrap();
    assert_eq!(image.data(), [2 + 2 * 40]);
}

#[test]
fn derivatives_are_those_of_the_response() {
    let model = made(vec![]).unwrap();
    let stimulus = Stimulus {
        contacts: [press(0.001, 1.0), press(-0.004, 0.5)].map(|s| s.contacts[0].clone()).into(),
        ..Stimulus::default()
    };
    let mut out = [f64::NAN; 12];
    model.jacobian(&stimulus, crate::Unknowns::Normal, &crate::Differences::default(), &mut out).unwrap();
    for (c, contact) in stimulus.contacts.iter().enumerate() {
        for (k, taxel) in [-0.005, 0.005].into_iter().enumerate() {
            let (dx, force) = (contact.position.x - taxel, contact.force.norm());
            let r = f64::hypot(dx, 0.005);
            // force / r, by x, by y and by the force.
            let exact = [-force * dx / r.powi(3), 0.0, 1.0 / r];
            for (u, exact) in exact.into_iter().enumerate() {
                let found = out[c * 6 + u * 2 + k];
                assert!(
                    (found - exact).abs() <= 3e-4 * (exact.abs() + 1.0),
                    "{c} {k} {u}: {found} for {exact}"
                );
            }
        }
    }
    // At the end of the surface there is half of the step, and beyond the largest force none.
    let edge = press(0.01, 1.0);
    let held = crate::Differences { pressing: [1.0, 1.0], ..crate::Differences::default() };
    model.jacobian(&edge, crate::Unknowns::Normal, &held, &mut out[..6]).unwrap();
    let slope = -0.005 / f64::hypot(0.005, 0.005).powi(3);
    approx::assert_relative_eq!(out[1], slope, max_relative = 0.01);
    assert_eq!(out[4..6], [0.0, 0.0]);
}

#[test]
fn tips_of_other_shapes_are_refused_by_models_of_spheres() {
    use crate::{Tip, TipShape};
    let surface = made(vec![]).unwrap().surface().clone();
    let with = |shape| {
        let tip = Tip { shape, orientation: nalgebra::UnitQuaternion::identity() };
        Indentation { tip, ..press(0.0, 1.0).contacts[0].clone() }
    };
    let refused = |shape| with(shape).check(0, &surface).unwrap_err().to_string();
    insta::assert_snapshot!(refused(TipShape::FlatPunch { diameter: 0.004 }), @r#"contact 0: its tip is a flat-punch, and this model knows spheres only: give a tip of shape "sphere""#);
    let any = |shape| with(shape).check_any_tip(0, &surface).map_err(|e| e.to_string());
    any(TipShape::Wedge { angle: 1.5, length: 0.01 }).unwrap();
    insta::assert_snapshot!(any(TipShape::Wedge { angle: 4.0, length: 0.01 }).unwrap_err(), @"contact 0: the angle of its wedge is 4 rad and must be between 0 and π");
    insta::assert_snapshot!(any(TipShape::Polygon { sides: 2, diameter: 0.01 }).unwrap_err(), @"contact 0: its polygon has 2 sides and must have 3 to 64");
    insta::assert_snapshot!(any(TipShape::Box { size: [0.01, 0.0] }).unwrap_err(), @"contact 0: its second side is 0 m and must be 0.0001 to 0.1 m");
    insta::assert_snapshot!(any(TipShape::Cylinder { diameter: 0.01, length: 1.0 }).unwrap_err(), @"contact 0: its length is 1 m and must be 0.0001 to 0.1 m");
    assert_eq!(with(TipShape::Box { size: [0.03, 0.04] }).diameter(), 0.05);
    assert_eq!(with(TipShape::Cylinder { diameter: 0.01, length: 0.02 }.scaled(2.0)).diameter(), 0.04);
}
