//! The loops.

use pulp::{Simd, WithSimd};

use super::{Binary, Step, Unary};

/// All steps of a plan, one after the other.
pub(super) struct Steps<'a> {
    pub steps: &'a [Step],
    pub values: &'a mut [f32],
}

impl WithSimd for Steps<'_> {
    type Output = ();

    // Plain loops: inlined, they are compiled for the instructions of each kind of processor.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for step in self.steps {
            run(step, self.values);
        }
    }
}

#[inline(always)]
fn run(step: &Step, values: &mut [f32]) {
    // A step's places lie before what it writes.
    let (before, after) = values.split_at_mut(step.to().start);
    match step {
        Step::Product { from, weights, bias, to } => {
            let out = &mut after[..to.len()];
            match bias {
                Some(bias) => out.copy_from_slice(&before[bias.clone()]),
                None => out.fill(0.0),
            }
            product(&before[from.clone()], weights, out);
        }
        Step::Binary { how, a, b, to } => {
            let (a, b, out) = (&before[a.clone()], &before[b.clone()], &mut after[..to.len()]);
            match how {
                Binary::Add => binary(a, b, out, |a, b| a + b),
                Binary::Sub => binary(a, b, out, |a, b| a - b),
                Binary::Mul => binary(a, b, out, |a, b| a * b),
                Binary::Div => binary(a, b, out, |a, b| a / b),
            }
        }
        Step::Unary { how, from, to } => {
            let (x, out) = (&before[from.clone()], &mut after[..to.len()]);
            match how {
                // NaN stays NaN.
                Unary::Relu => unary(x, out, |x| if x < 0.0 { 0.0 } else { x }),
                Unary::Sigmoid => unary(x, out, sigmoid),
                Unary::Silu => unary(x, out, |x| x * sigmoid(x)),
                Unary::Tanh => unary(x, out, tanh),
                Unary::Exp => unary(x, out, exp),
                Unary::Log => unary(x, out, f32::ln),
                Unary::Sqrt => unary(x, out, f32::sqrt),
                Unary::Neg => unary(x, out, |x| -x),
                Unary::Abs => unary(x, out, f32::abs),
            }
        }
        Step::Sum { from, .. } => after[0] = before[from.clone()].iter().sum(),
        Step::Copy { from, to } => after[..to.len()].copy_from_slice(&before[from.clone()]),
    }
}

/// Adds `x · weights` to `out`; `weights` has a row of `out`'s length for each number of `x`.
#[inline(always)]
fn product(x: &[f32], weights: &[f32], out: &mut [f32]) {
    let n = out.len();
    let (fours, rest) = x.as_chunks::<4>();
    let blocks = weights.chunks_exact(4 * n);
    let singles = blocks.remainder();
    for ([a, b, c, d], block) in fours.iter().zip(blocks) {
        let (wa, block) = block.split_at(n);
        let (wb, block) = block.split_at(n);
        let (wc, wd) = block.split_at(n);
        for ((((out, wa), wb), wc), wd) in out.iter_mut().zip(wa).zip(wb).zip(wc).zip(wd) {
            *out += (a * wa + b * wb) + (c * wc + d * wd);
        }
    }
    for (x, row) in rest.iter().zip(singles.chunks_exact(n)) {
        out.iter_mut().zip(row).for_each(|(out, w)| *out += x * w);
    }
}

#[inline(always)]
fn binary(a: &[f32], b: &[f32], out: &mut [f32], how: impl Fn(f32, f32) -> f32) {
    match (a, b) {
        ([a], b) => out.iter_mut().zip(b).for_each(|(out, b)| *out = how(*a, *b)),
        (a, [b]) => out.iter_mut().zip(a).for_each(|(out, a)| *out = how(*a, *b)),
        (a, b) => out.iter_mut().zip(a).zip(b).for_each(|((out, a), b)| *out = how(*a, *b)),
    }
}

#[inline(always)]
fn unary(x: &[f32], out: &mut [f32], how: impl Fn(f32) -> f32) {
    out.iter_mut().zip(x).for_each(|(out, x)| *out = how(*x));
}

#[inline(always)]
pub(super) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

#[inline(always)]
pub(super) fn tanh(x: f32) -> f32 {
    1.0 - 2.0 / (1.0 + exp(2.0 * x))
}

/// eˣ without a branch, so that loops over it become vector instructions; limited to what a 32-bit float can hold.
#[inline(always)]
pub(super) fn exp(x: f32) -> f32 {
    /// Added to a number below 2²², it leaves the nearest whole number in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    /// ln 2 in two parts, of which the first has few enough bits for exact products.
    const LN2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    // NaN goes through.
    let x = if x > 88.0 { 88.0 } else { x };
    let x = if x < -87.0 { -87.0 } else { x };
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let whole = shifted - ROUND;
    let r = (x - whole * LN2[0]) - whole * LN2[1];
    // Of (eʳ − 1 − r)/r² for |r| ≤ ln 2/2: the Taylor polynomial, whose first term that is left out is below 2⁻²⁶.
    let tail = 0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r / 5040.0))));
    let power = shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23;
    f32::from_bits(power) * (1.0 + r + r * r * tail)
}
