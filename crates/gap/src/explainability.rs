//! What could be explained at all: a smoother over everything that was recorded beside the readings.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::constants::explainability::{FIRST_SINCE, FORCE, KNOWN, NEAREST, PREDICTED, SOFTENING, WEIGHTS};
use crate::samples::{Sample, Samples};

/// What a residual goes with, in first order: the force where something touches.
fn size(row: &Sample) -> f64 {
    if row.phase.touched() { row.force.max(FORCE) } else { 1.0 }
}

/// Share of the energy of `residual` (samples × channels) that the nearest samples of other groups predict.
#[must_use]
pub fn explainable(residual: &[f32], samples: &Samples, channels: usize, seed: u64) -> f64 {
    let coordinates: Vec<[f64; 9]> = samples.list.iter().map(coordinates).collect();
    let mut spread = [0.0f64; 9];
    let mut mean = [0.0f64; 9];
    let n = coordinates.len().max(1) as f64;
    for c in &coordinates {
        for a in 0..9 {
            mean[a] += c[a] / n;
        }
    }
    for c in &coordinates {
        for a in 0..9 {
            spread[a] += (c[a] - mean[a]).powi(2) / n;
        }
    }
    // Where a contact is decides; the rest shades it.
    let scaled: Vec<[f64; 9]> = coordinates
        .iter()
        .map(|c| {
            let mut s = [0.0; 9];
            for a in 0..9 {
                s[a] = if spread[a] > 1e-18 { WEIGHTS[a] * (c[a] - mean[a]) / spread[a].sqrt() } else { 0.0 };
            }
            s
        })
        .collect();
    let mut order: Vec<usize> = (0..scaled.len()).collect();
    order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed ^ 0x6e));
    let known: Vec<usize> = order.iter().copied().take(KNOWN).collect();
    let (mut left, mut all) = (0.0, 0.0);
    let mut near: Vec<(f64, usize)> = Vec::new();
    let mut guess = vec![0.0f64; channels];
    for &i in order.iter().take(PREDICTED) {
        near.clear();
        for &j in &known {
            if samples.list[j].group == samples.list[i].group {
                continue;
            }
            let away: f64 = scaled[i].iter().zip(&scaled[j]).map(|(a, b)| (a - b).powi(2)).sum();
            if near.len() < NEAREST || near.last().is_some_and(|l| away < l.0) {
                let at = near.partition_point(|n| n.0 < away);
                near.insert(at, (away, j));
                near.truncate(NEAREST);
            }
        }
        guess.fill(0.0);
        let mut weights = 0.0;
        for (away, j) in &near {
            let w = 1.0 / (away + SOFTENING);
            weights += w;
            let ratio = if samples.list[i].phase.touched() == samples.list[*j].phase.touched() {
                size(&samples.list[i]) / size(&samples.list[*j])
            } else {
                0.0
            };
            for (g, v) in guess.iter_mut().zip(&residual[j * channels..(j + 1) * channels]) {
                *g += w * ratio * f64::from(*v);
            }
        }
        for (g, v) in guess.iter().zip(&residual[i * channels..(i + 1) * channels]) {
            let v = f64::from(*v);
            all += v * v;
            left += (v - if weights > 0.0 { g / weights } else { 0.0 }).powi(2);
        }
    }
    if all > 0.0 { 1.0 - left / all } else { 0.0 }
}

fn coordinates(row: &Sample) -> [f64; 9] {
    let or = |v: f64, other: f64| if v.is_finite() { v } else { other };
    let phase = match row.phase {
        dermis_skin::Phase::Load => -1.0,
        dermis_skin::Phase::Unload => 1.0,
        p if p.touched() => 0.0,
        _ => 2.0,
    };
    [
        or(row.position[0], 0.0),
        or(row.position[1], 0.0),
        or(row.position[2], 0.0),
        row.force,
        phase,
        or(row.since, 0.0).max(FIRST_SINCE).ln(),
        or(row.temperature, 0.0),
        row.time,
        row.before - row.force,
    ]
}
