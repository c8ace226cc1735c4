//! Zero of every channel: taring, and following slow drift while the skin is not touched.
//!
//! Two things that look alike are kept apart here. A *tare* averages readings that are known to be untouched. *Drift
//! tracking* lets that average follow temperature and ageing, but only while nothing touches: with a plain
//! high-pass a foot that stands for a minute feels nothing.

use crate::{Frame, SkinDescription, Stamp};

/// Fewest frames that a tare averages, however short its duration and however slow the device.
const FEWEST_FRAMES: u32 = 3;
/// Spread of an untouched channel, root mean square over the channels, in units of its noise: more means that
/// something moves. Twice the noise leaves room for a data sheet that flatters.
const QUIET_SPREAD: f64 = 2.5;
/// \[s\] after a contact during which the medium still relaxes: the zero does not follow that.
const SETTLE: f64 = 1.0;
/// \[s\] longest step that drift tracking believes: a gap in the stream says nothing about the zero.
const LONGEST_STEP: f64 = 1.0;

/// Where a tare stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TareState {
    /// Averaging; never had a zero, or a new one was requested.
    Averaging {
        /// \[s\] of untouched readings so far.
        elapsed: f64,
        /// Why the last attempt was thrown away: spread of the channels in units of their noise.
        disturbed: Option<f64>,
    },
    /// The zero is known.
    Done,
}

/// Keeps the zero of every channel.
///
/// Training and running code both feed their frames through this struct, so that a model sees in operation what
/// it saw in training: `value − zero`, where zero is the mean of untouched readings.
///
/// ```
/// # use dermis_skin::{SkinDescription, Frame, ZeroTracker};
/// # let skin = SkinDescription::from_toml(r#"
/// # schema = "dermis-skin/1"
/// # name = "pad"
/// # sensor = "taxels"
/// # frame_id = "pad_link"
/// # unit = "Pa"
/// # rate = 100.0
/// # noise = 20.0
/// # surface = { type = "rectangle", size = [0.02, 0.01], spacing = 0.005 }
/// # taxels = [{ name = "t0", position = [0.0, 0.0, -0.005] }]
/// # "#, "pad.toml")?;
/// let mut zero = ZeroTracker::new(&skin);
/// for k in 0..60_u64 {
///     zero.push(&Frame::new(k as i64 * 10_000_000, k, vec![101_325.0]), false);
/// }
/// let mut pressed = Frame::new(600_000_000, 60, vec![102_325.0]);
/// zero.push(&pressed, true);
/// zero.subtract(&mut pressed);
/// assert_eq!(pressed.values, [1000.0]);
/// # Ok::<(), dermis_skin::SkinError>(())
/// ```
#[derive(Debug, Clone)]
pub struct ZeroTracker {
    noise: Vec<f64>,
    tare_duration: f64,
    drift_time: f64,
    trust_labels: bool,
    /// Zeros of the channels, and behind them those of the numbers of an image. NaN where unknown. Only meaningful while
    /// `known`.
    zero: Vec<f64>,
    /// Readings behind each zero, up to as many as a tare averages.
    weight: Vec<u32>,
    known: bool,
    window: Window,
    averaging: bool,
    disturbed: Option<f64>,
    last: Option<Stamp>,
    last_touch: Option<Stamp>,
}

/// Running mean and sum of squared deviations of every channel (Welford).
#[derive(Debug, Clone, Default)]
struct Window {
    start: Option<Stamp>,
    frames: u32,
    count: Vec<u32>,
    mean: Vec<f64>,
    squares: Vec<f64>,
}

impl Window {
    fn clear(&mut self, channels: usize) {
        self.start = None;
        self.frames = 0;
        for v in [&mut self.mean, &mut self.squares] {
            v.clear();
            v.resize(channels, 0.0);
        }
        self.count.clear();
        self.count.resize(channels, 0);
    }

    fn push(&mut self, frame: &Frame, image: &[f32]) {
        self.start.get_or_insert(frame.stamp);
        self.frames += 1;
        for (i, value) in usable(frame, image) {
            self.count[i] += 1;
            let delta = value - self.mean[i];
            self.mean[i] += delta / f64::from(self.count[i]);
            self.squares[i] += delta * (value - self.mean[i]);
        }
    }

    /// Root mean square over the channels of their standard deviation in units of their noise.
    fn spread(&self, noise: &[f64]) -> f64 {
        let (mut sum, mut channels) = (0.0, 0_u32);
        for ((n, squares), noise) in self.count.iter().zip(&self.squares).zip(noise) {
            if *n >= 2 {
                sum += squares / f64::from(n - 1) / (noise * noise);
                channels += 1;
            }
        }
        if channels == 0 { 0.0 } else { (sum / f64::from(channels)).sqrt() }
    }
}

/// Numbers of a frame that may move the zero: finite, and of healthy channels; those of its image come after the channels.
fn usable<'a>(frame: &'a Frame, image: &'a [f32]) -> impl Iterator<Item = (usize, f64)> + 'a {
    let healthy = frame.values.iter().zip(&frame.flags).map(|(v, f)| if f.is_ok() { *v } else { f32::NAN });
    let all = healthy.chain(image.iter().copied()).enumerate();
    all.filter(|(_, v)| v.is_finite()).map(|(i, v)| (i, f64::from(v)))
}

impl ZeroTracker {
    /// A tracker that starts with a tare: the first `condition.tare_duration` of quiet, untouched readings.
    #[must_use]
    pub fn new(skin: &SkinDescription) -> Self {
        let noise = skin.channel_noise();
        let channels = noise.len();
        let mut window = Window::default();
        window.clear(channels);
        Self {
            noise,
            tare_duration: skin.condition.tare_duration,
            drift_time: skin.condition.drift_time,
            trust_labels: false,
            zero: vec![f64::NAN; channels],
            weight: vec![0; channels],
            known: false,
            window,
            averaging: true,
            disturbed: None,
            last: None,
            last_touch: None,
        }
    }

    /// A tracker for labelled recordings: `touched` is ground truth, so that readings need not look quiet to be
    /// averaged.
    #[must_use]
    pub fn labelled(skin: &SkinDescription) -> Self {
        Self { trust_labels: true, ..Self::new(skin) }
    }

    /// Has it keep the zero of an image of so many numbers as well, which is taken from the same frames as that of the
    /// channels. Whether the skin is quiet follows from the channels alone.
    ///
    /// A zero of another image is forgotten.
    pub fn set_image(&mut self, numbers: usize) {
        let channels = self.noise.len();
        self.zero.truncate(channels);
        self.weight.truncate(channels);
        self.zero.resize(channels + numbers, f64::NAN);
        self.weight.resize(channels + numbers, 0);
        self.window.clear(channels + numbers);
    }

    /// \[s\] with which the zero follows drift from now on.
    pub fn set_drift_time(&mut self, seconds: f64) {
        if seconds.is_finite() && seconds > 0.0 {
            self.drift_time = seconds;
        }
    }

    /// \[s\] of untouched readings that the next tare averages.
    pub fn set_tare_duration(&mut self, seconds: f64) {
        if seconds.is_finite() && seconds > 0.0 {
            self.tare_duration = seconds;
        }
    }

    /// Takes the next frame. While `touched`, the zero stands still.
    ///
    /// A frame with another number of channels is ignored.
    pub fn push(&mut self, frame: &Frame, touched: bool) {
        self.push_with(frame, &[], touched);
    }

    /// Takes the next frame and the numbers of its image: none where it has none, NaN where one is unknown.
    ///
    /// A frame with another number of channels is ignored; numbers beyond those that the image has are, too.
    pub fn push_with(&mut self, frame: &Frame, image: &[f32], touched: bool) {
        if frame.values.len() != self.noise.len() || frame.flags.len() != self.noise.len() {
            return;
        }
        let image = &image[..image.len().min(self.zero.len() - self.noise.len())];
        let step = self.last.map_or(0.0, |last| seconds(last, frame.stamp)).clamp(0.0, LONGEST_STEP);
        self.last = Some(frame.stamp);
        if touched {
            self.last_touch = Some(frame.stamp);
            self.window.clear(self.zero.len());
            return;
        }
        if self.averaging {
            self.average(frame, image);
        } else {
            self.follow((frame, image), step);
        }
    }

    fn average(&mut self, frame: &Frame, image: &[f32]) {
        // A clock that jumped back, e.g. a recording that starts over, must not hold up the tare.
        if self.window.start.is_some_and(|start| frame.stamp < start) {
            self.window.clear(self.zero.len());
        }
        self.window.push(frame, image);
        if self.elapsed() < self.tare_duration || self.window.frames < FEWEST_FRAMES {
            return;
        }
        let spread = self.window.spread(&self.noise);
        if !self.trust_labels && spread > QUIET_SPREAD {
            self.disturbed = Some(spread);
            self.window.clear(self.zero.len());
            return;
        }
        for (i, n) in self.window.count.iter().enumerate() {
            self.zero[i] = if *n > 0 { self.window.mean[i] } else { f64::NAN };
            self.weight[i] = *n;
        }
        self.known = true;
        self.averaging = false;
        self.disturbed = None;
        self.window.clear(self.zero.len());
    }

    fn follow(&mut self, (frame, image): (&Frame, &[f32]), step: f64) {
        if self.last_touch.is_some_and(|t| (0.0..SETTLE).contains(&seconds(t, frame.stamp))) {
            return;
        }
        let drift = 1.0 - (-step / self.drift_time).exp();
        for (i, value) in usable(frame, image) {
            // A channel that came back after the tare gets its zero as quickly as a tare would give it.
            let share = drift.max(1.0 / f64::from(self.weight[i] + 1));
            if self.zero[i].is_nan() {
                self.zero[i] = value;
                self.weight[i] = 1;
            } else if self.weight[i] < FEWEST_FRAMES {
                self.zero[i] += share * (value - self.zero[i]);
                self.weight[i] += 1;
            } else {
                self.zero[i] += drift * (value - self.zero[i]);
            }
        }
    }

    fn elapsed(&self) -> f64 {
        match (self.window.start, self.last) {
            (Some(start), Some(last)) => seconds(start, last),
            _ => 0.0,
        }
    }

    /// Asks for a new tare from the frames that follow. The old zero stays in use until it is done.
    pub fn begin_tare(&mut self) {
        self.averaging = true;
        self.disturbed = None;
        self.window.clear(self.zero.len());
    }

    /// Gives up a requested tare; the zero before it stays. Without one the tracker keeps averaging.
    pub fn cancel_tare(&mut self) {
        self.averaging = !self.known;
        self.window.clear(self.zero.len());
    }

    /// Where the tare stands.
    #[must_use]
    pub fn state(&self) -> TareState {
        if self.averaging {
            TareState::Averaging { elapsed: self.elapsed(), disturbed: self.disturbed }
        } else {
            TareState::Done
        }
    }

    /// Zero of every channel in the unit of the skin, NaN for a channel that never gave a usable reading; `None`
    /// before the first tare is done.
    #[must_use]
    pub fn zero(&self) -> Option<&[f64]> {
        self.known.then(|| &self.zero[..self.noise.len()])
    }

    /// Zero of every number of the image, NaN where none is known yet; `None` before the first tare is done.
    #[must_use]
    pub fn image_zero(&self) -> Option<&[f64]> {
        self.known.then(|| &self.zero[self.noise.len()..])
    }

    /// Takes a zero from elsewhere, e.g. from the idle readings of a recording; other lengths are ignored.
    pub fn set_zero(&mut self, zero: &[f64]) {
        let channels = self.noise.len();
        if zero.len() == channels {
            self.zero[..channels].copy_from_slice(zero);
            self.weight[..channels].fill(FEWEST_FRAMES);
            self.known = true;
            self.averaging = false;
        }
    }

    /// Replaces the values of a frame by `value − zero`. Channels that are invalid, and all channels before the
    /// first tare, become NaN; a saturated channel keeps its value, which is a bound.
    pub fn subtract(&self, frame: &mut Frame) {
        let known = self.known && frame.values.len() == self.noise.len();
        for (i, value) in frame.values.iter_mut().enumerate() {
            *value = if known { (f64::from(*value) - self.zero[i]) as f32 } else { f32::NAN };
            if frame.flags.get(i).is_some_and(|f| f.is_invalid()) {
                *value = f32::NAN;
            }
        }
    }

    /// The numbers of an image less their zero; NaN where either is not known.
    pub fn subtract_image(&self, image: &[f32], out: &mut Vec<f32>) {
        out.clear();
        match self.image_zero() {
            Some(zero) if zero.len() == image.len() => {
                out.extend(image.iter().zip(zero).map(|(v, zero)| (f64::from(*v) - zero) as f32));
            }
            _ => out.resize(image.len(), f32::NAN),
        }
    }

    /// Forgets the zero and starts over.
    pub fn reset(&mut self) {
        self.zero.fill(f64::NAN);
        self.weight.fill(0);
        self.known = false;
        self.averaging = true;
        self.disturbed = None;
        self.last = None;
        self.last_touch = None;
        self.window.clear(self.zero.len());
    }
}

fn seconds(from: Stamp, to: Stamp) -> f64 {
    to.saturating_sub(from) as f64 * 1e-9
}

#[cfg(test)]
mod tests;
