//! Sequence numbers: gaps, duplicates, late frames, restarts of the device.

use super::DecoderStats;

/// Frames that a late one may be behind; datagrams overtake each other by a few, not by more.
const LATE_WINDOW: u32 = 32;
/// Late frames in unbroken order that are taken for a device that started again.
const LATE_RUN: u32 = 4;
/// A gap as wide as this (hours of frames) is not a loss that means anything.
const MAX_GAP: u32 = 1_000_000;

/// What to do with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Hand it out under this unwrapped number.
    Accept(u64),
    /// Drop it; it is counted.
    Drop,
}

/// Unwraps the 32-bit sequence of a device into a 64-bit one that only ever grows.
#[derive(Debug, Clone, Default)]
pub(super) struct SequenceTracker {
    latest: Option<Latest>,
    /// Number of the last late frame, and how many came in unbroken order.
    late_run: Option<(u32, u32)>,
}

#[derive(Debug, Clone, Copy)]
struct Latest {
    sequence: u32,
    unwrapped: u64,
    time_us: Option<u64>,
}

impl SequenceTracker {
    pub(super) fn classify(
        &mut self,
        sequence: u32,
        time_us: Option<u64>,
        stats: &mut DecoderStats,
    ) -> Verdict {
        let Some(latest) = self.latest else {
            return self.accept(sequence, u64::from(sequence), time_us);
        };
        let ahead = sequence.wrapping_sub(latest.sequence);
        let time_went_back = matches!((time_us, latest.time_us), (Some(now), Some(then)) if now < then);
        if ahead == 0 && time_us == latest.time_us {
            stats.duplicates += 1;
            return Verdict::Drop;
        }
        if ahead == 0 || (ahead < 1 << 31 && (time_went_back || ahead > MAX_GAP)) {
            return self.restart(latest, sequence, time_us, stats);
        }
        if ahead < 1 << 31 {
            stats.lost += u64::from(ahead - 1);
            return self.accept(sequence, latest.unwrapped + u64::from(ahead), time_us);
        }
        // Behind the latest: a late frame, or a device that started again. A device counts from 0.
        let behind = ahead.wrapping_neg();
        let run = match self.late_run {
            Some((last, run)) if sequence == last.wrapping_add(1) => run + 1,
            _ => 1,
        };
        let time_went_on = matches!((time_us, latest.time_us), (Some(now), Some(then)) if now > then);
        if sequence == 0 || behind > LATE_WINDOW || run >= LATE_RUN || time_went_on {
            return self.restart(latest, sequence, time_us, stats);
        }
        self.late_run = Some((sequence, run));
        stats.late += 1;
        Verdict::Drop
    }

    fn restart(
        &mut self,
        latest: Latest,
        sequence: u32,
        time_us: Option<u64>,
        stats: &mut DecoderStats,
    ) -> Verdict {
        stats.restarts += 1;
        self.accept(sequence, latest.unwrapped + 1, time_us)
    }

    fn accept(&mut self, sequence: u32, unwrapped: u64, time_us: Option<u64>) -> Verdict {
        self.latest = Some(Latest { sequence, unwrapped, time_us });
        self.late_run = None;
        Verdict::Accept(unwrapped)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn run(frames: &[(u32, u64)]) -> (Vec<u64>, DecoderStats) {
        let mut tracker = SequenceTracker::default();
        let mut stats = DecoderStats::new(64);
        let mut out = Vec::new();
        for (sequence, time) in frames {
            if let Verdict::Accept(n) = tracker.classify(*sequence, Some(*time), &mut stats) {
                out.push(n);
            }
        }
        (out, stats)
    }

    #[test]
    fn wraps_without_a_loss() {
        let (out, stats) = run(&[(u32::MAX - 1, 10), (u32::MAX, 20), (0, 30), (1, 40)]);
        let first = u64::from(u32::MAX) - 1;
        assert_eq!(out, [first, first + 1, first + 2, first + 3]);
        assert_eq!((stats.lost, stats.restarts), (0, 0));
    }

    #[test]
    fn counts_gaps_duplicates_and_late_frames() {
        let (out, stats) = run(&[(5, 50), (8, 80), (7, 70), (8, 80), (9, 90)]);
        assert_eq!(out, [5, 8, 9]);
        assert_eq!((stats.lost, stats.late, stats.duplicates, stats.restarts), (2, 1, 1, 0));
    }

    #[test]
    fn a_restart_goes_on_counting() {
        let (out, stats) = run(&[(5000, 50_000), (5001, 50_010), (0, 3), (1, 13), (2, 23)]);
        assert_eq!(out, [5000, 5001, 5002, 5003, 5004]);
        assert_eq!((stats.restarts, stats.lost), (1, 0));
    }

    #[test]
    fn a_restart_soon_after_start_whose_first_frame_is_lost_is_found() {
        let (out, stats) = run(&[(20, 200), (21, 210), (1, 10), (2, 20), (3, 30), (4, 40), (5, 50)]);
        assert_eq!(out, [20, 21, 22, 23]);
        assert_eq!((stats.restarts, stats.late), (1, 3));
    }

    #[test]
    fn a_restart_beyond_half_the_range_is_no_loss_of_billions() {
        let (_, stats) = run(&[(3_000_000_000, 9_000_000), (0, 10)]);
        assert_eq!((stats.restarts, stats.lost), (1, 0));
    }

    #[test]
    fn a_restart_ahead_of_where_it_was_is_found_by_its_time() {
        let (out, stats) = run(&[(100, 100_000), (150, 1500), (151, 1510)]);
        assert_eq!(out, [100, 101, 102]);
        assert_eq!((stats.restarts, stats.lost), (1, 0));
    }

    proptest! {
        #[test]
        fn unwrapped_numbers_only_grow(frames in proptest::collection::vec((any::<u32>(), any::<u64>()), 0..60)) {
            let (out, _) = run(&frames);
            prop_assert!(out.windows(2).all(|w| w[0] < w[1]));
        }

        #[test]
        fn handed_out_lost_add_up(start in any::<u32>(), lost in proptest::collection::vec(any::<bool>(), 2..200)) {
            let sent: Vec<(u32, u64)> = (0u32..).zip(&lost)
                .filter(|(i, lost)| *i == 0 || !**lost)
                .map(|(i, _)| (start.wrapping_add(i), 1000 + 10 * u64::from(i))).collect();
            let (out, stats) = run(&sent);
            prop_assert_eq!(out.len(), sent.len());
            prop_assert_eq!(stats.lost + out.len() as u64, out[out.len() - 1] - out[0] + 1);
        }
    }
}
