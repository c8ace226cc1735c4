//! Several recordings of one device, and presses that are designed to tell apart what the first leaves open.

use std::sync::atomic::AtomicBool;

use dermis_gap::protocol::design::{Design, DesignOptions, Hypothesis, design};
use dermis_gap::protocol::places::places;
use dermis_gap::protocol::{Block, BlockKind, PlannedPress, Range};
use dermis_gap::{Recording, Report, Simulator, Verdict};
use dermis_skin::{Effect, SkinDescription};
use indicatif::ProgressBar;
use nalgebra::Point3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

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

/// Single presses at random places, all with one force and one speed, and with little time to creep.
fn alike(device: &Device, count: usize, seed: u64) -> Recording {
    pressed(device, &random(count, [0.6, 0.6], seed), 0, seed)
}

/// Single presses at random places with random forces.
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
    let mut hypotheses = report.hypotheses.clone();
    for suspect in report.suspects.iter().take(3) {
        if !hypotheses.iter().any(|h| h.name == suspect.name) {
            let effects =
                EFFECTS.iter().filter(|e| e.name == suspect.name).map(|e| Effect::new(e.name)).collect();
            hypotheses.push(Hypothesis { name: suspect.name.clone(), effects, p_confuse: 0.25 });
        }
    }
    let model = toy(&skin).unwrap();
    let places =
        places(model.as_ref(), (0.6, 0.004), 24, |p| p.x.abs() < 0.013 && p.y.abs() < 0.008).unwrap();
    let options = DesignOptions { minutes, range: RANGE, beside: Vec::new(), unknown: 0.0 };
    let hidden = ProgressBar::hidden();
    design(&simulator, &hypotheses, &places, &options, &AtomicBool::new(false), &hidden).unwrap()
}

#[test]
fn designed_presses_name_the_cause_more_often_than_as_many_random_ones() {
    let mut right = [0, 0];
    let mut tried = 0;
    for (seed, power) in [(31, 0.06), (32, 0.08), (33, 0.1), (34, 0.12)] {
        let device = Device { power, law: 0.3, ..device() };
        let first = alike(&device, 60, seed);
        let before = diagnosed(&first);
        println!(
            "{power}: {:?} {:?} {:?}",
            before.verdict,
            before.class(),
            before.suspects.iter().map(|s| &s.name).collect::<Vec<_>>()
        );
        let found = next(&before, 2.0);
        println!("{:?} {:?}", found.separations, found.blocks.iter().map(|b| b.kind).collect::<Vec<_>>());
        let count: usize = found.blocks.iter().map(|b| b.presses.len()).sum();
        tried += 1;
        let plans = [found.blocks.clone(), random(count, [0.1, 1.0], seed + 50)];
        for (blocks, right) in plans.iter().zip(&mut right) {
            let second = pressed(&device, blocks, 1, seed + 70);
            let report = diagnosed(&together(&[&first, &second]));
            println!("  {:?} {:?}", report.verdict, report.class());
            *right += usize::from(report.class() == ["stiffening"]);
        }
    }
    println!("{right:?} of {tried}");
    assert!(right[0] > right[1], "{right:?} of {tried}");
}
