//! The `[peaks]` table of a bundle's manifest.

use dermis_inversion::PeakSettings;
use serde::{Deserialize, Serialize};

use crate::interface::Interface;
use crate::manifest::ModelSection;

/// Output of a bundle that gives how far every point of the surface gives way \[m\].
pub const MAP_DISPLACEMENT: &str = "map.displacement";

/// How contacts are read off the map that a bundle gives ([`MAP_DISPLACEMENT`]). The `[peaks]` table of its manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeakSection {
    /// Which peaks are contacts.
    pub settings: PeakSettings,
    /// Of every point of the surface: what its displacement is multiplied by before peaks are looked for; empty: 1. One over
    /// the root of what a point gives way by itself puts the peak of one contact where that contact is, on a surface
    /// that is softer elsewhere, too: of a positive definite matrix, no entry of a column is larger than the root of the product
    /// of both entries of the diagonal. 0 for points that are rigid.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub weights: Vec<f32>,
    /// \[m\] root mean square error of locations along either tangent, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_sigma: Option<f64>,
    /// \[N\] root mean square error of forces, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_sigma: Option<f64>,
    /// The file `sensitivity.onnx`: x, y, z \[m\] and displacement \[m\] of a peak → pressing force \[N\].
    pub sensitivity: ModelSection,
}

impl PeakSection {
    /// Between what the inputs of a sensitivity network plausibly lie: locations on a skin of a robot \[m\], and how far it gives way
    /// there \[m\].
    pub(crate) const RANGES: [[f32; 2]; 4] = [[-0.1, 0.1], [-0.1, 0.1], [-0.1, 0.1], [0.0, 1e-3]];

    /// What a sensitivity network takes and gives.
    #[must_use]
    pub fn interface() -> Interface {
        Interface::flat(4, 1)
    }

    /// Says what is impossible: field and reason.
    ///
    /// # Errors
    ///
    /// The path of the field in this table, and what it must be.
    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        self.settings.check().map_err(|(field, reason)| (format!("settings.{field}"), reason))?;
        for (field, value) in [("position_sigma", self.position_sigma), ("force_sigma", self.force_sigma)] {
            if value.is_some_and(|v| !(v.is_finite() && v >= 0.0)) {
                return Err((field.into(), "must be 0 or positive".into()));
            }
        }
        if let Some(i) = self.weights.iter().position(|w| !(w.is_finite() && *w >= 0.0)) {
            return Err((format!("weights[{i}]"), "must be 0 or positive".into()));
        }
        let interface = &self.sensitivity.interface;
        if *interface != Self::interface() {
            return Err((
                "sensitivity.interface".into(),
                "must take `input` [1, 4] and give `output` [1, 1]".into(),
            ));
        }
        Ok(())
    }
}
