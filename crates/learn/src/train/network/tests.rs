use dermis_inference::{FeatureConfig, Interface, Model, Runtime, RuntimeChoice, RuntimeConfig};

use super::super::config::InputForm;
use super::*;

fn embedded() -> &'static Runtime {
    Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Embedded, library: None }).unwrap()
}

fn small(activation: Activation) -> NetworkConfig {
    NetworkConfig { hidden: vec![5, 4], activation, ..Default::default() }
}

fn noise(seed: u64, n: usize) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| rng.sample(StandardNormal)).collect()
}

#[test]
fn a_linear_function_is_learned() {
    let inputs = noise(1, 200 * 3);
    let targets: Vec<f32> = inputs.chunks(3).flat_map(|x| [2.0 * x[0] - x[1], 0.5 * x[2] + 1.0]).collect();
    let data =
        Batch { inputs: inputs.clone(), targets: targets.clone(), width: 3, outputs: 2, ..Batch::default() };
    let linear = NetworkConfig { hidden: vec![], ..NetworkConfig::default() };
    let training = TrainingConfig { epochs: 120, batch: 20, learning_rate: 0.05, ..Default::default() };
    let network = fit(&data, &linear, &training, 0).unwrap();
    for (got, expected) in network.predict(&inputs).iter().zip(&targets) {
        assert!((got - expected).abs() < 1e-2, "{got} {expected}");
    }
}

#[test]
fn gradients_are_those_of_finite_differences() {
    let (n, width, outputs) = (4, 3, 2);
    let inputs = noise(2, n * width);
    let targets = [0.3, 1.0, f32::NAN, 0.0, -0.2, 1.0, 0.1, f32::NAN];
    let weights = [1.0, 0.5, 1.0, 1.0, 0.3, 1.0, 2.0, 1.0];
    for (activation, logit) in
        [(Activation::Silu, true), (Activation::Tanh, false), (Activation::Relu, false)]
    {
        let mut network = Mlp::new(width, outputs, &small(activation), 3);
        let mut layers = Layers::default();
        // Once before with other rows: what is left of them does not count.
        network.gradient(&inputs[width..], (&targets[outputs..], &weights[outputs..]), logit, &mut layers);
        network.gradient(&inputs, (&targets, &weights), logit, &mut layers);
        for (i, gradient) in layers.gradients.iter().enumerate() {
            for (k, slope) in gradient.iter().enumerate() {
                let mut shifted = |by: f32| {
                    network.parameters[i][k] += by;
                    let loss = network.gradient(&inputs, (&targets, &weights), logit, &mut Layers::default());
                    network.parameters[i][k] -= by;
                    loss
                };
                let finite = (shifted(5e-3) - shifted(-5e-3)) / 1e-2;
                assert!((finite - slope).abs() < 2e-3, "{activation:?} {i} {k}: {finite} {slope}");
            }
        }
    }
}

#[test]
fn the_graph_equals_the_mean_of_the_networks() {
    let mut features = FeatureConfig::newest(vec![3.0, -2.0, 0.5], vec![2.0, 4.0, 1.0]);
    features.low_pass = vec![1.0];
    let inputs = noise(4, 6 * 20);
    for form in [InputForm::Plain, InputForm::Direction, InputForm::Ratios, InputForm::Logarithm] {
        let preparation = Preparation::measure(form, &features, &[0.5, 0.5, 0.5], &inputs);
        let prepared = preparation.apply(&inputs);
        for activation in [Activation::Silu, Activation::Tanh, Activation::Relu] {
            let members: Vec<Mlp> =
                (0..3).map(|s| Mlp::new(preparation.columns(), 2, &small(activation), s)).collect();
            let graph = Mlp::to_onnx(&members, &preparation, "mean").unwrap();
            let mut model = Model::load(embedded(), &graph, &Interface::flat(6, 2)).unwrap();
            let mut got = Vec::new();
            model.run_batch(&inputs, &mut got).unwrap();
            let each: Vec<Vec<f32>> = members.iter().map(|m| m.predict(&prepared)).collect();
            for (i, got) in got.iter().enumerate() {
                let mean = each.iter().map(|e| e[i]).sum::<f32>() / 3.0;
                assert!((got - mean).abs() < 1e-5, "{form:?} {activation:?}: {got} {mean}");
            }
        }
    }
}

#[test]
fn a_logit_learns_a_probability() {
    let inputs = noise(5, 400);
    let targets = inputs.iter().map(|x| if *x > 0.3 { 1.0 } else { 0.0 }).collect();
    let data = Batch { inputs, targets, width: 1, outputs: 1, logit: true, ..Batch::default() };
    let training = TrainingConfig { epochs: 60, batch: 50, learning_rate: 0.02, ..Default::default() };
    let network = fit(&data, &small(Activation::Silu), &training, 0).unwrap();
    let answer = network.predict(&[-0.5, 0.0, 0.6, 1.5]);
    assert!(answer[0] < -1.0 && answer[1] < 0.0 && answer[2] > 0.0 && answer[3] > 1.0, "{answer:?}");
}
