//! Contacts as the peaks of a displacement map that a bundle gives.

use dermis_inference::{Bundle, MAP_DISPLACEMENT, Runtime};
use dermis_skin::{Contact, ImageGrid, SkinDescription};

use super::{ConditionedFrame, ContactFinder, FindError};
use crate::models::{Pipeline, SetupError};

/// The peaks of the map that a model gave last, as contacts, the strongest first; none where its bundle names no peaks.
pub(crate) fn peaks(pipeline: &mut Pipeline) -> Result<Vec<Contact>, String> {
    let Pipeline { peaks, outputs, path, .. } = pipeline;
    let Some(peaks) = peaks else { return Ok(Vec::new()) };
    let map = outputs.values(MAP_DISPLACEMENT).unwrap_or_default();
    peaks.contacts(map).map_err(|e| format!("model {}: {e}", path.display()))
}

/// Peaks of the map of a bundle.
pub struct MapFinder {
    pipeline: Pipeline,
}

impl MapFinder {
    /// A finder on a skin.
    ///
    /// # Errors
    ///
    /// [`SetupError`] where the bundle has no peaks, does not fit the surface, or cannot be loaded into the runtime.
    pub fn new(bundle: &Bundle, skin: &SkinDescription, runtime: &Runtime) -> Result<Self, SetupError> {
        let pipeline = Pipeline::of(bundle, &skin.surface(), runtime)?;
        if pipeline.peaks.is_none() {
            return Err(SetupError::NoPeaks { path: pipeline.path });
        }
        Ok(Self { pipeline })
    }

    /// The map \[m\] of a frame, one number a point of the surface.
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

    fn pass(&mut self, frame: &ConditionedFrame<'_>) -> Result<(), FindError> {
        self.pipeline.take(frame)
    }

    fn reset(&mut self) {
        self.pipeline.features.reset();
    }

    fn image(&self) -> Option<ImageGrid> {
        self.pipeline.features.config().image
    }
}
