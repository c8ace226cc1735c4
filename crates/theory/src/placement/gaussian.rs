//! Placement by a Gaussian process over the surface, which knows where elements are and not what they read (A. Krause,
//! A. Singh, C. Guestrin, *Near-optimal sensor placements in Gaussian processes*, JMLR 9, 2008; thesis Alg. 3 and 4).

use dermis_skin::Surface;
use faer::Mat;
use faer::Side;
use faer::linalg::solvers::DenseSolveCore;
use nalgebra::Point3;

use super::{Sets, Watch};
use crate::TheoryError;

/// Length scale of the thesis, 33 mm, as a share of the longest way along its limb of 200 × 120 mm.
const LENGTH: f64 = 0.033 / 0.233;
/// Exponent of the thesis' kernel, l_p.
const POWER: f64 = 1.9;
/// Variance of what is measured on top of the process, whose own is 1.
const NUGGET: f64 = 1e-2;

/// Covariances between locations of a surface, exp(−(d/l)^1.9) of the distance along it (2.10).
#[derive(Debug, Clone)]
pub struct GaussianField {
    /// Between all locations, with the nugget on the diagonal.
    covariance: Mat<f64>,
    /// Location of each candidate; of several at one location the nearest.
    candidate_locations: Vec<(usize, usize)>,
    points: Vec<Point3<f64>>,
    /// \[m\] between all locations.
    ways: Vec<Vec<f64>>,
    /// \[m\] of the kernel.
    pub length: f64,
    /// Variance that was added. It is raised where distances along a surface with holes make no covariance otherwise.
    pub nugget: f64,
}

impl GaussianField {
    /// Of a surface and candidates on it (their feet). At most `most` points of the surface stand for it. `None` where `watch`
    /// stopped it.
    ///
    /// # Errors
    ///
    /// [`TheoryError::Decomposition`] where the surface is not of one piece.
    pub fn new(
        surface: &Surface,
        candidates: &[Point3<f64>],
        most: usize,
        watch: Watch<'_>,
    ) -> Result<Option<Self>, TheoryError> {
        let every = surface.points.len().div_ceil(most.max(1)).max(1);
        let locations: Vec<usize> = (0..surface.points.len()).step_by(every).collect();
        let mut ways = Vec::with_capacity(locations.len());
        for (n, location) in locations.iter().enumerate() {
            if !watch(n as f64 / locations.len() as f64) {
                return Ok(None);
            }
            let all = surface.ways_from(&surface.points[*location]);
            ways.push(locations.iter().map(|p| all[*p]).collect::<Vec<f64>>());
        }
        let longest = ways.iter().flatten().copied().fold(0.0, f64::max);
        if !(longest.is_finite() && longest > 0.0) {
            return Err(TheoryError::Decomposition {
                what: "the distances along a surface that is not of one piece",
            });
        }
        let length = LENGTH * longest;
        let n = locations.len();
        let mut nugget = NUGGET;
        let covariance = loop {
            let matrix = Mat::from_fn(n, n, |i, j| {
                let way = 0.5 * (ways[i][j] + ways[j][i]);
                (-(way / length).powf(POWER)).exp() + if i == j { nugget } else { 0.0 }
            });
            if matrix.llt(Side::Lower).is_ok() {
                break matrix;
            }
            nugget *= 2.0;
            if nugget > 10.0 {
                return Err(TheoryError::Decomposition { what: "the covariance of the surface" });
            }
        };
        let mut nearest: Vec<Option<(f64, usize)>> = vec![None; n];
        for (index, candidate) in candidates.iter().enumerate() {
            let off = |p: &usize| (surface.points[locations[*p]] - candidate).norm();
            let Some(location) = (0..n).min_by(|a, b| off(a).total_cmp(&off(b))) else { continue };
            let far = off(&location);
            if nearest[location].is_none_or(|(known, _)| far < known) {
                nearest[location] = Some((far, index));
            }
        }
        let candidate_locations = nearest
            .iter()
            .enumerate()
            .filter_map(|(location, c)| c.map(|(_, index)| (location, index)))
            .collect();
        let points = locations.iter().map(|p| surface.points[*p]).collect();
        Ok(Some(Self { covariance, candidate_locations, points, ways, length, nugget }))
    }

    /// What is left of the covariance between all locations and the candidates' once elements are chosen.
    fn start(&self) -> (Vec<f64>, Vec<Vec<f64>>) {
        ((0..self.covariance.nrows()).map(|i| self.covariance[(i, i)]).collect(), Vec::new())
    }

    /// Adds an element at `location` to the factor and takes what it tells from the variances.
    fn observe(&self, location: usize, variances: &mut [f64], factor: &mut Vec<Vec<f64>>) {
        let root = variances[location].max(f64::MIN_POSITIVE).sqrt();
        let row: Vec<f64> = (0..variances.len())
            .map(|j| {
                let known: f64 = factor.iter().map(|r| r[location] * r[j]).sum();
                // What is measured on top of the process says nothing of other locations.
                (self.covariance[(location, j)] - known) / root
            })
            .collect();
        variances.iter_mut().zip(&row).for_each(|(v, r)| *v = (*v - r * r).max(1e-12));
        factor.push(row);
    }

    /// Mean covariance of a location with all: how much the others say of it.
    fn said_of(&self, location: usize) -> f64 {
        (0..self.covariance.nrows()).map(|j| self.covariance[(location, j)]).sum()
    }

    /// The location that scores most; of equal ones that which the others say least of.
    fn best(&self, taken: &[usize], score: impl Fn(usize) -> f64) -> Option<(usize, usize)> {
        let open = self.candidate_locations.iter().filter(|(location, _)| !taken.contains(location));
        let scored: Vec<(f64, (usize, usize))> = open.map(|s| (score(s.0), *s)).collect();
        let most = scored.iter().map(|(v, _)| *v).fold(f64::NEG_INFINITY, f64::max);
        let tied = scored.into_iter().filter(|(v, _)| *v >= most - 1e-9 * most.abs());
        tied.map(|(_, s)| (self.said_of(s.0), s)).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, s)| s)
    }

    /// Elements whose readings together are least certain (2.11): the one that the chosen say least of, again and again.
    #[must_use]
    pub fn entropy(&self, budget: usize) -> Sets {
        let (mut variances, mut factor) = self.start();
        let (mut taken, mut order) = (Vec::new(), Vec::new());
        while order.len() < budget {
            let Some((location, index)) = self.best(&taken, |s| variances[s]) else { break };
            self.observe(location, &mut variances, &mut factor);
            taken.push(location);
            order.push(index);
        }
        Sets::nested(&order)
    }

    /// Elements that say most of all other locations (2.13): the one of the largest ratio between the variance that the chosen
    /// leave of it and the one that all the others would.
    ///
    /// # Errors
    ///
    /// [`TheoryError::Decomposition`] where the covariance cannot be inverted.
    pub fn mutual_information(&self, budget: usize) -> Result<Sets, TheoryError> {
        let llt = self
            .covariance
            .llt(Side::Lower)
            .map_err(|_| TheoryError::Decomposition { what: "the covariance of the surface" })?;
        // Of the locations that are not chosen: the variance of one that all others leave is 1 over its diagonal.
        let mut precision = llt.inverse();
        let (mut variances, mut factor) = self.start();
        let (mut taken, mut order) = (Vec::new(), Vec::new());
        while order.len() < budget {
            let Some((location, index)) = self.best(&taken, |s| variances[s] * precision[(s, s)]) else {
                break;
            };
            self.observe(location, &mut variances, &mut factor);
            let n = precision.nrows();
            let column: Vec<f64> = (0..n).map(|i| precision[(i, location)]).collect();
            let pivot = column[location];
            for j in 0..n {
                let by = column[j] / pivot;
                for i in 0..n {
                    precision[(i, j)] -= column[i] * by;
                }
            }
            taken.push(location);
            order.push(index);
        }
        Ok(Sets::nested(&order))
    }

    /// How far out locations lie: their mean distance along the surface from everywhere, over that of all candidates. Above 1 they
    /// lie towards the rim, below 1 towards the middle.
    #[must_use]
    pub fn outwardness(&self, locations: &[Point3<f64>]) -> f64 {
        let far = |location: usize| self.ways[location].iter().sum::<f64>();
        let all = self.candidate_locations.iter().map(|(location, _)| far(*location)).sum::<f64>()
            / self.candidate_locations.len().max(1) as f64;
        let off = |n: usize, p: &Point3<f64>| (self.points[n] - p).norm_squared();
        let nearest = |p: &Point3<f64>| {
            (0..self.points.len()).min_by(|a, b| off(*a, p).total_cmp(&off(*b, p))).unwrap_or_default()
        };
        locations.iter().map(|p| far(nearest(p))).sum::<f64>() / locations.len().max(1) as f64 / all
    }
}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;

    fn flat() -> (Surface, GaussianField) {
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.2, 0.12], spacing: 0.01 });
        let field = GaussianField::new(&surface, &surface.points, 10_000, &|_| true).unwrap().unwrap();
        (surface, field)
    }

    #[test]
    fn entropy_goes_to_the_rim_and_information_to_the_middle() {
        let (surface, field) = flat();
        let inside = |set: &[usize]| {
            let away = |i: &usize| {
                let p = &surface.points[*i];
                (0.1 - p.x.abs()).min(0.06 - p.y.abs())
            };
            set.iter().map(away).sum::<f64>() / set.len() as f64
        };
        let (entropy, information) = (field.entropy(6), field.mutual_information(6).unwrap());
        assert!(inside(entropy.last()) < 0.012, "{}", inside(entropy.last()));
        assert!(inside(information.last()) > 0.02, "{}", inside(information.last()));
        let outwardness = |set: &Sets| {
            field.outwardness(&set.last().iter().map(|i| surface.points[*i]).collect::<Vec<_>>())
        };
        assert!(outwardness(&entropy) > 1.1 && outwardness(&information) < 0.95);
    }

    #[test]
    fn the_first_two_are_what_the_definitions_say() {
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.06, 0.04], spacing: 0.01 });
        let field = GaussianField::new(&surface, &surface.points, 10_000, &|_| true).unwrap().unwrap();
        let k = |a: &[usize], b: &[usize]| {
            nalgebra::DMatrix::from_fn(a.len(), b.len(), |i, j| field.covariance[(a[i], b[j])])
        };
        let n = surface.points.len();
        // σ²_{y|A} from (2.9), all of it each time.
        let left = |y: usize, known: &[usize]| {
            if known.is_empty() {
                return field.covariance[(y, y)];
            }
            let c = k(&[y], known);
            let solved = k(known, known).cholesky().unwrap().solve(&c.transpose());
            field.covariance[(y, y)] - (c * solved)[(0, 0)]
        };
        let chosen = field.mutual_information(3).unwrap();
        for step in 0..3 {
            let before = &chosen.last()[..step];
            let ratio = |y: usize| {
                let others: Vec<usize> = (0..n).filter(|i| *i != y && !before.contains(i)).collect();
                left(y, before) / left(y, &others)
            };
            let best = (0..n).filter(|y| !before.contains(y)).map(ratio).fold(0.0, f64::max);
            approx::assert_relative_eq!(ratio(chosen.last()[step]), best, max_relative = 1e-6);
        }
        let chosen = field.entropy(3);
        for step in 1..3 {
            let before = &chosen.last()[..step];
            let best = (0..n).filter(|y| !before.contains(y)).map(|y| left(y, before)).fold(0.0, f64::max);
            approx::assert_relative_eq!(left(chosen.last()[step], before), best, max_relative = 1e-6);
        }
    }
}
