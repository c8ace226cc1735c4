//! Several graphs one after the other in one.
//!
//! Problem: what one network gives, another takes, and a runtime loads one graph. Method: operators and constants of all parts stand in
//! one graph, under the name of their part; a part's input is the output of the part before. Only names are rewritten: operators,
//! attributes and numbers stay byte for byte as they were. Assumptions: each part has one input, each but the last one output, and
//! all are written in the same operator sets. Graphs within graphs (loops, branches) may name tensors of the graph around them and
//! are refused, and so are operators that a graph defines itself. Cost: one pass over the bytes.

use std::collections::{BTreeMap, BTreeSet};

use super::check::{Fields, Signature, Value, field_of, listed, rewritten, text, varint};

/// Graphs that cannot stand one after the other.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("graph `{part}` {problem}")]
pub struct ChainError {
    /// The name of the part.
    pub part: String,
    /// What is wrong with it, and what to do.
    pub problem: String,
}

/// A part as it was read.
struct Part<'a> {
    name: &'a str,
    model: &'a [u8],
    signature: Signature,
}

/// One graph that gives what the last of `parts` gives when each takes what the one before it gives. Input and outputs keep their
/// names; what lies between is called `PART/NAME`.
///
/// # Errors
///
/// [`ChainError`] names the first part that does not fit the one before it, or cannot be rewritten.
pub fn chain(parts: &[(&str, &[u8])]) -> Result<Vec<u8>, ChainError> {
    let parts = parts.iter().map(|(name, model)| part(name, model)).collect::<Result<Vec<_>, _>>()?;
    let (Some(first), Some(last)) = (parts.first(), parts.last()) else {
        return Err(wrong("(none)", "is missing: name at least one"));
    };
    fit(&parts)?;
    let input = first.signature.inputs.first().map_or("", |port| port.name.as_str());
    if last.signature.outputs.iter().any(|port| port.name == input) {
        return Err(wrong(last.name, format!("has an output called `{input}`, as the input is; rename it")));
    }
    // What the tensor is called that comes out of the part before.
    let mut before = input.to_owned();
    let (mut nodes, mut constants, mut versions) = (Vec::new(), Vec::new(), BTreeMap::new());
    let mut ir_version = 0;
    for (index, part) in parts.iter().enumerate() {
        let names = Names::of(part, &before, index + 1 == parts.len());
        let garbled = |reason: String| wrong(part.name, format!("cannot be chained: {reason}"));
        for field in Fields(part.model) {
            match field.map_err(garbled)? {
                (1, Value::Number(version)) => ir_version = version.max(ir_version),
                (7, Value::Bytes(graph)) => {
                    names.graph(graph, &mut nodes, &mut constants).map_err(garbled)?;
                }
                (25, _) => return Err(garbled("it defines operators of its own".into())),
                _ => {}
            }
        }
        for (domain, version) in &part.signature.opsets {
            let domain = if domain == "ai.onnx" { "" } else { domain };
            let other = *versions.entry(domain.to_owned()).or_insert(*version);
            if other != *version {
                let problem = format!(
                    "is written in operator set {version}, and one before it in {other}; export both in the same one"
                );
                return Err(wrong(part.name, problem));
            }
        }
        before = part.signature.outputs.first().map_or_else(String::new, |port| names.renamed(&port.name));
    }
    ports(first.model, 11, &mut nodes, |name| name == input);
    ports(last.model, 12, &mut constants, |_| true);
    let graph = [field_of(2, b"chain"), nodes, constants].concat();
    let mut model = vec![8];
    varint(ir_version, &mut model);
    model.extend(field_of(2, b"dermis"));
    model.extend(field_of(7, &graph));
    for (domain, version) in versions {
        let mut set = field_of(1, domain.as_bytes());
        set.push(2 << 3);
        varint(version, &mut set);
        model.extend(field_of(8, &set));
    }
    Ok(model)
}

fn wrong(part: &str, problem: impl Into<String>) -> ChainError {
    ChainError { part: part.to_owned(), problem: problem.into() }
}

fn part<'a>(name: &'a str, model: &'a [u8]) -> Result<Part<'a>, ChainError> {
    let signature = Signature::read(model).map_err(|error| wrong(name, error.to_string()))?;
    Ok(Part { name, model, signature })
}

/// Whether each part takes what the one before it gives.
fn fit(parts: &[Part<'_>]) -> Result<(), ChainError> {
    for part in parts {
        if part.signature.inputs.len() != 1 {
            let problem = format!("has the inputs {}, and one is needed", listed(&part.signature.inputs));
            return Err(wrong(part.name, problem));
        }
    }
    for pair in parts.windows(2) {
        let [before, after] = pair else { continue };
        let ([output], [input]) = (&before.signature.outputs[..], &after.signature.inputs[..]) else {
            let problem = format!("has the outputs {}, and one is needed", listed(&before.signature.outputs));
            return Err(wrong(before.name, problem));
        };
        let fits = output.is_float() && input.is_float() && output.fixed() == input.fixed();
        if !fits || output.fixed().is_none() {
            let problem = format!(
                "takes {input} where `{}` gives {output}; both must be 32-bit floats of one fixed shape",
                before.name
            );
            return Err(wrong(after.name, problem));
        }
    }
    Ok(())
}

/// What the tensors of a part are called in the whole.
struct Names<'a> {
    part: &'a str,
    input: &'a str,
    /// What goes in is called there.
    before: &'a str,
    /// Outputs of the whole, which keep their names.
    kept: BTreeSet<&'a str>,
}

impl<'a> Names<'a> {
    fn of(part: &'a Part<'_>, before: &'a str, last: bool) -> Self {
        let input = part.signature.inputs.first().map_or("", |port| port.name.as_str());
        let outputs = part.signature.outputs.iter().map(|port| port.name.as_str());
        Self { part: part.name, input, before, kept: outputs.filter(|_| last).collect() }
    }

    fn renamed_bytes(&self, name: &[u8]) -> Result<Vec<u8>, String> {
        Ok(self.renamed(&text(name)?).into_bytes())
    }

    fn renamed(&self, name: &str) -> String {
        // An optional input that is left out has no name.
        if name.is_empty() || self.kept.contains(name) {
            name.to_owned()
        } else if name == self.input {
            self.before.to_owned()
        } else {
            format!("{}/{name}", self.part)
        }
    }

    /// Appends operators and constants of a graph, renamed.
    fn graph(&self, graph: &[u8], nodes: &mut Vec<u8>, constants: &mut Vec<u8>) -> Result<(), String> {
        for field in Fields(graph) {
            match field? {
                (1, Value::Bytes(node)) => nodes.extend(field_of(1, &self.node(node)?)),
                (5, Value::Bytes(constant)) => {
                    let renamed = rewritten(constant, |number, name| {
                        (number == 8).then(|| self.renamed_bytes(name)).transpose()
                    });
                    constants.extend(field_of(5, &renamed?));
                }
                (15, _) => return Err("it has sparse constants".into()),
                // Names and shapes of what lies between are known without being listed.
                _ => {}
            }
        }
        Ok(())
    }

    fn node(&self, node: &[u8]) -> Result<Vec<u8>, String> {
        for field in Fields(node) {
            if let (5, Value::Bytes(attribute)) = field? {
                for field in Fields(attribute) {
                    if matches!(field?, (6 | 11, Value::Bytes(_))) {
                        return Err("it has graphs within graphs".into());
                    }
                }
            }
        }
        // Inputs, outputs, and the operator's own name.
        rewritten(node, |number, name| match number {
            1 | 2 => self.renamed_bytes(name).map(Some),
            3 => Ok(Some(format!("{}/{}", self.part, text(name)?).into_bytes())),
            _ => Ok(None),
        })
    }
}

/// Appends inputs (11) or outputs (12) of a model's graph whose name is `wanted`, as they are.
fn ports(model: &[u8], number: u64, out: &mut Vec<u8>, wanted: impl Fn(&str) -> bool) {
    // Every field was read before.
    let graphs = Fields(model).flatten().filter_map(|field| match field {
        (7, Value::Bytes(graph)) => Some(graph),
        _ => None,
    });
    for (found, value) in graphs.flat_map(|graph| Fields(graph).flatten()) {
        let Value::Bytes(port) = value else { continue };
        let named = Fields(port).flatten().any(|field| match field {
            (1, Value::Bytes(name)) => std::str::from_utf8(name).is_ok_and(&wanted),
            _ => false,
        });
        if found == number && named {
            out.extend(field_of(number, port));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::rehearse_embedded;
    use crate::onnx::GraphBuilder;
    use crate::{Interface, Limits};

    /// `tanh(x · weight)`, whose tensors are called alike in every graph.
    fn layer(inputs: usize, outputs: usize, output: &str, seed: f32) -> Vec<u8> {
        let mut g = GraphBuilder::new("layer");
        let x = g.input("input", &[1, inputs]);
        let weights: Vec<f32> = (0..inputs * outputs).map(|i| ((i as f32 + seed) * 1.7).sin()).collect();
        let weight = g.constant("weight", &[inputs, outputs], &weights);
        let y = g.matmul(&x, &weight);
        let y = g.tanh(&y);
        g.output(output, &y, &[1, outputs]);
        g.finish().unwrap()
    }

    fn named(inputs: usize, outputs: usize, output: &str) -> Interface {
        Interface { output: output.into(), ..Interface::flat(inputs, outputs) }
    }

    #[test]
    fn a_chain_gives_what_its_parts_give_one_after_the_other() {
        let parts = [layer(5, 4, "output", 1.0), layer(4, 3, "output", 2.0), layer(3, 2, "map.normal", 3.0)];
        let whole = chain(&[("a", &parts[0]), ("b", &parts[1]), ("c", &parts[2])]).unwrap();
        super::super::check_constants(&whole, Limits::default().constant_bytes).unwrap();
        let mut input = vec![0.3, -1.0, 2.0, 0.0, 0.7];
        let got = rehearse_embedded(&whole, &named(5, 2, "map.normal"), &input).unwrap();
        let sizes = [(5, 4, "output"), (4, 3, "output"), (3, 2, "map.normal")];
        for (part, (inputs, outputs, output)) in parts.iter().zip(sizes) {
            input = rehearse_embedded(part, &named(inputs, outputs, output), &input).unwrap();
        }
        assert!(got.iter().zip(&input).all(|(a, b)| (a - b).abs() < 1e-6), "{got:?} {input:?}");
        // They are no constants.
        assert!(got.iter().all(|v| v.abs() > 1e-3) && got[0] != got[1], "{got:?}");
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let refused = |parts: &[(&str, &[u8])]| chain(parts).unwrap_err().to_string();
        let (first, second) = (layer(5, 4, "output", 1.0), layer(3, 2, "output", 2.0));
        insta::assert_snapshot!(refused(&[("a", &first), ("b", &second)]), @"graph `b` takes `input` [1, 3] where `a` gives `output` [1, 4]; both must be 32-bit floats of one fixed shape");
        insta::assert_snapshot!(refused(&[("a", b"PK\x03\x04 a zip")]), @"graph `a` is not an ONNX model: it is cut short or garbled; export it again");
        insta::assert_snapshot!(refused(&[]), @"graph `(none)` is missing: name at least one");
        let mut g = GraphBuilder::new("two");
        let (x, y) = (g.input("x", &[1, 4]), g.input("y", &[1, 4]));
        let sum = g.add(&x, &y);
        g.output("output", &sum, &[1, 4]);
        let two = g.finish().unwrap();
        insta::assert_snapshot!(refused(&[("a", &first), ("b", &two)]), @"graph `b` has the inputs `x` [1, 4] and `y` [1, 4], and one is needed");
        let own: Vec<u8> = {
            // A part whose output is called as the input of the whole is.
            let mut g = GraphBuilder::new("own");
            let x = g.input("x", &[1, 4]);
            let y = g.tanh(&x);
            g.output("input", &y, &[1, 4]);
            g.finish().unwrap()
        };
        insta::assert_snapshot!(refused(&[("a", &first), ("b", &own)]), @"graph `b` has an output called `input`, as the input is; rename it");
    }

    #[test]
    fn a_loop_is_refused() {
        // An operator with an attribute that is a graph (field 6).
        let within = field_of(1, &[field_of(4, b"If"), field_of(5, &field_of(6, b""))].concat());
        let mut model = vec![8, 8];
        for field in Fields(&layer(2, 2, "output", 1.0)).flatten() {
            if let (7, Value::Bytes(graph)) = field {
                model.extend(field_of(7, &[graph, &within].concat()));
            }
        }
        let text = chain(&[("a", &model)]).unwrap_err().to_string();
        assert_eq!(text, "graph `a` cannot be chained: it has graphs within graphs");
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
            let _ = chain(&[("a", &bytes)]);
            let _ = chain(&[("a", &layer(2, 2, "output", 1.0)), ("b", &bytes)]);
        }
    }
}
