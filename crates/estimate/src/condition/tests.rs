use dermis_skin::Stamp;

use super::health::change_probability;
use super::*;
use crate::testing::{Noise, skin_with};

const RATE: f64 = 100.0;

/// 2×2 pad, noise 20 Pa, range 50 to 110 kPa, 100 Hz.
fn skin() -> SkinDescription {
    skin_with("")
}

struct Run {
    conditioner: Conditioner,
    noise: Noise,
    k: u64,
    out: Conditioned,
}

impl Run {
    fn new(skin: &SkinDescription, masked: &[String]) -> Self {
        Self {
            conditioner: Conditioner::new(skin, masked).unwrap(),
            noise: Noise::new(7),
            k: 0,
            out: Conditioned::default(),
        }
    }

    /// One frame: 101 325 Pa, noise, and `load` in Pa on top.
    fn push(&mut self, load: [f64; 4]) -> &Conditioned {
        let values = load.map(|l| (101_325.0 + l + 20.0 * self.noise.normal()) as f32);
        self.raw(values)
    }

    fn raw(&mut self, values: [f32; 4]) -> &Conditioned {
        let stamp = (self.k as f64 / RATE * 1e9) as Stamp;
        let frame = Frame::new(stamp, self.k, values.to_vec());
        self.k += 1;
        self.conditioner.clean(&frame, &mut self.out).unwrap();
        self.conditioner.follow(&self.out, false);
        &self.out
    }

    fn seconds(&mut self, seconds: f64, load: [f64; 4]) {
        for _ in 0..(seconds * RATE) as u64 {
            self.push(load);
        }
    }

    fn tared() -> Self {
        let mut run = Self::new(&skin(), &[]);
        run.seconds(1.0, [0.0; 4]);
        assert!(run.conditioner.is_tared(), "{:?}", run.conditioner.tare_state());
        run
    }
}

#[test]
fn before_the_first_tare_nothing_looks_like_a_signal() {
    let mut run = Run::new(&skin(), &[]);
    let out = run.push([0.0; 4]);
    assert!(out.level.is_nan() && !out.touched);
    assert!(out.signal.values.iter().all(|v| v.is_nan()));
    assert!(out.reading.values.iter().all(|v| v.is_finite()), "readings are published before the tare too");
}

#[test]
fn a_touch_is_detected_and_released() {
    let mut run = Run::tared();
    assert!(!run.push([0.0; 4]).touched);
    let out = run.push([600.0, 0.0, 0.0, 0.0]);
    assert!(out.touched && (out.level - 15.0).abs() < 2.0, "{}", out.level);
    assert!((out.signal.values[0] - 600.0).abs() < 100.0);
    assert!(!run.push([0.0; 4]).touched);
}

#[test]
fn the_threshold_has_hysteresis() {
    let mut run = Run::tared();
    // 3 noise deviations on all channels: between release (2.4) and threshold (4).
    assert!(!run.raw([101_385.0; 4]).touched);
    assert!(run.raw([101_525.0; 4]).touched);
    assert!(run.raw([101_385.0; 4]).touched);
    assert!(!run.raw([101_345.0; 4]).touched);
}

#[test]
fn ten_minutes_of_standing_are_detected_to_the_end() {
    let mut run = Run::tared();
    let before = run.conditioner.zero().unwrap().to_vec();
    run.seconds(600.0, [300.0, 100.0, 50.0, 0.0]);
    let out = run.push([300.0, 100.0, 50.0, 0.0]).clone();
    assert!(out.touched && out.level > 5.0, "level {} after ten minutes", out.level);
    assert_eq!(run.conditioner.zero().unwrap(), before, "the zero moved under load");
    assert!(!run.push([0.0; 4]).touched);
}

#[test]
fn slow_drift_is_followed_while_untouched() {
    let mut run = Run::tared();
    // 0.2 Pa/s: 120 Pa in ten minutes would be 6 noise deviations.
    for k in 0..60_000 {
        let drift = f64::from(k) / RATE * 0.2;
        assert!(!run.push([drift; 4]).touched, "drift taken for a touch after {k} frames");
    }
    let lag = 101_325.0 + 120.0 - run.conditioner.zero().unwrap()[0];
    assert!((lag - 0.2 * 30.0).abs() < 5.0, "a first-order follower lags by rate × time constant, not {lag}");
}

#[test]
fn what_hysteresis_leaves_behind_is_the_new_zero_where_requested() {
    let left = [200.0, 200.0, 100.0, 100.0];
    for (share, released) in [(0.0, false), (0.5, true)] {
        let mut run = Run::new(&skin_with(&format!("condition = {{ release_share = {share:.1} }}")), &[]);
        run.seconds(1.0, [0.0; 4]);
        run.seconds(2.0, [4000.0, 2000.0, 1000.0, 1000.0]);
        assert!(run.out.touched, "a contact that stands still at its peak is one");
        run.seconds(0.3, left);
        assert!(run.out.touched, "0.3 s at rest are not enough");
        run.seconds(0.5, left);
        assert_eq!(!run.out.touched, released, "release_share {share}");
        if released {
            assert!(run.out.level < 2.0 && (run.conditioner.zero().unwrap()[0] - 101_525.0).abs() < 15.0);
            assert!(run.push([2000.0, 0.0, 0.0, 0.0]).touched, "the next press is detected");
        }
    }
    // What is left below the threshold counts too, as soon as it stands still.
    let mut run = Run::new(&skin_with("condition = { release_share = 0.5 }"), &[]);
    run.seconds(1.0, [0.0; 4]);
    run.seconds(1.0, [4000.0; 4]);
    run.seconds(0.8, [40.0; 4]);
    assert!((run.conditioner.zero().unwrap()[0] - 101_365.0).abs() < 15.0);
    // Sliding down is not standing still.
    let mut run = Run::new(&skin_with("condition = { release_share = 0.5 }"), &[]);
    run.seconds(1.0, [0.0; 4]);
    for k in (200..2000).rev() {
        run.push([4.0 * f64::from(k); 4]);
        assert!(run.out.touched);
    }
}

#[test]
fn tare_is_refused_while_touched_and_says_why() {
    let mut run = Run::tared();
    run.push([0.0, 2000.0, 0.0, 0.0]);
    let zero = run.conditioner.zero().unwrap().to_vec();
    let refusal = run.conditioner.begin_tare(false).unwrap_err();
    assert!(refusal.to_string().contains("most in channel t1"), "{refusal}");
    assert_eq!(run.conditioner.zero().unwrap(), zero);
    // The zero has drifted and the caller knows that nothing touches.
    run.conditioner.begin_tare(true).unwrap();
    run.seconds(1.0, [0.0, 2000.0, 0.0, 0.0]);
    assert!(!run.push([0.0, 2000.0, 0.0, 0.0]).touched);
}

#[test]
fn tare_moves_the_zero() {
    let mut run = Run::tared();
    run.conditioner.begin_tare(false).unwrap();
    run.seconds(1.0, [40.0; 4]);
    assert_eq!(run.conditioner.tare_state(), TareState::Done);
    assert!((run.conditioner.zero().unwrap()[2] - 101_365.0).abs() < 10.0);
}

#[test]
fn nan_is_flagged_and_never_zero() {
    let mut run = Run::tared();
    let out = run.raw([101_325.0, f32::NAN, f32::INFINITY, 101_325.0]);
    assert_eq!(out.reading.flags[1], ChannelFlags::NOT_FINITE);
    assert_eq!(out.reading.flags[2], ChannelFlags::NOT_FINITE);
    assert!(out.reading.values[1].is_nan() && out.reading.values[2].is_nan());
    assert!(out.signal.values[1].is_nan());
    assert!(!out.touched && out.level < 2.0, "an invalid channel must not count: level {}", out.level);
    assert!(run.push([0.0; 4]).reading.flags[1].is_ok(), "a channel that is back is healthy");
}

#[test]
fn the_end_of_the_range_is_saturation_and_keeps_its_value() {
    let mut run = Run::tared();
    let out = run.raw([110_000.0, 101_325.0, 101_330.0, 50_000.0]);
    assert_eq!(out.reading.flags[0], ChannelFlags::SATURATED);
    assert_eq!(out.reading.flags[3], ChannelFlags::SATURATED);
    assert!((f64::from(out.signal.values[0]) - 8675.0).abs() < 20.0);
    assert!(out.touched);
}

#[test]
fn a_hard_press_at_the_rail_is_not_stuck() {
    let mut run = Run::tared();
    for _ in 0..6000 {
        let noise = run.noise.normal() as f32;
        let out = run.raw([110_000.0, 101_325.0 + noise, 101_325.0 - noise, 101_320.0 + noise]);
        assert_eq!(out.reading.flags[0], ChannelFlags::SATURATED);
    }
}

#[test]
fn a_channel_that_fails_to_its_rail_is_no_contact_for_ever() {
    let mut run = Run::new(&skin_with("condition = { coupled = true }"), &[]);
    run.seconds(1.0, [0.0; 4]);
    let broken = |run: &mut Run, load: f64| {
        let mut noisy = || (101_325.0 + load + 20.0 * run.noise.normal()) as f32;
        let values = [110_000.0, noisy(), noisy(), noisy()];
        run.raw(values).clone()
    };
    for _ in 0..600 {
        let out = broken(&mut run, 0.0);
        assert!(!out.touched && out.signal.values[0].is_nan(), "no press is detected by one alone: {out:?}");
    }
    let out = broken(&mut run, 3000.0);
    assert!(out.reading.flags[0].contains(ChannelFlags::STUCK) && out.signal.values[0].is_nan());
    assert!(out.touched, "the others go on feeling");
    assert!(run.push([0.0; 4]).reading.flags[0].is_ok(), "it moves again");
    // A press that saturates one channel and is detected by another is a press for as long as it lasts.
    for _ in 0..2000 {
        let near = (101_725.0 + 20.0 * run.noise.normal()) as f32;
        let rest = [(); 2].map(|()| (101_325.0 + 20.0 * run.noise.normal()) as f32);
        let out = run.raw([110_000.0, near, rest[0], rest[1]]);
        assert!(out.touched && !out.reading.flags[0].is_invalid());
    }
}

/// Gauges whose zero drifts, leaned on for a minute.
#[test]
fn a_minute_of_contact_on_gauges_that_drift() {
    let gauges: Vec<String> = (0..10)
        .map(|i| format!("{{ name = \"g{i}\", position = [{:.3}, 0.0, 0.0] }}", f64::from(i) * 0.02))
        .collect();
    let skin = |condition: &str| {
        skin_with(&format!(
            "unit = \"1\"\nnoise = 3e-6\nrange = [-3e-3, 3e-3]\ncondition = {{ {condition} }}\ntaxels = [{}]",
            gauges.join(", ")
        ))
    };
    // [strain/s]: 1.5 and 6 noise deviations in a minute.
    for (drift, condition, ends) in [
        (7.5e-8, "drift_time = 10.0", true),
        (3e-7, "drift_time = 10.0", false),
        (3e-7, "drift_time = 10.0, release_share = 0.5", true),
    ] {
        let mut conditioner = Conditioner::new(&skin(condition), &[]).unwrap();
        let (mut noise, mut out, mut k) = (Noise::new(5), Conditioned::default(), 0_u64);
        let mut seconds = |conditioner: &mut Conditioner, seconds: f64, load: f64| {
            let mut every = true;
            let mut levels = Vec::new();
            for _ in 0..(seconds * RATE) as u64 {
                let t = k as f64 / RATE;
                let values = (0..10)
                    .map(|i| (drift * t + load / f64::from(1 + i) + 3e-6 * noise.normal()) as f32)
                    .collect();
                conditioner.clean(&Frame::new((t * 1e9) as Stamp, k, values), &mut out).unwrap();
                conditioner.follow(&out, false);
                k += 1;
                every &= out.touched;
                levels.push(out.level);
            }
            (every, levels)
        };
        seconds(&mut conditioner, 30.0, 0.0);
        let zero = conditioner.zero().unwrap().to_vec();
        assert!((zero[0] - drift * 30.0).abs() < drift * 15.0, "the zero follows drift while untouched");
        let (detected, levels) = seconds(&mut conditioner, 60.0, 2e-4);
        assert!(detected, "drift {drift}: a contact of a minute is detected to its end");
        assert!(levels.last() > levels.first().map(|l| l * 0.9).as_ref(), "and does not fade");
        assert_eq!(conditioner.zero().unwrap(), zero, "the zero rests while something touches");
        let (still, _) = seconds(&mut conditioner, 5.0, 0.0);
        let (held, _) = seconds(&mut conditioner, 1.0, 0.0);
        assert!(!still || !ends, "drift {drift}: released");
        assert_eq!(!held, ends, "drift {drift} with {condition}");
    }
}

#[test]
fn a_frozen_channel_is_stuck_and_one_that_never_moved_is_dead() {
    let mut run = Run::new(&skin(), &[]);
    let frame = |run: &mut Run, frozen: Option<f32>| {
        let mut v = [0.0; 4].map(|_: f64| (101_325.0 + 20.0 * run.noise.normal()) as f32);
        v[1] = 0.0;
        v[3] = 101_000.0;
        if let Some(value) = frozen {
            v[0] = value;
        }
        run.raw(v).reading.flags.clone()
    };
    for _ in 0..490 {
        let flags = frame(&mut run, None);
        assert!(flags[3].is_ok(), "5 s have not passed");
    }
    let mut flags = Vec::new();
    for _ in 0..600 {
        flags = frame(&mut run, Some(101_300.0));
    }
    assert_eq!(flags[0], ChannelFlags::STUCK);
    assert!(flags[1].contains(ChannelFlags::DEAD) && flags[1].contains(ChannelFlags::SATURATED));
    assert_eq!(flags[2], ChannelFlags::OK);
    assert_eq!(flags[3], ChannelFlags::DEAD);
    assert!(run.out.reading.values[0].is_nan() && run.out.reading.values[3].is_nan());
    assert!(frame(&mut run, None)[0].is_ok(), "it moves again");
}

#[test]
fn coarse_quantisation_is_not_stuck() {
    // One count is 200 Pa, ten times the noise: an idle channel stands still for hours.
    let skin = skin_with("wire = { scale = 200.0 }");
    let mut run = Run::new(&skin, &[]);
    for _ in 0..20_000 {
        let out = run.raw([101_400.0, 101_200.0, 101_400.0, 101_600.0]);
        assert!(out.reading.flags.iter().all(|f| f.is_ok()), "{:?}", out.reading.flags);
    }
    // The same without a declared scale, as soon as one channel shows its step.
    let mut run = Run::new(&skin_with("noise = 0.05"), &[]);
    for k in 0..20_000_u32 {
        let moving = if k.is_multiple_of(97) { 60_001.0 } else { 60_000.0 };
        let out = run.raw([60_010.0, 60_007.0, moving, 60_020.0]);
        assert!(out.reading.flags.iter().all(|f| f.is_ok()), "{:?} after {k}", out.reading.flags);
    }
}

#[test]
fn slow_devices_need_readings_as_well_as_time() {
    let mut run = Run::tared();
    let base = run.k;
    for k in 0..15 {
        // 1 Hz: 15 s without a change are 15 readings only.
        run.k = base + k * 100;
        let out = run.raw([101_300.0; 4]);
        assert!(out.reading.flags.iter().all(|f| f.is_ok()));
    }
}

#[test]
fn stuck_time_zero_switches_the_check_off() {
    let mut run = Run::new(&skin_with("condition = { stuck_time = 0.0 }"), &[]);
    for _ in 0..2000 {
        assert!(run.raw([101_300.5; 4]).reading.flags.iter().all(|f| f.is_ok()));
    }
}

#[test]
fn masked_channels_are_left_out() {
    let mut run = Run::new(&skin(), &["t2".into()]);
    run.seconds(1.0, [0.0; 4]);
    let out = run.push([0.0, 0.0, 1e4, 0.0]);
    assert_eq!(out.reading.flags[2], ChannelFlags::MASKED);
    assert!(out.signal.values[2].is_nan() && !out.touched);
    let error = Conditioner::new(&skin(), &["t9".into()]).unwrap_err().to_string();
    assert_eq!(error, "masked channel `t9` is none of skin `pad`; its channels are t0, t1, t2, t3");
}

#[test]
fn flags_of_a_recording_stay() {
    let mut run = Run::tared();
    let mut frame = Frame::new((run.k as f64 / RATE * 1e9) as Stamp, run.k, vec![101_325.0; 4]);
    frame.values[1] = f32::NAN;
    frame.flags[1] = ChannelFlags::STUCK;
    run.conditioner.clean(&frame, &mut run.out).unwrap();
    assert_eq!(run.out.reading.flags[1], ChannelFlags::STUCK);
}

/// Recorded presses on a magnetic pad (eFlesh), each after a reading of the untouched pad.
#[test]
fn every_recorded_press_is_detected_and_ends() {
    let data = std::env::var("DERMIS_DATA")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data").into());
    let runs = std::path::Path::new(&data).join("eflesh/spatial_resolution");
    let Ok(runs) = std::fs::read_dir(&runs) else {
        println!("skipped: {} is not there", runs.display());
        return;
    };
    let skin = SkinDescription::from_toml(
        include_str!("../../../../launch/skins/eflesh.toml"),
        "launch/skins/eflesh.toml",
    )
    .unwrap();
    let read = |path: std::path::PathBuf| -> Vec<Vec<f64>> {
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().map(|l| l.split(',').map(|n| n.trim().parse().unwrap()).collect()).collect()
    };
    for run in runs {
        let run = run.unwrap().path();
        let readings = read(run.join("sensor.csv"));
        let signals = read(run.join("sensor_post_baselines.csv"));
        let mut conditioner = Conditioner::new(&skin, &[]).unwrap();
        let mut out = Conditioned::default();
        let (mut k, mut detected, mut ended, mut worst) = (0, 0, 0, 0.0_f64);
        for (reading, signal) in readings.iter().zip(&signals) {
            let stamp = (reading[0] * 1e9) as Stamp;
            let tesla = |v: &[f64]| v.iter().map(|v| (v * 1e-6) as f32).collect::<Vec<f32>>();
            let untouched: Vec<f64> = reading[1..].iter().zip(&signal[1..]).map(|(r, s)| r - s).collect();
            for before in (0..=8).rev() {
                let values = tesla(if before > 0 { &untouched } else { &reading[1..] });
                let frame = Frame::new(stamp - before * 100_000_000, k, values);
                k += 1;
                conditioner.clean(&frame, &mut out).unwrap();
                conditioner.follow(&out, false);
                if before == 1 {
                    ended += usize::from(!out.touched);
                    worst = worst.max(out.level);
                }
            }
            detected += usize::from(out.touched);
        }
        let presses = readings.len();
        assert_eq!(presses, 4805, "{}", run.display());
        println!("{}: {detected} detected, {ended} ended, worst rest {worst:.2}", run.display());
        assert!(detected + 2 >= presses, "{detected} of {presses} presses detected in {}", run.display());
        assert!(ended + 5 >= presses, "{ended} of {presses} presses ended in {}", run.display());
    }
}

#[test]
fn the_change_probability_is_that_of_a_normal_distribution() {
    assert!((change_probability(0.0) - 1.0).abs() < 1e-6);
    assert!((change_probability(2.0) - 0.317_31).abs() < 1e-5);
    assert!((change_probability(4.0) - 0.045_50).abs() < 1e-5);
}
