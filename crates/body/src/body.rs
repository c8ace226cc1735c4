//! Links and joints as one tree.

use nalgebra::{Isometry3, Unit, Vector3};

use crate::dynamics::Inertia;

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Not at all.
    Fixed,
    /// Turns about its axis between limits \[rad\].
    Revolute,
    /// Turns about its axis without limits \[rad\].
    Continuous,
    /// Slides along its axis \[m\].
    Prismatic,
}

/// What a joint may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// \[rad\] or \[m\] least position.
    pub lower: f64,
    /// \[rad\] or \[m\] largest position.
    pub upper: f64,
    /// \[rad/s\] or \[m/s\]
    pub velocity: f64,
    /// \[N m\] or \[N\]
    pub effort: f64,
}

/// What a joint's motion takes of its drive's effort before anything moves: `<dynamics>` of a URDF.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Friction {
    /// \[N m\] or \[N\] against the direction of motion, whatever the speed.
    pub coulomb: f64,
    /// \[N m s/rad\] or \[N s/m\] in proportion to the speed.
    pub viscous: f64,
}

/// A joint that follows another: its position is `multiplier` × that of the other + `offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mimic {
    /// Index of the coordinate of the joint that it follows in the end (one that follows nobody).
    pub coordinate: usize,
    /// Factor over the whole chain of followers.
    pub multiplier: f64,
    /// \[rad\] or \[m\] over the whole chain of followers.
    pub offset: f64,
}

/// A joint between two links.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name, unique in the body.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// Index of the link that carries it.
    pub parent: usize,
    /// Index of the link that it carries.
    pub child: usize,
    /// `parent_from_joint` at position 0.
    pub origin: Isometry3<f64>,
    /// Unit, in the frame of the joint.
    pub axis: Unit<Vector3<f64>>,
    /// Where it has any.
    pub limits: Option<Limits>,
    /// 0 where the file does not tell.
    pub friction: Friction,
    /// Which coordinate moves it, and how; `None` for fixed joints. A joint that follows nobody has factor 1 and offset 0.
    pub moved_by: Option<Mimic>,
}

/// The links of a robot and the joints between them: a tree with one root.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    pub(crate) name: String,
    pub(crate) links: Vec<String>,
    /// One a link; `None` where the file does not tell.
    pub(crate) inertias: Vec<Option<Inertia>>,
    pub(crate) joints: Vec<Joint>,
    /// Joint above each link; `None` for the root.
    pub(crate) above: Vec<Option<usize>>,
    /// Joints, those nearer to the root first.
    pub(crate) order: Vec<usize>,
    pub(crate) root: usize,
    /// Joints whose positions are free: they move and follow nobody.
    pub(crate) coordinates: Vec<usize>,
}

impl Body {
    /// Name of the robot.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Names of all links, in the order of the file.
    #[must_use]
    pub fn links(&self) -> &[String] {
        &self.links
    }

    /// Index of a link.
    #[must_use]
    pub fn link(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|link| link == name)
    }

    /// All joints, in the order of the file.
    #[must_use]
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Index of the link that no joint carries.
    #[must_use]
    pub fn root(&self) -> usize {
        self.root
    }

    /// Joint that carries a link; `None` for the root.
    #[must_use]
    pub fn joint_above(&self, link: usize) -> Option<&Joint> {
        self.above[link].map(|joint| &self.joints[joint])
    }

    /// The free joints: those that move and follow no other. Positions are given in this order.
    pub fn coordinates(&self) -> impl ExactSizeIterator<Item = &Joint> {
        self.coordinates.iter().map(|joint| &self.joints[*joint])
    }

    /// The topmost link that is rigidly connected with `link` (over fixed joints only), and the pose of `link` in its frame:
    /// `top_from_link`. It depends on no joint position.
    #[must_use]
    pub fn rigid_top(&self, link: usize) -> (usize, Isometry3<f64>) {
        let (mut top, mut pose) = (link, Isometry3::identity());
        while let Some(joint) = self.joint_above(top).filter(|joint| joint.kind == JointKind::Fixed) {
            pose = joint.origin * pose;
            top = joint.parent;
        }
        (top, pose)
    }
}
