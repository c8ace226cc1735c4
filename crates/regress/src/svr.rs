//! ε-support vector regression with radial basis functions.
//!
//! The dual problem in n unknowns β = α − α*, of which one of α and α* is 0: minimise ½βᵀKβ − tᵀβ + ε‖β‖₁ with Σβ = 0 and
//! |β| ≤ C. Two unknowns at a time are changed, the first by how much it violates the conditions of the optimum, the second
//! by what the pair gains to second order (R.-E. Fan, P.-H. Chen, C.-J. Lin, *Working set selection using second order
//! information for training support vector machines*, JMLR 6, 2005).

use serde::{Deserialize, Serialize};

use crate::{Kernel, KernelExpansion, RegressError, Rows, Standard};

/// Settings. Inputs and targets are standardised before, so that they mean the same for every skin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SvrSettings {
    /// What a target outside of the tube costs: the larger, the closer the fit.
    pub c: f64,
    /// Half width of the tube in which an error costs nothing, as a share of the targets' spread.
    pub epsilon: f64,
    /// γ of exp(−γ‖a − b‖²) times the number of inputs, so that it means the same for few and for many.
    pub gamma: f64,
    /// Violation of the optimum that is left, as a share of the targets' spread.
    pub tolerance: f64,
    /// Changes of two unknowns after which the search ends; what is found then is near the optimum.
    pub most_steps: usize,
}

impl Default for SvrSettings {
    fn default() -> Self {
        Self { c: 30.0, epsilon: 0.003, gamma: 3.0, tolerance: 5e-3, most_steps: 100_000 }
    }
}

impl SvrSettings {
    fn check(&self) -> Result<(), RegressError> {
        let positive = [("c", self.c), ("gamma", self.gamma), ("tolerance", self.tolerance)];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(RegressError::Setting { name, value, must: "a positive number" });
            }
        }
        if !(self.epsilon.is_finite() && self.epsilon >= 0.0) {
            return Err(RegressError::Setting { name: "epsilon", value: self.epsilon, must: "at least 0" });
        }
        Ok(())
    }
}

/// Solution of the dual problem: `f(x) = Σ weights[i] k(x, x_i) + bias`.
#[derive(Debug, Clone, PartialEq)]
pub struct Dual {
    /// One a row; 0 for those that support nothing.
    pub weights: Vec<f64>,
    /// Constant part.
    pub bias: f64,
    /// Changes that it took.
    pub steps: usize,
}

/// Kernel matrix exp(−γd) of squared distances d, row by row.
#[must_use]
pub fn gram(squared_distances: &[f64], gamma: f64) -> Vec<f64> {
    squared_distances.iter().map(|d| (-gamma * d).exp()).collect()
}

/// Solves the dual problem for the symmetric n × n `kernel` (ones on its diagonal) and n targets. `epsilon` and `tolerance`
/// of the settings are in units of the targets here; `gamma` is not read.
///
/// # Panics
///
/// Where `kernel` is not n × n.
#[must_use]
pub fn solve(kernel: &[f64], targets: &[f64], settings: &SvrSettings) -> Dual {
    let n = targets.len();
    assert_eq!(kernel.len(), n * n, "the kernel matrix belongs to other targets");
    let SvrSettings { c, epsilon, tolerance, most_steps, .. } = *settings;
    let mut weights = vec![0.0; n];
    // t − Kβ: what is left of each target, but for the constant.
    let mut left = targets.to_vec();
    let mut steps = 0;
    loop {
        // What the constant would be if this unknown could still grow, or shrink.
        let (mut up, mut first, mut down) = (f64::NEG_INFINITY, 0, f64::INFINITY);
        for i in 0..n {
            let (w, u) = (weights[i], left[i]);
            if w < c {
                let value = if w < 0.0 { u + epsilon } else { u - epsilon };
                if value > up {
                    (up, first) = (value, i);
                }
            }
            if w > -c {
                let value = if w > 0.0 { u - epsilon } else { u + epsilon };
                down = down.min(value);
            }
        }
        if up - down <= tolerance || steps >= most_steps || n == 0 {
            let bias = if n == 0 { 0.0 } else { f64::midpoint(up, down) };
            return Dual { weights, bias, steps };
        }
        let row = &kernel[first * n..(first + 1) * n];
        let (mut best, mut second, mut gap) = (f64::NEG_INFINITY, usize::MAX, 0.0);
        for j in 0..n {
            let w = weights[j];
            if w <= -c || j == first {
                continue;
            }
            let value = if w > 0.0 { left[j] - epsilon } else { left[j] + epsilon };
            let violation = up - value;
            if violation <= 0.0 {
                continue;
            }
            let gain = violation * violation / (2.0 - 2.0 * row[j]).max(1e-12);
            if gain > best {
                (best, second, gap) = (gain, j, violation);
            }
        }
        if second == usize::MAX {
            // Only the first itself violates: nothing can be exchanged.
            return Dual { weights, bias: f64::midpoint(up, down), steps };
        }
        let mut by = gap / (2.0 - 2.0 * row[second]).max(1e-12);
        // As far as the next kink or end of either.
        let room = if weights[first] < 0.0 { -weights[first] } else { c - weights[first] };
        let other = if weights[second] > 0.0 { weights[second] } else { c + weights[second] };
        by = by.min(room).min(other);
        weights[first] = settle(weights[first] + by, c);
        weights[second] = settle(weights[second] - by, c);
        let column = &kernel[second * n..(second + 1) * n];
        for ((l, a), b) in left.iter_mut().zip(row).zip(column) {
            *l -= by * (a - b);
        }
        steps += 1;
    }
}

/// Rounding must not keep an unknown from lying on a kink or an end.
fn settle(weight: f64, c: f64) -> f64 {
    let tiny = 1e-13 * c;
    if weight.abs() < tiny {
        0.0
    } else if c - weight.abs() < tiny {
        c.copysign(weight)
    } else {
        weight
    }
}

/// A fitted regression for all outputs.
#[derive(Debug, Clone)]
pub struct Svr {
    standard: Standard,
    gamma: f64,
    /// Standardised inputs that any output is supported by.
    supports: Vec<f64>,
    /// Of every output: one a support.
    weights: Vec<Vec<f64>>,
    bias: Vec<f64>,
    /// What targets were reduced by and divided by; the divisor is one for all, so that their units stay alike.
    centre: Vec<f64>,
    scale: f64,
}

impl Svr {
    /// Fits every column of `targets`.
    ///
    /// # Errors
    ///
    /// [`RegressError`] where the tables do not have equally many rows, or a setting is out of its range.
    pub fn fit(inputs: Rows<'_>, targets: Rows<'_>, settings: &SvrSettings) -> Result<Self, RegressError> {
        settings.check()?;
        let (n, width, outputs) = (inputs.count(), inputs.width(), targets.width());
        if targets.count() != n {
            return Err(RegressError::Size {
                what: "the table of targets",
                found: targets.count(),
                expected: n,
            });
        }
        let standard = Standard::of(&inputs);
        let mut scaled = Vec::with_capacity(n * width);
        inputs.iter().for_each(|row| standard.push(row, &mut scaled));
        let gamma = settings.gamma / width as f64;
        let kernel = gram(&squared_distances(&scaled, width), gamma);
        let (centre, scale) = common(&targets);
        let mut duals = Vec::with_capacity(outputs);
        for k in 0..outputs {
            let column: Vec<f64> = targets.iter().map(|row| (row[k] - centre[k]) / scale).collect();
            duals.push(solve(&kernel, &column, settings));
        }
        let support: Vec<usize> = (0..n).filter(|i| duals.iter().any(|d| d.weights[*i] != 0.0)).collect();
        Ok(Self {
            standard,
            gamma,
            supports: support.iter().flat_map(|i| &scaled[i * width..(i + 1) * width]).copied().collect(),
            weights: duals.iter().map(|d| support.iter().map(|i| d.weights[*i]).collect()).collect(),
            bias: duals.iter().map(|d| d.bias).collect(),
            centre,
            scale,
        })
    }

    /// Rows that support the regression.
    #[must_use]
    pub fn supports(&self) -> usize {
        self.supports.len() / self.standard.mean.len()
    }

    /// Mean of every input among the rows that were learnt: what a reading that is missing is best replaced by.
    #[must_use]
    pub fn means(&self) -> &[f64] {
        &self.standard.mean
    }

    /// What a graph needs to compute it.
    #[must_use]
    pub fn into_expansion(self) -> KernelExpansion {
        let bias = self.bias.iter().zip(&self.centre).map(|(b, c)| b * self.scale + c).collect();
        KernelExpansion {
            standard: self.standard,
            kernel: Kernel::Gaussian,
            gamma: self.gamma,
            supports: self.supports,
            weights: self.weights.into_iter().flatten().map(|w| w * self.scale).collect(),
            bias,
        }
    }

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
        let mut out = self.bias.clone();
        for (i, support) in self.supports.chunks_exact(width).enumerate() {
            let distance: f64 = scaled.iter().zip(support).map(|(a, b)| (a - b) * (a - b)).sum();
            let near = (-self.gamma * distance).exp();
            for (o, weights) in out.iter_mut().zip(&self.weights) {
                *o += weights[i] * near;
            }
        }
        Ok(out.iter().zip(&self.centre).map(|(o, c)| o * self.scale + c).collect())
    }
}

/// Mean of every column, and the largest of their spreads.
pub(crate) fn common(targets: &Rows<'_>) -> (Vec<f64>, f64) {
    let standard = Standard::of(targets);
    let spread = |k: usize| {
        let mean = standard.mean[k];
        (targets.iter().map(|row| (row[k] - mean).powi(2)).sum::<f64>() / targets.count() as f64).sqrt()
    };
    let largest = (0..targets.width()).map(spread).fold(0.0, f64::max);
    (standard.mean, if largest > 0.0 { largest } else { 1.0 })
}

/// Squared distances between all rows, row by row.
#[must_use]
pub fn squared_distances(values: &[f64], width: usize) -> Vec<f64> {
    let n = values.len() / width;
    let mut out = vec![0.0; n * n];
    for (i, a) in values.chunks_exact(width).enumerate() {
        for (j, b) in values.chunks_exact(width).enumerate().take(i) {
            let d: f64 = a.iter().zip(b).map(|(p, q)| (p - q) * (p - q)).sum();
            out[i * n + j] = d;
            out[j * n + i] = d;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn settings(c: f64, epsilon: f64) -> SvrSettings {
        SvrSettings { c, epsilon, tolerance: 1e-6, ..SvrSettings::default() }
    }

    /// Conditions of the optimum, from the definition of the primal problem.
    fn optimal(kernel: &[f64], targets: &[f64], dual: &Dual, s: &SvrSettings) {
        let n = targets.len();
        assert!(dual.weights.iter().sum::<f64>().abs() < 1e-9 * s.c * n as f64);
        for i in 0..n {
            let answer: f64 = (0..n).map(|j| kernel[i * n + j] * dual.weights[j]).sum::<f64>() + dual.bias;
            let (error, w) = (targets[i] - answer, dual.weights[i]);
            let slack = 1e-4;
            // Inside of the tube nothing pulls, outside all that may does, and to the right side.
            if error.abs() < s.epsilon - slack {
                assert_eq!(w, 0.0, "row {i}: {error}");
            }
            if error.abs() > s.epsilon + slack {
                assert!((w - s.c.copysign(error)).abs() < 1e-9 * s.c, "row {i}: {error} {w}");
            }
            assert!(w == 0.0 || w.signum() == error.signum());
        }
    }

    #[test]
    fn two_points_have_a_closed_form() {
        // Symmetric targets ±t: both weights are ±(t − ε)/(1 − k), the constant 0.
        let k = 0.3;
        let dual = solve(&[1.0, k, k, 1.0], &[2.0, -2.0], &settings(100.0, 0.5));
        approx::assert_relative_eq!(dual.weights[0], 1.5 / (1.0 - k), epsilon = 1e-9);
        approx::assert_relative_eq!(dual.weights[1], -1.5 / (1.0 - k), epsilon = 1e-9);
        assert!(dual.bias.abs() < 1e-9);
        // C holds them back.
        assert_eq!(solve(&[1.0, k, k, 1.0], &[2.0, -2.0], &settings(1.0, 0.5)).weights, [1.0, -1.0]);
    }

    #[test]
    fn it_learns_a_curve_and_its_outputs_apart() {
        let inputs: Vec<f64> = (0..60).map(|i| f64::from(i) * 0.1).collect();
        let targets: Vec<f64> = inputs.iter().flat_map(|x| [x.sin(), 7.0 + 0.01 * x.cos()]).collect();
        let rows = Rows::new(&inputs, 1, "inputs").unwrap();
        let s = SvrSettings { gamma: 3.0, c: 100.0, epsilon: 0.005, ..SvrSettings::default() };
        let svr = Svr::fit(rows, Rows::new(&targets, 2, "targets").unwrap(), &s).unwrap();
        for x in [0.33, 2.02, 4.44] {
            let out = svr.predict(&[x]).unwrap();
            assert!((out[0] - f64::sin(x)).abs() < 0.02 && (out[1] - 7.0).abs() < 0.03, "{x}: {out:?}");
        }
        assert!(svr.supports() < 60 && svr.predict(&[1.0, 2.0]).is_err());
        let answer = svr.predict(&[2.5]).unwrap();
        let expanded = svr.into_expansion().predict(&[2.5]).unwrap();
        assert!(answer.iter().zip(&expanded).all(|(a, b)| (a - b).abs() < 1e-12), "{answer:?} {expanded:?}");
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let (inputs, targets) = ([0.0, 1.0], [0.0, 1.0, 2.0, 3.0]);
        let rows = Rows::new(&inputs, 1, "inputs").unwrap();
        let two = Rows::new(&targets, 2, "targets").unwrap();
        let refused = |s: SvrSettings| Svr::fit(rows, two, &s).unwrap_err().to_string();
        insta::assert_snapshot!(refused(SvrSettings { c: f64::NAN, ..SvrSettings::default() }), @"setting `c` is NaN and must be a positive number");
        insta::assert_snapshot!(refused(SvrSettings { epsilon: -1.0, ..SvrSettings::default() }), @"setting `epsilon` is -1 and must be at least 0");
        let four = Rows::new(&targets, 1, "targets").unwrap();
        insta::assert_snapshot!(Svr::fit(rows, four, &SvrSettings::default()).unwrap_err(), @"the table of targets has 4 numbers where 2 belong");
    }

    proptest! {
        #[test]
        fn the_optimum_is_reached(
            points in proptest::collection::vec((-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64), 2..25),
            c in 0.1..50.0f64,
            epsilon in 0.0..0.3f64,
        ) {
            let inputs: Vec<f64> = points.iter().flat_map(|p| [p.0, p.1]).collect();
            let targets: Vec<f64> = points.iter().map(|p| p.2).collect();
            let kernel = gram(&squared_distances(&inputs, 2), 2.0);
            let s = settings(c, epsilon);
            let dual = solve(&kernel, &targets, &s);
            prop_assume!(dual.steps < s.most_steps);
            optimal(&kernel, &targets, &dual, &s);
        }
    }
}
