//! Recordings of devices that are made by other laws than the model.

use dermis_gap::protocol::Block;
use dermis_gap::{FrameLabel, Phase, Recording};
use dermis_model::{Indentation, Stimulus};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::model::skin;

/// Time, phase, location, press, place, force and the rest of one frame of a device.
type Instant = (f64, Phase, u64, u32, Point3<f64>, f64, f64);

/// What the devices are made by: nothing of the above.
#[derive(Default, Clone)]
pub(crate) struct Device {
    pub gains: [f64; 6],
    /// \[m\] by which taxels are moved along x.
    pub moved: [f64; 6],
    /// Power that the force enters with, minus 1.
    pub power: f64,
    /// Shares and times of three exponentials.
    pub fade: Vec<(f64, f64)>,
    /// \[Pa/s\] of all channels.
    pub drift: f64,
    /// \[Pa\] of one channel, everywhere.
    pub zero: [f64; 6],
    /// \[s\] late.
    pub late: f64,
    /// \[m\] by which the rig is off.
    pub shift: f64,
    /// Reads this much less in a circle of 5 mm about (6, 0) mm.
    pub void: f64,
    /// Of the law of spread: 0 is the tool's.
    pub law: f64,
    /// \[Pa\] of every reading.
    pub noise: f64,
    /// A cause that nothing recorded goes with: of each press.
    pub whim: f64,
    /// Of what the taxel before it reads.
    pub leak: f64,
    /// Share of the sensitivity that all presses together take, each as much.
    pub wear: f64,
    /// \[Pa\] of each taxel at the beginning, gone by half every 30 s.
    pub cold: [f64; 6],
    /// \[Pa\] and \[Hz\] of a triangle wave on all.
    pub interference: (f64, f64),
}

pub(crate) fn device() -> Device {
    Device { noise: 5.0, law: 1.0, ..Device::default() }
}

/// Presses at random locations: load, hold, unload, rest; what the device reads.
pub(crate) fn recorded(device: &Device, presses: usize, repeats: usize, seed: u64) -> Recording {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
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
            let whim = 1.0 + device.whim * rng.sample::<f64, _>(StandardNormal);
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
    read(device, frames, (presses, 0), &mut rng)
}

/// Blocks of presses to come, as a rig does them in run `run`: what the device reads.
pub(crate) fn pressed(device: &Device, blocks: &[Block], run: u32, seed: u64) -> Recording {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let dt = 0.02;
    let (mut frames, mut t, mut number): (Vec<Instant>, f64, u64) = (Vec::new(), 0.0, 0);
    let mut locations: Vec<Point3<f64>> = Vec::new();
    let idle = |t: &mut f64, frames: &mut Vec<Instant>| {
        for _ in 0..60 {
            frames.push((*t, Phase::Idle, 0, 0, Point3::origin(), 0.0, 0.0));
            *t += dt;
        }
    };
    idle(&mut t, &mut frames);
    for block in blocks {
        let known = locations.iter().position(|p| *p == block.at);
        let place = known.unwrap_or_else(|| {
            locations.push(block.at);
            locations.len() - 1
        });
        for press in &block.presses {
            number += 1;
            let ends = [press.load, press.load + press.hold, press.load + press.hold + press.unload];
            let begin = t;
            while t - begin < press.duration() {
                let since = t - begin + dt;
                let (phase, share) = if since < ends[0] {
                    (Phase::Load, since / ends[0])
                } else if since < ends[1] {
                    (Phase::Hold, 1.0)
                } else if since < ends[2] {
                    (Phase::Unload, (ends[2] - since) / press.unload)
                } else {
                    (Phase::Approach, 0.0)
                };
                frames.push((t, phase, number, place as u32 + 1, block.at, share * press.force, 1.0));
                t += dt;
            }
        }
    }
    idle(&mut t, &mut frames);
    read(device, frames, (number as usize, run), &mut rng)
}

/// One recording after another, each in a run of its own.
pub(crate) fn together(recordings: &[&Recording]) -> Recording {
    let mut whole = Recording::new("together", 6);
    for (run, of) in recordings.iter().enumerate() {
        whole.sessions.push(format!("session {}", run + 1));
        for (index, label) in of.labels.iter().enumerate() {
            whole.push(FrameLabel { run: run as u32, ..label.clone() }, of.frame(index));
        }
    }
    whole
}

/// What a device reads along these instants, with so many presses in all, in this run.
fn read(
    device: &Device,
    frames: Vec<Instant>,
    (presses, run): (usize, u32),
    rng: &mut ChaCha8Rng,
) -> Recording {
    let skin = skin();
    let dt = 0.02;
    let mut recording = Recording::new("toy device", 6);
    recording.sessions.push("one".to_owned());
    let gain = |k: usize| 1.0 + device.gains[k];
    let elastic = |k: usize, at: &Point3<f64>, force: f64| -> f64 {
        if force <= 0.0 {
            return 0.0;
        }
        let p = skin.taxels[k].position;
        let away = (at.x + device.shift - p[0] - device.moved[k]).hypot(at.y - p[1]);
        let q = (away / 0.005).powi(2);
        // Another law of spread of about the same width, mixed in.
        let spread = (1.0 + q).powf(-2.5) * (1.0 + device.law * 0.04 * (1.0 - q).exp());
        let near = (at.x - 0.006).hypot(at.y) < 0.005;
        let void = if near { 1.0 - device.void } else { 1.0 };
        gain(k) * void * 0.5 * force.powf(1.0 + device.power) / 0.005f64.powi(2) * spread
    };
    let mut fading = vec![[0.0; 6]; device.fade.len()];
    let mut late: Vec<[f64; 6]> = Vec::new();
    for (t, phase, press, location, at, force, whim) in frames {
        let mut read = [0.0; 6];
        for (k, r) in read.iter_mut().enumerate() {
            let stress = elastic(k, &at, force) * if whim == 0.0 { 1.0 } else { whim };
            let mut lost = 0.0;
            for ((share, tau), state) in device.fade.iter().zip(&mut fading) {
                state[k] += (stress - state[k]) * (dt / tau).min(1.0);
                lost += share * state[k];
            }
            *r = stress - lost;
        }
        let felt = read;
        for k in 0..6 {
            let before = if k > 0 { felt[k - 1] } else { 0.0 };
            read[k] = felt[k] * (1.0 - device.wear * press as f64 / presses as f64) + device.leak * before;
            read[k] += device.cold[k] * 0.5f64.powf(t / 30.0);
            let turn = (device.interference.1 * t).fract();
            read[k] += device.interference.0 * (4.0 * (turn - 0.5).abs() - 1.0);
        }
        late.push(read);
        let behind = device.late / dt;
        let index = late.len() - 1;
        let (a, part) = (behind.floor() as usize, behind.fract());
        let back = |n: usize| late[index.saturating_sub(n)];
        let values: Vec<f32> = (0..6)
            .map(|k| {
                let value = back(a)[k] * (1.0 - part) + back(a + 1)[k] * part;
                let noise: f64 = rng.sample(StandardNormal);
                (value + device.zero[k] + device.drift * t + device.noise * noise) as f32
            })
            .collect();
        let contacts = if force > 0.0 {
            vec![Indentation::sphere(at, Vector3::new(0.0, 0.0, -force), 0.004)]
        } else {
            Vec::new()
        };
        let stimulus = Some(Stimulus { contacts, ..Stimulus::default() });
        recording.push(
            FrameLabel { time: t, run, press, location, phase, stimulus, temperature: f64::NAN },
            &values,
        );
    }
    recording
}
