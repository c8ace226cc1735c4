//! What lies in a bag nearly in the order of its stamps, in that order.
//!
//! Problem: frames and ground truth are stored as they arrived. They are needed in the order of their stamps, in memory that does not
//! grow with the bag. Method: so many wait, and the earliest of them leaves as soon as one more comes (a sort over a sliding window).
//! Assumption: none arrives behind more than [`WINDOW`] later ones; what does is left out and counted. Cost: O(log window) for each.

use std::collections::BTreeMap;

use dermis_skin::Stamp;

/// Of frames, and of messages of ground truth, that wait for earlier ones: ten seconds at 100 Hz.
pub(crate) const WINDOW: usize = 1024;

/// Things that wait for earlier ones.
#[derive(Debug)]
pub(crate) struct InOrder<T> {
    window: usize,
    /// By stamp, those of one stamp in the order of their arrival.
    waiting: BTreeMap<(Stamp, usize), T>,
    arrived: usize,
    left: usize,
    last: Option<Stamp>,
    needed: usize,
    late: usize,
}

impl<T> InOrder<T> {
    /// None so far, of which `window` may wait.
    pub(crate) fn new(window: usize) -> Self {
        Self { window, waiting: BTreeMap::new(), arrived: 0, left: 0, last: None, needed: 0, late: 0 }
    }

    /// Takes the next one of the bag; leaves out what comes too late.
    pub(crate) fn push(&mut self, stamp: Stamp, item: T) {
        if self.last.is_some_and(|last| stamp < last) {
            self.late += 1;
            return;
        }
        self.waiting.insert((stamp, self.arrived), item);
        self.arrived += 1;
    }

    /// The next one in order, where it is known; at the end of the bag it is, as long as any waits.
    pub(crate) fn pop(&mut self, ended: bool) -> Option<(Stamp, T)> {
        if !ended && self.waiting.len() <= self.window {
            return None;
        }
        let ((stamp, arrival), item) = self.waiting.pop_first()?;
        self.needed = self.needed.max(arrival.saturating_sub(self.left));
        self.left += 1;
        self.last = Some(stamp);
        Some((stamp, item))
    }

    /// How many wait.
    pub(crate) fn len(&self) -> usize {
        self.waiting.len()
    }

    /// How many may wait.
    pub(crate) fn window(&self) -> usize {
        self.window
    }

    /// The window that those which left would have needed: with it, the same leave in the same order.
    pub(crate) fn needed(&self) -> usize {
        self.needed
    }

    /// How many were left out.
    pub(crate) fn late(&self) -> usize {
        self.late
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// What leaves, with its place in `stamps`; the window that was needed, and how many were late.
    fn ordered(stamps: &[Stamp], window: usize) -> (Vec<(Stamp, usize)>, usize, usize) {
        let mut order = InOrder::new(window);
        let mut all = Vec::new();
        for (i, stamp) in stamps.iter().enumerate() {
            order.push(*stamp, i);
            while let Some(next) = order.pop(false) {
                all.push(next);
            }
            assert!(order.len() <= window);
        }
        while let Some(next) = order.pop(true) {
            all.push(next);
        }
        (all, order.needed(), order.late())
    }

    proptest! {
        #[test]
        fn the_window_that_was_needed_gives_the_same(
            stamps in proptest::collection::vec(0_i64..60, 0..80), window in 0_usize..20,
        ) {
            let (all, needed, late) = ordered(&stamps, window);
            prop_assert!(all.is_sorted() && needed <= window);
            prop_assert_eq!(all.len() + late, stamps.len());
            prop_assert_eq!(&ordered(&stamps, needed).0, &all);
            // With a wide window, nothing is late, and it is a stable sort.
            let mut sorted: Vec<(Stamp, usize)> = stamps.iter().copied().zip(0..).collect();
            sorted.sort_by_key(|(stamp, _)| *stamp);
            let (all, needed, late) = ordered(&stamps, stamps.len());
            prop_assert_eq!((&all, late), (&sorted, 0));
            prop_assert_eq!(ordered(&stamps, needed).0, sorted);
        }
    }
}
