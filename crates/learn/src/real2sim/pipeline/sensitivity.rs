//! Place and displacement of a peak → force, by a small network.
//!
//! A surface gives way more in one place than in another, so that the force of a contact follows from its displacement only where it
//! is known ("rigidness" in chapter 3 of the thesis). A dense network learns it from peaks of reconstructed maps whose forces are
//! known; its inputs are the place \[m\] and the displacement \[m\], each less its mean and in deviations.

use dermis_inference::onnx::{GraphBuilder, OnnxError};

use super::settings::SensitivityOutput;
use crate::LearnError;
use crate::train::{Batch, Mlp, NetworkConfig, States, TrainingConfig, fit_kept};

/// A peak, (x, y, z, displacement) \[m\], and the force \[N\] that presses there.
pub(super) type Peak = ([f32; 4], f32);

/// Place and displacement of a peak → force.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sensitivity {
    centre: [f32; 4],
    factor: [f32; 4],
    gives: SensitivityOutput,
    /// Mean of ln(force / displacement), which the network's output is added to; or the mean force, which it is multiplied by.
    level: f32,
    net: Mlp,
}

impl Sensitivity {
    /// A force that is its displacement.
    pub(super) fn unknown() -> Self {
        let net = Mlp::linear(4, 1, vec![0.0; 4]);
        Self { centre: [0.0; 4], factor: [0.0; 4], gives: SensitivityOutput::Ratio, level: 0.0, net }
    }

    pub(super) fn fit(
        peaks: &[Peak],
        gives: SensitivityOutput,
        (network, training): (&NetworkConfig, &TrainingConfig),
        states: Option<&States>,
    ) -> Result<Self, LearnError> {
        let count = peaks.len().max(1) as f32;
        let (mut centre, mut factor) = ([0.0; 4], [1.0; 4]);
        for i in 0..4 {
            centre[i] = peaks.iter().map(|(x, _)| x[i]).sum::<f32>() / count;
            let square = peaks.iter().map(|(x, _)| (x[i] - centre[i]).powi(2)).sum::<f32>() / count;
            // A coordinate that does not vary, as z of a flat skin, says nothing.
            factor[i] = if square.sqrt() > 1e-7 { 1.0 / square.sqrt() } else { 0.0 };
        }
        let target = |(x, force): &Peak| match gives {
            SensitivityOutput::Ratio => (force / x[3]).ln(),
            SensitivityOutput::Force => *force,
        };
        let level = peaks.iter().map(target).sum::<f32>() / count;
        let mut data = Batch { width: 4, outputs: 1, ..Batch::default() };
        for peak in peaks {
            data.inputs.extend((0..4).map(|i| (peak.0[i] - centre[i]) * factor[i]));
            data.targets.push(match gives {
                SensitivityOutput::Ratio => target(peak) - level,
                SensitivityOutput::Force => target(peak) / level,
            });
        }
        let keep = states.map(|s| (s, "sensitivity"));
        Ok(Self { centre, factor, gives, level, net: fit_kept(&data, network, training, keep, &mut |_| ())? })
    }

    /// Widths of all its layers.
    pub(super) fn layers(&self) -> &[usize] {
        self.net.layers()
    }

    pub(super) fn to_onnx(&self) -> Result<Vec<u8>, OnnxError> {
        let mut g = GraphBuilder::new("sensitivity");
        let input = g.input("input", &[1, 4]);
        let centre = g.constant("centre", &[1, 4], &self.centre);
        let factor = g.constant("factor", &[1, 4], &self.factor);
        let centred = g.sub(&input, &centre);
        let x = g.mul(&centred, &factor);
        let force = match self.gives {
            SensitivityOutput::Force => self.net.to_graph(&mut g, &x, "sensitivity", self.level),
            SensitivityOutput::Ratio => {
                let level = g.constant("level", &[1, 1], &[self.level]);
                let logarithm = self.net.to_graph(&mut g, &x, "sensitivity", 1.0);
                let logarithm = g.add(&logarithm, &level);
                let rigidity = g.exp(&logarithm);
                let displacement = g.slice(&input, 1, 3, 4);
                g.mul(&displacement, &rigidity)
            }
        };
        g.output("output", &force, &[1, 1]);
        g.finish()
    }
}

#[cfg(test)]
mod tests {
    use dermis_inference::{Model, PeakSection, Runtime, RuntimeChoice, RuntimeConfig};

    use super::*;

    /// Forces in proportion to the displacement, on a surface that is softer towards one end.
    fn peaks() -> Vec<Peak> {
        let at = |i: u32| {
            let (x, displacement) = (0.01 * (i % 7) as f32, 1e-4 * (1 + i % 5) as f32);
            ([x, 0.0, 0.0, displacement], displacement * 1e5 * (1.0 - 5.0 * x))
        };
        (0..70).map(at).collect()
    }

    #[test]
    fn both_outputs_learn_the_force_and_their_graphs_give_it() {
        let config = RuntimeConfig { choice: RuntimeChoice::Embedded, library: None };
        let runtime = Runtime::load(&config).unwrap();
        let network = NetworkConfig { hidden: vec![24], ..NetworkConfig::default() };
        let training =
            TrainingConfig { epochs: 300, batch: 10, learning_rate: 1e-2, ..TrainingConfig::default() };
        for gives in [SensitivityOutput::Ratio, SensitivityOutput::Force] {
            let learned = Sensitivity::fit(&peaks(), gives, (&network, &training), None).unwrap();
            assert_eq!(learned.layers(), [4, 24, 1]);
            let mut model =
                Model::load(runtime, &learned.to_onnx().unwrap(), &PeakSection::interface()).unwrap();
            let mut out = Vec::new();
            for (input, force) in peaks() {
                model.run(&input, &mut out).unwrap();
                // Forces are 7 to 50 N.
                assert!((out[0] - force).abs() < 3.0, "{gives:?}: {} for {force}", out[0]);
            }
        }
    }
}
