//! Frames of a run, one after the other.
//!
//! A data set does not hold the frames of its bags, unless they are few ([`DatasetOptions::memory`]): who needs readings
//! reads the bag once more, in order of acquisition, and the zero is subtracted on the way as a node does it. Memory holds
//! one frame and those that lie in the bag before it although they were acquired later; time is that of decoding the bag,
//! once a pass.
//!
//! Images are never held: who asks for them reads the bag. An image belongs to the frame of its stamp, on the topic `image`
//! beside that of the frames.
//!
//! [`DatasetOptions::memory`]: super::DatasetOptions::memory

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use dermis_bag::{BagReader, Filter, Messages};
use dermis_estimate::ConditionedFrame;
use dermis_inference::Baseline;
use dermis_msgs::Message;
use dermis_msgs::msg::TaxelFrame;
use dermis_msgs::sensor_msgs::msg::Image as ImageMsg;
use dermis_skin::{ChannelFlags, Frame, Image, ImageGrid, SkinDescription, Stamp, ZeroTracker};

use super::truth::Truth;
use super::{Run, SampleId};
use crate::LearnError;

/// Frames that a tare takes at least.
pub(super) const FEWEST_TARE_FRAMES: usize = 3;
/// Images, and frames, that are read ahead of their counterparts: they may be recorded in either order.
const AHEAD: usize = 64;

/// What stays in memory of every frame: when it was acquired and what was true, but no reading.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameInfo {
    /// When it was acquired.
    pub stamp: Stamp,
    /// Whether the zero is taken anew from this frame on: the first of an idle stretch that is long enough.
    pub tare: bool,
    /// One entry a channel. Frames of like flags share them.
    pub flags: Arc<[ChannelFlags]>,
    /// `None` for a frame without ground truth; it still feeds history.
    pub truth: Option<Truth>,
}

/// One frame and what was true when it was acquired.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// As the device gave it, in the unit of the skin.
    pub frame: Frame,
    /// `value − zero` in the unit of the skin, one a channel; NaN where a channel is invalid or its zero unknown.
    pub tared: Vec<f32>,
    /// The coarse image that was requested ([`Dataset::stream_images`](super::Dataset::stream_images)), NaN throughout where
    /// the frame has none; empty where none was requested.
    pub image: Vec<f32>,
    /// The same less its zero; NaN where that is not known.
    pub image_tared: Vec<f32>,
    /// Whether the zero is taken anew from this frame on: the first of an idle stretch that is long enough.
    pub tare: bool,
    /// `None` for a frame without ground truth; it still feeds history.
    pub truth: Option<Truth>,
}

impl Sample {
    /// As contact finders take it.
    #[must_use]
    pub fn conditioned(&self) -> ConditionedFrame<'_> {
        ConditionedFrame {
            stamp: self.frame.stamp,
            reading: &self.frame.values,
            signal: &self.tared,
            flags: &self.frame.flags,
            image: &self.image,
            image_signal: &self.image_tared,
        }
    }

    /// What a model takes of it: the channels or, where it takes images, the coarse image.
    #[must_use]
    pub fn numbers(&self, baseline: Baseline, image: bool) -> &[f32] {
        match (image, baseline) {
            (false, Baseline::Raw) => &self.frame.values,
            (false, Baseline::Tared) => &self.tared,
            (true, Baseline::Raw) => &self.image,
            (true, Baseline::Tared) => &self.image_tared,
        }
    }
}

/// Where the frames of a run are: in memory, in a bag, or in both.
#[derive(Debug, Clone, Default)]
pub(super) struct Source {
    /// In memory, in order of acquisition; without their images where they are of a bag.
    pub(super) held: Option<Arc<Vec<Frame>>>,
    /// In the bag.
    pub(super) bag: Option<BagFrames>,
}

/// Which messages of a bag are the frames of a run.
#[derive(Debug, Clone)]
pub(super) struct BagFrames {
    pub(super) instance: String,
    pub(super) topic: Option<String>,
    /// Topic of their images, where there is one.
    pub(super) images: Option<String>,
    /// Place in time of every frame of the bag; `None` where they lie in order.
    pub(super) ranks: Option<Arc<Vec<u32>>>,
}

/// The frames of a run, in order of acquisition, with their zero subtracted.
pub struct Samples<'a> {
    run: &'a Run,
    frames: Frames<'a>,
    zero: ZeroTracker,
    grid: Option<ImageGrid>,
    next: usize,
}

enum Frames<'a> {
    Held(std::slice::Iter<'a, Frame>),
    Bag(Box<Reading<'a>>),
}

/// A bag that is being read.
struct Reading<'a> {
    path: &'a Path,
    of: &'a BagFrames,
    messages: Messages,
    /// Frames of the bag that were read.
    read: usize,
    /// Frames that were read before it was their turn, by their place in time.
    early: BTreeMap<usize, Frame>,
    /// Topic of the images that are read, where any are.
    image_topic: Option<&'a str>,
    /// Images that were read and belong to no frame so far.
    images: BTreeMap<Stamp, Image>,
}

impl<'a> Reading<'a> {
    fn open(path: &'a Path, of: &'a BagFrames, images: bool) -> Result<Self, LearnError> {
        let images = of.images.as_ref().filter(|_| images);
        let image_topic = images.map(String::as_str);
        let mut filter = Filter::default()
            .types([TaxelFrame::TYPE_NAME].into_iter().chain(images.map(|_| ImageMsg::TYPE_NAME)));
        if let Some(topic) = &of.topic {
            filter = filter.topics([topic].into_iter().chain(images).cloned());
        }
        let messages = BagReader::open(path)?.messages_where(filter);
        Ok(Self { path, of, messages, read: 0, early: BTreeMap::new(), image_topic, images: BTreeMap::new() })
    }

    /// Reads one message; `false` at the end of the bag.
    fn advance(&mut self) -> Result<bool, LearnError> {
        let Some(message) = self.messages.next().transpose()? else { return Ok(false) };
        if *message.type_name == *ImageMsg::TYPE_NAME {
            if self.image_topic.is_some_and(|topic| *topic == *message.topic) {
                let image: ImageMsg = message.decode()?;
                let unknown =
                    || LearnError::Image { bag: self.path.to_owned(), encoding: image.encoding.clone() };
                let seen = Image::from_message(&image).ok_or_else(unknown)?;
                self.images.insert(image.header.stamp.as_nanos(), seen);
                if self.images.len() > AHEAD {
                    self.images.pop_first();
                }
            }
            return Ok(true);
        }
        if self.of.topic.as_ref().is_some_and(|topic| **topic != *message.topic) {
            return Ok(true);
        }
        let frame: TaxelFrame = message.decode()?;
        if frame.skin == self.of.instance && frame.header.stamp.as_nanos() != 0 {
            let rank = match &self.of.ranks {
                None => Some(self.read),
                Some(ranks) => ranks.get(self.read).map(|r| *r as usize),
            };
            self.read += 1;
            self.early.insert(rank.ok_or_else(|| self.changed())?, Frame::from(&frame));
        }
        Ok(true)
    }

    /// The frame with this place in time.
    fn frame(&mut self, place: usize) -> Result<Frame, LearnError> {
        loop {
            if let Some(frame) = self.early.remove(&place) {
                return Ok(frame);
            }
            if !self.advance()? {
                return Err(self.changed());
            }
        }
    }

    /// The image of this stamp, where there is one near its frame.
    fn image(&mut self, stamp: Stamp) -> Result<Option<Image>, LearnError> {
        loop {
            if let Some(image) = self.images.remove(&stamp) {
                return Ok(Some(image));
            }
            if self.early.len() >= AHEAD || !self.advance()? {
                return Ok(None);
            }
        }
    }

    fn changed(&self) -> LearnError {
        LearnError::Changed { bag: self.path.to_owned() }
    }
}

/// Which images of a run are wanted.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Images {
    /// Whether frames come with theirs.
    pub(super) read: bool,
    /// What is made of them besides.
    pub(super) grid: Option<ImageGrid>,
}

impl<'a> Samples<'a> {
    pub(super) fn new(run: &'a Run, skin: &SkinDescription, images: Images) -> Result<Self, LearnError> {
        let Source { held, bag } = &run.source;
        let in_bag = bag.as_ref().filter(|of| held.is_none() || (images.read && of.images.is_some()));
        let frames = match (in_bag, held) {
            (Some(of), _) => Frames::Bag(Box::new(Reading::open(&run.path, of, images.read)?)),
            (None, held) => Frames::Held(held.as_ref().map_or(&[][..], |frames| frames.as_slice()).iter()),
        };
        let mut zero = ZeroTracker::labelled(skin);
        zero.set_image(images.grid.map_or(0, |grid| grid.numbers()));
        Ok(Self { run, frames, zero, grid: images.grid, next: 0 })
    }

    fn sample(&mut self, info: &FrameInfo) -> Result<Sample, LearnError> {
        let frame = match &mut self.frames {
            Frames::Held(frames) => frames.next().cloned().unwrap_or_default(),
            Frames::Bag(reading) => {
                let mut frame = reading.frame(self.next)?;
                if frame.stamp != info.stamp {
                    return Err(reading.changed());
                }
                if reading.image_topic.is_some() {
                    frame.image = reading.image(frame.stamp)?;
                }
                frame
            }
        };
        let mut image = Vec::new();
        if let Some(grid) = &self.grid {
            image.resize(grid.numbers(), f32::NAN);
            if let Some(seen) = &frame.image {
                let unfit = |source| LearnError::ImageSize { bag: self.run.path.clone(), source };
                grid.reduce(seen, &mut image).map_err(unfit)?;
            }
        }
        if info.tare {
            self.zero.reset();
        }
        // What is not known to be untouched must not move the zero.
        self.zero.push_with(&frame, &image, info.truth.as_ref().is_none_or(Truth::touched));
        let mut tared = frame.clone();
        self.zero.subtract(&mut tared);
        let mut image_tared = Vec::new();
        self.zero.subtract_image(&image, &mut image_tared);
        Ok(Sample {
            frame,
            tared: tared.values,
            image,
            image_tared,
            tare: info.tare,
            truth: info.truth.clone(),
        })
    }
}

impl Iterator for Samples<'_> {
    type Item = Result<Sample, LearnError>;

    fn next(&mut self) -> Option<Self::Item> {
        let run = self.run;
        let sample = self.sample(run.samples.get(self.next)?);
        // After an error there is nothing more to come.
        self.next = if sample.is_ok() { self.next + 1 } else { run.samples.len() };
        Some(sample)
    }
}

impl Run {
    /// A run of frames that were made elsewhere, in order of acquisition, with a label each.
    #[must_use]
    pub fn of_frames(
        (path, session, hash): (std::path::PathBuf, String, String),
        frames: Vec<Frame>,
        labels: Vec<Option<Truth>>,
        skin: &SkinDescription,
        tare_when_idle: bool,
    ) -> Self {
        let mut flags = SharedFlags::default();
        let marks = frames.iter().map(|f| (f.stamp, flags.share(&f.flags))).collect();
        let samples = infos(marks, labels, skin, tare_when_idle);
        let source = Source { held: Some(Arc::new(frames)), bag: None };
        Self { path, session, hash, samples, lost: 0, bias: None, source }
    }
}

impl super::Dataset {
    /// The frames of one run, read anew, without the images of a camera; none where there is no such run.
    ///
    /// # Errors
    ///
    /// [`LearnError::Bag`] where the bag cannot be opened.
    pub fn stream(
        &self,
        run: usize,
    ) -> Result<impl Iterator<Item = Result<Sample, LearnError>> + '_, LearnError> {
        self.samples(run, Images::default())
    }

    /// As [`stream`](Self::stream), with the image of every frame that has one, and what `grid` makes of it.
    ///
    /// # Errors
    ///
    /// As [`stream`](Self::stream); then, sample by sample, [`LearnError::Image`] and [`LearnError::ImageSize`].
    pub fn stream_images(
        &self,
        run: usize,
        grid: Option<ImageGrid>,
    ) -> Result<impl Iterator<Item = Result<Sample, LearnError>> + '_, LearnError> {
        self.samples(run, Images { read: true, grid })
    }

    /// What a model takes of the frames of one run: with images where it takes these.
    pub(crate) fn stream_for(
        &self,
        run: usize,
        image: Option<ImageGrid>,
    ) -> Result<impl Iterator<Item = Result<Sample, LearnError>> + '_, LearnError> {
        self.samples(run, Images { read: image.is_some(), grid: image })
    }

    fn samples(
        &self,
        run: usize,
        images: Images,
    ) -> Result<std::iter::Flatten<std::option::IntoIter<Samples<'_>>>, LearnError> {
        let samples = self.runs.get(run).map(|run| Samples::new(run, &self.skin, images)).transpose()?;
        Ok(samples.into_iter().flatten())
    }

    /// The samples of these identities with their readings, in the order of `ids`. They are held in memory: ask for a part.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where a bag cannot be read once more, or has changed.
    pub fn gather(&self, ids: &[SampleId]) -> Result<Vec<(SampleId, Sample)>, LearnError> {
        let wanted: BTreeSet<SampleId> = ids.iter().copied().collect();
        let mut found: BTreeMap<SampleId, Sample> = BTreeMap::new();
        for run in 0..self.runs.len() {
            let of_run = || wanted.range(SampleId { run, sample: 0 }..=SampleId { run, sample: usize::MAX });
            let Some(last) = of_run().next_back() else { continue };
            for (sample, read) in self.stream(run)?.enumerate().take(last.sample + 1) {
                let (id, read) = (SampleId { run, sample }, read?);
                if wanted.contains(&id) {
                    found.insert(id, read);
                }
            }
        }
        if wanted.len() == ids.len() {
            return Ok(ids.iter().filter_map(|id| Some((*id, found.remove(id)?))).collect());
        }
        Ok(ids.iter().filter_map(|id| Some((*id, found.get(id)?.clone()))).collect())
    }
}

/// Flags of frames, each combination once.
#[derive(Default)]
pub(super) struct SharedFlags(std::collections::HashSet<Arc<[ChannelFlags]>>);

impl SharedFlags {
    pub(super) fn share(&mut self, flags: &[ChannelFlags]) -> Arc<[ChannelFlags]> {
        if let Some(known) = self.0.get(flags) {
            return Arc::clone(known);
        }
        let new: Arc<[ChannelFlags]> = flags.into();
        self.0.insert(Arc::clone(&new));
        new
    }
}

/// Says where the zero is taken anew. Frames are in order of their stamps, with a label each.
pub(super) fn infos(
    frames: Vec<(Stamp, Arc<[ChannelFlags]>)>,
    labels: Vec<Option<Truth>>,
    skin: &SkinDescription,
    tare_when_idle: bool,
) -> Vec<FrameInfo> {
    let mut infos: Vec<FrameInfo> = frames
        .into_iter()
        .zip(labels)
        .map(|((stamp, flags), truth)| FrameInfo { stamp, tare: false, flags, truth })
        .collect();
    if !tare_when_idle {
        return infos;
    }
    let idle = |info: &FrameInfo| info.truth.as_ref().is_some_and(|t| t.idle);
    let mut k = 0;
    while k < infos.len() {
        let count = infos[k..].iter().take_while(|i| idle(i)).count();
        if let Some(last) = count.checked_sub(1) {
            let lasts = infos[k + last].stamp.saturating_sub(infos[k].stamp) as f64 * 1e-9;
            infos[k].tare = count >= FEWEST_TARE_FRAMES && lasts >= skin.condition.tare_duration;
        }
        k += count.max(1);
    }
    infos
}
