//! Several recordings of one device, and presses that are designed to tell apart what the first leaves open.

use std::sync::atomic::AtomicBool;

use dermis_gap::protocol::design::{Design, DesignOptions, Hypothesis, design};
use dermis_gap::protocol::locations::locations;
use dermis_gap::protocol::open::{Open, open};
use dermis_gap::protocol::{Block, BlockKind, PlannedPress, Range};
use dermis_gap::{Recording, Report, Simulator, Verdict};
use dermis_skin::{Effect, SkinDescription};
use indicatif::ProgressBar;
use nalgebra::Point3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::device::{Device, device, pressed, recorded, together};
use crate::diagnosed;
use crate::model::{EFFECTS, skin, toy};

const RANGE: Range = Range { force: [0.1, 1.0], tip: 0.004, second_tip: Some(0.008) };

#[test]
fn short_recordings_say_together_what_neither_says_alone() {
    let gains = [0.15, -0.12, 0.1, -0.15, 0.2, 0.0];
    let short = [21, 22].map(|seed| recorded(&Device { gains, ..device() }, 24, 1, seed));
    for alone in &short {
        let report = diagnosed(alone);
        assert_eq!(report.verdict, Verdict::UnusableRecording, "{}", report.sentence);
    }
    let report = diagnosed(&together(&[&short[0], &short[1]]));
    assert_eq!(report.class().first(), Some(&"gains"), "{}", report.sentence);
    assert_eq!(report.data.sessions.len(), 2);
}

/// Single presses at random locations with random forces.
fn random(count: usize, force: [f64; 2], seed: u64) -> Vec<Block> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let usual = RANGE.press(0.5);
    (0..count)
        .map(|_| {
            let at = Point3::new(rng.random_range(-0.013..0.013), rng.random_range(-0.008..0.008), 0.0);
            let press = PlannedPress { force: rng.random_range(force[0]..=force[1]), ..usual };
            Block { kind: BlockKind::Single, at, presses: vec![press] }
        })
        .collect()
}

fn next(report: &Report, minutes: f64) -> Design {
    let skin = skin();
    let make = |skin: &SkinDescription| toy(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    let Open { hypotheses, beside, .. } = open(report, EFFECTS);
    let model = toy(&skin).unwrap();
    let locations =
        locations(model.as_ref(), (0.6, 0.004), 8, |p| p.x.abs() < 0.013 && p.y.abs() < 0.008).unwrap();
    let options = DesignOptions { minutes, range: RANGE, beside, unknown: 0.0 };
    let hidden = ProgressBar::hidden();
    design(&simulator, &hypotheses, &locations, &options, &AtomicBool::new(false), &hidden).unwrap()
}

/// What the tool's own device with these effects reads along these presses.
fn simulated(effects: &[Effect], blocks: &[Block], seed: u64) -> Recording {
    let skin = skin();
    let make = |skin: &SkinDescription| toy(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    let bare = pressed(&device(), blocks, 0, seed);
    let frames: Vec<usize> = (0..bare.labels.len()).collect();
    let read = simulator.readings(&simulator.with(effects), &bare, &frames).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut recording = Recording::new("simulated", 6);
    recording.sessions.push("one".to_owned());
    for (label, read) in bare.labels.into_iter().zip(read.chunks_exact(6)) {
        let noisy: Vec<f32> = read.iter().map(|v| v + 5.0 * rng.sample::<f32, _>(StandardNormal)).collect();
        recording.push(label, &noisy);
    }
    recording
}

/// A medium that stiffens, pressed with one force only: the force cell, the gains and the medium look alike.
#[test]
fn designed_presses_name_the_cause_more_often_than_as_many_random_ones() {
    let mut right = [0, 0, 0];
    for (seed, rise) in [(31, 0.25), (32, 0.2), (33, -0.15)] {
        let effects = [Effect::new("stiffening").with("rise", rise)];
        let first = simulated(&effects, &random(60, [0.6, 0.6], seed), seed);
        let before = diagnosed(&first);
        assert!(before.class().len() > 1, "the first recording cannot tell: {}", before.sentence);
        let found = next(&before, 1.0);
        let count: usize = found.blocks.iter().map(|b| b.presses.len()).sum();
        assert!(found.separations[0].p_after < 0.01, "{:?}", found.separations);
        let plans =
            [found.blocks, random(count, [0.6, 0.6], seed + 50), random(count, [0.1, 1.0], seed + 50)];
        for (blocks, right) in plans.iter().zip(&mut right) {
            let second = simulated(&effects, blocks, seed + 70);
            let report = diagnosed(&together(&[&first, &second]));
            println!("{rise}: {:?} {:?}", report.verdict, report.class());
            *right += usize::from(report.class() == ["stiffening"]);
        }
    }
    // As many presses like the first ones settle nothing; over all forces they may.
    let [designed, like_the_first, over_all_forces] = right;
    assert!(designed == 3 && designed > like_the_first && designed >= over_all_forces, "{right:?}");
}

fn plain(hypotheses: &[Hypothesis]) -> Design {
    let skin = skin();
    let make = |skin: &SkinDescription| toy(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    let locations: Vec<Point3<f64>> = [-0.009, 0.0, 0.009].map(|x| Point3::new(x, 0.003, 0.0)).into();
    let options = DesignOptions { minutes: 0.5, range: RANGE, beside: Vec::new(), unknown: 0.0 };
    let hidden = ProgressBar::hidden();
    design(&simulator, hypotheses, &locations, &options, &AtomicBool::new(false), &hidden).unwrap()
}

#[test]
fn what_bends_with_the_force_is_told_by_a_ladder_and_two_names_of_one_thing_by_nothing() {
    let of = |name: &str, effect: Effect| Hypothesis {
        name: name.to_owned(),
        effects: vec![effect],
        p_confuse: 0.4,
    };
    let gain =
        ["a", "b", "c", "d", "e", "f"].iter().fold(Effect::new("channel-gain"), |e, c| e.with(*c, 1.1));
    let found = plain(&[
        of("stiffening", Effect::new("stiffening").with("rise", 0.15)),
        of("force-scale", Effect::new("force-scale").with("factor", 1.1)),
    ]);
    let [separation] = &found.separations[..] else { panic!("{:?}", found.separations) };
    assert!(!separation.one_thing && (separation.p_before - 0.4).abs() < 1e-3, "{separation:?}");
    assert!(separation.p_after < 0.01, "{separation:?}");
    assert!(found.blocks.iter().any(|b| b.kind == BlockKind::Ladder), "{:?}", found.blocks);
    assert!(found.minutes() <= 0.5);

    let same =
        plain(&[of("force-scale", Effect::new("force-scale").with("factor", 1.1)), of("channel-gain", gain)]);
    assert!(same.separations.iter().all(|s| s.one_thing && s.by.is_none()), "{:?}", same.separations);
}
