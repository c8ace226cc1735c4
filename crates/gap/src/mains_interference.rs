//! Whether the noise of untouched frames is noise: interference of one frequency is in no mean of residuals, and looks like noise in repeats.

use std::f64::consts::TAU;

use crate::algebra::mean;
use crate::constants::Z95;
use crate::constants::interference::{ABOVE, FEWEST, MAINS, SLOW, STRETCH};
use crate::recording::Recording;

/// A line in the spectrum of untouched frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interference {
    /// \[Hz\] as the frames show it; what is above half of their rate comes back below it.
    pub frequency: f64,
    /// \[Hz\] of the frames, which need not be the skin's: recorders leave frames out.
    pub rate: f64,
    /// Share of the energy of untouched frames, about their mean and trend, that is in the line.
    pub share: f64,
    /// Half of the 95 % interval of it, over stretches of frames.
    pub half: f64,
    /// Amplitude, root mean square over channels, in the unit of the readings.
    pub amplitude: f64,
}

/// Finds the strongest line in the spectrum of untouched frames that follow each other.
#[must_use]
pub fn find(recording: &Recording) -> Option<Interference> {
    let rate = recording.rate()?;
    let half = STRETCH / 2;
    let mut power = vec![0.0f64; half + 1];
    let mut spectra: Vec<Vec<f64>> = Vec::new();
    let mut variance = 0.0;
    let stretches = stretches(recording);
    for &start in &stretches {
        for k in 0..recording.channels {
            let values = (0..STRETCH).map(|i| f64::from(recording.frame(start + i)[k])).collect();
            let Some((own, energy)) = spectrum(values) else { continue };
            variance += energy / STRETCH as f64;
            power.iter_mut().zip(&own).for_each(|(p, o)| *p += o);
            spectra.push(own);
        }
    }
    let taken = spectra.len();
    if taken < FEWEST {
        return None;
    }
    // What is slow is drift, not interference.
    let mut sorted = power[SLOW..].to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2].max(1e-300);
    let peak = (SLOW..=half).max_by(|a, b| power[*a].total_cmp(&power[*b]))?;
    if power[peak] < ABOVE * median {
        return None;
    }
    let line = peak.saturating_sub(2)..=(peak + 2).min(half);
    let of = |power: &[f64], median: f64| -> f64 {
        let above: f64 = line.clone().map(|f| (power[f] - median).max(0.0)).sum();
        above / power.iter().sum::<f64>().max(1e-300)
    };
    let share = of(&power, median);
    // Channels of a stretch interference together.
    let each: Vec<f64> = spectra.iter().map(|own| of(own, median / taken as f64)).collect();
    let level = mean(&each);
    let variance_of = each.iter().map(|s| (s - level).powi(2)).sum::<f64>() / each.len() as f64;
    let spread = Z95 * (variance_of / stretches.len() as f64).sqrt();
    let amplitude = (2.0 * share * variance / taken as f64).sqrt();
    let between = if peak < half { between([power[peak - 1], power[peak], power[peak + 1]]) } else { 0.0 };
    Some(Interference {
        frequency: (peak as f64 + between) * rate / STRETCH as f64,
        rate,
        share,
        half: spread,
        amplitude,
    })
}

/// First frames of stretches of untouched frames that follow each other.
fn stretches(recording: &Recording) -> Vec<usize> {
    let mut stretches = Vec::new();
    let mut since = 0;
    for (i, label) in recording.labels.iter().enumerate() {
        let goes_on = i > 0 && recording.labels[i - 1].run == label.run;
        since = match (label.phase.touched() || label.stimulus.is_none(), goes_on) {
            (true, _) => 0,
            (false, true) => since + 1,
            (false, false) => 1,
        };
        if since == STRETCH {
            stretches.push(i + 1 - STRETCH);
            since = 0;
        }
    }
    stretches
}

/// Spectrum of a stretch of readings about their mean and trend, over their energy, and that energy; `None` where they do not change, or
/// some are missing.
fn spectrum(mut values: Vec<f64>) -> Option<(Vec<f64>, f64)> {
    if values.iter().any(|v| !v.is_finite()) {
        return None;
    }
    detrend(&mut values);
    let energy: f64 = values.iter().map(|v| v * v).sum();
    if energy <= 0.0 {
        return None;
    }
    let half = STRETCH / 2;
    let mut power = vec![0.0f64; half + 1];
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
        *p = twice * (re * re + im * im) / energy;
    }
    Some((power, energy))
}

/// How far beside the middle of three powers in a row, of a window that is half a cosine squared, their line lies.
fn between([below, peak, above]: [f64; 3]) -> f64 {
    let ratio = |side: f64| {
        let root = (side / peak.max(1e-300)).sqrt();
        (2.0 * root - 1.0) / (root + 1.0)
    };
    let by = if above > below { ratio(above) } else { -ratio(below) };
    by.clamp(-0.5, 0.5)
}

/// What mains shows at frames of this rate, where it is the frequency `seen` within what a stretch resolves: \[Hz\] of the mains.
#[must_use]
pub fn mains(seen: f64, rate: f64) -> Option<f64> {
    let folded = |f: f64| (f - rate * (f / rate).round()).abs();
    MAINS.into_iter().find(|f| (folded(*f) - seen).abs() < 0.5 * rate / STRETCH as f64)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FrameLabel;
    use dermis_model::Stimulus;
    use dermis_skin::Phase;

    #[test]
    fn a_hum_has_a_frequency_and_an_amplitude() {
        for (frequency, shows, of) in [(7.3, 7.3, None), (50.0, 30.0, Some(50.0)), (60.0, 20.0, Some(60.0))] {
            let mut recording = Recording::new("interference", 1);
            let mut noise = 1u32;
            for i in 0..2000_u32 {
                let t = f64::from(i) / 80.0;
                let label = FrameLabel {
                    time: t,
                    run: 0,
                    press: 0,
                    location: 0,
                    phase: Phase::Idle,
                    stimulus: Some(Stimulus::default()),
                    temperature: f64::NAN,
                };
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let jitter = f64::from(noise >> 8) / f64::from(1u32 << 24) - 0.5;
                recording.push(label, &[(4.0 * (TAU * frequency * t).sin() + jitter) as f32]);
            }
            let interference = find(&recording).unwrap();
            approx::assert_abs_diff_eq!(interference.frequency, shows, epsilon = 0.1);
            approx::assert_relative_eq!(interference.amplitude, 4.0, max_relative = 0.05);
            approx::assert_relative_eq!(interference.rate, 80.0, max_relative = 1e-9);
            assert_eq!(mains(interference.frequency, interference.rate), of);
        }
    }
}
