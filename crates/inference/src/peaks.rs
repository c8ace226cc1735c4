//! A displacement map → contacts.

use dermis_inversion::{PeakFinder, PeakSettings, suppress};
use dermis_model::tangents;
use dermis_skin::{Contact, ForceComponents, Surface};

use crate::bundle::{Bundle, BundleError};
use crate::model::{Model, ModelError};
use crate::runtime::Runtime;

mod section;

pub use section::{MAP_DISPLACEMENT, PeakSection};

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
