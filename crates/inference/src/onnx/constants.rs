//! The constants of a graph: whether they are finite numbers, and how large they are once unpacked; read without running anything.
//!
//! A graph of a few bytes can claim a tensor of gigabytes, which a runtime would allocate, and one number that is not finite makes
//! every answer so. Constants are the graph's initialisers and the tensors among the attributes of its operators, those of graphs
//! within graphs included, down to a fixed depth.

use super::check::{Fields, Value, text};
use crate::model::ModelError;

/// Graphs within graphs that are followed.
const DEEPEST: usize = 8;

/// Refuses a graph whose constants are not all finite, or have more than `most` bytes together.
pub(crate) fn check(bytes: &[u8], most: u64) -> Result<(), ModelError> {
    let garbled = |reason: String| ModelError::NotOnnx { reason };
    let mut found = Found { bytes: 0, most, bad: None, free: None };
    found.model(bytes).map_err(garbled)?;
    if let Some((constant, value)) = found.bad {
        return Err(ModelError::ConstantNotFinite { constant, value });
    }
    if found.bytes > most {
        return Err(ModelError::ConstantsTooLarge { bytes: found.bytes, most });
    }
    Ok(())
}

/// The first operator whose result may be as large as a number says that it computes with, if there is one: where a graph cannot be
/// tried in a process of its own, such a graph is not run.
pub(crate) fn unbounded(bytes: &[u8]) -> Option<String> {
    let mut found = Found { bytes: 0, most: u64::MAX, bad: None, free: None };
    match found.model(bytes) {
        Ok(()) => found.free,
        Err(_) => Some("(garbled)".to_owned()),
    }
}

/// Operators whose result has a size that is a value, or that run graphs again and again.
const UNBOUNDED: [&str; 13] = [
    "ConstantOfShape",
    "Expand",
    "If",
    "Loop",
    "OneHot",
    "Pad",
    "RandomNormal",
    "RandomUniform",
    "Range",
    "Resize",
    "Scan",
    "Tile",
    "Upsample",
];

struct Found {
    bytes: u64,
    most: u64,
    bad: Option<(String, f64)>,
    /// An operator of [`UNBOUNDED`].
    free: Option<String>,
}

impl Found {
    fn model(&mut self, model: &[u8]) -> Result<(), String> {
        for field in Fields(model) {
            match field? {
                (7, Value::Bytes(graph)) => self.graph(graph, 0)?,
                // Operators that the model defines itself.
                (25, Value::Bytes(function)) => {
                    for field in Fields(function) {
                        if let (7, Value::Bytes(node)) = field? {
                            self.node(node, 0)?;
                        }
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn graph(&mut self, graph: &[u8], depth: usize) -> Result<(), String> {
        if depth > DEEPEST {
            return Err(format!("it nests graphs deeper than {DEEPEST}"));
        }
        for field in Fields(graph) {
            match field? {
                (1, Value::Bytes(node)) => self.node(node, depth)?,
                (5, Value::Bytes(constant)) => self.tensor(constant)?,
                (15, Value::Bytes(sparse)) => self.sparse(sparse)?,
                _ => {}
            }
        }
        Ok(())
    }

    fn sparse(&mut self, sparse: &[u8]) -> Result<(), String> {
        // Values, indices, and the size that both are unpacked to.
        let mut whole = 1u64;
        for field in Fields(sparse) {
            match field? {
                (1 | 2, Value::Bytes(tensor)) => self.tensor(tensor)?,
                (3, value) => whole = whole.saturating_mul(product(value)?),
                _ => {}
            }
        }
        self.bytes = self.bytes.saturating_add(whole.saturating_mul(8));
        Ok(())
    }

    fn node(&mut self, node: &[u8], depth: usize) -> Result<(), String> {
        for field in Fields(node) {
            match field? {
                (4, Value::Bytes(operator)) if self.free.is_none() => {
                    let operator = text(operator)?;
                    self.free = UNBOUNDED.contains(&operator.as_str()).then_some(operator);
                }
                (5, Value::Bytes(attribute)) => {
                    for field in Fields(attribute) {
                        match field? {
                            (5 | 10, Value::Bytes(tensor)) => self.tensor(tensor)?,
                            (6 | 11, Value::Bytes(graph)) => self.graph(graph, depth + 1)?,
                            (22 | 23, Value::Bytes(sparse)) => self.sparse(sparse)?,
                            _ => {}
                        }
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn tensor(&mut self, tensor: &[u8]) -> Result<(), String> {
        let (mut elements, mut kind, mut name) = (1u64, 0, String::new());
        for field in Fields(tensor) {
            match field? {
                (1, value) => elements = elements.saturating_mul(product(value)?),
                (2, Value::Number(n)) => kind = n,
                (8, Value::Bytes(b)) => name = text(b)?,
                _ => {}
            }
        }
        self.bytes = self.bytes.saturating_add(elements.saturating_mul(width(kind)));
        if self.bytes > self.most {
            // It is refused whatever it holds.
            return Ok(());
        }
        for field in Fields(tensor) {
            let value = match field? {
                (4, Value::Bytes(packed)) => not_finite::<4>(packed, |b| f32::from_le_bytes(b).into()),
                (4, Value::Word(bits)) => Some(f64::from(f32::from_bits(bits))).filter(|v| !v.is_finite()),
                (10, Value::Bytes(packed)) => not_finite::<8>(packed, f64::from_le_bytes),
                (10, Value::Long(bits)) => Some(f64::from_bits(bits)).filter(|v| !v.is_finite()),
                (9, Value::Bytes(raw)) => match kind {
                    1 => not_finite::<4>(raw, |b| f32::from_le_bytes(b).into()),
                    11 => not_finite::<8>(raw, f64::from_le_bytes),
                    10 => not_finite::<2>(raw, |b| half(u16::from_le_bytes(b))),
                    16 => not_finite::<2>(raw, |b| {
                        f32::from_bits(u32::from(u16::from_le_bytes(b)) << 16).into()
                    }),
                    _ => None,
                },
                _ => None,
            };
            if let Some(value) = value
                && self.bad.is_none()
            {
                self.bad = Some((name.clone(), value));
            }
        }
        Ok(())
    }
}

/// Sizes along one or more dimensions, multiplied.
fn product(value: Value<'_>) -> Result<u64, String> {
    match value {
        Value::Number(n) => Ok(n),
        // Packed: as proto3 has it.
        Value::Bytes(packed) => {
            let mut fields = Fields(packed);
            let mut product = 1u64;
            while !fields.0.is_empty() {
                let size = fields.varint().ok_or("it is cut short or garbled")?;
                product = product.saturating_mul(size);
            }
            Ok(product)
        }
        Value::Word(_) | Value::Long(_) => Err("a tensor has no whole numbers for dimensions".into()),
    }
}

/// \[bytes\] of one element of a `TensorProto.DataType`.
fn width(kind: u64) -> u64 {
    match kind {
        2 | 3 | 9 => 1,
        4 | 5 | 10 | 16 => 2,
        7 | 11 | 13 | 14 => 8,
        15 => 16,
        // 32-bit numbers, and what nobody knows.
        _ => 4,
    }
}

fn not_finite<const N: usize>(bytes: &[u8], value: impl Fn([u8; N]) -> f64) -> Option<f64> {
    bytes.as_chunks::<N>().0.iter().map(|b| value(*b)).find(|v| !v.is_finite())
}

/// What matters of a half-precision number here: whether it is finite.
fn half(bits: u16) -> f64 {
    match (bits >> 10 & 0x1f, bits & 0x3ff) {
        (0x1f, 0) => f64::INFINITY,
        (0x1f, _) => f64::NAN,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::onnx::{Attribute, GraphBuilder};

    fn with_weights(weights: &[f32]) -> Vec<u8> {
        let mut g = GraphBuilder::new("line");
        let x = g.input("input", &[1, weights.len()]);
        let w = g.constant("weight", &[weights.len(), 1], weights);
        let y = g.matmul(&x, &w);
        g.output("output", &y, &[1, 1]);
        g.finish().unwrap()
    }

    fn field(number: u8, content: &[u8]) -> Vec<u8> {
        let mut out = vec![number << 3 | 2];
        out.extend(u8::try_from(content.len()).ok().filter(|n| *n < 128));
        out.extend_from_slice(content);
        out
    }

    /// A model whose graph has one initialiser.
    fn with_tensor(tensor: &[u8]) -> Vec<u8> {
        field(7, &field(5, tensor))
    }

    #[test]
    fn weights_that_are_not_finite_are_named() {
        check(&with_weights(&[1.0, -2.5]), 1 << 20).unwrap();
        let refused = |bytes: &[u8]| check(bytes, 1 << 20).unwrap_err().to_string();
        insta::assert_snapshot!(refused(&with_weights(&[1.0, f32::NAN])), @"constant `weight` holds NaN, which is no finite number, so that no answer would be one; train or export the model again");
        insta::assert_snapshot!(refused(&with_weights(&[f32::NEG_INFINITY, 0.0])), @"constant `weight` holds -inf, which is no finite number, so that no answer would be one; train or export the model again");
        // The other places where a tensor keeps its numbers: float_data packed and not, halves, and those of an operator.
        let infinite = f32::INFINITY.to_le_bytes();
        let name = field(8, b"w");
        for data in [
            [vec![8, 1, 16, 1], field(4, &infinite), name.clone()].concat(),
            [vec![8, 1, 16, 1, 4 << 3 | 5], infinite.to_vec(), name.clone()].concat(),
            [vec![8, 1, 16, 10], field(9, &[0x00, 0xfc]), name.clone()].concat(),
            [vec![8, 1, 16, 16], field(9, &[0xc0, 0x7f]), name.clone()].concat(),
            [vec![8, 1, 16, 11], field(9, &f64::NAN.to_le_bytes()), name].concat(),
        ] {
            assert!(refused(&with_tensor(&data)).starts_with("constant `w` holds "), "{data:?}");
            let attribute = field(7, &field(1, &field(5, &field(5, &data))));
            assert!(refused(&attribute).starts_with("constant `w` holds "), "{data:?}");
        }
    }

    #[test]
    fn tensors_that_claim_gigabytes_are_refused_before_any_is_made() {
        // dims: [32768, 32768], of 32-bit floats, without a number in it.
        let dims = [8, 0x80, 0x80, 2, 8, 0x80, 0x80, 2, 16, 1];
        let text = check(&with_tensor(&dims), 512 << 20).unwrap_err().to_string();
        insta::assert_snapshot!(text, @"its constants have 4294967296 bytes, and at most 536870912 are loaded; export a smaller model, or raise `constant_bytes` of `model_limits`");
        let packed = [vec![10, 6, 0x80, 0x80, 2, 0x80, 0x80, 2], vec![16, 1]].concat();
        assert!(check(&with_tensor(&packed), 512 << 20).is_err());
        let overflowing = [10, 10, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f, 3, 16, 1];
        assert!(check(&with_tensor(&overflowing), u64::MAX - 1).is_err());
    }

    #[test]
    fn graphs_within_graphs_have_an_end() {
        let mut graph = field(5, &[8, 1, 16, 1]);
        for _ in 0..DEEPEST + 2 {
            // An operator with an attribute that is a graph.
            graph = field(1, &field(5, &field(6, &graph)));
        }
        let text = check(&field(7, &graph), 1 << 20).unwrap_err().to_string();
        assert!(text.contains("nests graphs deeper than 8"), "{text}");
    }

    #[test]
    fn operators_with_an_output_size_from_their_inputs_are_found() {
        assert_eq!(unbounded(&with_weights(&[1.0])), None);
        let mut g = GraphBuilder::new("tile");
        let x = g.input("input", &[1, 2]);
        let n = g.constant_i64("n", &[2], &[1, 1_000_000_000]);
        let y = g.operator("Tile", &[&x, &n], &[("axis", Attribute::Int(0))], 1).remove(0);
        g.output("output", &y, &[1, 2]);
        assert_eq!(unbounded(&g.finish().unwrap()).as_deref(), Some("Tile"));
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
            let _ = check(&bytes, 1 << 20);
            let _ = check(&with_tensor(&bytes[..bytes.len().min(100)]), 1 << 20);
            let _ = unbounded(&bytes);
        }
    }
}
