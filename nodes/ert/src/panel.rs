//! Where things are on a panel: flat, or part of a cylinder, which unrolls to the plane of the sheet without stretch.

use dermis_skin::{SkinDescription, SurfaceSpec};
use nalgebra::{Point3, Vector3};

/// A rectangular panel about the origin (flat), or about the top of a cylinder that lies along x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Panel {
    /// \[m\] along x, and along y or the arc.
    pub size: [f64; 2],
    /// \[m\] of the outside; flat where absent.
    pub radius: Option<f64>,
}

impl Panel {
    /// That of a skin.
    ///
    /// # Errors
    ///
    /// A sentence where its surface is another one.
    pub fn of(skin: &SkinDescription) -> Result<Self, String> {
        match skin.surface {
            SurfaceSpec::Rectangle { size, .. } => Ok(Self { size, radius: None }),
            SurfaceSpec::Panel { size, radius, cells: [0, _] | [_, 0], .. } => {
                Ok(Self { size, radius: Some(radius) })
            }
            SurfaceSpec::Panel { .. } => {
                Err("has openings, and a sheet of fabric has none: leave `cells` out".into())
            }
            _ => Err("must be of type \"rectangle\" (flat) or \"panel\" (part of a cylinder)".into()),
        }
    }

    /// \[m\] in the plane of the sheet.
    #[must_use]
    pub fn unroll(&self, p: &Point3<f64>) -> [f64; 2] {
        match self.radius {
            None => [p.x, p.y],
            Some(radius) => [p.x, radius * p.y.atan2(p.z)],
        }
    }

    /// Point of the outside, and its normal.
    #[must_use]
    pub fn roll(&self, [x, s]: [f64; 2]) -> (Point3<f64>, Vector3<f64>) {
        match self.radius {
            None => (Point3::new(x, s, 0.0), Vector3::z()),
            Some(radius) => {
                let (sin, cos) = (s / radius).sin_cos();
                (Point3::new(x, radius * sin, radius * cos), Vector3::new(0.0, sin, cos))
            }
        }
    }

    /// Whether a place of the plane lies on it.
    #[must_use]
    pub fn holds(&self, at: [f64; 2]) -> bool {
        (0..2).all(|k| at[k].abs() <= self.size[k] / 2.0)
    }
}
