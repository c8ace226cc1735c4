//! The field that a sensor's place sends out in a medium without end.

use nalgebra::{Matrix3, Point3, Vector3};

/// A source of dilatation whose displacements are the influence of the mean compressive stress in its place: \[Pa\] per
/// \[N\] of a force there, in a medium without boundaries.
///
/// It is Kelvin's solution seen from the sensor: u = −C r/|r|³ with C = (1+ν)/(12π(1−ν)), r from the sensor to the force.
/// It has no dilatation and, with Young's modulus 1, the stress 2μ∇u. Finite elements then have to find only what the
/// boundaries add, which is smooth where this is steep.
#[derive(Debug, Clone, Copy)]
pub(super) struct Source {
    place: Point3<f64>,
    strength: f64,
    shear: f64,
}

impl Source {
    pub fn new(place: Point3<f64>, poisson_ratio: f64) -> Self {
        let strength = (1.0 + poisson_ratio) / (12.0 * std::f64::consts::PI * (1.0 - poisson_ratio));
        Self { place, strength, shear: 0.5 / (1.0 + poisson_ratio) }
    }

    /// Displacement at a point.
    pub fn displacement(&self, at: &Point3<f64>) -> Vector3<f64> {
        let r = at - self.place;
        r * (-self.strength / r.norm().powi(3))
    }

    /// Force per area on a surface with the outward unit `normal`.
    pub fn traction(&self, at: &Point3<f64>, normal: &Vector3<f64>) -> Vector3<f64> {
        let r = at - self.place;
        let square = r.norm_squared();
        let gradient = r * r.transpose() * (3.0 / square) - Matrix3::identity();
        gradient * normal * (2.0 * self.shear * self.strength / (square * square.sqrt()))
    }
}
