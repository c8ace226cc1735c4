//! The error that is minimised, and its mean over a pass.
//!
//! Reading a number from a GPU waits for everything that it was given to do. So losses stay there for a while ([`Losses`]). What goes
//! there, a batch of targets, is the most that a step moves: 6.6 MB for 64 pictures of 160 × 160 pixels. Weights that are all 1 would be as
//! much again and change nothing; they stay away.

use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};

use super::network::{ConvNetwork, batch_of, numbers};
use super::{TensorSample, split};
use crate::LearnError;

/// Losses that are read at once. More would let a fast program pile up batches on the way to a slow GPU.
const AT_ONCE: usize = 32;

/// Mean loss of samples, batch by batch.
#[derive(Default)]
pub(super) struct Losses {
    /// Mean of a batch \[1\], and its samples.
    pending: Vec<(Tensor<1>, usize)>,
    sum: f64,
    count: usize,
}

impl Losses {
    /// Takes the mean loss of so many samples.
    pub(super) fn push(&mut self, loss: Tensor<1>, samples: usize) -> Result<(), LearnError> {
        self.pending.push((loss, samples));
        if self.pending.len() < AT_ONCE { Ok(()) } else { self.read() }
    }

    fn read(&mut self) -> Result<(), LearnError> {
        if self.pending.is_empty() {
            return Ok(());
        }
        let (losses, samples): (Vec<Tensor<1>>, Vec<usize>) = self.pending.drain(..).unzip();
        for (loss, samples) in numbers(Tensor::cat(losses, 0))?.into_iter().zip(samples) {
            self.sum += f64::from(loss) * samples as f64;
            self.count += samples;
        }
        Ok(())
    }

    /// Mean over all samples.
    ///
    /// # Errors
    ///
    /// Where there are none to do `what` with, and where burn gives no numbers.
    pub(super) fn mean(mut self, what: &str) -> Result<f64, LearnError> {
        self.read()?;
        if self.count == 0 {
            return Err(LearnError::Training {
                reason: format!("there is no sample to {what}; record more"),
            });
        }
        Ok(self.sum / self.count as f64)
    }
}

/// What a batch says of one head, sample after sample.
#[derive(Debug, PartialEq)]
struct Wanted {
    /// 0 where it is not known.
    targets: Vec<f32>,
    /// 0 where the target is not known; `None` where all count 1.
    weights: Option<Vec<f32>>,
    /// Targets that count.
    known: usize,
}

impl Wanted {
    fn of(batch: &[TensorSample], head: usize) -> Self {
        let count = batch.iter().map(|s| s.targets[head].len()).sum();
        let mut targets = Vec::with_capacity(count);
        let plain = |s: &TensorSample| {
            s.weights.get(head).is_none_or(|w| w.iter().all(|w| *w == 1.0))
                && s.targets[head].iter().all(|t| t.is_finite())
        };
        if batch.iter().all(plain) {
            batch.iter().for_each(|s| targets.extend_from_slice(&s.targets[head]));
            return Self { known: targets.len(), targets, weights: None };
        }
        let mut weights = Vec::with_capacity(count);
        for sample in batch {
            for (i, target) in sample.targets[head].iter().enumerate() {
                let weight = sample.weights.get(head).map_or(1.0, |w| w[i]);
                let known = target.is_finite() && weight.is_finite();
                targets.push(if known { *target } else { 0.0 });
                weights.push(if known { weight } else { 0.0 });
            }
        }
        Self { known: weights.iter().filter(|w| **w != 0.0).count(), targets, weights: Some(weights) }
    }
}

/// Sum over the heads of the mean error of what is known, with sums `split` for a GPU or not.
pub(super) fn loss(
    network: &ConvNetwork,
    tensors: &[Tensor<1>],
    batch: &[TensorSample],
    device: &Device,
    split: bool,
) -> Tensor<1> {
    let spec = &network.spec;
    let inputs = batch.iter().flat_map(|s| s.input.iter().copied()).collect();
    let x = batch_of(inputs, batch.len(), spec.shape, device);
    let outputs = network.forward(tensors, &x, split);
    let mut total: Option<Tensor<1>> = None;
    for (h, (head, output)) in spec.heads.iter().zip(outputs).enumerate() {
        let Wanted { targets, weights, known } = Wanted::of(batch, h);
        let count = targets.len();
        let flat = |values: Vec<f32>| Tensor::<1>::from_data(TensorData::new(values, [count]), device);
        let targets = flat(targets);
        let output = output.reshape([count]);
        let errors = if head.logit {
            // ln(1 + e^z) − t z, written so that no exponential overflows.
            let soft = relu(output.clone()) + (-output.clone().abs()).exp().log1p();
            soft - targets * output
        } else {
            let apart = output - targets;
            apart.clone() * apart
        };
        let errors = match weights {
            Some(weights) => errors * flat(weights),
            None => errors,
        };
        let sum = if split { split::sum(errors) } else { errors.sum() };
        let mean = sum / known.max(1) as f32;
        total = Some(match total {
            Some(total) => total + mean,
            None => mean,
        });
    }
    total.unwrap_or_else(|| Tensor::zeros([1], device))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(targets: &[f32], weights: &[f32]) -> TensorSample {
        let lists = |list: &[f32]| if list.is_empty() { Vec::new() } else { vec![list.to_vec()] };
        TensorSample { input: Vec::new(), targets: lists(targets), weights: lists(weights) }
    }

    #[test]
    fn losses_are_read_in_their_order_and_none_is_lost() {
        let device = Device::flex();
        for batches in [1, AT_ONCE - 1, AT_ONCE, 2 * AT_ONCE + 3] {
            let mut losses = Losses::default();
            let (mut sum, mut count) = (0.0, 0);
            for i in 0..batches {
                let (loss, samples) = (0.1 + i as f32, 1 + i % 5);
                losses.push(Tensor::from_data(TensorData::new(vec![loss], [1]), &device), samples).unwrap();
                sum += f64::from(loss) * samples as f64;
                count += samples;
            }
            assert_eq!(losses.mean("count").unwrap(), sum / count as f64);
        }
        assert!(
            Losses::default().mean("train on").unwrap_err().to_string().contains("no sample to train on")
        );
    }

    #[test]
    fn weights_stay_away_only_where_all_targets_count_one() {
        let plain = [sample(&[1.0, 0.0], &[]), sample(&[3.0, 4.0], &[1.0, 1.0])];
        let wanted = Wanted { targets: vec![1.0, 0.0, 3.0, 4.0], weights: None, known: 4 };
        assert_eq!(Wanted::of(&plain, 0), wanted);
        let mixed = [sample(&[1.0, f32::NAN], &[]), sample(&[3.0, 4.0], &[0.5, f32::NAN])];
        let wanted =
            Wanted { targets: vec![1.0, 0.0, 3.0, 0.0], weights: Some(vec![1.0, 0.0, 0.5, 0.0]), known: 2 };
        assert_eq!(Wanted::of(&mixed, 0), wanted);
    }
}
