//! A rigid tip of any shape on an elastic surface that is known by its compliance at points.
//!
//! *Problem.* A tip is pressed into a surface with a force. Which points does it touch, and how is the force shared among them?
//!
//! *Method.* Unilateral contact in matrix form (T. F. Conry and A. Seireg, 1971; J. J. Kalker, 1990, section 4.3): forces p are not
//! negative; where p > 0, surface and tip touch, u + h = δ; elsewhere the surface does not enter the tip, u + h ≥ δ; and Σp is the force.
//! Here u = C p is how far points give way, h how high the tip is over them before it presses, and δ how deep it sinks. An active set finds
//! them: points that pull are let go, then points that the tip enters are taken in, until neither is left.
//!
//! *Assumptions.* No friction while it presses, so that tangential forces do not change the contact; the tip does not turn; C is
//! positive definite.
//!
//! *Cost.* A Cholesky factor of the touching points in each round, some ten of them: O(n³).

use nalgebra::{DMatrix, DVector};

use crate::MechanicsError;

/// Rounds in which points change sides, at most; more are not seen but where C is not positive definite.
const ROUNDS: usize = 200;
/// Share of the depth by which a point may lie inside the tip before it counts: rounding.
const INSIDE: f64 = 1e-9;

/// How a rigid tip rests on a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct RigidContact {
    /// \[N\] on every point; 0 where the tip does not touch.
    pub forces: Vec<f64>,
    /// \[m\] by which the tip sinks in, from where it would touch a point of height 0.
    pub depth: f64,
}

impl RigidContact {
    /// Presses with `force` \[N\] a tip that is as high \[m\] over each point as `heights` say into a surface whose points give way as
    /// `compliance` \[m/N\] says: row i has how far point i gives way under forces on all points.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Contact`] where there is no point, sizes differ, a number is not one, or the compliance is not positive definite.
    pub fn solve(compliance: &DMatrix<f64>, heights: &[f64], force: f64) -> Result<Self, MechanicsError> {
        let n = heights.len();
        let failed = |reason: &str| Err(MechanicsError::Contact { reason: reason.to_owned() });
        if n == 0 || compliance.shape() != (n, n) {
            return failed("it has no points, or as many heights as its compliance has rows are missing");
        }
        if !(force > 0.0 && force.is_finite()) || heights.iter().any(|h| !h.is_finite()) {
            return failed("its force or a height is not a number, or nothing presses");
        }
        let mut touches = vec![true; n];
        for _ in 0..ROUNDS {
            let active: Vec<usize> = (0..n).filter(|i| touches[*i]).collect();
            let Some((depth, forces)) = pressed(compliance, heights, &active, force) else {
                return failed("its compliance is not positive definite");
            };
            let pulls = active.iter().zip(forces.iter()).filter(|(_, f)| **f < 0.0);
            let pulls: Vec<usize> = pulls.map(|(i, _)| *i).collect();
            if !pulls.is_empty() {
                pulls.into_iter().for_each(|i| touches[i] = false);
                continue;
            }
            let gives = |i: usize| {
                active.iter().zip(forces.iter()).map(|(j, f)| compliance[(i, *j)] * f).sum::<f64>()
            };
            let inside = |i: &usize| !touches[*i] && gives(*i) + heights[*i] < depth - INSIDE * depth.abs();
            let enters: Vec<usize> = (0..n).filter(inside).collect();
            if enters.is_empty() {
                let mut all = vec![0.0; n];
                active.iter().zip(forces.iter()).for_each(|(i, f)| all[*i] = *f);
                return Ok(Self { forces: all, depth });
            }
            enters.into_iter().for_each(|i| touches[i] = true);
        }
        failed("points kept changing sides")
    }
}

/// Depth and forces where just these points touch, whatever their signs; `None` where the compliance of these points has no factor.
fn pressed(
    compliance: &DMatrix<f64>,
    heights: &[f64],
    active: &[usize],
    force: f64,
) -> Option<(f64, DVector<f64>)> {
    let part = compliance.select_rows(active).select_columns(active);
    let factor = part.cholesky()?;
    let ones = factor.solve(&DVector::repeat(active.len(), 1.0));
    let rest = factor.solve(&DVector::from_iterator(active.len(), active.iter().map(|i| heights[*i])));
    let depth = (force + rest.sum()) / ones.sum();
    Some((depth, ones * depth - rest))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use approx::assert_relative_eq;
    use proptest::prelude::*;

    use super::*;

    /// \[Pa\] E/(1 − ν²).
    const MODULUS: f64 = 70e3 / (1.0 - 0.49 * 0.49);

    /// Squares of `side` \[m\] on a half-space (A. E. H. Love, 1929, for the square itself; far ones as points).
    fn half_space(locations: &[[f64; 2]], side: f64) -> DMatrix<f64> {
        DMatrix::from_fn(locations.len(), locations.len(), |i, j| {
            let [dx, dy] = [0, 1].map(|k| locations[i][k] - locations[j][k]);
            match i == j {
                // At its middle: 4 ln(1 + √2) a p / (π E*).
                true => 4.0 * (1.0 + 2f64.sqrt()).ln() / (PI * MODULUS * side),
                false => 1.0 / (PI * MODULUS * dx.hypot(dy)),
            }
        })
    }

    fn squares(half: usize, side: f64) -> Vec<[f64; 2]> {
        let at = |i: usize| (i as f64 - half as f64) * side;
        (0..=2 * half).flat_map(|i| (0..=2 * half).map(move |j| [at(i), at(j)])).collect()
    }

    #[test]
    fn a_ball_rests_as_hertz_says() {
        let (radius, side) = (0.01, 0.00015);
        let locations = squares(10, side);
        let heights: Vec<f64> = locations.iter().map(|[x, y]| (x * x + y * y) / (2.0 * radius)).collect();
        let force = 0.02;
        let found = RigidContact::solve(&half_space(&locations, side), &heights, force).unwrap();
        let contact = (0.75 * force * radius / MODULUS).cbrt();
        assert!(contact < 10.0 * side, "the contact lies inside of the modelled area: {contact}");
        assert_relative_eq!(found.depth, contact * contact / radius, max_relative = 0.02);
        let sum: f64 = found.forces.iter().sum();
        assert_relative_eq!(sum, force, max_relative = 1e-9);
        let touching = found.forces.iter().filter(|f| **f > 0.0).count() as f64 * side * side;
        assert_relative_eq!((touching / PI).sqrt(), contact, max_relative = 0.05);
        let most = found.forces.iter().copied().fold(0.0, f64::max) / (side * side);
        assert_relative_eq!(most, 1.5 * force / (PI * contact * contact), max_relative = 0.03);
    }

    #[test]
    fn a_flat_punch_sinks_as_far_as_sneddon_says() {
        let (radius, side) = (0.002, 0.0002);
        let locations: Vec<[f64; 2]> =
            squares(10, side).into_iter().filter(|[x, y]| x.hypot(*y) <= radius).collect();
        let found =
            RigidContact::solve(&half_space(&locations, side), &vec![0.0; locations.len()], 0.5).unwrap();
        let covered = (locations.len() as f64 * side * side / PI).sqrt();
        assert_relative_eq!(found.depth, 0.5 / (2.0 * MODULUS * covered), max_relative = 0.03);
        let at = |x: f64| {
            let near = |p: &[f64; 2]| (p[0] - x).hypot(p[1]);
            let place = (0..locations.len())
                .min_by(|a, b| near(&locations[*a]).total_cmp(&near(&locations[*b])))
                .unwrap();
            found.forces[place]
        };
        // Pressure rises towards the edge: by 2.3 at 0.9 of the radius.
        assert!(at(0.0018) > 1.7 * at(0.0), "{} {}", at(0.0018), at(0.0));
    }

    #[test]
    fn what_cannot_rest_is_refused() {
        let message =
            |c: DMatrix<f64>, h: &[f64], f: f64| RigidContact::solve(&c, h, f).unwrap_err().to_string();
        assert!(message(DMatrix::zeros(0, 0), &[], 1.0).contains("no points"));
        assert!(message(DMatrix::identity(2, 2), &[0.0; 3], 1.0).contains("missing"));
        assert!(message(DMatrix::identity(1, 1), &[0.0], -1.0).contains("nothing presses"));
        assert!(message(DMatrix::identity(1, 1), &[f64::INFINITY], 1.0).contains("not a number"));
        assert!(message(-DMatrix::<f64>::identity(1, 1), &[0.0], 1.0).contains("positive definite"));
    }

    proptest! {
        /// Nothing pulls, nothing enters, what presses touches, and the force is what presses.
        #[test]
        fn every_tip_rests(heights in prop::collection::vec(0.0..5e-4f64, 25), force in 1e-3..1.0f64) {
            let (side, locations) = (0.0004, squares(2, 0.0004));
            let compliance = half_space(&locations, side);
            let found = RigidContact::solve(&compliance, &heights, force).unwrap();
            let forces = DVector::from_column_slice(&found.forces);
            let gap = &compliance * &forces + DVector::from_column_slice(&heights)
                - DVector::repeat(25, found.depth);
            for (gap, force) in gap.iter().zip(&found.forces) {
                prop_assert!(*force >= 0.0 && *gap >= -1e-8 * found.depth);
                prop_assert!(*force == 0.0 || gap.abs() <= 1e-8 * found.depth, "{} {}", gap, force);
            }
            prop_assert!((forces.sum() / force - 1.0).abs() < 1e-9);
        }
    }
}
