//! Cleaning: channel health, zero, and whether the skin is touched.

use std::collections::BTreeSet;

use dermis_skin::{
    ChannelFlags, Condition, Frame, ImageGrid, ImageGridError, SkinDescription, TareState, ZeroTracker,
};

use crate::finder::ConditionedFrame;

mod health;
mod rest;
#[cfg(test)]
mod tests;

use health::Health;
use rest::Rest;

/// A contact ends below this share of the level at which it begins, so that noise does not make it flicker.
const RELEASE: f64 = 0.6;

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
    /// The coarse image that was requested ([`Conditioner::set_image`]); NaN throughout where the frame has none.
    pub image: Vec<f32>,
    /// The same less its zero; NaN where that is not known.
    pub image_signal: Vec<f32>,
}

impl Conditioned {
    /// As models and finders take it.
    #[must_use]
    pub fn frame(&self) -> ConditionedFrame<'_> {
        ConditionedFrame {
            stamp: self.reading.stamp,
            reading: &self.reading.values,
            signal: &self.signal.values,
            flags: &self.signal.flags,
            image: &self.image,
            image_signal: &self.image_signal,
        }
    }
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
    /// Channels of parts that are out of order.
    broken: Vec<usize>,
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
            broken: Vec::new(),
            names,
        })
    }

    /// Takes these channels for dead from the next frame on, until others are set: a part of the device is out of order. Channels
    /// that the skin does not have are left out.
    pub fn set_broken(&mut self, channels: impl IntoIterator<Item = usize>) {
        self.broken.clear();
        self.broken.extend(channels.into_iter().filter(|channel| *channel < self.names.len()));
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
        for &channel in &self.broken {
            out.reading.flags[channel] |= ChannelFlags::DEAD;
        }
        self.health.flag(&mut out.reading, &self.condition);
        for (value, flags) in out.reading.values.iter_mut().zip(&out.reading.flags) {
            if flags.is_invalid() {
                *value = f32::NAN;
            }
        }
        out.signal.clone_from(&out.reading);
        self.zero.subtract(&mut out.signal);
        let before = (self.touched, self.peak);
        self.detect_touch(&out.signal.values);
        if self.health.disown(&mut out.reading, &out.signal.values, &self.condition) {
            for (value, flags) in out.signal.values.iter_mut().zip(&out.reading.flags) {
                if flags.is_invalid() {
                    *value = f32::NAN;
                }
            }
            out.signal.flags.clone_from(&out.reading.flags);
            (self.touched, self.peak) = before;
            self.detect_touch(&out.signal.values);
        }
        if self.came_to_rest(&out.reading) {
            // What hysteresis left behind is where untouched is now.
            self.zero.set_zero(&self.rest.mean);
            self.replaced = true;
            self.contacted = false;
            out.signal.clone_from(&out.reading);
            self.zero.subtract(&mut out.signal);
            self.detect_touch(&out.signal.values);
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

    fn detect_touch(&mut self, signal: &[f32]) {
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

    /// Whether another zero was taken since the last call: earlier signals are not comparable with later ones.
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

/// At most `most` names, separated by commas.
pub(crate) fn listed<S: AsRef<str>>(names: &[S], most: usize) -> String {
    let mut text = names.iter().take(most).map(AsRef::as_ref).collect::<Vec<_>>().join(", ");
    if names.len() > most {
        text += &format!(" and {} more", names.len() - most);
    }
    text
}
