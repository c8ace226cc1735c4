//! Sums of kernels around rows that were learned: what support vectors and Gaussian processes answer with.

use serde::{Deserialize, Serialize};

use crate::{RegressError, Standard};

/// Similarity of two rows at the squared distance d² of their standardised inputs, with the inverse width γ. All begin as 1 − γd².
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kernel {
    /// exp(−γd²): smooth to every order.
    #[default]
    Gaussian,
    /// (1 + s + s²/3) exp(−s) with s = √(6γd²), Matérn's of order 5/2: smooth to the second derivative.
    Matern,
}

impl Kernel {
    /// At a squared distance.
    #[must_use]
    pub fn at(self, gamma: f64, squared_distance: f64) -> f64 {
        let scaled = gamma * squared_distance;
        match self {
            Self::Gaussian => (-scaled).exp(),
            Self::Matern => {
                let s = (6.0 * scaled).sqrt();
                (1.0 + s + s * s / 3.0) * (-s).exp()
            }
        }
    }
}

/// f(x) = W k(γ‖s(x) − xᵢ‖²) + b, where s standardises the inputs. Everything that a graph needs to compute it.
#[derive(Debug, Clone, PartialEq)]
pub struct KernelExpansion {
    /// What inputs are reduced by and divided by.
    pub standard: Standard,
    /// Similarity.
    pub kernel: Kernel,
    /// Its inverse width.
    pub gamma: f64,
    /// n standardised rows, one after the other.
    pub supports: Vec<f64>,
    /// W, outputs × n, in the unit of the targets.
    pub weights: Vec<f64>,
    /// b, one an output, in the unit of the targets.
    pub bias: Vec<f64>,
}

impl KernelExpansion {
    /// The answer to one row, one number an output.
    ///
    /// # Errors
    ///
    /// [`RegressError::Size`] for a row of another width.
    pub fn predict(&self, row: &[f64]) -> Result<Vec<f64>, RegressError> {
        let width = self.standard.mean.len();
        if row.len() != width {
            return Err(RegressError::Size { what: "a row", found: row.len(), expected: width });
        }
        let mut scaled = Vec::with_capacity(width);
        self.standard.push(row, &mut scaled);
        let near: Vec<f64> = self
            .supports
            .chunks_exact(width)
            .map(|support| {
                let squares = scaled.iter().zip(support).map(|(a, b)| (a - b) * (a - b)).sum();
                self.kernel.at(self.gamma, squares)
            })
            .collect();
        let mut out = self.bias.clone();
        if !near.is_empty() {
            for (o, weights) in out.iter_mut().zip(self.weights.chunks_exact(near.len())) {
                *o += weights.iter().zip(&near).map(|(w, k)| w * k).sum::<f64>();
            }
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_begin_alike_and_fall() {
        for kernel in [Kernel::Gaussian, Kernel::Matern] {
            assert_eq!(kernel.at(2.0, 0.0), 1.0);
            // 1 − γd² with γd² = 2e-6; the next term of Matérn's is of the order (γd²)^2.
            assert!((kernel.at(2.0, 1e-6) - (1.0 - 2e-6)).abs() < 1e-9);
            assert!(kernel.at(1.0, 4.0) < kernel.at(1.0, 1.0));
        }
        assert!(Kernel::Matern.at(1.0, 9.0) > Kernel::Gaussian.at(1.0, 9.0));
    }
}
