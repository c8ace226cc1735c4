//! The operators and constants of a graph without graphs within it.

use super::check::{Fields, Value, text};

/// A graph of the core domain.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Graph {
    /// In an order in which they can be evaluated.
    pub nodes: Vec<GraphNode>,
    pub constants: Vec<Tensor>,
}

/// An operator.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct GraphNode {
    pub operator: String,
    pub inputs: Vec<String>,
    pub outputs: Vec<String>,
    attributes: Vec<Attribute>,
}

#[derive(Debug, Clone, Default, PartialEq)]
struct Attribute {
    name: String,
    float: f32,
    integer: i64,
    integers: Vec<i64>,
}

/// A constant.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Tensor {
    pub name: String,
    pub shape: Vec<usize>,
    /// Its numbers, row-major, where it holds 32-bit floats.
    pub floats: Option<Vec<f32>>,
    /// The same of 64-bit integers.
    pub integers: Option<Vec<i64>>,
}

impl GraphNode {
    pub(crate) fn float(&self, name: &str) -> Option<f32> {
        self.attributes.iter().find(|a| a.name == name).map(|a| a.float)
    }

    pub(crate) fn integer(&self, name: &str) -> Option<i64> {
        self.attributes.iter().find(|a| a.name == name).map(|a| a.integer)
    }

    pub(crate) fn integers(&self, name: &str) -> Option<&[i64]> {
        self.attributes.iter().find(|a| a.name == name).map(|a| a.integers.as_slice())
    }
}

impl Graph {
    /// Reads it from the bytes of an `.onnx` file; `None` where it is garbled, defines operators of its own or takes them from another
    /// domain, or holds graphs within.
    pub(crate) fn read(bytes: &[u8]) -> Option<Self> {
        let mut graph = Self::default();
        for field in Fields(bytes) {
            match field.ok()? {
                (7, Value::Bytes(inner)) => graph.fill(inner)?,
                (25, _) => return None,
                _ => {}
            }
        }
        Some(graph)
    }

    fn fill(&mut self, bytes: &[u8]) -> Option<()> {
        for field in Fields(bytes) {
            match field.ok()? {
                (1, Value::Bytes(inner)) => self.nodes.push(node(inner)?),
                (5, Value::Bytes(inner)) => self.constants.push(tensor(inner)?),
                // Sparse constants.
                (15, _) => return None,
                _ => {}
            }
        }
        Some(())
    }
}

fn node(bytes: &[u8]) -> Option<GraphNode> {
    let mut node = GraphNode::default();
    for field in Fields(bytes) {
        match field.ok()? {
            (1, Value::Bytes(name)) => node.inputs.push(text(name).ok()?),
            (2, Value::Bytes(name)) => node.outputs.push(text(name).ok()?),
            (4, Value::Bytes(name)) => node.operator = text(name).ok()?,
            (5, Value::Bytes(inner)) => node.attributes.push(attribute(inner)?),
            (7, Value::Bytes(domain)) if !domain.is_empty() && domain != b"ai.onnx" => return None,
            _ => {}
        }
    }
    Some(node)
}

fn attribute(bytes: &[u8]) -> Option<Attribute> {
    let mut attribute = Attribute::default();
    for field in Fields(bytes) {
        match field.ok()? {
            (1, Value::Bytes(name)) => attribute.name = text(name).ok()?,
            (2, Value::Word(bits)) => attribute.float = f32::from_bits(bits),
            (3, Value::Number(n)) => attribute.integer = n.cast_signed(),
            (8, value) => whole(value, &mut attribute.integers)?,
            // Tensors, graphs, and lists of them.
            (5 | 6 | 10 | 11, _) => return None,
            _ => {}
        }
    }
    Some(attribute)
}

/// One whole number, or several packed.
fn whole(value: Value<'_>, all: &mut Vec<i64>) -> Option<()> {
    match value {
        Value::Number(n) => all.push(n.cast_signed()),
        Value::Bytes(packed) => {
            let mut fields = Fields(packed);
            while !fields.0.is_empty() {
                all.push(fields.varint()?.cast_signed());
            }
        }
        Value::Word(_) | Value::Long(_) => return None,
    }
    Some(())
}

fn tensor(bytes: &[u8]) -> Option<Tensor> {
    let mut tensor = Tensor::default();
    let (mut kind, mut shape, mut floats, mut integers, mut raw) =
        (0, Vec::new(), Vec::new(), Vec::new(), None);
    for field in Fields(bytes) {
        match field.ok()? {
            (1, value) => whole(value, &mut shape)?,
            (2, Value::Number(n)) => kind = n,
            (4, Value::Bytes(packed)) => {
                floats.extend(packed.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)));
            }
            (4, Value::Word(bits)) => floats.push(f32::from_bits(bits)),
            (7, value) => whole(value, &mut integers)?,
            (8, Value::Bytes(name)) => tensor.name = text(name).ok()?,
            (9, Value::Bytes(bytes)) => raw = Some(bytes),
            // In another file.
            (14, Value::Number(1)) => return None,
            _ => {}
        }
    }
    tensor.shape = shape.into_iter().map(|size| usize::try_from(size).ok()).collect::<Option<_>>()?;
    let count = tensor.shape.iter().try_fold(1_usize, |product, size| product.checked_mul(*size))?;
    match kind {
        1 => {
            if let Some(raw) = raw {
                floats = raw.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            }
            tensor.floats = Some(floats).filter(|numbers| numbers.len() == count);
        }
        7 => {
            if let Some(raw) = raw {
                integers = raw.as_chunks::<8>().0.iter().map(|b| i64::from_le_bytes(*b)).collect();
            }
            tensor.integers = Some(integers).filter(|numbers| numbers.len() == count);
        }
        _ => {}
    }
    Some(tensor)
}
