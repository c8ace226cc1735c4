//! Parts of a data set for cross-validation.

use std::collections::BTreeMap;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// 0 to `count` − 1 in an order that `seed` draws.
#[must_use]
pub fn shuffled(count: usize, seed: u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    order
}

/// Which of `count` folds each row belongs to. Rows of one group, e.g. presses at one place, stay together, and folds have
/// equally many groups, or one more.
#[must_use]
pub fn folds(groups: &[usize], count: usize, seed: u64) -> Vec<usize> {
    let mut known: BTreeMap<usize, usize> = groups.iter().map(|g| (*g, 0)).collect();
    let order = shuffled(known.len(), seed);
    for (fold, place) in known.values_mut().zip(order) {
        *fold = place % count.max(1);
    }
    groups.iter().map(|g| known[g]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_stay_together_and_folds_are_even() {
        let groups: Vec<usize> = (0..60).map(|i| i / 3 * 7).collect();
        let fold = folds(&groups, 5, 3);
        for three in fold.chunks(3) {
            assert!(three.iter().all(|f| *f == three[0]));
        }
        for k in 0..5 {
            assert_eq!(fold.iter().filter(|f| **f == k).count(), 12);
        }
        assert_eq!(fold, folds(&groups, 5, 3));
        assert_ne!(fold, folds(&groups, 5, 4));
    }
}
