//! Gaussian process regression.
//!
//! Problem: the mean of a function given noisy values of it, where values of rows that are alike are alike. Method: the posterior mean of a
//! Gaussian process with a stationary kernel and independent noise, α = (K + λI)⁻¹ t by Cholesky's decomposition (C. E. Rasmussen and C. K.
//! I. Williams, *Gaussian Processes for Machine Learning*, 2006, algorithm 2.1); only the mean, hence only the ratio λ of noise to signal
//! matters. All outputs share kernel and noise. Assumptions: noise of one size for all rows. Cost: n³/3 operations and n² numbers for n
//! rows, which should be some thousands at most; an answer takes n kernels.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::svr::{common, squared_distances};
use crate::{Kernel, KernelExpansion, RegressError, Rows, Standard};

/// Settings. Inputs and targets are standardised before, so that they mean the same for every skin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GaussianSettings {
    /// Similarity of rows.
    pub kernel: Kernel,
    /// γ of the kernel times the number of inputs, so that it means the same for few and for many.
    pub gamma: f64,
    /// λ: variance of the noise over that of the function.
    pub noise: f64,
}

impl Default for GaussianSettings {
    fn default() -> Self {
        Self { kernel: Kernel::Matern, gamma: 0.3, noise: 1e-3 }
    }
}

/// Fits every column of `targets`.
///
/// # Errors
///
/// [`RegressError`] where the tables do not have equally many rows, a setting is out of its range, or the noise is too small for rows
/// that are alike.
pub fn gaussian_process(
    inputs: Rows<'_>,
    targets: Rows<'_>,
    settings: &GaussianSettings,
) -> Result<KernelExpansion, RegressError> {
    for (name, value) in [("gamma", settings.gamma), ("noise", settings.noise)] {
        if !(value.is_finite() && value > 0.0) {
            return Err(RegressError::Setting { name, value, must: "a positive number" });
        }
    }
    let (n, width, outputs) = (inputs.count(), inputs.width(), targets.width());
    if targets.count() != n {
        return Err(RegressError::Size { what: "the table of targets", found: targets.count(), expected: n });
    }
    let standard = Standard::of(&inputs);
    let mut supports = Vec::with_capacity(n * width);
    inputs.iter().for_each(|row| standard.push(row, &mut supports));
    let gamma = settings.gamma / width as f64;
    let distances = squared_distances(&supports, width);
    let mut kernel = DMatrix::from_fn(n, n, |i, j| settings.kernel.at(gamma, distances[i * n + j]));
    (0..n).for_each(|i| kernel[(i, i)] += settings.noise);
    let must = "large enough that rows which are alike can differ";
    let small = RegressError::Setting { name: "noise", value: settings.noise, must };
    let factor = kernel.cholesky().ok_or(small)?;
    let (centre, scale) = common(&targets);
    let mut weights = Vec::with_capacity(outputs * n);
    for (k, middle) in centre.iter().enumerate() {
        let column = DVector::from_iterator(n, targets.iter().map(|row| (row[k] - middle) / scale));
        weights.extend(factor.solve(&column).iter().map(|w| w * scale));
    }
    Ok(KernelExpansion { standard, kernel: settings.kernel, gamma, supports, weights, bias: centre })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_points_have_a_closed_form() {
        // Standardised inputs ±1, targets ±t about their mean: α = ±t / (1 + λ − k), k = exp(−4γ).
        let (inputs, targets) = ([3.0, 5.0], [1.0, 7.0]);
        let s = GaussianSettings { kernel: Kernel::Gaussian, gamma: 0.5, noise: 0.1 };
        let rows = Rows::new(&inputs, 1, "inputs").unwrap();
        let fitted = gaussian_process(rows, Rows::new(&targets, 1, "targets").unwrap(), &s).unwrap();
        let k = (-2.0_f64).exp();
        let alpha = 3.0 / (1.1 - k);
        approx::assert_relative_eq!(fitted.weights[1], alpha, max_relative = 1e-12);
        approx::assert_relative_eq!(fitted.weights[0], -alpha, max_relative = 1e-12);
        let answer = fitted.predict(&[5.0]).unwrap()[0];
        approx::assert_relative_eq!(answer, 4.0 + alpha * (1.0 - k), max_relative = 1e-12);
        approx::assert_relative_eq!(fitted.predict(&[4.0]).unwrap()[0], 4.0, max_relative = 1e-12);
        assert!(fitted.predict(&[1.0, 2.0]).is_err());
    }

    #[test]
    fn it_learns_a_curve() {
        let inputs: Vec<f64> = (0..60).map(|i| f64::from(i) * 0.1).collect();
        let targets: Vec<f64> = inputs.iter().flat_map(|x| [x.sin(), 7.0 + 0.1 * x.cos()]).collect();
        let rows = Rows::new(&inputs, 1, "inputs").unwrap();
        for kernel in [Kernel::Gaussian, Kernel::Matern] {
            let s = GaussianSettings { kernel, gamma: 1.0, noise: 1e-6 };
            let fitted = gaussian_process(rows, Rows::new(&targets, 2, "targets").unwrap(), &s).unwrap();
            for x in [0.33, 2.02, 4.44] {
                let out = fitted.predict(&[x]).unwrap();
                assert!((out[0] - x.sin()).abs() < 1e-3, "{kernel:?} {x}: {out:?}");
                assert!((out[1] - 7.0 - 0.1 * x.cos()).abs() < 1e-3, "{kernel:?} {x}: {out:?}");
            }
        }
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let rows = Rows::new(&[0.0, 1.0], 1, "inputs").unwrap();
        let refused = |noise: f64| {
            let s = GaussianSettings { noise, ..GaussianSettings::default() };
            gaussian_process(rows, rows, &s).unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused(0.0), @"setting `noise` is 0 and must be a positive number");
    }
}
