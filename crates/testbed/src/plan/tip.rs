//! The tip that a plan presses with, where it is no sphere, and how it stands.

use dermis_model::{Tip, TipShape};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Shape of the indenter's tip and how it stands on the surface, as the key `tip` of a plan says it:
/// `tip = { shape = { shape = "wedge", angle = 1.0, length = 0.01 }, turn = 0.5 }`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanTip {
    /// Shape and size.
    pub shape: TipShape,
    /// \[rad\] about the outward normal, from the first [tangent](tangents) of the surface (x on a flat one).
    #[serde(default)]
    pub turn: f64,
    /// \[rad\] about the tip's own x axis, after it was turned.
    #[serde(default)]
    pub tilt: f64,
}

impl PlanTip {
    /// The field that is wrong, and why.
    pub(super) fn check(&self) -> Result<(), (String, String)> {
        for (field, value) in [("tip.turn", self.turn), ("tip.tilt", self.tilt)] {
            // More than a quarter of a turn of tilt, and the tip would press with its back.
            let most = if field == "tip.tilt" { std::f64::consts::FRAC_PI_2 } else { 1e3 };
            if !(-most..=most).contains(&value) {
                return Err((field.to_owned(), format!("is {value} rad and must be -{most} to {most} rad")));
            }
        }
        self.shape.check().map_err(|reason| ("tip.shape".to_owned(), reason))
    }

    /// The tip where the surface has this outward normal.
    #[must_use]
    pub fn on(&self, normal: &Vector3<f64>) -> Tip {
        let orientation = Tip::standing(self.shape, normal).orientation
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.turn)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), self.tilt);
        Tip { shape: self.shape, orientation }
    }
}
