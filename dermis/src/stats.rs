//! Order statistics for what people read.

/// Collects numbers and answers percentiles; NaN is ignored.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    values: Vec<f64>,
}

impl Samples {
    /// Adds one number.
    pub fn push(&mut self, value: f64) {
        if !value.is_nan() {
            self.values.push(value);
        }
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Nearest-rank percentile, `p` in 0..=100; NaN where there are no numbers.
    pub fn percentile(&mut self, p: f64) -> f64 {
        if self.values.is_empty() {
            return f64::NAN;
        }
        let rank = (p / 100.0 * self.values.len() as f64).ceil() as usize;
        let index = rank.clamp(1, self.values.len()) - 1;
        *self.values.select_nth_unstable_by(index, f64::total_cmp).1
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
    }
}
