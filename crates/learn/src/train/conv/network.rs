//! A network: its parameters, and how they are put together.

use burn::tensor::{Device, Tensor, TensorData};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::ops::{Burn, Onnx, Ops};
use super::{ConvSpec, Form};
use crate::LearnError;
use crate::picture::Mixing;
use crate::train::layer::{Layer, shapes};

/// Numbers that are fitted; weights and their biases alternate.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Parameter {
    pub(super) shape: Vec<usize>,
    pub(super) values: Vec<f32>,
}

/// A convolutional network with its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct ConvNetwork {
    pub(super) spec: ConvSpec,
    pub(super) parameters: Vec<Parameter>,
}

/// Height and width of every level of an encoder, from the input on.
fn levels([height, width]: [usize; 2], count: usize) -> Vec<[usize; 2]> {
    let half = |size: &[usize; 2]| Some(size.map(|s| s.div_ceil(2)));
    std::iter::successors(Some([height, width]), half).take(count + 1).collect()
}

/// Names the parameters in the order in which [`forward`] uses them.
struct Plan {
    rng: ChaCha8Rng,
    parameters: Vec<Parameter>,
}

impl Plan {
    /// A weight and its bias; weights are drawn as He et al. (2015) do for positive parts.
    fn push(&mut self, shape: &[usize], inputs: usize, outputs: usize) {
        let deviation = (2.0 / inputs as f32).sqrt();
        let rng = &mut self.rng;
        let values =
            (0..shape.iter().product()).map(|_| deviation * rng.sample::<f32, _>(StandardNormal)).collect();
        self.parameters.push(Parameter { shape: shape.to_vec(), values });
        self.parameters.push(Parameter { shape: vec![outputs], values: vec![0.0; outputs] });
    }

    fn conv(&mut self, from: usize, to: usize) {
        self.push(&[to, from, 3, 3], 9 * from, to);
    }

    fn grow(&mut self, from: usize, to: usize) {
        self.push(&[from, to, 2, 2], from, to);
    }

    fn dense(&mut self, from: usize, to: usize) {
        self.push(&[from, to], from, to);
    }

    fn sequence(&mut self, spec: &ConvSpec) {
        let made = shapes(spec.shape, &spec.layers).unwrap_or_default();
        for (layer, from) in spec.layers.iter().zip(made) {
            match *layer {
                Layer::Linear { outputs } => self.dense(from.iter().product(), outputs),
                Layer::Transposed { channels, kernel, stride, .. } => {
                    // So many numbers of the input reach one of the output.
                    let reach = kernel.div_ceil(stride).pow(2).min(from[1] * from[2]);
                    self.push(&[from[0], channels, kernel, kernel], from[0] * reach, channels);
                }
                Layer::Upsample { .. } => {}
            }
        }
    }
}

/// Channels of a decoder at every level, from the deepest on; the last is the finest.
fn decoder(spec: &ConvSpec) -> Vec<usize> {
    let first = spec.encoder[0];
    spec.encoder.iter().rev().skip(1).copied().chain([first]).collect()
}

/// As [`forward`], of a sequence of layers.
fn sequence<O: Ops>(spec: &ConvSpec, ops: &mut O, input: &O::Value) -> Vec<O::Value> {
    let made = shapes(spec.shape, &spec.layers).unwrap_or_default();
    let last = spec.layers.iter().rposition(|layer| layer.is_weighted());
    let (mut x, mut index) = (input.clone(), 0);
    for (i, (layer, from)) in spec.layers.iter().zip(&made).enumerate() {
        x = match *layer {
            Layer::Linear { outputs } => {
                let flat = ops.reshape(&x, [1, 1, from.iter().product()]);
                let y = ops.dense(&flat, index);
                ops.reshape(&y, [outputs, 1, 1])
            }
            Layer::Transposed { stride, padding, .. } => ops.transposed(&x, index, stride, padding),
            Layer::Upsample { factor } => ops.upsample(&x, *from, factor),
        };
        if layer.is_weighted() {
            index += 2;
            if Some(i) != last {
                x = ops.relu(&x);
            }
        }
    }
    vec![x]
}

/// Evaluates or writes a network; outputs in the order of the heads, each with the shape \[batch, …\] of its form.
fn forward<O: Ops>(spec: &ConvSpec, ops: &mut O, input: &O::Value) -> Vec<O::Value> {
    if !spec.layers.is_empty() {
        return sequence(spec, ops, input);
    }
    let mut index = 0;
    // A weight, and the bias behind it.
    let mut next = || {
        index += 2;
        index - 2
    };
    let sizes = levels([spec.shape[1], spec.shape[2]], spec.encoder.len());
    let mut code = input.clone();
    for _ in &spec.encoder {
        let x = ops.conv(&code, next(), 2);
        code = ops.relu(&x);
    }
    let deepest = [
        spec.encoder.last().copied().unwrap_or(1),
        sizes[spec.encoder.len()][0],
        sizes[spec.encoder.len()][1],
    ];
    let flat = ops.reshape(&code, [1, 1, deepest.iter().product()]);
    let hidden = ops.dense(&flat, next());
    let hidden = ops.relu(&hidden);
    let mut outputs = Vec::with_capacity(spec.heads.len());
    for head in &spec.heads {
        let Form::Map([_, height, width]) = head.form else {
            outputs.push(ops.dense(&hidden, next()));
            continue;
        };
        let sizes = levels([height, width], spec.encoder.len());
        let mut x = if [height, width] == [spec.shape[1], spec.shape[2]] {
            code.clone()
        } else {
            let [h, w] = sizes[spec.encoder.len()];
            let x = ops.dense(&hidden, next());
            let x = ops.relu(&x);
            ops.reshape(&x, [deepest[0], h, w])
        };
        for [h, w] in sizes.iter().rev().skip(1) {
            let grown = ops.grow(&x, next());
            let cut = ops.crop(&grown, *h, *w);
            let cut = ops.relu(&cut);
            let smooth = ops.conv(&cut, next(), 1);
            x = ops.relu(&smooth);
        }
        outputs.push(ops.conv(&x, next(), 1));
    }
    outputs
}

impl ConvNetwork {
    /// A network whose parameters are drawn with `seed`.
    ///
    /// # Errors
    ///
    /// As [`ConvSpec::validate`].
    pub fn new(spec: &ConvSpec, seed: u64) -> Result<Self, LearnError> {
        spec.validate()?;
        let mut plan = Plan { rng: ChaCha8Rng::seed_from_u64(seed), parameters: Vec::new() };
        if !spec.layers.is_empty() {
            plan.sequence(spec);
            return Ok(Self { spec: spec.clone(), parameters: plan.parameters });
        }
        let depth = spec.encoder.len();
        let mut from = spec.shape[0];
        for to in &spec.encoder {
            plan.conv(from, *to);
            from = *to;
        }
        let [h, w] = levels([spec.shape[1], spec.shape[2]], depth)[depth];
        plan.dense(from * h * w, spec.hidden);
        for head in &spec.heads {
            let Form::Map([channels, height, width]) = head.form else {
                plan.dense(spec.hidden, head.form.len());
                continue;
            };
            if [height, width] != [spec.shape[1], spec.shape[2]] {
                let [h, w] = levels([height, width], depth)[depth];
                plan.dense(spec.hidden, from * h * w);
            }
            let mut narrow = from;
            for to in decoder(spec) {
                plan.grow(narrow, to);
                plan.conv(to, to);
                narrow = to;
            }
            plan.conv(narrow, channels);
        }
        Ok(Self { spec: spec.clone(), parameters: plan.parameters })
    }

    /// What goes in and what comes out.
    #[must_use]
    pub fn spec(&self) -> &ConvSpec {
        &self.spec
    }

    /// Number of parameters.
    #[must_use]
    pub fn len(&self) -> usize {
        self.parameters.iter().map(|p| p.values.len()).sum()
    }

    /// Whether there is nothing to fit; never so.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// What burn makes of inputs that lie end to end: for every head, the outputs end to end.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the inputs have another length, or burn cannot give its numbers.
    pub fn evaluate(&self, inputs: &[f32]) -> Result<Vec<Vec<f32>>, LearnError> {
        if !inputs.len().is_multiple_of(self.spec.input_len()) {
            return Err(LearnError::Training {
                reason: format!(
                    "{} numbers are no whole number of inputs of {:?}",
                    inputs.len(),
                    self.spec.shape
                ),
            });
        }
        let device = Device::flex();
        let tensors = self.tensors(&device);
        let batch = inputs.len() / self.spec.input_len();
        let x = batch_of(inputs.to_vec(), batch, self.spec.shape, &device);
        self.forward(&tensors, &x, false).into_iter().map(numbers).collect()
    }

    pub(super) fn tensors(&self, device: &Device) -> Vec<Tensor<1>> {
        let tensor =
            |p: &Parameter| Tensor::from_data(TensorData::new(p.values.clone(), [p.values.len()]), device);
        self.parameters.iter().map(tensor).collect()
    }

    /// What burn makes of inputs, with sums of gradients `split` or not.
    pub(super) fn forward(&self, tensors: &[Tensor<1>], x: &Tensor<4>, split: bool) -> Vec<Tensor<4>> {
        forward(&self.spec, &mut Burn { shapes: &self.parameters, tensors, split }, x)
    }

    /// The bytes of an `.onnx` file of batch 1, whose outputs are called as the heads are.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the graph cannot be written.
    pub fn to_onnx(&self, name: &str) -> Result<Vec<u8>, LearnError> {
        self.write(name, None)
    }

    /// As [`to_onnx`](Self::to_onnx), of a network with one map, whose numbers are mixed by `mixing` in the graph: the output is
    /// \[1, rows of `mixing`\].
    ///
    /// # Errors
    ///
    /// As [`to_onnx`](Self::to_onnx), and where `mixing` is of another number of values than the map.
    pub fn to_onnx_mixed(&self, name: &str, mixing: &Mixing) -> Result<Vec<u8>, LearnError> {
        let columns: Vec<usize> = self.spec.heads.iter().map(|head| head.form.len()).collect();
        if columns != [mixing.columns()] {
            return Err(LearnError::Training {
                reason: format!("outputs of {columns:?} numbers cannot be mixed from {}", mixing.columns()),
            });
        }
        self.write(name, Some(mixing))
    }

    fn write(&self, name: &str, mixing: Option<&Mixing>) -> Result<Vec<u8>, LearnError> {
        let mut ops = Onnx::new(name, &self.parameters);
        let [channels, height, width] = self.spec.shape;
        let input = ops.graph.input(&self.spec.input, &[1, channels, height, width]);
        let outputs = forward(&self.spec, &mut ops, &input);
        for (head, value) in self.spec.heads.iter().zip(outputs) {
            if let Some(mixing) = mixing {
                let mixed = mixing.write(&mut ops.graph, &value);
                ops.graph.output(&head.name, &mixed, &[1, mixing.rows()]);
                continue;
            }
            match head.form {
                Form::Vector(count) => {
                    let flat = ops.graph.reshape(&value, &[1, count]);
                    ops.graph.output(&head.name, &flat, &[1, count]);
                }
                Form::Map([c, h, w]) => ops.graph.output(&head.name, &value, &[1, c, h, w]),
            }
        }
        ops.graph
            .finish()
            .map_err(|e| LearnError::Training { reason: format!("the graph cannot be written: {e}") })
    }
}

pub(super) fn batch_of(values: Vec<f32>, batch: usize, [c, h, w]: [usize; 3], device: &Device) -> Tensor<4> {
    Tensor::from_data(TensorData::new(values, [batch, c, h, w]), device)
}

/// The numbers of a tensor, row by row.
pub(super) fn numbers<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>, LearnError> {
    let data = tensor.into_data();
    let values = data.as_slice::<f32>();
    values
        .map(<[f32]>::to_vec)
        .map_err(|e| LearnError::Training { reason: format!("burn gives no numbers: {e}") })
}
