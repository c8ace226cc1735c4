//! The frames of a bag while it is read: what stays of them, and what is found out on the way.

use std::sync::Arc;

use dermis_skin::{ChannelFlags, Frame, Stamp};

use super::stream::{BagFrames, SharedFlags, Source};

/// The frames of a bag: marks of all, and the frames themselves while they are few.
#[derive(Default)]
pub(super) struct Recording {
    pub(super) marks: Vec<Mark>,
    pub(super) flags: SharedFlags,
    pub(super) held: Option<Vec<Frame>>,
    /// Bytes that `held` takes.
    pub(super) bytes: usize,
    /// First number that each channel gave.
    pub(super) first: Vec<Option<f32>>,
    /// Whether a channel gave another one.
    pub(super) varies: Vec<bool>,
    /// Frames that have channels that are not healthy.
    pub(super) unhealthy: usize,
}

pub(super) struct Mark {
    pub(super) stamp: Stamp,
    pub(super) sequence: u64,
    pub(super) flags: Arc<[ChannelFlags]>,
}

impl Recording {
    pub(super) fn push(&mut self, frame: Frame, memory: usize) {
        self.unhealthy += usize::from(frame.healthy_channels() < frame.values.len());
        if self.first.len() < frame.values.len() {
            self.first.resize(frame.values.len(), None);
            self.varies.resize(frame.values.len(), false);
        }
        let numbers = frame.values.iter().zip(&mut self.first).zip(&mut self.varies);
        for ((value, first), varies) in numbers.filter(|((v, _), _)| v.is_finite()) {
            *varies |= *first.get_or_insert(*value) != *value;
        }
        let flags = self.flags.share(&frame.flags);
        self.marks.push(Mark { stamp: frame.stamp, sequence: frame.sequence, flags });
        self.bytes += size_of::<Frame>() + frame.values.len() * size_of::<f32>() + frame.flags.len();
        if self.bytes > memory {
            self.held = None;
        } else if let Some(held) = &mut self.held {
            held.push(frame);
        }
    }

    /// Marks in order of acquisition, and where the frames are found in that order: those of `bag`, whose ranks are filled in.
    /// `memory` is left with what they take.
    pub(super) fn finish(self, mut bag: BagFrames, memory: &mut usize) -> (Vec<Mark>, Source) {
        let mut marks = self.marks;
        let held = self.held.map(|mut frames| {
            frames.sort_by_key(|f| f.stamp);
            *memory = memory.saturating_sub(self.bytes);
            Arc::new(frames)
        });
        let mut ranks = None;
        if !marks.is_sorted_by_key(|m| m.stamp) {
            let mut order: Vec<u32> = (0_u32..).take(marks.len()).collect();
            order.sort_by_key(|i| marks[*i as usize].stamp);
            let mut rank_of = vec![0; order.len()];
            for (rank, i) in (0_u32..).zip(&order) {
                rank_of[*i as usize] = rank;
            }
            ranks = Some(Arc::new(rank_of));
            marks.sort_by_key(|m| m.stamp);
        }
        bag.ranks = ranks;
        (marks, Source { held, bag: Some(bag) })
    }
}
