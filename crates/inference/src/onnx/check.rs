//! What a graph takes and gives, read without running anything.
//!
//! `onnx-rs` can parse a graph too, but follows nested subgraphs to any depth, so a crafted file overflows its
//! stack. What is needed here lies at a fixed depth.

use crate::interface::Interface;
use crate::model::ModelError;

const FLOAT: u64 = 1;

/// Checks that `bytes` are an ONNX graph of this interface.
///
/// # Errors
///
/// [`ModelError::NotOnnx`] and [`ModelError::Interface`].
pub(crate) fn check(bytes: &[u8], interface: &Interface) -> Result<(), ModelError> {
    let signature = Signature::read(bytes)?;
    let sides = [
        ("input", &signature.inputs, interface.inputs().map(declared).collect::<Vec<_>>()),
        ("output", &signature.outputs, interface.outputs().map(declared).collect()),
    ];
    for (what, found, expected) in sides {
        // Graphs list their tensors in any order; two of one name are none.
        let sorted = |ports: &[GraphTensor]| {
            let mut ports = ports.to_vec();
            ports.sort_by(|a, b| a.name.cmp(&b.name));
            ports
        };
        let twice = sorted(&expected).windows(2).any(|pair| pair[0].name == pair[1].name);
        if twice || sorted(found) != sorted(&expected) {
            return Err(ModelError::Interface { what, found: listed(found), expected: listed(&expected) });
        }
    }
    Ok(())
}

/// A tensor that an interface declares.
fn declared((name, shape): (&str, &[usize])) -> GraphTensor {
    let shape = shape.iter().map(|d| i64::try_from(*d).ok()).collect();
    GraphTensor { name: name.to_owned(), element: FLOAT, shape }
}

/// Tensors in words.
#[must_use]
pub fn listed(ports: &[GraphTensor]) -> String {
    match ports {
        [] => "nothing".to_owned(),
        ports => ports.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and "),
    }
}

/// A tensor that goes into a graph or comes out.
#[derive(Debug, Clone, PartialEq)]
pub struct GraphTensor {
    /// Its name.
    pub name: String,
    /// `TensorProto.DataType`.
    element: u64,
    /// Its shape, `None` where a dimension is free.
    pub shape: Vec<Option<i64>>,
}

impl GraphTensor {
    /// Whether it holds 32-bit floats.
    #[must_use]
    pub fn is_float(&self) -> bool {
        self.element == FLOAT
    }

    /// Its shape, where no dimension is free or empty.
    #[must_use]
    pub fn fixed(&self) -> Option<Vec<usize>> {
        self.shape.iter().map(|d| d.and_then(|d| usize::try_from(d).ok()).filter(|d| *d > 0)).collect()
    }
}

impl std::fmt::Display for GraphTensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let shape: Vec<String> =
            self.shape.iter().map(|d| d.map_or_else(|| "?".to_owned(), |d| d.to_string())).collect();
        let element = match self.element {
            FLOAT => "",
            7 => " of int64",
            11 => " of float64",
            _ => " of another element type",
        };
        write!(f, "`{}` [{}]{element}", self.name, shape.join(", "))
    }
}

/// What a graph of unknown origin takes and gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Signature {
    /// What goes in.
    pub inputs: Vec<GraphTensor>,
    /// What comes out.
    pub outputs: Vec<GraphTensor>,
    /// Operator sets that it is written in: domain (empty for the core) and version.
    pub opsets: Vec<(String, u64)>,
}

impl Signature {
    /// Reads it from the bytes of an `.onnx` file.
    ///
    /// # Errors
    ///
    /// [`ModelError::NotOnnx`].
    pub fn read(bytes: &[u8]) -> Result<Self, ModelError> {
        Self::parse(bytes).map_err(|reason| ModelError::NotOnnx { reason })
    }

    /// Field numbers are those of `onnx.proto`.
    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let (mut version, mut graph, mut opsets) = (0, None, Vec::new());
        for field in Fields(bytes) {
            match field? {
                (1, Value::Number(n)) => version = n,
                (7, Value::Bytes(b)) => graph = Some(b),
                (8, Value::Bytes(b)) => opsets.push(opset(b)?),
                _ => {}
            }
        }
        let graph = graph.filter(|_| version > 0).ok_or("it holds no graph")?;
        let (mut inputs, mut outputs, mut constants) = (Vec::new(), Vec::new(), Vec::new());
        for field in Fields(graph) {
            match field? {
                (5, Value::Bytes(b)) => constants.push(constant_name(b)?),
                (11, Value::Bytes(b)) => inputs.push(port(b)?),
                (12, Value::Bytes(b)) => outputs.push(port(b)?),
                _ => {}
            }
        }
        // Old exporters list weights among the inputs, too.
        inputs.retain(|input| !constants.contains(&input.name));
        Ok(Self { inputs, outputs, opsets })
    }
}

fn opset(bytes: &[u8]) -> Result<(String, u64), String> {
    let mut opset = (String::new(), 0);
    for field in Fields(bytes) {
        match field? {
            (1, Value::Bytes(b)) => opset.0 = text(b)?,
            (2, Value::Number(n)) => opset.1 = n,
            _ => {}
        }
    }
    Ok(opset)
}

/// From a graph to the dimensions of what goes in and comes out.
const DIMENSIONS: [&[u64]; 6] = [&[7], &[11, 12], &[2], &[1], &[2], &[1]];

/// The same graph with a batch of 1, where its inputs and outputs leave the first dimension free.
///
/// # Errors
///
/// [`ModelError::NotOnnx`].
pub fn with_batch_of_one(bytes: &[u8]) -> Result<Vec<u8>, ModelError> {
    fixed(bytes, &DIMENSIONS).map_err(|reason| ModelError::NotOnnx { reason })
}

fn fixed(bytes: &[u8], path: &[&[u64]]) -> Result<Vec<u8>, String> {
    let Some((wanted, rest)) = path.split_first() else {
        // A dimension: 1 is its value, 2 the name of a free one.
        let mut known = false;
        for field in Fields(bytes) {
            known |= matches!(field?, (1, _));
        }
        return Ok(if known { bytes.to_vec() } else { vec![8, 1] });
    };
    let mut first = true;
    rewritten(bytes, |number, inner| {
        // Of the dimensions only the first is the batch.
        if !wanted.contains(&number) || !first && rest.is_empty() {
            return Ok(None);
        }
        first = false;
        fixed(inner, rest).map(Some)
    })
}

/// A message whose fields of bytes are replaced by what `with` says, where it says anything; all others stay as they are.
pub(super) fn rewritten(
    message: &[u8],
    mut with: impl FnMut(u64, &[u8]) -> Result<Option<Vec<u8>>, String>,
) -> Result<Vec<u8>, String> {
    let mut fields = Fields(message);
    let mut out = Vec::with_capacity(message.len() + 64);
    loop {
        let before = fields.0;
        let Some(field) = fields.next() else { return Ok(out) };
        let replaced = match field? {
            (number, Value::Bytes(content)) => with(number, content)?.map(|new| field_of(number, &new)),
            _ => None,
        };
        match replaced {
            Some(new) => out.extend(new),
            None => out.extend_from_slice(&before[..before.len() - fields.0.len()]),
        }
    }
}

/// A field that holds bytes.
pub(super) fn field_of(number: u64, content: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(content.len() + 8);
    varint(number << 3 | 2, &mut out);
    varint(content.len() as u64, &mut out);
    out.extend_from_slice(content);
    out
}

pub(super) fn varint(mut value: u64, out: &mut Vec<u8>) {
    while value > 0x7f {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn constant_name(bytes: &[u8]) -> Result<String, String> {
    let mut name = String::new();
    for field in Fields(bytes) {
        match field? {
            (8, Value::Bytes(b)) => name = text(b)?,
            (14, Value::Number(1)) => return Err("it keeps weights in another file".into()),
            _ => {}
        }
    }
    Ok(name)
}

fn port(bytes: &[u8]) -> Result<GraphTensor, String> {
    let mut port = GraphTensor { name: String::new(), element: 0, shape: Vec::new() };
    for field in Fields(bytes) {
        match field? {
            (1, Value::Bytes(b)) => port.name = text(b)?,
            (2, Value::Bytes(kind)) => {
                for field in Fields(kind) {
                    if let (1, Value::Bytes(tensor)) = field? {
                        tensor_type(tensor, &mut port)?;
                    }
                }
            }
            _ => {}
        }
    }
    Ok(port)
}

fn tensor_type(bytes: &[u8], port: &mut GraphTensor) -> Result<(), String> {
    for field in Fields(bytes) {
        match field? {
            (1, Value::Number(n)) => port.element = n,
            (2, Value::Bytes(shape)) => {
                for field in Fields(shape) {
                    if let (1, Value::Bytes(dimension)) = field? {
                        let mut size = None;
                        for field in Fields(dimension) {
                            if let (1, Value::Number(n)) = field? {
                                size = Some(n.cast_signed());
                            }
                        }
                        port.shape.push(size);
                    }
                }
            }
            _ => {}
        }
    }
    Ok(())
}

pub(super) fn text(bytes: &[u8]) -> Result<String, String> {
    String::from_utf8(bytes.to_vec()).map_err(|_| "a name is not UTF-8".into())
}

#[derive(Clone, Copy)]
pub(super) enum Value<'a> {
    Number(u64),
    Bytes(&'a [u8]),
    /// Four bytes, lowest first.
    Word(u32),
    /// Eight bytes, lowest first.
    Long(u64),
}

/// The fields of one protobuf message; stops after the first error.
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    pub(super) fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let (byte, rest) = self.0.split_first()?;
            self.0 = rest;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    fn take(&mut self, length: u64) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(usize::try_from(length).ok()?)?;
        self.0 = rest;
        Some(taken)
    }

    fn field(&mut self) -> Option<(u64, Value<'a>)> {
        let tag = self.varint()?;
        let value = match tag & 7 {
            0 => Value::Number(self.varint()?),
            1 => Value::Long(u64::from_le_bytes(self.take(8)?.try_into().ok()?)),
            2 => {
                let length = self.varint()?;
                Value::Bytes(self.take(length)?)
            }
            5 => Value::Word(u32::from_le_bytes(self.take(4)?.try_into().ok()?)),
            _ => return None,
        };
        (tag >> 3 != 0).then_some((tag >> 3, value))
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<(u64, Value<'a>), String>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.0.is_empty() {
            return None;
        }
        let field = self.field();
        if field.is_none() {
            self.0 = &[];
        }
        Some(field.ok_or_else(|| "it is cut short or garbled".to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::onnx::GraphBuilder;

    fn doubler() -> Vec<u8> {
        let mut g = GraphBuilder::new("doubler");
        let x = g.input("input", &[1, 3]);
        let y = g.add(&x, &x);
        g.output("output", &y, &[1, 3]);
        g.finish().unwrap()
    }

    #[test]
    fn a_graph_of_the_declared_interface_passes() {
        check(&doubler(), &Interface::flat(3, 3)).unwrap();
    }

    #[test]
    fn refusals_show_both_sides() {
        let refused = |bytes: &[u8], interface| check(bytes, &interface).unwrap_err().to_string();
        insta::assert_snapshot!(refused(&doubler(), Interface::flat(4, 3)), @"has input `input` [1, 3] where `input` [1, 4] is declared; export it again with that input");
        insta::assert_snapshot!(refused(&doubler(), Interface { output: "y".into(), ..Interface::flat(3, 3) }), @"has output `output` [1, 3] where `y` [1, 3] is declared; export it again with that output");
        insta::assert_snapshot!(refused(b"", Interface::flat(3, 3)), @"is not an ONNX model: it holds no graph; export it again");
        insta::assert_snapshot!(refused(b"PK\x03\x04 a zip", Interface::flat(3, 3)), @"is not an ONNX model: it is cut short or garbled; export it again");
    }

    #[test]
    fn a_free_batch_becomes_one() {
        let whole = doubler();
        assert_eq!(with_batch_of_one(&whole).unwrap(), whole);
        // Both first dimensions, {dim_value: 1}, become {dim_param: "N"}, which is a byte longer on every level.
        let free: Vec<u8> = {
            let needle: &[u8] = &[0x0a, 2, 8, 1];
            let mut free = whole.clone();
            while let Some(at) = free.windows(4).position(|w| w == needle) {
                // A name of no letters keeps all lengths.
                free[at + 2..at + 4].copy_from_slice(&[0x12, 0]);
            }
            free
        };
        let signature = Signature::read(&free).unwrap();
        assert_eq!(signature.inputs[0].shape, [None, Some(3)]);
        assert_eq!(signature.opsets, [(String::new(), 17)]);
        assert_eq!(with_batch_of_one(&free).unwrap(), whole);
    }

    #[test]
    fn every_truncation_is_refused() {
        let bytes = doubler();
        for length in 0..bytes.len() {
            assert!(check(&bytes[..length], &Interface::flat(3, 3)).is_err() || length + 10 > bytes.len());
        }
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
            let _ = check(&bytes, &Interface::flat(3, 3));
            let _ = with_batch_of_one(&bytes);
        }

        #[test]
        fn no_bit_flip_panics(at in 0..100_usize, bit in 0..8) {
            let mut bytes = doubler();
            let at = at % bytes.len();
            bytes[at] ^= 1_u8 << bit;
            let _ = check(&bytes, &Interface::flat(3, 3));
        }
    }
}
