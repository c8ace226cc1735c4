//! Which experiment would tell apart what this recording cannot.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

use dermis_model::{Indentation, Stimulus};
use dermis_skin::{Effect, Phase, Surface};
use indicatif::ProgressBar;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::algebra::normal;
use crate::constants::experiments::{LISTED, TRUST};
use crate::constants::protocol::UNTELLABLE;
use crate::protocol::design::settles;
use crate::recording::{FrameLabel, Recording};
use crate::samples::{Sample, Samples};

use crate::simulate::Simulator;

/// An experiment, and what it would settle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Experiment {
    /// Stable name.
    pub id: String,
    /// What to do.
    pub what: String,
    /// Minutes on the rig.
    pub minutes: f64,
    /// The two effects that it tells apart least well.
    pub separates: Vec<String>,
    /// Probability of confusing these two after it.
    pub p_confuse_after: f64,
}

/// One press of an experiment: positions, force \[N\], tip \[m\], and seconds to load, hold, unload and rest.
struct Press {
    at: Vec<Point3<f64>>,
    force: f64,
    tip: f64,
    load: f64,
    hold: f64,
    unload: f64,
    rest: f64,
    temperature: f64,
}

struct Menu {
    id: &'static str,
    what: &'static str,
    minutes: f64,
    presses: Vec<Press>,
    /// \[s\] untouched from when the device is switched on, before the first press.
    warm: f64,
}

/// How far an experiment puts two members apart.
struct Separability {
    pair: (usize, usize),
    /// In deviations squared.
    apart: f64,
}

/// Ranks experiments by how well they tell the members of a class apart in a minute. Each member is the effects that make it.
#[must_use]
pub fn rank(
    simulator: &Simulator<'_>,
    members: &[(String, Vec<Effect>)],
    samples: &Samples,
    stop: &AtomicBool,
) -> Vec<Experiment> {
    let held: Vec<&Sample> =
        samples.list.iter().filter(|r| r.phase == Phase::Hold && r.contacts == 1).collect();
    if held.is_empty() || members.len() < 2 {
        return Vec::new();
    }
    let mut forces: Vec<f64> = held.iter().map(|r| r.force).collect();
    forces.sort_by(f64::total_cmp);
    let force = forces[forces.len() * 3 / 4];
    let middle = held[held.len() / 2];
    // Presses to come are simulated as they will be read; trust in a model goes with what touches make of it.
    let zero = simulator.zero_level(&Recording::default()).unwrap_or_default();
    let mut separabilities: Vec<(Menu, Vec<Separability>)> = Vec::new();
    for menu in menu(simulator, middle, force) {
        let (recording, samples) = carried_out(simulator, &menu);
        let skins: Vec<_> = members.iter().map(|(_, effects)| simulator.with(effects)).collect();
        let hidden = ProgressBar::hidden();
        let Ok(read) = simulator.many(&skins, &recording, (&samples, true), stop, &hidden) else { continue };
        let noise = simulator.skin.channel_noise();
        let mut pairs = Vec::new();
        for a in 0..members.len() {
            for b in 0..a {
                let (Ok(x), Ok(y)) = (&read[a], &read[b]) else { continue };
                let apart: f64 = x
                    .iter()
                    .zip(y)
                    .enumerate()
                    .map(|(i, (x, y))| {
                        let (x, y) = (f64::from(*x), f64::from(*y));
                        let channel = i % noise.len();
                        let signal = zero.signal(channel, x);
                        (x - y).powi(2) / (noise[channel].powi(2) + (TRUST * signal).powi(2))
                    })
                    .sum();
                // What is wrong with a model is wrong in all frames of a press alike.
                let frames = x.len() as f64 / noise.len() as f64 / menu.presses.len().max(1) as f64;
                pairs.push(Separability { pair: (a, b), apart: apart / frames.max(1.0) });
            }
        }
        separabilities.push((menu, pairs));
    }
    // Two that nothing on the menu tells apart are two names of one thing: no experiment is for them.
    let confusion = |apart: f64| normal(-apart.sqrt() / 2.0);
    let tellable: BTreeSet<(usize, usize)> = separabilities
        .iter()
        .flat_map(|(_, pairs)| pairs)
        .filter(|t| confusion(t.apart) < UNTELLABLE)
        .map(|t| t.pair)
        .collect();
    let mut found = Vec::new();
    for (menu, pairs) in &separabilities {
        let of = pairs.iter().filter(|t| tellable.contains(&t.pair));
        if let Some(Separability { pair: (a, b), apart }) = of.min_by(|s, t| s.apart.total_cmp(&t.apart)) {
            found.push((
                apart / menu.minutes,
                Experiment {
                    id: menu.id.to_owned(),
                    what: menu.what.to_owned(),
                    minutes: menu.minutes,
                    separates: vec![members[*a].0.clone(), members[*b].0.clone()],
                    p_confuse_after: confusion(*apart),
                },
            ));
        }
    }
    // Those that settle it first, the shortest of them first; then by what a minute gives.
    let settles = |e: &(f64, Experiment)| settles(e.1.p_confuse_after);
    found.sort_by(|a, b| {
        settles(b)
            .cmp(&settles(a))
            .then_with(|| if settles(a) { a.1.minutes.total_cmp(&b.1.minutes) } else { b.0.total_cmp(&a.0) })
    });
    found.into_iter().map(|(_, e)| e).take(LISTED).collect()
}

fn menu(simulator: &Simulator<'_>, row: &Sample, force: f64) -> Vec<Menu> {
    let at = Point3::from(row.position);
    let surface = simulator.skin.surface();
    let near = |dx: f64, dy: f64| surface.project(&Point3::new(at.x + dx, at.y + dy, at.z)).0;
    let press = |force: f64| Press {
        at: vec![at],
        force,
        tip: row.diameter,
        load: 0.1,
        hold: 0.3,
        unload: 0.1,
        rest: 0.3,
        temperature: f64::NAN,
    };
    let several = |count: usize| (0..count).map(|_| press(force)).collect::<Vec<_>>();
    let item = |id, what, minutes, presses| Menu { id, what, minutes, presses, warm: 0.0 };
    vec![
        item(
            "long-hold",
            "hold one press for 20 s",
            1.0,
            vec![Press { hold: 20.0, rest: 5.0, ..press(force) }],
        ),
        item(
            "speed-sweep",
            "the same press, loaded and released within 0.02, 0.1, 0.5 and 2 s",
            2.0,
            [0.02, 0.1, 0.5, 2.0].map(|t| Press { load: t, unload: t, ..press(force) }).into(),
        ),
        item("repeat", "the same press at the same place, five times", 1.0, several(5)),
        item(
            "return-to-zero",
            "one press, then 20 s untouched",
            1.0,
            vec![Press { hold: 2.0, rest: 20.0, ..press(force) }],
        ),
        item(
            "force-ladder",
            "one place, five forces from light to strong and back",
            2.0,
            [0.1, 0.3, 0.6, 1.0, 0.6, 0.3, 0.1].map(|f| press(f * force)).into(),
        ),
        item(
            "second-tip",
            "the same presses with a tip of twice the diameter",
            5.0,
            vec![press(force), Press { tip: 2.0 * row.diameter, ..press(force) }],
        ),
        item(
            "offset",
            "five locations one millimetre from one another, along both axes",
            2.0,
            [[0.0, 0.0], [1e-3, 0.0], [-1e-3, 0.0], [0.0, 1e-3], [0.0, -1e-3]]
                .map(|[x, y]| Press { at: vec![near(x, y)], ..press(force) })
                .into(),
        ),
        item(
            "two-contacts",
            "two tips at once, 8 mm apart",
            5.0,
            vec![press(force), Press { at: vec![near(-4e-3, 0.0), near(4e-3, 0.0)], ..press(force) }],
        ),
        item(
            "thermal-cycle",
            "warm the skin by 5 K and cool it down again, with a press at each step",
            30.0,
            [293.15, 295.65, 298.15, 295.65, 293.15].map(|t| Press { temperature: t, ..press(force) }).into(),
        ),
        Menu {
            id: "power-on",
            what: "switch the skin on, leave it untouched for two minutes, then press once",
            minutes: 3.0,
            presses: several(1),
            warm: 120.0,
        },
    ]
}

/// The experiment as a recording without readings, and all of its frames as samples.
fn carried_out(simulator: &Simulator<'_>, menu: &Menu) -> (Recording, Samples) {
    let surface = simulator.skin.surface();
    let mut recording = Recording::new(menu.id, simulator.skin.channels().len());
    let nothing = vec![f32::NAN; recording.channels];
    let mut time = 0.0;
    let step = (1.0 / simulator.skin.rate).max(0.01);
    let mut add = |time: f64, phase: Phase, stimulus: Stimulus, press: u64| {
        let label = FrameLabel {
            time,
            run: 0,
            press,
            location: 1,
            phase,
            temperature: 293.15,
            stimulus: Some(stimulus),
        };
        recording.push(label, &nothing);
    };
    while time < menu.warm {
        add(time, Phase::Idle, untouched(f64::NAN), 0);
        time += 0.5;
    }
    for (n, press) in menu.presses.iter().enumerate() {
        let total = press.load + press.hold + press.unload + press.rest;
        let begin = time;
        // Long rests and holds are sampled less often.
        while time - begin < total {
            let t = time - begin;
            let (share, phase) = press.course(t);
            add(time, phase, press.stimulus(share, &surface), n as u64 + 1);
            time += if t > 2.0 + press.load { 10.0 * step } else { step };
        }
    }
    let samples = all_frames(&recording);
    (recording, samples)
}

/// Nothing touches, at a temperature \[K\].
fn untouched(temperature: f64) -> Stimulus {
    Stimulus {
        temperature: if temperature.is_finite() { temperature } else { 293.15 },
        ..Stimulus::default()
    }
}

impl Press {
    /// Share of the force and phase `t` \[s\] after its beginning.
    fn course(&self, t: f64) -> (f64, Phase) {
        if t < self.load {
            (t / self.load, Phase::Load)
        } else if t < self.load + self.hold {
            (1.0, Phase::Hold)
        } else if t < self.load + self.hold + self.unload {
            (1.0 - (t - self.load - self.hold) / self.unload, Phase::Unload)
        } else {
            (0.0, Phase::Approach)
        }
    }

    /// What touches under a share of the force.
    fn stimulus(&self, share: f64, surface: &Surface) -> Stimulus {
        let mut stimulus = untouched(self.temperature);
        if share > 0.0 {
            for at in &self.at {
                let (position, normal) = surface.project(at);
                stimulus.contacts.push(Indentation::sphere(
                    position,
                    Vector3::from(normal * (-share * self.force)),
                    self.tip,
                ));
            }
        }
        stimulus
    }
}

/// All frames of a recording as samples of one group.
fn all_frames(recording: &Recording) -> Samples {
    let samples = recording.labels.iter().enumerate().map(|(frame, m)| Sample {
        frame,
        group: 0,
        press: 0,
        location: (0, 1),
        session: 0,
        phase: m.phase,
        force: m.force(),
        since: 0.0,
        time: m.time,
        before: 0.0,
        speed: 0.0,
        temperature: m.temperature,
        position: [f64::NAN; 3],
        diameter: f64::NAN,
        contacts: 0,
        paired: false,
        zero: None,
    });
    Samples {
        list: samples.collect(),
        groups: 1,
        test: vec![false],
        presses: 1,
        single_frame_samples: 0,
        missing: 0,
    }
}
