//! Cholesky factor of an arrow of blocks: the blocks of channels first, then the Schur complement of the shared columns.

use super::layout::Split;
use crate::algebra::{backward, forward};

/// Factor of products of columns: channels first, then what is left of the shared ones.
#[derive(Debug, Clone)]
pub struct Factor {
    pub(super) split: Split,
    /// For each channel the factor of its own columns, and the products with the shared ones solved with it.
    pub(super) blocks: Vec<(Vec<f64>, Vec<f64>)>,
    pub(super) corner: Vec<f64>,
    pub(super) count: usize,
}

impl Factor {
    /// Coefficients for these scores, in the order of the columns that were factored.
    #[must_use]
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let s = self.split.shared.len();
        let mut shared: Vec<f64> = self.split.shared.iter().map(|&(at, _)| b[at]).collect();
        let mut parts = Vec::with_capacity(self.blocks.len());
        for ((_, of), (own, side)) in self.split.own.iter().zip(&self.blocks) {
            let m = of.len();
            let mut y: Vec<f64> = of.iter().map(|&(at, _)| b[at]).collect();
            if y.iter().any(|v| *v != 0.0) {
                forward(own, m, &mut y);
                for (x, row) in shared.iter_mut().zip(side.chunks_exact(m)) {
                    *x -= row.iter().zip(&y).map(|(a, b)| a * b).sum::<f64>();
                }
            }
            parts.push(y);
        }
        forward(&self.corner, s, &mut shared);
        backward(&self.corner, s, &mut shared);
        let mut found = vec![0.0; self.count];
        for (&(at, _), x) in self.split.shared.iter().zip(&shared) {
            found[at] = *x;
        }
        for (((_, of), (own, side)), mut y) in self.split.own.iter().zip(&self.blocks).zip(parts) {
            let m = of.len();
            for (x, row) in shared.iter().zip(side.chunks_exact(m)) {
                y.iter_mut().zip(row).for_each(|(y, r)| *y -= x * r);
            }
            backward(own, m, &mut y);
            for (&(at, _), x) in of.iter().zip(&y) {
                found[at] = *x;
            }
        }
        found
    }

    /// Energy that columns with these scores hold: scores times coefficients.
    #[must_use]
    pub fn held(&self, b: &[f64]) -> f64 {
        let s = self.split.shared.len();
        let mut shared: Vec<f64> = self.split.shared.iter().map(|&(at, _)| b[at]).collect();
        let mut held = 0.0;
        let mut y: Vec<f64> = Vec::new();
        for ((_, of), (own, side)) in self.split.own.iter().zip(&self.blocks) {
            let m = of.len();
            y.clear();
            y.extend(of.iter().map(|&(at, _)| b[at]));
            if y.iter().all(|v| *v == 0.0) {
                continue;
            }
            forward(own, m, &mut y);
            held += y.iter().map(|v| v * v).sum::<f64>();
            for (x, row) in shared.iter_mut().zip(side.chunks_exact(m)) {
                *x -= row.iter().zip(&y).map(|(a, b)| a * b).sum::<f64>();
            }
        }
        forward(&self.corner, s, &mut shared);
        held + shared.iter().map(|v| v * v).sum::<f64>()
    }
}
