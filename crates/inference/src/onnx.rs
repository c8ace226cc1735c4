//! Writing ONNX graphs, and looking into those of others.
//!
//! What is written has opset 17 and IR version 8, which every supported runtime reads; operators of the core domain only.

mod chain;
mod check;
mod constants;
mod graph;
mod operators;

use onnx_rs::ast;

pub use chain::{ChainError, chain};
pub(crate) use check::check;
pub use check::{GraphTensor, Signature, listed, with_batch_of_one};
pub(crate) use constants::{check as check_constants, unbounded};
pub(crate) use graph::{Graph, GraphNode, Tensor};

const OPSET: i64 = 17;
const IR_VERSION: i64 = 8;

/// Element type of a tensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Element {
    /// 32-bit floats.
    F32,
    /// 64-bit floats.
    F64,
    /// 64-bit integers.
    I64,
}

impl Element {
    fn code(self) -> ast::DataType {
        match self {
            Self::F32 => ast::DataType::Float,
            Self::F64 => ast::DataType::Double,
            Self::I64 => ast::DataType::Int64,
        }
    }
}

/// A tensor in a graph under construction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Value(String);

impl Value {
    /// Stands for an optional input that is left out.
    #[must_use]
    pub fn absent() -> Self {
        Self(String::new())
    }

    /// Its name in the graph.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0
    }
}

/// An attribute of an operator.
#[derive(Debug, Clone, PartialEq)]
pub enum Attribute {
    /// A whole number.
    Int(i64),
    /// Whole numbers.
    Ints(Vec<i64>),
    /// A number.
    Float(f32),
    /// Text.
    Text(String),
}

/// Shape of a convolution window: two entries for images, one for sequences.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Window {
    /// Step per spatial axis.
    pub strides: Vec<i64>,
    /// Padding: the begins of all spatial axes, then their ends.
    pub pads: Vec<i64>,
}

/// A graph that cannot be written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OnnxError {
    /// A constant has another number of values than its shape.
    #[error("graph `{graph}`: constant `{name}` has {got} values where its shape {shape:?} takes {expected}")]
    ConstantShape {
        /// Name of the graph.
        graph: String,
        /// Name of the constant.
        name: String,
        /// Values given.
        got: usize,
        /// Its shape.
        shape: Vec<usize>,
        /// Values that the shape takes.
        expected: usize,
    },
    /// Two tensors would have the same name.
    #[error("graph `{graph}`: the name `{name}` is used twice")]
    NameTaken {
        /// Name of the graph.
        graph: String,
        /// The name.
        name: String,
    },
    /// Nothing goes in or nothing comes out.
    #[error("graph `{graph}` has no {what}")]
    Missing {
        /// Name of the graph.
        graph: String,
        /// `input` or `output`.
        what: &'static str,
    },
}

struct Node {
    operator: String,
    inputs: Vec<String>,
    outputs: Vec<String>,
    attributes: Vec<(String, Attribute)>,
}

struct Constant {
    name: String,
    shape: Vec<i64>,
    element: Element,
    bytes: Vec<u8>,
}

struct Port {
    name: String,
    shape: Vec<i64>,
}

/// Builds a graph operator by operator.
///
/// Methods never fail: what is wrong is reported by [`finish`](Self::finish).
///
/// ```
/// use dermis_inference::onnx::GraphBuilder;
///
/// let mut g = GraphBuilder::new("line");
/// let x = g.input("input", &[1, 2]);
/// let w = g.constant("weight", &[2, 1], &[2.0, 3.0]);
/// let b = g.constant("bias", &[1], &[1.0]);
/// let y = g.gemm(&x, &w, Some(&b));
/// g.output("output", &y, &[1, 1]);
/// let bytes = g.finish()?;
/// # Ok::<(), dermis_inference::onnx::OnnxError>(())
/// ```
pub struct GraphBuilder {
    name: String,
    nodes: Vec<Node>,
    constants: Vec<Constant>,
    inputs: Vec<Port>,
    outputs: Vec<Port>,
    names: std::collections::BTreeSet<String>,
    error: Option<OnnxError>,
}

impl GraphBuilder {
    /// An empty graph.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            nodes: Vec::new(),
            constants: Vec::new(),
            inputs: Vec::new(),
            outputs: Vec::new(),
            names: std::collections::BTreeSet::new(),
            error: None,
        }
    }

    /// An input of 32-bit floats.
    pub fn input(&mut self, name: &str, shape: &[usize]) -> Value {
        self.claim(name);
        self.inputs.push(Port { name: name.to_owned(), shape: dims(shape) });
        Value(name.to_owned())
    }

    /// Makes `value` an output of 32-bit floats under this name.
    pub fn output(&mut self, name: &str, value: &Value, shape: &[usize]) {
        self.claim(name);
        self.nodes.push(Node {
            operator: "Identity".into(),
            inputs: vec![value.0.clone()],
            outputs: vec![name.to_owned()],
            attributes: Vec::new(),
        });
        self.outputs.push(Port { name: name.to_owned(), shape: dims(shape) });
    }

    /// A constant of 32-bit floats, row-major.
    pub fn constant(&mut self, name: &str, shape: &[usize], values: &[f32]) -> Value {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add_constant(name, shape, Element::F32, values.len(), bytes)
    }

    /// A constant of 64-bit floats, row-major.
    pub fn constant_f64(&mut self, name: &str, shape: &[usize], values: &[f64]) -> Value {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add_constant(name, shape, Element::F64, values.len(), bytes)
    }

    /// A constant of 64-bit integers, row-major.
    pub fn constant_i64(&mut self, name: &str, shape: &[usize], values: &[i64]) -> Value {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add_constant(name, shape, Element::I64, values.len(), bytes)
    }

    fn add_constant(
        &mut self,
        name: &str,
        shape: &[usize],
        element: Element,
        got: usize,
        bytes: Vec<u8>,
    ) -> Value {
        self.claim(name);
        let expected = shape.iter().product();
        if got != expected {
            self.error.get_or_insert(OnnxError::ConstantShape {
                graph: self.name.clone(),
                name: name.to_owned(),
                got,
                shape: shape.to_vec(),
                expected,
            });
        }
        self.constants.push(Constant { name: name.to_owned(), shape: dims(shape), element, bytes });
        Value(name.to_owned())
    }

    /// A vector of integers that belongs to one operator.
    fn parameter(&mut self, values: &[i64]) -> Value {
        let name = self.fresh("parameter");
        self.constant_i64(&name, &[values.len()], values)
    }

    fn claim(&mut self, name: &str) {
        if !self.names.insert(name.to_owned()) {
            self.error
                .get_or_insert(OnnxError::NameTaken { graph: self.name.clone(), name: name.to_owned() });
        }
    }

    /// A name that no one has; it is not claimed yet.
    fn fresh(&self, stem: &str) -> String {
        let mut number = self.nodes.len();
        loop {
            let name = format!("{stem}_{number}");
            if !self.names.contains(&name) {
                return name;
            }
            number += 1;
        }
    }

    /// Any operator of the core domain with `outputs` outputs.
    pub fn operator(
        &mut self,
        operator: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute)],
        outputs: usize,
    ) -> Vec<Value> {
        let mut names = Vec::new();
        for _ in 0..outputs {
            let name = self.fresh(&operator.to_lowercase());
            self.claim(&name);
            names.push(name);
        }
        self.nodes.push(Node {
            operator: operator.to_owned(),
            inputs: inputs.iter().map(|v| v.0.clone()).collect(),
            outputs: names.clone(),
            attributes: attributes.iter().map(|(n, a)| ((*n).to_owned(), a.clone())).collect(),
        });
        names.into_iter().map(Value).collect()
    }

    fn one(&mut self, operator: &str, inputs: &[&Value], attributes: &[(&str, Attribute)]) -> Value {
        self.operator(operator, inputs, attributes, 1).swap_remove(0)
    }

    /// The bytes of an `.onnx` file.
    ///
    /// # Errors
    ///
    /// [`OnnxError`] says what was wrong first.
    pub fn finish(self) -> Result<Vec<u8>, OnnxError> {
        if let Some(error) = self.error {
            return Err(error);
        }
        for (what, ports) in [("input", &self.inputs), ("output", &self.outputs)] {
            if ports.is_empty() {
                return Err(OnnxError::Missing { graph: self.name, what });
            }
        }
        let graph = ast::Graph {
            name: &self.name,
            node: self.nodes.iter().map(node).collect(),
            initializer: self
                .constants
                .iter()
                .map(|c| ast::TensorProto::from_raw(&c.name, c.shape.clone(), c.element.code(), &c.bytes))
                .collect(),
            input: self.inputs.iter().map(value_info).collect(),
            output: self.outputs.iter().map(value_info).collect(),
            ..Default::default()
        };
        let model = ast::Model {
            ir_version: IR_VERSION,
            producer_name: "dermis",
            producer_version: env!("CARGO_PKG_VERSION"),
            opset_import: vec![ast::OperatorSetId { domain: "", version: OPSET }],
            graph: Some(graph),
            ..Default::default()
        };
        Ok(onnx_rs::encode(&model))
    }
}

fn dims(shape: &[usize]) -> Vec<i64> {
    // A dimension beyond i64 cannot have values, so its constant is refused; an input of it, by every runtime.
    shape.iter().map(|d| i64::try_from(*d).unwrap_or(i64::MAX)).collect()
}

fn window_attributes(window: &Window) -> Vec<(&'static str, Attribute)> {
    vec![("strides", Attribute::Ints(window.strides.clone())), ("pads", Attribute::Ints(window.pads.clone()))]
}

fn node(node: &Node) -> ast::Node<'_> {
    ast::Node {
        // Every operator has an output, and its name is unique in the graph.
        name: node.outputs.first().map_or("", String::as_str),
        op_type: ast::OpType::from(node.operator.as_str()),
        input: node.inputs.iter().map(String::as_str).collect(),
        output: node.outputs.iter().map(String::as_str).collect(),
        attribute: node
            .attributes
            .iter()
            .map(|(name, value)| {
                let mut attribute = ast::Attribute { name, ..Default::default() };
                match value {
                    Attribute::Int(i) => (attribute.r#type, attribute.i) = (ast::AttributeType::Int, *i),
                    Attribute::Ints(v) => {
                        (attribute.r#type, attribute.ints) = (ast::AttributeType::Ints, v.clone());
                    }
                    Attribute::Float(f) => (attribute.r#type, attribute.f) = (ast::AttributeType::Float, *f),
                    Attribute::Text(s) => {
                        (attribute.r#type, attribute.s) = (ast::AttributeType::String, s.as_bytes());
                    }
                }
                attribute
            })
            .collect(),
        ..Default::default()
    }
}

fn value_info(port: &Port) -> ast::ValueInfo<'_> {
    let dim = port
        .shape
        .iter()
        .map(|d| ast::TensorShapeDimension { value: ast::Dimension::Value(*d), ..Default::default() })
        .collect();
    let tensor =
        ast::TensorTypeProto { elem_type: ast::DataType::Float, shape: Some(ast::TensorShape { dim }) };
    ast::ValueInfo {
        name: &port.name,
        r#type: Some(ast::TypeProto { value: Some(ast::TypeValue::Tensor(tensor)), ..Default::default() }),
        ..Default::default()
    }
}

#[cfg(test)]
mod tests;
