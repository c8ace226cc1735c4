//! The operators of a network, evaluated by burn or written into a graph.

use burn::tensor::Tensor;
use burn::tensor::activation::relu;
use burn::tensor::module::{conv_transpose2d, conv2d};
use burn::tensor::ops::{ConvOptions, ConvTransposeOptions};
use dermis_inference::onnx::{GraphBuilder, Value, Window};

use super::network::Parameter;
use super::split;

/// Operators on tensors of \[batch, channels, height, width\]; weights are given by their index.
pub(super) trait Ops {
    /// A tensor.
    type Value: Clone;

    /// 3 × 3 convolution with padding 1.
    fn conv(&mut self, x: &Self::Value, weight: usize, stride: usize) -> Self::Value;
    /// Transposed convolution that doubles height and width.
    fn grow(&mut self, x: &Self::Value, weight: usize) -> Self::Value;
    /// Transposed convolution.
    fn transposed(&mut self, x: &Self::Value, weight: usize, stride: usize, padding: usize) -> Self::Value;
    /// Every number `factor` times along rows and columns, of such \[channels, height, width\].
    fn upsample(&mut self, x: &Self::Value, shape: [usize; 3], factor: usize) -> Self::Value;
    /// The first rows and columns.
    fn crop(&mut self, x: &Self::Value, height: usize, width: usize) -> Self::Value;
    /// Positive part.
    fn relu(&mut self, x: &Self::Value) -> Self::Value;
    /// `x · weight + bias`, of \[batch, 1, 1, in\].
    fn dense(&mut self, x: &Self::Value, weight: usize) -> Self::Value;
    /// The same numbers in another shape.
    fn reshape(&mut self, x: &Self::Value, shape: [usize; 3]) -> Self::Value;
}

/// Evaluates. Weights and biases alternate, as [`Parameter`]s do.
pub(super) struct Burn<'a> {
    pub(super) shapes: &'a [Parameter],
    pub(super) tensors: &'a [Tensor<1>],
    /// Whether sums of gradients are split among the threads of a GPU ([`split`]).
    pub(super) split: bool,
}

impl Burn<'_> {
    fn weight<const D: usize>(&self, index: usize) -> (Tensor<D>, Tensor<1>) {
        let shape: [usize; D] = std::array::from_fn(|i| self.shapes[index].shape[i]);
        (self.tensors[index].clone().reshape(shape), self.tensors[index + 1].clone())
    }

    /// Transposed convolution.
    fn spread(&self, x: &Tensor<4>, index: usize, stride: usize, padding: usize) -> Tensor<4> {
        let (weight, bias) = self.weight::<4>(index);
        let options = ConvTransposeOptions::new([stride; 2], [padding; 2], [0, 0], [1, 1], 1);
        if !self.split {
            return conv_transpose2d(x.clone(), weight, Some(bias), options);
        }
        let y = if split::is_worth(x, self.tensors[index].dims()[0]) {
            split::transposed(x, weight, stride, padding)
        } else {
            conv_transpose2d(x.clone(), weight, None, options)
        };
        split::biased(y, bias)
    }
}

impl Ops for Burn<'_> {
    type Value = Tensor<4>;

    fn conv(&mut self, x: &Tensor<4>, weight: usize, stride: usize) -> Tensor<4> {
        let (kernel, bias) = self.weight::<4>(weight);
        let options = ConvOptions::new([stride; 2], [1, 1], [1, 1], 1);
        if !self.split {
            return conv2d(x.clone(), kernel, Some(bias), options);
        }
        let y = if stride == 1 && split::is_worth(x, self.tensors[weight].dims()[0]) {
            // With the kernel turned round, it is the transposed one.
            split::transposed(x, kernel.swap_dims(0, 1).flip([2, 3]), 1, 1)
        } else {
            conv2d(x.clone(), kernel, None, options)
        };
        split::biased(y, bias)
    }

    fn grow(&mut self, x: &Tensor<4>, weight: usize) -> Tensor<4> {
        self.spread(x, weight, 2, 0)
    }

    fn transposed(&mut self, x: &Tensor<4>, weight: usize, stride: usize, padding: usize) -> Tensor<4> {
        self.spread(x, weight, stride, padding)
    }

    fn upsample(&mut self, x: &Tensor<4>, [channels, height, width]: [usize; 3], factor: usize) -> Tensor<4> {
        let batch = x.dims()[0];
        let rows: Tensor<4> = x.clone().reshape([batch, channels * height, 1, width]);
        let rows: Tensor<4> =
            rows.repeat_dim(2, factor).reshape([batch, channels * height * factor, width, 1]);
        rows.repeat_dim(3, factor).reshape([batch, channels, height * factor, width * factor])
    }

    fn crop(&mut self, x: &Tensor<4>, height: usize, width: usize) -> Tensor<4> {
        let [batch, channels, ..] = x.dims();
        x.clone().slice([0..batch, 0..channels, 0..height, 0..width])
    }

    fn relu(&mut self, x: &Tensor<4>) -> Tensor<4> {
        relu(x.clone())
    }

    fn dense(&mut self, x: &Tensor<4>, weight: usize) -> Tensor<4> {
        let [batch, _, _, width] = x.dims();
        let (weight, bias) = self.weight::<2>(weight);
        let outputs = weight.dims()[1];
        let y = x.clone().reshape([batch, width]).matmul(weight) + bias.reshape([1, outputs]);
        y.reshape([batch, 1, 1, outputs])
    }

    fn reshape(&mut self, x: &Tensor<4>, [channels, height, width]: [usize; 3]) -> Tensor<4> {
        let batch = x.dims()[0];
        x.clone().reshape([batch, channels, height, width])
    }
}

/// Writes a graph of batch 1.
pub(super) struct Onnx<'a> {
    pub(super) shapes: &'a [Parameter],
    pub(super) graph: GraphBuilder,
    /// Constants, made when they are first used.
    made: std::collections::BTreeMap<usize, (Value, Value)>,
}

impl<'a> Onnx<'a> {
    pub(super) fn new(name: &str, shapes: &'a [Parameter]) -> Self {
        Self { shapes, graph: GraphBuilder::new(name), made: std::collections::BTreeMap::new() }
    }

    fn weight(&mut self, index: usize) -> (Value, Value) {
        let (graph, shapes) = (&mut self.graph, self.shapes);
        let constant = |graph: &mut GraphBuilder, i: usize| {
            graph.constant(&format!("parameter.{i}"), &shapes[i].shape, &shapes[i].values)
        };
        self.made.entry(index).or_insert_with(|| (constant(graph, index), constant(graph, index + 1))).clone()
    }
}

impl Ops for Onnx<'_> {
    type Value = Value;

    fn conv(&mut self, x: &Value, weight: usize, stride: usize) -> Value {
        let (weight, bias) = self.weight(weight);
        let stride = i64::try_from(stride).unwrap_or(1);
        self.graph.conv(x, &weight, Some(&bias), &Window { strides: vec![stride; 2], pads: vec![1; 4] })
    }

    fn grow(&mut self, x: &Value, weight: usize) -> Value {
        let (weight, bias) = self.weight(weight);
        let window = Window { strides: vec![2; 2], pads: vec![0; 4] };
        self.graph.conv_transpose(x, &weight, Some(&bias), &window, &[0, 0])
    }

    fn transposed(&mut self, x: &Value, weight: usize, stride: usize, padding: usize) -> Value {
        let (weight, bias) = self.weight(weight);
        let [stride, padding] = [stride, padding].map(|v| i64::try_from(v).unwrap_or(i64::MAX));
        let window = Window { strides: vec![stride; 2], pads: vec![padding; 4] };
        self.graph.conv_transpose(x, &weight, Some(&bias), &window, &[0, 0])
    }

    /// By joining copies: runtimes disagree on the options of `Resize`.
    fn upsample(&mut self, x: &Value, [channels, height, width]: [usize; 3], factor: usize) -> Value {
        let rows = self.graph.reshape(x, &[1, channels * height, 1, width]);
        let rows = self.graph.concat(&vec![&rows; factor], 2);
        let columns = self.graph.reshape(&rows, &[1, channels * height * factor, width, 1]);
        let columns = self.graph.concat(&vec![&columns; factor], 3);
        self.graph.reshape(&columns, &[1, channels, height * factor, width * factor])
    }

    fn crop(&mut self, x: &Value, height: usize, width: usize) -> Value {
        let end = |size: usize| i64::try_from(size).unwrap_or(i64::MAX);
        let rows = self.graph.slice(x, 2, 0, end(height));
        self.graph.slice(&rows, 3, 0, end(width))
    }

    fn relu(&mut self, x: &Value) -> Value {
        self.graph.relu(x)
    }

    fn dense(&mut self, x: &Value, weight: usize) -> Value {
        let [inputs, outputs] = [self.shapes[weight].shape[0], self.shapes[weight].shape[1]];
        let (weight, bias) = self.weight(weight);
        let flat = self.graph.reshape(x, &[1, inputs]);
        let y = self.graph.gemm(&flat, &weight, Some(&bias));
        self.graph.reshape(&y, &[1, 1, 1, outputs])
    }

    fn reshape(&mut self, x: &Value, [channels, height, width]: [usize; 3]) -> Value {
        self.graph.reshape(x, &[1, channels, height, width])
    }
}
