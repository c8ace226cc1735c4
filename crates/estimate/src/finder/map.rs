//! Contacts as the peaks of a map that a bundle gives: of displacements, or of forces.

use dermis_inference::{
    Bundle, BundleError, ForceMapContacts, MAP_DISPLACEMENT, MAP_NORMAL, MapContacts, Runtime,
};
use dermis_skin::{Contact, Estimate, ImageGrid, SkinDescription, Surface};

use super::{ConditionedFrame, ContactFinder, FindError, GivenMaps, spread_forces};
use crate::models::{Pipeline, SetupError};

/// Reads contacts off the map that a bundle gives.
pub(crate) enum Peaks {
    /// Of displacements.
    Displacement(MapContacts),
    /// Of forces.
    Force(ForceMapContacts),
}

impl Peaks {
    /// What a bundle asks for on a surface; `None` where its manifest has neither `[peaks]` nor `[force_peaks]`.
    pub(crate) fn of(
        bundle: &Bundle,
        surface: &Surface,
        runtime: &Runtime,
    ) -> Result<Option<Self>, BundleError> {
        if let Some(section) = &bundle.manifest().force_peaks {
            return Ok(Some(Self::Force(ForceMapContacts::new(section.clone(), surface))));
        }
        Ok(MapContacts::of(bundle, surface, runtime)?.map(Self::Displacement))
    }

    /// \[N\] root mean square error of their forces, where it was measured.
    pub(crate) fn force_sigma(&self) -> Option<f64> {
        match self {
            Self::Displacement(contacts) => contacts.force_sigma(),
            Self::Force(contacts) => contacts.force_sigma(),
        }
    }

    /// Whether a forward model can be begun at all of them together. Peaks of displacements are contacts by themselves.
    pub(crate) fn are_starts(&self) -> bool {
        matches!(self, Self::Force(_))
    }
}

/// The peaks of the map that a model gave last, as contacts, the strongest first; none where its bundle names no peaks.
pub(crate) fn peaks(pipeline: &mut Pipeline) -> Result<Vec<Contact>, String> {
    let Pipeline { peaks, outputs, path, .. } = pipeline;
    let map = |output| outputs.values(output).unwrap_or_default();
    match peaks {
        None => Ok(Vec::new()),
        Some(Peaks::Displacement(contacts)) => {
            contacts.contacts(map(MAP_DISPLACEMENT)).map_err(|e| format!("model {}: {e}", path.display()))
        }
        Some(Peaks::Force(contacts)) => Ok(contacts.contacts(map(MAP_NORMAL))),
    }
}

/// Peaks of the map of a bundle.
pub struct MapFinder {
    pipeline: Pipeline,
    surface: Surface,
}

impl MapFinder {
    /// A finder on a skin.
    ///
    /// # Errors
    ///
    /// [`SetupError`] where the bundle has no peaks, does not fit the surface, or cannot be loaded into the runtime.
    pub fn new(bundle: &Bundle, skin: &SkinDescription, runtime: &Runtime) -> Result<Self, SetupError> {
        let surface = skin.surface();
        let pipeline = Pipeline::of(bundle, &surface, runtime)?;
        if pipeline.peaks.is_none() {
            return Err(SetupError::NoPeaks { path: pipeline.path });
        }
        Ok(Self::with(pipeline, surface))
    }

    pub(super) fn with(pipeline: Pipeline, surface: Surface) -> Self {
        Self { pipeline, surface }
    }

    /// The map of displacements \[m\] of a frame, one number a point of the surface; empty where the bundle gives forces.
    ///
    /// # Errors
    ///
    /// [`FindError`] where the model fails, or has not seen enough frames.
    pub fn map(&mut self, frame: &ConditionedFrame<'_>) -> Result<&[f64], FindError> {
        self.pipeline.answer(frame)?;
        Ok(self.pipeline.outputs.values(MAP_DISPLACEMENT).unwrap_or_default())
    }
}

impl ContactFinder for MapFinder {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        self.pipeline.answer(frame)?;
        peaks(&mut self.pipeline).map_err(FindError::Model)
    }

    fn given_maps(&self) -> GivenMaps {
        GivenMaps::of(&self.pipeline.outputs)
    }

    fn estimate(&mut self, frame: &ConditionedFrame<'_>) -> Result<Estimate, FindError> {
        let contacts = self.find(frame)?;
        let GivenMaps { force, displacement } = self.given_maps();
        let force = force.unwrap_or_else(|| spread_forces(&self.surface, &contacts, false));
        Ok(Estimate { contacts, force_map: Some(force), displacement_map: displacement })
    }

    fn pass(&mut self, frame: &ConditionedFrame<'_>) -> Result<(), FindError> {
        self.pipeline.take(frame)
    }

    fn reset(&mut self) {
        self.pipeline.features.reset();
    }

    fn image(&self) -> Option<ImageGrid> {
        self.pipeline.features.config().image
    }

    fn complete(&self) -> bool {
        self.pipeline.peaks.as_ref().is_some_and(Peaks::are_starts)
    }
}
