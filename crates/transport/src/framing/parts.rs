//! Frames that come in parts, put together.
//!
//! Problem: a frame of hundreds of channels is longer than a datagram that networks carry whole. A device sends it in parts, each a
//! frame of the wire with a checksum of its own that says which channels of which frame it has; datagrams are lost, overtake each
//! other and come twice. Method: reassembly by the key of a frame (sequence and device time), as of IP fragments (RFC 791, 3.2), with
//! limits in place of timers: at most [`OPEN`] frames are put together at a time, and a frame is given up when a later one is whole.
//! Assumptions: parts of at most [`OPEN`] frames are under way at a time. Cost: one copy of every value, and [`OPEN`] frames of memory.

use std::collections::VecDeque;

use super::DecoderStats;
use super::native::WireFrame;

/// \[bytes\] between the header of a part and its first value.
pub(super) const PART_LEN: usize = 4;
/// Frames that are put together at a time.
const OPEN: usize = 4;
/// Frames that were handed out or given up whose parts are still recognised: datagrams overtake each other by a few, not by more.
const CLOSED: usize = 32;

/// Some channels of a frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Part {
    /// Sequence and time of the frame, and the values of this part.
    pub(super) frame: WireFrame,
    /// As on the wire.
    pub(super) format: u8,
    /// Of the whole frame.
    pub(super) channels: usize,
    /// Channel of the first value.
    pub(super) first: usize,
    /// Which part, from 0, and of how many.
    pub(super) part: u8,
    pub(super) parts: u8,
}

/// What tells a frame from others.
type Key = (u32, Option<u64>);

/// Parts of one frame that do not fit each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the parts of frame {sequence} do not fit each other: they must agree in format, channels and number, and have each channel once"
)]
pub(super) struct Disagreement {
    sequence: u32,
}

/// A frame of which parts are missing.
#[derive(Debug, Clone)]
struct Unfinished {
    key: Key,
    /// Format, channels, and number of parts.
    shape: (u8, usize, u8),
    values: Vec<f32>,
    /// Channels that came.
    filled: Vec<bool>,
    /// Parts that came.
    seen: Vec<bool>,
}

impl Unfinished {
    fn new(part: &Part) -> Self {
        Self {
            key: part.key(),
            shape: part.shape(),
            values: vec![f32::NAN; part.channels],
            filled: vec![false; part.channels],
            seen: vec![false; usize::from(part.parts)],
        }
    }

    fn came(&self) -> usize {
        self.seen.iter().filter(|seen| **seen).count()
    }
}

impl Part {
    fn key(&self) -> Key {
        (self.frame.sequence, self.frame.device_time_us)
    }

    fn shape(&self) -> (u8, usize, u8) {
        (self.format, self.channels, self.parts)
    }
}

/// Puts frames together.
#[derive(Debug, Clone, Default)]
pub(super) struct Assembler {
    /// The oldest first.
    open: VecDeque<Unfinished>,
    /// Handed out or given up, the oldest first.
    closed: VecDeque<Key>,
}

impl Assembler {
    /// Takes a part; `Some` where it was the last one of its frame that lacked.
    pub(super) fn add(
        &mut self,
        part: &Part,
        stats: &mut DecoderStats,
    ) -> Result<Option<WireFrame>, Disagreement> {
        let key = part.key();
        if self.closed.contains(&key) {
            stats.spare_parts += 1;
            return Ok(None);
        }
        let at = match self.open.iter().position(|frame| frame.key == key) {
            Some(at) => at,
            None => {
                while self.open.len() >= OPEN {
                    self.give_up(0, stats);
                }
                self.open.push_back(Unfinished::new(part));
                self.open.len() - 1
            }
        };
        let frame = &mut self.open[at];
        if frame.shape != part.shape() {
            return Err(Disagreement { sequence: key.0 });
        }
        let channels = part.first..part.first + part.frame.values.len();
        if frame.seen[usize::from(part.part)] {
            stats.spare_parts += 1;
            return Ok(None);
        }
        if frame.filled[channels.clone()].contains(&true) {
            return Err(Disagreement { sequence: key.0 });
        }
        frame.seen[usize::from(part.part)] = true;
        frame.filled[channels.clone()].fill(true);
        frame.values[channels].copy_from_slice(&part.frame.values);
        if frame.seen.contains(&false) {
            return Ok(None);
        }
        let whole = !frame.filled.contains(&false);
        let values = std::mem::take(&mut frame.values);
        self.close(at);
        if !whole {
            return Err(Disagreement { sequence: key.0 });
        }
        stats.put_together();
        // What is older would be dropped as late.
        while let Some(at) = self.open.iter().position(|frame| is_before(frame.key.0, key.0)) {
            self.give_up(at, stats);
        }
        Ok(Some(WireFrame { sequence: key.0, device_time_us: key.1, values }))
    }

    /// Something is missing here, or another device sends: parts from before belong to nothing that comes after.
    pub(super) fn gap(&mut self, stats: &mut DecoderStats) {
        while !self.open.is_empty() {
            self.give_up(0, stats);
        }
        self.closed.clear();
    }

    fn give_up(&mut self, at: usize, stats: &mut DecoderStats) {
        if let Some(frame) = self.open.get(at) {
            let came = frame.came() as u64;
            stats.gave_up(came, frame.seen.len() as u64 - came);
        }
        self.close(at);
    }

    fn close(&mut self, at: usize) {
        if let Some(frame) = self.open.remove(at) {
            self.closed.push_back(frame.key);
        }
        if self.closed.len() > CLOSED {
            self.closed.pop_front();
        }
    }
}

/// Whether a sequence number lies before another, which may have wrapped.
fn is_before(sequence: u32, other: u32) -> bool {
    sequence != other && other.wrapping_sub(sequence) < 1 << 31
}

#[cfg(test)]
mod tests;
