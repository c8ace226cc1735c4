//! Which finder reads a bundle: the one place that decides it.
//!
//! | the manifest has | contacts are |
//! |---|---|
//! | `[force_peaks]`, or `[peaks]` without `[inversion]` | the peaks of the bundle's map ([`MapFinder`]) |
//! | neither | one contact of its position and force ([`NetworkFinder`]) |
//! | `[inversion]` besides | those of maximum likelihood, begun at the former ([`InversionFinder`]) |
//!
//! A node may load several bundles that share the work, so that its estimator holds pipelines and no finders. It decides by
//! the same function, `reads_peaks`, and makes contacts with the same functions.

use std::sync::Arc;

use dermis_inference::{Bundle, Runtime};
use dermis_model::ForwardModel;
use dermis_skin::{ModelError, SkinDescription};

use super::{ContactFinder, InversionFinder, MapFinder, NetworkFinder, Start};
use crate::models::{Pipeline, SetupError, inverter};

impl Pipeline {
    /// Whether contacts are the peaks of its map. Peaks of displacements are no starts of a forward model, so that what is `refined`
    /// does without them.
    pub(crate) fn reads_peaks(&self, refined: bool) -> bool {
        self.peaks.as_ref().is_some_and(|peaks| !refined || peaks.are_starts())
    }
}

/// The finder that gives the contacts that a node with this bundle gives: of its outputs, refined on the forward model where its
/// manifest asks for that, from frame to frame where its settings [follow](dermis_inversion::Settings::follows) contacts. `model`
/// is called only then.
///
/// # Errors
///
/// [`SetupError`] where the bundle does not fit the skin or its forward model, or the runtime refuses it.
pub fn finder_of(
    bundle: &Bundle,
    skin: &SkinDescription,
    model: impl FnOnce() -> Result<Arc<dyn ForwardModel>, ModelError>,
    runtime: &Runtime,
) -> Result<Box<dyn ContactFinder>, SetupError> {
    let Some(inverter) = inverter(bundle, model)? else { return learned(bundle, skin, runtime, false) };
    let start = Start::Bundle(learned(bundle, skin, runtime, true)?);
    Ok(Box::new(InversionFinder::new(inverter, start).following()))
}

/// The finder of what a bundle gives by itself, whether or not a forward model would refine it; `None` where nothing was learned.
///
/// # Errors
///
/// As [`finder_of`].
pub fn learned_finder_of(
    bundle: &Bundle,
    skin: &SkinDescription,
    runtime: &Runtime,
) -> Result<Option<Box<dyn ContactFinder>>, SetupError> {
    bundle.manifest().model.as_ref().map(|_| learned(bundle, skin, runtime, false)).transpose()
}

fn learned(
    bundle: &Bundle,
    skin: &SkinDescription,
    runtime: &Runtime,
    refined: bool,
) -> Result<Box<dyn ContactFinder>, SetupError> {
    let surface = skin.surface();
    let pipeline = Pipeline::of(bundle, &surface, runtime)?;
    if pipeline.reads_peaks(refined) {
        return Ok(Box::new(MapFinder::with(pipeline, surface)));
    }
    Ok(Box::new(NetworkFinder::with(pipeline, skin, surface)))
}
