//! How much of one effect's signature another's holds.

use super::{Statistics, Sum};

/// Products of all columns over all samples.
pub(crate) struct Gram {
    sum: Sum,
}

impl Gram {
    /// Over all groups of these statistics.
    pub(crate) fn of(statistics: &Statistics) -> Self {
        Self { sum: statistics.sum(&vec![1.0; statistics.groups()]) }
    }

    /// Share of the energy of columns `of` that lies in the span of columns `by`.
    pub(crate) fn explained(&self, of: &[usize], by: &[usize]) -> f64 {
        let factor = self.sum.factor(by, |_, g| g * (1.0 + 1e-9) + 1e-12);
        let (mut held, mut all) = (0.0, 0.0);
        for &t in of {
            if let Some(factor) = &factor {
                let b: Vec<f64> = by.iter().map(|&i| self.sum.at(i, t)).collect();
                held += factor.held(&b);
            }
            all += self.sum.diagonal(t);
        }
        if all > 0.0 { held / all } else { 0.0 }
    }
}
