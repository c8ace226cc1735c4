//! Frames of a run, one after the other.
//!
//! A data set does not hold the frames of its bags, unless they are few ([`DatasetOptions::memory`]): who needs readings
//! reads the bag once more, in order of acquisition, and the zero is subtracted on the way as a node does it. Memory holds
//! one frame and those that lie in the bag before it although they were acquired later; time is that of decoding the bag,
//! once a pass. Frames that are not in the index ([`Run::samples`]) come, too, because zero and history need them: without
//! ground truth.
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

use super::index::{Indexer, Share};
use super::order::InOrder;
use super::truth::Truth;
use super::{Run, SampleId};
use crate::LearnError;

/// Frames that a tare takes at least.
pub(super) const FEWEST_TARE_FRAMES: usize = 3;
/// Images, and frames, that are read ahead of their counterparts: they may be recorded in either order.
const AHEAD: usize = 64;

/// Combinations of flags that frames share; of skins whose flags are noise, further ones are there several times.
const MOST_FLAGS: usize = 4096;

/// What stays in memory of a frame: when it was acquired and what was true, but no reading.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameInfo {
    /// When it was acquired.
    pub stamp: Stamp,
    /// Whether the zero is taken anew from this frame on: the first of an idle stretch that is long enough.
    pub tare: bool,
    /// Its number in the run, in order of acquisition, from 0: [`SampleId::sample`].
    pub number: u32,
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
    /// `None` for a frame without ground truth, or outside of the index; it still feeds history.
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
    pub(super) order: BagOrder,
}

/// How frames get into the order of acquisition.
#[derive(Debug, Clone, Default)]
pub(super) enum BagOrder {
    /// They lie in it.
    #[default]
    Stored,
    /// By the place in time of every frame of the bag.
    Ranks(Arc<Vec<u32>>),
    /// By a window of so many; those that come too late for it are left out.
    Window(usize),
}

/// The frames of a run, in order of acquisition, with their zero subtracted.
pub struct Samples<'a> {
    run: &'a Run,
    frames: Frames<'a>,
    zero: ZeroTracker,
    grid: Option<ImageGrid>,
    /// Number of the next frame, and where it, or the next one that is in it, is in the index.
    next: usize,
    indexed: usize,
    /// Where [`Between::of_frame`](super::index::Between::of_frame) is.
    stretch: usize,
}

/// The frames of a run, in order of acquisition.
pub(super) enum Frames<'a> {
    Held(std::slice::Iter<'a, Frame>),
    Bag(Box<Reading<'a>>),
}

impl<'a> Frames<'a> {
    pub(super) fn open(path: &'a Path, source: &'a Source, images: bool) -> Result<Self, LearnError> {
        let Source { held, bag } = source;
        let in_bag = bag.as_ref().filter(|of| held.is_none() || (images && of.images.is_some()));
        Ok(match (in_bag, held) {
            (Some(of), _) => Self::Bag(Box::new(Reading::open(path, of, images)?)),
            (None, held) => Self::Held(held.as_ref().map_or(&[][..], |frames| frames.as_slice()).iter()),
        })
    }

    /// The frame with this number, which is the next one, without its image.
    pub(super) fn next(&mut self, number: usize) -> Result<Frame, LearnError> {
        match self {
            Self::Held(frames) => Ok(frames.next().cloned().unwrap_or_default()),
            Self::Bag(reading) => reading.frame(number),
        }
    }
}

/// A bag that is being read.
pub(super) struct Reading<'a> {
    path: &'a Path,
    of: &'a BagFrames,
    messages: Messages,
    /// Frames of the bag that were read.
    read: usize,
    /// Frames that were read before it was their turn.
    early: Early,
    /// Whether all was read.
    ended: bool,
    /// Topic of the images that are read, where any are.
    image_topic: Option<&'a str>,
    /// Images that were read and belong to no frame so far.
    images: BTreeMap<Stamp, Image>,
}

/// Frames that wait for their turn.
enum Early {
    /// By their place in time.
    Ranked(BTreeMap<usize, Frame>),
    Window(InOrder<Frame>),
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
        let early = match &of.order {
            BagOrder::Stored | BagOrder::Ranks(_) => Early::Ranked(BTreeMap::new()),
            BagOrder::Window(window) => Early::Window(InOrder::new(*window)),
        };
        let images = BTreeMap::new();
        Ok(Self { path, of, messages, read: 0, early, ended: false, image_topic, images })
    }

    /// Images, and frames, that may be read ahead of their counterparts.
    fn ahead(&self) -> usize {
        AHEAD + if let Early::Window(order) = &self.early { order.window() } else { 0 }
    }

    /// Reads one message; `false` at the end of the bag.
    fn advance(&mut self) -> Result<bool, LearnError> {
        let Some(message) = self.messages.next().transpose()? else {
            self.ended = true;
            return Ok(false);
        };
        if *message.type_name == *ImageMsg::TYPE_NAME {
            if self.image_topic.is_some_and(|topic| *topic == *message.topic) {
                let image: ImageMsg = message.decode()?;
                let unknown =
                    || LearnError::Image { bag: self.path.to_owned(), encoding: image.encoding.clone() };
                let seen = Image::from_message(&image).ok_or_else(unknown)?;
                self.images.insert(image.header.stamp.as_nanos(), seen);
                if self.images.len() > self.ahead() {
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
            let frame = Frame::from(&frame);
            let rank = match &self.of.order {
                BagOrder::Ranks(ranks) => ranks.get(self.read).map(|r| *r as usize),
                BagOrder::Stored | BagOrder::Window(_) => Some(self.read),
            };
            let rank = rank.ok_or_else(|| self.changed())?;
            self.read += 1;
            match &mut self.early {
                Early::Ranked(early) => drop(early.insert(rank, frame)),
                Early::Window(order) => order.push(frame.stamp, frame),
            }
        }
        Ok(true)
    }

    /// The frame with this place in time.
    fn frame(&mut self, place: usize) -> Result<Frame, LearnError> {
        loop {
            let next = match &mut self.early {
                Early::Ranked(early) => early.remove(&place),
                Early::Window(order) => order.pop(self.ended).map(|(_, frame)| frame),
            };
            if let Some(frame) = next {
                return Ok(frame);
            }
            if self.ended {
                return Err(self.changed());
            }
            self.advance()?;
        }
    }

    /// The image of this stamp, where there is one near its frame.
    fn image(&mut self, stamp: Stamp) -> Result<Option<Image>, LearnError> {
        loop {
            if let Some(image) = self.images.remove(&stamp) {
                return Ok(Some(image));
            }
            let waiting = match &self.early {
                Early::Ranked(early) => early.len(),
                Early::Window(order) => order.len(),
            };
            if waiting >= self.ahead() || !self.advance()? {
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
        let frames = Frames::open(&run.path, &run.source, images.read)?;
        let mut zero = ZeroTracker::labelled(skin);
        zero.set_image(images.grid.map_or(0, |grid| grid.numbers()));
        Ok(Self { run, frames, zero, grid: images.grid, next: 0, indexed: 0, stretch: 0 })
    }

    fn sample(&mut self) -> Result<Sample, LearnError> {
        let run = self.run;
        let info = run.samples.get(self.indexed).filter(|info| info.number as usize == self.next);
        self.indexed += usize::from(info.is_some());
        let mut frame = self.frames.next(self.next)?;
        if let Frames::Bag(reading) = &mut self.frames {
            if info.is_some_and(|info| info.stamp != frame.stamp) {
                return Err(reading.changed());
            }
            if reading.image_topic.is_some() {
                frame.image = reading.image(frame.stamp)?;
            }
        }
        let (tare, untouched) = match (info, &run.between) {
            (Some(info), _) => (info.tare, info.truth.as_ref().is_some_and(|t| !t.touched())),
            (None, Some(between)) => between.of_frame(self.next, &mut self.stretch),
            (None, None) => (false, false),
        };
        let mut image = Vec::new();
        if let Some(grid) = &self.grid {
            image.resize(grid.numbers(), f32::NAN);
            if let Some(seen) = &frame.image {
                let unfit = |source| LearnError::ImageSize { bag: self.run.path.clone(), source };
                grid.reduce(seen, &mut image).map_err(unfit)?;
            }
        }
        if tare {
            self.zero.reset();
        }
        // What is not known to be untouched must not move the zero.
        self.zero.push_with(&frame, &image, !untouched);
        let mut tared = frame.clone();
        self.zero.subtract(&mut tared);
        let mut image_tared = Vec::new();
        self.zero.subtract_image(&image, &mut image_tared);
        Ok(Sample {
            frame,
            tared: tared.values,
            image,
            image_tared,
            tare,
            truth: info.and_then(|info| info.truth.clone()),
        })
    }
}

impl Iterator for Samples<'_> {
    type Item = Result<Sample, LearnError>;

    fn next(&mut self) -> Option<Self::Item> {
        let frames = self.run.frames();
        if self.next >= frames {
            return None;
        }
        let sample = self.sample();
        // After an error there is nothing more to come.
        self.next = if sample.is_ok() { self.next + 1 } else { frames };
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
        let tare_after = tare_when_idle.then_some(skin.condition.tare_duration);
        let mut index = Indexer::new(Share::ALL, tare_after, frames.len());
        for (frame, label) in frames.iter().zip(labels) {
            index.push(frame.stamp, flags.share(&frame.flags), label);
        }
        let (samples, between, _) = index.finish();
        let source = Source { held: Some(Arc::new(frames)), bag: None };
        Self { path, session, hash, samples, lost: 0, bias: None, between, source }
    }

    /// How many frames it has, whether they are in [`samples`](Self::samples) or not: as many as [`Dataset::stream`] gives.
    ///
    /// [`Dataset::stream`]: super::Dataset::stream
    #[must_use]
    pub fn frames(&self) -> usize {
        self.between.as_ref().map_or(self.samples.len(), |between| between.frames)
    }

    /// Of so many frames, one is in [`samples`](Self::samples): 1 where all of them are.
    #[must_use]
    pub fn every(&self) -> usize {
        self.between.as_ref().map_or(1, |between| between.every)
    }

    /// How often the zero is taken anew ([`Sample::tare`]).
    #[must_use]
    pub fn tares(&self) -> usize {
        let indexed = || self.samples.iter().filter(|s| s.tare).count();
        self.between.as_ref().map_or_else(indexed, |between| between.tares())
    }
}

impl super::Dataset {
    /// The frames of one run, read anew, without the images of a camera; none where there is no such run. All of them come in order,
    /// so that the n-th has the [`SampleId::sample`] n; those outside of [`Run::samples`] have no ground truth.
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
        if self.0.len() >= MOST_FLAGS {
            self.0.clear();
        }
        let new: Arc<[ChannelFlags]> = flags.into();
        self.0.insert(Arc::clone(&new));
        new
    }
}
