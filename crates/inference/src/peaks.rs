//! A displacement map → contacts.

use dermis_inversion::{PeakFinder, PeakSettings, suppress};
use dermis_skin::{Contact, ForceComponents, Surface, tangents};
use serde::{Deserialize, Serialize};

use crate::bundle::{Bundle, BundleError};
use crate::interface::Interface;
use crate::manifest::ModelSection;
use crate::model::{Model, ModelError};
use crate::runtime::Runtime;

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
    /// \[m\] root mean square error of places along either tangent, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_sigma: Option<f64>,
    /// \[N\] root mean square error of forces, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_sigma: Option<f64>,
    /// The file `sensitivity.onnx`: x, y, z \[m\] and displacement \[m\] of a peak → pressing force \[N\].
    pub sensitivity: ModelSection,
}

impl PeakSection {
    /// Between what the inputs of a sensitivity network plausibly lie: places on a skin of a robot \[m\], and how far it gives way
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

/// Reads contacts off maps; the neighbourhoods of the surface are found once.
#[derive(Debug)]
pub struct MapContacts {
    finder: PeakFinder,
    section: PeakSection,
    sensitivity: Model,
    raw: Vec<f32>,
}

impl MapContacts {
    /// For the maps of a bundle; `None` where it has no `[peaks]`.
    ///
    /// # Errors
    ///
    /// [`BundleError`] where the runtime refuses the sensitivity network.
    pub fn of(bundle: &Bundle, surface: &Surface, runtime: &Runtime) -> Result<Option<Self>, BundleError> {
        let Some(section) = &bundle.manifest().peaks else { return Ok(None) };
        let Some(sensitivity) = bundle.sensitivity(runtime)? else { return Ok(None) };
        Ok(Some(Self::new(section.clone(), sensitivity, surface)))
    }

    /// With a sensitivity network that is already loaded.
    #[must_use]
    pub fn new(section: PeakSection, sensitivity: Model, surface: &Surface) -> Self {
        let finder = PeakFinder::new(surface, section.settings.radius);
        Self { finder, section, sensitivity, raw: Vec::new() }
    }

    /// Uses other settings from the next map on; the radius stays.
    pub fn set(&mut self, settings: &PeakSettings) {
        self.section.settings = PeakSettings { radius: self.section.settings.radius, ..settings.clone() };
    }

    /// Which peaks are contacts.
    #[must_use]
    pub fn settings(&self) -> &PeakSettings {
        &self.section.settings
    }

    /// \[N\] root mean square error of its forces, where it was measured.
    #[must_use]
    pub fn force_sigma(&self) -> Option<f64> {
        self.section.force_sigma
    }

    /// Every peak of a map \[m\] above the least displacement, as a contact with its force; the highest peak first. None
    /// is suppressed yet.
    ///
    /// # Errors
    ///
    /// [`ModelError`] where the sensitivity network fails.
    pub fn candidates(&mut self, map: &[f64]) -> Result<Vec<Contact>, ModelError> {
        let weights = &self.section.weights;
        let mut peaks = if weights.len() == map.len() {
            let weighted: Vec<f64> = map.iter().zip(weights).map(|(d, w)| d * f64::from(*w)).collect();
            self.finder.find(&weighted, 0.0)
        } else {
            self.finder.find(map, 0.0)
        };
        for peak in &mut peaks {
            peak.displacement = map[peak.point];
        }
        peaks.retain(|p| p.displacement > self.section.settings.least_displacement);
        // Ripples are many where a map is little but noise; each costs one run.
        let most = 4 * self.section.settings.most;
        let mut contacts = Vec::with_capacity(peaks.len().min(most));
        for peak in peaks.into_iter().take(most) {
            let p = peak.position;
            let input = [p.x as f32, p.y as f32, p.z as f32, peak.displacement as f32];
            self.sensitivity.run(&input, &mut self.raw)?;
            let force = self.raw.first().copied().map_or(f64::NAN, f64::from);
            let mut contact = Contact::at(peak.position, peak.normal);
            contact.force = -peak.normal * force;
            contact.force_components = ForceComponents::Normal;
            let sigma = self.section.position_sigma.unwrap_or(f64::NAN);
            let along = tangents(&peak.normal).map(|t| t * t.transpose() * (sigma * sigma));
            contact.position_covariance = along[0] + along[1];
            let sigma = self.section.force_sigma.unwrap_or(f64::NAN);
            contact.force_covariance = peak.normal * peak.normal.transpose() * (sigma * sigma);
            contacts.push(contact);
        }
        Ok(contacts)
    }

    /// Contacts of a map \[m\], the strongest first; empty for a map of another surface.
    ///
    /// # Errors
    ///
    /// As [`candidates`](Self::candidates).
    pub fn contacts(&mut self, map: &[f64]) -> Result<Vec<Contact>, ModelError> {
        let all = self.candidates(map)?;
        let forces: Vec<f64> = all.iter().map(Contact::normal_force).collect();
        Ok(suppress(&forces, &self.section.settings).into_iter().map(|i| all[i].clone()).collect())
    }
}
