//! What it takes to move a body: its momentum, its weight, and the torques of a motion.
//!
//! Problem: joints measure the torques of their drives; how much of that does the body's own motion and weight explain? Method: recursive
//! Newton–Euler in spatial vectors (Featherstone, *Rigid Body Dynamics Algorithms*, 2008, §5.3), with every quantity in the frame of the
//! root and about its origin, so that nothing is transformed on the way. [`Poses::momentum`] gives the terms of Lagrange's equations
//!
//! d/dt p = τ + ∂T/∂q + g, with p = M q̇
//!
//! in one pass out and one pass back and without the mass matrix: with S the axis of a joint, V the velocity of the link that carries it, H the momentum of all
//! that it carries and W the weight of that, p = S·H, ∂T/∂q = H·(V × S) and g = S·W. The first is the definition; the second holds because
//! a turn of the joint leaves the motion of what it carries as it is, seen from there, but for that of the carrier, which turns back.
//! ∂T/∂q is what Cᵀq̇ is where C is made of Christoffel symbols (De Luca and Mattone, *Actuator failure detection and isolation using
//! generalized momenta*, ICRA 2003).
//!
//! Assumptions: rigid links, a root that rests; no friction, no springs, and no inertia of rotors, which a URDF does not tell. Links
//! without inertia weigh nothing.
//!
//! Cost: some hundred multiplications a link for each pass.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use crate::body::{Body, JointKind};
use crate::kinematics::Poses;
use crate::wrench::Wrench;

/// Mass of a link and how it is spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertia {
    /// \[kg\]
    pub mass: f64,
    /// \[m\] centre of mass, in the frame of the link.
    pub center: Point3<f64>,
    /// \[kg m²\] about the centre of mass, along the axes of the link.
    pub tensor: Matrix3<f64>,
}

impl Inertia {
    /// Whether a body can have it: a mass that is not negative, and principal moments of which none exceeds the sum of the others.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        let moments = self.tensor.symmetric_eigenvalues();
        // A file has six digits or so.
        let slack = 1e-4 * moments.amax() + 1e-12;
        self.mass >= 0.0 && moments.min() >= -slack && 2.0 * moments.max() <= moments.sum() + slack
    }
}

/// The terms of Lagrange's equations, each with one number a coordinate of the body.
#[derive(Debug, Clone, PartialEq)]
pub struct Momentum {
    /// \[N m s\], \[N s\] at prismatic joints: p = M q̇.
    pub generalized: Vec<f64>,
    /// \[N m\] or \[N\]: ∂T/∂q, the derivative of the kinetic energy at constant joint velocities.
    pub kinetic: Vec<f64>,
    /// \[N m\] or \[N\] that the weight puts on the joints.
    pub weight: Vec<f64>,
    /// \[J\] T.
    pub energy: f64,
}

/// A motion of a rigid body in Plücker coordinates about the origin of the root.
#[derive(Debug, Clone, Copy)]
struct Motion {
    angular: Vector3<f64>,
    /// Of the point of the body that is at the origin.
    linear: Vector3<f64>,
}

impl Motion {
    fn zero() -> Self {
        Self { angular: Vector3::zeros(), linear: Vector3::zeros() }
    }

    fn plus(&self, other: &Self, factor: f64) -> Self {
        Self { angular: self.angular + other.angular * factor, linear: self.linear + other.linear * factor }
    }

    /// The rate at which `other` changes where it moves with this: V × S.
    fn cross(&self, other: &Self) -> Self {
        Self {
            angular: self.angular.cross(&other.angular),
            linear: self.angular.cross(&other.linear) + self.linear.cross(&other.angular),
        }
    }

    /// The same of a force or a momentum: V ×* H.
    fn cross_force(&self, force: &Wrench) -> Wrench {
        Wrench {
            force: self.angular.cross(&force.force),
            torque: self.angular.cross(&force.torque) + self.linear.cross(&force.force),
        }
    }

    /// Power of a force, or twice the energy of a momentum.
    fn dot(&self, force: &Wrench) -> f64 {
        self.angular.dot(&force.torque) + self.linear.dot(&force.force)
    }
}

/// The inertia of a link in the frame of the root.
struct Placed {
    mass: f64,
    center: Vector3<f64>,
    tensor: Matrix3<f64>,
}

impl Placed {
    fn new(inertia: &Inertia, root_from_link: &Isometry3<f64>) -> Self {
        let turn = root_from_link.rotation.to_rotation_matrix();
        Self {
            mass: inertia.mass,
            center: (root_from_link * inertia.center).coords,
            tensor: turn * inertia.tensor * turn.transpose(),
        }
    }

    /// I V.
    fn times(&self, motion: &Motion) -> Wrench {
        let force = (motion.linear + motion.angular.cross(&self.center)) * self.mass;
        Wrench { force, torque: self.tensor * motion.angular + self.center.cross(&force) }
    }
}

impl Body {
    /// Mass of a link and how it is spread; `None` where the file does not tell.
    #[must_use]
    pub fn inertia(&self, link: usize) -> Option<&Inertia> {
        self.inertias[link].as_ref()
    }

    /// For each coordinate, whether any link that it moves has a mass: of others, no motion takes a torque that could be predicted.
    #[must_use]
    pub fn carries_mass(&self) -> Vec<bool> {
        let mut carries = vec![false; self.coordinates.len()];
        let mut below: Vec<bool> =
            self.inertias.iter().map(|i| i.as_ref().is_some_and(|i| i.mass > 0.0)).collect();
        for index in self.order.iter().rev() {
            let joint = &self.joints[*index];
            if below[joint.child] {
                below[joint.parent] = true;
                if let Some(by) = joint.moved_by {
                    carries[by.coordinate] = true;
                }
            }
        }
        carries
    }

    /// The first link whose inertia no body can have.
    #[must_use]
    pub fn impossible_inertia(&self) -> Option<&str> {
        let wrong = |i: &Option<Inertia>| i.as_ref().is_some_and(|i| !i.is_possible());
        self.inertias.iter().position(wrong).map(|link| self.links[link].as_str())
    }
}

impl Poses<'_> {
    /// Axis of a joint as a motion.
    fn axis(&self, index: usize) -> Motion {
        let (axis, origin) = &self.axes[index];
        match self.body.joints[index].kind {
            JointKind::Prismatic => Motion { angular: Vector3::zeros(), linear: *axis },
            _ => Motion { angular: *axis, linear: origin.coords.cross(axis) },
        }
    }

    fn placed(&self, link: usize) -> Option<Placed> {
        self.body.inertias[link].as_ref().map(|inertia| Placed::new(inertia, &self.links[link]))
    }

    /// Velocity of each link for the velocities of the coordinates \[rad/s\] or \[m/s\]; those that are missing are 0.
    fn velocities(&self, rates: &[f64]) -> Vec<Motion> {
        let mut velocities = vec![Motion::zero(); self.links.len()];
        for index in &self.body.order {
            let joint = &self.body.joints[*index];
            let rate = joint.moved_by.map_or(0.0, |by| by.multiplier * rate(rates, by.coordinate));
            velocities[joint.child] = velocities[joint.parent].plus(&self.axis(*index), rate);
        }
        velocities
    }

    /// Momentum of the body, how it changes by itself, and its weight, for joint velocities \[rad/s\] or \[m/s\]. `gravity` \[m/s²\] is in
    /// the frame of the root.
    #[must_use]
    pub fn momentum(&self, rates: &[f64], gravity: &Vector3<f64>) -> Momentum {
        let velocities = self.velocities(rates);
        let n = self.body.coordinates.len();
        let (mut momenta, mut weights) =
            (vec![Wrench::zero(); self.links.len()], vec![Wrench::zero(); self.links.len()]);
        let mut energy = 0.0;
        for (link, velocity) in velocities.iter().enumerate() {
            if let Some(inertia) = self.placed(link) {
                momenta[link] = inertia.times(velocity);
                weights[link] = Wrench::of_force(gravity * inertia.mass, Point3::from(inertia.center));
                energy += 0.5 * velocity.dot(&momenta[link]);
            }
        }
        let mut found =
            Momentum { generalized: vec![0.0; n], kinetic: vec![0.0; n], weight: vec![0.0; n], energy };
        for index in self.body.order.iter().rev() {
            let joint = &self.body.joints[*index];
            let (momentum, weight) = (momenta[joint.child], weights[joint.child]);
            if let Some(by) = joint.moved_by {
                let axis = self.axis(*index);
                found.generalized[by.coordinate] += by.multiplier * axis.dot(&momentum);
                found.weight[by.coordinate] += by.multiplier * axis.dot(&weight);
                found.kinetic[by.coordinate] +=
                    by.multiplier * velocities[joint.parent].cross(&axis).dot(&momentum);
            }
            momenta[joint.parent] += momentum;
            weights[joint.parent] += weight;
        }
        found
    }

    /// Torques \[N m\], forces \[N\] at prismatic joints, that drives need for a motion against gravity: M q̈ + C q̇ − g. `rates` and
    /// `accelerations` are of the coordinates, `gravity` \[m/s²\] is in the frame of the root.
    #[must_use]
    pub fn inverse_dynamics(&self, rates: &[f64], accelerations: &[f64], gravity: &Vector3<f64>) -> Vec<f64> {
        let velocities = self.velocities(rates);
        let mut changes = vec![Motion::zero(); self.links.len()];
        // A root that is lifted against gravity feels as one that stands in it.
        changes[self.body.root].linear = -gravity;
        for index in &self.body.order {
            let joint = &self.body.joints[*index];
            let axis = self.axis(*index);
            let mut change = changes[joint.parent];
            if let Some(by) = joint.moved_by {
                let turned = velocities[joint.child].cross(&axis);
                change = change
                    .plus(&axis, by.multiplier * rate(accelerations, by.coordinate))
                    .plus(&turned, by.multiplier * rate(rates, by.coordinate));
            }
            changes[joint.child] = change;
        }
        let mut forces = vec![Wrench::zero(); self.links.len()];
        for link in 0..self.links.len() {
            if let Some(inertia) = self.placed(link) {
                let velocity = &velocities[link];
                forces[link] = inertia.times(&changes[link]) + velocity.cross_force(&inertia.times(velocity));
            }
        }
        let mut torques = vec![0.0; self.body.coordinates.len()];
        for index in self.body.order.iter().rev() {
            let joint = &self.body.joints[*index];
            let force = forces[joint.child];
            if let Some(by) = joint.moved_by {
                torques[by.coordinate] += by.multiplier * self.axis(*index).dot(&force);
            }
            forces[joint.parent] += force;
        }
        torques
    }
}

fn rate(rates: &[f64], coordinate: usize) -> f64 {
    rates.get(coordinate).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
