//! Layers whose gradients are sums that many threads share.
//!
//! Problem: a gradient of a weight or a bias is a sum over all positions of all samples, 1.6 million of them for 64 pictures of
//! 160 × 160 pixels. burn gives each weight one thread of a GPU where its kernels are not tuned at run time; a layer of 2 × 3 × 3
//! weights occupies 18 threads, and the step waits for one thread's million additions. Method: a transposed convolution as a product of
//! matrices and the sum of its overlapping columns (Dumoulin & Visin 2016, section 4), over batches of some √n of the n positions. The
//! gradient of a product that is shared by a batch is a product for each of them and their sum, so no thread adds more than some √n
//! numbers twice. Biases and the loss are split alike.
//!
//! Assumptions: the processor runs thousands of threads; on a CPU the layers of burn are faster, and their sums have the order that
//! checkpoints and tests know. Cost: columns of outputs × kernel² numbers a position, 118 MB for 8 → 2 planes of 64 pictures; serial
//! additions of a step of the thesis' network fall from some millions to some thousands.

use burn::tensor::Tensor;

/// Largest divisor of a number that is not above its root; 1 for 0.
fn below_root(number: usize) -> usize {
    (1..=number.isqrt()).rev().find(|d| number.is_multiple_of(*d)).unwrap_or(1)
}

/// Whether a layer has more positions than weights: only then does one thread a weight leave a GPU waiting.
pub(super) fn is_worth(x: &Tensor<4>, weights: usize) -> bool {
    let [batch, _, height, width] = x.dims();
    batch * height * width > weights
}

/// Transposed convolution of \[batch, from, height, width\] by \[from, to, kernel, kernel\], without a bias.
pub(super) fn transposed(x: &Tensor<4>, weight: Tensor<4>, stride: usize, padding: usize) -> Tensor<4> {
    let [batch, from, height, width] = x.dims();
    let [_, to, kernel, _] = weight.dims();
    let positions = batch * height * width;
    let run = below_root(positions);
    let pixels: Tensor<3> = x.clone().permute([0, 2, 3, 1]).reshape([positions / run, run, from]);
    let columns: Tensor<3> = pixels.matmul(weight.reshape([1, from, to * kernel * kernel]));
    let columns: Tensor<6> = columns.reshape([batch, height, width, to, kernel, kernel]);
    let columns = columns.permute([0, 3, 1, 4, 2, 5]);
    let size = |n: usize| (n - 1) * stride + kernel - 2 * padding;
    let (rows, across) = (size(height), size(width));
    let y = overlap(columns.reshape([batch * to, height, kernel, width * kernel]), stride, padding, rows);
    let y = overlap(y.reshape([batch * to * rows, width, kernel, 1]), stride, padding, across);
    y.reshape([batch, to, rows, across])
}

/// Sums runs of numbers that overlap: of \[outer, count, kernel, inner\], run i begins at i · `stride`. Numbers `first` to `first + length`
/// of the sum, as \[outer, length, inner\].
fn overlap(x: Tensor<4>, stride: usize, first: usize, length: usize) -> Tensor<3> {
    let [outer, count, kernel, inner] = x.dims();
    let device = x.device();
    // Blocks of a whole stride lie side by side.
    let blocks = kernel.div_ceil(stride);
    let rest = blocks * stride - kernel;
    let x = if rest == 0 {
        x
    } else {
        Tensor::cat(vec![x, Tensor::zeros([outer, count, rest, inner], &device)], 2)
    };
    let placed = |block: usize| {
        let part = x.clone().slice([0..outer, 0..count, block * stride..(block + 1) * stride, 0..inner]);
        let part: Tensor<3> = part.reshape([outer, count * stride, inner]);
        let blank = |blocks: usize| Tensor::<3>::zeros([outer, blocks * stride, inner], &device);
        let mut parts = vec![part];
        if block > 0 {
            parts.insert(0, blank(block));
        }
        if block + 1 < blocks {
            parts.push(blank(blocks - 1 - block));
        }
        if parts.len() == 1 { parts.swap_remove(0) } else { Tensor::cat(parts, 1) }
    };
    let sum = (1..blocks).fold(placed(0), |sum, block| sum + placed(block));
    sum.slice([0..outer, first..first + length, 0..inner])
}

/// Adds a bias \[channels\] to \[batch, channels, height, width\].
pub(super) fn biased(x: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    let [batch, channels, height, width] = x.dims();
    let run = below_root(height * width);
    let runs = height * width / run;
    let bias = bias.reshape([1, channels, 1, 1]).expand([1, channels, runs, 1]);
    (x.reshape([batch, channels, runs, run]) + bias).reshape([batch, channels, height, width])
}

/// Sum of all numbers.
pub(super) fn sum(x: Tensor<1>) -> Tensor<1> {
    let [count] = x.dims();
    let run = below_root(count);
    x.reshape([count / run, run]).sum_dim(1).sum()
}

#[cfg(test)]
mod tests {
    use burn::tensor::module::{conv_transpose2d, conv2d};
    use burn::tensor::ops::{ConvOptions, ConvTransposeOptions};
    use burn::tensor::{Device, TensorData};

    use super::*;
    use crate::train::conv::network::Parameter;
    use crate::train::conv::network::numbers;
    use crate::train::conv::ops::{Burn, Ops};

    /// Numbers between −1 and 1 that repeat after none of the sizes here.
    fn made_up<const D: usize>(shape: [usize; D], seed: usize, device: &Device) -> Tensor<D> {
        let count = shape.iter().product();
        let values = (0..count).map(|i| ((i * 37 + seed * 11) % 101) as f32 / 50.0 - 1.0).collect();
        Tensor::from_data(TensorData::new(values, shape), device)
    }

    /// The answer, and the gradients by input, weight and bias of the sum of all answers, each times another number.
    fn learned(
        layer: impl Fn(Tensor<4>, Tensor<4>, Tensor<1>) -> Tensor<4>,
        x: &Tensor<4>,
        weight: &Tensor<4>,
        bias: &Tensor<1>,
    ) -> [Vec<f32>; 4] {
        let x = x.clone().require_grad();
        let (weight, bias) = (weight.clone().require_grad(), bias.clone().require_grad());
        let y = layer(x.clone(), weight.clone(), bias.clone());
        let factors = made_up(y.dims(), 5, &y.device());
        let gradients = (y.clone() * factors).sum().backward();
        let of = |t: Option<Tensor<4>>| numbers(t.unwrap()).unwrap();
        [
            numbers(y.inner()).unwrap(),
            of(x.grad(&gradients)),
            of(weight.grad(&gradients)),
            numbers(bias.grad(&gradients).unwrap()).unwrap(),
        ]
    }

    fn assert_alike(found: &[Vec<f32>; 4], wanted: &[Vec<f32>; 4], what: &str) {
        for (part, (found, wanted)) in
            ["answer", "input", "weight", "bias"].iter().zip(found.iter().zip(wanted))
        {
            assert_eq!(found.len(), wanted.len(), "{what}, {part}");
            assert!(wanted.iter().any(|v| v.abs() > 0.1), "{what}, {part}: nothing comes out");
            for (a, b) in found.iter().zip(wanted) {
                assert!((a - b).abs() < 1e-3 * (1.0 + b.abs()), "{what}, {part}: {a} and {b}");
            }
        }
    }

    #[test]
    fn split_transposed_convolutions_learn_as_whole_ones() {
        let device = Device::flex().autodiff();
        // Kernel, stride, padding: those of the thesis, and ones that leave gaps and cut edges.
        for (k, s, p) in [(5, 1, 0), (6, 3, 4), (2, 2, 0), (3, 1, 1), (2, 3, 0), (4, 3, 1)] {
            let (x, weight) = (made_up([3, 4, 5, 7], 1, &device), made_up([4, 2, k, k], 2, &device));
            let bias = made_up([2], 3, &device);
            let options = ConvTransposeOptions::new([s; 2], [p; 2], [0, 0], [1, 1], 1);
            let whole =
                learned(|x, w, b| conv_transpose2d(x, w, Some(b), options.clone()), &x, &weight, &bias);
            let split = learned(|x, w, b| biased(transposed(&x, w, s, p), b), &x, &weight, &bias);
            assert_alike(&split, &whole, &format!("kernel {k}, stride {s}, padding {p}"));
        }
    }

    #[test]
    fn split_convolutions_learn_as_whole_ones() {
        let device = Device::flex().autodiff();
        let shapes = [Parameter { shape: vec![2, 4, 3, 3], values: Vec::new() }];
        for stride in [1, 2] {
            // More positions than weights: it is split.
            let (x, weight) = (made_up([3, 4, 9, 7], 1, &device), made_up([2, 4, 3, 3], 2, &device));
            assert!(is_worth(&x, 72));
            let bias = made_up([2], 3, &device);
            let by = |split: bool| {
                let layer = |x: Tensor<4>, w: Tensor<4>, b: Tensor<1>| {
                    let tensors = [w.reshape([72]), b];
                    Burn { shapes: &shapes, tensors: &tensors, split }.conv(&x, 0, stride)
                };
                learned(layer, &x, &weight, &bias)
            };
            let options = ConvOptions::new([stride; 2], [1, 1], [1, 1], 1);
            let whole = learned(|x, w, b| conv2d(x, w, Some(b), options.clone()), &x, &weight, &bias);
            assert_alike(&by(true), &whole, &format!("stride {stride}"));
            assert_eq!(by(false), whole, "stride {stride}");
        }
    }

    #[test]
    fn sums_are_split_near_the_root() {
        assert_eq!([0, 1, 7, 12, 1_638_400].map(below_root), [1, 1, 1, 3, 1280]);
        for count in [1, 7, 60] {
            let x = made_up([count], 1, &Device::flex());
            let whole = numbers(x.clone()).unwrap().iter().sum::<f32>();
            assert!((numbers(sum(x)).unwrap()[0] - whole).abs() < 1e-4, "{count}");
        }
    }
}
