//! Order statistics for what people read.

use std::collections::VecDeque;

use serde::Serialize;

/// Collects numbers and answers percentiles; NaN is ignored.
#[derive(Debug, Clone)]
pub struct Samples {
    values: VecDeque<f64>,
    most: usize,
}

impl Default for Samples {
    fn default() -> Self {
        Self::last(usize::MAX)
    }
}

impl Samples {
    /// Keeps the last `most` numbers only.
    #[must_use]
    pub fn last(most: usize) -> Self {
        Self { values: VecDeque::new(), most: most.max(1) }
    }

    /// Adds one number.
    pub fn push(&mut self, value: f64) {
        if !value.is_nan() {
            if self.values.len() >= self.most {
                self.values.pop_front();
            }
            self.values.push_back(value);
        }
    }

    /// How many.
    #[must_use]
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Nearest-rank percentile, `p` in 0..=100; NaN where there are no numbers.
    #[must_use]
    pub fn percentile(&self, p: f64) -> f64 {
        if self.values.is_empty() {
            return f64::NAN;
        }
        let rank = (p / 100.0 * self.values.len() as f64).ceil() as usize;
        let index = rank.clamp(1, self.values.len()) - 1;
        // The order of arrival stays as it is.
        let mut values: Vec<f64> = self.values.iter().copied().collect();
        *values.select_nth_unstable_by(index, f64::total_cmp).1
    }
}

/// Percentiles of a quantity; NaN where there are no numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// The median.
    pub p50: f64,
    /// 90 % are no larger.
    pub p90: f64,
    /// 99 % are no larger.
    pub p99: f64,
}

impl From<&Samples> for Spread {
    fn from(samples: &Samples) -> Self {
        let [p50, p90, p99] = [50.0, 90.0, 99.0].map(|p| samples.percentile(p));
        Self { p50, p90, p99 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_sorted_numbers() {
        let mut s = Samples::default();
        for v in [5.0, 1.0, f64::NAN, 3.0, 2.0, 4.0] {
            s.push(v);
        }
        assert_eq!(s.len(), 5);
        assert_eq!((s.percentile(0.0), s.percentile(50.0), s.percentile(100.0)), (1.0, 3.0, 5.0));
        assert!(Samples::default().percentile(50.0).is_nan());
        let mut last = Samples::last(2);
        for v in [9.0, 1.0, 2.0] {
            last.push(v);
        }
        assert_eq!((last.len(), last.percentile(100.0)), (2, 2.0));
    }
}
