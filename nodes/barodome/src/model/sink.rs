//! How deep tips sink in.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

use dermis_mechanics::{Medium, SphereContacts};
use dermis_model::Indentation;
use dermis_skin::{ModelError, SkinDescription, SurfaceSpec};
use nalgebra::Point3;

use crate::parameters::Parameters;

/// \[N\] up to which contacts are solved.
const FORCE_MAX: f64 = 5.0;
/// Diameters whose contacts are kept.
const KEPT: usize = 32;

/// Contacts of spherical tips with the elastomer, solved when they are requested.
#[derive(Debug)]
pub(super) struct Sink {
    medium: Medium,
    surface: SurfaceSpec,
    /// Bits of an effective diameter → what is known of it.
    contacts: RwLock<BTreeMap<u64, Option<Arc<SphereContacts>>>>,
}

impl Sink {
    /// # Errors
    ///
    /// [`ModelError::Description`] where the elastomer cannot be.
    pub(super) fn new(skin: &SkinDescription, parameters: &Parameters) -> Result<Self, ModelError> {
        let Parameters { young_modulus, poisson_ratio, thickness, slip, .. } = *parameters;
        let medium = Medium::mixed(young_modulus, poisson_ratio, thickness, slip)
            .map_err(|e| skin.refusal("medium", e.to_string()))?;
        Ok(Self { medium, surface: parameters.surface.clone(), contacts: RwLock::default() })
    }

    /// Contacts of a tip of `diameter` \[m\] at a point of the surface; `None` for a tip that the theory cannot speak of.
    pub(super) fn contacts(&self, at: &Point3<f64>, diameter: f64) -> Option<Arc<SphereContacts>> {
        if !Indentation::DIAMETERS.contains(&diameter) {
            return None;
        }
        // Two spheres touch like one of the sum of their curvatures on a plane; a cylinder has the mean of both of its.
        let curvature = match self.surface {
            SurfaceSpec::Rectangle { .. }
            | SurfaceSpec::Panel { .. }
            | SurfaceSpec::Mesh { .. }
            | SurfaceSpec::Family(_) => 0.0,
            SurfaceSpec::Dome { radius, cylinder, .. } if at.z < cylinder => 0.5 / radius,
            SurfaceSpec::Dome { radius, .. } => 1.0 / radius,
        };
        let diameter = 2.0 / (2.0 / diameter + curvature);
        let key = diameter.to_bits();
        if let Some(known) = self.contacts.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return known.clone();
        }
        let solved = SphereContacts::new(&self.medium, diameter, FORCE_MAX).ok().map(Arc::new);
        let mut kept = self.contacts.write().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= KEPT {
            kept.clear();
        }
        kept.insert(key, solved.clone());
        solved
    }
}
