//! One loaded graph.

use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};

use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::Tensor;
use tract_onnx::prelude::{Framework, InferenceModelExt, IntoRunnable, TractError, TypedSimpleState, tvec};

use crate::interface::{Interface, elements};
use crate::onnx;
use crate::rows::Plan;
use crate::runtime::Runtime;

/// A graph that cannot be loaded or run.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
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
    /// A constant of the graph is NaN or infinite.
    #[error(
        "constant `{constant}` holds {value}, which is no finite number, so that no answer would be one; train or export the \
         model again"
    )]
    ConstantNotFinite {
        /// Its name.
        constant: String,
        /// The first such number.
        value: f64,
    },
    /// The constants of the graph claim too much memory.
    #[error(
        "its constants have {bytes} bytes, and at most {most} are loaded; export a smaller model, or raise `constant_bytes` of \
         `model_limits`"
    )]
    ConstantsTooLarge {
        /// What they have.
        bytes: u64,
        /// What they may have.
        most: u64,
    },
    /// What it answers to plausible readings is not finite.
    #[error(
        "answers {value} to plausible readings (output {index}, run {run} of its trial); train or export the model again"
    )]
    OutputNotFinite {
        /// Number of the output.
        index: usize,
        /// What came out.
        value: f32,
        /// Which input of the trial it was.
        run: usize,
    },
    /// It did not live through its trial in a process of its own.
    #[error("failed its trial: {reason}")]
    Trial {
        /// What happened, and which limit it ran into.
        reason: String,
    },
    /// Its output may have any size, and there is no process of its own to try it in.
    #[error(
        "has the operator `{operator}`, whose result may be of any size, and this program has no process to try it in: \
         call `dermis_inference::trial::serve` first in `main`"
    )]
    Unbounded {
        /// The operator.
        operator: String,
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

/// Inputs that a model is tried on.
const REHEARSALS: usize = 9;
/// Range of a normalised reading: deviations from its mean.
const NORMALISED: [f32; 2] = [-3.0, 3.0];
/// Difference of two ways to evaluate a dense network that is rounding, as a share of the largest answer: sums of hundreds of products
/// of 24 bits, and sigmoids that runtimes approximate to some 1e-6.
const ROUNDING: f32 = 1e-4;

/// One loaded graph; runs on the calling thread.
#[derive(Debug)]
pub struct Model {
    engine: Engine,
    input_len: usize,
    output_len: usize,
}

/// What evaluates it.
#[derive(Debug)]
enum Engine {
    Native {
        session: Session,
        inputs: Vec<(String, Tensor<f32>)>,
        outputs: Vec<String>,
    },
    // One state for all runs: a new one for each costs as much again as the arithmetic, and what operators keep for a
    // state that has gone is not all given back.
    Embedded {
        state: TypedSimpleState,
        inputs: Vec<Part>,
        outputs: Vec<usize>,
    },
    /// In the place of the embedded runtime where all tensors are rows.
    Rows(Box<Plan>),
}

/// An input tensor in the order of the graph: which of the numbers that go in are its own.
#[derive(Debug)]
struct Part {
    numbers: Range<usize>,
    shape: Vec<usize>,
}

impl Model {
    /// Loads a graph from the bytes of an `.onnx` file.
    ///
    /// # Errors
    ///
    /// [`ModelError`] where the bytes are no graph, the graph has another interface, or the runtime refuses it.
    pub fn load(runtime: &Runtime, bytes: &[u8], interface: &Interface) -> Result<Self, ModelError> {
        onnx::check(bytes, interface)?;
        let refused = |reason: String| refusal(runtime.report().to_string(), &reason);
        let (Some(input_len), Some(output_len)) = (interface.input_len(), interface.output_len()) else {
            return Err(refused("a declared shape has no elements, or far too many".into()));
        };
        let engine = match runtime.environment() {
            Some(environment) => {
                let session = (|| {
                    Session::builder(environment)?
                        .with_optimization_level(GraphOptimizationLevel::All)?
                        .with_intra_threads(1)?
                        .with_inter_threads(1)?
                        .commit_from_memory(bytes)
                })()
                .map_err(|e: ort::Error| refused(e.to_string()))?;
                let tensor = |(name, shape): (&str, &[usize])| {
                    let zeros = vec![0.0_f32; elements(shape).unwrap_or_default()];
                    Ok((name.to_owned(), Tensor::from_array((shape.to_vec(), zeros))?))
                };
                let inputs = interface.inputs().map(tensor).collect::<Result<_, ort::Error>>();
                let inputs = inputs.map_err(|e| refused(e.to_string()))?;
                let outputs = interface.outputs().map(|(name, _)| name.to_owned()).collect();
                Engine::Native { session, inputs, outputs }
            }
            None => embedded(bytes, interface).map_err(refused)?,
        };
        let mut model = Self { engine, input_len, output_len };
        // Shapes inside of a graph are only known to fit once it has run.
        let first = || model.run(&vec![0.0; input_len], &mut Vec::new());
        caught(first).map_err(refused)?.map_err(|e| refused(e.to_string()))?;
        if matches!(model.engine, Engine::Embedded { .. })
            && let Some(plan) = model.plan(bytes, interface)
        {
            model.engine = Engine::Rows(plan);
        }
        Ok(model)
    }

    /// The graph as a sequence of loops over rows, where it is one and answers as it does now.
    fn plan(&mut self, bytes: &[u8], interface: &Interface) -> Option<Box<Plan>> {
        let mut plan = Box::new(Plan::translate(bytes, interface)?);
        let (mut inputs, mut answers, mut row) = (Vec::new(), Vec::new(), vec![0.0; self.input_len]);
        let mut drawn = Plausible::default();
        for _ in 0..REHEARSALS {
            self.append(&row, &mut answers).ok()?;
            inputs.extend_from_slice(&row);
            drawn.next(&[], &mut row);
        }
        let agrees = plan.agrees(&inputs, &answers, ROUNDING);
        if !agrees {
            tracing::debug!(
                "the translation of a dense network answers otherwise than the embedded runtime; it is not used"
            );
        }
        agrees.then_some(plan)
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

    /// Runs it on plausible inputs, the same ones each time: on zeros, and on numbers from all of `ranges` and from their middle third.
    /// An input beyond the last range is a normalised reading: up to three deviations from its mean.
    ///
    /// # Errors
    ///
    /// [`ModelError::OutputNotFinite`], and as [`run`](Self::run).
    pub fn rehearse(&mut self, ranges: &[[f32; 2]]) -> Result<(), ModelError> {
        let (mut input, mut output) = (vec![0.0; self.input_len], Vec::new());
        let mut drawn = Plausible::default();
        for run in 0..REHEARSALS {
            if run > 0 {
                drawn.next(ranges, &mut input);
            }
            self.run(&input, &mut output)?;
            if let Some((index, value)) = output.iter().enumerate().find(|(_, v)| !v.is_finite()) {
                return Err(ModelError::OutputNotFinite { index, value: *value, run });
            }
        }
        Ok(())
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
        let before = output.len();
        match &mut self.engine {
            Engine::Native { session, inputs, outputs: names } => {
                let run = |e: ort::Error| ModelError::Run { reason: e.to_string() };
                let mut rest = input;
                for (_, tensor) in inputs.iter_mut() {
                    let slots = tensor.extract_tensor_mut().1;
                    let (own, others) = rest.split_at(slots.len());
                    slots.copy_from_slice(own);
                    rest = others;
                }
                let outputs = match inputs.as_slice() {
                    [(_, tensor)] => session.run(ort::inputs![tensor]),
                    several => {
                        let named: Vec<(&str, &Tensor<f32>)> =
                            several.iter().map(|(name, tensor)| (name.as_str(), tensor)).collect();
                        session.run(named)
                    }
                };
                let outputs = outputs.map_err(run)?;
                for name in names {
                    let values = outputs
                        .get(name.as_str())
                        .ok_or_else(|| ModelError::Run { reason: format!("no output `{name}` came out") })?;
                    let (_, values) = values.try_extract_tensor::<f32>().map_err(run)?;
                    output.extend_from_slice(values);
                }
            }
            Engine::Embedded { state, inputs, outputs: indices } => {
                let run = |e: TractError| ModelError::Run { reason: format!("{e:#}") };
                let mut tensors = tvec!();
                for part in inputs {
                    let numbers = input.get(part.numbers.clone()).unwrap_or_default();
                    let tensor =
                        tract_onnx::prelude::Tensor::from_shape(&part.shape, numbers).map_err(run)?;
                    tensors.push(tensor.into());
                }
                let outputs = caught(|| state.run(tensors))
                    .map_err(|reason| ModelError::Run { reason })?
                    .map_err(run)?;
                for index in indices {
                    let values = outputs
                        .get(*index)
                        .ok_or_else(|| ModelError::Run { reason: format!("no output {index} came out") })?;
                    output.extend(values.to_plain_array_view::<f32>().map_err(run)?.iter());
                }
            }
            Engine::Rows(plan) => plan.run(input, output),
        }
        check_len(output.len() - before, self.output_len)
    }
}

/// Draws inputs, the same ones each time.
struct Plausible {
    state: u64,
    drawn: u32,
}

impl Default for Plausible {
    fn default() -> Self {
        Self { state: 0x9e37_79b9_7f4a_7c15, drawn: 0 }
    }
}

impl Plausible {
    /// Fills `input` with numbers from all of `ranges`, every other time from their middle third. A number beyond the last range is a
    /// normalised reading.
    fn next(&mut self, ranges: &[[f32; 2]], input: &mut [f32]) {
        self.drawn += 1;
        let share = if self.drawn.is_multiple_of(2) { 1.0 / 3.0 } else { 1.0 };
        // Numbers from −1 to 1 of an xorshift generator: any will do.
        let state = &mut self.state;
        for (i, value) in input.iter_mut().enumerate() {
            *state ^= *state << 13;
            *state ^= *state >> 7;
            *state ^= *state << 17;
            let [low, high] = ranges.get(i).copied().unwrap_or(NORMALISED);
            let place = share * ((*state >> 40) as f32 / (1u32 << 23) as f32 - 1.0);
            *value = 0.5 * (low + high) + 0.5 * (high - low) * place;
        }
    }
}

fn check_len(got: usize, declared: usize) -> Result<(), ModelError> {
    if got == declared {
        return Ok(());
    }
    Err(ModelError::Run { reason: format!("{got} numbers came out where {declared} are declared") })
}

fn refusal(runtime: String, reason: &str) -> ModelError {
    ModelError::Refused { runtime, reason: dermis_io::one_line(reason) }
}

/// A graph in the embedded runtime, ready to run.
fn embedded(bytes: &[u8], interface: &Interface) -> Result<Engine, String> {
    let signature = onnx::Signature::read(bytes).map_err(|e| e.to_string())?;
    let place = |name: &str| signature.outputs.iter().position(|tensor| tensor.name == name);
    let outputs = interface
        .outputs()
        .map(|(name, _)| place(name).ok_or_else(|| format!("it has no output `{name}`")))
        .collect::<Result<_, _>>()?;
    let mut start = 0;
    let mut parts = std::collections::BTreeMap::new();
    for (name, shape) in interface.inputs() {
        let end = start + elements(shape).unwrap_or_default();
        parts.insert(name, Part { numbers: start..end, shape: shape.to_vec() });
        start = end;
    }
    let take = |tensor: &onnx::GraphTensor| {
        parts
            .remove(tensor.name.as_str())
            .ok_or_else(|| format!("it has an input `{}` too many", tensor.name))
    };
    let inputs = signature.inputs.iter().map(take).collect::<Result<_, _>>()?;
    let prepare =
        || tract_onnx::onnx().model_for_read(&mut &*bytes)?.into_optimized()?.into_runnable()?.spawn();
    let state = caught(prepare)?.map_err(|e: TractError| format!("{e:#}"))?;
    Ok(Engine::Embedded { state, inputs, outputs })
}

/// The embedded runtime may panic on a graph that parses but makes no sense; here that becomes a refusal.
fn caught<R>(work: impl FnOnce() -> R) -> Result<R, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|_| "it cannot be evaluated".into())
}

/// Runs a graph once in the embedded runtime, whichever runtime the process has chosen; what comes out.
///
/// # Errors
///
/// [`ModelError`] where the bytes are no graph of this interface, or the runtime refuses them.
pub fn rehearse_embedded(bytes: &[u8], interface: &Interface, input: &[f32]) -> Result<Vec<f32>, ModelError> {
    onnx::check(bytes, interface)?;
    let refused = |reason: String| refusal("the embedded runtime".into(), &reason);
    let (Some(input_len), Some(output_len)) = (interface.input_len(), interface.output_len()) else {
        return Err(refused("a declared shape has no elements, or far too many".into()));
    };
    let mut model = Model { engine: embedded(bytes, interface).map_err(refused)?, input_len, output_len };
    let mut output = Vec::new();
    caught(|| model.run(input, &mut output)).map_err(refused)??;
    Ok(output)
}
