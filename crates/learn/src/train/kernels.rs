//! Sums of kernels as operators of a graph.
//!
//! Method: differences from every learned row, squared and added up, exponentials, and one product with the weights. Differences are
//! taken before they are squared, because ‖x‖² − 2x·y + ‖y‖² loses the small distances, which count most, in 32 bits. Cost: rows ×
//! inputs multiplications and as many exponentials as there are rows.

use dermis_inference::onnx::{GraphBuilder, Value};
use dermis_regress::{Kernel, KernelExpansion};

/// Operators of `expansion`; `input` is \[1, inputs\], what comes out \[1, outputs\]. `name` tells its constants from those of others.
pub(super) fn to_graph(
    expansion: &KernelExpansion,
    g: &mut GraphBuilder,
    input: &Value,
    name: &str,
) -> Value {
    let (width, outputs) = (expansion.standard.mean.len(), expansion.bias.len());
    let rows = expansion.supports.len() / width.max(1);
    let single = |values: &[f64]| values.iter().map(|v| *v as f32).collect::<Vec<f32>>();
    let bias = g.constant(&format!("{name}_bias"), &[1, outputs], &single(&expansion.bias));
    if rows == 0 {
        // Nothing supports it: the constant alone, in the shape of the input's batch.
        let first = g.slice(input, 1, 0, 1);
        let zero = g.constant(&format!("{name}_zero"), &[1, 1], &[0.0]);
        let nothing = g.mul(&first, &zero);
        return g.add(&nothing, &bias);
    }
    let inverse: Vec<f64> = expansion.standard.spread.iter().map(|s| 1.0 / s).collect();
    let mean = g.constant(&format!("{name}_mean"), &[1, width], &single(&expansion.standard.mean));
    let inverse = g.constant(&format!("{name}_inverse_spread"), &[1, width], &single(&inverse));
    let supports = g.constant(&format!("{name}_supports"), &[rows, width], &single(&expansion.supports));
    // γ in front of all, so that what is added up is the exponent.
    let gamma = g.constant(&format!("{name}_gamma"), &[1, 1], &[expansion.gamma as f32]);
    let centred = g.sub(input, &mean);
    let scaled = g.mul(&centred, &inverse);
    let apart = g.sub(&scaled, &supports);
    let squares = g.mul(&apart, &apart);
    let distances = g.reduce_sum(&squares, 1);
    let exponents = g.mul(&distances, &gamma);
    let near = match expansion.kernel {
        Kernel::Gaussian => {
            let negative = g.neg(&exponents);
            g.exp(&negative)
        }
        Kernel::Matern => {
            let six = g.constant(&format!("{name}_six"), &[1, 1], &[6.0]);
            let third = g.constant(&format!("{name}_third"), &[1, 1], &[1.0 / 3.0]);
            let one = g.constant(&format!("{name}_one"), &[1, 1], &[1.0]);
            let squared = g.mul(&exponents, &six);
            let s = g.sqrt(&squared);
            let quadratic = g.mul(&squared, &third);
            let sum = g.add(&s, &quadratic);
            let polynomial = g.add(&sum, &one);
            let negative = g.neg(&s);
            let fall = g.exp(&negative);
            g.mul(&polynomial, &fall)
        }
    };
    // [rows, 1] in a row, times [rows, outputs].
    let near = g.reshape(&near, &[1, rows]);
    let mut weights = vec![0.0_f32; rows * outputs];
    for (o, own) in expansion.weights.chunks_exact(rows).enumerate() {
        own.iter().enumerate().for_each(|(i, w)| weights[i * outputs + o] = *w as f32);
    }
    let weights = g.constant(&format!("{name}_weights"), &[rows, outputs], &weights);
    let sum = g.matmul(&near, &weights);
    g.add(&sum, &bias)
}

#[cfg(test)]
mod tests {
    use dermis_inference::{Interface, Model, Runtime, RuntimeChoice, RuntimeConfig};
    use dermis_regress::{GaussianSettings, Method, Rows, Settings, SvrSettings};

    use super::*;

    #[test]
    fn the_graph_answers_as_the_regression() {
        let inputs: Vec<f64> =
            (0..80).flat_map(|i| [f64::from(i % 9) * 0.3, f64::from(i / 9) * 20.0]).collect();
        let of = |x: &[f64]| [x[0].sin() + 0.01 * x[1], 3.0 - x[0] * 0.1 * x[1]];
        let targets: Vec<f64> = inputs.chunks_exact(2).flat_map(of).collect();
        let (x, t) = (Rows::new(&inputs, 2, "inputs").unwrap(), Rows::new(&targets, 2, "targets").unwrap());
        let config = RuntimeConfig { choice: RuntimeChoice::Embedded, library: None };
        let runtime = Runtime::load(&config).unwrap();
        let gaussian =
            |kernel| Settings::Gaussian(GaussianSettings { kernel, gamma: 0.5, noise: 1e-3, supports: None });
        let vectors = Settings::Vectors(SvrSettings { gamma: 1.0, ..SvrSettings::default() });
        for settings in [gaussian(Kernel::Gaussian), gaussian(Kernel::Matern), vectors] {
            let fitted = settings.fit(x, t).unwrap();
            let mut g = GraphBuilder::new("kernels");
            let input = g.input("input", &[1, 2]);
            let output = to_graph(fitted.expansion().unwrap(), &mut g, &input, "all");
            g.output("output", &output, &[1, 2]);
            let mut model = Model::load(runtime, &g.finish().unwrap(), &Interface::flat(2, 2)).unwrap();
            let mut got = Vec::new();
            for row in [[0.3, 20.0], [1.1, 77.0], [2.4, 160.0]] {
                model.run(&row.map(|v| v as f32), &mut got).unwrap();
                for (got, known) in got.iter().zip(fitted.predict(&row).unwrap()) {
                    // Weights of some hundred in 32 bits, of targets of some ten.
                    assert!((f64::from(*got) - known).abs() < 2e-2, "{settings:?}: {got} {known}");
                }
            }
        }
        // What has no arithmetic has no graph.
        for method in [Method::Trees, Method::Neighbours] {
            assert!(method.grid()[0].fit(x, t).unwrap().expansion().is_none());
        }
    }

    #[test]
    fn what_nothing_supports_is_a_constant() {
        let inputs = [0.0, 1.0, 2.0];
        let x = Rows::new(&inputs, 1, "inputs").unwrap();
        let flat = Rows::new(&[4.0; 3], 1, "targets").unwrap();
        let fitted = Settings::Vectors(SvrSettings::default()).fit(x, flat).unwrap();
        assert!(fitted.expansion().unwrap().supports.is_empty());
        let mut g = GraphBuilder::new("constant");
        let input = g.input("input", &[1, 1]);
        let output = to_graph(fitted.expansion().unwrap(), &mut g, &input, "all");
        g.output("output", &output, &[1, 1]);
        let config = RuntimeConfig { choice: RuntimeChoice::Embedded, library: None };
        let graph = g.finish().unwrap();
        let mut model = Model::load(Runtime::load(&config).unwrap(), &graph, &Interface::flat(1, 1)).unwrap();
        let mut got = Vec::new();
        model.run(&[0.7], &mut got).unwrap();
        assert!((got[0] - 4.0).abs() < 1e-6, "{got:?}");
    }
}
