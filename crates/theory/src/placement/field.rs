//! What every candidate reads for presses all over a skin.

use dermis_model::{Differences, ForwardModel, Indentation, Stimulus, Unknowns, Untouched};
use nalgebra::{DMatrix, Point3, Vector3};

use super::Watch;
use crate::TheoryError;
use crate::surface::positive;

/// A place that is pressed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Location {
    /// \[m\] on the surface.
    pub point: Point3<f64>,
    /// Out of the surface there.
    pub normal: Vector3<f64>,
}

/// Readings of candidates, free of noise and with the untouched ones subtracted, for presses along the normal: every place with every force, force by force within a
/// place. Press `p` is at place `p / forces.len()`.
#[derive(Debug, Clone)]
pub struct Field {
    /// Where it is pressed.
    pub locations: Vec<Location>,
    /// \[N\] pressing.
    pub forces: Vec<f64>,
    /// \[m\] diameter of the tip.
    pub diameter: f64,
    /// Standard deviation of each candidate's noise, in the unit of the skin.
    pub noise: Vec<f64>,
    /// Presses × candidates, in the unit of the skin.
    pub readings: DMatrix<f64>,
    /// By both directions along the surface \[unit/m\] and by the pressing force \[unit/N\], as `readings`.
    pub slopes: [DMatrix<f64>; 3],
}

impl Field {
    /// Asks a model whose channels are the candidates. `None` where `watch` stopped it.
    ///
    /// # Errors
    ///
    /// [`TheoryError::Model`] where the model has no answer for a press, [`TheoryError::Noise`] where a channel has no noise,
    /// [`TheoryError::NotPositive`] for a force or a diameter that is not.
    pub fn of_model(
        model: &dyn ForwardModel,
        locations: &[Location],
        forces: &[f64],
        diameter: f64,
        watch: Watch<'_>,
    ) -> Result<Option<Self>, TheoryError> {
        positive("diameter of the tip [m]", diameter)?;
        forces.iter().try_for_each(|f| positive("force [N]", *f).map(drop))?;
        let noise = model.noise().to_vec();
        if let Some((channel, &noise)) = noise.iter().enumerate().find(|(_, n)| !(n.is_finite() && **n > 0.0))
        {
            return Err(TheoryError::Noise { channel, noise });
        }
        let (channels, presses) = (model.channels(), locations.len() * forces.len());
        let mut readings = DMatrix::zeros(presses, channels);
        let mut slopes = std::array::from_fn(|_| DMatrix::zeros(presses, channels));
        let untouched = Untouched::of(model)?;
        let mut read = vec![0.0; channels];
        let mut jacobian = vec![0.0; channels * Unknowns::Normal.count()];
        let mut stimulus = Stimulus::default();
        for (at, location) in locations.iter().enumerate() {
            if !watch(at as f64 / locations.len() as f64) {
                return Ok(None);
            }
            for (n, &force) in forces.iter().enumerate() {
                let row = at * forces.len() + n;
                let contact = Indentation::sphere(location.point, -location.normal * force, diameter);
                stimulus.contacts = vec![contact];
                model.response(&stimulus, &mut read)?;
                untouched.subtract(&mut read);
                readings.row_mut(row).iter_mut().zip(&read).for_each(|(to, from)| *to = *from);
                model.jacobian(&stimulus, Unknowns::Normal, &Differences::default(), &mut jacobian)?;
                for (slope, column) in slopes.iter_mut().zip(jacobian.chunks_exact(channels.max(1))) {
                    let slope: &mut DMatrix<f64> = slope;
                    slope.row_mut(row).iter_mut().zip(column).for_each(|(to, from)| *to = *from);
                }
            }
        }
        let (locations, forces) = (locations.to_vec(), forces.to_vec());
        Ok(Some(Self { locations, forces, diameter, noise, readings, slopes }))
    }

    /// Number of candidates.
    #[must_use]
    pub fn candidates(&self) -> usize {
        self.noise.len()
    }

    /// Number of presses.
    #[must_use]
    pub fn presses(&self) -> usize {
        self.readings.nrows()
    }

    /// Place of a press.
    #[must_use]
    pub fn location_of(&self, press: usize) -> &Location {
        &self.locations[press / self.forces.len()]
    }

    /// The same for some of the locations.
    #[must_use]
    pub fn at(&self, locations: &[usize]) -> Self {
        let count = self.forces.len();
        let rows: Vec<usize> = locations.iter().flat_map(|p| p * count..(p + 1) * count).collect();
        Self {
            locations: locations.iter().map(|p| self.locations[*p]).collect(),
            forces: self.forces.clone(),
            diameter: self.diameter,
            noise: self.noise.clone(),
            readings: self.readings.select_rows(&rows),
            slopes: std::array::from_fn(|k| self.slopes[k].select_rows(&rows)),
        }
    }

    /// Mean of each candidate's readings, and their standard deviation; 0 for one that always reads the same.
    #[must_use]
    pub fn spreads(&self) -> Vec<(f64, f64)> {
        self.readings
            .column_iter()
            .map(|column| {
                let mean = column.mean();
                let spread = (column.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
                    / column.len().max(1) as f64)
                    .sqrt();
                (mean, if spread > 1e-12 * mean.abs() { spread } else { 0.0 })
            })
            .collect()
    }

    /// Standardised readings, presses × candidates; 0 for a candidate that always reads the same.
    pub(super) fn standardised(&self) -> DMatrix<f64> {
        let mut out = self.readings.clone();
        for (mut column, (mean, spread)) in out.column_iter_mut().zip(self.spreads()) {
            let by = if spread > 0.0 { 1.0 / spread } else { 0.0 };
            column.iter_mut().for_each(|v| *v = (*v - mean) * by);
        }
        out
    }
}
