//! A recording as a device.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dermis_bag::{BagError, BagReader, BagSkin, SkinChoice, SkinChoiceError, Typed};
use dermis_msgs::msg::TaxelFrame;
use dermis_sensor::Encoder;
use dermis_skin::{Frame, SkinDescription};

use super::line::Line;
use super::worker::{Worker, sleep_until};
use super::{Counters, DeviceStats, Outlet, plain_encoder};
use crate::TestbedError;

/// How long a replay waits for a full line to be read.
const FULL_LINE: Duration = Duration::from_millis(1);

/// How a recording is sent.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayOptions {
    /// Factor on the recorded pace; infinite for as fast as it is read.
    pub speed: f64,
    /// Topic of the frames; the only one of that type where absent.
    pub topic: Option<String>,
    /// Name of the skin whose frames are sent; the only one of this type where absent.
    pub instance: Option<String>,
    /// Where the device is plugged in.
    pub outlet: Outlet,
}

impl Default for ReplayOptions {
    fn default() -> Self {
        Self { speed: 1.0, topic: None, instance: None, outlet: Outlet::Pty }
    }
}

/// Why it is not clear which frames of a bag to send.
enum Unclear {
    Bag(BagError),
    Skin(String),
}

impl From<BagError> for Unclear {
    fn from(error: BagError) -> Self {
        Self::Bag(error)
    }
}

/// Topic of the skin whose frames are sent, and the skin: never those of two.
fn choose(
    reader: &BagReader,
    skin: &SkinDescription,
    options: &ReplayOptions,
) -> Result<(String, BagSkin), Unclear> {
    let named = options.topic.as_deref().map(|topic| reader.topic(topic)).transpose()?;
    let named = named.map(|topic| topic.name.as_str());
    let skins = reader.skins()?;
    let choice =
        SkinChoice { instance: options.instance.as_deref(), topic: named, type_name: skin.type_name() };
    let mut chosen = choice.of(&skins, |hash, name| skin.is_type(hash, name));
    // A recording of one skin is taken whatever that is called: its channels are compared below.
    let mut framed = skins.iter().filter(|skin| skin.topics_of::<TaxelFrame>().next().is_some());
    if let (Err(SkinChoiceError::NoneOfType { .. }), Some(only), None) =
        (&chosen, framed.next(), framed.next())
    {
        chosen = Ok(only);
    }
    let chosen = chosen.map_err(|error| {
        Unclear::Skin(format!("{error}; `--skin-instance` names one, `dermis bag info` lists them"))
    })?;
    let topics: Vec<&str> =
        chosen.topics_of::<TaxelFrame>().filter(|topic| named.is_none_or(|named| named == *topic)).collect();
    match topics.as_slice() {
        [only] => Ok(((*only).to_owned(), chosen.clone())),
        [] => Err(Unclear::Skin(format!(
            "has no frames of skin `{}` on {}",
            chosen.name,
            named.unwrap_or_default()
        ))),
        several => Err(Unclear::Skin(format!(
            "frames of skin `{}` come on several topics: {}: two skins would be taken for one",
            chosen.name,
            several.join(", ")
        ))),
    }
}

/// The frames of a bag as a device that sends them once, with the sequence numbers and device times that they
/// were recorded with.
///
/// Nothing is dropped: where the line is full, it waits until somebody reads. The line stays open after the last
/// frame until the device is stopped or dropped. At another speed than 1 the device time keeps its recorded pace
/// and so runs faster or slower than the host's clock.
#[derive(Debug)]
pub struct ReplayDevice {
    url: String,
    counters: Arc<Counters>,
    finished: Arc<AtomicBool>,
    worker: Worker,
}

impl ReplayDevice {
    /// Plugs the recording in and starts to send it.
    ///
    /// # Errors
    ///
    /// [`TestbedError`] where the bag cannot be read, holds no frames of this skin, or there is no line.
    pub fn start(
        bag: impl AsRef<Path>,
        skin: &SkinDescription,
        options: &ReplayOptions,
    ) -> Result<Self, TestbedError> {
        Self::start_on(plain_encoder(skin)?, bag, skin, options)
    }

    /// [`start`](Self::start) with a wire of the sensor family's own.
    ///
    /// # Errors
    ///
    /// As [`start`](Self::start).
    pub fn start_on(
        encoder: Box<dyn Encoder>,
        bag: impl AsRef<Path>,
        skin: &SkinDescription,
        options: &ReplayOptions,
    ) -> Result<Self, TestbedError> {
        let path = bag.as_ref().to_path_buf();
        let wrong = |reason: String| TestbedError::Recording { path: path.clone(), reason };
        if options.speed.is_nan() || options.speed <= 0.0 {
            return Err(wrong(format!("replay speed is {} and must be positive", options.speed)));
        }
        let reader = BagReader::open(&path)?;
        let (topic, sender) = choose(&reader, skin, options).map_err(|reason| match reason {
            Unclear::Bag(error) => error.into(),
            Unclear::Skin(reason) => wrong(reason),
        })?;
        // A topic may carry several skins.
        let frames = || {
            let name = sender.name.clone();
            let of_skin = move |message: &Result<Typed<TaxelFrame>, BagError>| {
                message.as_ref().is_ok_and(|typed| typed.message.skin == name) || message.is_err()
            };
            reader.read::<TaxelFrame>(&topic).map(|messages| messages.filter(of_skin))
        };
        let Some(first) = frames()?.next().transpose()?.map(|m| m.message) else {
            return Err(wrong("holds no frames".into()));
        };
        if let Some(reason) = skin.layout_mismatch(&first, &sender.layouts) {
            return Err(wrong(format!(
                "its frames are of skin `{}`, and not as `{}` sends them: {reason}",
                first.skin, skin.name
            )));
        }
        let messages = frames()?;
        let (line, url) = Line::open(&options.outlet, &skin.name)?;
        let counters = Arc::new(Counters::default());
        let stop = Arc::new(AtomicBool::new(false));
        let finished = Arc::new(AtomicBool::new(false));
        let sending = Sending {
            encoder,
            counters: Arc::clone(&counters),
            stop: Arc::clone(&stop),
            line,
            path,
            skin: skin.name.clone(),
            speed: options.speed,
            begin: Instant::now(),
            first,
        };
        let ended = Arc::clone(&finished);
        let worker = Worker::spawn(&skin.name, "replay-device", stop, move || sending.run(messages, &ended))?;
        Ok(Self { url, counters, finished, worker })
    }

    /// Source URL under which a node reads the device.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Whether every frame was handed to the line.
    #[must_use]
    pub fn finished(&self) -> bool {
        self.finished.load(Ordering::Acquire)
    }

    /// Whether it is still connected; `false` after it failed, for the reason that [`stop`](Self::stop) returns.
    #[must_use]
    pub fn running(&self) -> bool {
        self.worker.running()
    }

    /// What was sent so far.
    #[must_use]
    pub fn stats(&self) -> DeviceStats {
        self.counters.read()
    }

    /// Ends the thread and closes the line.
    ///
    /// # Errors
    ///
    /// [`TestbedError`] that ended the replay before.
    pub fn stop(mut self) -> Result<DeviceStats, TestbedError> {
        self.worker.stop()?;
        Ok(self.stats())
    }
}

/// What the thread of a replay works with.
struct Sending {
    encoder: Box<dyn Encoder>,
    counters: Arc<Counters>,
    stop: Arc<AtomicBool>,
    line: Line,
    /// Of the bag.
    path: PathBuf,
    /// Name of the skin.
    skin: String,
    speed: f64,
    begin: Instant,
    /// The first frame of the recording.
    first: TaxelFrame,
}

impl Sending {
    /// Sends every frame at its time, and holds the line until the device is stopped.
    fn run(
        mut self,
        messages: impl Iterator<Item = Result<Typed<TaxelFrame>, BagError>>,
        finished: &AtomicBool,
    ) -> Result<(), TestbedError> {
        for message in messages {
            let frame = message?.message;
            self.check(&frame)?;
            let zero = self.first.header.stamp.as_nanos();
            let since = (frame.header.stamp.as_nanos() - zero).max(0) as f64 * 1e-9 / self.speed;
            sleep_until(self.begin + Duration::from_secs_f64(since), &self.stop);
            if !self.send(&frame)? {
                return Ok(());
            }
        }
        finished.store(true, Ordering::Release);
        // Hanging up would throw away what is still on its way to the reader.
        while !self.stop.load(Ordering::Relaxed) {
            std::thread::park();
        }
        Ok(())
    }

    /// Refuses a frame that is not of the same channels as the first.
    fn check(&self, frame: &TaxelFrame) -> Result<(), TestbedError> {
        let wrong = |reason| Err(TestbedError::Recording { path: self.path.clone(), reason });
        let (layout, channels) = (self.first.layout_id, self.first.values.len());
        if frame.layout_id != layout {
            return wrong(format!(
                "frame {} has the channel layout {:08x} where those before have {layout:08x}: the skin was changed in the \
                 middle; cut the bag there",
                frame.sequence, frame.layout_id
            ));
        }
        if frame.values.len() != channels {
            return wrong(format!(
                "frame {} has {} values where its channels are {channels}",
                frame.sequence,
                frame.values.len()
            ));
        }
        Ok(())
    }

    /// Waits until the line has taken the whole frame; `false` where the device was stopped before.
    fn send(&mut self, frame: &TaxelFrame) -> Result<bool, TestbedError> {
        let Self { encoder, line, skin, stop, .. } = self;
        let bytes = encoder
            .encode(&Frame::from(frame), frame.device_time_us)
            .map_err(|reason| TestbedError::Wire { skin: skin.clone(), reason })?;
        let lost = |source| TestbedError::Device { skin: skin.clone(), what: "lost its line", source };
        while !line.send(bytes).map_err(lost)? {
            if stop.load(Ordering::Relaxed) {
                return Ok(false);
            }
            sleep_until(Instant::now() + FULL_LINE, stop);
        }
        self.counters.frames.fetch_add(1, Ordering::Relaxed);
        while !line.flush().map_err(lost)? {
            if stop.load(Ordering::Relaxed) {
                return Ok(false);
            }
            sleep_until(Instant::now() + FULL_LINE, stop);
        }
        Ok(true)
    }
}
