//! Fits a network to samples that are streamed.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use burn::tensor::{Device, Tensor, TensorData};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::loss::{Losses, loss};
use super::network::{ConvNetwork, numbers};
use super::{ConvSpec, TensorReader, TensorSample, checkpoint};
use crate::LearnError;
use crate::train::Processor;

/// Decay of Adam's second moment, and what keeps its quotient finite.
const DECAY: f32 = 0.999;
const EPSILON: f32 = 1e-8;

/// How a network is fitted.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConvTraining {
    /// Most passes over the samples.
    pub epochs: u32,
    /// Samples a step.
    pub batch: usize,
    /// Largest step size; it falls to 0 along a cosine over all epochs.
    pub learning_rate: f64,
    /// Epochs without a lower error on the validation samples after which training ends; 0: never.
    pub patience: u32,
    /// Samples among which the next one is drawn.
    pub shuffle: usize,
    /// Seed of every random choice.
    pub seed: u64,
    /// Decay of Adam's first moment.
    pub momentum: f64,
    /// Standard deviation of Gaussian noise that is added to every number of an input at every step; none where empty.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub noise: Vec<f32>,
    /// What the samples are, as a hash of them, say: the state of training on others is not continued.
    pub data: String,
    /// What computes. Sums round differently on another one, and training that was interrupted goes on there all the same.
    #[serde(skip)]
    pub processor: Processor,
}

impl Default for ConvTraining {
    fn default() -> Self {
        Self {
            epochs: 60,
            batch: 32,
            learning_rate: 1e-3,
            patience: 10,
            shuffle: 1024,
            seed: 1,
            momentum: 0.9,
            noise: Vec::new(),
            data: String::new(),
            processor: Processor::Cpu,
        }
    }
}

/// How far fitting is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConvProgress {
    /// Epochs that are done.
    pub epoch: u32,
    /// Mean loss of the last one.
    pub training: f64,
    /// Mean loss of the validation samples after it.
    pub validation: f64,
    /// Whether that is the lowest so far.
    pub best: bool,
}

/// A fitted network.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// The best one.
    pub network: ConvNetwork,
    /// Its mean loss on the validation samples.
    pub validation: f64,
    /// The epoch that it is from.
    pub epoch: u32,
    /// Epochs that were done.
    pub epochs: u32,
}

/// Everything that changes while a network is fitted; what a checkpoint holds.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct State {
    pub(super) network: ConvNetwork,
    pub(super) first: Vec<Vec<f32>>,
    pub(super) second: Vec<Vec<f32>>,
    pub(super) best: ConvNetwork,
    pub(super) best_loss: f64,
    pub(super) best_epoch: u32,
    pub(super) epoch: u32,
    pub(super) steps: u64,
}

impl State {
    pub(super) fn new(network: ConvNetwork) -> Self {
        let zeros: Vec<Vec<f32>> = network.parameters.iter().map(|p| vec![0.0; p.values.len()]).collect();
        Self {
            best: network.clone(),
            first: zeros.clone(),
            second: zeros,
            network,
            best_loss: f64::INFINITY,
            best_epoch: 0,
            epoch: 0,
            steps: 0,
        }
    }
}

/// Fits a network to `train`, and keeps the one that does best on `validation`. With `state`, the state is saved there after
/// every epoch, and training goes on from what is there where `resume` is set. When `stop` is set, training ends after the
/// step that it is at; an epoch that was begun is done again on resuming. `progress` is called after every epoch.
///
/// On one processor, the result depends on the samples, their order, the specification and the seed only, also across a resumption.
///
/// # Errors
///
/// [`LearnError::Interrupted`] where `stop` was set, [`LearnError::Checkpoint`] where the state does not fit, and what the
/// readers say.
pub fn fit(
    spec: &ConvSpec,
    training: &ConvTraining,
    (train, validation): (&dyn TensorReader, &dyn TensorReader),
    state: Option<(&Path, bool)>,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(ConvProgress),
) -> Result<Fitted, LearnError> {
    if training.epochs == 0
        || training.batch == 0
        || !(training.learning_rate > 0.0 && training.learning_rate.is_finite())
        || !(0.0..1.0).contains(&training.momentum)
    {
        return Err(LearnError::Training {
            reason: "`training.epochs` and `training.batch` must be at least 1, `training.learning_rate` positive, and \
                     `training.momentum` from 0 to below 1".into(),
        });
    }
    check_noise(spec, &training.noise)?;
    let device = training.processor.device()?;
    let fresh = State::new(ConvNetwork::new(spec, training.seed)?);
    let mut now = match state {
        Some((path, true)) if path.exists() => checkpoint::load(path, fresh, spec, training)?,
        _ => fresh,
    };
    while now.epoch < training.epochs {
        let patience = training.patience > 0 && now.epoch > 0;
        if patience && now.epoch - now.best_epoch >= training.patience {
            break;
        }
        let before = now.epoch;
        let report =
            epoch(&mut now, training, (train, validation), &device, stop).map_err(|error| match error {
                LearnError::Interrupted { .. } => LearnError::Interrupted {
                    epoch: before,
                    epochs: training.epochs,
                    path: state.map(|(path, _)| path.to_owned()).unwrap_or_default(),
                },
                error => error,
            })?;
        if let Some((path, _)) = state {
            checkpoint::save(path, &now, training)?;
        }
        progress(report);
    }
    Ok(Fitted { network: now.best, validation: now.best_loss, epoch: now.best_epoch, epochs: now.epoch })
}

/// One pass over the training samples, and one over the validation samples.
fn epoch(
    state: &mut State,
    training: &ConvTraining,
    (train, validation): (&dyn TensorReader, &dyn TensorReader),
    device: &Device,
    stop: &AtomicBool,
) -> Result<ConvProgress, LearnError> {
    let mut live = Live::of(state, device);
    // A share of the way through all epochs: the number of samples need not be known before.
    let done = f64::from(state.epoch) / f64::from(training.epochs);
    let rate = training.learning_rate * 0.5 * (1.0 + (std::f64::consts::PI * done).cos());
    let mut rng = ChaCha8Rng::seed_from_u64(training.seed);
    rng.set_stream(u64::from(state.epoch) + 1);
    // A stream of its own: what is drawn does not depend on whether there is noise.
    let mut noise = ChaCha8Rng::seed_from_u64(training.seed);
    noise.set_stream(u64::MAX - u64::from(state.epoch));
    let spec = state.network.spec.clone();
    let split = training.processor != Processor::Cpu;
    let (mut pool, mut batch): (Vec<TensorSample>, Vec<TensorSample>) = (Vec::new(), Vec::new());
    let mut losses = Losses::default();
    let mut draw = |pool: &mut Vec<TensorSample>, batch: &mut Vec<TensorSample>, last: bool| {
        let index = rng.random_range(0..pool.len());
        let mut sample = pool.swap_remove(index);
        for (value, sigma) in sample.input.iter_mut().zip(&training.noise) {
            *value += sigma * noise.sample::<f32, _>(StandardNormal);
        }
        batch.push(sample);
        if batch.len() < training.batch && !(last && pool.is_empty()) {
            return Ok(());
        }
        if stop.load(Ordering::Relaxed) {
            return Err(LearnError::Interrupted { epoch: 0, epochs: 0, path: std::path::PathBuf::new() });
        }
        let loss = live.step(&state.network, batch, (rate, training.momentum), device, split);
        losses.push(loss, batch.len())?;
        batch.clear();
        Ok(())
    };
    train.each(&mut |sample| {
        check(&spec, &sample)?;
        pool.push(sample);
        if pool.len() >= training.shuffle.max(1) { draw(&mut pool, &mut batch, false) } else { Ok(()) }
    })?;
    while !pool.is_empty() {
        draw(&mut pool, &mut batch, true)?;
    }
    let loss = losses.mean("train on")?;
    live.store(state)?;
    state.epoch += 1;
    let checked = measure(&state.network, validation, training.batch, device, split)?;
    if !(loss.is_finite() && checked.is_finite()) {
        return Err(LearnError::Training {
            reason: format!(
                "the loss is no number any more after epoch {}; lower `training.learning_rate` (now {})",
                state.epoch, training.learning_rate
            ),
        });
    }
    let best = checked < state.best_loss;
    if best {
        (state.best, state.best_loss, state.best_epoch) = (state.network.clone(), checked, state.epoch);
    }
    Ok(ConvProgress { epoch: state.epoch, training: loss, validation: checked, best })
}

/// Mean loss over samples, without learning from them.
fn measure(
    network: &ConvNetwork,
    samples: &dyn TensorReader,
    size: usize,
    device: &Device,
    split: bool,
) -> Result<f64, LearnError> {
    let tensors = network.tensors(device);
    let (mut batch, mut losses) = (Vec::new(), Losses::default());
    let mut take = |batch: &mut Vec<TensorSample>| {
        losses.push(loss(network, &tensors, batch, device, split), batch.len())?;
        batch.clear();
        Ok(())
    };
    samples.each(&mut |sample| {
        check(&network.spec, &sample)?;
        batch.push(sample);
        if batch.len() < size { Ok(()) } else { take(&mut batch) }
    })?;
    if !batch.is_empty() {
        take(&mut batch)?;
    }
    losses.mean("validate on")
}

/// Refuses noise of another shape.
fn check_noise(spec: &ConvSpec, noise: &[f32]) -> Result<(), LearnError> {
    if noise.is_empty() || noise.len() == spec.input_len() && noise.iter().all(|s| s.is_finite() && *s >= 0.0)
    {
        return Ok(());
    }
    Err(LearnError::Training {
        reason: format!(
            "noise has {} standard deviations where inputs have {} numbers, or one that is negative",
            noise.len(),
            spec.input_len()
        ),
    })
}

/// Refuses a sample of another shape.
fn check(spec: &ConvSpec, sample: &TensorSample) -> Result<(), LearnError> {
    let wrong = |what: String| {
        Err(LearnError::Training { reason: format!("a sample does not fit the network: {what}") })
    };
    if sample.input.len() != spec.input_len() {
        return wrong(format!(
            "its input has {} numbers where {:?} are taken",
            sample.input.len(),
            spec.shape
        ));
    }
    if let Some(i) = sample.input.iter().position(|v| !v.is_finite()) {
        return wrong(format!("number {i} of its input is not finite"));
    }
    let like = |lists: &[Vec<f32>]| {
        lists.len() == spec.heads.len()
            && lists.iter().zip(&spec.heads).all(|(list, head)| list.len() == head.form.len())
    };
    if !like(&sample.targets) || !(sample.weights.is_empty() || like(&sample.weights)) {
        let lengths: Vec<usize> = sample.targets.iter().map(Vec::len).collect();
        return wrong(format!("its targets have the lengths {lengths:?}"));
    }
    Ok(())
}

/// Parameters and Adam's moments on the device.
struct Live {
    parameters: Vec<Tensor<1>>,
    first: Vec<Tensor<1>>,
    second: Vec<Tensor<1>>,
    steps: u64,
}

impl Live {
    fn of(state: &State, device: &Device) -> Self {
        let tensors = |all: &[Vec<f32>]| {
            all.iter().map(|v| Tensor::from_data(TensorData::new(v.clone(), [v.len()]), device)).collect()
        };
        Self {
            parameters: state.network.tensors(device),
            first: tensors(&state.first),
            second: tensors(&state.second),
            steps: state.steps,
        }
    }

    fn store(self, state: &mut State) -> Result<(), LearnError> {
        for (parameter, tensor) in state.network.parameters.iter_mut().zip(self.parameters) {
            parameter.values = numbers(tensor)?;
        }
        state.first = self.first.into_iter().map(numbers).collect::<Result<_, _>>()?;
        state.second = self.second.into_iter().map(numbers).collect::<Result<_, _>>()?;
        state.steps = self.steps;
        Ok(())
    }

    /// One step of Adam; the mean loss before it, which is on the device still.
    fn step(
        &mut self,
        network: &ConvNetwork,
        batch: &[TensorSample],
        (rate, momentum): (f64, f64),
        device: &Device,
        split: bool,
    ) -> Tensor<1> {
        let tracked: Vec<Tensor<1>> =
            self.parameters.iter().map(|p| p.clone().autodiff().require_grad()).collect();
        let loss = loss(network, &tracked, batch, &device.clone().autodiff(), split);
        let mut gradients = loss.backward();
        self.steps += 1;
        let power = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let decay = [momentum as f32, DECAY];
        let [fade, fade_square] = decay.map(|d| 1.0 - d.powi(power));
        for (i, tracked) in tracked.iter().enumerate() {
            let Some(gradient) = tracked.grad_remove(&mut gradients) else { continue };
            let first = self.first[i].clone() * decay[0] + gradient.clone() * (1.0 - decay[0]);
            let second = self.second[i].clone() * decay[1] + gradient.clone() * gradient * (1.0 - decay[1]);
            let quotient = (first.clone() / fade) / ((second.clone() / fade_square).sqrt() + EPSILON);
            self.parameters[i] = self.parameters[i].clone() - quotient * (rate as f32);
            (self.first[i], self.second[i]) = (first, second);
        }
        loss.inner()
    }
}
