//! What the nominal model reads where nothing touches, beside what a recording counts its readings from.
//!
//! A recording that was tared holds signals: there what each simulated skin reads in the same untouched frames is subtracted from what it reads
//! ([`Simulator::readings`](crate::simulate::Simulator::readings)). In readings as they were recorded they are still there. What
//! scales with a touch (the laws of the model discrepancy, the energy of a model along an axis) must not scale with them.

use dermis_model::Untouched;
use serde::{Deserialize, Serialize};

/// Untouched readings of the nominal model, one a channel, in the unit of the skin; nothing where there are none.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ZeroLevel {
    /// Those that simulated readings still hold.
    held: Vec<f64>,
    /// Those that were subtracted from simulated readings.
    subtracted: Vec<f64>,
}

impl ZeroLevel {
    /// Of a design that reads `untouched`, and so much of it whatever its channels are shifted by (`unshifted`).
    pub(crate) fn new(untouched: &Untouched, unshifted: &Untouched, tared: bool) -> Self {
        if !tared || unshifted.is_zero() {
            return Self { held: untouched.readings().to_vec(), subtracted: Vec::new() };
        }
        let subtracted = unshifted.readings().to_vec();
        let held = untouched.readings().iter().zip(&subtracted).map(|(u, s)| u - s).collect();
        Self { held, subtracted }
    }

    /// Signal of a channel that reads this.
    pub(crate) fn signal(&self, channel: usize, reading: f64) -> f64 {
        self.held.get(channel).map_or(reading, |held| reading - held)
    }

    /// Whether something was subtracted: the recording was tared, and the design reads something of its own.
    pub(crate) fn is_subtracted(&self) -> bool {
        !self.subtracted.is_empty()
    }

    /// What was subtracted from the readings of a channel.
    pub(crate) fn subtracted(&self, channel: usize) -> f64 {
        self.subtracted.get(channel).copied().unwrap_or(0.0)
    }

    /// Signals of readings, samples × channels.
    pub(crate) fn signals(&self, readings: &[f32], channels: usize) -> Vec<f32> {
        let of = |(i, v): (usize, &f32)| self.signal(i % channels, f64::from(*v)) as f32;
        readings.iter().enumerate().map(of).collect()
    }

    /// Readings as a channel's range speaks of them, samples × channels; `None` where nothing was subtracted.
    pub(crate) fn restored(&self, readings: &[f32], channels: usize) -> Option<Vec<f32>> {
        if self.subtracted.is_empty() {
            return None;
        }
        let of = |(i, v): (usize, &f32)| (f64::from(*v) + self.subtracted(i % channels)) as f32;
        Some(readings.iter().enumerate().map(of).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_are_what_touches_add() {
        let (untouched, unshifted) = (Untouched::from(vec![7.0, 3.0]), Untouched::from(vec![5.0, 3.0]));
        // As recorded, all of it is in the readings.
        let level = ZeroLevel::new(&untouched, &unshifted, false);
        assert_eq!(level.signals(&[8.0, 8.0], 2), [1.0, 5.0]);
        assert_eq!(level.restored(&[8.0, 8.0], 2), None);
        // Tared, only what channels are shifted by.
        let level = ZeroLevel::new(&untouched, &unshifted, true);
        assert_eq!(level.signals(&[3.0, 5.0], 2), [1.0, 5.0]);
        assert_eq!(level.restored(&[3.0, 5.0], 2).unwrap(), [8.0, 8.0]);
        // Nothing is subtracted from a design that reads nothing of its own.
        let level = ZeroLevel::new(&Untouched::from(vec![2.0, 0.0]), &Untouched::from(vec![0.0; 2]), true);
        assert_eq!((level.subtracted(0), level.restored(&[1.0], 2)), (0.0, None));
        assert_eq!(ZeroLevel::default().signals(&[1.0, 2.0], 2), [1.0, 2.0]);
    }
}
