//! Principal components and the pivots of their QR decomposition (K. Manohar et al., *Data-driven sparse sensor placement for
//! reconstruction*, IEEE Control Systems 38, 2018; thesis Alg. 2).

use faer::Mat;
use faer::linalg::solvers::SvdError;
use nalgebra::DMatrix;
use serde::Serialize;

use super::{Field, Sets};
use crate::TheoryError;

/// Candidates that stand for all.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reduction {
    /// Ascending.
    pub chosen: Vec<usize>,
    /// Numbers of candidates that were tried, ascending, and the share of the variance of all readings that no linear
    /// combination of so many explains (Fig. 2.3c).
    pub unexplained: Vec<(usize, f64)>,
}

fn broken(_: SvdError) -> TheoryError {
    TheoryError::Decomposition { what: "the singular values of the candidates' readings" }
}

fn faer_of(from: &DMatrix<f64>) -> Mat<f64> {
    Mat::from_fn(from.nrows(), from.ncols(), |i, j| from[(i, j)])
}

/// Directions of the readings' variance, candidates × components, the strongest first.
struct Components {
    readings: Mat<f64>,
    directions: Mat<f64>,
    /// Components that stand for more than rounding.
    rank: usize,
}

impl Components {
    fn of(field: &Field) -> Result<Self, TheoryError> {
        let readings = faer_of(&field.standardised());
        if readings.nrows() == 0 || readings.ncols() == 0 {
            return Ok(Self { directions: Mat::zeros(readings.ncols(), 0), readings, rank: 0 });
        }
        let svd = readings.thin_svd().map_err(broken)?;
        let values: Vec<f64> = svd.S().column_vector().iter().copied().collect();
        let largest = values.first().copied().unwrap_or_default();
        let rank = values.iter().filter(|v| **v > 1e-10 * largest).count();
        Ok(Self { directions: svd.V().to_owned(), readings, rank })
    }

    /// As many candidates as components: the pivots of the QR decomposition of the transposed components.
    fn pivots(&self, count: usize) -> Vec<usize> {
        let count = count.min(self.rank);
        let transposed = Mat::from_fn(count, self.directions.nrows(), |i, j| self.directions[(j, i)]);
        let decomposed = transposed.col_piv_qr();
        let (forward, _) = decomposed.P().arrays();
        forward[..count].to_vec()
    }

    /// Share of the variance that these candidates leave unexplained.
    fn unexplained(&self, chosen: &[usize]) -> f64 {
        let total = self.readings.squared_norm_l2();
        if total == 0.0 {
            return 0.0;
        }
        let basis = Mat::from_fn(self.readings.nrows(), chosen.len(), |i, j| self.readings[(i, chosen[j])]);
        let q = basis.qr().compute_thin_Q();
        let explained = (q.transpose() * &self.readings).squared_norm_l2();
        (1.0 - explained / total).max(0.0)
    }
}

/// The elements of every budget up to `budget`; a budget beyond the rank of the readings gets no more than that.
///
/// # Errors
///
/// [`TheoryError::Decomposition`] where the readings hold numbers that are not finite.
pub fn pca_qr(field: &Field, budget: usize) -> Result<Sets, TheoryError> {
    let components = Components::of(field)?;
    Ok(Sets((1..=budget.min(components.rank)).map(|k| components.pivots(k)).collect()))
}

/// As few candidates as leave no more than `share` of the variance unexplained.
///
/// # Errors
///
/// As [`pca_qr`].
pub fn reduce(field: &Field, share: f64) -> Result<Reduction, TheoryError> {
    let components = Components::of(field)?;
    let mut unexplained: Vec<(usize, f64)> = Vec::new();
    let mut try_count = |count: usize| {
        let chosen = components.pivots(count);
        let left = components.unexplained(&chosen);
        let at = unexplained.partition_point(|(n, _)| *n < count);
        unexplained.insert(at, (count, left));
        (chosen, left)
    };
    let (mut low, mut high) = (0, 1);
    let mut found = loop {
        let (chosen, left) = try_count(high.min(components.rank));
        if left <= share || high >= components.rank {
            break chosen;
        }
        low = high;
        high = (high * 3).div_ceil(2);
    };
    high = high.min(components.rank);
    while high > low + 1 {
        let middle = usize::midpoint(low, high);
        let (chosen, left) = try_count(middle);
        if left <= share {
            (high, found) = (middle, chosen);
        } else {
            low = middle;
        }
    }
    found.sort_unstable();
    Ok(Reduction { chosen: found, unexplained })
}

#[cfg(test)]
mod tests {
    use super::super::testing::plate;
    use super::*;

    #[test]
    fn pivots_span_what_the_components_do() {
        let field = plate(9, 5);
        let components = Components::of(&field).unwrap();
        let pivots = components.pivots(6);
        assert_eq!(pivots.len(), 6);
        // The first is the row of the components that is longest.
        let long = |j: usize| (0..6).map(|i| components.directions[(j, i)].powi(2)).sum::<f64>();
        assert!((0..field.candidates()).all(|j| long(j) <= long(pivots[0]) + 1e-12));
        // And six of them span the six components.
        let picked = Mat::from_fn(6, 6, |i, j| components.directions[(pivots[j], i)]);
        let values: Vec<f64> = picked.thin_svd().unwrap().S().column_vector().iter().copied().collect();
        assert!(values[5] > 1e-3, "{values:?}");
    }

    #[test]
    fn reduction_explains_the_requested_share() {
        let field = plate(9, 5);
        let few = reduce(&field, 0.05).unwrap();
        let many = reduce(&field, 0.01).unwrap();
        assert!(few.chosen.len() < many.chosen.len() && many.chosen.len() < field.candidates());
        let components = Components::of(&field).unwrap();
        assert!(components.unexplained(&many.chosen) <= 0.01);
        assert!(many.unexplained.windows(2).all(|w| w[0].0 < w[1].0));
        let sets = pca_qr(&field, 4).unwrap();
        assert_eq!(sets.0.iter().map(Vec::len).collect::<Vec<_>>(), [1, 2, 3, 4]);
    }
}
