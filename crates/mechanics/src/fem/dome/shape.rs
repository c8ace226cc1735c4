//! The shape of an elastomer on a rigid core, and the chart of its outside: arc from the tip and angle about the axis.

use std::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::{Point3, Vector3};

use crate::MechanicsError;
use crate::error::positive;

/// Where the elastomer lies: the tip is up, the origin in the base of the cylinder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DomeShape {
    /// \[m\] of the outer hemisphere and the outer cylinder.
    pub radius: f64,
    /// \[m\] height of the cylinder.
    pub cylinder: f64,
    /// \[m\] of elastomer between the core and the outside.
    pub thickness: f64,
}

impl DomeShape {
    /// Arc \[m\] from the tip down to the foot of the cylinder.
    #[must_use]
    pub fn length(&self) -> f64 {
        FRAC_PI_2 * self.radius + self.cylinder
    }

    /// Arc from the tip \[m\] and angle about the axis \[rad\], in \[0, 2π), of a point on the outside.
    #[must_use]
    pub fn chart(&self, point: &Point3<f64>) -> [f64; 2] {
        let (r, above) = (point.x.hypot(point.y), point.z - self.cylinder);
        let arc = if above > 0.0 { self.radius * r.atan2(above) } else { FRAC_PI_2 * self.radius - above };
        let angle = point.y.atan2(point.x);
        [arc, if angle < 0.0 { angle + TAU } else { angle }]
    }

    /// Point at an arc and an angle, as [`chart`](Self::chart) has them.
    #[must_use]
    pub fn point(&self, [arc, angle]: [f64; 2]) -> Point3<f64> {
        let (r, z) = self.meridian(arc, self.radius);
        Point3::new(r * angle.cos(), r * angle.sin(), z)
    }

    /// Unit, out of the surface, at the point of the outside that is nearest to `point`; up where that is none.
    #[must_use]
    pub fn normal(&self, point: &Point3<f64>) -> Vector3<f64> {
        Vector3::new(point.x, point.y, (point.z - self.cylinder).max(0.0))
            .try_normalize(1e-12)
            .unwrap_or_else(Vector3::z)
    }

    /// \[m\] from a point to the outside, positive in the body.
    #[must_use]
    pub fn depth(&self, point: &Point3<f64>) -> f64 {
        self.radius - point.x.hypot(point.y).hypot((point.z - self.cylinder).max(0.0))
    }

    /// Distance from the axis and height of the point that lies under `arc` at `radius` from the hemisphere's centre or
    /// the axis.
    pub(super) fn meridian(&self, arc: f64, radius: f64) -> (f64, f64) {
        let angle = arc / self.radius;
        if angle < FRAC_PI_2 {
            (radius * angle.sin(), self.cylinder + radius * angle.cos())
        } else {
            (radius, self.cylinder - (arc - FRAC_PI_2 * self.radius))
        }
    }

    pub(super) fn check(&self) -> Result<(), MechanicsError> {
        positive("radius of the dome [m]", self.radius)?;
        positive("height of the cylinder [m]", self.cylinder)?;
        positive("thickness [m]", self.thickness)?;
        if self.thickness < self.radius {
            Ok(())
        } else {
            Err(MechanicsError::Value {
                quantity: "thickness [m]",
                value: self.thickness,
                expected: "smaller than the radius of the dome",
            })
        }
    }
}
