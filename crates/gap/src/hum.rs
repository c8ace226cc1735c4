//! Whether the noise of untouched frames is noise: hum of one frequency is in no mean of residuals, and looks like noise in repeats.

use std::f64::consts::TAU;

use crate::data::Recording;

/// Frames of a stretch whose spectrum is taken.
const STRETCH: usize = 64;
/// Stretches that say anything.
const FEWEST: usize = 4;
/// How far a line stands above the median of the spectrum: averages of a few stretches stay well below.
const ABOVE: f64 = 8.0;

/// A line in the spectrum of untouched frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hum {
    /// \[Hz\] as the frames show it; what is above half of their rate comes back below it.
    pub frequency: f64,
    /// Share of the energy of untouched frames, about their mean and trend, that is in the line.
    pub share: f64,
}

/// Finds the strongest line in the spectrum of untouched frames that follow each other.
#[must_use]
pub fn find(recording: &Recording, rate: f64) -> Option<Hum> {
    let mut stretches: Vec<usize> = Vec::new();
    let mut since = 0;
    for (i, moment) in recording.moments.iter().enumerate() {
        let goes_on = i > 0 && recording.moments[i - 1].run == moment.run;
        since = match (moment.phase.touched() || moment.stimulus.is_none(), goes_on) {
            (true, _) => 0,
            (false, true) => since + 1,
            (false, false) => 1,
        };
        if since == STRETCH {
            stretches.push(i + 1 - STRETCH);
            since = 0;
        }
    }
    let half = STRETCH / 2;
    let mut power = vec![0.0f64; half + 1];
    let mut taken = 0;
    for start in stretches {
        for k in 0..recording.channels {
            let mut values: Vec<f64> =
                (0..STRETCH).map(|i| f64::from(recording.frame(start + i)[k])).collect();
            if values.iter().any(|v| !v.is_finite()) {
                continue;
            }
            detrend(&mut values);
            let energy: f64 = values.iter().map(|v| v * v).sum();
            if energy <= 0.0 {
                continue;
            }
            taken += 1;
            for (f, p) in power.iter_mut().enumerate() {
                let (mut re, mut im) = (0.0, 0.0);
                for (i, v) in values.iter().enumerate() {
                    // A window keeps a line in its place.
                    let window = 1.0 - (TAU * (i as f64 + 0.5) / STRETCH as f64).cos();
                    let (sin, cos) = (TAU * (f * i) as f64 / STRETCH as f64).sin_cos();
                    re += window * v * cos;
                    im += window * v * sin;
                }
                // Lines at the ends of the spectrum stand there once, all others twice.
                let twice = if f == 0 || f == half { 0.5 } else { 1.0 };
                *p += twice * (re * re + im * im) / energy;
            }
        }
    }
    if taken < FEWEST {
        return None;
    }
    // What is slow is drift, not hum.
    let slow = 4;
    let mut sorted = power[slow..].to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2].max(1e-300);
    let peak = (slow..=half).max_by(|a, b| power[*a].total_cmp(&power[*b]))?;
    if power[peak] < ABOVE * median {
        return None;
    }
    let line: f64 =
        (peak.saturating_sub(2)..=(peak + 2).min(half)).map(|f| (power[f] - median).max(0.0)).sum();
    let share = line / power.iter().sum::<f64>();
    Some(Hum { frequency: peak as f64 * rate / STRETCH as f64, share })
}

/// Takes mean and straight line out.
fn detrend(values: &mut [f64]) {
    let n = values.len() as f64;
    let middle = (n - 1.0) / 2.0;
    let mean = values.iter().sum::<f64>() / n;
    let (mut xy, mut xx) = (0.0, 0.0);
    for (i, v) in values.iter().enumerate() {
        let x = i as f64 - middle;
        xy += x * (v - mean);
        xx += x * x;
    }
    let slope = xy / xx;
    for (i, v) in values.iter_mut().enumerate() {
        *v -= mean + slope * (i as f64 - middle);
    }
}
