//! All pairs of hypotheses: two causes whose columns overlap look like a third one, which forward steps take first and never leave.
//!
//! Exhaustive search over subsets of two (best-subset selection, Hocking and Leslie 1967) by the same score as forward steps. Cost: some
//! hundred solves, since only the candidates that do best alone or beside what is accepted are paired.

use std::sync::atomic::Ordering;

use super::{Selector, Tier};
use crate::constants::select::PAIRED;

impl Selector<'_> {
    /// The pair that makes a clearly better model than one or two accepted effects, if there is one. Each of it must be needed beside
    /// the other as a second step would have to be.
    pub(super) fn better_pair(&self, set: &[usize]) -> Option<[usize; 2]> {
        if set.is_empty() || set.len() > 2 {
            return None;
        }
        self.calibrate(&set[..1]);
        let now = self.score(set);
        let list = self.paired(set);
        let mut best: Option<([usize; 2], f64)> = None;
        for (n, &a) in list.iter().enumerate() {
            if self.watch.is_some_and(|(stop, _)| stop.load(Ordering::Relaxed)) {
                return None;
            }
            for &b in &list[n + 1..] {
                if set.contains(&a) && set.contains(&b) {
                    continue;
                }
                let score = self.score(&[a, b]);
                if best.is_none_or(|(_, least)| score < least) {
                    best = Some(([a, b], score));
                }
            }
        }
        let (pair, score) = best?;
        // A second effect has to earn its place; another pair has to be told from the one that is accepted.
        let ask = if set.len() == 1 { self.firm() } else { 2.0 * self.options.decisive_odds.ln() };
        let with = self.losses(&pair, Tier::Strict);
        let needed =
            |other: usize| self.gain(&self.losses(&[other], Tier::Strict), &with) >= self.least(&[other]);
        (now - score > ask && needed(pair[0]) && needed(pair[1])).then_some(pair)
    }

    /// Candidates that are paired: those with the best models alone, and beside each accepted effect.
    fn paired(&self, set: &[usize]) -> Vec<usize> {
        let ranked = |beside: &[usize]| {
            let with = |e: usize| -> Vec<usize> { beside.iter().copied().chain([e]).collect() };
            let mut all: Vec<(f64, usize)> = (0..self.candidates.len())
                .filter(|e| !beside.contains(e))
                .map(|e| (self.score(&with(e)), e))
                .collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0));
            all.into_iter().map(|(_, e)| e).take(PAIRED)
        };
        let mut found = set.to_vec();
        found.extend(ranked(&[]));
        for accepted in set {
            found.extend(ranked(&[*accepted]));
        }
        found.sort_unstable();
        found.dedup();
        found
    }
}
