//! Stage `signatures`: what each effect would change, from memory, from the disk, or simulated.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use super::Options;
use crate::recording::Recording;
use crate::samples::Samples;
use crate::signatures::Signatures;
use crate::simulate::Simulator;
use crate::{GapError, store};

/// Keeps signatures in memory, so that many recordings of the same presses are diagnosed with one set of simulations.
#[derive(Debug, Default)]
pub struct Memory {
    kept: Mutex<BTreeMap<String, Arc<Signatures>>>,
}

/// Signatures of all effects in these samples, and the seconds that simulating them took.
pub(super) fn obtain(
    simulator: &Simulator<'_>,
    recording: &Recording,
    samples: &Samples,
    options: &Options,
    memory: &Memory,
) -> Result<(Arc<Signatures>, f64), GapError> {
    let key = store::key(simulator, recording, samples);
    if let Ok(kept) = memory.kept.lock()
        && let Some(found) = kept.get(&key)
    {
        return Ok((Arc::clone(found), 0.0));
    }
    let begun = Instant::now();
    let mut seconds = 0.0;
    let stored = options.cache.as_ref().and_then(|folder| store::load(folder, &key));
    let found = match stored {
        Some(found) => found,
        None => {
            let found =
                Signatures::simulate(simulator, recording, samples, &options.stop, &options.progress)?;
            if let Some(folder) = &options.cache {
                store::save(folder, &key, &found)?;
            }
            seconds = begun.elapsed().as_secs_f64();
            found
        }
    };
    let found = Arc::new(found);
    if let Ok(mut kept) = memory.kept.lock() {
        kept.insert(key, Arc::clone(&found));
    }
    Ok((found, seconds))
}
