//! Conditioned frames → the model's input.

use std::collections::VecDeque;

use dermis_skin::ImageGrid;
use serde::{Deserialize, Serialize};

/// Most frames that the history keeps, so that a device which sends too fast cannot fill the memory.
const MOST_FRAMES: usize = 1 << 14;

/// Which past frames the model sees besides the newest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Taps {
    /// Delays in frames; 0 is the newest.
    Frames(Vec<u32>),
    /// Delays \[s\] before the newest frame; readings are interpolated linearly between acquisition times.
    Seconds(Vec<f64>),
}

impl Default for Taps {
    fn default() -> Self {
        Self::Frames(vec![0])
    }
}

impl Taps {
    fn len(&self) -> usize {
        match self {
            Self::Frames(d) => d.len(),
            Self::Seconds(d) => d.len(),
        }
    }
}

/// What stands in for a channel that has no valid reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Missing {
    /// The mean of the training data: 0 after normalisation.
    #[default]
    Mean,
    /// The mean, and one more input per channel that is 1 where the newest reading is valid and 0 where not.
    Mask,
}

/// How frames become an input. Serialised in the `[input]` table of a bundle's manifest.
///
/// Where `image` is given, the numbers of a coarse image of the skin's camera stand in the place of channels: `C` is their
/// number, they lie plane by plane and row by row, and their unit is the full scale of a pixel.
///
/// With `C` channels and `z = (x − mean) / scale`, the input is, in this order and each part in channel order:
///
/// 1. for every tap, `C` values `z(t − delay)`;
/// 2. for every entry of `low_pass`, `C` values of `z` behind a first-order low-pass of that time constant:
///    the slow part of hysteresis and drift;
/// 3. for every entry of `difference`, `C` values `z(t) − z(t − T)`: the mean rate over `T`, times `T`;
/// 4. with [`Missing::Mask`], `C` values 1 (valid) or 0 (missing).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FeatureConfig {
    /// Subtracted from each channel, in the unit of the skin.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mean: Vec<f32>,
    /// Each channel is divided by it after that, in the unit of the skin; positive.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scale: Vec<f32>,
    /// Frames that the model sees.
    #[serde(default)]
    pub taps: Taps,
    /// \[s\] time constants of low-passed copies.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub low_pass: Vec<f64>,
    /// \[s\] spans of differences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub difference: Vec<f64>,
    /// What stands in for an invalid channel.
    #[serde(default)]
    pub missing: Missing,
    /// \[s\] without a frame after which history starts anew.
    #[serde(default = "half_second")]
    pub max_gap: f64,
    /// The image that the model sees in place of the channels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image: Option<ImageGrid>,
}

fn half_second() -> f64 {
    0.5
}

impl FeatureConfig {
    /// The newest frame only, normalised with `mean` and `scale` (unit of the skin).
    #[must_use]
    pub fn newest(mean: Vec<f32>, scale: Vec<f32>) -> Self {
        Self {
            mean,
            scale,
            taps: Taps::default(),
            low_pass: Vec::new(),
            difference: Vec::new(),
            missing: Missing::Mean,
            max_gap: half_second(),
            image: None,
        }
    }

    /// Of no model: what stands where there is none.
    #[must_use]
    pub fn none() -> Self {
        Self::newest(Vec::new(), Vec::new())
    }

    /// Whether it is [`none`](Self::none).
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::none()
    }

    /// Number of channels, or of the numbers of an image.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.mean.len()
    }

    /// Length of the input.
    #[must_use]
    pub fn input_len(&self) -> usize {
        let blocks = self.taps.len()
            + self.low_pass.len()
            + self.difference.len()
            + usize::from(self.missing == Missing::Mask);
        blocks * self.channels()
    }

    /// Says what is impossible.
    ///
    /// # Errors
    ///
    /// [`FeatureError::Impossible`] names the field.
    pub fn validate(&self) -> Result<(), FeatureError> {
        let wrong = |field: String, reason: String| Err(FeatureError::Impossible { field, reason });
        if self.mean.is_empty() {
            return wrong("mean".into(), "is empty: a skin has at least one channel".into());
        }
        if self.scale.len() != self.mean.len() {
            return wrong(
                "scale".into(),
                format!("has {} entries where `mean` has {}", self.scale.len(), self.mean.len()),
            );
        }
        if let Some(i) = self.mean.iter().position(|m| !m.is_finite()) {
            return wrong(format!("mean[{i}]"), "must be a finite number".into());
        }
        if let Some(i) = self.scale.iter().position(|s| !(s.is_normal() && *s > 0.0)) {
            return wrong(format!("scale[{i}]"), format!("is {} and must be positive", self.scale[i]));
        }
        if let Some(grid) = &self.image {
            if !(1..=ImageGrid::MOST).contains(&grid.numbers()) {
                return wrong(
                    "image".into(),
                    format!("has {} numbers and must have 1 to {}", grid.numbers(), ImageGrid::MOST),
                );
            }
            if grid.numbers() != self.mean.len() {
                return wrong(
                    "mean".into(),
                    format!("has {} entries where `image` has {} numbers", self.mean.len(), grid.numbers()),
                );
            }
            if self.missing == Missing::Mask {
                return wrong(
                    "missing".into(),
                    "must be \"mean\": an image is there as a whole or not at all".into(),
                );
            }
        }
        if self.taps.len() == 0 && self.low_pass.is_empty() {
            return wrong("taps".into(), "is empty: the model would see no reading".into());
        }
        match &self.taps {
            Taps::Frames(delays) => {
                if let Some(i) = delays.iter().position(|d| *d as usize >= MOST_FRAMES) {
                    return wrong(
                        format!("taps.frames[{i}]"),
                        format!("is {} and must be below {MOST_FRAMES}", delays[i]),
                    );
                }
            }
            Taps::Seconds(delays) => {
                if let Some(i) = delays.iter().position(|d| !(0.0..=60.0).contains(d)) {
                    return wrong(
                        format!("taps.seconds[{i}]"),
                        format!("is {} and must lie between 0 and 60 s", delays[i]),
                    );
                }
            }
        }
        if let Some(i) = self.low_pass.iter().position(|t| !(t.is_finite() && *t > 0.0)) {
            return wrong(format!("low_pass[{i}]"), "must be a positive number of seconds".into());
        }
        if let Some(i) = self.difference.iter().position(|t| !(*t > 0.0 && *t <= 60.0)) {
            return wrong(format!("difference[{i}]"), "must lie above 0 and at most at 60 s".into());
        }
        if !(self.max_gap.is_finite() && self.max_gap > 0.0) {
            return wrong("max_gap".into(), "must be a positive number of seconds".into());
        }
        Ok(())
    }
}

/// A frame or a configuration that gives no input.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FeatureError {
    /// The configuration contradicts itself.
    #[error("field `{field}`: {reason}")]
    Impossible {
        /// Path of the field below `[input]`.
        field: String,
        /// Why it cannot be, and what would be right.
        reason: String,
    },
    /// A frame has another number of channels than the model was trained on.
    #[error(
        "a frame has {got} channels where the model was trained on {expected}; check the skin description"
    )]
    ChannelCount {
        /// Channels of the frame.
        got: usize,
        /// Channels of the model.
        expected: usize,
    },
}

struct Past {
    stamp: i64,
    /// Normalised; NaN where invalid.
    values: Vec<f32>,
}

/// Turns a stream of conditioned frames into inputs of the model.
///
/// ```
/// use dermis_inference::{FeatureConfig, Features};
///
/// let mut features = Features::new(FeatureConfig::newest(vec![10.0, 0.0], vec![2.0, 1.0]))?;
/// features.push(0, &[14.0, f32::NAN])?;
/// assert_eq!(features.input(), Some(&[2.0, 0.0][..]));
/// # Ok::<(), dermis_inference::FeatureError>(())
/// ```
pub struct Features {
    config: FeatureConfig,
    /// Newest last.
    history: VecDeque<Past>,
    /// Frames taken out of the history, kept for their memory.
    spare: Vec<Vec<f32>>,
    /// One per low-pass: its state, NaN before the first valid reading.
    slow: Vec<Vec<f32>>,
    input: Vec<f32>,
    ready: bool,
    /// How far back the history must reach: frames before the newest.
    frames_back: usize,
    /// How far back the history must reach \[ns\].
    nanos_back: i64,
    max_gap: i64,
}

impl Features {
    /// Ready for the first frame.
    ///
    /// # Errors
    ///
    /// As [`FeatureConfig::validate`].
    pub fn new(config: FeatureConfig) -> Result<Self, FeatureError> {
        config.validate()?;
        Ok(Self::of_valid(config))
    }

    /// The newest frame of so many channels, as it was read.
    #[must_use]
    pub fn as_read(channels: usize) -> Self {
        Self::of_valid(FeatureConfig::newest(vec![0.0; channels], vec![1.0; channels]))
    }

    pub(crate) fn of_valid(config: FeatureConfig) -> Self {
        let mut nanos_back = config.difference.iter().copied().map(nanos).max().unwrap_or(0);
        let mut frames_back = 0;
        match &config.taps {
            Taps::Frames(delays) => frames_back = delays.iter().max().map_or(0, |d| *d as usize),
            Taps::Seconds(delays) => {
                nanos_back = nanos_back.max(delays.iter().copied().map(nanos).max().unwrap_or(0));
            }
        }
        let channels = config.channels();
        Self {
            history: VecDeque::new(),
            spare: Vec::new(),
            slow: vec![vec![f32::NAN; channels]; config.low_pass.len()],
            input: vec![0.0; config.input_len()],
            ready: false,
            frames_back,
            nanos_back,
            max_gap: nanos(config.max_gap),
            config,
        }
    }

    /// The configuration.
    #[must_use]
    pub fn config(&self) -> &FeatureConfig {
        &self.config
    }

    /// Forgets every frame.
    pub fn reset(&mut self) {
        while let Some(past) = self.history.pop_front() {
            self.spare.push(past.values);
        }
        for state in &mut self.slow {
            state.fill(f32::NAN);
        }
        self.ready = false;
    }

    /// Takes one frame: when it was acquired \[ns\], and one value per channel in the unit of the skin, NaN
    /// (or infinite) where invalid.
    ///
    /// A gap longer than `max_gap`, or a stamp that goes back (a replay that starts again), restarts the
    /// history; a frame with the stamp of the one before replaces it.
    ///
    /// # Errors
    ///
    /// [`FeatureError::ChannelCount`]; the frame is then ignored.
    pub fn push(&mut self, stamp: i64, values: &[f32]) -> Result<(), FeatureError> {
        if values.len() != self.config.channels() {
            return Err(FeatureError::ChannelCount { got: values.len(), expected: self.config.channels() });
        }
        let mut elapsed = 0;
        if let Some(last) = self.history.back() {
            let step = stamp.saturating_sub(last.stamp);
            if step < 0 || step > self.max_gap {
                self.reset();
            } else if step == 0 {
                if let Some(past) = self.history.pop_back() {
                    self.spare.push(past.values);
                }
            } else {
                elapsed = step;
            }
        }
        let mut z = self.spare.pop().unwrap_or_default();
        z.clear();
        z.extend(values.iter().zip(&self.config.mean).zip(&self.config.scale).map(|((x, mean), scale)| {
            let z = (x - mean) / scale;
            if z.is_finite() { z } else { f32::NAN }
        }));
        for (state, time_constant) in self.slow.iter_mut().zip(&self.config.low_pass) {
            let weight = (1.0 - (-(elapsed as f64) * 1e-9 / time_constant).exp()) as f32;
            for (y, z) in state.iter_mut().zip(&z) {
                if y.is_nan() {
                    *y = *z;
                } else if !z.is_nan() {
                    *y += weight * (z - *y);
                }
            }
        }
        let seen = z.iter().any(|z| !z.is_nan());
        self.history.push_back(Past { stamp, values: z });
        self.forget(stamp);
        self.ready = seen && self.reaches_back(stamp);
        if self.ready {
            self.fill(stamp);
        }
        Ok(())
    }

    /// The input for the newest frame, of length [`FeatureConfig::input_len`]; finite everywhere. `None` while
    /// the history does not reach back far enough, and where no channel of the newest frame is valid.
    #[must_use]
    pub fn input(&self) -> Option<&[f32]> {
        self.ready.then_some(self.input.as_slice())
    }

    /// Drops frames that no tap can reach any more. One frame older than the longest delay stays, to
    /// interpolate from.
    fn forget(&mut self, now: i64) {
        let horizon = now.saturating_sub(self.nanos_back);
        while self.history.len() > self.frames_back + 1
            && (self.history.get(1).is_some_and(|second| second.stamp <= horizon)
                || self.history.len() > MOST_FRAMES)
        {
            if let Some(past) = self.history.pop_front() {
                self.spare.push(past.values);
            }
        }
    }

    fn reaches_back(&self, now: i64) -> bool {
        self.history.len() > self.frames_back
            && self.history.front().is_some_and(|oldest| {
                now.saturating_sub(oldest.stamp) >= self.nanos_back || self.history.len() >= MOST_FRAMES
            })
    }

    fn fill(&mut self, now: i64) {
        let channels = self.config.channels();
        let mut blocks = self.input.chunks_exact_mut(channels);
        let newest = self.history.len() - 1;
        match &self.config.taps {
            Taps::Frames(delays) => {
                for (delay, block) in delays.iter().zip(blocks.by_ref()) {
                    let past = &self.history[newest - *delay as usize].values;
                    for (out, z) in block.iter_mut().zip(past) {
                        *out = or_mean(*z);
                    }
                }
            }
            Taps::Seconds(delays) => {
                for (delay, block) in delays.iter().zip(blocks.by_ref()) {
                    let at = Between::find(&self.history, now.saturating_sub(nanos(*delay)));
                    for (channel, out) in block.iter_mut().enumerate() {
                        *out = or_mean(at.value(channel));
                    }
                }
            }
        }
        for (state, block) in self.slow.iter().zip(blocks.by_ref()) {
            for (out, y) in block.iter_mut().zip(state) {
                *out = or_mean(*y);
            }
        }
        for (span, block) in self.config.difference.iter().zip(blocks.by_ref()) {
            let before = Between::find(&self.history, now.saturating_sub(nanos(*span)));
            for (channel, out) in block.iter_mut().enumerate() {
                *out = or_mean(self.history[newest].values[channel] - before.value(channel));
            }
        }
        if self.config.missing == Missing::Mask
            && let Some(block) = blocks.next()
        {
            for (out, z) in block.iter_mut().zip(&self.history[newest].values) {
                *out = if z.is_nan() { 0.0 } else { 1.0 };
            }
        }
    }
}

/// The two frames around an instant, and where it lies between them.
struct Between<'a> {
    before: &'a [f32],
    after: &'a [f32],
    fraction: f32,
}

impl<'a> Between<'a> {
    /// `history` holds at least one frame; an instant outside of it is held at its end.
    fn find(history: &'a VecDeque<Past>, instant: i64) -> Self {
        let last = history.len() - 1;
        let after = history.partition_point(|past| past.stamp < instant).min(last);
        let before = after.saturating_sub(1);
        let (a, b) = (&history[before], &history[after]);
        let fraction = if instant >= b.stamp || before == after {
            1.0
        } else {
            ((instant - a.stamp).max(0) as f64 / (b.stamp - a.stamp) as f64) as f32
        };
        Self { before: &a.values, after: &b.values, fraction }
    }

    /// NaN where neither frame has a reading; the one reading where only one has.
    fn value(&self, channel: usize) -> f32 {
        let (a, b) = (self.before[channel], self.after[channel]);
        if self.fraction >= 1.0 && !b.is_nan() || a.is_nan() {
            b
        } else if b.is_nan() {
            a
        } else {
            a + self.fraction * (b - a)
        }
    }
}

fn or_mean(z: f32) -> f32 {
    if z.is_finite() { z } else { 0.0 }
}

fn nanos(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

#[cfg(test)]
mod tests;
