//! Regressions from readings to one contact, learned from recordings: what a model is measured beside.
//!
//! | regression | method |
//! |---|---|
//! | nearest neighbours | mean of the nearest rows' contacts, weighted by the inverse of their distance |
//! | support vectors | ε-insensitive support vector regression |
//! | extra trees | extremely randomised trees |
//! | Gaussian process | posterior mean; of more than 8,000 readings by a sum over 2,500 of them, fitted to all (subset of regressors) |
//! | feed-forward network | three layers of 256 |
//!
//! All take what our networks take: the direction of the readings in deviations of their noise, and the logarithm of their length.
//! Where a contact is shows in the one, how hard it presses in the other; raw readings, whose sizes go over three decades, would
//! make the comparison too easy. Place and force are fitted apart, each with the settings of the least error over locations that
//! were not learned from ([`dermis_regress::Method::tuned`]), within what may be learned from.
//!
//! Cost: support vectors take the square of the rows and more, hence [`Most`]; a Gaussian process of n rows n³/3 multiplications
//! and 8n² bytes up to [`dermis_regress::EXACT`] rows, beyond them n times the square of [`dermis_regress::SUPPORTS`], a minute for
//! 30,000 and 200 MB beside the rows.

use anyhow::{Result, bail};
use dermis_estimate::finder::RegressionFinder;
use dermis_learn::Recorded;
use dermis_learn::train::{Batch, NetworkConfig, TrainingConfig, fit};
use dermis_regress::{Fitted, Method, Rows, Tuning};
use dermis_skin::{ForceComponents, SkinDescription};
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};

/// Rows that are learned from at most: of more, every n-th is taken.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Most {
    /// By neighbours, trees, Gaussian processes and the network.
    pub(crate) all: usize,
    /// By support vectors, whose cost grows with the square and faster.
    pub(crate) vectors: usize,
}

impl Most {
    fn of(self, method: Method) -> usize {
        match method {
            Method::Neighbours | Method::Trees | Method::Gaussian => self.all,
            Method::Vectors => self.vectors,
        }
    }
}

/// Rows that trees and neighbours choose their settings with, which depend on how dense the rows are.
const DENSE: usize = 4000;

/// Single contacts and what the channels read of them.
pub(crate) struct Learned {
    /// Direction and logarithm of the length, row by row.
    inputs: Vec<f64>,
    width: usize,
    positions: Vec<f64>,
    forces: Vec<f64>,
    /// Numbers of a force: the pressing one, or x, y and z.
    components: usize,
    locations: Vec<usize>,
}

impl Learned {
    /// Nothing yet; with `Full`, all of the force is learned.
    pub(crate) fn new(skin: &SkinDescription, components: ForceComponents) -> Self {
        Self {
            inputs: Vec::new(),
            width: skin.channels().len() + 1,
            positions: Vec::new(),
            forces: Vec::new(),
            components: if components == ForceComponents::Full { 3 } else { 1 },
            locations: Vec::new(),
        }
    }

    /// Of recorded presses, whose force is along the normal.
    pub(crate) fn of(skin: &SkinDescription, recorded: &[Recorded]) -> Self {
        let mut learned = Self::new(skin, ForceComponents::Normal);
        let noise = skin.channel_noise();
        for press in recorded {
            let row: Vec<f64> = press.signal.iter().zip(&noise).map(|(v, n)| f64::from(*v) / n).collect();
            let force = press.contact.force;
            learned.push(&row, press.contact.position, &force, force.norm(), press.location);
        }
        learned
    }

    /// One more reading, in deviations of the noise.
    pub(crate) fn push(
        &mut self,
        whitened: &[f64],
        position: Point3<f64>,
        force: &Vector3<f64>,
        pressing: f64,
        location: u32,
    ) {
        self.inputs.extend(direction(whitened));
        self.positions.extend(position.iter());
        match self.components {
            1 => self.forces.push(pressing),
            _ => self.forces.extend(force.iter()),
        }
        self.locations.push(location as usize);
    }

    /// Readings.
    pub(crate) fn len(&self) -> usize {
        self.locations.len()
    }

    /// Every n-th row, so that there are `most` at most.
    fn thinned(&self, most: usize) -> Self {
        let step = dermis_regress::stride(self.len(), most);
        let of = |values: &[f64], width: usize| -> Vec<f64> {
            values.chunks_exact(width).step_by(step).flatten().copied().collect()
        };
        Self {
            inputs: of(&self.inputs, self.width),
            positions: of(&self.positions, 3),
            forces: of(&self.forces, self.components),
            locations: self.locations.iter().copied().step_by(step).collect(),
            ..*self
        }
    }
}

/// A regression with settings chosen over locations, and these settings; it answers with place and force.
pub(crate) fn tuned(
    method: Method,
    skin: &SkinDescription,
    learned: &Learned,
    most: Most,
) -> Result<(RegressionFinder, Value)> {
    if learned.len() == 0 {
        bail!("there is no single contact of known place and force to learn from");
    }
    let some = learned.thinned(most.of(method));
    let tuning = match method {
        Method::Neighbours | Method::Trees => Tuning { most: DENSE, ..Tuning::default() },
        Method::Vectors | Method::Gaussian => Tuning::default(),
    };
    let inputs = Rows::new(&some.inputs, some.width, "readings")?;
    let fitted = |targets: Rows<'_>| -> Result<(Fitted, Value)> {
        let (settings, error) = method.tuned(inputs, targets, &some.locations, &tuning)?;
        let fitted = settings.fit(inputs, targets)?;
        let mut found = json!({ "settings": settings, "error": error });
        if let Some(kernels) = fitted.expansion() {
            found["supports"] = json!(kernels.supports.len() / some.width);
        }
        Ok((fitted, found))
    };
    // Metres and newtons are scaled for themselves: outputs of one fit share a scale.
    let (place, of_place) = fitted(Rows::new(&some.positions, 3, "locations")?)?;
    let (force, of_force) = fitted(Rows::new(&some.forces, some.components, "forces")?)?;
    let settings = json!({ "learned": some.len(), "position": of_place, "force": of_force });
    let regress = move |row: &[f64]| {
        let row = direction(row);
        let mut answer = place.predict(&row).map_err(|e| format!("failed: {e}"))?;
        answer.extend(force.predict(&row).map_err(|e| format!("failed: {e}"))?);
        Ok(answer)
    };
    Ok((RegressionFinder::new(skin, Box::new(regress)), settings))
}

/// A feed-forward network.
pub(crate) fn network(
    skin: &SkinDescription,
    learned: &Learned,
    most: usize,
) -> Result<(RegressionFinder, Value)> {
    let learned = learned.thinned(most);
    let largest = |values: &[f64]| values.iter().fold(1e-9_f64, |m, v| m.max(v.abs())) as f32;
    let scales = [largest(&learned.positions), largest(&learned.forces)];
    let targets = learned.positions.chunks_exact(3).zip(learned.forces.chunks_exact(learned.components));
    let data = Batch {
        inputs: learned.inputs.iter().map(|v| *v as f32).collect(),
        targets: targets
            .flat_map(|(place, force)| {
                place.iter().map(|v| *v as f32 / scales[0]).chain(force.iter().map(|v| *v as f32 / scales[1]))
            })
            .collect(),
        width: learned.width,
        outputs: 3 + learned.components,
        ..Batch::default()
    };
    let network = NetworkConfig { hidden: vec![256, 256, 256], ..NetworkConfig::default() };
    let training = TrainingConfig { epochs: 60, learning_rate: 1e-3, ..TrainingConfig::default() };
    let net = fit(&data, &network, &training, 0)?;
    let regress = move |row: &[f64]| {
        let row: Vec<f32> = direction(row).iter().map(|v| *v as f32).collect();
        let answer = net.predict(&row);
        Ok(answer.iter().enumerate().map(|(i, v)| f64::from(v * scales[usize::from(i >= 3)])).collect())
    };
    Ok((RegressionFinder::new(skin, Box::new(regress)), json!({ "learned": learned.len() })))
}

/// A row of readings in deviations of their noise as its direction, and the logarithm of its length: where a contact is shows in
/// the one, how hard in the other. One deviation a channel is added to the length, so that noise alone has none.
fn direction(row: &[f64]) -> Vec<f64> {
    let width = row.len() as f64;
    let length = (row.iter().map(|v| v * v).sum::<f64>() + width).sqrt();
    // About 1, as the other inputs are of a unit vector of some ten.
    row.iter().map(|v| v / length * width.sqrt()).chain([length.ln() - 4.0]).collect()
}

#[cfg(test)]
mod tests {
    use dermis_estimate::{ConditionedFrame, ContactFinder};
    use dermis_fixtures::SkinFile;

    use super::*;

    /// Readings of a press: they fall off with the distance, and grow with the force.
    fn read(x: f64, force: f64) -> [f64; 2] {
        [-1.0, 1.0]
            .map(|side| 500.0 * force * (-(x - side * 0.005).powi(2) / (2.0 * 0.006_f64.powi(2))).exp())
    }

    #[test]
    fn every_regression_finds_a_press_between_those_it_learned_from() {
        let skin = SkinFile::new("pad").set("noise", "2.0").read();
        let mut learned = Learned::new(&skin, ForceComponents::Full);
        for i in 0..21_u32 {
            for force in [0.5, 1.0, 1.5, 2.0] {
                let x = (f64::from(i) - 10.0) * 5e-4;
                let row = read(x, force).map(|v| v / 2.0);
                learned.push(&row, Point3::new(x, 0.0, 0.0), &Vector3::new(0.1, 0.0, -force), force, i);
            }
        }
        let signal = read(0.0013, 1.2).map(|v| v as f32);
        let frame = |signal| ConditionedFrame {
            stamp: 0,
            reading: signal,
            signal,
            flags: &[],
            image: &[],
            image_signal: &[],
        };
        let most = Most { all: 300, vectors: 300 };
        for method in Method::ALL {
            let (mut finder, settings) = tuned(method, &skin, &learned, most).unwrap();
            let found = finder.find(&frame(&signal)).unwrap().remove(0);
            // Presses lie 0.5 mm and half a newton apart.
            assert!((found.position.x - 0.0013).abs() < 8e-4, "{method:?}: {} {settings}", found.position);
            assert!((found.force.z + 1.2).abs() < 0.4, "{method:?}: {} {settings}", found.force);
            assert_eq!(found.force_components, ForceComponents::Full);
            assert_eq!(settings["learned"], 84);
            let supports = settings["position"]["supports"].as_u64();
            assert_eq!(
                supports.is_some(),
                matches!(method, Method::Vectors | Method::Gaussian),
                "{settings}"
            );
            assert!(method != Method::Gaussian || supports == Some(84), "{settings}");
        }
        let none = Learned::new(&skin, ForceComponents::Full);
        assert!(tuned(Method::Vectors, &skin, &none, most).is_err());
    }

    #[test]
    fn inputs_are_the_direction_and_the_length() {
        let (weak, strong) = (direction(&[30.0, 40.0]), direction(&[300.0, 400.0]));
        assert!((weak[0] / weak[1] - 0.75).abs() < 1e-12);
        // 50 deviations long, but for the one a channel that noise has.
        assert!((weak[2] - (2502.0_f64.sqrt().ln() - 4.0)).abs() < 1e-12);
        assert!((strong[0] - 0.6 * 2.0_f64.sqrt()).abs() < 1e-4);
        assert!((strong[2] - weak[2] - 10.0_f64.ln()).abs() < 1e-3);
        assert!(direction(&[0.0, 0.0]).iter().all(|v| v.is_finite()));
    }
}
