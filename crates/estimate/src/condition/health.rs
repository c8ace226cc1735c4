//! Whether a channel's value can be relied on: dead, stuck, saturated, masked, broken.

use dermis_skin::{ChannelFlags, Condition, Frame, SkinDescription, Stamp};

/// Fewest unchanged readings that count as evidence of a stuck channel.
const FEWEST_UNCHANGED: f64 = 20.0;
/// A press that takes one of coupled channels to the end of its range is detected by another at this share of it or more.
const SOLITARY: f64 = 1.0 / 30.0;
/// Misjudging a healthy channel takes this many expected waiting times without a change (e⁻²⁰).
const SURE: f64 = 20.0;

/// Watches each channel for signs that its value says nothing.
#[derive(Debug, Clone)]
pub(super) struct Health {
    channels: Vec<Watch>,
    /// \[s\] a pause longer than this breaks a run of unchanged readings.
    longest_pause: f64,
    /// Smallest step that any channel ever made: the quantisation, as far as it is known.
    step: f64,
    last: Option<Stamp>,
}

#[derive(Debug, Clone)]
struct Watch {
    masked: bool,
    noise: f64,
    range: Option<[f64; 2]>,
    value: f32,
    since: Stamp,
    unchanged: u32,
    ever_changed: bool,
    /// It stands at the end of its range, and nothing holds it there.
    broken: bool,
}

impl Health {
    pub(super) fn new(skin: &SkinDescription, masked: Vec<bool>) -> Self {
        let channels = skin
            .channels()
            .iter()
            .zip(masked)
            .map(|(c, masked)| Watch {
                masked,
                noise: c.noise.unwrap_or(skin.noise),
                range: c.range,
                value: f32::NAN,
                since: 0,
                unchanged: 0,
                ever_changed: false,
                broken: false,
            })
            .collect();
        // A scale other than 1 is the unit per raw count, so no reading can move by less.
        let step = if skin.wire.scale == 1.0 { 0.0 } else { skin.wire.scale.abs() };
        Self { channels, longest_pause: (5.0 / skin.rate).max(1.0), step, last: None }
    }

    pub(super) fn reset(&mut self) {
        for watch in &mut self.channels {
            watch.value = f32::NAN;
            watch.unchanged = 0;
            watch.ever_changed = false;
            watch.broken = false;
        }
        self.last = None;
    }

    /// Where channels are coupled: takes those for broken that stand at the end of their range while no other feels anything.
    /// At once, where no press could be detected by one alone so much; otherwise once it has stood still there. It is believed again as
    /// soon as it moves. Whether the frame has changed by this.
    pub(super) fn disown(&mut self, reading: &mut Frame, signal: &[f32], condition: &Condition) -> bool {
        if !condition.coupled {
            return false;
        }
        let railed = |flags: &ChannelFlags| flags.contains(ChannelFlags::SATURATED);
        let level = |i: usize, channels: &[Watch]| f64::from(signal[i]).abs() / channels[i].noise;
        let mut changed = false;
        for i in 0..self.channels.len() {
            if !railed(&reading.flags[i]) || reading.flags[i].is_invalid() {
                continue;
            }
            let others = (0..self.channels.len())
                .filter(|j| *j != i && !railed(&reading.flags[*j]))
                .map(|j| level(j, &self.channels))
                .filter(|z| z.is_finite());
            let Some(most) = others.reduce(f64::max).filter(|most| *most < condition.contact_threshold)
            else {
                continue;
            };
            let alone = most.max(condition.contact_threshold) < SOLITARY * level(i, &self.channels);
            let watch = &mut self.channels[i];
            if alone || watch.stands_still(reading.stamp, condition.stuck_time) {
                watch.broken = true;
                reading.flags[i] |= watch.fault();
                reading.values[i] = f32::NAN;
                changed = true;
            }
        }
        changed
    }

    pub(super) fn flag(&mut self, frame: &mut Frame, condition: &Condition) {
        let pause = self.last.map_or(0.0, |last| frame.stamp.saturating_sub(last) as f64 * 1e-9);
        let broken = pause < 0.0 || pause > self.longest_pause;
        self.last = Some(frame.stamp);
        let mut smallest = f64::INFINITY;
        for (watch, value) in self.channels.iter_mut().zip(&frame.values) {
            watch.observe(*value, frame.stamp, broken, &mut smallest);
        }
        // Without a declared scale the quantisation shows in the smallest step that occurs.
        if smallest.is_finite() && (self.step == 0.0 || smallest < self.step) {
            self.step = smallest;
        }
        // Raw counts that nothing moved yet: whole numbers hint at a step of one.
        let step = if self.step > 0.0 {
            self.step
        } else if frame.values.iter().all(|v| !v.is_finite() || v.fract() == 0.0) {
            1.0
        } else {
            0.0
        };
        for ((watch, value), flags) in self.channels.iter().zip(&frame.values).zip(&mut frame.flags) {
            *flags |= watch.verdict(*value, frame.stamp, step, condition.stuck_time, *flags);
        }
    }
}

impl Watch {
    fn observe(&mut self, value: f32, stamp: Stamp, broken: bool, smallest: &mut f64) {
        if !value.is_finite() {
            return;
        }
        if value == self.value && !broken {
            self.unchanged = self.unchanged.saturating_add(1);
            return;
        }
        if self.value.is_finite() && value != self.value {
            self.ever_changed = true;
            *smallest = smallest.min((f64::from(value) - f64::from(self.value)).abs());
        }
        self.value = value;
        self.since = stamp;
        self.unchanged = 0;
        self.broken = false;
    }

    /// Whether it has not changed for `stuck_time` \[s\]; never where that is 0.
    fn stands_still(&self, stamp: Stamp, stuck_time: f64) -> bool {
        let elapsed = stamp.saturating_sub(self.since) as f64 * 1e-9;
        stuck_time > 0.0 && elapsed >= stuck_time && f64::from(self.unchanged) >= FEWEST_UNCHANGED
    }

    fn verdict(
        &self,
        value: f32,
        stamp: Stamp,
        step: f64,
        stuck_time: f64,
        known: ChannelFlags,
    ) -> ChannelFlags {
        if self.masked {
            return ChannelFlags::MASKED;
        }
        let mut flags = ChannelFlags::OK;
        if !value.is_finite() {
            // A recording that names the fault already says why there is no number.
            if !known.is_invalid() {
                flags |= ChannelFlags::NOT_FINITE;
            }
            return flags;
        }
        let value = f64::from(value);
        let railed = self.range.is_some_and(|[low, high]| {
            let margin = (step / 2.0).max(1e-6 * (high - low));
            value <= low + margin || value >= high - margin
        });
        if railed {
            flags |= ChannelFlags::SATURATED;
        }
        // At its rail a channel stands still however noisy it is, and a hard press may hold it there for minutes:
        // only one that never left it since the start is known to be dead, and one that nothing else feels broken.
        let still = self.stands_still(stamp, stuck_time);
        let suspicious = if railed {
            self.broken || still && !self.ever_changed
        } else {
            still && f64::from(self.unchanged) >= SURE / change_probability(step / self.noise)
        };
        if suspicious {
            flags |= self.fault();
        }
        flags
    }

    /// What is wrong with it, where something is.
    fn fault(&self) -> ChannelFlags {
        if self.ever_changed { ChannelFlags::STUCK } else { ChannelFlags::DEAD }
    }
}

/// Least probability that the next reading of a healthy channel differs from this one, where the noise-free value
/// sits in the middle of a quantisation step of `step` noise deviations: 2 (1 − Φ(step/2)).
pub(super) fn change_probability(step: f64) -> f64 {
    erfc(step / (2.0 * std::f64::consts::SQRT_2)).max(1e-12)
}

/// Complementary error function for x ≥ 0, to 1.5e-7 absolute (Abramowitz and Stegun 7.1.26).
fn erfc(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let poly = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    poly * (-x * x).exp()
}
