//! How long to wait before a process that ended is started again.

use std::time::Duration;

use serde::Deserialize;

use crate::file::loose;

/// How long to wait before a process that ended is started again: not at all at first, then twice as long each time up to
/// a bound, from the beginning after it has run for a while.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Backoff {
    /// Restarts in a row that are not waited for: a crash after a long run is over at once, and a loop of crashes is slowed.
    #[serde(deserialize_with = "loose")]
    pub at_once: u32,
    /// \[s\] before the first restart after those.
    #[serde(deserialize_with = "loose")]
    pub first: f64,
    /// \[s\] longest wait.
    #[serde(deserialize_with = "loose")]
    pub most: f64,
    /// \[s\] of running after which earlier restarts are forgotten.
    #[serde(deserialize_with = "loose")]
    pub stable: f64,
    /// Restarts in a row after which it is given up.
    #[serde(deserialize_with = "loose")]
    pub limit: u32,
}

impl Default for Backoff {
    fn default() -> Self {
        Self { at_once: 1, first: 0.5, most: 30.0, stable: 10.0, limit: 10 }
    }
}

/// Longest time that a file may ask for \[s\]: a day.
const LONGEST: f64 = 86_400.0;

impl Backoff {
    /// The field that cannot be used, and why.
    pub(crate) fn fault(&self) -> Option<(&'static str, String)> {
        for (name, value) in [("first", self.first), ("most", self.most), ("stable", self.stable)] {
            if let Some(reason) = bad_seconds(value) {
                return Some((name, reason));
            }
        }
        (self.most < self.first).then(|| {
            ("most", format!("{} s is less than the first wait of {} s; raise it", self.most, self.first))
        })
    }
}

/// Why a number is no time that a file may ask for.
pub(crate) fn bad_seconds(value: f64) -> Option<String> {
    (!(0.0..=LONGEST).contains(&value))
        .then(|| format!("{value} is no time; give seconds from 0 to {LONGEST}"))
}

/// Restarts of one process.
#[derive(Debug, Default)]
pub(crate) struct Restarts {
    in_a_row: u32,
}

impl Restarts {
    /// The wait before the next start of a process that ran for `ran`, or `None` where it is given up.
    pub(crate) fn next(&mut self, backoff: &Backoff, ran: Duration) -> Option<Duration> {
        if ran.as_secs_f64() >= backoff.stable {
            self.in_a_row = 0;
        }
        if self.in_a_row >= backoff.limit {
            return None;
        }
        let waited_for = self.in_a_row.checked_sub(backoff.at_once);
        self.in_a_row += 1;
        let Some(waited_for) = waited_for else { return Some(Duration::ZERO) };
        let doubled = backoff.first * 2f64.powi(waited_for.min(60) as i32);
        Some(Duration::from_secs_f64(doubled.clamp(0.0, backoff.most)))
    }

    /// Restarts since it last ran for long.
    pub(crate) fn in_a_row(&self) -> u32 {
        self.in_a_row
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn waits_double_up_to_the_bound_and_end_at_the_limit() {
        let backoff = Backoff { at_once: 0, first: 0.5, most: 3.0, stable: 10.0, limit: 5 };
        let waits = |backoff: &Backoff| -> Vec<f64> {
            let mut restarts = Restarts::default();
            std::iter::from_fn(|| restarts.next(backoff, Duration::from_secs(1)))
                .map(|wait| wait.as_secs_f64())
                .collect()
        };
        assert_eq!(waits(&backoff), [0.5, 1.0, 2.0, 3.0, 3.0]);
        assert_eq!(waits(&Backoff { at_once: 2, ..backoff.clone() }), [0.0, 0.0, 0.5, 1.0, 2.0]);
        let usual = waits(&Backoff::default());
        assert_eq!(
            usual,
            [0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0],
            "a loop of crashes is slowed"
        );
    }

    #[test]
    fn a_crash_after_a_stable_run_is_the_first_one_again() {
        let (backoff, mut restarts) = (Backoff::default(), Restarts::default());
        let mut next = |ran| restarts.next(&backoff, Duration::from_secs_f64(ran)).unwrap().as_secs_f64();
        assert_eq!(
            [next(0.1), next(0.1), next(9.9), next(10.0), next(60.0), next(1.0)],
            [0.0, 0.5, 1.0, 0.0, 0.0, 0.5]
        );
    }

    proptest! {
        #[test]
        fn any_usable_backoff_waits_within_its_bounds(
            at_once in 0..5u32, first in 0.0..100.0f64, more in 0.0..100.0f64, stable in 0.0..100.0f64, limit in 0..200u32,
            runs in prop::collection::vec(0.0..200.0f64, 0..300),
        ) {
            let backoff = Backoff { at_once, first, most: first + more, stable, limit };
            prop_assert!(backoff.fault().is_none());
            let mut restarts = Restarts::default();
            let mut row = 0;
            for ran in runs {
                row = if ran >= stable { 0 } else { row };
                match restarts.next(&backoff, Duration::from_secs_f64(ran)) {
                    Some(wait) => {
                        let wait = wait.as_secs_f64();
                        let least = if row < at_once { 0.0 } else { first };
                        prop_assert!(row < limit && wait >= least - 1e-6 && wait <= first + more + 1e-6);
                        prop_assert!(row >= at_once || wait == 0.0);
                        row += 1;
                    }
                    None => prop_assert!(row >= limit),
                }
            }
        }
    }

    #[test]
    fn times_that_are_none_are_refused() {
        for bad in [f64::NAN, -1.0, f64::INFINITY, 1e9] {
            assert!(Backoff { stable: bad, ..Backoff::default() }.fault().is_some(), "{bad}");
        }
        let (field, reason) = Backoff { first: 2.0, most: 1.0, ..Backoff::default() }.fault().unwrap();
        insta::assert_snapshot!(format!("{field}: {reason}"), @"most: 1 s is less than the first wait of 2 s; raise it");
    }
}
