//! The numbers of dense networks: products of matrices, what stands between layers, losses and steps.
//!
//! They stand by themselves because nearly all of the time of training is spent here: this crate is built for speed, and what prepares and
//! reports a training, which is a hundred times as much code, for size.

use serde::{Deserialize, Serialize};

/// Non-linearity of the hidden layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// x · logistic(x).
    #[default]
    Silu,
    /// Hyperbolic tangent.
    Tanh,
    /// Positive part.
    Relu,
}

impl Activation {
    /// In place; `slopes` becomes the derivative.
    pub fn apply(self, values: &mut [f32], slopes: &mut Vec<f32>) {
        slopes.clear();
        slopes.extend(values.iter_mut().map(|v| {
            let z = *v;
            match self {
                Self::Silu => {
                    let gate = 1.0 / (1.0 + (-z).exp());
                    *v = z * gate;
                    gate * (1.0 + z * (1.0 - gate))
                }
                Self::Tanh => {
                    *v = z.tanh();
                    1.0 - *v * *v
                }
                Self::Relu => {
                    *v = z.max(0.0);
                    f32::from(u8::from(z > 0.0))
                }
            }
        }));
    }
}

/// c = a · b, or c += a · b.
#[derive(Debug, Clone, Copy)]
pub struct Product {
    /// Rows of a and c.
    pub rows: usize,
    /// Columns of a, rows of b.
    pub inner: usize,
    /// Columns of b and c.
    pub columns: usize,
    /// Adds to what is in c.
    pub keep: bool,
}

impl Product {
    /// Matrices come with the distance between rows and between columns; c is row-major.
    ///
    /// # Panics
    ///
    /// Where a slice is shorter than its matrix.
    pub fn run(self, a: &[f32], a_steps: [usize; 2], b: &[f32], b_steps: [usize; 2], c: &mut [f32]) {
        let Self { rows, inner, columns, keep } = self;
        let reach = |rows: usize, columns: usize, steps: [usize; 2]| {
            (rows.max(1) - 1) * steps[0] + (columns.max(1) - 1) * steps[1] + 1
        };
        assert!(a.len() >= reach(rows, inner, a_steps) || rows * inner == 0, "a is too short");
        assert!(b.len() >= reach(inner, columns, b_steps) || inner * columns == 0, "b is too short");
        assert!(c.len() >= rows * columns, "c is too short");
        let [ars, acs, brs, bcs, crs] =
            [a_steps[0], a_steps[1], b_steps[0], b_steps[1], columns].map(usize::cast_signed);
        // SAFETY: every index that the product reads or writes lies in its slice, as asserted above, and c is
        // borrowed mutably, so that it overlaps neither a nor b.
        unsafe {
            matrixmultiply::sgemm(
                rows,
                inner,
                columns,
                1.0,
                a.as_ptr(),
                ars,
                acs,
                b.as_ptr(),
                brs,
                bcs,
                if keep { 1.0 } else { 0.0 },
                c.as_mut_ptr(),
                crs,
                1,
            );
        }
    }
}

/// Adds up rows that lie end to end into `sums`, which is as long as one.
pub fn sum_rows(rows: &[f32], sums: &mut [f32]) {
    sums.fill(0.0);
    for row in rows.chunks_exact(sums.len()) {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += value;
        }
    }
}

/// Multiplies element by element.
pub fn multiply(values: &mut [f32], factors: &[f32]) {
    for (value, factor) in values.iter_mut().zip(factors) {
        *value *= factor;
    }
}

/// Mean over samples of the summed squared errors, cross entropy for a logit, and its gradient by the outputs.
/// Unknown targets (NaN) do not count; targets without a weight have the weight 1.
#[must_use]
pub fn loss(
    answers: &[f32],
    (targets, weights): (&[f32], &[f32]),
    outputs: usize,
    logit: bool,
) -> (f32, Vec<f32>) {
    let share = outputs as f32 / answers.len() as f32;
    let mut sum = 0.0;
    let slopes = answers
        .iter()
        .zip(targets)
        .enumerate()
        .map(|(i, (z, t))| {
            let weight = weights.get(i).copied().unwrap_or(1.0);
            if t.is_nan() {
                0.0
            } else if logit && i % outputs == outputs - 1 {
                // ln(1 + e^z) − t z, written so that no exponential overflows.
                sum += weight * (z.max(0.0) + (-z.abs()).exp().ln_1p() - t * z);
                weight * (1.0 / (1.0 + (-z).exp()) - t) * share
            } else {
                sum += weight * (z - t) * (z - t);
                2.0 * weight * (z - t) * share
            }
        })
        .collect();
    (sum * share, slopes)
}

/// A step of Adam with decoupled decay (D. P. Kingma and J. Ba, 2015; I. Loshchilov and F. Hutter, 2019).
#[derive(Debug, Clone, Copy)]
pub struct Adam {
    /// Steps with this one.
    pub step: u64,
    /// Learning rate.
    pub rate: f64,
    /// Share of a parameter that goes in a step, over the rate.
    pub decay: f64,
    /// Decay of the first moment; that of the second one is 0.999.
    pub momentum: f64,
}

impl Adam {
    /// Moves parameters; `moments` are the running mean and mean square of their gradient.
    pub fn step(self, parameters: &mut [f32], gradient: &[f32], moments: [&mut [f32]; 2]) {
        let beta = [self.momentum as f32, 0.999];
        let step = i32::try_from(self.step).unwrap_or(i32::MAX);
        let [c1, c2] = beta.map(|b| 1.0 - f64::from(b).powi(step));
        let (scale, root) = ((self.rate / c1) as f32, (1.0 / c2.sqrt()) as f32);
        let keep = (1.0 - self.rate * self.decay) as f32;
        let [first, second] = moments;
        for (((p, g), m), v) in parameters.iter_mut().zip(gradient).zip(first).zip(second) {
            *m += (1.0 - beta[0]) * (g - *m);
            *v += (1.0 - beta[1]) * (g * g - *v);
            *p = *p * keep - scale * *m / (v.sqrt() * root + 1e-8);
        }
    }
}
