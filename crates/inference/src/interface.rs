//! What a graph takes and gives.

use serde::{Deserialize, Serialize};

/// What goes into a graph and what comes out: one tensor of 32-bit floats each, with fixed shapes and batch 1.
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
        }
    }

    /// Numbers that go in; `None` where the shape is impossible.
    #[must_use]
    pub fn input_len(&self) -> Option<usize> {
        elements(&self.input_shape)
    }

    /// Numbers that come out; `None` where the shape is impossible.
    #[must_use]
    pub fn output_len(&self) -> Option<usize> {
        elements(&self.output_shape)
    }
}

/// Number of elements of a shape, `None` where it is empty or beyond what a model of a skin can be.
fn elements(shape: &[usize]) -> Option<usize> {
    let count = shape.iter().try_fold(1_usize, |n, d| n.checked_mul(*d))?;
    (!shape.is_empty() && count > 0 && count <= 1 << 26).then_some(count)
}
