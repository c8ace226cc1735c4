//! The engine on a small analytic skin. The worlds here are made by other laws than the signatures, and by other code.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::sync::Arc;

use dermis_gap::{Memory, Moment, Options, Phase, Recording, Report, Simulator, Tier, Verdict, diagnose};
use dermis_model::{DeviceState, ForwardModel, Indentation, Stepped, Stimulus};
use dermis_skin::{Effect, EffectInfo, ModelError, ParameterInfo, SkinDescription, Surface};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Time, phase, location, press, place, force and the rest of one frame of a world.
type Instant = (f64, Phase, u64, u32, Point3<f64>, f64, f64);

const SKIN: &str = r#"
schema = "dermis-skin/1"
name = "toy"
sensor = "toy"
frame_id = "toy_link"
unit = "Pa"
rate = 50.0
noise = 5.0
surface = { type = "rectangle", size = [0.030, 0.020], spacing = 0.002 }
taxels = [
    { name = "a", position = [-0.009, -0.005, -0.005] },
    { name = "b", position = [0.000, -0.005, -0.005] },
    { name = "c", position = [0.009, -0.005, -0.005] },
    { name = "d", position = [-0.009, 0.005, -0.005] },
    { name = "e", position = [0.000, 0.005, -0.005] },
    { name = "f", position = [0.009, 0.005, -0.005] },
]
[medium]
spread = 1.0
"#;

const fn parameter(name: &'static str, typical: f64, range: [f64; 2], limits: [f64; 2]) -> ParameterInfo {
    ParameterInfo { name, unit: "1", what: "a number", typical, range, limits }
}

const EFFECTS: &[EffectInfo] = &[
    EffectInfo {
        name: "gains",
        what: "Each taxel reads by a factor of its own.",
        source: "a test",
        parameters: &[parameter("spread", 0.1, [0.0, 0.2], [0.0, 0.9])],
        stateful: false,
        random: true,
    },
    EffectInfo {
        name: "misplacement",
        what: "Taxels lie elsewhere.",
        source: "a test",
        parameters: &[parameter("by", 4e-4, [0.0, 8e-4], [0.0, 4e-3])],
        stateful: false,
        random: true,
    },
    EffectInfo {
        name: "stiffening",
        what: "Strong presses read too much.",
        source: "a test",
        parameters: &[parameter("rise", 0.2, [-0.2, 0.3], [-0.9, 3.0])],
        stateful: false,
        random: false,
    },
    EffectInfo {
        name: "creep",
        what: "What is held fades.",
        source: "a test",
        parameters: &[
            parameter("share", 0.1, [0.0, 0.2], [0.0, 0.9]),
            parameter("time", 0.5, [0.1, 2.0], [1e-2, 1e3]),
        ],
        stateful: true,
        random: false,
    },
    EffectInfo {
        name: "weather",
        what: "All read what the air does.",
        source: "a test",
        parameters: &[parameter("deviation", 100.0, [10.0, 300.0], [0.0, 1e5])],
        stateful: true,
        random: true,
    },
];

fn stream(effect: &Effect, taxel: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(effect.seed.unwrap_or(0));
    rng.set_stream(1 + taxel as u64);
    rng
}

/// Point loads on a half space, as the tool knows them.
struct Toy {
    surface: Surface,
    taxels: Vec<Point3<f64>>,
    gains: Vec<f64>,
    spread: f64,
    rise: f64,
    noise: Vec<f64>,
    way: Way,
}

#[derive(Clone, Default)]
struct Way {
    creep: Option<(f64, f64)>,
    weather: Option<(f64, ChaCha8Rng, f64)>,
    state: Vec<f64>,
    last: Option<f64>,
}

impl Toy {
    fn make(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, String> {
        Effect::check(&skin.effects, EFFECTS, &skin.name).map_err(|e| e.to_string())?;
        let mut toy = Self {
            surface: skin.surface(),
            taxels: skin.taxels.iter().map(dermis_skin::Taxel::point).collect(),
            gains: vec![1.0; skin.taxels.len()],
            spread: skin.medium.get("spread").and_then(toml::Value::as_float).unwrap_or(1.0),
            rise: 0.0,
            noise: skin.channel_noise(),
            way: Way::default(),
        };
        for effect in skin.effects.iter().filter(|e| e.strength > 0.0) {
            let info = EFFECTS.iter().find(|i| i.name == effect.name).ok_or("unknown effect")?;
            let value = |name: &str| effect.strength * info.value(effect, name);
            match info.name {
                "gains" => {
                    for (t, gain) in toy.gains.iter_mut().enumerate() {
                        *gain = 1.0 + value("spread") * stream(effect, t).random_range(-1.0..=1.0);
                    }
                }
                "misplacement" => {
                    for (t, place) in toy.taxels.iter_mut().enumerate() {
                        let mut rng = stream(effect, t);
                        for axis in 0..3 {
                            place[axis] += value("by") * rng.random_range(-1.0..=1.0);
                        }
                    }
                }
                "stiffening" => toy.rise = value("rise"),
                "creep" => toy.way.creep = Some((value("share"), info.value(effect, "time"))),
                _ => toy.way.weather = Some((value("deviation"), stream(effect, 0), f64::NAN)),
            }
        }
        toy.way.state = vec![0.0; toy.taxels.len()];
        Ok(Arc::new(toy))
    }
}

impl ForwardModel for Toy {
    fn channels(&self) -> usize {
        self.taxels.len()
    }
    fn surface(&self) -> &Surface {
        &self.surface
    }
    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for c in &stimulus.contacts {
            let force = -c.force.z * (1.0 + self.rise * (-c.force.z));
            for ((o, t), gain) in out.iter_mut().zip(&self.taxels).zip(&self.gains) {
                let (along, deep) = ((c.position - t).xy().norm_squared() * self.spread, t.z * t.z);
                *o += gain * 0.5 * force * -t.z * deep / (along + deep).powf(2.5);
            }
        }
        Ok(())
    }
    fn noise(&self) -> &[f64] {
        &self.noise
    }
    fn start(&self, _: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Stepped::new(self, self.way.clone()))
    }
}

impl dermis_model::Memory for Way {
    fn apply_transducer(&mut self, time: f64, _: &Stimulus, readings: &mut [f64]) {
        let dt = time - self.last.unwrap_or(time);
        self.last = Some(time);
        if let Some((share, tau)) = self.creep {
            for (r, s) in readings.iter_mut().zip(&mut self.state) {
                *s += (*r - *s) * -(-dt / tau).exp_m1();
                *r -= share * *s;
            }
        }
        if let Some((deviation, rng, value)) = &mut self.weather {
            let draw: f64 = rng.sample(StandardNormal);
            *value = if value.is_nan() { draw } else { *value + draw * (2.0 * dt / 600.0).sqrt() };
            readings.iter_mut().for_each(|r| *r += *deviation * *value);
        }
    }
}

/// What the worlds are made by: nothing of the above.
#[derive(Default, Clone)]
struct World {
    gains: [f64; 6],
    /// \[m\] by which taxels are moved along x.
    moved: [f64; 6],
    /// Power that the force enters with, minus 1.
    power: f64,
    /// Shares and times of three exponentials.
    fade: Vec<(f64, f64)>,
    /// \[Pa/s\] of all channels.
    drift: f64,
    /// \[Pa\] of one channel, everywhere.
    zero: [f64; 6],
    /// \[s\] late.
    late: f64,
    /// \[m\] by which the rig is off.
    shift: f64,
    /// Reads this much less in a circle of 5 mm about (6, 0) mm.
    void: f64,
    /// Of the law of spread: 0 is the tool's.
    law: f64,
    /// \[Pa\] of every reading.
    noise: f64,
    /// A cause that nothing recorded goes with: of each press.
    whim: f64,
    /// Of what the taxel before it reads.
    leak: f64,
    /// Share of the sensitivity that all presses together take, each as much.
    wear: f64,
    /// \[Pa\] of each taxel at the beginning, gone by half every 30 s.
    cold: [f64; 6],
    /// \[Pa\] and \[Hz\] of a triangle wave on all.
    hum: (f64, f64),
}

fn world() -> World {
    World { noise: 5.0, law: 1.0, ..World::default() }
}

/// Presses at random places: load, hold, unload, rest; what the world reads.
fn recorded(world: &World, presses: usize, repeats: usize, seed: u64) -> Recording {
    let skin = SkinDescription::from_toml(SKIN, "toy.toml").unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut recording = Recording::new("toy world", 6);
    recording.sessions.push("one".to_owned());
    let dt = 0.02;
    let mut frames: Vec<Instant> = Vec::new();
    let mut t = 0.0;
    let origin = Point3::origin();
    let idle = |t: &mut f64, frames: &mut Vec<_>| {
        for _ in 0..60 {
            frames.push((*t, Phase::Idle, 0, 0, origin, 0.0, 0.0));
            *t += dt;
        }
    };
    idle(&mut t, &mut frames);
    let mut number = 0;
    for place in 0..presses {
        let at = Point3::new(rng.random_range(-0.013..0.013), rng.random_range(-0.008..0.008), 0.0);
        let force = rng.random_range(0.1..1.0);
        for _ in 0..repeats {
            number += 1;
            let (load, hold, unload) = (4, rng.random_range(10..30), 4);
            let whim = 1.0 + world.whim * rng.sample::<f64, _>(StandardNormal);
            let mut add = |phase: Phase, share: f64, t: &mut f64| {
                frames.push((*t, phase, number, place as u32 + 1, at, share * force, whim));
                *t += dt;
            };
            for i in 1..=load {
                add(Phase::Load, f64::from(i) / f64::from(load), &mut t);
            }
            (0..hold).for_each(|_| add(Phase::Hold, 1.0, &mut t));
            for i in 1..unload {
                add(Phase::Unload, 1.0 - f64::from(i) / f64::from(unload), &mut t);
            }
            (0..12).for_each(|_| add(Phase::Approach, 0.0, &mut t));
        }
        if place % 40 == 39 {
            idle(&mut t, &mut frames);
        }
    }
    idle(&mut t, &mut frames);
    let gain = |k: usize| 1.0 + world.gains[k];
    let elastic = |k: usize, at: &Point3<f64>, force: f64| -> f64 {
        if force <= 0.0 {
            return 0.0;
        }
        let p = skin.taxels[k].position;
        let away = (at.x + world.shift - p[0] - world.moved[k]).hypot(at.y - p[1]);
        let q = (away / 0.005).powi(2);
        // Another law of spread of about the same width, mixed in.
        let spread = (1.0 + q).powf(-2.5) * (1.0 + world.law * 0.04 * (1.0 - q).exp());
        let near = (at.x - 0.006).hypot(at.y) < 0.005;
        let void = if near { 1.0 - world.void } else { 1.0 };
        gain(k) * void * 0.5 * force.powf(1.0 + world.power) / 0.005f64.powi(2) * spread
    };
    let mut fading = vec![[0.0; 6]; world.fade.len()];
    let mut late: Vec<[f64; 6]> = Vec::new();
    for (t, phase, press, location, at, force, whim) in frames {
        let mut read = [0.0; 6];
        for (k, r) in read.iter_mut().enumerate() {
            let stress = elastic(k, &at, force) * if whim == 0.0 { 1.0 } else { whim };
            let mut lost = 0.0;
            for ((share, tau), state) in world.fade.iter().zip(&mut fading) {
                state[k] += (stress - state[k]) * (dt / tau).min(1.0);
                lost += share * state[k];
            }
            *r = stress - lost;
        }
        let felt = read;
        for k in 0..6 {
            let before = if k > 0 { felt[k - 1] } else { 0.0 };
            read[k] = felt[k] * (1.0 - world.wear * press as f64 / presses as f64) + world.leak * before;
            read[k] += world.cold[k] * 0.5f64.powf(t / 30.0);
            let turn = (world.hum.1 * t).fract();
            read[k] += world.hum.0 * (4.0 * (turn - 0.5).abs() - 1.0);
        }
        late.push(read);
        let behind = world.late / dt;
        let index = late.len() - 1;
        let (a, part) = (behind.floor() as usize, behind.fract());
        let back = |n: usize| late[index.saturating_sub(n)];
        let values: Vec<f32> = (0..6)
            .map(|k| {
                let value = back(a)[k] * (1.0 - part) + back(a + 1)[k] * part;
                let noise: f64 = rng.sample(StandardNormal);
                (value + world.zero[k] + world.drift * t + world.noise * noise) as f32
            })
            .collect();
        let contacts = if force > 0.0 {
            vec![Indentation::sphere(at, Vector3::new(0.0, 0.0, -force), 0.004)]
        } else {
            Vec::new()
        };
        let stimulus = Some(Stimulus { contacts, ..Stimulus::default() });
        recording.push(
            Moment { time: t, run: 0, press, location, phase, stimulus, temperature: f64::NAN },
            &values,
        );
    }
    recording
}

fn options() -> Options {
    Options { resamples: 6, ..Options::default() }
}

fn diagnosed(recording: &Recording) -> Report {
    let skin = SkinDescription::from_toml(SKIN, "toy.toml").unwrap();
    let make = |skin: &SkinDescription| Toy::make(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    diagnose(&simulator, recording, &options(), &Memory::default()).unwrap().report
}

fn said(world: &World) -> Report {
    let report = diagnosed(&recorded(world, 160, 1, 11));
    println!(
        "{:?} {:?} {:?} gap {:?} unknown {:?} closure {:?}",
        report.verdict,
        report.class(),
        report.effects.iter().map(|e| (e.label.as_str(), e.tier, e.gain)).collect::<Vec<_>>(),
        report.gap.as_ref().map(|g| (g.fvu_before, g.floor, g.systematic, g.interval)),
        (report.unknown.library, report.unknown.form, report.unknown.explainable),
        report.closure
    );
    report
}

#[test]
fn another_law_alone_names_no_effect_firmly() {
    for law in [0.0, 1.0, 2.0] {
        let report = said(&World { law, ..world() });
        // A gap that matters may get a name, but never one without "or the simulator's own error".
        assert!(report.effects.iter().all(|e| e.tier == Tier::Loose), "law {law}: {}", report.sentence);
    }
}

#[test]
fn gains_are_named_and_closed() {
    let report = said(&World { gains: [0.1, -0.08, 0.05, -0.12, 0.15, 0.0], ..world() });
    assert_eq!(report.class().first(), Some(&"gains"), "{}", report.sentence);
    assert_eq!(report.effects[0].tier, Tier::Strict);
    let closure = report.closure.unwrap();
    assert!(closure.achieved.unwrap() > 0.8);
    assert!((closure.predicted - closure.achieved.unwrap()).abs() < 0.08);
    // Written in words that a skin description knows.
    assert_eq!(report.corrected[0].name, "channel-gain");
    // The world's other law is in all of them.
    let of = |name: &str| report.corrected[0].parameters[name];
    assert!((of("a") / of("d") - 1.1 / 0.88).abs() < 0.03, "{:?}", report.corrected);
}

#[test]
fn creep_of_another_law_is_named() {
    let report = said(&World { law: 0.3, fade: vec![(0.05, 0.15), (0.05, 0.4), (0.05, 1.0)], ..world() });
    assert_eq!(report.class(), ["creep"], "{}", report.sentence);
    let closure = report.closure.unwrap();
    assert!(closure.achieved.unwrap() > 0.7, "{closure:?}");
    assert!((closure.predicted - closure.achieved.unwrap()).abs() < 0.08);
}

#[test]
fn taxels_that_lie_elsewhere_are_named() {
    let moved = [4e-4, -5e-4, 3e-4, -6e-4, 5e-4, 2e-4];
    let report = said(&World { moved, ..world() });
    assert_eq!(report.class().first(), Some(&"misplacement"), "{}", report.sentence);
    let found = report.corrected[0].parameters["d.x"];
    assert!((found + 6e-4).abs() < 1.5e-4, "{found}");
}

#[test]
fn a_rig_that_is_off_is_told_from_taxels_that_are() {
    let report = said(&World { shift: 6e-4, ..world() });
    assert_eq!(report.class().first(), Some(&"truth-shift"), "{}", report.sentence);
    // The world's other law is in it: its places are felt a little farther than ours.
    let x = report.corrected[0].parameters["x"];
    assert!((x - 6e-4).abs() < 9e-5, "{x}");
}

#[test]
fn readings_that_come_late_are_named() {
    let report = said(&World { late: 0.03, ..world() });
    assert!(report.class().contains(&"delay"), "{}", report.sentence);
}

#[test]
fn neighbours_that_leak_are_named() {
    let report = said(&World { leak: 0.12, ..world() });
    assert_eq!(report.class().first(), Some(&"crosstalk"), "{}", report.sentence);
    let found = &report.corrected[0].parameters;
    assert!((found["before"] - 0.12).abs() < 0.03 && found["after"].abs() < 0.03, "{found:?}");
}

#[test]
fn a_skin_that_wears_is_named() {
    let report = said(&World { wear: 0.25, ..world() });
    assert_eq!(report.class().first(), Some(&"ageing"), "{}", report.sentence);
    // These presses follow each other like a clock's ticks: how much is use and how much is time they do not tell.
    assert!(report.closure.unwrap().achieved.unwrap() > 0.0, "{:?}", report.closure);
}

#[test]
fn zeros_that_go_home_from_switching_on_are_named() {
    let report =
        said(&World { cold: [3000.0, 2000.0, -1000.0, 2500.0, 1500.0, 4000.0], law: 0.0, ..world() });
    assert_eq!(report.class().first(), Some(&"warm-up"), "{}", report.sentence);
    let found = &report.corrected[0].parameters;
    let time = 30.0 / std::f64::consts::LN_2;
    assert!(
        (found["time"] / time - 1.0).abs() < 0.15 && (found["a"] / 3000.0 - 1.0).abs() < 0.15,
        "{found:?}"
    );
}

#[test]
fn a_hum_is_named_with_its_frequency() {
    let report = said(&World { hum: (800.0, 7.0), law: 0.0, ..world() });
    assert_eq!(report.verdict, Verdict::Named, "{}", report.sentence);
    assert_eq!(report.class(), ["interference"], "{}", report.sentence);
    let found = &report.corrected[0].parameters;
    // The strongest line of a triangle is 8/π² of it.
    assert!((found["frequency"] - 7.0).abs() < 0.1 && (found["amplitude"] - 648.0).abs() < 50.0, "{found:?}");
}

#[test]
fn two_effects_are_both_found() {
    let report = said(&World {
        gains: [0.15, -0.1, 0.1, -0.15, 0.1, -0.1],
        fade: vec![(0.1, 0.3), (0.06, 1.0)],
        ..world()
    });
    let found: Vec<&str> = report.effects.iter().map(|e| e.label.as_str()).collect();
    assert!(found.contains(&"gains") && found.contains(&"creep"), "{found:?} {}", report.sentence);
}

#[test]
fn a_void_is_none_of_the_known_effects_and_its_place_is_found() {
    let report = said(&World { void: 0.5, ..world() });
    assert_eq!(report.verdict, Verdict::UnknownSystematic, "{} {:?}", report.sentence, report.unknown);
    assert!(report.effects.is_empty() && report.closure.is_none());
    let peak = report.maps[0].peak.unwrap();
    assert!((peak[0] - 0.006).hypot(peak[1]) < 0.006, "{peak:?}");
}

#[test]
fn what_differs_from_press_to_press_is_irreproducible() {
    let recording = recorded(&World { whim: 0.1, ..world() }, 90, 2, 3);
    let report = diagnosed(&recording);
    let gap = report.gap.unwrap();
    println!("{gap:?} {}", report.sentence);
    assert!(gap.irreproducible.unwrap() > 0.5 * (gap.fvu_before - gap.systematic.max(0.0)));
    assert!(gap.systematic < 0.4 * gap.fvu_before);
    assert_eq!(report.verdict, Verdict::Unmeasured);
    assert!(report.effects.is_empty(), "{}", report.sentence);
}

fn problem<'a>(report: &'a Report, code: &str) -> &'a str {
    let found = report.data.problems.iter().find(|p| p.code == code);
    &found.unwrap_or_else(|| panic!("no {code} in {:?}", report.data.problems)).what
}

fn some() -> Recording {
    recorded(&World { gains: [0.1, -0.08, 0.05, -0.12, 0.15, 0.0], ..world() }, 60, 1, 5)
}

#[test]
fn a_clock_that_runs_backwards_is_named() {
    let mut recording = some();
    recording.moments[500].time -= 3.0;
    let report = diagnosed(&recording);
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "clock").contains("frame 500 by 2.980 s"), "{}", report.sentence);
    assert!(report.effects.is_empty());
}

#[test]
fn readings_in_another_unit_are_named() {
    let mut recording = some();
    recording.readings.iter_mut().for_each(|v| *v *= 1e-3);
    let report = diagnosed(&recording);
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "units").contains("1e-3"), "{}", report.sentence);
}

#[test]
fn channels_in_another_order_are_put_right_and_named() {
    let mut recording = some();
    for frame in recording.readings.chunks_exact_mut(6) {
        frame.swap(0, 4);
    }
    let report = diagnosed(&recording);
    let found: Vec<&str> = report.effects.iter().map(|e| e.label.as_str()).collect();
    assert_eq!(found, ["channel-order", "gains"], "{}", report.sentence);
    assert!(problem(&report, "channel-order").contains("a carries e, e carries a"));
    let order = &report.corrected[0];
    assert_eq!((order.parameters["a"], order.parameters["e"]), (4.0, 0.0));
}

#[test]
fn ground_truth_in_a_mirrored_frame_is_named() {
    let mut recording = some();
    for moment in &mut recording.moments {
        for contact in moment.stimulus.iter_mut().flat_map(|s| &mut s.contacts) {
            contact.position.x = -contact.position.x;
        }
    }
    let report = diagnosed(&recording);
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "frame").contains("x is mirrored"), "{}", report.sentence);
}

#[test]
fn stretches_without_numbers_are_left_out_and_named() {
    let mut recording = some();
    for frame in 400..600 {
        recording.readings[frame * 6 + 2] = f32::NAN;
    }
    let report = diagnosed(&recording);
    assert!(problem(&report, "not-finite").contains("channel c gives no number in 200 frames"));
    assert_eq!(report.class().first(), Some(&"gains"), "{}", report.sentence);
    // A channel that never gives any is another thing.
    for frame in recording.readings.chunks_exact_mut(6) {
        frame[2] = f32::NAN;
    }
    let report = diagnosed(&recording);
    assert!(problem(&report, "dead-channel").contains("channel c never gives a number"));
    assert_eq!(report.class().first(), Some(&"gains"), "{}", report.sentence);
}

#[test]
fn ten_contacts_are_too_few() {
    let report = diagnosed(&recorded(&World { gains: [0.3; 6], ..world() }, 10, 1, 5));
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "few-contacts").contains("10 presses only"));
}

#[test]
fn readings_of_something_else_are_named() {
    let mut recording = some();
    let half = recording.readings.len() / 12 * 6;
    recording.readings.rotate_left(half);
    let report = diagnosed(&recording);
    assert_eq!(report.verdict, Verdict::UnusableRecording);
    assert!(problem(&report, "unrelated").contains("next to nothing in common"), "{}", report.sentence);
}

#[test]
fn what_is_missing_says_what_it_blocks() {
    let report = diagnosed(&some());
    let missing: Vec<&str> = report.data.missing.iter().map(|m| m.what.as_str()).collect();
    insta::assert_debug_snapshot!(missing, @r#"
    [
        "repeats: presses of the same place and force, at least ten pairs",
        "a second session",
        "the temperature",
        "presses that are held for a second or more",
        "several contacts at once",
        "a second tip",
    ]
    "#);
}

#[test]
fn signatures_are_kept_on_the_disk() {
    let skin = SkinDescription::from_toml(SKIN, "toy.toml").unwrap();
    let make = |skin: &SkinDescription| Toy::make(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    let dir = tempfile::tempdir().unwrap();
    let options = Options { cache: Some(dir.path().join("kept")), ..options() };
    let recording = some();
    let mut first = diagnose(&simulator, &recording, &options, &Memory::default()).unwrap().report;
    let mut again = diagnose(&simulator, &recording, &options, &Memory::default()).unwrap().report;
    assert!(first.provenance.seconds[0] > 0.0);
    assert_eq!(again.provenance.seconds[0], 0.0);
    first.provenance.seconds = [0.0; 2];
    again.provenance.seconds = [0.0; 2];
    assert_eq!(first.to_json().unwrap(), again.to_json().unwrap());
}

#[test]
fn the_corrected_skin_reads_what_the_diagnosis_says() {
    let skin = SkinDescription::from_toml(SKIN, "toy.toml").unwrap();
    let make = |skin: &SkinDescription| Toy::make(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    let found = diagnose(&simulator, &some(), &options(), &Memory::default()).unwrap();
    let text = dermis_gap::skin_text(&found.corrected).unwrap();
    let read = SkinDescription::from_toml(&text, "corrected.toml").unwrap();
    assert_eq!(read.effects, found.report.corrected);
    let model = dermis_gap::device(&read, |inner: &SkinDescription| {
        Toy::make(inner).map_err(|reason| ModelError::Description {
            skin: "toy".into(),
            field: String::new(),
            reason,
        })
    });
    let (model, nominal) = (model.unwrap(), Toy::make(&skin).unwrap());
    let press = Indentation::sphere(Point3::new(-0.009, -0.005, 0.0), Vector3::new(0.0, 0.0, -1.0), 0.004);
    let stimulus = Stimulus { contacts: vec![press], ..Stimulus::default() };
    let (mut corrected, mut plain) = ([0.0; 6], [0.0; 6]);
    model.response(&stimulus, &mut corrected).unwrap();
    nominal.response(&stimulus, &mut plain).unwrap();
    approx::assert_relative_eq!(
        corrected[0] / plain[0],
        read.effects[0].parameters["a"],
        max_relative = 1e-9
    );
}

/// Whether a value is as a schema says: types, required and known keys.
fn fits(value: &serde_json::Value, schema: &serde_json::Value, root: &serde_json::Value, at: &str) {
    use serde_json::Value;
    if let Some(name) = schema["$ref"].as_str() {
        return fits(value, root.pointer(&name[1..]).unwrap(), root, at);
    }
    if let Some(choices) = schema["oneOf"].as_array() {
        let choice = choices.iter().find(|c| (c["type"] == "null") == value.is_null()).unwrap();
        return fits(value, choice, root, at);
    }
    if let Some(allowed) = schema["enum"].as_array() {
        assert!(allowed.contains(value), "{at}: {value}");
    }
    if let Some(constant) = schema.get("const") {
        assert_eq!(value, constant, "{at}");
    }
    let kind = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(n) if n.is_u64() => "integer",
        Value::Number(_) => "number",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    };
    let is = |t: &Value| t == kind || (t == "number" && kind == "integer");
    match &schema["type"] {
        Value::Null => {}
        Value::Array(types) => assert!(types.iter().any(is), "{at}: {kind} is none of {types:?}"),
        one => assert!(is(one), "{at}: {kind} where {one} is said"),
    }
    if let (Some(items), Some(values)) = (schema.get("items"), value.as_array()) {
        values.iter().enumerate().for_each(|(i, v)| fits(v, items, root, &format!("{at}[{i}]")));
    }
    if let Some(fields) = value.as_object() {
        for key in schema["required"].as_array().into_iter().flatten() {
            assert!(fields.contains_key(key.as_str().unwrap()), "{at} lacks {key}");
        }
        for (key, field) in fields {
            match schema["properties"].get(key) {
                Some(schema) => fits(field, schema, root, &format!("{at}.{key}")),
                None => assert!(schema["additionalProperties"] != false, "{at}.{key} is not in the schema"),
            }
        }
    }
}

#[test]
fn reports_are_as_the_published_schema_says() {
    let schema: serde_json::Value = serde_json::from_str(dermis_gap::SCHEMA_JSON).unwrap();
    let unusable = diagnosed(&recorded(&world(), 5, 1, 5));
    let none = diagnosed(&recorded(&World { law: 0.0, ..world() }, 60, 1, 5));
    assert_eq!(none.verdict, Verdict::NoGapBeyondNoise);
    for report in [diagnosed(&some()), unusable, none] {
        let value: serde_json::Value = serde_json::from_str(&report.to_json().unwrap()).unwrap();
        fits(&value, &schema, &schema, "report");
    }
}
