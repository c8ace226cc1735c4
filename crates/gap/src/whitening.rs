//! Readings and residuals in deviations of the noise, so that all channels weigh by what they can say.
//!
//! Whitened values are `(readings − model) / sigma`, samples × channels. A channel that gives nothing has an infinite `sigma`, and
//! readings that were cut off are NaN: both become 0, which asks nothing of a fit.

use dermis_skin::SkinDescription;

use crate::axes::View;
use crate::noise::{self, Gap};
use crate::samples::Samples;
use crate::statistics::Column;

/// Makes readings (samples × channels) NaN that lie at the end of their channel's range, or whose model does: how far beyond it
/// they would be nobody knows, and a fit must not take the end for a reading. `sigma` is the deviation of each channel's noise.
pub fn mask_saturated(readings: &mut [f32], nominal: &[f32], skin: &SkinDescription, sigma: &[f64]) {
    let ranges: Vec<Option<[f64; 2]>> = skin.channels().iter().map(|c| c.range).collect();
    for (i, (reading, model)) in readings.iter_mut().zip(nominal).enumerate() {
        let k = i % sigma.len();
        let Some([low, high]) = ranges[k] else { continue };
        let near = if sigma[k].is_finite() { sigma[k].min(0.01 * (high - low)) } else { 0.0 };
        let ends = |v: f64| v <= low + near || v >= high - near;
        if ends(f64::from(*reading)) || ends(f64::from(*model)) {
            *reading = f32::NAN;
        }
    }
}

/// Readings minus model, whitened.
pub(crate) fn residual(readings: &[f32], model: &[f32], sigma: &[f64]) -> Vec<f32> {
    readings
        .iter()
        .zip(model)
        .enumerate()
        .map(|(i, (y, s))| {
            let r = (f64::from(*y) - f64::from(*s)) / sigma[i % sigma.len()];
            if r.is_finite() { r as f32 } else { 0.0 }
        })
        .collect()
}

/// Readings, whitened.
pub(crate) fn whiten(readings: &[f32], sigma: &[f64]) -> Vec<f32> {
    let nothing = vec![0.0; readings.len()];
    residual(readings, &nothing, sigma)
}

/// How large the gap of a whitened residual is; `scaled` are the whitened readings.
pub(crate) fn measure(residual: &[f32], scaled: &[f32], samples: &Samples, sigma: &[f64], seed: u64) -> Gap {
    let usable = sigma.iter().filter(|s| s.is_finite()).count();
    noise::measure(residual, scaled, samples, usable, sigma.len(), seed)
}

/// What axes and maps look at.
pub(crate) fn view<'a>(
    samples: &'a Samples,
    residual: &'a [f32],
    model: &'a [f32],
    sigma: &'a [f64],
    gap: &Gap,
) -> View<'a> {
    View {
        samples,
        channels: sigma.len(),
        residual,
        model,
        sigma,
        variance: gap.variance,
        noise: gap.floor * gap.variance,
    }
}

/// A column in deviations of the measured noise instead of the declared one, where there are `readings`.
pub(crate) fn rescale(column: &Column, declared: &[f64], sigma: &[f64], readings: &[f32]) -> Column {
    let channels = sigma.len();
    let factor = |i: usize| {
        let k = i % channels;
        let f = declared[k] / sigma[k];
        if f.is_finite() && readings[i].is_finite() { f as f32 } else { 0.0 }
    };
    let values = match column.channel {
        Some(k) => column.values.iter().enumerate().map(|(i, v)| v * factor(i * channels + k)).collect(),
        None => column.values.iter().enumerate().map(|(i, v)| v * factor(i)).collect(),
    };
    Column { channel: column.channel, values }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_says_nothing_asks_nothing() {
        let sigma = [2.0, f64::INFINITY];
        assert_eq!(residual(&[5.0, 7.0, f32::NAN, 1.0], &[1.0, 0.0, 1.0, 0.0], &sigma), [2.0, 0.0, 0.0, 0.0]);
        let column = Column { channel: Some(0), values: vec![3.0, 3.0] };
        let found = rescale(&column, &[4.0, 1.0], &sigma, &[1.0, 1.0, f32::NAN, 1.0]);
        assert_eq!(found.values, [6.0, 0.0]);
        let both = Column { channel: None, values: vec![1.0; 4] };
        assert_eq!(rescale(&both, &[4.0, 1.0], &sigma, &[1.0; 4]).values, [2.0, 0.0, 2.0, 0.0]);
    }
}
