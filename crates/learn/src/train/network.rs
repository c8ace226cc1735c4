//! Multilayer perceptrons: fitting, and as an ONNX graph.
//!
//! Nothing but dense layers is trained here, so forward and backward pass are a few matrix products; a training
//! framework would take minutes to build and train 2 to 4 times slower. Gradients are checked against finite
//! differences in the tests.

use std::sync::atomic::{AtomicBool, Ordering};

use dermis_inference::onnx::{GraphBuilder, OnnxError, Value};
use dermis_regress::dense::{self, Activation, Adam, Product};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::config::{NetworkConfig, TrainingConfig};
use super::prepare::Preparation;
use crate::LearnError;
use crate::random::{STEP, mixed};

/// Samples end to end, normalised.
#[derive(Debug, Clone, Default)]
pub struct Batch {
    /// Row-major \[n, inputs\].
    pub inputs: Vec<f32>,
    /// Row-major \[n, outputs\]; NaN where unknown. With `logit`, the last one is 0 or 1.
    pub targets: Vec<f32>,
    /// Weight of every target; empty: all count the same.
    pub weights: Vec<f32>,
    /// Number of inputs.
    pub width: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Whether the last output is the logit of a probability, fitted by cross entropy.
    pub logit: bool,
}

impl Batch {
    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.inputs.len() / self.width.max(1)
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.inputs.is_empty()
    }
}

/// One network: weights \[in, out\] and biases \[out\] of every layer.
#[derive(Debug, Clone, PartialEq)]
pub struct Mlp {
    /// Inputs, hidden widths, outputs.
    sizes: Vec<usize>,
    activation: Activation,
    /// Weight, bias, weight, bias, …
    pub(super) parameters: Vec<Vec<f32>>,
}

impl Mlp {
    /// He initialisation; the last layer starts small.
    #[must_use]
    pub fn new(inputs: usize, outputs: usize, config: &NetworkConfig, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let sizes: Vec<usize> =
            std::iter::once(inputs).chain(config.hidden.iter().copied()).chain([outputs]).collect();
        let mut parameters = Vec::new();
        for (layer, w) in sizes.windows(2).enumerate() {
            let last = if layer + 2 == sizes.len() { 0.1 } else { 1.0 };
            let scale = (2.0 / w[0] as f64).sqrt() * last;
            parameters.push(
                (0..w[0] * w[1])
                    .map(|_| (scale * Distribution::<f64>::sample(&StandardNormal, &mut rng)) as f32)
                    .collect(),
            );
            parameters.push(vec![0.0; w[1]]);
        }
        Self { sizes, activation: config.activation, parameters }
    }

    /// A single layer without a non-linearity: `weight` is row-major \[inputs, outputs\], and there is no bias.
    ///
    /// # Panics
    ///
    /// Where `weight` has another length.
    #[must_use]
    pub fn linear(inputs: usize, outputs: usize, weight: Vec<f32>) -> Self {
        assert_eq!(weight.len(), inputs * outputs, "one weight for each pair");
        Self {
            sizes: vec![inputs, outputs],
            activation: Activation::default(),
            parameters: vec![weight, vec![0.0; outputs]],
        }
    }

    /// Number of inputs.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.sizes[0]
    }

    /// Number of outputs.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.sizes[self.sizes.len() - 1]
    }

    /// Widths of all layers: inputs, hidden ones, outputs.
    #[must_use]
    pub fn layers(&self) -> &[usize] {
        &self.sizes
    }

    /// Number of weights and biases.
    #[must_use]
    pub fn len(&self) -> usize {
        self.parameters.iter().map(Vec::len).sum()
    }

    /// Whether it has no parameter; never so.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn shape(&self, parameter: usize) -> [usize; 2] {
        let layer = parameter / 2;
        if parameter.is_multiple_of(2) {
            [self.sizes[layer], self.sizes[layer + 1]]
        } else {
            [1, self.sizes[layer + 1]]
        }
    }

    /// Outputs for rows that lie end to end.
    #[must_use]
    pub fn predict(&self, inputs: &[f32]) -> Vec<f32> {
        let mut layers = Layers::default();
        self.forward(inputs, &mut layers);
        layers.values.pop().unwrap_or_default()
    }

    fn forward(&self, inputs: &[f32], layers: &mut Layers) {
        let rows = inputs.len() / self.sizes[0];
        let last = self.sizes.len() - 2;
        layers.values.resize(last + 1, Vec::new());
        layers.slopes.resize(last, Vec::new());
        for layer in 0..=last {
            let [width, outputs] = self.shape(2 * layer);
            let (before, after) = layers.values.split_at_mut(layer);
            let x = before.last().map_or(inputs, Vec::as_slice);
            let z = &mut after[0];
            z.clear();
            for _ in 0..rows {
                z.extend_from_slice(&self.parameters[2 * layer + 1]);
            }
            let product = Product { rows, inner: width, columns: outputs, keep: true };
            product.run(x, [width, 1], &self.parameters[2 * layer], [outputs, 1], z);
            if layer < last {
                self.activation.apply(z, &mut layers.slopes[layer]);
            }
        }
    }

    /// Gradient of the loss by every parameter, from the gradient by the outputs.
    fn backward(&self, inputs: &[f32], layers: &mut Layers, mut by_output: Vec<f32>) {
        let rows = inputs.len() / self.sizes[0];
        let gradients = &mut layers.gradients;
        gradients.resize(self.parameters.len(), Vec::new());
        for (gradient, parameter) in gradients.iter_mut().zip(&self.parameters) {
            gradient.resize(parameter.len(), 0.0);
        }
        for layer in (0..self.sizes.len() - 1).rev() {
            let [width, outputs] = self.shape(2 * layer);
            let x = layer.checked_sub(1).map_or(inputs, |l| layers.values[l].as_slice());
            // xᵀ · g.
            let product = Product { rows: width, inner: rows, columns: outputs, keep: false };
            product.run(x, [1, width], &by_output, [outputs, 1], &mut gradients[2 * layer]);
            dense::sum_rows(&by_output, &mut gradients[2 * layer + 1]);
            if let Some(before) = layer.checked_sub(1) {
                // g · wᵀ.
                let mut by_input = vec![0.0; rows * width];
                let product = Product { rows, inner: outputs, columns: width, keep: false };
                product.run(
                    &by_output,
                    [outputs, 1],
                    &self.parameters[2 * layer],
                    [1, outputs],
                    &mut by_input,
                );
                dense::multiply(&mut by_input, &layers.slopes[before]);
                by_output = by_input;
            }
        }
    }

    /// Loss over rows; its gradient by every parameter is left in `layers`.
    fn gradient(
        &self,
        inputs: &[f32],
        (targets, weights): (&[f32], &[f32]),
        logit: bool,
        layers: &mut Layers,
    ) -> f32 {
        self.forward(inputs, layers);
        let answers = layers.values.last().map_or(&[][..], Vec::as_slice);
        let (loss, by_output) =
            dense::loss(answers, (targets, weights), self.sizes[self.sizes.len() - 1], logit);
        self.backward(inputs, layers, by_output);
        loss
    }

    /// Its operators in a graph, whose outputs are `factor` times its own; `input` is \[n, inputs\]. `name` tells its constants
    /// from those of other networks in the graph.
    pub fn to_graph(&self, g: &mut GraphBuilder, input: &Value, name: &str, factor: f32) -> Value {
        let last = self.sizes.len() - 2;
        let mut x = input.clone();
        for layer in 0..=last {
            let factor = if layer == last { factor } else { 1.0 };
            let scaled = |values: &[f32]| values.iter().map(|v| v * factor).collect::<Vec<f32>>();
            let [rows, columns] = self.shape(2 * layer);
            let weight = scaled(&self.parameters[2 * layer]);
            let bias = scaled(&self.parameters[2 * layer + 1]);
            let weight = g.constant(&format!("weight_{name}_{layer}"), &[rows, columns], &weight);
            let bias = g.constant(&format!("bias_{name}_{layer}"), &[columns], &bias);
            x = g.gemm(&x, &weight, Some(&bias));
            if layer < last {
                x = match self.activation {
                    Activation::Silu => {
                        let gate = g.sigmoid(&x);
                        g.mul(&x, &gate)
                    }
                    Activation::Tanh => g.tanh(&x),
                    Activation::Relu => g.relu(&x),
                };
            }
        }
        x
    }

    /// The mean of several networks of one interface behind a preparation, as a graph of batch 1: `input` →
    /// `output`.
    ///
    /// # Errors
    ///
    /// [`OnnxError`] where there is no network.
    pub fn to_onnx(members: &[Self], preparation: &Preparation, name: &str) -> Result<Vec<u8>, OnnxError> {
        let mut g = GraphBuilder::new(name);
        let Some(first) = members.first() else { return g.finish() };
        let outputs = first.sizes[first.sizes.len() - 1];
        let input = g.input("input", &[1, preparation.width()]);
        let input = preparation.to_graph(&mut g, &input);
        if let Some(mean) = Self::mean_to_graph(members, &mut g, &input) {
            g.output("output", &mean, &[1, outputs]);
        }
        g.finish()
    }

    /// The mean of several networks of one interface as operators; `None` of none.
    pub(super) fn mean_to_graph(members: &[Self], g: &mut GraphBuilder, input: &Value) -> Option<Value> {
        let mut mean: Option<Value> = None;
        let share = 1.0 / members.len() as f32;
        for (m, member) in members.iter().enumerate() {
            // The mean is taken in the last layer's weights.
            let x = member.to_graph(g, input, &m.to_string(), share);
            mean = Some(match mean {
                Some(sum) => g.add(&sum, &x),
                None => x,
            });
        }
        mean
    }
}

/// What a forward pass leaves for the backward pass, and what that leaves. It is used again for the next rows: to allocate the gradients
/// of a large network anew takes as long as a tenth of its products.
#[derive(Default)]
struct Layers {
    /// Outputs of every layer, row-major \[n, width\].
    values: Vec<Vec<f32>>,
    /// Derivative of every hidden activation.
    slopes: Vec<Vec<f32>>,
    /// Gradient of the loss by every parameter.
    gradients: Vec<Vec<f32>>,
}

/// A network on its way, and what is needed to go on exactly where it was.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct State {
    pub(super) network: Mlp,
    /// Running mean and mean square of every gradient.
    pub(super) first: Vec<Vec<f32>>,
    pub(super) second: Vec<Vec<f32>>,
    /// Steps done.
    pub(super) steps: u64,
    /// Epochs done.
    pub(super) epoch: u32,
}

impl State {
    pub(super) fn new(network: Mlp) -> Self {
        let zeros: Vec<Vec<f32>> = network.parameters.iter().map(|p| vec![0.0; p.len()]).collect();
        Self { network, first: zeros.clone(), second: zeros, steps: 0, epoch: 0 }
    }
}

/// What is reported after every epoch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Which network of an ensemble.
    pub member: u32,
    /// Epochs done.
    pub epoch: u32,
    /// Epochs to do.
    pub epochs: u32,
    /// Mean loss over the epoch, in normalised units.
    pub loss: f64,
}

/// Fits one network from the start, without checkpoints.
///
/// # Errors
///
/// [`LearnError::Training`] where the loss stops being a number.
pub fn fit(
    data: &Batch,
    network: &NetworkConfig,
    training: &TrainingConfig,
    member: u32,
) -> Result<Mlp, LearnError> {
    let mut state = State::new(Mlp::new(data.width, data.outputs, network, seed_of(training, member, 0)));
    advance(&mut state, data, training, member, &AtomicBool::new(false), &mut |_, _| Ok(()))?;
    Ok(state.network)
}

/// A seed for each member and epoch, so that a resumed run shuffles as one that was never interrupted.
pub(super) fn seed_of(training: &TrainingConfig, member: u32, epoch: u32) -> u64 {
    let steps = u64::from(member) << 32 | u64::from(epoch);
    mixed(training.seed.wrapping_add(steps.wrapping_mul(STEP)))
}

/// Goes on until all epochs are done or `stop` is set; `report` is called after every epoch.
pub(super) fn advance(
    state: &mut State,
    data: &Batch,
    training: &TrainingConfig,
    member: u32,
    stop: &AtomicBool,
    report: &mut dyn FnMut(&State, Progress) -> Result<(), LearnError>,
) -> Result<(), LearnError> {
    let samples = data.len();
    if samples == 0 {
        return Err(LearnError::Training { reason: "there is no sample to train on".into() });
    }
    let mut layers = Layers::default();
    let batches = samples.div_ceil(training.batch) as u64;
    let total = batches * u64::from(training.epochs);
    let mut order: Vec<usize> = (0..samples).collect();
    while state.epoch < training.epochs {
        if stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed_of(training, member, state.epoch + 1));
        order.sort_unstable();
        order.shuffle(&mut rng);
        let mut sum = 0.0;
        for chunk in order.chunks(training.batch) {
            let loss = step(state, data, chunk, training, total, &mut rng, &mut layers);
            sum += f64::from(loss) * chunk.len() as f64;
        }
        state.epoch += 1;
        let loss = sum / samples as f64;
        if !loss.is_finite() {
            return Err(LearnError::Training {
                reason: format!(
                    "the loss is no number any more after epoch {}; lower `training.learning_rate` (now {})",
                    state.epoch, training.learning_rate
                ),
            });
        }
        report(state, Progress { member, epoch: state.epoch, epochs: training.epochs, loss })?;
    }
    Ok(())
}

fn step(
    state: &mut State,
    data: &Batch,
    chunk: &[usize],
    training: &TrainingConfig,
    total: u64,
    rng: &mut ChaCha8Rng,
    layers: &mut Layers,
) -> f32 {
    let (width, outputs) = (data.width, data.outputs);
    let mut inputs = Vec::with_capacity(chunk.len() * width);
    let mut targets = Vec::with_capacity(chunk.len() * outputs);
    let mut weights = Vec::new();
    for &i in chunk {
        if let Some(row) = data.weights.get(i * outputs..(i + 1) * outputs) {
            weights.extend_from_slice(row);
        }
        inputs.extend_from_slice(&data.inputs[i * width..(i + 1) * width]);
        targets.extend_from_slice(&data.targets[i * outputs..(i + 1) * outputs]);
    }
    if training.noise > 0.0 {
        for x in &mut inputs {
            *x += training.noise as f32 * rng.sample::<f32, _>(StandardNormal);
        }
    }
    let loss = state.network.gradient(&inputs, (&targets, &weights), data.logit, layers);
    state.steps += 1;
    let progress = state.steps as f64 / total as f64;
    let rate = training.learning_rate * 0.5 * (1.0 + (std::f64::consts::PI * progress.min(1.0)).cos());
    for (i, gradient) in layers.gradients.iter().enumerate() {
        let decay = if i.is_multiple_of(2) { training.weight_decay } else { 0.0 };
        let moments = [&mut state.first[i][..], &mut state.second[i][..]];
        let adam = Adam { step: state.steps, rate, decay, momentum: training.momentum };
        adam.step(&mut state.network.parameters[i], gradient, moments);
    }
    loss
}

#[cfg(test)]
mod tests;
