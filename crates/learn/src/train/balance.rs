//! Weights by which every range of force counts alike.

use crate::dataset::Truth;
use crate::metrics::{FORCE_BINS, bin_of};

/// Largest factor between the weights of two samples of different force: a range of few samples must not become the
/// noise of every step.
const MOST_BALANCE: f32 = 10.0;

/// How many samples each range of force has.
#[derive(Default)]
pub(super) struct Balance {
    /// Range of every sample; `None` where its force is unknown.
    ranges: Vec<Option<usize>>,
    counts: [usize; FORCE_BINS.len() + 1],
}

impl Balance {
    pub(super) fn push(&mut self, truth: &Truth) {
        let range = match truth.value("force.normal") {
            Some(_) if !truth.touched() => Some(0),
            Some(force) => Some(bin_of(force) + 1),
            None => None,
        };
        if let Some(range) = range {
            self.counts[range] += 1;
        }
        self.ranges.push(range);
    }

    /// Makes every range count alike for the forces; the mean weight stays what it was.
    pub(super) fn apply(&self, outputs: &[&'static str], weights: &mut [f32]) {
        let most = self.counts.iter().copied().max().unwrap_or(0) as f32;
        let factor = |range: usize| (most / self.counts[range] as f32).min(MOST_BALANCE);
        let total: f32 = self.ranges.iter().map(|r| r.map_or(1.0, factor)).sum();
        let mean = total / self.ranges.len().max(1) as f32;
        for (range, row) in self.ranges.iter().zip(weights.chunks_exact_mut(outputs.len())) {
            let factor = range.map_or(1.0, factor) / mean;
            for (weight, _) in row.iter_mut().zip(outputs).filter(|(_, o)| o.starts_with("force.")) {
                *weight *= factor;
            }
        }
    }
}
