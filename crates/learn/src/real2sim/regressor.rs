//! From virtual sensors to the amplitudes of a map: a straight line, neighbours, a network.

use dermis_regress::{Neighbours, Rows};
use nalgebra::DMatrix;

use crate::LearnError;
use crate::train::{Batch, Mlp, NetworkConfig, Progress, States, TrainingConfig, fit_kept};

/// Something that gives amplitudes for rows of inputs.
pub trait MapRegressor {
    /// Amplitudes of rows that lie end to end.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] for rows of another width.
    fn predict(&self, inputs: &[f32]) -> Result<Vec<f32>, LearnError>;
}

/// Least squares with a ridge, through 0: an untouched skin has a map of 0.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearMap {
    net: Mlp,
    ridge: f64,
}

impl LinearMap {
    /// Ridges that are tried, relative to the mean square of the inputs.
    const RIDGES: [f64; 8] = [1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2];

    /// Fits rows of `width` inputs; the ridge is the one that errs least on `validation` (inputs, targets).
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where there is nothing to fit.
    pub fn fit(
        inputs: &[f32],
        targets: &[f32],
        width: usize,
        validation: (&[f32], &[f32]),
    ) -> Result<Self, LearnError> {
        let nothing = || LearnError::Training { reason: "a linear fit has no samples".into() };
        let count = inputs.len().checked_div(width).filter(|n| *n > 0).ok_or_else(nothing)?;
        let outputs = targets.len() / count;
        let (mut gram, mut sums) = (DMatrix::zeros(width, width), DMatrix::zeros(width, outputs));
        for (x, y) in inputs.chunks(width * 1024).zip(targets.chunks(outputs * 1024)) {
            let rows = x.len() / width;
            let x = DMatrix::from_fn(rows, width, |i, j| f64::from(x[i * width + j]));
            let y = DMatrix::from_fn(rows, outputs, |i, j| f64::from(y[i * outputs + j]));
            gram += x.tr_mul(&x);
            sums += x.tr_mul(&y);
        }
        let scale = gram.diagonal().mean().max(f64::MIN_POSITIVE);
        let mut best: Option<(f64, Self)> = None;
        for ridge in Self::RIDGES {
            let mut damped = gram.clone();
            for i in 0..width {
                damped[(i, i)] += ridge * scale;
            }
            let Some(factor) = damped.cholesky() else { continue };
            let solved = factor.solve(&sums);
            let weight: Vec<f32> =
                (0..width * outputs).map(|k| solved[(k / outputs, k % outputs)] as f32).collect();
            let fitted = Self { net: Mlp::linear(width, outputs, weight), ridge };
            let error: f64 = fitted
                .net
                .predict(validation.0)
                .iter()
                .zip(validation.1)
                .map(|(a, b)| f64::from(a - b).powi(2))
                .sum();
            if best.as_ref().is_none_or(|(least, _)| error < *least) {
                best = Some((error, fitted));
            }
        }
        best.map(|(_, fitted)| fitted).ok_or_else(nothing)
    }

    /// The ridge that was chosen.
    #[must_use]
    pub fn ridge(&self) -> f64 {
        self.ridge
    }

    /// The same as a network of one layer.
    #[must_use]
    pub fn network(&self) -> &Mlp {
        &self.net
    }
}

impl MapRegressor for LinearMap {
    fn predict(&self, inputs: &[f32]) -> Result<Vec<f32>, LearnError> {
        Ok(self.net.predict(inputs))
    }
}

/// Nearest neighbours, weighted by the inverse of their distance.
#[derive(Debug, Clone)]
pub struct NearestMaps {
    neighbours: Neighbours,
    width: usize,
}

impl NearestMaps {
    /// Keeps rows of `width` inputs; `count` of them answer.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where there is nothing to keep.
    pub fn fit(inputs: &[f32], targets: &[f32], width: usize, count: usize) -> Result<Self, LearnError> {
        let wrong = |e: dermis_regress::RegressError| LearnError::Training { reason: e.to_string() };
        let rows = inputs.len() / width.max(1);
        let wide = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
        let (inputs, outputs) = (wide(inputs), targets.len() / rows.max(1));
        let targets = wide(targets);
        let inputs = Rows::new(&inputs, width, "inputs").map_err(wrong)?;
        let targets = Rows::new(&targets, outputs, "targets").map_err(wrong)?;
        Ok(Self { neighbours: Neighbours::fit(inputs, targets, count).map_err(wrong)?, width })
    }
}

impl MapRegressor for NearestMaps {
    fn predict(&self, inputs: &[f32]) -> Result<Vec<f32>, LearnError> {
        let mut all = Vec::new();
        for row in inputs.chunks_exact(self.width) {
            let row: Vec<f64> = row.iter().map(|v| f64::from(*v)).collect();
            let found =
                self.neighbours.predict(&row).map_err(|e| LearnError::Training { reason: e.to_string() })?;
            all.extend(found.iter().map(|v| *v as f32));
        }
        Ok(all)
    }
}

/// A network, with inputs and outputs divided by a number each, so that what goes in and comes out is about 1.
#[derive(Debug, Clone, PartialEq)]
pub struct NetMap {
    /// Divides inputs.
    pub(super) input: f32,
    /// Multiplies outputs.
    pub(super) output: f32,
    pub(super) net: Mlp,
}

/// Root mean square; 1 of nothing.
pub(super) fn scale(values: &[f32]) -> f32 {
    let square = values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / values.len().max(1) as f64;
    if square > 0.0 { square.sqrt() as f32 } else { 1.0 }
}

impl NetMap {
    /// Fits rows of `width` inputs.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where there is nothing to fit, or the loss stops being a number.
    pub fn fit(
        inputs: &[f32],
        targets: &[f32],
        width: usize,
        network: &NetworkConfig,
        training: &TrainingConfig,
    ) -> Result<Self, LearnError> {
        Self::fit_kept((inputs, targets), width, (network, training), None, &mut |_| ())
    }

    /// The same, with its state kept under a name where `keep` says so ([`fit_kept`]); `progress` is called after every epoch.
    ///
    /// # Errors
    ///
    /// As [`fit`](Self::fit), and where a state cannot be written.
    pub fn fit_kept(
        (inputs, targets): (&[f32], &[f32]),
        width: usize,
        (network, training): (&NetworkConfig, &TrainingConfig),
        keep: Option<(&States, &str)>,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Self, LearnError> {
        let rows = inputs.len() / width.max(1);
        let (input, output) = (scale(inputs), scale(targets));
        let data = Batch {
            inputs: inputs.iter().map(|v| v / input).collect(),
            targets: targets.iter().map(|v| v / output).collect(),
            width,
            outputs: targets.len() / rows.max(1),
            ..Batch::default()
        };
        Ok(Self { input, output, net: fit_kept(&data, network, training, keep, progress)? })
    }

    /// The network: its inputs and outputs are divided by a number each.
    #[must_use]
    pub fn network(&self) -> &Mlp {
        &self.net
    }
}

impl MapRegressor for NetMap {
    fn predict(&self, inputs: &[f32]) -> Result<Vec<f32>, LearnError> {
        let mut all = Vec::new();
        // In parts, so that the hidden layers of many rows are not in memory at once.
        let scaled: Vec<f32> = inputs.iter().map(|v| v / self.input).collect();
        for rows in scaled.chunks(self.net.inputs() * 1024) {
            all.extend(self.net.predict(rows).into_iter().map(|v| v * self.output));
        }
        Ok(all)
    }
}
