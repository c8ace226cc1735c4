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

#[cfg(test)]
mod tests {
    use dermis_skin::Effect;

    use super::super::testing::{Case, with_simulator};
    use super::*;

    #[test]
    fn signatures_are_simulated_once_and_then_come_from_memory_or_from_the_disk() {
        with_simulator(|simulator| {
            let case = Case::of(simulator, &[Effect::new("channel-gain").with("a", 1.1)]);
            let folder = tempfile::tempdir().unwrap();
            let options = Options { cache: Some(folder.path().to_owned()), ..Options::default() };
            let of = |memory: &Memory| {
                obtain(simulator, &case.recording, &case.samples, &options, memory).unwrap()
            };
            let memory = Memory::default();
            let (first, seconds) = of(&memory);
            assert!(seconds > 0.0 && !first.candidates.is_empty());
            let (again, seconds) = of(&memory);
            assert!(Arc::ptr_eq(&first, &again) && seconds == 0.0);
            let (stored, seconds) = of(&Memory::default());
            assert_eq!((&stored.candidates, seconds), (&first.candidates, 0.0));
            assert_eq!(stored.nominal, first.nominal);
            // What cannot be read is simulated again.
            for file in std::fs::read_dir(folder.path()).unwrap() {
                std::fs::write(file.unwrap().path(), b"dgapsig").unwrap();
            }
            let (renewed, seconds) = of(&Memory::default());
            assert!(seconds > 0.0 && renewed.candidates == first.candidates);
        });
    }

    #[test]
    fn other_presses_have_other_signatures() {
        with_simulator(|simulator| {
            let case = Case::of(simulator, &[]);
            let mut fewer = case.samples.clone();
            fewer.list.truncate(fewer.list.len() / 2);
            let memory = Memory::default();
            let options = Options::default();
            let of = |samples| obtain(simulator, &case.recording, samples, &options, &memory).unwrap().0;
            assert!(of(&case.samples).nominal.len() > of(&fewer).nominal.len());
        });
    }
}
