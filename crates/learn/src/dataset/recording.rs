//! The frames of a bag while it is read: what stays of them, and what is found out on the way.

use std::path::Path;
use std::sync::Arc;

use dermis_skin::{ChannelFlags, Frame, Stamp};

use super::order::{InOrder, WINDOW};
use super::stream::{BagFrames, BagOrder, Frames, SharedFlags, Source};
use crate::LearnError;

/// The frames of a bag: marks of all, or of many only their order; and the frames themselves while they are few.
#[derive(Default)]
pub(super) struct Recording {
    marks: Vec<Mark>,
    /// Where they are too many to be marked: their sequence numbers, until it is their turn.
    order: Option<InOrder<u64>>,
    losses: Losses,
    flags: SharedFlags,
    held: Option<Vec<Frame>>,
    /// Bytes that `held` takes.
    bytes: usize,
    /// Frames with a stamp.
    pub(super) count: usize,
    /// First number that each channel gave.
    pub(super) first: Vec<Option<f32>>,
    /// Whether a channel gave another one.
    pub(super) varies: Vec<bool>,
    /// Frames that have channels that are not healthy.
    pub(super) unhealthy: usize,
}

pub(super) struct Mark {
    pub(super) stamp: Stamp,
    sequence: u64,
    pub(super) flags: Arc<[ChannelFlags]>,
}

/// What is missing between frames, in order of acquisition.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Losses {
    before: Option<(Stamp, u64)>,
    /// Frames that are there.
    pub(super) frames: usize,
    /// Frames that are missing.
    pub(super) lost: u64,
    /// \[ns\] longest time between two frames.
    pub(super) gap: i64,
    /// Frames that are left out, because they lie too far behind later ones.
    pub(super) late: usize,
}

impl Losses {
    fn push(&mut self, stamp: Stamp, sequence: u64) {
        if let Some((time, number)) = self.before {
            self.lost = self.lost.saturating_add(sequence.saturating_sub(number).saturating_sub(1));
            self.gap = self.gap.max(stamp.saturating_sub(time));
        }
        self.before = Some((stamp, sequence));
        self.frames += 1;
    }
}

impl Recording {
    /// Nothing yet; a `streamed` one holds no marks.
    pub(super) fn new(streamed: bool) -> Self {
        let order = streamed.then(|| InOrder::new(WINDOW));
        Self { held: Some(Vec::new()), order, ..Self::default() }
    }

    pub(super) fn push(&mut self, frame: Frame, memory: usize) {
        self.count += 1;
        self.unhealthy += usize::from(frame.healthy_channels() < frame.values.len());
        if self.first.len() < frame.values.len() {
            self.first.resize(frame.values.len(), None);
            self.varies.resize(frame.values.len(), false);
        }
        let numbers = frame.values.iter().zip(&mut self.first).zip(&mut self.varies);
        for ((value, first), varies) in numbers.filter(|((v, _), _)| v.is_finite()) {
            *varies |= *first.get_or_insert(*value) != *value;
        }
        if let Some(order) = &mut self.order {
            order.push(frame.stamp, frame.sequence);
            while let Some((stamp, sequence)) = order.pop(false) {
                self.losses.push(stamp, sequence);
            }
        } else {
            let flags = self.flags.share(&frame.flags);
            self.marks.push(Mark { stamp: frame.stamp, sequence: frame.sequence, flags });
        }
        self.bytes += size_of::<Frame>() + frame.values.len() * size_of::<f32>() + frame.flags.len();
        if self.bytes > memory {
            self.held = None;
        } else if let Some(held) = &mut self.held {
            held.push(frame);
        }
    }

    /// Where the frames are found in order of acquisition: those of `bag`, whose order is filled in. `memory` is left with what they take.
    pub(super) fn finish(self, bag: BagFrames, memory: &mut usize) -> Found {
        let Self { mut marks, order, mut losses, mut held, .. } = self;
        let order = if let Some(mut order) = order {
            while let Some((stamp, sequence)) = order.pop(true) {
                losses.push(stamp, sequence);
            }
            losses.late = order.late();
            BagOrder::Window(order.needed())
        } else {
            let order = in_order(&mut marks);
            marks.iter().for_each(|m| losses.push(m.stamp, m.sequence));
            order
        };
        if losses.late > 0 {
            held = None;
        }
        let held = held.map(|mut frames| {
            frames.sort_by_key(|f| f.stamp);
            *memory = memory.saturating_sub(self.bytes);
            Arc::new(frames)
        });
        Found { marks, losses, source: Source { held, bag: Some(BagFrames { order, ..bag }) } }
    }
}

/// Sorts marks; how they lie in the bag.
fn in_order(marks: &mut [Mark]) -> BagOrder {
    if marks.is_sorted_by_key(|m| m.stamp) {
        return BagOrder::Stored;
    }
    let mut order: Vec<u32> = (0_u32..).take(marks.len()).collect();
    order.sort_by_key(|i| marks[*i as usize].stamp);
    let mut rank_of = vec![0; order.len()];
    for (rank, i) in (0_u32..).zip(&order) {
        rank_of[*i as usize] = rank;
    }
    marks.sort_by_key(|m| m.stamp);
    BagOrder::Ranks(Arc::new(rank_of))
}

/// The frames of a bag once it was read.
pub(super) struct Found {
    /// In order of acquisition; none where they are too many.
    marks: Vec<Mark>,
    pub(super) losses: Losses,
    pub(super) source: Source,
}

impl Found {
    /// The marks in order of acquisition. Where there are too many to be held, the bag at `path` is read once more.
    pub(super) fn marks<'a>(
        &'a mut self,
        path: &'a Path,
    ) -> Result<Box<dyn Iterator<Item = Result<Mark, LearnError>> + 'a>, LearnError> {
        let streamed = self.source.bag.as_ref().is_some_and(|bag| matches!(bag.order, BagOrder::Window(_)));
        if !streamed {
            return Ok(Box::new(std::mem::take(&mut self.marks).into_iter().map(Ok)));
        }
        let mut flags = SharedFlags::default();
        let mut frames = Frames::open(path, &self.source, false)?;
        Ok(Box::new((0..self.losses.frames).map(move |number| {
            let frame = frames.next(number)?;
            Ok(Mark { stamp: frame.stamp, sequence: frame.sequence, flags: flags.share(&frame.flags) })
        })))
    }
}
