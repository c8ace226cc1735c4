//! One loaded graph.

use std::panic::{AssertUnwindSafe, catch_unwind};

use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::Tensor;
use tract_onnx::prelude::{Framework, InferenceModelExt, IntoRunnable, tvec};

use crate::interface::Interface;
use crate::onnx;
use crate::runtime::{Runtime, RuntimeKind};

/// A graph that cannot be loaded or run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The bytes are no ONNX graph.
    #[error("is not an ONNX model: {reason}; export it again")]
    NotOnnx {
        /// What is wrong with the bytes.
        reason: String,
    },
    /// The graph has other inputs or outputs than it is said to have.
    #[error("has {what} {found} where {expected} is declared; export it again with that {what}")]
    Interface {
        /// `input` or `output`.
        what: &'static str,
        /// Tensors that the graph has.
        found: String,
        /// Tensor that was declared.
        expected: String,
    },
    /// The runtime does not accept the graph.
    #[error("is refused by {runtime}: {reason}; export it again or try another runtime")]
    Refused {
        /// The runtime.
        runtime: String,
        /// What it said.
        reason: String,
    },
    /// An input has the wrong length.
    #[error("input has {got} numbers where the model takes {expected}")]
    InputLength {
        /// Numbers given.
        got: usize,
        /// Numbers taken.
        expected: usize,
    },
    /// An input is NaN or infinite.
    #[error("input[{index}] is not a finite number")]
    InputNotFinite {
        /// Index of the first such number.
        index: usize,
    },
    /// The runtime failed while it ran the graph.
    #[error("run failed: {reason}")]
    Run {
        /// What it said.
        reason: String,
    },
}

/// One loaded graph; runs on the calling thread.
#[derive(Debug)]
pub struct Model {
    session: Session,
    input: Tensor<f32>,
    input_len: usize,
    output: String,
    output_len: usize,
}

impl Model {
    /// Loads a graph from the bytes of an `.onnx` file.
    ///
    /// # Errors
    ///
    /// [`ModelError`] where the bytes are no graph, the graph has another interface, or the runtime refuses it.
    pub fn load(runtime: &Runtime, bytes: &[u8], interface: &Interface) -> Result<Self, ModelError> {
        onnx::check(bytes, interface)?;
        let refused = |reason: String| ModelError::Refused {
            runtime: runtime.report().to_string(),
            reason: reason.split_whitespace().collect::<Vec<_>>().join(" "),
        };
        let (Some(input_len), Some(output_len)) = (interface.input_len(), interface.output_len()) else {
            return Err(refused("a declared shape has no elements, or far too many".into()));
        };
        if runtime.report().kind == RuntimeKind::Embedded {
            let zeros = tract_onnx::prelude::Tensor::zero::<f32>(&interface.input_shape)
                .map_err(|e| refused(e.to_string()))?;
            rehearse(bytes, zeros).map_err(refused)?;
        }
        let session = (|| {
            let builder = Session::builder(runtime.environment())?
                .with_optimization_level(GraphOptimizationLevel::All)?;
            let mut builder = match runtime.report().kind {
                RuntimeKind::Native => builder.with_intra_threads(1)?.with_inter_threads(1)?,
                // It has one thread and no such option.
                RuntimeKind::Embedded => builder,
            };
            builder.commit_from_memory(bytes)
        })()
        .map_err(|e: ort::Error| refused(e.to_string()))?;
        let input = Tensor::from_array((interface.input_shape.clone(), vec![0.0_f32; input_len]))
            .map_err(|e| refused(e.to_string()))?;
        let mut model = Self { session, input, input_len, output: interface.output.clone(), output_len };
        // Shapes inside of a graph are only known to fit once it has run.
        model.run(&vec![0.0; input_len], &mut Vec::new()).map_err(|e| refused(e.to_string()))?;
        Ok(model)
    }

    /// Numbers that [`run`](Self::run) takes.
    #[must_use]
    pub fn input_len(&self) -> usize {
        self.input_len
    }

    /// Numbers that [`run`](Self::run) gives.
    #[must_use]
    pub fn output_len(&self) -> usize {
        self.output_len
    }

    /// Evaluates the graph; `output` is replaced, and its memory used again.
    ///
    /// # Errors
    ///
    /// [`ModelError`] where the input has the wrong length or is not finite, or the runtime fails.
    pub fn run(&mut self, input: &[f32], output: &mut Vec<f32>) -> Result<(), ModelError> {
        output.clear();
        self.append(input, output)
    }

    /// Evaluates the graph for each of the rows that `inputs` holds end to end, one after the other; `outputs` is
    /// replaced by their outputs, end to end.
    ///
    /// # Errors
    ///
    /// As [`run`](Self::run).
    pub fn run_batch(&mut self, inputs: &[f32], outputs: &mut Vec<f32>) -> Result<(), ModelError> {
        outputs.clear();
        if !inputs.len().is_multiple_of(self.input_len) {
            return Err(ModelError::InputLength {
                got: inputs.len() % self.input_len,
                expected: self.input_len,
            });
        }
        outputs.reserve(inputs.len() / self.input_len * self.output_len);
        inputs.chunks_exact(self.input_len).try_for_each(|row| self.append(row, outputs))
    }

    fn append(&mut self, input: &[f32], output: &mut Vec<f32>) -> Result<(), ModelError> {
        if input.len() != self.input_len {
            return Err(ModelError::InputLength { got: input.len(), expected: self.input_len });
        }
        if let Some(index) = input.iter().position(|x| !x.is_finite()) {
            return Err(ModelError::InputNotFinite { index });
        }
        self.input.extract_tensor_mut().1.copy_from_slice(input);
        let run = |e: ort::Error| ModelError::Run { reason: e.to_string() };
        let outputs = self.session.run(ort::inputs![&self.input]).map_err(run)?;
        let values = outputs
            .get(self.output.as_str())
            .ok_or_else(|| ModelError::Run { reason: format!("no output `{}` came out", self.output) })?;
        let (_, values) = values.try_extract_tensor::<f32>().map_err(run)?;
        if values.len() != self.output_len {
            return Err(ModelError::Run {
                reason: format!("{} numbers came out where {} are declared", values.len(), self.output_len),
            });
        }
        output.extend_from_slice(values);
        Ok(())
    }
}

/// Runs a graph once in the embedded runtime, whichever runtime the process has chosen; what comes out.
///
/// # Errors
///
/// [`ModelError`] where the bytes are no graph of this interface, or the runtime refuses them.
pub fn rehearse_embedded(bytes: &[u8], interface: &Interface, input: &[f32]) -> Result<Vec<f32>, ModelError> {
    onnx::check(bytes, interface)?;
    let tensor = tract_onnx::prelude::Tensor::from_shape(&interface.input_shape, input).map_err(|_| {
        ModelError::InputLength { got: input.len(), expected: interface.input_len().unwrap_or_default() }
    })?;
    rehearse(bytes, tensor).map_err(|reason| ModelError::Refused {
        runtime: "the embedded runtime".into(),
        reason: reason.split_whitespace().collect::<Vec<_>>().join(" "),
    })
}

/// Loads, optimises and runs a graph where a panic can be caught.
///
/// The embedded runtime may panic on a graph that parses but makes no sense, and a panic behind the C interface
/// that `ort` speaks ends the process. Here it becomes a refusal.
fn rehearse(bytes: &[u8], input: tract_onnx::prelude::Tensor) -> Result<Vec<f32>, String> {
    let rehearsal = || {
        let graph = tract_onnx::onnx().model_for_read(&mut &*bytes)?.into_optimized()?.into_runnable()?;
        let outputs = graph.run(tvec!(input.into()))?;
        let first = outputs.first().map(|o| Ok(o.to_plain_array_view::<f32>()?.iter().copied().collect()));
        first.transpose().map(Option::unwrap_or_default)
    };
    match catch_unwind(AssertUnwindSafe(rehearsal)) {
        Ok(result) => result.map_err(|e: tract_onnx::prelude::TractError| format!("{e:#}")),
        Err(_) => Err("it cannot be evaluated".into()),
    }
}
