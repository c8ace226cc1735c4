//! Whether the readings stand still, as they do once nothing touches any more.

use dermis_skin::{Frame, Stamp};

/// Readings are at rest while they stay this close to where they were, root mean square over the channels, in units of
/// their noise. The difference of two noisy readings alone makes √2.
const AT_REST: f64 = 3.0;

/// Notices when the readings stand still.
#[derive(Debug, Clone, Default)]
pub(super) struct Rest {
    since: Option<Stamp>,
    frames: u32,
    /// First reading of the rest, and mean of all of them; NaN for a channel without any.
    anchor: Vec<f64>,
    pub(super) mean: Vec<f64>,
}

impl Rest {
    /// Whether the readings have stayed within a few noise deviations for `duration` \[s\], this one included.
    pub(super) fn push(&mut self, reading: &Frame, noise: &[f64], duration: f64) -> bool {
        let value = |i: usize| f64::from(reading.values[i]);
        let (mut sum, mut count) = (0.0, 0_u32);
        for (i, (anchor, noise)) in self.anchor.iter().zip(noise).enumerate() {
            let z = (value(i) - anchor) / noise;
            if z.is_finite() {
                sum += z * z;
                count += 1;
            }
        }
        let moved = count == 0 || (sum / f64::from(count)).sqrt() > AT_REST;
        let since = self.since.filter(|since| !moved && *since <= reading.stamp);
        let Some(since) = since else {
            self.since = Some(reading.stamp);
            self.frames = 1;
            self.anchor = reading.values.iter().map(|v| f64::from(*v)).collect();
            self.mean.clone_from(&self.anchor);
            return false;
        };
        self.frames = self.frames.saturating_add(1);
        for (i, mean) in self.mean.iter_mut().enumerate() {
            if value(i).is_finite() {
                *mean = if mean.is_nan() {
                    value(i)
                } else {
                    *mean + (value(i) - *mean) / f64::from(self.frames)
                };
            }
        }
        self.frames >= 3 && reading.stamp.saturating_sub(since) as f64 * 1e-9 >= duration
    }
}
