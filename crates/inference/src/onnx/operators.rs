//! Operators of a graph, each by its usual name.

use super::{Attribute, Element, GraphBuilder, Value, Window, dims, window_attributes};

impl GraphBuilder {
    /// `x · weight + bias`; `x` is \[n, in\], `weight` \[in, out\], `bias` \[out\].
    pub fn gemm(&mut self, x: &Value, weight: &Value, bias: Option<&Value>) -> Value {
        let inputs: Vec<&Value> = [x, weight].into_iter().chain(bias).collect();
        self.one("Gemm", &inputs, &[])
    }

    /// Matrix product.
    pub fn matmul(&mut self, a: &Value, b: &Value) -> Value {
        self.one("MatMul", &[a, b], &[])
    }

    /// Convolution; `x` is \[n, in, …\], `weight` \[out, in, …\], `bias` \[out\].
    pub fn conv(&mut self, x: &Value, weight: &Value, bias: Option<&Value>, window: &Window) -> Value {
        let inputs: Vec<&Value> = [x, weight].into_iter().chain(bias).collect();
        self.one("Conv", &inputs, &window_attributes(window))
    }

    /// Transposed convolution; `weight` is \[in, out, …\]; `output_padding` per spatial axis.
    pub fn conv_transpose(
        &mut self,
        x: &Value,
        weight: &Value,
        bias: Option<&Value>,
        window: &Window,
        output_padding: &[i64],
    ) -> Value {
        let inputs: Vec<&Value> = [x, weight].into_iter().chain(bias).collect();
        let mut attributes = window_attributes(window);
        attributes.push(("output_padding", Attribute::Ints(output_padding.to_vec())));
        self.one("ConvTranspose", &inputs, &attributes)
    }

    /// Batch normalisation as it is at inference; each of the four is \[channels\].
    pub fn batch_norm(
        &mut self,
        x: &Value,
        scale: &Value,
        bias: &Value,
        mean: &Value,
        variance: &Value,
        epsilon: f32,
    ) -> Value {
        let attributes = [("epsilon", Attribute::Float(epsilon))];
        self.one("BatchNormalization", &[x, scale, bias, mean, variance], &attributes)
    }

    /// Joins along an axis.
    pub fn concat(&mut self, values: &[&Value], axis: i64) -> Value {
        self.one("Concat", values, &[("axis", Attribute::Int(axis))])
    }

    /// `x[start..end]` along an axis.
    pub fn slice(&mut self, x: &Value, axis: i64, start: i64, end: i64) -> Value {
        let [start, end, axis] = [start, end, axis].map(|v| self.unnamed(v));
        self.one("Slice", &[x, &start, &end, &axis], &[])
    }

    fn unnamed(&mut self, value: i64) -> Value {
        self.parameter(&[value])
    }

    /// Parts of these sizes along an axis.
    pub fn split(&mut self, x: &Value, axis: i64, sizes: &[i64]) -> Vec<Value> {
        let parts = self.parameter(sizes);
        self.operator("Split", &[x, &parts], &[("axis", Attribute::Int(axis))], sizes.len())
    }

    /// The `k` largest (or smallest) along an axis, sorted, and their indices.
    pub fn top_k(&mut self, x: &Value, k: i64, axis: i64, largest: bool) -> (Value, Value) {
        let k = self.parameter(&[k]);
        let attributes = [("axis", Attribute::Int(axis)), ("largest", Attribute::Int(i64::from(largest)))];
        let mut both = self.operator("TopK", &[x, &k], &attributes, 2);
        let indices = both.swap_remove(1);
        (both.swap_remove(0), indices)
    }

    /// Entries of `data` along an axis, at integer indices.
    pub fn gather(&mut self, data: &Value, indices: &Value, axis: i64) -> Value {
        self.one("Gather", &[data, indices], &[("axis", Attribute::Int(axis))])
    }

    /// The same values in another element type.
    pub fn cast(&mut self, x: &Value, to: Element) -> Value {
        self.one("Cast", &[x], &[("to", Attribute::Int(to.code() as i64))])
    }

    /// The same values in another shape.
    pub fn reshape(&mut self, x: &Value, shape: &[usize]) -> Value {
        let shape = self.parameter(&dims(shape));
        self.one("Reshape", &[x, &shape], &[])
    }

    /// Sum along an axis, which stays with size 1.
    pub fn reduce_sum(&mut self, x: &Value, axis: i64) -> Value {
        let axes = self.parameter(&[axis]);
        self.one("ReduceSum", &[x, &axes], &[])
    }

    /// Mean along an axis, which stays with size 1.
    pub fn reduce_mean(&mut self, x: &Value, axis: i64) -> Value {
        self.one("ReduceMean", &[x], &[("axes", Attribute::Ints(vec![axis]))])
    }

    /// Sum, with broadcasting.
    pub fn add(&mut self, a: &Value, b: &Value) -> Value {
        self.one("Add", &[a, b], &[])
    }

    /// Difference, with broadcasting.
    pub fn sub(&mut self, a: &Value, b: &Value) -> Value {
        self.one("Sub", &[a, b], &[])
    }

    /// Product by elements, with broadcasting.
    pub fn mul(&mut self, a: &Value, b: &Value) -> Value {
        self.one("Mul", &[a, b], &[])
    }

    /// Quotient by elements, with broadcasting.
    pub fn div(&mut self, a: &Value, b: &Value) -> Value {
        self.one("Div", &[a, b], &[])
    }

    /// Hyperbolic tangent.
    pub fn tanh(&mut self, x: &Value) -> Value {
        self.one("Tanh", &[x], &[])
    }

    /// Positive part.
    pub fn relu(&mut self, x: &Value) -> Value {
        self.one("Relu", &[x], &[])
    }

    /// Logistic function.
    pub fn sigmoid(&mut self, x: &Value) -> Value {
        self.one("Sigmoid", &[x], &[])
    }

    /// Exponential.
    pub fn exp(&mut self, x: &Value) -> Value {
        self.one("Exp", &[x], &[])
    }

    /// Square root.
    pub fn sqrt(&mut self, x: &Value) -> Value {
        self.one("Sqrt", &[x], &[])
    }

    /// Sign turned.
    pub fn neg(&mut self, x: &Value) -> Value {
        self.one("Neg", &[x], &[])
    }
}
