//! Counts what is missing of numbered messages.
//!
//! Problem: a bus may lose messages without telling anybody. Publishers of `rmw_zenoh` number what they publish, and a
//! taxel frame carries the number that its device gave it; a step of more than one is a loss. But messages also come late,
//! twice (the history that a latched topic keeps for late joiners), and from publishers that count from the start again, and
//! none of that is a loss.
//!
//! Method: [`SequenceTracker`] follows one sender. It keeps its highest number and the gaps below it. A number that falls into
//! a gap was late and takes itself off the count. Any other number that is not above the highest is judged by its time: where
//! it was sent after the highest one, the sender counts from the start again; otherwise it has come before. Without times, a lower
//! number starts the count again, unless the number after the highest one follows: then it was late. The first message
//! of a sender is where counting begins: what went before it was never meant for this receiver. [`LossCounter`] does so for
//! several senders.
//!
//! Cost: a comparison for each message in order. Memory is bounded: of very many gaps the oldest are no longer watched for
//! late messages (they stay counted), and of very many senders those that were silent longest are forgotten.

use std::borrow::Borrow;
use std::collections::{HashMap, VecDeque};
use std::hash::Hash;

/// Gaps of a sender that are watched for late messages.
const GAPS: usize = 1024;
/// Senders that are followed at the same time.
const SENDERS: usize = 256;
/// Numbers and times are given out one after the other: of messages that are sent at once by two threads, the one with the
/// lower number may have the later time.
const SLACK_NS: i64 = 100_000_000;

/// What a number says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// The first of its sender.
    First,
    /// The one after the highest.
    Next,
    /// So many are missing before it.
    After(u64),
    /// It was missing: it came late, after a higher number.
    Late,
    /// It has come before, or is older than what was requested (history).
    Repeated,
    /// The sender counts from this number on again.
    Restarted,
}

/// Follows the numbers of one sender.
#[derive(Debug, Clone, Default)]
pub struct SequenceTracker {
    /// The highest number and when it was sent.
    highest: Option<(u64, Option<i64>)>,
    /// When the sender last began to count again: what it sent before may still arrive.
    since: Option<i64>,
    /// The highest number before a lower one came that no time tells from a start.
    doubted: Option<u64>,
    /// First and last number of each gap below the highest, in rising order.
    gaps: VecDeque<(u64, u64)>,
    missing: u64,
}

impl SequenceTracker {
    /// A message with this number came, sent at `sent_ns` by the sender's clock where that is known.
    pub fn observe(&mut self, number: u64, sent_ns: Option<i64>) -> Arrival {
        let Some((highest, highest_ns)) = self.highest else {
            self.highest = Some((number, sent_ns));
            return Arrival::First;
        };
        if self.doubted.take().is_some_and(|before| number == before + 1) {
            self.highest = Some((number, sent_ns));
            return Arrival::Next;
        }
        if number > highest {
            let before_restart = matches!((sent_ns, self.since), (Some(sent), Some(since)) if sent < since);
            if number > highest + 1 && before_restart {
                return Arrival::Repeated;
            }
            self.highest = Some((number, sent_ns));
            let lost = number - highest - 1;
            if lost == 0 {
                return Arrival::Next;
            }
            if self.gaps.len() == GAPS {
                self.gaps.pop_front();
            }
            self.gaps.push_back((highest + 1, number - 1));
            self.missing = self.missing.saturating_add(lost);
            return Arrival::After(lost);
        }
        let newer = match (sent_ns, highest_ns) {
            (Some(sent), Some(newest)) => sent > newest.saturating_add(SLACK_NS),
            _ => false,
        };
        if !newer && self.fill(number) {
            self.missing -= 1;
            return Arrival::Late;
        }
        let timed = sent_ns.is_some() && highest_ns.is_some();
        if !newer && (timed || number == highest) {
            return Arrival::Repeated;
        }
        self.doubted = (!timed).then_some(highest);
        self.highest = Some((number, sent_ns));
        self.since = sent_ns;
        self.gaps.clear();
        Arrival::Restarted
    }

    /// Takes a number out of the gaps, where it is in one.
    fn fill(&mut self, number: u64) -> bool {
        let at = self.gaps.partition_point(|&(_, last)| last < number);
        let Some(&(first, last)) = self.gaps.get(at).filter(|(first, _)| *first <= number) else {
            return false;
        };
        self.gaps.remove(at);
        if number < last {
            self.gaps.insert(at, (number + 1, last));
        }
        if first < number {
            self.gaps.insert(at, (first, number - 1));
        }
        true
    }

    /// How many numbers are missing so far.
    #[must_use]
    pub fn missing(&self) -> u64 {
        self.missing
    }
}

/// What several senders together lost on the way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Losses {
    /// Messages that are missing, by the numbers of their senders.
    pub lost: u64,
    /// Messages that came with a number.
    pub numbered: u64,
    /// Messages that came without: whether others of their senders were lost is not known.
    pub unnumbered: u64,
}

impl Losses {
    /// How many were lost; `None` where nothing came that would tell.
    #[must_use]
    pub fn known(&self) -> Option<u64> {
        (self.numbered > 0).then_some(self.lost)
    }
}

struct Sender {
    tracker: SequenceTracker,
    heard: u64,
}

/// Follows the numbers of several senders, distinguished by `K`.
pub struct LossCounter<K> {
    senders: HashMap<K, Sender>,
    losses: Losses,
}

impl<K> Default for LossCounter<K> {
    fn default() -> Self {
        Self { senders: HashMap::new(), losses: Losses::default() }
    }
}

impl<K> std::fmt::Debug for LossCounter<K> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LossCounter").field("losses", &self.losses).finish_non_exhaustive()
    }
}

impl<K: Eq + Hash + Clone> LossCounter<K> {
    /// A message of this sender came; as [`SequenceTracker::observe`].
    pub fn observe<Q>(&mut self, sender: &Q, number: u64, sent_ns: Option<i64>) -> Arrival
    where
        K: Borrow<Q>,
        Q: Eq + Hash + ToOwned<Owned = K> + ?Sized,
    {
        self.losses.numbered += 1;
        let heard = self.losses.numbered;
        if !self.senders.contains_key(sender) {
            self.forget();
            self.senders.insert(sender.to_owned(), Sender { tracker: SequenceTracker::default(), heard });
        }
        let Some(known) = self.senders.get_mut(sender) else { return Arrival::First };
        known.heard = heard;
        let before = known.tracker.missing();
        let arrival = known.tracker.observe(number, sent_ns);
        self.losses.lost = self.losses.lost.saturating_add(known.tracker.missing()).saturating_sub(before);
        arrival
    }

    /// A message without a number came.
    pub fn observe_unnumbered(&mut self) {
        self.losses.unnumbered += 1;
    }

    fn forget(&mut self) {
        if self.senders.len() < SENDERS {
            return;
        }
        if let Some(silent) = self.senders.iter().min_by_key(|(_, s)| s.heard).map(|(key, _)| key.clone()) {
            self.senders.remove(&silent);
        }
    }

    /// What is missing so far.
    #[must_use]
    pub fn losses(&self) -> Losses {
        self.losses
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Numbers with the second in which they were sent.
    fn all(numbers: &[(u64, i64)]) -> (Vec<Arrival>, u64) {
        let mut tracker = SequenceTracker::default();
        let mut observe = |&(number, second)| tracker.observe(number, Some(second * 1_000_000_000));
        let arrivals = numbers.iter().map(&mut observe).collect();
        (arrivals, tracker.missing())
    }

    #[test]
    fn a_step_is_a_loss_and_a_late_one_takes_it_back() {
        use Arrival::{After, First, Late, Next, Repeated};
        let (arrivals, missing) = all(&[(7, 7), (8, 8), (12, 12), (10, 10), (10, 10), (13, 13), (9, 9)]);
        assert_eq!(arrivals, [First, Next, After(3), Late, Repeated, Next, Late]);
        assert_eq!(missing, 1);
    }

    #[test]
    fn history_before_the_first_is_no_loss() {
        // A live message overtakes the history that was requested, of which one comes twice.
        let (arrivals, missing) = all(&[(100, 100), (98, 98), (99, 99), (99, 99), (101, 101)]);
        use Arrival::{First, Next, Repeated};
        assert_eq!(arrivals, [First, Repeated, Repeated, Repeated, Next]);
        assert_eq!(missing, 0);
    }

    #[test]
    fn a_sender_that_counts_again_has_lost_nothing() {
        let (arrivals, missing) = all(&[(100, 100), (0, 101), (1, 102), (99, 99), (102, 99), (4, 105)]);
        use Arrival::{After, First, Next, Repeated, Restarted};
        assert_eq!(arrivals, [First, Restarted, Next, Repeated, Repeated, After(2)]);
        assert_eq!(missing, 2);
        // Without times, what was not missing and is not new counts again.
        let mut tracker = SequenceTracker::default();
        for (number, arrival) in
            [(5, First), (8, After(2)), (7, Arrival::Late), (8, Repeated), (0, Restarted)]
        {
            assert_eq!(tracker.observe(number, None), arrival, "{number}");
        }
    }

    /// A live message may overtake one of the history; a frame that has no stamp does not tell so by its time.
    #[test]
    fn one_that_comes_late_without_a_time_is_no_start() {
        use Arrival::{After, First, Next, Restarted};
        let mut tracker = SequenceTracker::default();
        for (number, arrival) in
            [(8, First), (7, Restarted), (9, Next), (0, Restarted), (1, Next), (10, After(8))]
        {
            assert_eq!(tracker.observe(number, None), arrival, "{number}");
        }
        assert_eq!(tracker.missing(), 8);
    }

    #[test]
    fn senders_are_distinguished_and_kept_within_bounds() {
        let mut counter = LossCounter::default();
        for round in 0..10_u64 {
            for sender in 0..1000_u64 {
                counter.observe(&(sender % 2), round * 1000 + sender, Some(0));
                counter.observe(&(1000 + sender), round * 2, None);
            }
        }
        assert!(counter.senders.len() <= SENDERS);
        // Senders 0 and 1 each send every other number.
        assert_eq!(counter.losses().lost, 9998);
        counter.observe_unnumbered();
        let Losses { numbered, unnumbered, .. } = counter.losses();
        assert_eq!((numbered, unnumbered), (20_000, 1));
        assert_eq!(Losses::default().known(), None);
    }

    proptest! {
        /// Whatever is left out, repeated and moved by a few places: what is missing between the first that came and the
        /// highest is counted exactly.
        #[test]
        fn the_count_is_that_of_the_numbers_which_never_came(
            drops in prop::collection::vec(prop::bool::weighted(0.2), 2..400),
            moves in prop::collection::vec(0..6_usize, 400),
            again in prop::collection::vec(prop::bool::weighted(0.1), 400),
        ) {
            let kept: Vec<u64> = (0..drops.len() as u64).filter(|&i| i == 0 || !drops[i as usize]).collect();
            let mut sent: Vec<(usize, u64)> = kept.iter().map(|&n| (n as usize + moves[n as usize], n)).collect();
            // The first stays the first: it is where counting begins.
            sent[0].0 = 0;
            sent.sort();
            let mut tracker = SequenceTracker::default();
            for &(_, number) in &sent {
                for _ in 0..=usize::from(again[number as usize]) {
                    let time = i64::try_from(number).ok();
                    prop_assert_ne!(tracker.observe(number, time), Arrival::Restarted);
                }
            }
            let highest = kept.iter().max().copied().unwrap_or(0);
            prop_assert_eq!(tracker.missing(), highest + 1 - kept.len() as u64);
        }
    }
}
