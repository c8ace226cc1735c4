//! What a graph takes and gives.

use serde::{Deserialize, Serialize};

/// One tensor of 32-bit floats of a graph.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TensorPort {
    /// Its name.
    pub name: String,
    /// Its shape; the first dimension is 1.
    pub shape: Vec<usize>,
}

/// What goes into a graph and what comes out: tensors of 32-bit floats by name, with fixed shapes and batch 1. Where there
/// are several, their numbers lie end to end in the order in which they stand here, whatever their order in the graph.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Interface {
    /// Name of the input tensor.
    #[serde(default = "input")]
    pub input: String,
    /// Its shape; the first dimension is 1.
    pub input_shape: Vec<usize>,
    /// Name of the output tensor.
    #[serde(default = "output")]
    pub output: String,
    /// Its shape; the first dimension is 1.
    pub output_shape: Vec<usize>,
    /// Further input tensors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub more_inputs: Vec<TensorPort>,
    /// Further output tensors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub more_outputs: Vec<TensorPort>,
}

fn input() -> String {
    "input".to_owned()
}

fn output() -> String {
    "output".to_owned()
}

impl Interface {
    /// `input` \[1, inputs\] → `output` \[1, outputs\].
    #[must_use]
    pub fn flat(inputs: usize, outputs: usize) -> Self {
        Self {
            input: input(),
            input_shape: vec![1, inputs],
            output: output(),
            output_shape: vec![1, outputs],
            ..Self::default()
        }
    }

    /// Tensors of these names and shapes.
    #[must_use]
    pub fn of(inputs: &[TensorPort], outputs: &[TensorPort]) -> Self {
        let first = |ports: &[TensorPort]| ports.first().cloned().unwrap_or_default();
        let rest = |ports: &[TensorPort]| ports.get(1..).unwrap_or_default().to_vec();
        let (input, output) = (first(inputs), first(outputs));
        Self {
            input: input.name,
            input_shape: input.shape,
            output: output.name,
            output_shape: output.shape,
            more_inputs: rest(inputs),
            more_outputs: rest(outputs),
        }
    }

    /// Name and shape of every input.
    pub fn inputs(&self) -> impl Iterator<Item = (&str, &[usize])> {
        let more = self.more_inputs.iter().map(|p| (p.name.as_str(), p.shape.as_slice()));
        std::iter::once((self.input.as_str(), self.input_shape.as_slice())).chain(more)
    }

    /// Name and shape of every output.
    pub fn outputs(&self) -> impl Iterator<Item = (&str, &[usize])> {
        let more = self.more_outputs.iter().map(|p| (p.name.as_str(), p.shape.as_slice()));
        std::iter::once((self.output.as_str(), self.output_shape.as_slice())).chain(more)
    }

    /// Numbers that go in; `None` where a shape is impossible.
    #[must_use]
    pub fn input_len(&self) -> Option<usize> {
        total(self.inputs())
    }

    /// Numbers that come out; `None` where a shape is impossible.
    #[must_use]
    pub fn output_len(&self) -> Option<usize> {
        total(self.outputs())
    }
}

fn total<'a>(ports: impl Iterator<Item = (&'a str, &'a [usize])>) -> Option<usize> {
    let count = ports.map(|(_, shape)| elements(shape)).try_fold(0_usize, |n, e| n.checked_add(e?))?;
    (count <= 1 << 26).then_some(count)
}

/// Number of elements of a shape, `None` where it is empty or beyond what a model of a skin can be.
pub(crate) fn elements(shape: &[usize]) -> Option<usize> {
    let count = shape.iter().try_fold(1_usize, |n, d| n.checked_mul(*d))?;
    (!shape.is_empty() && count > 0 && count <= 1 << 26).then_some(count)
}
