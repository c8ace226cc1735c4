//! What an estimator answers.

use nalgebra::{Matrix3, Point3, Vector3};

/// Which components of a contact's force are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ForceComponents {
    /// None: the force is NaN.
    #[default]
    None,
    /// Only the one along the normal; the others are 0.
    Normal,
    /// Each for itself; one that is not measured, as where a load cell has one axis, is NaN.
    Full,
}

/// One contact, in the frame of the skin's link.
#[derive(Debug, Clone, PartialEq)]
pub struct Contact {
    /// The same from frame to frame while the contact lasts; 0 before tracking.
    pub track_id: u32,
    /// \[m\] on the skin's surface; NaN where the model gives no position.
    pub position: Point3<f64>,
    /// Unit, out of the skin.
    pub normal: Vector3<f64>,
    /// \[N\] that the environment exerts on the skin; pushing in means `force · normal < 0`.
    pub force: Vector3<f64>,
    /// Which components of `force` are measured.
    pub force_components: ForceComponents,
    /// \[m²\]; NaN where unknown.
    pub position_covariance: Matrix3<f64>,
    /// \[N²\]; NaN where unknown.
    pub force_covariance: Matrix3<f64>,
    /// \[m\] of the contact patch; NaN where unknown.
    pub diameter: f32,
    /// 0..1 that this is a contact.
    pub confidence: f32,
    /// Taxels that carry its signal, by index.
    pub taxels: Vec<u32>,
}

impl Contact {
    /// A contact at `position` of which nothing else is known.
    #[must_use]
    pub fn at(position: Point3<f64>, normal: Vector3<f64>) -> Self {
        Self {
            track_id: 0,
            position,
            normal,
            force: Vector3::repeat(f64::NAN),
            force_components: ForceComponents::None,
            position_covariance: Matrix3::repeat(f64::NAN),
            force_covariance: Matrix3::repeat(f64::NAN),
            diameter: f32::NAN,
            confidence: 1.0,
            taxels: Vec::new(),
        }
    }

    /// Pressing force \[N\], positive when the skin is pushed in; NaN where the force is not measured.
    #[must_use]
    pub fn normal_force(&self) -> f64 {
        // A component across the normal may be unknown, and NaN · 0 is NaN.
        let along = self.force.iter().zip(&self.normal).filter(|(_, n)| **n != 0.0);
        -along.map(|(f, n)| f * n).sum::<f64>()
    }
}

/// Forces on the points of a [`Surface`](crate::Surface).
#[derive(Debug, Clone, PartialEq)]
pub enum ForceValues {
    /// \[N\] along the inward normal, positive when pressed; one a point.
    Normal(Vec<f32>),
    /// \[N\] exerted on the skin, in the link frame; one a point.
    Vector(Vec<[f32; 3]>),
}

/// Force distribution over the skin.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceMap {
    /// Points that the values belong to, by index; `None`: all points in order.
    pub indices: Option<Vec<u32>>,
    /// The forces.
    pub forces: ForceValues,
}

/// How far the points of a [`Surface`](crate::Surface) give way.
#[derive(Debug, Clone, PartialEq)]
pub struct DisplacementMap {
    /// Points that the values belong to, by index; `None`: all points in order.
    pub indices: Option<Vec<u32>>,
    /// \[m\] inwards along the normal, positive where the skin is pushed in; one a point.
    pub displacements: Vec<f32>,
}

/// What an estimator makes of one frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Estimate {
    /// All contacts; empty means "not touched".
    pub contacts: Vec<Contact>,
    /// Where the model gives one.
    pub force_map: Option<ForceMap>,
    /// Where the model gives one.
    pub displacement_map: Option<DisplacementMap>,
}
