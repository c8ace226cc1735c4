//! Dense networks as one straight sequence of loops.
//!
//! *Problem.* A network of a skin has some ten thousand weights, and each of its tensors is one row of numbers. A runtime for any
//! graph looks its operators up, allocates their results and walks its plan for each frame; on such graphs that takes longer than the
//! arithmetic.
//!
//! *Method.* When a model is loaded, its graph is translated to steps over one buffer: every tensor has a place in it, constants
//! among them, each step reads places before the one that it writes, and `x · sigmoid(x)` is one step (operator fusion). Products of
//! a row with a matrix add the matrix' rows, four at a time; all loops are compiled for the vector instructions of each kind of
//! processor, and `pulp` chooses among them.
//!
//! *Assumptions.* What the translation does not know, it does not translate: such a graph stays with the general runtime. So does one
//! whose translation does not answer as that runtime does, up to rounding ([`Plan::agrees`]).
//!
//! *Cost.* Each weight is read once per row; nothing is allocated.
//!
//! Exponentials follow Cody and Waite (1980): the argument is reduced by a multiple of ln 2, the rest goes through a polynomial whose
//! relative error is below 2⁻²³.

mod kernels;
mod translate;

use std::ops::Range;

use crate::interface::Interface;
use crate::onnx::Graph;

/// Numbers of all tensors of a graph together, at most. A graph of a few operators could ask for any number.
const MOST: usize = 1 << 20;

/// One loop.
#[derive(Debug, Clone, PartialEq)]
enum Step {
    /// A row times a matrix, plus a row.
    Product { from: Range<usize>, weights: Vec<f32>, bias: Option<Range<usize>>, to: Range<usize> },
    /// Of two rows, of which one may be a single number.
    Binary { how: Binary, a: Range<usize>, b: Range<usize>, to: Range<usize> },
    /// Of each number.
    Unary { how: Unary, from: Range<usize>, to: Range<usize> },
    /// The sum of a row.
    Sum { from: Range<usize>, to: usize },
    /// A row again.
    Copy { from: Range<usize>, to: Range<usize> },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Binary {
    Add,
    Sub,
    Mul,
    Div,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unary {
    Relu,
    Sigmoid,
    /// `x · sigmoid(x)`.
    Silu,
    Tanh,
    Exp,
    Log,
    Sqrt,
    Neg,
    Abs,
}

impl Step {
    /// Where its result is.
    fn to(&self) -> Range<usize> {
        match self {
            Self::Product { to, .. }
            | Self::Binary { to, .. }
            | Self::Unary { to, .. }
            | Self::Copy { to, .. } => to.clone(),
            Self::Sum { to, .. } => *to..to + 1,
        }
    }

    /// What it reads.
    fn from(&self) -> [Option<&Range<usize>>; 2] {
        match self {
            Self::Product { from, bias, .. } => [Some(from), bias.as_ref()],
            Self::Binary { a, b, .. } => [Some(a), Some(b)],
            Self::Unary { from, .. } | Self::Sum { from, .. } | Self::Copy { from, .. } => [Some(from), None],
        }
    }
}

/// A graph whose every tensor is a row of numbers, ready to run.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// All tensors: those that go in, then constants and results.
    values: Vec<f32>,
    steps: Vec<Step>,
    /// How many numbers go in.
    inputs: usize,
    /// Where what comes out lies.
    outputs: Vec<Range<usize>>,
    arch: pulp::Arch,
}

impl Plan {
    /// Translates a graph; `None` where it holds something else than rows, or an operator that has no step.
    pub(crate) fn translate(bytes: &[u8], interface: &Interface) -> Option<Self> {
        translate::plan(&Graph::read(bytes)?, interface)
    }

    /// Evaluates it; what comes out is appended.
    pub(crate) fn run(&mut self, input: &[f32], output: &mut Vec<f32>) {
        let Self { values, steps, inputs, outputs, arch } = self;
        values[..*inputs].copy_from_slice(input);
        arch.dispatch(kernels::Steps { steps, values });
        for range in outputs {
            output.extend_from_slice(&values[range.clone()]);
        }
    }

    /// Whether it answers `answers` to the rows of `inputs`, both end to end, up to `rounding` of the largest number that comes out in
    /// the same place.
    pub(crate) fn agrees(&mut self, inputs: &[f32], answers: &[f32], rounding: f32) -> bool {
        let mut ours = Vec::with_capacity(answers.len());
        inputs.chunks_exact(self.inputs).for_each(|row| self.run(row, &mut ours));
        let length: usize = self.outputs.iter().map(Range::len).sum();
        if ours.len() != answers.len() || length == 0 {
            return false;
        }
        let mut largest = vec![0.0_f32; length];
        for row in answers.chunks_exact(length) {
            largest.iter_mut().zip(row).for_each(|(most, value)| *most = most.max(value.abs()));
        }
        ours.chunks_exact(length).zip(answers.chunks_exact(length)).all(|(ours, theirs)| {
            ours.iter()
                .zip(theirs)
                .zip(&largest)
                .all(|((a, b), most)| a == b || (a - b).abs() <= rounding * most.max(f32::MIN_POSITIVE))
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::model::rehearse_embedded;
    use crate::onnx::{Attribute, GraphBuilder, Value};

    /// Numbers from −2 to 2.
    fn numbers(count: usize, seed: u64) -> Vec<f32> {
        let mut state = seed | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            ((state >> 40) as f32 / (1u32 << 22) as f32) - 2.0
        };
        (0..count).map(|_| next()).collect()
    }

    fn run(bytes: &[u8], inputs: usize, outputs: usize, input: &[f32]) -> Option<Vec<f32>> {
        let mut plan = Plan::translate(bytes, &Interface::flat(inputs, outputs))?;
        let mut out = Vec::new();
        // What the first run left behind changes nothing.
        plan.run(&vec![0.5; inputs], &mut out);
        out.clear();
        plan.run(input, &mut out);
        Some(out)
    }

    fn same(bytes: &[u8], inputs: usize, outputs: usize, seed: u64) {
        let input = numbers(inputs, seed);
        let ours = run(bytes, inputs, outputs, &input).expect("it is translated");
        let theirs = rehearse_embedded(bytes, &Interface::flat(inputs, outputs), &input).unwrap();
        for (a, b) in ours.iter().zip(&theirs) {
            assert!((a - b).abs() <= 2e-5 * b.abs().max(1.0), "{a} {b}");
        }
    }

    /// Direction and length of a row, two layers of each activation, and an ensemble's sum: what training exports.
    fn network(inputs: usize, hidden: usize, outputs: usize, seed: u64) -> Vec<u8> {
        let mut g = GraphBuilder::new("network");
        let x = g.input("input", &[1, inputs]);
        let factor = g.constant("factor", &[1, inputs], &numbers(inputs, seed));
        let one = g.constant("one", &[1, 1], &[1.0]);
        let axes = g.constant_i64("axes", &[1], &[1]);
        let x = g.mul(&x, &factor);
        let squares = g.mul(&x, &x);
        let sum =
            g.operator("ReduceSum", &[&squares, &axes], &[("keepdims", Attribute::Int(1))], 1).remove(0);
        let sum = g.add(&sum, &one);
        let norm = g.sqrt(&sum);
        let direction = g.operator("Div", &[&x, &norm], &[], 1).remove(0);
        let log = g.operator("Log", &[&norm], &[], 1).remove(0);
        let x = g.concat(&[&direction, &log], 1);
        let mut all: Option<Value> = None;
        for (member, activation) in ["Sigmoid", "Tanh", "Relu", "Abs"].into_iter().enumerate() {
            let mut constant = |name: &str, shape: &[usize]| {
                let values = numbers(shape.iter().product(), seed ^ (member as u64 * 77 + name.len() as u64));
                g.constant(&format!("{name}{member}"), shape, &values)
            };
            let weights = constant("weights", &[inputs + 1, hidden]);
            let bias = constant("bias", &[hidden]);
            let last = constant("last_weights", &[hidden, outputs]);
            let y = g.gemm(&x, &weights, Some(&bias));
            let z = g.operator(activation, &[&y], &[], 1).remove(0);
            let y = if activation == "Sigmoid" { g.mul(&z, &y) } else { z };
            let y = g.matmul(&y, &last);
            all = Some(all.map_or(y.clone(), |sum| g.add(&sum, &y)));
        }
        g.output("output", &all.unwrap(), &[1, outputs]);
        g.finish().unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn it_answers_as_the_general_runtime_does(inputs in 1..40_usize, hidden in 1..70_usize, outputs in 1..9_usize, seed: u64) {
            same(&network(inputs, hidden, outputs, seed), inputs, outputs, seed ^ 5);
        }

        #[test]
        fn exponentials_are_right_to_rounding(x in -80.0..80.0_f32) {
            let exact = f64::from(x).exp();
            let ours = f64::from(kernels::exp(x));
            prop_assert!((ours / exact - 1.0).abs() < 3e-7, "{x}: {ours} {exact}");
        }
    }

    #[test]
    fn exponentials_stay_finite_numbers() {
        assert_eq!(kernels::exp(0.0), 1.0);
        for x in [-1e30, -104.0, 104.0, 1e30] {
            let y = kernels::exp(x);
            assert!(y.is_finite() && y >= 0.0, "{x}: {y}");
            assert!((0.0..=1.0).contains(&kernels::sigmoid(x)), "{x}");
        }
        assert_eq!((kernels::sigmoid(1e30), kernels::tanh(1e30), kernels::tanh(-1e30)), (1.0, 1.0, -1.0));
        assert!(kernels::sigmoid(-1e30) < 1e-30);
    }

    #[test]
    fn parts_of_rows_and_single_numbers_are_understood() {
        let mut g = GraphBuilder::new("parts");
        let x = g.input("input", &[1, 6]);
        let middle = g.slice(&x, 1, 2, 5);
        let two = g.constant("two", &[1], &[2.0]);
        let doubled = g.mul(&two, &middle);
        let all = g.concat(&[&doubled, &x, &middle], 1);
        let negative = g.neg(&all);
        g.output("output", &negative, &[1, 12]);
        let bytes = g.finish().unwrap();
        let out = run(&bytes, 6, 12, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert_eq!(out, [-4.0, -6.0, -8.0, -0.0, -1.0, -2.0, -3.0, -4.0, -5.0, -2.0, -3.0, -4.0]);
    }

    #[test]
    fn what_has_no_step_is_left_to_the_general_runtime() {
        let with = |operator: &str| {
            let mut g = GraphBuilder::new("other");
            let x = g.input("input", &[1, 3]);
            let y = g.operator(operator, &[&x], &[], 1).remove(0);
            g.output("output", &y, &[1, 3]);
            Plan::translate(&g.finish().unwrap(), &Interface::flat(3, 3))
        };
        assert!(with("Relu").is_some());
        assert!(with("Softmax").is_none());
        // A column times a row is no row.
        let mut g = GraphBuilder::new("outer");
        let x = g.input("input", &[1, 3]);
        let column = g.constant("column", &[3, 1], &[1.0, 2.0, 3.0]);
        let y = g.mul(&x, &column);
        g.output("output", &y, &[3, 3]);
        let wide = Interface { output_shape: vec![3, 3], ..Interface::flat(3, 9) };
        assert!(Plan::translate(&g.finish().unwrap(), &wide).is_none());
        let image = Interface { input_shape: vec![1, 1, 2, 2], ..Interface::flat(4, 4) };
        let mut g = GraphBuilder::new("image");
        let x = g.input("input", &[1, 1, 2, 2]);
        let y = g.neg(&x);
        g.output("output", &y, &[1, 4]);
        assert!(Plan::translate(&g.finish().unwrap(), &image).is_none());
    }

    #[test]
    fn a_graph_that_grows_beyond_bounds_is_left_to_the_general_runtime() {
        let mut g = GraphBuilder::new("doubling");
        let mut x = g.input("input", &[1, 2]);
        for _ in 0..40 {
            x = g.concat(&[&x, &x], 1);
        }
        g.output("output", &x, &[1, 1 << 20]);
        assert!(Plan::translate(&g.finish().unwrap(), &Interface::flat(2, 1 << 20)).is_none());
    }

    #[test]
    fn a_translation_that_answers_otherwise_is_noticed() {
        let bytes = network(5, 8, 2, 3);
        let mut plan = Plan::translate(&bytes, &Interface::flat(5, 2)).unwrap();
        let inputs = numbers(20, 9);
        let answers: Vec<f32> = inputs
            .chunks_exact(5)
            .flat_map(|row| rehearse_embedded(&bytes, &Interface::flat(5, 2), row).unwrap())
            .collect();
        assert!(plan.agrees(&inputs, &answers, 1e-4));
        let mut others = answers.clone();
        others[3] += 0.05;
        assert!(!plan.agrees(&inputs, &others, 1e-4));
        assert!(!plan.agrees(&inputs, &answers[..6], 1e-4));
        assert!(!plan.agrees(&inputs, &vec![f32::NAN; answers.len()], 1e-4));
    }

    proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
            let _ = Plan::translate(&bytes, &Interface::flat(3, 3));
        }

        #[test]
        fn no_flipped_bit_panics(at in 0..2000_usize, bit in 0..8) {
            let mut bytes = network(3, 4, 2, 1);
            let at = at % bytes.len();
            bytes[at] ^= 1_u8 << bit;
            if let Some(mut plan) = Plan::translate(&bytes, &Interface::flat(3, 2)) {
                plan.run(&[1.0, 2.0, 3.0], &mut Vec::new());
            }
        }
    }
}
