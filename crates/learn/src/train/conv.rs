//! Convolutional networks: an image, or channels that lie in a grid, in; numbers and maps out.
//!
//! The network is an encoder of strided convolutions (LeCun et al. 1998) and, for every map, a decoder of transposed
//! convolutions, each followed by a convolution that smooths its checkerboard (Odena et al. 2016). It is fitted by Adam
//! (Kingma & Ba 2015) on the squared error, cross entropy for logits, in mini-batches that are streamed: memory holds the
//! network, one mini-batch and a buffer of samples to shuffle ([`ConvTraining::shuffle`]), however many samples there are.
//! Training stops early where the error on the validation samples has not fallen for [`ConvTraining::patience`] epochs
//! (Prechelt 1998), and the best network is kept.
//!
//! The framework is burn, on its backend `flex` (pure Rust, one or a few cores) or on a GPU ([`Processor`](super::Processor)). The same description of a network
//! ([`ConvSpec`]) is evaluated by burn and written as an ONNX graph, so that both have the same operators.
//!
//! Cost: 0.5 to 2 ms a sample and pass on one core for images of 77 × 103 and four levels.

mod checkpoint;
mod fit;
mod loss;
mod network;
mod ops;
mod split;
#[cfg(test)]
mod tests;

use super::layer::{Layer, shapes};
use crate::LearnError;

pub use fit::{ConvProgress, ConvTraining, Fitted, fit};
pub use network::ConvNetwork;

/// What goes into a network and what comes out.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct ConvSpec {
    /// Name of the input tensor in the graph.
    pub input: String,
    /// \[channels, height, width\] of the input.
    pub shape: [usize; 3],
    /// Channels of every level of the encoder; each halves height and width, rounding up.
    pub encoder: Vec<usize>,
    /// Width of the dense layer between encoder and outputs.
    pub hidden: usize,
    /// What comes out, in order.
    pub heads: Vec<Head>,
    /// Layers one after another in place of encoder, dense layer and decoders: one head, a map, is what the last one makes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub layers: Vec<Layer>,
}

/// One output tensor.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Head {
    /// Name of the tensor in the graph.
    pub name: String,
    /// Its shape.
    pub form: Form,
    /// Whether the numbers are logits whose targets are 0 or 1.
    #[serde(default)]
    pub logit: bool,
}

/// Shape of an output tensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// So many numbers: scalars, or one number a point of a surface of any shape.
    Vector(usize),
    /// \[channels, height, width\], decoded by convolutions. Where height and width are those of the input, the map is
    /// aligned with it; otherwise it is decoded from the dense layer.
    Map([usize; 3]),
}

impl Form {
    /// Numbers in it.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Vector(count) => *count,
            Self::Map(shape) => shape.iter().product(),
        }
    }

    /// Whether there are none; never so in a valid specification.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl ConvSpec {
    /// Numbers of one input.
    #[must_use]
    pub fn input_len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Says what is impossible.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] names the field.
    pub fn validate(&self) -> Result<(), LearnError> {
        let wrong = |reason: String| Err(LearnError::Training { reason });
        if self.input_len() == 0 || self.input_len() > 1 << 26 {
            return wrong(format!("the input has the shape {:?}, which no network takes", self.shape));
        }
        if !self.layers.is_empty() {
            return self.validate_layers();
        }
        if self.encoder.is_empty()
            || self.encoder.len() > 12
            || self.encoder.iter().any(|c| !(1..=4096).contains(c))
        {
            return wrong("`network.encoder` holds 1 to 12 numbers of channels from 1 to 4096".into());
        }
        if !(1..=65_536).contains(&self.hidden) {
            return wrong("`network.hidden` must be 1 to 65536 for a convolutional network".into());
        }
        if self.heads.is_empty() {
            return wrong("a network needs at least one output".into());
        }
        for (i, head) in self.heads.iter().enumerate() {
            if head.form.is_empty() || head.form.len() > 1 << 26 {
                return wrong(format!(
                    "output `{}` has the shape {:?}, which no network gives",
                    head.name, head.form
                ));
            }
            if head.name == self.input || self.heads[..i].iter().any(|h| h.name == head.name) {
                return wrong(format!("the name `{}` stands for two tensors", head.name));
            }
        }
        Ok(())
    }
}

impl ConvSpec {
    /// As [`validate`](Self::validate), of a sequence of layers.
    fn validate_layers(&self) -> Result<(), LearnError> {
        let wrong = |reason: String| Err(LearnError::Training { reason });
        let shapes = match shapes(self.shape, &self.layers) {
            Ok(shapes) => shapes,
            Err((index, shape)) => {
                return wrong(format!(
                    "`layers[{index}]` can make nothing of the shape {shape:?}: {:?}",
                    self.layers[index]
                ));
            }
        };
        let made = shapes.last().copied().unwrap_or(self.shape);
        match &self.heads[..] {
            [head] if head.form == Form::Map(made) && head.name != self.input => Ok(()),
            _ => {
                wrong(format!("the last of `layers` makes the shape {made:?}, which must be the only output"))
            }
        }
    }
}

/// One sample as a network takes it: everything normalised, tensors row by row.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TensorSample {
    /// Of [`ConvSpec::shape`], finite.
    pub input: Vec<f32>,
    /// One for each of [`ConvSpec::heads`]; NaN where a number is not known.
    pub targets: Vec<Vec<f32>>,
    /// How much each target counts, as `targets`; all count the same where empty.
    pub weights: Vec<Vec<f32>>,
}

/// Samples that can be read from the start as often as needed.
pub trait TensorReader {
    /// Gives every sample to `take`, in any order, and stops at its first error.
    ///
    /// # Errors
    ///
    /// What reading or `take` says.
    fn each(&self, take: &mut dyn FnMut(TensorSample) -> Result<(), LearnError>) -> Result<(), LearnError>;
}

/// A function that opens an iterator over the samples.
impl<F, I> TensorReader for F
where
    F: Fn() -> Result<I, LearnError>,
    I: Iterator<Item = Result<TensorSample, LearnError>>,
{
    fn each(&self, take: &mut dyn FnMut(TensorSample) -> Result<(), LearnError>) -> Result<(), LearnError> {
        self()?.try_for_each(|sample| take(sample?))
    }
}

/// Samples in memory.
impl TensorReader for Vec<TensorSample> {
    fn each(&self, take: &mut dyn FnMut(TensorSample) -> Result<(), LearnError>) -> Result<(), LearnError> {
        self.iter().try_for_each(|sample| take(sample.clone()))
    }
}
