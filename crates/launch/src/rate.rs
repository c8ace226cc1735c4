//! How many lines a process may print: a token bucket for each.
//!
//! A process that prints an error with every frame would fill a disk and hide what others say. It may print a burst, then
//! so many lines a second; what it prints beyond is left out and counted.

use std::time::{Duration, Instant};

/// \[s\] of the allowed rate that may come at once.
const BURST: f64 = 10.0;

/// Lines that may be printed now.
#[derive(Debug)]
pub(crate) struct Bucket {
    /// \[1/s\]; 0 is without limit.
    rate: f64,
    left: f64,
    filled: Option<Instant>,
}

impl Bucket {
    /// `rate` \[lines/s\]; 0 is without limit.
    pub(crate) fn new(rate: f64) -> Self {
        Self { rate, left: rate * BURST, filled: None }
    }

    /// Whether a line may be printed at `now`; it is counted as printed then.
    pub(crate) fn take(&mut self, now: Instant) -> bool {
        if self.rate <= 0.0 {
            return true;
        }
        let passed = self.filled.map_or(Duration::ZERO, |at| now.saturating_duration_since(at));
        self.filled = Some(now);
        // At least one line, where the rate is less than one in ten seconds.
        self.left = (self.left + passed.as_secs_f64() * self.rate).min((self.rate * BURST).max(1.0));
        if self.left < 1.0 {
            return false;
        }
        self.left -= 1.0;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(bucket: &mut Bucket, from: Instant, seconds: u64, per_second: u64) -> u64 {
        let step = Duration::from_secs(1) / u32::try_from(per_second).unwrap();
        (0..seconds * per_second)
            .map(|i| u64::from(bucket.take(from + step * u32::try_from(i).unwrap())))
            .sum()
    }

    #[test]
    fn a_flood_is_cut_to_a_burst_and_the_rate() {
        let (mut bucket, start) = (Bucket::new(100.0), Instant::now());
        let first = taken(&mut bucket, start, 12, 2000);
        assert!((2190..=2200).contains(&first), "{first} lines of a flood of 24,000 in 12 s");
        let rest = start + Duration::from_secs(112);
        assert_eq!(taken(&mut bucket, rest, 10, 90), 900, "who keeps to the rate loses nothing");
        assert_eq!(taken(&mut Bucket::new(0.0), start, 1, 5000), 5000, "0 is without limit");
        assert!(taken(&mut Bucket::new(0.01), start, 300, 10) >= 3, "a low rate is one, too");
    }
}
