//! Where the links are, and how points on them move with the joints.
//!
//! Forward kinematics: the pose of a link is the product of the joints' poses from the root to it. The geometric Jacobian of a
//! point p on a link has one column per joint above it: for an axis a through o, linear part a × (p − o) and angular part a where it
//! turns, a and 0 where it slides (Siciliano et al., *Robotics: Modelling, Planning and Control*, 2009, §3.1.3). Joint torques of a
//! wrench follow from virtual work, τ = Jᵀ w (§3.8). A joint that follows another adds its columns to that one's, times its factor.
//!
//! Assumptions: rigid links, a fixed root. A position that is NaN is not known: every link beyond that joint has a pose of NaN, and
//! the others are placed nevertheless.
//!
//! Cost: one product of poses a joint; a Jacobian or the torques of one wrench cost one cross product for each joint above the link.

use nalgebra::{Isometry3, Matrix6xX, Point3, Translation3, UnitQuaternion, Vector3};

use crate::body::{Body, JointKind};
use crate::wrench::Wrench;

/// Poses of all links for one set of joint positions.
#[derive(Debug, Clone)]
pub struct Poses<'a> {
    pub(crate) body: &'a Body,
    pub(crate) links: Vec<Isometry3<f64>>,
    /// Axis and a point on it, in the frame of the root; one a joint.
    pub(crate) axes: Vec<(Vector3<f64>, Point3<f64>)>,
}

impl Body {
    /// Places all links. `positions` \[rad\] or \[m\] are those of [`coordinates`](Self::coordinates), in their order; what is
    /// missing at its end is not known, as NaN.
    #[must_use]
    pub fn poses(&self, positions: &[f64]) -> Poses<'_> {
        let mut links = vec![Isometry3::identity(); self.links.len()];
        let mut axes = vec![(Vector3::zeros(), Point3::origin()); self.joints.len()];
        for index in &self.order {
            let joint = &self.joints[*index];
            let root_from_joint = links[joint.parent] * joint.origin;
            axes[*index] =
                (root_from_joint.rotation * *joint.axis, root_from_joint.translation.vector.into());
            let position = joint.moved_by.map_or(0.0, |by| {
                by.multiplier * positions.get(by.coordinate).copied().unwrap_or(f64::NAN) + by.offset
            });
            let motion = match joint.kind {
                JointKind::Fixed => Isometry3::identity(),
                JointKind::Revolute | JointKind::Continuous => Isometry3::from_parts(
                    // A position that is not known leaves no coordinate of the link known.
                    Translation3::from(Vector3::repeat(position * 0.0)),
                    UnitQuaternion::from_axis_angle(&joint.axis, position),
                ),
                JointKind::Prismatic => Isometry3::from_parts(
                    Translation3::from(*joint.axis * position),
                    // A product with NaN: axes of 0 must not hide it.
                    UnitQuaternion::from_axis_angle(&joint.axis, position * 0.0),
                ),
            };
            links[joint.child] = root_from_joint * motion;
        }
        Poses { body: self, links, axes }
    }
}

impl Poses<'_> {
    /// Pose of a link in the frame of the root; NaN where a joint position above it is not known.
    #[must_use]
    pub fn root_from(&self, link: usize) -> &Isometry3<f64> {
        &self.links[link]
    }

    /// Pose of a link in the frame of another: `base_from_link`.
    #[must_use]
    pub fn between(&self, base: usize, link: usize) -> Isometry3<f64> {
        self.links[base].inv_mul(&self.links[link])
    }

    /// Whether every joint position between the root and a link is known.
    #[must_use]
    pub fn knows(&self, link: usize) -> bool {
        let pose = &self.links[link];
        pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite())
    }

    /// Calls `each(coordinate, factor, joint)` for every moving joint between the root and a link.
    fn above(&self, link: usize, mut each: impl FnMut(usize, f64, usize)) {
        let mut at = link;
        while let Some(index) = self.body.above[at] {
            let joint = &self.body.joints[index];
            if let Some(by) = joint.moved_by {
                each(by.coordinate, by.multiplier, index);
            }
            at = joint.parent;
        }
    }

    /// Geometric Jacobian of a point of a link: rows 0 to 2 give its linear velocity \[m/s\], rows 3 to 5 the angular velocity of
    /// the link \[rad/s\], both in the frame of the root; one column a coordinate. `point` \[m\] is in the frame of the root, too.
    #[must_use]
    pub fn jacobian(&self, link: usize, point: &Point3<f64>) -> Matrix6xX<f64> {
        let mut jacobian = Matrix6xX::zeros(self.body.coordinates.len());
        self.above(link, |coordinate, factor, index| {
            let (axis, origin) = &self.axes[index];
            let (linear, angular) = match self.body.joints[index].kind {
                JointKind::Prismatic => (*axis, Vector3::zeros()),
                _ => (axis.cross(&(point - origin)), *axis),
            };
            let mut column = jacobian.column_mut(coordinate);
            for row in 0..3 {
                column[row] += factor * linear[row];
                column[row + 3] += factor * angular[row];
            }
        });
        jacobian
    }

    /// Torques \[N m\], forces \[N\] at prismatic joints, that a wrench on a link puts on each coordinate: Jᵀ w. `wrench` is in the
    /// frame of the root and about its origin. Positive torque drives the joint in its positive direction.
    #[must_use]
    pub fn torques(&self, link: usize, wrench: &Wrench) -> Vec<f64> {
        let mut torques = vec![0.0; self.body.coordinates.len()];
        self.above(link, |coordinate, factor, index| {
            let (axis, origin) = &self.axes[index];
            torques[coordinate] += factor
                * match self.body.joints[index].kind {
                    JointKind::Prismatic => axis.dot(&wrench.force),
                    _ => axis.dot(&(wrench.torque - origin.coords.cross(&wrench.force))),
                };
        });
        torques
    }
}

#[cfg(test)]
mod tests;
