//! Whether an estimate can be relied on, in one sentence.

use dermis_skin::{ChannelFlags, TareState};

use super::{Quality, SkinEstimator};
use crate::condition::listed;

impl SkinEstimator {
    /// Impaired channels: their names with what is wrong but for those of parts that are out of order, and of those that are not
    /// masked, how many of how many are unusable.
    pub(super) fn channel_faults(&self) -> (Vec<String>, usize, usize) {
        let reading = &self.cleaned.reading;
        let mut names = Vec::new();
        let (mut invalid, mut checked) = (0, 0);
        let of_part = |channel: usize| self.faults.iter().any(|fault| fault.channels.contains(&channel));
        for (k, (channel, flags)) in self.skin.channels().iter().zip(&reading.flags).enumerate() {
            if !flags.contains(ChannelFlags::MASKED) {
                checked += 1;
                invalid += usize::from(flags.is_invalid());
            }
            if !flags.is_ok() && !of_part(k) {
                names.push(format!("{} ({flags})", channel.name));
            }
        }
        (names, invalid, checked)
    }

    /// What is wrong with parts of the device, and with channels.
    fn faulty(&self) -> (Vec<String>, usize, usize) {
        let (channels, invalid, checked) = self.channel_faults();
        let mut faults: Vec<String> = self.faults.iter().map(ToString::to_string).collect();
        faults.extend(channels);
        (faults, invalid, checked)
    }

    pub(super) fn evaluate(&self) -> (Quality, String) {
        let (faults, invalid, checked) = self.faulty();
        if 2 * invalid > checked || checked == 0 {
            return (
                Quality::Fault,
                format!(
                    "{invalid} of {checked} channels are unusable: {}; check the sensor and its wiring",
                    listed(&faults, 8)
                ),
            );
        }
        if self.pipelines.is_empty() {
            return (Quality::Uncalibrated, self.no_model.clone());
        }
        if self.needs_zero() && !self.conditioner.is_tared() {
            return (Quality::Uncalibrated, self.untared());
        }
        if faults.is_empty() {
            return (Quality::Ok, String::new());
        }
        let channels = self.cleaned.reading.values.len();
        let impaired = self.cleaned.reading.flags.iter().filter(|flags| !flags.is_ok()).count();
        let mut text = format!("{impaired} of {channels} channels are impaired: {}", listed(&faults, 8));
        if self.channels_missing() && self.pipelines.iter().all(|p| p.inverter.is_none()) {
            text += "; no forward model stands in for them, so that the error of the contacts is unknown";
        }
        (Quality::Degraded, text)
    }

    pub(super) fn untared(&self) -> String {
        match self.conditioner.tare_state() {
            TareState::Averaging { disturbed: Some(spread), .. } => format!(
                "not tared: the readings move by {spread:.1} times their noise; leave the skin untouched, or correct \
                 `noise` in the skin file"
            ),
            TareState::Averaging { elapsed, .. } => format!(
                "not tared yet: {elapsed:.1} of {:.1} s of untouched readings",
                self.conditioner.condition().tare_duration
            ),
            TareState::Done => "not tared".into(),
        }
    }
}
