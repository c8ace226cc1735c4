//! The floor: a chain in C that decodes, checks, runs the same network in plain loops and writes to a socket.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use dermis_inference::{Bundle, Model, OutputSpec, Runtime, RuntimeChoice, RuntimeConfig};
use dermis_skin::SkinDescription;
use onnx_rs::ast::{AttributeType, Graph, Node};

/// How far its answers may be from ours, as a share of what an answer is worth at most.
const ROUNDING: f64 = 1e-4;
/// Readings that it must answer as we do before it is measured.
const CHECKED: usize = 64;

/// The chain, built.
#[derive(Debug)]
pub struct Chain {
    folder: tempfile::TempDir,
}

impl Chain {
    /// Writes its network out of the bundle, compiles it, and compares its answers with those of our runtime.
    ///
    /// # Errors
    ///
    /// Where there is no C compiler, the graph has an operator that is not translated, or an answer is another one.
    pub fn build(root: &Path, skin: &SkinDescription, model: &Path) -> Result<Self> {
        let bundle = Bundle::load(model, skin)?;
        let graph = std::fs::read(model.join("model.onnx"))?;
        let folder = tempfile::tempdir()?;
        std::fs::write(folder.path().join("network.h"), header(skin, &bundle, &graph)?)?;
        let built = Command::new("cc")
            .args(["-std=gnu11", "-O3", "-march=native", "-Wall", "-Wextra", "-o"])
            .arg(folder.path().join("chain"))
            .arg(root.join("benches/c/chain.c"))
            .arg("-I")
            .arg(folder.path())
            .arg("-lm")
            .output()
            .context("cc cannot be started; apt-get install gcc")?;
        ensure!(built.status.success(), "cc refuses the chain: {}", String::from_utf8_lossy(&built.stderr));
        let chain = Self { folder };
        chain.compare(&bundle, &graph)?;
        Ok(chain)
    }

    /// Where its answers are read.
    #[must_use]
    pub fn socket(&self) -> PathBuf {
        self.folder.path().join("answers")
    }

    /// Between a line and [`socket`](Self::socket).
    #[must_use]
    pub fn command(&self, line: &str) -> Command {
        let mut command = Command::new(self.folder.path().join("chain"));
        command.arg(line).arg(self.socket());
        command
    }

    fn compare(&self, bundle: &Bundle, graph: &[u8]) -> Result<()> {
        let manifest = bundle.manifest();
        let section = manifest.model.as_ref().context("the bundle has no network")?;
        let (mean, scale) = (&manifest.input.mean, &manifest.input.scale);
        // Spread over what the network was trained on, each channel at another phase.
        let reading = |i: usize| {
            let at = |(k, (mean, scale)): (usize, (&f32, &f32))| {
                mean + 2.0 * scale * ((i * (k + 1)) as f32 * 0.37).sin()
            };
            mean.iter().zip(scale).enumerate().map(at).collect()
        };
        let readings: Vec<Vec<f32>> = (0..CHECKED).map(reading).collect();
        let mut child = Command::new(self.folder.path().join("chain"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let bytes: Vec<u8> = readings.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        // Dropped at the end of the statement, which ends the chain. What comes back fits into a pipe.
        child.stdin.take().context("the chain has no input")?.write_all(&bytes)?;
        let out = child.wait_with_output()?;
        let (answers, _) = out.stdout.as_chunks::<4>();
        let answers: Vec<f32> = answers.iter().map(|b| f32::from_le_bytes(*b)).collect();
        let values = &manifest.output.values;
        ensure!(answers.len() == CHECKED * values.len(), "the chain answers {} numbers", answers.len());
        let embedded = RuntimeConfig { choice: RuntimeChoice::Embedded, ..RuntimeConfig::default() };
        let mut model = Model::load(Runtime::load(&embedded)?, graph, &section.interface)?;
        let (mut features, mut outputs, mut raw) = (bundle.features(), bundle.outputs(), Vec::new());
        for (reading, answers) in readings.iter().zip(answers.chunks_exact(values.len())) {
            features.push(0, reading)?;
            model.run(features.input().context("one frame is not enough")?, &mut raw)?;
            outputs.decode(&raw)?;
            for ((spec, ours), theirs) in values.iter().zip(outputs.all()).zip(answers) {
                if (ours - f64::from(*theirs)).abs() > ROUNDING * ours.abs().max(spec.scale.abs()) {
                    bail!("the chain answers {theirs} for `{}`, our runtime {ours}", spec.name);
                }
            }
        }
        Ok(())
    }
}

/// `network.h` of the chain.
fn header(skin: &SkinDescription, bundle: &Bundle, graph: &[u8]) -> Result<String> {
    let manifest = bundle.manifest();
    let values: &[OutputSpec] = &manifest.output.values;
    let mut text = format!(
        "#define CHANNELS {}\n#define ANSWERS {}\n#define THRESHOLD {:e}f\n",
        skin.channels().len(),
        values.len(),
        skin.condition.contact_threshold,
    );
    let noise: Option<Vec<f32>> = skin.channels().iter().map(|c| c.noise.map(|sigma| sigma as f32)).collect();
    let noise = noise.context("the skin has a channel without noise")?;
    let of = |number: fn(&OutputSpec) -> f64| values.iter().map(|v| number(v) as f32).collect::<Vec<f32>>();
    constants(&mut text, "noise", &noise);
    constants(&mut text, "input_mean", &manifest.input.mean);
    constants(&mut text, "input_scale", &manifest.input.scale);
    constants(&mut text, "output_mean", &of(|v| v.mean));
    constants(&mut text, "output_scale", &of(|v| v.scale));
    let section = manifest.model.as_ref().context("the bundle has no network")?;
    let model = onnx_rs::parse(graph).map_err(|e| anyhow::anyhow!("model.onnx: {e}"))?;
    let graph = model.graph.context("model.onnx has no graph")?;
    network(&mut text, &graph, &section.interface.input, skin.channels().len(), &section.interface.output)?;
    Ok(text)
}

fn constants(text: &mut String, name: &str, numbers: &[f32]) {
    let numbers: Vec<String> = numbers.iter().map(|n| format!("{n:e}f")).collect();
    let _ = writeln!(text, "static const float {name}[{}] = {{{}}};", numbers.len(), numbers.join(","));
}

/// A graph whose every tensor is a row, as one function of loops.
fn network(text: &mut String, graph: &Graph<'_>, input: &str, inputs: usize, output: &str) -> Result<()> {
    let mut lengths: HashMap<String, usize> = HashMap::from([(input.to_owned(), inputs)]);
    for tensor in &graph.initializer {
        let Some(numbers) = tensor.as_f32() else { continue };
        constants(text, &format!("c_{}", tensor.name()), &numbers);
        lengths.insert(tensor.name().to_owned(), numbers.len());
    }
    let fixed = |name: &str| graph.initializer.iter().any(|t| t.name() == name);
    let variable = |name: &str| if fixed(name) { format!("c_{name}") } else { format!("v_{name}") };
    let (mut variables, mut body) = (String::new(), String::new());
    for node in &graph.node {
        let [result] = node.output.as_slice() else { bail!("an operator with several results") };
        let from: Vec<(String, usize)> =
            node.input.iter().filter_map(|name| Some((variable(name), *lengths.get(*name)?))).collect();
        let length = statement(&mut body, node, &variable(result), &from)?;
        let _ = writeln!(variables, "static float {}[{length}];", variable(result));
        lengths.insert((*result).to_owned(), length);
    }
    ensure!(lengths.contains_key(output), "the graph does not give `{output}`");
    let _ = write!(
        text,
        "{variables}static void network(const float *{}, float *answer) {{\n{body}  memcpy(answer, {}, ANSWERS * sizeof *answer);\n}}\n",
        variable(input),
        variable(output)
    );
    Ok(())
}

/// Writes one operator; how many numbers it gives.
fn statement(body: &mut String, node: &Node<'_>, to: &str, from: &[(String, usize)]) -> Result<usize> {
    let operator = node.op_type.to_string();
    let (name, length) = from.first().context("an operator without an input")?;
    // Of a row and a row, or of a row and one number.
    let element = |(name, length): &(String, usize)| {
        if *length == 1 { format!("{name}[0]") } else { format!("{name}[i]") }
    };
    let each = |body: &mut String, length: usize, expression: &str| {
        let _ = writeln!(body, "  for (int i = 0; i < {length}; i++) {to}[i] = {expression};");
        length
    };
    Ok(match (operator.as_str(), from) {
        ("Add" | "Sub" | "Mul" | "Div", [a, b]) => {
            let sign = match operator.as_str() {
                "Add" => '+',
                "Sub" => '-',
                "Mul" => '*',
                _ => '/',
            };
            each(body, a.1.max(b.1), &format!("{} {sign} {}", element(a), element(b)))
        }
        ("Sigmoid", [_]) => each(body, *length, &format!("1.0f / (1.0f + expf(-{name}[i]))")),
        ("Sqrt", [_]) => each(body, *length, &format!("sqrtf({name}[i])")),
        ("Log", [_]) => each(body, *length, &format!("logf({name}[i])")),
        ("Identity", [_]) => each(body, *length, &format!("{name}[i]")),
        ("ReduceSum", [_, ..]) => {
            let _ = writeln!(body, "  {to}[0] = 0; for (int i = 0; i < {length}; i++) {to}[0] += {name}[i];");
            1
        }
        ("Concat", parts) => {
            let mut at = 0;
            for (name, length) in parts {
                let _ = writeln!(body, "  memcpy({to} + {at}, {name}, {length} * sizeof *{to});");
                at += length;
            }
            at
        }
        ("Gemm", [_, (weights, number), (bias, columns)]) => {
            let plain = node.attribute.iter().all(|a| match a.r#type {
                AttributeType::Float => a.f == 1.0,
                AttributeType::Int => a.i == 0,
                _ => false,
            });
            ensure!(plain && *number == length * columns, "a Gemm that is not a row times a matrix");
            let _ = writeln!(
                body,
                "  memcpy({to}, {bias}, sizeof {to});\n  for (int i = 0; i < {length}; i++)\n    for (int j = 0; j < {columns}; j++) \
                 {to}[j] += {name}[i] * {weights}[i * {columns} + j];"
            );
            *columns
        }
        _ => bail!("the operator {operator} has no loop"),
    })
}
