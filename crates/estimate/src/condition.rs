//! Cleaning: channel health, zero, and whether the skin is touched.

use std::collections::BTreeSet;

use dermis_skin::{
    ChannelFlags, Condition, Frame, ImageGrid, ImageGridError, SkinDescription, Stamp, TareState, ZeroTracker,
};

/// A contact ends below this share of the level at which it begins, so that noise does not make it flicker.
const RELEASE: f64 = 0.6;
/// Readings are at rest while they stay this close to where they were, root mean square over the channels, in units of
/// their noise. The difference of two noisy readings alone makes √2.
const AT_REST: f64 = 3.0;
/// Fewest unchanged readings that count as evidence of a stuck channel.
const FEWEST_UNCHANGED: f64 = 20.0;
/// A press that takes one of coupled channels to the end of its range is felt by another at this share of it or more.
const SOLITARY: f64 = 1.0 / 30.0;
/// Misjudging a healthy channel takes this many expected waiting times without a change (e⁻²⁰).
const SURE: f64 = 20.0;

/// Why a configuration does not fit the skin.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ConditionError {
    /// A masked channel that the skin does not have.
    #[error("masked channel `{name}` is none of skin `{skin}`; its channels are {known}")]
    UnknownChannel {
        /// Channel as configured.
        name: String,
        /// Name of the skin.
        skin: String,
        /// Channels that exist.
        known: String,
    },
}

/// Why a tare was refused. The zero stays as it was.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TareRefusal {
    /// The skin reads as touched.
    #[error(
        "the skin reads as touched ({level:.1} times its noise, most in channel {channel}): take the load off and call \
         again; where nothing touches it and its zero has drifted, set the parameter `tare_while_touched` first"
    )]
    Touched {
        /// Root mean square of the channels in units of their noise.
        level: f64,
        /// Channel with the strongest signal.
        channel: String,
    },
}

/// One frame after cleaning.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Conditioned {
    /// Readings in the unit of the skin before tare; NaN where invalid. This is what gets recorded.
    pub reading: Frame,
    /// The same less the zero; NaN where invalid and, before the first tare, everywhere.
    pub signal: Frame,
    /// Root mean square of the signal's channels in units of their noise; NaN before the first tare.
    pub level: f64,
    /// Whether something touches the skin, by level.
    pub touched: bool,
    /// The coarse image that was asked for ([`Conditioner::set_image`]); NaN throughout where the frame has none.
    pub image: Vec<f32>,
    /// The same less its zero; NaN where that is not known.
    pub image_signal: Vec<f32>,
}

/// Cleans the frames of one skin, in order.
#[derive(Debug, Clone)]
pub struct Conditioner {
    names: Vec<String>,
    noise: Vec<f64>,
    condition: Condition,
    health: Health,
    zero: ZeroTracker,
    /// What is made of the image of every frame.
    grid: Option<ImageGrid>,
    touched: bool,
    level: f64,
    /// Highest level of the contact that lasts.
    peak: f64,
    rest: Rest,
    /// Whether there was a contact since the zero was taken.
    contacted: bool,
    replaced: bool,
    strongest: Option<usize>,
}

impl Conditioner {
    /// Ready for the first frame; `masked` names channels that are to be left out.
    ///
    /// # Errors
    ///
    /// [`ConditionError::UnknownChannel`].
    pub fn new(skin: &SkinDescription, masked: &[String]) -> Result<Self, ConditionError> {
        let names: Vec<String> = skin.channels().iter().map(|c| c.name.clone()).collect();
        if let Some(name) = masked.iter().find(|m| !names.contains(m)) {
            return Err(ConditionError::UnknownChannel {
                name: name.clone(),
                skin: skin.name.clone(),
                known: listed(&names, 12),
            });
        }
        let masked: BTreeSet<&String> = masked.iter().collect();
        let masked = names.iter().map(|n| masked.contains(n)).collect();
        Ok(Self {
            noise: skin.channel_noise(),
            condition: skin.condition.clone(),
            health: Health::new(skin, masked),
            zero: ZeroTracker::new(skin),
            grid: None,
            touched: false,
            level: f64::NAN,
            peak: 0.0,
            rest: Rest::default(),
            contacted: false,
            replaced: false,
            strongest: None,
            names,
        })
    }

    /// Thresholds and times in use.
    #[must_use]
    pub fn condition(&self) -> &Condition {
        &self.condition
    }

    /// Uses other thresholds and times from the next frame on.
    pub fn set_condition(&mut self, condition: Condition) {
        self.zero.set_drift_time(condition.drift_time);
        self.zero.set_tare_duration(condition.tare_duration);
        self.condition = condition;
    }

    /// Makes a coarse image of every frame from the next one on, and keeps its zero; where the grid is another one than before,
    /// that zero is known after the next tare, or once untouched frames have come.
    pub fn set_image(&mut self, grid: Option<ImageGrid>) {
        if grid != self.grid {
            self.zero.set_image(grid.map_or(0, |grid| grid.numbers()));
            self.grid = grid;
        }
    }

    /// Flags the channels of a frame, subtracts the zero and decides whether the skin is touched. The zero itself
    /// is not moved: that is [`follow`](Self::follow), once it is known whether there is a contact.
    ///
    /// The frame has as many channels as the skin.
    ///
    /// # Errors
    ///
    /// [`ImageGridError`] where the frame's image is not one that the grid divides; the frame is taken without it.
    pub fn clean(&mut self, frame: &Frame, out: &mut Conditioned) -> Result<(), ImageGridError> {
        out.reading.clone_from(frame);
        out.reading.flags.resize(frame.values.len(), ChannelFlags::OK);
        self.health.flag(&mut out.reading, &self.condition);
        for (value, flags) in out.reading.values.iter_mut().zip(&out.reading.flags) {
            if flags.is_invalid() {
                *value = f32::NAN;
            }
        }
        out.signal.clone_from(&out.reading);
        self.zero.subtract(&mut out.signal);
        let before = (self.touched, self.peak);
        self.judge(&out.signal.values);
        if self.health.disown(&mut out.reading, &out.signal.values, &self.condition) {
            for (value, flags) in out.signal.values.iter_mut().zip(&out.reading.flags) {
                if flags.is_invalid() {
                    *value = f32::NAN;
                }
            }
            out.signal.flags.clone_from(&out.reading.flags);
            (self.touched, self.peak) = before;
            self.judge(&out.signal.values);
        }
        if self.came_to_rest(&out.reading) {
            // What hysteresis left behind is where untouched is now.
            self.zero.set_zero(&self.rest.mean);
            self.replaced = true;
            self.contacted = false;
            out.signal.clone_from(&out.reading);
            self.zero.subtract(&mut out.signal);
            self.judge(&out.signal.values);
        }
        out.level = self.level;
        out.touched = self.touched;
        self.look(frame, out)
    }

    /// Makes the coarse image of a frame.
    fn look(&self, frame: &Frame, out: &mut Conditioned) -> Result<(), ImageGridError> {
        let numbers = self.grid.map_or(0, |grid| grid.numbers());
        let seen = match (&self.grid, &frame.image) {
            (Some(grid), Some(image)) => grid.reduce(image, &mut out.image),
            _ => Ok(()),
        };
        if seen.is_err() || frame.image.is_none() || self.grid.is_none() {
            out.image.clear();
            out.image.resize(numbers, f32::NAN);
        }
        self.zero.subtract_image(&out.image, &mut out.image_signal);
        seen
    }

    fn judge(&mut self, signal: &[f32]) {
        let (mut sum, mut count, mut top) = (0.0, 0_u32, 0.0);
        self.strongest = None;
        for (i, (value, noise)) in signal.iter().zip(&self.noise).enumerate() {
            let z = f64::from(*value) / noise;
            if z.is_finite() {
                sum += z * z;
                count += 1;
                if z * z > top {
                    top = z * z;
                    self.strongest = Some(i);
                }
            }
        }
        self.level = if count == 0 { f64::NAN } else { (sum / f64::from(count)).sqrt() };
        let threshold = self.condition.contact_threshold * if self.touched { RELEASE } else { 1.0 };
        self.touched = self.level > threshold;
        self.peak = if self.touched { self.peak.max(self.level) } else { 0.0 };
    }

    /// Whether the signal, after a contact and far below its peak, has stood still for as long as a tare takes.
    fn came_to_rest(&mut self, reading: &Frame) -> bool {
        let share = self.condition.release_share;
        if share == 0.0 || !self.is_tared() {
            return false;
        }
        self.contacted |= self.touched;
        let still = self.rest.push(reading, &self.noise, self.condition.tare_duration);
        still && self.contacted && (!self.touched || self.level < share * self.peak)
    }

    /// Lets the zero follow the cleaned frame, unless something touches: by level, or because the model says so.
    pub fn follow(&mut self, cleaned: &Conditioned, model_says_touched: bool) {
        let averaging = self.zero.state() != TareState::Done;
        self.zero.push_with(&cleaned.reading, &cleaned.image, cleaned.touched || model_says_touched);
        self.replaced |= averaging && self.zero.state() == TareState::Done;
    }

    /// Whether another zero was taken since this was asked last: earlier signals are not comparable with later ones.
    pub fn zero_replaced(&mut self) -> bool {
        std::mem::take(&mut self.replaced)
    }

    /// Starts a tare; `even_if_touched` skips the check that nothing touches.
    ///
    /// # Errors
    ///
    /// [`TareRefusal::Touched`]; the zero stays as it was.
    pub fn begin_tare(&mut self, even_if_touched: bool) -> Result<(), TareRefusal> {
        if self.touched {
            if !even_if_touched {
                return Err(TareRefusal::Touched {
                    level: self.level,
                    channel: self.strongest.map_or_else(String::new, |i| self.names[i].clone()),
                });
            }
            // The zero that made it look touched is what is wrong: start from nothing.
            self.zero.reset();
            self.touched = false;
        }
        self.zero.begin_tare();
        Ok(())
    }

    /// Gives up a tare that has not ended; the zero before it stays.
    pub fn cancel_tare(&mut self) {
        self.zero.cancel_tare();
    }

    /// Where the tare stands.
    #[must_use]
    pub fn tare_state(&self) -> TareState {
        self.zero.state()
    }

    /// Whether there is a zero.
    #[must_use]
    pub fn is_tared(&self) -> bool {
        self.zero.zero().is_some()
    }

    /// Zero of every channel in the unit of the skin; `None` before the first tare.
    #[must_use]
    pub fn zero(&self) -> Option<&[f64]> {
        self.zero.zero()
    }

    /// Takes the readings as they are: for devices and recordings whose values are already relative to an
    /// untouched skin.
    pub fn set_zero(&mut self, zero: &[f64]) {
        self.zero.set_zero(zero);
    }

    /// Forgets every frame, and the zero.
    pub fn reset(&mut self) {
        self.health.reset();
        self.zero.reset();
        self.touched = false;
        self.level = f64::NAN;
        self.peak = 0.0;
        self.rest = Rest::default();
        self.contacted = false;
        self.strongest = None;
    }
}

/// Notices when the readings stand still.
#[derive(Debug, Clone, Default)]
struct Rest {
    since: Option<Stamp>,
    frames: u32,
    /// First reading of the rest, and mean of all of them; NaN for a channel without any.
    anchor: Vec<f64>,
    mean: Vec<f64>,
}

impl Rest {
    /// Whether the readings have stayed within a few noise deviations for `duration` \[s\], this one included.
    fn push(&mut self, reading: &Frame, noise: &[f64], duration: f64) -> bool {
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

/// At most `most` names, separated by commas.
pub(crate) fn listed<S: AsRef<str>>(names: &[S], most: usize) -> String {
    let mut text = names.iter().take(most).map(AsRef::as_ref).collect::<Vec<_>>().join(", ");
    if names.len() > most {
        text += &format!(" and {} more", names.len() - most);
    }
    text
}

/// Watches each channel for signs that its value says nothing.
#[derive(Debug, Clone)]
struct Health {
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
    fn new(skin: &SkinDescription, masked: Vec<bool>) -> Self {
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

    fn reset(&mut self) {
        for watch in &mut self.channels {
            watch.value = f32::NAN;
            watch.unchanged = 0;
            watch.ever_changed = false;
            watch.broken = false;
        }
        self.last = None;
    }

    /// Where channels are coupled: takes those for broken that stand at the end of their range while no other feels anything.
    /// At once, where no press could be felt by one alone so much; otherwise once it has stood still there. It is believed again as
    /// soon as it moves. Whether the frame has changed by this.
    fn disown(&mut self, reading: &mut Frame, signal: &[f32], condition: &Condition) -> bool {
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

    fn flag(&mut self, frame: &mut Frame, condition: &Condition) {
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
fn change_probability(step: f64) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Noise, skin_with};

    const RATE: f64 = 100.0;

    /// 2×2 pad, noise 20 Pa, range 50 to 110 kPa, 100 Hz.
    fn skin() -> SkinDescription {
        skin_with("")
    }

    struct Run {
        conditioner: Conditioner,
        noise: Noise,
        k: u64,
        out: Conditioned,
    }

    impl Run {
        fn new(skin: &SkinDescription, masked: &[String]) -> Self {
            Self {
                conditioner: Conditioner::new(skin, masked).unwrap(),
                noise: Noise::new(7),
                k: 0,
                out: Conditioned::default(),
            }
        }

        /// One frame: 101 325 Pa, noise, and `load` in Pa on top.
        fn push(&mut self, load: [f64; 4]) -> &Conditioned {
            let values = load.map(|l| (101_325.0 + l + 20.0 * self.noise.normal()) as f32);
            self.raw(values)
        }

        fn raw(&mut self, values: [f32; 4]) -> &Conditioned {
            let stamp = (self.k as f64 / RATE * 1e9) as Stamp;
            let frame = Frame::new(stamp, self.k, values.to_vec());
            self.k += 1;
            self.conditioner.clean(&frame, &mut self.out).unwrap();
            self.conditioner.follow(&self.out, false);
            &self.out
        }

        fn seconds(&mut self, seconds: f64, load: [f64; 4]) {
            for _ in 0..(seconds * RATE) as u64 {
                self.push(load);
            }
        }

        fn tared() -> Self {
            let mut run = Self::new(&skin(), &[]);
            run.seconds(1.0, [0.0; 4]);
            assert!(run.conditioner.is_tared(), "{:?}", run.conditioner.tare_state());
            run
        }
    }

    #[test]
    fn before_the_first_tare_nothing_looks_like_a_signal() {
        let mut run = Run::new(&skin(), &[]);
        let out = run.push([0.0; 4]);
        assert!(out.level.is_nan() && !out.touched);
        assert!(out.signal.values.iter().all(|v| v.is_nan()));
        assert!(
            out.reading.values.iter().all(|v| v.is_finite()),
            "readings are published before the tare too"
        );
    }

    #[test]
    fn a_touch_is_felt_and_released() {
        let mut run = Run::tared();
        assert!(!run.push([0.0; 4]).touched);
        let out = run.push([600.0, 0.0, 0.0, 0.0]);
        assert!(out.touched && (out.level - 15.0).abs() < 2.0, "{}", out.level);
        assert!((out.signal.values[0] - 600.0).abs() < 100.0);
        assert!(!run.push([0.0; 4]).touched);
    }

    #[test]
    fn the_threshold_has_hysteresis() {
        let mut run = Run::tared();
        // 3 noise deviations on all channels: between release (2.4) and threshold (4).
        assert!(!run.raw([101_385.0; 4]).touched);
        assert!(run.raw([101_525.0; 4]).touched);
        assert!(run.raw([101_385.0; 4]).touched);
        assert!(!run.raw([101_345.0; 4]).touched);
    }

    #[test]
    fn ten_minutes_of_standing_are_felt_to_the_end() {
        let mut run = Run::tared();
        let before = run.conditioner.zero().unwrap().to_vec();
        run.seconds(600.0, [300.0, 100.0, 50.0, 0.0]);
        let out = run.push([300.0, 100.0, 50.0, 0.0]).clone();
        assert!(out.touched && out.level > 5.0, "level {} after ten minutes", out.level);
        assert_eq!(run.conditioner.zero().unwrap(), before, "the zero moved under load");
        assert!(!run.push([0.0; 4]).touched);
    }

    #[test]
    fn slow_drift_is_followed_while_untouched() {
        let mut run = Run::tared();
        // 0.2 Pa/s: 120 Pa in ten minutes would be 6 noise deviations.
        for k in 0..60_000 {
            let drift = f64::from(k) / RATE * 0.2;
            assert!(!run.push([drift; 4]).touched, "drift taken for a touch after {k} frames");
        }
        let lag = 101_325.0 + 120.0 - run.conditioner.zero().unwrap()[0];
        assert!(
            (lag - 0.2 * 30.0).abs() < 5.0,
            "a first-order follower lags by rate × time constant, not {lag}"
        );
    }

    #[test]
    fn what_hysteresis_leaves_behind_is_the_new_zero_where_asked() {
        let left = [200.0, 200.0, 100.0, 100.0];
        for (share, released) in [(0.0, false), (0.5, true)] {
            let mut run = Run::new(&skin_with(&format!("condition = {{ release_share = {share:.1} }}")), &[]);
            run.seconds(1.0, [0.0; 4]);
            run.seconds(2.0, [4000.0, 2000.0, 1000.0, 1000.0]);
            assert!(run.out.touched, "a contact that stands still at its peak is one");
            run.seconds(0.3, left);
            assert!(run.out.touched, "0.3 s at rest are not enough");
            run.seconds(0.5, left);
            assert_eq!(!run.out.touched, released, "release_share {share}");
            if released {
                assert!(run.out.level < 2.0 && (run.conditioner.zero().unwrap()[0] - 101_525.0).abs() < 15.0);
                assert!(run.push([2000.0, 0.0, 0.0, 0.0]).touched, "the next press is felt");
            }
        }
        // What is left below the threshold counts too, as soon as it stands still.
        let mut run = Run::new(&skin_with("condition = { release_share = 0.5 }"), &[]);
        run.seconds(1.0, [0.0; 4]);
        run.seconds(1.0, [4000.0; 4]);
        run.seconds(0.8, [40.0; 4]);
        assert!((run.conditioner.zero().unwrap()[0] - 101_365.0).abs() < 15.0);
        // Sliding down is not standing still.
        let mut run = Run::new(&skin_with("condition = { release_share = 0.5 }"), &[]);
        run.seconds(1.0, [0.0; 4]);
        for k in (200..2000).rev() {
            run.push([4.0 * f64::from(k); 4]);
            assert!(run.out.touched);
        }
    }

    #[test]
    fn tare_is_refused_while_touched_and_says_why() {
        let mut run = Run::tared();
        run.push([0.0, 2000.0, 0.0, 0.0]);
        let zero = run.conditioner.zero().unwrap().to_vec();
        let refusal = run.conditioner.begin_tare(false).unwrap_err();
        assert!(refusal.to_string().contains("most in channel t1"), "{refusal}");
        assert_eq!(run.conditioner.zero().unwrap(), zero);
        // The zero has drifted and the caller knows that nothing touches.
        run.conditioner.begin_tare(true).unwrap();
        run.seconds(1.0, [0.0, 2000.0, 0.0, 0.0]);
        assert!(!run.push([0.0, 2000.0, 0.0, 0.0]).touched);
    }

    #[test]
    fn tare_moves_the_zero() {
        let mut run = Run::tared();
        run.conditioner.begin_tare(false).unwrap();
        run.seconds(1.0, [40.0; 4]);
        assert_eq!(run.conditioner.tare_state(), TareState::Done);
        assert!((run.conditioner.zero().unwrap()[2] - 101_365.0).abs() < 10.0);
    }

    #[test]
    fn nan_is_flagged_and_never_zero() {
        let mut run = Run::tared();
        let out = run.raw([101_325.0, f32::NAN, f32::INFINITY, 101_325.0]);
        assert_eq!(out.reading.flags[1], ChannelFlags::NOT_FINITE);
        assert_eq!(out.reading.flags[2], ChannelFlags::NOT_FINITE);
        assert!(out.reading.values[1].is_nan() && out.reading.values[2].is_nan());
        assert!(out.signal.values[1].is_nan());
        assert!(!out.touched && out.level < 2.0, "an invalid channel must not count: level {}", out.level);
        assert!(run.push([0.0; 4]).reading.flags[1].is_ok(), "a channel that is back is healthy");
    }

    #[test]
    fn the_end_of_the_range_is_saturation_and_keeps_its_value() {
        let mut run = Run::tared();
        let out = run.raw([110_000.0, 101_325.0, 101_330.0, 50_000.0]);
        assert_eq!(out.reading.flags[0], ChannelFlags::SATURATED);
        assert_eq!(out.reading.flags[3], ChannelFlags::SATURATED);
        assert!((f64::from(out.signal.values[0]) - 8675.0).abs() < 20.0);
        assert!(out.touched);
    }

    #[test]
    fn a_hard_press_at_the_rail_is_not_stuck() {
        let mut run = Run::tared();
        for _ in 0..6000 {
            let noise = run.noise.normal() as f32;
            let out = run.raw([110_000.0, 101_325.0 + noise, 101_325.0 - noise, 101_320.0 + noise]);
            assert_eq!(out.reading.flags[0], ChannelFlags::SATURATED);
        }
    }

    #[test]
    fn a_channel_that_fails_to_its_rail_is_no_contact_for_ever() {
        let mut run = Run::new(&skin_with("condition = { coupled = true }"), &[]);
        run.seconds(1.0, [0.0; 4]);
        let broken = |run: &mut Run, load: f64| {
            let mut noisy = || (101_325.0 + load + 20.0 * run.noise.normal()) as f32;
            let values = [110_000.0, noisy(), noisy(), noisy()];
            run.raw(values).clone()
        };
        for _ in 0..600 {
            let out = broken(&mut run, 0.0);
            assert!(!out.touched && out.signal.values[0].is_nan(), "no press is felt by one alone: {out:?}");
        }
        let out = broken(&mut run, 3000.0);
        assert!(out.reading.flags[0].contains(ChannelFlags::STUCK) && out.signal.values[0].is_nan());
        assert!(out.touched, "the others go on feeling");
        assert!(run.push([0.0; 4]).reading.flags[0].is_ok(), "it moves again");
        // A press that saturates one channel and is felt by another is a press for as long as it lasts.
        for _ in 0..2000 {
            let near = (101_725.0 + 20.0 * run.noise.normal()) as f32;
            let rest = [(); 2].map(|()| (101_325.0 + 20.0 * run.noise.normal()) as f32);
            let out = run.raw([110_000.0, near, rest[0], rest[1]]);
            assert!(out.touched && !out.reading.flags[0].is_invalid());
        }
    }

    /// Gauges whose zero wanders, leaned on for a minute.
    #[test]
    fn a_minute_of_contact_on_gauges_that_drift() {
        let gauges: Vec<String> = (0..10)
            .map(|i| format!("{{ name = \"g{i}\", position = [{:.3}, 0.0, 0.0] }}", f64::from(i) * 0.02))
            .collect();
        let skin = |condition: &str| {
            skin_with(&format!(
                "unit = \"1\"\nnoise = 3e-6\nrange = [-3e-3, 3e-3]\ncondition = {{ {condition} }}\ntaxels = [{}]",
                gauges.join(", ")
            ))
        };
        // [strain/s]: 1.5 and 6 noise deviations in a minute.
        for (drift, condition, ends) in [
            (7.5e-8, "drift_time = 10.0", true),
            (3e-7, "drift_time = 10.0", false),
            (3e-7, "drift_time = 10.0, release_share = 0.5", true),
        ] {
            let mut conditioner = Conditioner::new(&skin(condition), &[]).unwrap();
            let (mut noise, mut out, mut k) = (Noise::new(5), Conditioned::default(), 0_u64);
            let mut seconds = |conditioner: &mut Conditioner, seconds: f64, load: f64| {
                let mut every = true;
                let mut levels = Vec::new();
                for _ in 0..(seconds * RATE) as u64 {
                    let t = k as f64 / RATE;
                    let values = (0..10)
                        .map(|i| (drift * t + load / f64::from(1 + i) + 3e-6 * noise.normal()) as f32)
                        .collect();
                    conditioner.clean(&Frame::new((t * 1e9) as Stamp, k, values), &mut out).unwrap();
                    conditioner.follow(&out, false);
                    k += 1;
                    every &= out.touched;
                    levels.push(out.level);
                }
                (every, levels)
            };
            seconds(&mut conditioner, 30.0, 0.0);
            let zero = conditioner.zero().unwrap().to_vec();
            assert!((zero[0] - drift * 30.0).abs() < drift * 15.0, "the zero follows drift while untouched");
            let (felt, levels) = seconds(&mut conditioner, 60.0, 2e-4);
            assert!(felt, "drift {drift}: a contact of a minute is felt to its end");
            assert!(levels.last() > levels.first().map(|l| l * 0.9).as_ref(), "and does not fade");
            assert_eq!(conditioner.zero().unwrap(), zero, "the zero rests while something touches");
            let (still, _) = seconds(&mut conditioner, 5.0, 0.0);
            let (held, _) = seconds(&mut conditioner, 1.0, 0.0);
            assert!(!still || !ends, "drift {drift}: released");
            assert_eq!(!held, ends, "drift {drift} with {condition}");
        }
    }

    #[test]
    fn a_frozen_channel_is_stuck_and_one_that_never_moved_is_dead() {
        let mut run = Run::new(&skin(), &[]);
        let frame = |run: &mut Run, frozen: Option<f32>| {
            let mut v = [0.0; 4].map(|_: f64| (101_325.0 + 20.0 * run.noise.normal()) as f32);
            v[1] = 0.0;
            v[3] = 101_000.0;
            if let Some(value) = frozen {
                v[0] = value;
            }
            run.raw(v).reading.flags.clone()
        };
        for _ in 0..490 {
            let flags = frame(&mut run, None);
            assert!(flags[3].is_ok(), "5 s have not passed");
        }
        let mut flags = Vec::new();
        for _ in 0..600 {
            flags = frame(&mut run, Some(101_300.0));
        }
        assert_eq!(flags[0], ChannelFlags::STUCK);
        assert!(flags[1].contains(ChannelFlags::DEAD) && flags[1].contains(ChannelFlags::SATURATED));
        assert_eq!(flags[2], ChannelFlags::OK);
        assert_eq!(flags[3], ChannelFlags::DEAD);
        assert!(run.out.reading.values[0].is_nan() && run.out.reading.values[3].is_nan());
        assert!(frame(&mut run, None)[0].is_ok(), "it moves again");
    }

    #[test]
    fn coarse_quantisation_is_not_stuck() {
        // One count is 200 Pa, ten times the noise: an idle channel stands still for hours.
        let skin = skin_with("wire = { scale = 200.0 }");
        let mut run = Run::new(&skin, &[]);
        for _ in 0..20_000 {
            let out = run.raw([101_400.0, 101_200.0, 101_400.0, 101_600.0]);
            assert!(out.reading.flags.iter().all(|f| f.is_ok()), "{:?}", out.reading.flags);
        }
        // The same without a declared scale, as soon as one channel shows its step.
        let mut run = Run::new(&skin_with("noise = 0.05"), &[]);
        for k in 0..20_000_u32 {
            let moving = if k.is_multiple_of(97) { 60_001.0 } else { 60_000.0 };
            let out = run.raw([60_010.0, 60_007.0, moving, 60_020.0]);
            assert!(out.reading.flags.iter().all(|f| f.is_ok()), "{:?} after {k}", out.reading.flags);
        }
    }

    #[test]
    fn slow_devices_need_readings_as_well_as_time() {
        let mut run = Run::tared();
        let base = run.k;
        for k in 0..15 {
            // 1 Hz: 15 s without a change are 15 readings only.
            run.k = base + k * 100;
            let out = run.raw([101_300.0; 4]);
            assert!(out.reading.flags.iter().all(|f| f.is_ok()));
        }
    }

    #[test]
    fn stuck_time_zero_switches_the_check_off() {
        let mut run = Run::new(&skin_with("condition = { stuck_time = 0.0 }"), &[]);
        for _ in 0..2000 {
            assert!(run.raw([101_300.5; 4]).reading.flags.iter().all(|f| f.is_ok()));
        }
    }

    #[test]
    fn masked_channels_are_left_out() {
        let mut run = Run::new(&skin(), &["t2".into()]);
        run.seconds(1.0, [0.0; 4]);
        let out = run.push([0.0, 0.0, 1e4, 0.0]);
        assert_eq!(out.reading.flags[2], ChannelFlags::MASKED);
        assert!(out.signal.values[2].is_nan() && !out.touched);
        let error = Conditioner::new(&skin(), &["t9".into()]).unwrap_err().to_string();
        assert_eq!(error, "masked channel `t9` is none of skin `pad`; its channels are t0, t1, t2, t3");
    }

    #[test]
    fn flags_of_a_recording_stay() {
        let mut run = Run::tared();
        let mut frame = Frame::new((run.k as f64 / RATE * 1e9) as Stamp, run.k, vec![101_325.0; 4]);
        frame.values[1] = f32::NAN;
        frame.flags[1] = ChannelFlags::STUCK;
        run.conditioner.clean(&frame, &mut run.out).unwrap();
        assert_eq!(run.out.reading.flags[1], ChannelFlags::STUCK);
    }

    /// Recorded presses on a magnetic pad (eFlesh), each after a reading of the untouched pad.
    #[test]
    fn every_recorded_press_is_felt_and_ends() {
        let data = std::env::var("DERMIS_DATA")
            .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data").into());
        let runs = std::path::Path::new(&data).join("eflesh/spatial_resolution");
        let Ok(runs) = std::fs::read_dir(&runs) else {
            println!("skipped: {} is not there", runs.display());
            return;
        };
        let skin = SkinDescription::from_toml(
            include_str!("../../../launch/skins/eflesh.toml"),
            "launch/skins/eflesh.toml",
        )
        .unwrap();
        let read = |path: std::path::PathBuf| -> Vec<Vec<f64>> {
            let text = std::fs::read_to_string(path).unwrap();
            text.lines().map(|l| l.split(',').map(|n| n.trim().parse().unwrap()).collect()).collect()
        };
        for run in runs {
            let run = run.unwrap().path();
            let readings = read(run.join("sensor.csv"));
            let signals = read(run.join("sensor_post_baselines.csv"));
            let mut conditioner = Conditioner::new(&skin, &[]).unwrap();
            let mut out = Conditioned::default();
            let (mut k, mut felt, mut ended, mut worst) = (0, 0, 0, 0.0_f64);
            for (reading, signal) in readings.iter().zip(&signals) {
                let stamp = (reading[0] * 1e9) as Stamp;
                let tesla = |v: &[f64]| v.iter().map(|v| (v * 1e-6) as f32).collect::<Vec<f32>>();
                let untouched: Vec<f64> = reading[1..].iter().zip(&signal[1..]).map(|(r, s)| r - s).collect();
                for before in (0..=8).rev() {
                    let values = tesla(if before > 0 { &untouched } else { &reading[1..] });
                    let frame = Frame::new(stamp - before * 100_000_000, k, values);
                    k += 1;
                    conditioner.clean(&frame, &mut out).unwrap();
                    conditioner.follow(&out, false);
                    if before == 1 {
                        ended += usize::from(!out.touched);
                        worst = worst.max(out.level);
                    }
                }
                felt += usize::from(out.touched);
            }
            let presses = readings.len();
            assert_eq!(presses, 4805, "{}", run.display());
            println!("{}: {felt} felt, {ended} ended, worst rest {worst:.2}", run.display());
            assert!(felt + 2 >= presses, "{felt} of {presses} presses felt in {}", run.display());
            assert!(ended + 5 >= presses, "{ended} of {presses} presses ended in {}", run.display());
        }
    }

    #[test]
    fn the_change_probability_is_that_of_a_normal_distribution() {
        assert!((change_probability(0.0) - 1.0).abs() < 1e-6);
        assert!((change_probability(2.0) - 0.317_31).abs() < 1e-5);
        assert!((change_probability(4.0) - 0.045_50).abs() < 1e-5);
    }
}
