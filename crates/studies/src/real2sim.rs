//! Several contacts from few readings by way of a simulation, and who else could find them.
//!
//! Method (thesis, chapter 3): a simulation of many virtual sensors maps readings to displacements of the surface; recorded
//! single contacts teach the transfer from real to virtual sensors; contacts are peaks of the map. Beside it stand maximum
//! likelihood on the forward model, sparse recovery, and regressions.

pub mod compare;
pub mod table;
pub mod thesis;
pub mod train;

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Result;
use dermis_learn::real2sim::VirtualSensors;
use dermis_model::ForwardModel;
use dermis_skin::SkinDescription;

use crate::{Families, Progress};

/// A skin as it was designed, and its forward model: a simulation knows nothing of what makes a device differ.
fn nominal(
    path: &Path,
    families: &Families,
    progress: &dyn Progress,
) -> Result<(SkinDescription, Arc<dyn ForwardModel>)> {
    let mut skin = SkinDescription::load(path)?;
    if !skin.effects.is_empty() {
        let names: Vec<&str> = skin.effects.iter().map(|e| e.name.as_str()).collect();
        progress.note(&format!(
            "the simulation is of the skin as it was designed; it leaves out the effects of {}: {}",
            path.display(),
            names.join(", ")
        ));
        skin.effects.clear();
    }
    let model = families.model_of_file(path, &skin)?;
    Ok((skin, model))
}

/// The virtual sensors that settings ask for.
fn sensors(model: &Arc<dyn ForwardModel>, skin: &SkinDescription, each: usize) -> Result<VirtualSensors> {
    Ok(match each {
        0 => VirtualSensors::channels(Arc::clone(model))?,
        each => VirtualSensors::displacements(model.as_ref(), skin, each),
    })
}

/// Hands steps and their shares on.
fn watched(progress: &dyn Progress) -> impl Fn(&str, f64) + Sync + '_ {
    let last = Mutex::new(String::new());
    move |step, share| {
        let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
        if *last != step {
            step.clone_into(&mut last);
            progress.begin(step);
        }
        progress.at(share);
    }
}
