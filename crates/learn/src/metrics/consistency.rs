//! Whether what an estimator states of its own errors is true.
//!
//! Problem: planners and the fusion weigh a contact by its covariance, so that one which is too small is as wrong as the contact. Method:
//! the normalised estimation error squared (NEES), ε = eᵀ C⁻¹ e, is on average the number of its degrees of freedom where errors are as stated, and
//! 95 % of Gaussian ones lie within the quantile of χ² (Y. Bar-Shalom, X. R. Li and T. Kirubarajan, *Estimation with Applications to
//! Tracking and Navigation*, 2001, §5.4). Beside it stand the root mean squares of the error and of the stated deviation √tr C: a few large
//! errors rule the first and hardly show in the share inside. Assumption: a direction in which C has no extent, as across a surface, has no
//! error; it is left out. Cost: an eigendecomposition of 3×3 a contact.

use std::fmt;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{ContactError, bin_in};

/// Share of the largest variance below which a direction has none.
const NO_EXTENT: f64 = 1e-9;
/// The 95 % quantiles of χ² with one, two and three degrees of freedom.
const QUANTILES: [f64; 3] = [3.841, 5.991, 7.815];

/// The error of one position beside the covariance that the estimator states of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stated {
    /// \[m\] √tr C, of the directions in which C has an extent.
    pub deviation: f64,
    /// ε \[1\].
    pub square: f64,
    /// Degrees of freedom: directions in which C has an extent.
    pub freedom: usize,
}

impl Stated {
    /// `None` where no covariance is stated, or none that is one.
    pub(super) fn of(covariance: &Matrix3<f64>, error: &Vector3<f64>) -> Option<Self> {
        if !covariance.iter().chain(error).all(|v| v.is_finite()) {
            return None;
        }
        let eigen = covariance.symmetric_eigen();
        let least = eigen.eigenvalues.max() * NO_EXTENT;
        let along = eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter());
        let stated: Vec<(f64, f64)> = along
            .filter(|(variance, _)| **variance > least)
            .map(|(&variance, axis)| (variance, axis.dot(error).powi(2) / variance))
            .collect();
        (!stated.is_empty()).then(|| Self {
            deviation: stated.iter().map(|(variance, _)| variance).sum::<f64>().sqrt(),
            square: stated.iter().map(|(_, square)| square).sum(),
            freedom: stated.len(),
        })
    }

    fn is_inside(&self) -> bool {
        self.square <= QUANTILES[self.freedom - 1]
    }
}

/// Errors of positions that were found beside what is stated of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Consistency {
    /// Contacts of which a covariance is stated.
    pub samples: usize,
    /// Share of the contacts that were found of which none is.
    pub not_stated: f64,
    /// \[m\] root mean square of the distance.
    pub error_rms: f64,
    /// \[m\] root mean square of what is stated.
    pub stated_rms: f64,
    /// Mean of the NEES over its degrees of freedom; 1 where errors are as stated.
    pub nees: f64,
    /// Share within the stated 95 % ellipsoid.
    pub inside_95: f64,
}

/// The same in one bin of force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ConsistencyBin {
    /// \[N\] lower end.
    pub from: f64,
    /// \[N\] upper end, absent for the last bin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<f64>,
    /// The same as one number each.
    #[serde(flatten)]
    pub consistency: Consistency,
}

/// Over all forces, and by true normal force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Consistencies {
    /// Over all forces.
    pub all: Consistency,
    /// By true normal force.
    pub by_force: Vec<ConsistencyBin>,
}

impl Consistency {
    fn of<'a>(errors: impl Iterator<Item = &'a ContactError>) -> Option<Self> {
        let found: Vec<&ContactError> = errors.filter(|e| e.found && e.position.is_finite()).collect();
        let all: Vec<(f64, Stated)> = found.iter().filter_map(|e| Some((e.position, e.stated?))).collect();
        let mean = |of: fn(&(f64, Stated)) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
        (!all.is_empty()).then(|| Self {
            samples: all.len(),
            not_stated: 1.0 - all.len() as f64 / found.len() as f64,
            error_rms: mean(|(error, _)| error * error).sqrt(),
            stated_rms: mean(|(_, stated)| stated.deviation.powi(2)).sqrt(),
            nees: mean(|(_, stated)| stated.square / stated.freedom as f64),
            inside_95: mean(|(_, stated)| f64::from(u8::from(stated.is_inside()))),
        })
    }
}

impl Consistencies {
    /// `None` where the estimator states no covariance of any position; by force in bins of these edges \[N\].
    #[must_use]
    pub fn of(errors: &[ContactError], edges: &[f64]) -> Option<Self> {
        let bin = |n: usize| {
            let inside = errors.iter().filter(|e| bin_in(edges, e.force) == Some(n));
            let consistency = Consistency::of(inside)?;
            Some(ConsistencyBin { from: edges[n], to: edges.get(n + 1).copied(), consistency })
        };
        let by_force = (0..edges.len()).filter_map(bin).collect();
        Some(Self { all: Consistency::of(errors.iter())?, by_force })
    }
}

impl fmt::Display for Consistencies {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  positions beside the covariance that is stated of each, where one is")?;
        writeln!(
            f,
            "  {:<24}{:>9}{:>12}{:>16}{:>17}{:>7}{:>13}",
            "", "contacts", "not stated", "error RMS [mm]", "stated RMS [mm]", "NEES", "inside 95 %"
        )?;
        let mut row = |name: &str, c: &Consistency| {
            writeln!(
                f,
                "  {name:<24}{:>9}{:>10.2} %{:>16.3}{:>17.3}{:>7.2}{:>11.1} %",
                c.samples,
                c.not_stated * 100.0,
                c.error_rms * 1e3,
                c.stated_rms * 1e3,
                c.nees,
                c.inside_95 * 100.0
            )
        };
        row("all", &self.all)?;
        for bin in &self.by_force {
            let to = bin.to.map_or_else(|| "+".to_owned(), |to| format!("-{to}"));
            row(&format!("{}{to} N", bin.from), &bin.consistency)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::SampleId;

    fn error(force: f64, along: Vector3<f64>, covariance: &Matrix3<f64>) -> ContactError {
        ContactError {
            id: SampleId { run: 0, sample: 0 },
            contact: [0, 1],
            force,
            position: along.norm(),
            normal_force: f64::NAN,
            vector: f64::NAN,
            angle: f64::NAN,
            found: true,
            stated: Stated::of(covariance, &along),
        }
    }

    /// On a surface: nothing across it, and an error there counts in no square.
    #[test]
    fn a_direction_without_extent_is_left_out() {
        let covariance = Matrix3::from_diagonal(&Vector3::new(1e-6, 4e-6, 0.0));
        let stated = Stated::of(&covariance, &Vector3::new(1e-3, 4e-3, 1e-3)).unwrap();
        assert_eq!(stated.freedom, 2);
        approx::assert_relative_eq!(stated.square, 5.0, max_relative = 1e-9);
        approx::assert_relative_eq!(stated.deviation, 5e-6_f64.sqrt(), max_relative = 1e-9);
        assert!(stated.is_inside(), "5.0 is below 5.99");
        assert_eq!(Stated::of(&Matrix3::zeros(), &Vector3::zeros()), None);
        assert_eq!(Stated::of(&Matrix3::repeat(f64::NAN), &Vector3::zeros()), None);
    }

    /// Gaussian errors that are as stated, and the same that are twice as large.
    #[test]
    fn errors_are_told_from_what_is_stated() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};

        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let covariance = Matrix3::from_diagonal(&Vector3::new(1e-6, 4e-6, 0.0));
        let mut drawn = |factor: f64| {
            let [x, y]: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
            Vector3::new(1e-3 * x, 2e-3 * y, 0.0) * factor
        };
        let errors: Vec<ContactError> = (0..4000)
            .map(|i| {
                let light = i % 2 == 0;
                error(if light { 0.5 } else { 5.0 }, drawn(if light { 1.0 } else { 2.0 }), &covariance)
            })
            .collect();
        let found = Consistencies::of(&errors, &[0.0, 1.0]).unwrap();
        let [light, firm] = [0, 1].map(|bin| found.by_force[bin].consistency);
        assert!((light.nees - 1.0).abs() < 0.07 && (light.inside_95 - 0.95).abs() < 0.02, "{light:?}");
        assert!((firm.nees - 4.0).abs() < 0.3 && firm.inside_95 < 0.6, "{firm:?}");
        assert!((firm.error_rms / firm.stated_rms - 2.0).abs() < 0.1, "{firm:?}");
        insta::assert_snapshot!(found, @r"
          positions beside the covariance that is stated of each, where one is
                                   contacts  not stated  error RMS [mm]  stated RMS [mm]   NEES  inside 95 %
          all                          4000      0.00 %           3.561            2.236   2.50       73.4 %
          0-1 N                        2000      0.00 %           2.239            2.236   0.99       94.5 %
          1+ N                         2000      0.00 %           4.511            2.236   4.00       52.2 %
        ");
        // What was not found, and what is not stated, are no part of it.
        let lost = ContactError { found: false, ..errors[0] };
        let silent = ContactError { stated: None, ..errors[0] };
        assert_eq!(Consistencies::of(&[lost, silent], &[0.0]), None);
        let some = Consistencies::of(&[lost, silent, errors[0]], &[0.0]).unwrap();
        assert_eq!((some.all.samples, some.all.not_stated), (1, 0.5));
    }
}
