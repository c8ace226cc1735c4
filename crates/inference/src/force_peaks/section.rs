//! What a manifest says of force maps.

use serde::{Deserialize, Serialize};

/// Output of a bundle that gives the pressing force \[N\] on every point of the surface.
pub const MAP_NORMAL: &str = "map.normal";

/// How contacts are read off the force map that a bundle gives ([`MAP_NORMAL`]). The `[force_peaks]` table of its manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForcePeakSection {
    /// \[m\] diameter of the disc in which a contact is the largest pressure.
    pub disc: f64,
    /// \[N\] that a disc bears at least where it is a contact.
    pub threshold: f64,
    /// Contacts at most.
    pub most: usize,
    /// \[m\] root mean square error of locations along either tangent, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_sigma: Option<f64>,
    /// \[N\] root mean square error of forces, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_sigma: Option<f64>,
}

impl ForcePeakSection {
    /// Says what is impossible: field and reason.
    ///
    /// # Errors
    ///
    /// The field of this table, and what it must be.
    pub(crate) fn check(&self) -> Result<(), (&'static str, String)> {
        if !(self.disc.is_finite() && self.disc > 0.0) {
            return Err(("disc", format!("is {} m and must be a positive length", self.disc)));
        }
        if !(1..=10).contains(&self.most) {
            return Err(("most", format!("is {} and must be 1 to 10", self.most)));
        }
        let not_negative = [
            ("threshold", Some(self.threshold)),
            ("position_sigma", self.position_sigma),
            ("force_sigma", self.force_sigma),
        ];
        for (field, value) in not_negative {
            if value.is_some_and(|v| !(v.is_finite() && v >= 0.0)) {
                return Err((field, "must be 0 or positive".into()));
            }
        }
        Ok(())
    }
}
