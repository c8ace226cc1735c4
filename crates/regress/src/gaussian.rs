//! Gaussian process regression.
//!
//! Problem: the mean of a function given noisy values of it, where values of rows that are alike are alike. Method: the posterior
//! mean of a Gaussian process with a stationary kernel and independent noise, α = (K + λI)⁻¹ t by Cholesky's decomposition (C. E.
//! Rasmussen and C. K. I. Williams, *Gaussian Processes for Machine Learning*, 2006, algorithm 2.1); only the mean, hence only the
//! ratio λ of noise to signal matters. All outputs share kernel and noise. Up to [`EXACT`] rows this is done as it stands; of more
//! rows, a sum over [`SUPPORTS`] of them is fitted to all ([`sparse`]). Assumptions: noise of one size for all rows. Cost: n³/3
//! multiplications and 8n² bytes for n rows, half a gigabyte at most; an answer takes one kernel a support.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, Par};
use serde::{Deserialize, Serialize};

use crate::svr::common;
use crate::{Kernel, KernelExpansion, RegressError, Rows, Standard};

mod sparse;

/// Rows up to which a process is exact, where its settings name no number of supports.
pub const EXACT: usize = 8000;
/// Supports of a process of more rows than [`EXACT`].
pub const SUPPORTS: usize = 2500;

/// Settings. Inputs and targets are standardised before, so that they mean the same for every skin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GaussianSettings {
    /// Similarity of rows.
    pub kernel: Kernel,
    /// γ of the kernel times the number of inputs, so that it means the same for few and for many.
    pub gamma: f64,
    /// λ: variance of the noise over that of the function.
    pub noise: f64,
    /// Rows that answers are a sum over at most; a fit of more rows is sparse. Without it, [`EXACT`] and [`SUPPORTS`] say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub supports: Option<usize>,
}

impl Default for GaussianSettings {
    fn default() -> Self {
        Self { kernel: Kernel::Matern, gamma: 0.3, noise: 1e-3, supports: None }
    }
}

impl GaussianSettings {
    fn check(&self) -> Result<(), RegressError> {
        for (name, value) in [("gamma", self.gamma), ("noise", self.noise)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(RegressError::Setting { name, value, must: "a positive number" });
            }
        }
        match self.supports {
            Some(0) => Err(RegressError::Setting { name: "supports", value: 0.0, must: "at least 1" }),
            _ => Ok(()),
        }
    }

    /// Supports of a sparse fit of so many rows; `None` where the fit is exact.
    fn sparse(&self, rows: usize) -> Option<usize> {
        let (exact, supports) = self.supports.map_or((EXACT, SUPPORTS), |most| (most, most));
        (rows > exact).then_some(supports)
    }
}

/// Fits every column of `targets`.
///
/// # Errors
///
/// [`RegressError`] where the tables do not have equally many rows, a setting is out of its range, or the noise is too small for
/// rows that are alike.
pub fn gaussian_process(
    inputs: Rows<'_>,
    targets: Rows<'_>,
    settings: &GaussianSettings,
) -> Result<KernelExpansion, RegressError> {
    settings.check()?;
    let n = inputs.count();
    if targets.count() != n {
        return Err(RegressError::Size { what: "the table of targets", found: targets.count(), expected: n });
    }
    let (problem, standard) = Problem::new(inputs, targets, settings);
    let must = "large enough that rows which are alike can differ";
    let small = RegressError::Setting { name: "noise", value: settings.noise, must };
    let solved = match settings.sparse(n) {
        Some(most) => sparse::fit(&problem, most),
        None => problem.exact(),
    };
    let (supports, weights) = solved.ok_or(small)?;
    let scaled = weights.col_iter().flat_map(|column| column.iter().map(|w| w * problem.scale));
    Ok(KernelExpansion {
        standard,
        kernel: settings.kernel,
        gamma: problem.gamma,
        weights: scaled.collect(),
        supports,
        bias: problem.centre,
    })
}

/// Standardised rows and targets.
struct Problem {
    rows: Vec<f64>,
    width: usize,
    kernel: Kernel,
    gamma: f64,
    noise: f64,
    /// n × outputs, with mean 0 and a largest spread of 1.
    targets: Mat<f64>,
    centre: Vec<f64>,
    scale: f64,
}

/// Standardised supports one after the other, and their weights, supports × outputs.
type Solved = (Vec<f64>, Mat<f64>);

impl Problem {
    fn new(inputs: Rows<'_>, targets: Rows<'_>, settings: &GaussianSettings) -> (Self, Standard) {
        let (n, width) = (inputs.count(), inputs.width());
        let standard = Standard::of(&inputs);
        let mut rows = Vec::with_capacity(n * width);
        inputs.iter().for_each(|row| standard.push(row, &mut rows));
        let (centre, scale) = common(&targets);
        let scaled = Mat::from_fn(n, targets.width(), |i, k| (targets.row(i)[k] - centre[k]) / scale);
        let GaussianSettings { kernel, noise, .. } = *settings;
        let gamma = settings.gamma / width as f64;
        (Self { rows, width, kernel, gamma, noise, targets: scaled, centre, scale }, standard)
    }

    fn count(&self) -> usize {
        self.targets.nrows()
    }

    fn row(&self, i: usize) -> &[f64] {
        &self.rows[i * self.width..(i + 1) * self.width]
    }

    /// Similarity of two rows.
    fn covariance(&self, i: usize, j: usize) -> f64 {
        let squares = self.row(i).iter().zip(self.row(j)).map(|(a, b)| (a - b) * (a - b)).sum();
        self.kernel.at(self.gamma, squares)
    }

    /// `None` where the noise is too small.
    fn exact(&self) -> Option<Solved> {
        let n = self.count();
        // The upper half is never read.
        let mut factor = Mat::from_fn(n, n, |i, j| match i.cmp(&j) {
            std::cmp::Ordering::Less => 0.0,
            std::cmp::Ordering::Equal => 1.0 + self.noise,
            std::cmp::Ordering::Greater => self.covariance(i, j),
        });
        let mut weights = self.targets.clone();
        solve(&mut factor, &mut weights)?;
        Some((self.rows.clone(), weights))
    }
}

/// Solves for the columns of `right` in place; `matrix` holds the lower half of a positive definite one, and its factor afterwards.
/// `None` where it is not.
fn solve(matrix: &mut Mat<f64>, right: &mut Mat<f64>) -> Option<()> {
    let n = matrix.nrows();
    let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f64>(n, Par::Seq, Default::default()));
    let none = LltRegularization { dynamic_regularization_delta: 0.0, dynamic_regularization_epsilon: 0.0 };
    let stack = MemStack::new(&mut memory);
    cholesky_in_place(matrix.as_mut(), none, Par::Seq, stack, Default::default()).ok()?;
    solve_lower_triangular_in_place(matrix.as_ref(), right.as_mut(), Par::Seq);
    solve_upper_triangular_in_place(matrix.as_ref().transpose(), right.as_mut(), Par::Seq);
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_points_have_a_closed_form() {
        // Standardised inputs ±1, targets ±t about their mean: α = ±t / (1 + λ − k), k = exp(−4γ).
        let (inputs, targets) = ([3.0, 5.0], [1.0, 7.0]);
        let s = GaussianSettings { kernel: Kernel::Gaussian, gamma: 0.5, noise: 0.1, supports: None };
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
            let s = GaussianSettings { kernel, gamma: 1.0, noise: 1e-6, supports: None };
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
