//! The index of a run: what stays in memory of its frames, and of which frames.
//!
//! Problem: labelled frames must be in memory to be split, drawn and counted, and recordings have any number of them. Method: systematic
//! sampling. Where bags hold more than [`MOST_FRAMES`](super::MOST_FRAMES) frames, every k-th stays, and one frame of each press that has none
//! among them: of its touched frames, each is as likely (reservoir sampling, drawn by a hash of its number, so that it is the same in every
//! program). What the zero needs of the frames between is held as stretches. Assumption: frames that follow each other tell nearly the same.
//! Cost: O(1) for each frame; lists that would outgrow their bound keep every second entry ([`Sparse`]).

use std::sync::Arc;

use dermis_skin::{ChannelFlags, Stamp};

use super::stream::FEWEST_TARE_FRAMES;
use super::{FrameInfo, Truth};
use crate::random::{STEP, mixed};

/// A list that keeps every entry while they are few, and then every second, every fourth and so on.
#[derive(Debug)]
pub(crate) struct Sparse<T> {
    most: usize,
    step: usize,
    seen: usize,
    list: Vec<T>,
}

impl<T> Sparse<T> {
    /// Keeps `most` entries, and 2 at least.
    pub(crate) fn new(most: usize) -> Self {
        Self { most: most.max(2), step: 1, seen: 0, list: Vec::new() }
    }

    pub(crate) fn push(&mut self, item: T) {
        while self.seen.is_multiple_of(self.step) && self.list.len() >= self.most {
            every_second(&mut self.list);
            self.step *= 2;
        }
        if self.seen.is_multiple_of(self.step) {
            self.list.push(item);
        }
        self.seen += 1;
    }

    pub(crate) fn list(&self) -> &[T] {
        &self.list
    }

    /// How many were pushed and are not in the list.
    pub(crate) fn left_out(&self) -> usize {
        self.seen - self.list.len()
    }
}

/// Keeps the first entry, the third and so on.
fn every_second<T>(list: &mut Vec<T>) {
    let mut odd = true;
    list.retain(|_| {
        odd = !odd;
        !odd
    });
}

/// Frames that are known to be untouched, one after the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stretch {
    /// Number of the first one.
    from: u32,
    /// Number behind the last one.
    to: u32,
    /// Whether the zero is taken anew from the first one on.
    tare: bool,
}

/// What is known of the frames of a run that are not in its index.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Between {
    /// Frames of the run.
    pub(super) frames: usize,
    /// Of so many frames, one is in the index.
    pub(super) every: usize,
    stretches: Vec<Stretch>,
}

impl Between {
    /// How often the zero is taken anew.
    pub(super) fn tares(&self) -> usize {
        self.stretches.iter().filter(|s| s.tare).count()
    }

    /// Whether the zero is taken anew from a frame on, and whether it is known to be untouched. `at` is where the call for the frame
    /// before left it, 0 for the first frame.
    pub(super) fn of_frame(&self, number: usize, at: &mut usize) -> (bool, bool) {
        while self.stretches.get(*at).is_some_and(|s| s.to as usize <= number) {
            *at += 1;
        }
        match self.stretches.get(*at).filter(|s| s.from as usize <= number) {
            Some(stretch) => (stretch.tare && stretch.from as usize == number, true),
            None => (false, false),
        }
    }
}

/// How many frames of a run are in the index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Share {
    /// Of so many frames, one is; of 1, all are.
    pub(super) every: usize,
    /// Frames besides of presses that have none among those.
    pub(super) spare: usize,
    /// Stretches of untouched frames that are known at most.
    pub(super) stretches: usize,
}

impl Share {
    /// All frames are.
    pub(super) const ALL: Self = Self { every: 1, spare: 0, stretches: usize::MAX };
}

/// What was counted of all frames, whether they are in the index or not.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) frames: usize,
    pub(super) labelled: usize,
    /// Labelled frames with several contacts.
    pub(super) several: usize,
    /// First and last stamp.
    pub(super) span: Option<(Stamp, Stamp)>,
    /// Presses of which no frame is in the index.
    pub(super) presses_left_out: usize,
    /// Stretches of untouched frames that the zero does not follow.
    pub(super) stretches_left_out: usize,
}

/// Makes an index of frames in the order of their stamps.
pub(super) struct Indexer {
    share: Share,
    /// \[s\] for which a skin is idle before the zero is taken anew; `None` where it never is.
    tare_after: Option<f64>,
    samples: Vec<FrameInfo>,
    /// Frames of short presses, by their place in `samples` while they are few.
    spare: Sparse<u32>,
    press: Option<Press>,
    untouched: Option<Stretch>,
    idle: Option<Idle>,
    stretches: Sparse<Stretch>,
    counts: Counts,
}

/// The press that is going on, or was the last one.
struct Press {
    identity: (u64, u32),
    /// Whether one of its touched frames is in the index.
    known: bool,
    /// Its touched frames that are not, and one of them.
    seen: usize,
    one: Option<FrameInfo>,
}

/// An idle stretch that is going on.
struct Idle {
    from: u32,
    begin: Stamp,
    frames: usize,
    tared: bool,
}

impl Indexer {
    /// Nothing yet of about `frames` frames.
    pub(super) fn new(share: Share, tare_after: Option<f64>, frames: usize) -> Self {
        Self {
            share,
            tare_after,
            // At once, because a list that grows is there twice.
            samples: Vec::with_capacity(frames.div_ceil(share.every).saturating_add(share.spare)),
            spare: Sparse::new(share.spare),
            press: None,
            untouched: None,
            idle: None,
            stretches: Sparse::new(share.stretches),
            counts: Counts::default(),
        }
    }

    /// Takes the next frame.
    pub(super) fn push(&mut self, stamp: Stamp, flags: Arc<[ChannelFlags]>, truth: Option<Truth>) {
        let counts = &mut self.counts;
        // Whoever reads the bag refuses one with more frames than numbers.
        let number = u32::try_from(counts.frames).unwrap_or(u32::MAX);
        counts.frames += 1;
        counts.labelled += usize::from(truth.is_some());
        counts.several += usize::from(truth.as_ref().is_some_and(|t| t.contacts.len() > 1));
        counts.span = Some((counts.span.map_or(stamp, |(first, _)| first), stamp));
        self.follow_zero(number, stamp, truth.as_ref());
        let kept = (number as usize).is_multiple_of(self.share.every);
        let info = FrameInfo { stamp, tare: false, number, flags, truth };
        if self.share.every > 1
            && let Some(truth) = info.truth.as_ref().filter(|t| t.touched())
        {
            let identity = (truth.press, truth.location);
            if self.press.as_ref().is_none_or(|press| press.identity != identity) {
                self.end_press();
                self.press = Some(Press { identity, known: false, seen: 0, one: None });
            }
            if let Some(press) = &mut self.press {
                if kept {
                    (press.known, press.one) = (true, None);
                } else if !press.known {
                    press.seen += 1;
                    if mixed(u64::from(number).wrapping_add(STEP)).is_multiple_of(press.seen as u64) {
                        press.one = Some(info);
                    }
                    return;
                }
            }
        }
        if kept {
            self.samples.push(info);
        }
    }

    /// Keeps one frame of a press that has none so far.
    fn end_press(&mut self) {
        let Some(info) = self.press.take().filter(|press| !press.known).and_then(|press| press.one) else {
            return;
        };
        let step = self.spare.step;
        self.spare.push(info.number);
        if self.spare.list().last() == Some(&info.number) {
            let at = self.samples.partition_point(|s| s.number < info.number);
            self.samples.insert(at, info);
        }
        if self.spare.step != step {
            self.drop_spare();
        }
    }

    /// Drops frames of short presses that are too many.
    fn drop_spare(&mut self) {
        let (every, spare) = (self.share.every, self.spare.list());
        self.samples
            .retain(|s| (s.number as usize).is_multiple_of(every) || spare.binary_search(&s.number).is_ok());
    }

    /// Says where the zero is taken anew, and in which frames it follows drift.
    fn follow_zero(&mut self, number: u32, stamp: Stamp, truth: Option<&Truth>) {
        if truth.is_none_or(Truth::touched) {
            self.idle = None;
            self.end_stretch();
            return;
        }
        let next = Stretch { from: number, to: number.saturating_add(1), tare: false };
        self.untouched =
            Some(self.untouched.map_or(next, |open| Stretch { to: number.saturating_add(1), ..open }));
        let (Some(after), true) = (self.tare_after, truth.is_some_and(|t| t.idle)) else {
            self.idle = None;
            return;
        };
        let fresh = || Idle { from: number, begin: stamp, frames: 0, tared: false };
        let idle = self.idle.get_or_insert_with(fresh);
        idle.frames += 1;
        let lasts = stamp.saturating_sub(idle.begin) as f64 * 1e-9;
        if !idle.tared && idle.frames >= FEWEST_TARE_FRAMES && lasts >= after {
            idle.tared = true;
            let from = idle.from;
            if let Some(open) = self.untouched.filter(|open| open.from < from) {
                self.untouched = Some(Stretch { to: from, ..open });
                self.end_stretch();
            }
            self.untouched = Some(Stretch { from, to: number.saturating_add(1), tare: true });
        }
    }

    fn end_stretch(&mut self) {
        // Where every frame is in the index, it says itself whether it is touched.
        if let Some(stretch) = self.untouched.take().filter(|s| s.tare || self.share.every > 1) {
            self.stretches.push(stretch);
        }
    }

    /// The index, what is known of the frames between where there are any, and what was counted.
    pub(super) fn finish(mut self) -> (Vec<FrameInfo>, Option<Arc<Between>>, Counts) {
        self.end_stretch();
        self.end_press();
        let mut samples = self.samples;
        for stretch in self.stretches.list().iter().filter(|s| s.tare) {
            if let Ok(at) = samples.binary_search_by_key(&stretch.from, |s| s.number) {
                samples[at].tare = true;
            }
        }
        let mut counts = self.counts;
        counts.presses_left_out = self.spare.left_out();
        counts.stretches_left_out = self.stretches.left_out();
        let frames = counts.frames;
        let between = (samples.len() < frames).then(|| {
            let mut stretches = self.stretches.list;
            stretches.shrink_to_fit();
            Arc::new(Between { frames, every: self.share.every, stretches })
        });
        (samples, between, counts)
    }
}

/// How the frames of several bags share an index.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plan {
    most: usize,
    /// Frames of all bags.
    total: usize,
    every: usize,
    /// Frames of short presses over all bags.
    spare: usize,
}

impl Plan {
    /// Of bags with so many frames each, `most` of which may be in the index.
    pub(super) fn new(most: usize, frames: &[usize]) -> Self {
        let most = most.max(1);
        let total: usize = frames.iter().sum();
        // An eighth is for presses that are shorter than the step.
        let every = if total <= most { 1 } else { total.div_ceil(most - most / 8) };
        let even: usize = frames.iter().map(|n| n.div_ceil(every)).sum();
        Self { most, total, every, spare: most.saturating_sub(even) }
    }

    /// The share of a bag with so many frames.
    pub(super) fn share(&self, frames: usize) -> Share {
        if self.every == 1 {
            return Share::ALL;
        }
        let of = |all: usize| (all as u128 * frames as u128 / self.total.max(1) as u128) as usize;
        Share { every: self.every, spare: of(self.spare), stretches: of(self.most) }
    }

    /// What [`DatasetOptions::most_frames`](super::DatasetOptions::most_frames) is, 1 at least.
    pub(super) fn most(&self) -> usize {
        self.most
    }
}

#[cfg(test)]
mod tests;
