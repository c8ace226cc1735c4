use dermis_skin::Phase;
use rand::SeedableRng;

use super::*;
use crate::samples::{Sample, Samples};

/// Forty locations, each pressed once with eight frames, on two channels.
fn samples() -> Samples {
    let mut samples = Samples { groups: 40, test: vec![false; 40], presses: 40, ..Samples::default() };
    for i in 0..320 {
        let (group, step) = (i / 8, i % 8);
        samples.list.push(Sample {
            frame: i,
            group,
            press: group,
            location: (0, group as u32),
            session: 0,
            phase: Phase::Hold,
            force: 0.5 + 0.1 * step as f64,
            since: 0.1 * ((3 * step) % 8) as f64,
            time: i as f64,
            before: 0.5 + 0.1 * step as f64,
            speed: 0.0,
            temperature: f64::NAN,
            position: [1e-3 * ((group * 7) % 40) as f64, 0.0, 0.0],
            diameter: 8e-3,
            contacts: 1,
            paired: false,
            zero: None,
        });
    }
    samples
}

fn found(gap: impl Fn(&Sample) -> f64) -> Vec<Axis> {
    let samples = samples();
    let model: Vec<f32> = samples.list.iter().flat_map(|r| [100.0 * r.force as f32; 2]).collect();
    let residual: Vec<f32> = samples.list.iter().flat_map(|r| [gap(r) as f32; 2]).collect();
    let sigma = [1.0, 1.0];
    let view = View {
        samples: &samples,
        channels: 2,
        residual: &residual,
        model: &model,
        sigma: &sigma,
        variance: 1e4,
        noise: 0.0,
    };
    shares(&view, &["run".to_owned()], 1)
}

#[test]
fn a_gap_that_changes_its_sign_lies_where_it_is() {
    // From the middle of the session on, to either side from place to place: no mean and no factor holds it.
    let axes = found(|r| {
        if r.time < 160.0 {
            0.0
        } else if r.group % 2 == 0 {
            10.0
        } else {
            -10.0
        }
    });
    assert_eq!(axes[0].axis, "session time", "{axes:?}");
    assert!((axes[0].share - 0.5).abs() < 0.1 && axes[0].interval[0] < axes[0].share, "{:?}", axes[0]);
    // Presses follow each other evenly.
    assert_eq!(axes[0].title(), "session time or presses so far");
    assert!(axes.iter().all(|a| a.axis != "presses so far"));
}

#[test]
fn what_goes_with_the_force_and_with_nothing_is_told() {
    let axes = found(|r| if r.force > 1.0 { 40.0 * (r.force - 1.0) } else { 0.0 });
    let force = axes.iter().find(|a| a.axis == "force").unwrap();
    assert!(
        force.share > 0.05 && force.share > axes.iter().find(|a| a.axis == "surface location").unwrap().share
    );
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let signs: Vec<f64> = (0..320).map(|_| if rng.random_bool(0.5) { 10.0 } else { -10.0 }).collect();
    let axes = found(|r| signs[r.frame]);
    assert!(axes.iter().all(|a| a.share < 0.15), "{axes:?}");
}
