//! What a spherical tip does to the points of the outside.
//!
//! The contact's radius is that of a rigid sphere on a half-space (I. N. Sneddon, 1965; the geometry of the sphere is exact), its pressure has
//! Hertz's shape. A fixed spiral of points of equal force stands for it, each shared between the points of the outside around it, so that
//! readings change evenly as a contact moves. Shear has the shape of the pressure, as it has where all of the contact slips.
//!
//! Assumptions: the layer's own bending does not change the contact's radius; no moment.

use std::f64::consts::{PI, TAU};

use dermis_model::{Indentation, tangents};
use nalgebra::{Point3, Vector3};

use crate::shape::Thumb;
use crate::surface::Rings;

/// Points that stand for a contact.
const SPIRAL: usize = 24;

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
        // Points of the spiral share points of the outside: each of these comes once.
        shares.sort_unstable_by_key(|(point, _)| *point);
        shares.dedup_by(|later, first| {
            let same = later.0 == first.0;
            if same {
                first.1 += later.1;
            }
            same
        });
        Self { shares, height }
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
        let places = rings.places();
        for (s, azimuth) in [(0.03, 1.0), (0.002, -2.0), (0.055, 3.0)] {
            let (at, _) = thumb.point(s, azimuth, 0.0);
            let footprint = Footprint::new(&thumb, &rings, &at, 0.002, 0.0015);
            let sum: f64 = footprint.shares.iter().map(|(_, w)| w).sum();
            assert_relative_eq!(sum, 1.0, max_relative = 1e-12);
            let middle: Vector3<f64> = footprint
                .shares
                .iter()
                .map(|(p, w)| thumb.point(places[*p][0], places[*p][1], 0.0).0.coords * *w)
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
