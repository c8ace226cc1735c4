//! Contacts as the peaks of a displacement map that a bundle gives.

use dermis_inference::{Bundle, Features, MAP_DISPLACEMENT, MapContacts, Model, Outputs, Runtime};
use dermis_inversion::PeakSettings;
use dermis_skin::{Contact, Surface};

use super::{ConditionedFrame, ContactFinder, FindError};

/// Peaks of the map of a bundle.
pub struct MapFinder {
    features: Features,
    model: Model,
    outputs: Outputs,
    peaks: MapContacts,
    raw: Vec<f32>,
}

impl MapFinder {
    /// A finder on `surface`, the skin's.
    ///
    /// # Errors
    ///
    /// [`FindError`] where the bundle has no map, or cannot be loaded into the runtime.
    pub fn new(bundle: &Bundle, surface: &Surface, runtime: &Runtime) -> Result<Self, FindError> {
        let Some(peaks) = MapContacts::of(bundle, surface, runtime)? else {
            return Err(FindError::NoPeaks(bundle.path().display().to_string()));
        };
        let (model, outputs) = (bundle.session(runtime)?, bundle.outputs());
        Ok(Self { features: bundle.features(), model, outputs, peaks, raw: Vec::new() })
    }

    /// How peaks are told from noise.
    pub fn set(&mut self, settings: &PeakSettings) {
        self.peaks.set(settings);
    }

    /// The map \[m\] of a frame, one number a point of the surface.
    ///
    /// # Errors
    ///
    /// [`FindError`] where the model fails, or looks at several frames.
    pub fn map(&mut self, frame: &ConditionedFrame<'_>) -> Result<&[f64], FindError> {
        self.features.reset();
        self.features.push(frame.stamp, frame.signal)?;
        let input = self.features.input().ok_or(FindError::History)?;
        self.model.run(input, &mut self.raw)?;
        self.outputs.decode(&self.raw)?;
        Ok(self.outputs.values(MAP_DISPLACEMENT).unwrap_or_default())
    }
}

impl ContactFinder for MapFinder {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        let map = self.map(frame)?.to_vec();
        Ok(self.peaks.contacts(&map)?)
    }
}
