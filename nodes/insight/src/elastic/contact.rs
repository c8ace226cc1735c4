//! What a tip does to the points of the outside.
//!
//! A ball's contact radius is that of a rigid sphere on a half-space (I. N. Sneddon, 1965; the geometry of the sphere is exact), its pressure has
//! Hertz's shape. A fixed spiral of points of equal force stands for it, each shared between the points of the outside around it, so that
//! readings change evenly as a contact moves. Any other tip, however it stands, is a unilateral contact on the compliance of the elastomer itself
//! ([`RigidContact`]): a lattice of points of its face, each of which rests on the points of the outside around it.
//! Shear has the shape of the pressure, as it has where all of the contact slips.
//!
//! Assumptions: the layer's own bending does not change the radius of a ball's contact; tips do not turn while they press, so that the middle of
//! the pressure may lie beside the place of a tip that stands askew.
//!
//! Cost: microseconds for a ball or a flat punch; for any other tip some milliseconds, most of them for factors of a few hundred points.

use std::f64::consts::{PI, TAU};

use dermis_mechanics::{MechanicsError, RigidContact};
use dermis_model::{Indentation, Tip, tangents};
use nalgebra::{DMatrix, Point3, Vector3};

use crate::elastic::basis::Basis;
use crate::shape::Thumb;
use crate::surface::{Rings, Weights};

/// Points that stand for a contact.
const SPIRAL: usize = 24;
/// Points of a tip's lattice across its widest extent, and \[m\] between them at least: a third of what lies between points of the outside, beyond
/// which their compliance knows nothing.
const ACROSS: f64 = 24.0;
const FINEST: f64 = 3.5e-4;
/// \[m\] by which a tip's face may lie above its lowest point and still be inspected: the thickness of the elastomer.
const HIGHEST: f64 = 4e-3;
/// Points of the lattice are closer than those of the outside, so that many forces move these alike. This share of a point's own compliance is
/// added to it, which chooses the most even one among them.
const EVEN: f64 = 1e-2;

/// \[m\] of the contact of a rigid sphere of `radius` \[m\] that presses a half-space of plane modulus E/(1 − ν²) \[Pa\] with `force` \[N\].
#[must_use]
pub fn contact_radius(modulus: f64, radius: f64, force: f64) -> f64 {
    if force <= 0.0 {
        return 0.0;
    }
    // By x = artanh(a/R), of which the force is a smooth, rising function.
    let excess = |x: f64| {
        let t = x.tanh();
        modulus * radius * radius * ((1.0 + t * t) * x - t) - force
    };
    let (mut low, mut high) = (0.0, 1.0);
    while excess(high) < 0.0 && high < 1e3 {
        high *= 2.0;
    }
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if excess(middle) < 0.0 { low = middle } else { high = middle }
    }
    radius * low.tanh()
}

/// Shares of a contact's force on the points of the outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Footprint {
    /// Points, each once, and their shares; they sum to 1.
    pub shares: Vec<(usize, f64)>,
    /// \[m\] by which the sphere's mean height over the contact is above its lowest point.
    pub height: f64,
}

/// \[m\] of a sphere that touches a plane as a sphere of `diameter` \[m\] touches the outside at the way `s`: curvatures add up (H. Hertz).
#[must_use]
pub fn relative_radius(thumb: &Thumb, s: f64, diameter: f64) -> f64 {
    1.0 / (2.0 / diameter + thumb.curvature(s))
}

impl Footprint {
    /// Of a sphere that presses with `force` \[N\] at a point of the outside; `modulus` \[Pa\] is E/(1 − ν²).
    #[must_use]
    pub fn of_sphere(
        thumb: &Thumb,
        rings: &Rings,
        at: &Point3<f64>,
        [diameter, force, modulus]: [f64; 3],
    ) -> Self {
        let radius = relative_radius(thumb, thumb.locate(at).0, diameter);
        Self::new(thumb, rings, at, radius, contact_radius(modulus, radius, force))
    }

    /// Of a flat punch of `diameter` \[m\], whose pressure rises towards its edge (M. A. Sadowsky, 1928).
    #[must_use]
    pub fn of_punch(thumb: &Thumb, rings: &Rings, at: &Point3<f64>, diameter: f64) -> Self {
        let radius = diameter / 2.0;
        let within = |share: f64| radius * (1.0 - (1.0 - share).powi(2)).sqrt();
        Self::spread(thumb, rings, at, within, |_| 0.0)
    }

    /// Of a sphere of the relative `radius` \[m\] at a point of the outside whose contact has the radius `contact` \[m\].
    #[must_use]
    pub fn new(thumb: &Thumb, rings: &Rings, at: &Point3<f64>, radius: f64, contact: f64) -> Self {
        let within = |share: f64| contact * (1.0 - (1.0 - share).powf(2.0 / 3.0)).sqrt();
        Self::spread(thumb, rings, at, within, |r| radius - (radius * radius - r * r).max(0.0).sqrt())
    }

    /// Of any tip that presses with `force` \[N\] into an elastomer `stiffness` times as stiff as that of `basis`.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Contact`] where its face looks away, or no part of it meets the outside.
    pub fn of_tip(
        (thumb, rings, basis): (&Thumb, &Rings, &Basis),
        at: &Point3<f64>,
        tip: &Tip,
        [force, stiffness]: [f64; 2],
    ) -> Result<Self, MechanicsError> {
        let (s, azimuth, _) = thumb.locate(at);
        let normal = thumb.point(s, azimuth, 0.0).1;
        if (tip.orientation * Vector3::z()).dot(&normal) <= 0.0 {
            return Err(MechanicsError::Contact { reason: "its face looks away from the surface".into() });
        }
        let lattice = Lattice::under(thumb, rings, at, tip);
        let compliance = lattice.compliance(basis, &normal) / stiffness;
        let rest = RigidContact::solve(&compliance, &lattice.heights, force)?;
        let bearing = || lattice.weights.iter().zip(&rest.forces).filter(|(_, f)| **f > 0.0);
        let shares = bearing().flat_map(|(weights, f)| weights.map(|(point, w)| (point, w * f / force)));
        let height = lattice.heights.iter().zip(&rest.forces).map(|(h, f)| h * f / force).sum();
        Ok(Self { shares: gathered(shares.filter(|(_, share)| *share > 0.0).collect()), height })
    }

    /// Of a tip whose force lies to a share within the radius `within`, and whose face is so high at a radius, all \[m\].
    fn spread(
        thumb: &Thumb,
        rings: &Rings,
        at: &Point3<f64>,
        within: impl Fn(f64) -> f64,
        face: impl Fn(f64) -> f64,
    ) -> Self {
        let (s, azimuth, _) = thumb.locate(at);
        let (centre, normal) = thumb.point(s, azimuth, 0.0);
        let [first, second] = tangents(&normal);
        let golden = PI * (3.0 - 5f64.sqrt());
        let (mut shares, mut height) = (Vec::with_capacity(4 * SPIRAL), 0.0);
        let share = 1.0 / SPIRAL as f64;
        for k in 0..SPIRAL {
            let r = within((k as f64 + 0.5) * share);
            let (sin, cos) = (golden * k as f64 % TAU).sin_cos();
            let (s, azimuth, _) = thumb.locate(&(centre + (first * cos + second * sin) * r));
            shares.extend(rings.weights(s, azimuth).map(|(point, w)| (point, w * share)));
            height += share * face(r);
        }
        Self { shares: gathered(shares), height }
    }
}

/// The same shares with each point once, in rising order: neighbours share points of the outside.
fn gathered(mut shares: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    shares.sort_unstable_by_key(|(point, _)| *point);
    shares.dedup_by(|later, first| {
        let same = later.0 == first.0;
        if same {
            first.1 += later.1;
        }
        same
    });
    shares
}

/// Points of a tip's face that can meet the outside.
struct Lattice {
    /// On the points of the outside.
    weights: Vec<Weights>,
    /// \[m\] of the face over the outside.
    heights: Vec<f64>,
}

impl Lattice {
    fn under(thumb: &Thumb, rings: &Rings, at: &Point3<f64>, tip: &Tip) -> Self {
        let extent = tip.shape.extent();
        let step = (extent / ACROSS).max(FINEST);
        let half = (extent / 2.0 / step).ceil() as i32;
        let (mut weights, mut heights) = (Vec::new(), Vec::new());
        let along = |i: i32| (f64::from(i) + 0.5) * step;
        for (i, j) in (-half..half).flat_map(|i| (-half..half).map(move |j| (i, j))) {
            let beside = tip.orientation * Vector3::new(along(i), along(j), 0.0);
            let (s, azimuth, _) = thumb.locate(&(at + beside));
            let own = tip.orientation.inverse_transform_vector(&(thumb.point(s, azimuth, 0.0).0 - at));
            // The far side of the thumb is below the tip, too, but not in reach.
            let Some(face) = tip.shape.face(own.x, own.y).map(|face| face - own.z) else { continue };
            if face <= HIGHEST {
                weights.push(rings.weights(s, azimuth));
                heights.push(face);
            }
        }
        Self { weights, heights }
    }

    /// \[m/N\] by which each point gives way under a force on each, against the outward `normal`.
    fn compliance(&self, basis: &Basis, normal: &Vector3<f64>) -> DMatrix<f64> {
        let mut nodes: Vec<usize> = self.weights.iter().flatten().map(|(node, _)| *node).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let mut of_nodes = DMatrix::zeros(nodes.len(), nodes.len());
        for (column, node) in nodes.iter().enumerate() {
            basis.give(*node, &-normal, |other, by| {
                if let Ok(row) = nodes.binary_search(&other) {
                    of_nodes[(row, column)] = by;
                }
            });
        }
        let mut on: DMatrix<f64> = DMatrix::zeros(self.weights.len(), nodes.len());
        for (row, weights) in self.weights.iter().enumerate() {
            for (node, weight) in weights {
                if let Ok(column) = nodes.binary_search(node) {
                    on[(row, column)] += weight;
                }
            }
        }
        let all = &on * of_nodes * on.transpose();
        let even = EVEN * all.diagonal().max();
        // Normals differ a little from point to point, which the compliance of one direction is not symmetric for.
        (&all + all.transpose()) * 0.5 + DMatrix::from_diagonal_element(on.nrows(), on.nrows(), even)
    }
}

/// A contact's force with its shear cut where it would slip.
#[must_use]
pub fn gripping(contact: &Indentation, normal: &Vector3<f64>, friction: f64) -> Vector3<f64> {
    let pressing = normal * contact.force.dot(normal);
    let shear = contact.force - pressing;
    let (most, has) = (friction * pressing.norm(), shear.norm());
    if has <= most { contact.force } else { pressing + shear * (most / has) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    /// Case B3 of the sphere on a half-space: 70 kPa, ν = 0.49, R = 2 mm, 1.2 mm deep at 0.2146 N.
    #[test]
    fn the_contact_is_sneddon_s() {
        let (modulus, radius) = (70e3 / (1.0 - 0.49f64.powi(2)), 0.002);
        for (depth, force) in [(0.0012, 0.2146), (0.0024, 0.5683)] {
            let a = contact_radius(modulus, radius, force);
            assert_relative_eq!(a * (a / radius).atanh(), depth, max_relative = 5e-3);
        }
        // Hertz, where the sphere is large.
        let a = contact_radius(modulus, 1.0, 0.5);
        assert_relative_eq!(4.0 / 3.0 * modulus * a.powi(3), 0.5, max_relative = 1e-3);
        assert_relative_eq!(contact_radius(modulus, radius, 0.0), 0.0);
    }

    #[test]
    fn shares_sum_up_and_lie_around_the_contact() {
        let thumb = Thumb::new(0.020, 0.070, 0.009).unwrap();
        let rings = Rings::new(&thumb, 0.060, 0.0011);
        let locations = rings.locations();
        for (s, azimuth) in [(0.03, 1.0), (0.002, -2.0), (0.055, 3.0)] {
            let (at, _) = thumb.point(s, azimuth, 0.0);
            let footprint = Footprint::new(&thumb, &rings, &at, 0.002, 0.0015);
            let sum: f64 = footprint.shares.iter().map(|(_, w)| w).sum();
            assert_relative_eq!(sum, 1.0, max_relative = 1e-12);
            let middle: Vector3<f64> = footprint
                .shares
                .iter()
                .map(|(p, w)| thumb.point(locations[*p][0], locations[*p][1], 0.0).0.coords * *w)
                .sum();
            assert!((middle - at.coords).norm() < 3e-4, "{s}: {}", (middle - at.coords).norm());
        }
    }

    #[test]
    fn shear_beyond_friction_slips() {
        let press = |force: [f64; 3]| Indentation::sphere(Point3::origin(), force.into(), 0.004);
        let z = Vector3::z();
        assert_eq!(gripping(&press([0.3, 0.0, -1.0]), &z, 0.5), Vector3::new(0.3, 0.0, -1.0));
        assert_relative_eq!(gripping(&press([3.0, 0.0, -1.0]), &z, 0.5), Vector3::new(0.5, 0.0, -1.0));
    }
}
