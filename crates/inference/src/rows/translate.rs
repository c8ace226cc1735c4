//! From a graph to the steps of a plan.

use std::collections::HashMap;
use std::ops::Range;

use super::{Binary, MOST, Plan, Step, Unary};
use crate::interface::Interface;
use crate::onnx::{Graph, GraphNode, Tensor};

/// Operators of a graph, at most: more are no network of a skin, and finding those whose results are read takes their square.
const STEPS: usize = 2000;

/// What a name stands for.
#[derive(Debug, Clone)]
enum Known<'a> {
    /// \[1, n\].
    Row(Range<usize>),
    /// The numbers of a row in another shape: only what comes out may have it.
    Shaped(Range<usize>),
    Constant(&'a Tensor),
}

struct Translation<'a> {
    known: HashMap<&'a str, Known<'a>>,
    values: Vec<f32>,
    steps: Vec<Step>,
}

/// Translates a graph of rows.
pub(super) fn plan(graph: &Graph, interface: &Interface) -> Option<Plan> {
    let mut all = Translation { known: HashMap::new(), values: Vec::new(), steps: Vec::new() };
    for constant in &graph.constants {
        all.known.insert(&constant.name, Known::Constant(constant));
    }
    for (name, shape) in interface.inputs() {
        let &[1, length] = shape else { return None };
        let place = all.room(length)?;
        all.known.insert(name, Known::Row(place));
    }
    let inputs = all.values.len();
    for node in &graph.nodes {
        (all.steps.len() < STEPS).then_some(())?;
        all.node(node)?;
    }
    let mut outputs = Vec::new();
    for (name, shape) in interface.outputs() {
        let place = match all.known.get(name)? {
            Known::Row(place) | Known::Shaped(place) => place.clone(),
            Known::Constant(_) => return None,
        };
        (place.len() == shape.iter().product::<usize>()).then_some(())?;
        outputs.push(place);
    }
    let Translation { values, steps, .. } = all;
    let steps = needed(steps, &outputs);
    Some(Plan { values, steps, inputs, outputs, arch: pulp::Arch::new() })
}

/// The steps whose results are read by another one, or come out.
fn needed(steps: Vec<Step>, outputs: &[Range<usize>]) -> Vec<Step> {
    let mut read: Vec<Range<usize>> = outputs.to_vec();
    let overlaps = |a: &Range<usize>, b: &Range<usize>| a.start < b.end && b.start < a.end;
    let mut kept = Vec::with_capacity(steps.len());
    for step in steps.into_iter().rev() {
        if read.iter().any(|place| overlaps(place, &step.to())) {
            read.extend(step.from().into_iter().flatten().cloned());
            kept.push(step);
        }
    }
    kept.reverse();
    kept
}

/// The name of an input, where there is one.
fn input(node: &GraphNode, at: usize) -> Option<&str> {
    node.inputs.get(at).map(String::as_str).filter(|name| !name.is_empty())
}

impl<'a> Translation<'a> {
    /// Room for so many numbers at the end of the buffer.
    fn room(&mut self, length: usize) -> Option<Range<usize>> {
        let start = self.values.len();
        let end = start.checked_add(length).filter(|end| *end <= MOST && length > 0)?;
        self.values.resize(end, 0.0);
        Some(start..end)
    }

    /// A tensor that is a row, or a constant that can be one.
    fn row(&mut self, name: &'a str) -> Option<Range<usize>> {
        match self.known.get(name)?.clone() {
            Known::Row(place) => Some(place),
            Known::Constant(tensor) => {
                let flat = matches!(tensor.shape.as_slice(), [] | [_] | [1, _]);
                let numbers = tensor.floats.as_ref().filter(|_| flat)?;
                let place = self.room(numbers.len())?;
                self.values[place.clone()].copy_from_slice(numbers);
                // Constants are never written: one place serves all who read it.
                self.known.insert(name, Known::Row(place.clone()));
                Some(place)
            }
            Known::Shaped(_) => None,
        }
    }

    fn constant(&self, name: &str) -> Option<&'a Tensor> {
        match self.known.get(name)? {
            Known::Constant(tensor) => Some(tensor),
            _ => None,
        }
    }

    fn whole_numbers(&self, name: &str) -> Option<&'a [i64]> {
        self.constant(name)?.integers.as_deref()
    }

    fn node(&mut self, node: &'a GraphNode) -> Option<()> {
        let [output] = node.outputs.as_slice() else { return None };
        let input = |at: usize| input(node, at);
        let result = match node.operator.as_str() {
            "Add" => self.binary(Binary::Add, input(0)?, input(1)?)?,
            "Sub" => self.binary(Binary::Sub, input(0)?, input(1)?)?,
            "Mul" => self.binary(Binary::Mul, input(0)?, input(1)?)?,
            "Div" => self.binary(Binary::Div, input(0)?, input(1)?)?,
            "Relu" => self.unary(Unary::Relu, input(0)?)?,
            "Sigmoid" => self.unary(Unary::Sigmoid, input(0)?)?,
            "Tanh" => self.unary(Unary::Tanh, input(0)?)?,
            "Exp" => self.unary(Unary::Exp, input(0)?)?,
            "Log" => self.unary(Unary::Log, input(0)?)?,
            "Sqrt" => self.unary(Unary::Sqrt, input(0)?)?,
            "Neg" => self.unary(Unary::Neg, input(0)?)?,
            "Abs" => self.unary(Unary::Abs, input(0)?)?,
            "Gemm" => {
                let plain = |name: &str, default: f32| node.float(name).is_none_or(|v| v == default);
                (plain("alpha", 1.0) && plain("beta", 1.0) && node.integer("transA").unwrap_or(0) == 0)
                    .then_some(())?;
                self.product(input(0)?, input(1)?, node.integer("transB").unwrap_or(0) == 1, input(2))?
            }
            "MatMul" => self.product(input(0)?, input(1)?, false, None)?,
            "ReduceSum" => {
                let axes = match input(1) {
                    Some(name) => self.whole_numbers(name)?,
                    None => node.integers("axes")?,
                };
                (matches!(axes, [1 | -1]) && node.integer("keepdims").unwrap_or(1) == 1).then_some(())?;
                let from = self.row(input(0)?)?;
                let to = self.room(1)?;
                self.steps.push(Step::Sum { from, to: to.start });
                Known::Row(to)
            }
            "Concat" => self.concatenation(node)?,
            "Slice" => self.slice(node)?,
            "Identity" => match self.known.get(input(0)?)?.clone() {
                Known::Constant(_) => Known::Row(self.row(input(0)?)?),
                same => same,
            },
            "Reshape" | "Flatten" | "Squeeze" | "Unsqueeze" => match self.known.get(input(0)?)?.clone() {
                Known::Row(place) | Known::Shaped(place) => Known::Shaped(place),
                Known::Constant(_) => return None,
            },
            _ => return None,
        };
        self.known.insert(output, result);
        Some(())
    }

    /// Rows one behind the other.
    fn concatenation(&mut self, node: &'a GraphNode) -> Option<Known<'a>> {
        matches!(node.integer("axis")?, 1 | -1).then_some(())?;
        let parts = node.inputs.iter().map(|name| self.row(name)).collect::<Option<Vec<_>>>()?;
        let length = parts.iter().try_fold(0_usize, |sum, part| sum.checked_add(part.len()))?;
        let to = self.room(length)?;
        let mut at = to.start;
        for from in parts {
            let end = at + from.len();
            self.steps.push(Step::Copy { from, to: at..end });
            at = end;
        }
        Some(Known::Row(to))
    }

    /// A part of a row.
    fn slice(&mut self, node: &'a GraphNode) -> Option<Known<'a>> {
        let input = |at: usize| input(node, at);
        let one = |name: Option<&str>, otherwise: i64| match name {
            Some(name) => match self.whole_numbers(name)? {
                [one] => Some(*one),
                _ => None,
            },
            None => Some(otherwise),
        };
        let (start, end) = (one(input(1), 0)?, one(input(2), 0)?);
        (matches!(one(input(3), 0)?, 1 | -1) && one(input(4), 1)? == 1).then_some(())?;
        let from = self.row(input(0)?)?;
        let within = |at: i64| {
            let length = i64::try_from(from.len()).ok()?;
            let at = if at < 0 { at.saturating_add(length) } else { at };
            usize::try_from(at.clamp(0, length)).ok()
        };
        let (start, end) = (within(start)?, within(end)?);
        (start < end).then_some(())?;
        // A part of a row lies where the row does.
        Some(Known::Row(from.start + start..from.start + end))
    }

    fn binary(&mut self, how: Binary, a: &'a str, b: &'a str) -> Option<Known<'a>> {
        let (a, b) = (self.row(a)?, self.row(b)?);
        let fits = a.len() == b.len() || a.len() == 1 || b.len() == 1;
        let to = self.room(a.len().max(b.len())).filter(|_| fits)?;
        let silu = |x: &Range<usize>, sigmoid: &Range<usize>| {
            let made = |step: &Step| matches!(step, Step::Unary { how: Unary::Sigmoid, from, to } if from == x && to == sigmoid);
            how == Binary::Mul && self.steps.iter().rev().any(made)
        };
        let step = if silu(&a, &b) {
            Step::Unary { how: Unary::Silu, from: a, to: to.clone() }
        } else if silu(&b, &a) {
            Step::Unary { how: Unary::Silu, from: b, to: to.clone() }
        } else {
            Step::Binary { how, a, b, to: to.clone() }
        };
        self.steps.push(step);
        Some(Known::Row(to))
    }

    fn unary(&mut self, how: Unary, from: &'a str) -> Option<Known<'a>> {
        let from = self.row(from)?;
        let to = self.room(from.len())?;
        self.steps.push(Step::Unary { how, from, to: to.clone() });
        Some(Known::Row(to))
    }

    fn product(
        &mut self,
        from: &'a str,
        weights: &'a str,
        transposed: bool,
        bias: Option<&'a str>,
    ) -> Option<Known<'a>> {
        let from = self.row(from)?;
        let tensor = self.constant(weights)?;
        let (numbers, &[rows, columns]) = (tensor.floats.as_ref()?, tensor.shape.as_slice()) else {
            return None;
        };
        let [taken, given] = if transposed { [columns, rows] } else { [rows, columns] };
        (taken == from.len() && numbers.len() == taken.checked_mul(given)?).then_some(())?;
        let bias = match bias {
            Some(name) => Some(self.row(name)?),
            None => None,
        };
        bias.as_ref().is_none_or(|bias| bias.len() == given).then_some(())?;
        let weights = if transposed {
            (0..taken).flat_map(|i| (0..given).map(move |j| numbers[j * taken + i])).collect()
        } else {
            numbers.clone()
        };
        let to = self.room(given)?;
        self.steps.push(Step::Product { from, weights, bias, to: to.clone() });
        Some(Known::Row(to))
    }
}
