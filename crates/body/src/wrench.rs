//! Forces and moments, and how they look from elsewhere.

use nalgebra::{Isometry3, Point3, Vector3};

/// A force and the moment about one point, in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wrench {
    /// \[N\]
    pub force: Vector3<f64>,
    /// \[N m\] about the origin of the frame.
    pub torque: Vector3<f64>,
}

impl Wrench {
    /// None.
    #[must_use]
    pub fn zero() -> Self {
        Self { force: Vector3::zeros(), torque: Vector3::zeros() }
    }

    /// A pure force \[N\] that acts at a point \[m\].
    #[must_use]
    pub fn of_force(force: Vector3<f64>, at: Point3<f64>) -> Self {
        Self { force, torque: at.coords.cross(&force) }
    }

    /// The same in frame a and about its origin, where `a_from_b` is the pose of the present frame b in a.
    #[must_use]
    pub fn seen_from(&self, a_from_b: &Isometry3<f64>) -> Self {
        let force = a_from_b.rotation * self.force;
        let torque = a_from_b.rotation * self.torque + a_from_b.translation.vector.cross(&force);
        Self { force, torque }
    }
}

impl std::ops::Add for Wrench {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { force: self.force + other.force, torque: self.torque + other.torque }
    }
}

impl std::ops::AddAssign for Wrench {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::array::uniform3;
    use proptest::prelude::*;

    proptest! {
        /// A force at a point is the same whether the point or the wrench is taken to the other frame.
        #[test]
        fn frames_agree(force in uniform3(-50.0..50.0f64), at in uniform3(-2.0..2.0f64), to in uniform3(-2.0..2.0f64), rpy in uniform3(-3.0..3.0f64)) {
            let a_from_b = Isometry3::from_parts(
                Translation3::from(to),
                UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]),
            );
            let (force, at) = (Vector3::from(force), Point3::from(at));
            let there = Wrench::of_force(force, at).seen_from(&a_from_b);
            let direct = Wrench::of_force(a_from_b * force, a_from_b * at);
            prop_assert!((there.force - direct.force).norm() < 1e-9);
            prop_assert!((there.torque - direct.torque).norm() < 1e-9);
            let back = there.seen_from(&a_from_b.inverse());
            prop_assert!((back.torque - at.coords.cross(&force)).norm() < 1e-9);
        }
    }
}
