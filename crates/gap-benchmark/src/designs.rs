//! Forward models of designs that the benchmark is handed and does not know: of families whose untouched, undamaged device no
//! other code here computes.
//!
//! What such a reference device reads by design is the answer of its family's own model. What makes it differ is computed here, by
//! laws of its own. So controls of these families show no error of a simulator, unless the design is meshed otherwise: a diagnosis
//! has it easier with them than with layers and shells, which have a physics of their own.
//!
//! Shells are solved here, and the last of them are kept: most causes leave a shell as it is.

use std::sync::{Arc, Mutex};

use dermis_model::ForwardModel;
use dermis_skin::SkinDescription;

use crate::cause::Causes;
use crate::shell::{Influence, Solved};
use crate::{BenchmarkError, Script, loads};

/// A description → the family's forward model of it, or why there is none.
pub type Make<'a> = &'a (dyn Fn(&SkinDescription) -> Result<Arc<dyn ForwardModel>, String> + Sync);

/// Models and shells that are kept: one by design, and a few with another number.
const KEPT: usize = 4;

/// Where models of designs come from.
#[derive(Clone, Default)]
pub struct Designs<'a> {
    make: Option<Make<'a>>,
    kept: Arc<Mutex<Vec<Nominal>>>,
    shells: Arc<Mutex<Vec<KeptShell>>>,
}

/// A shell that was solved.
#[derive(Clone)]
struct KeptShell {
    shell: Solved,
    influence: Arc<Influence>,
}

/// Readings under a script, which are kept for the causes that change readings only.
struct Answered {
    script: Script,
    readings: Arc<Vec<f64>>,
}

/// The device of a design.
#[derive(Clone)]
pub(crate) struct Nominal {
    hash: String,
    pub model: Arc<dyn ForwardModel>,
    answered: Arc<Mutex<Option<Answered>>>,
}

impl std::fmt::Debug for Nominal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Nominal").field("hash", &self.hash).finish_non_exhaustive()
    }
}

impl<'a> Designs<'a> {
    /// Of families that `make` knows.
    #[must_use]
    pub fn new(make: Make<'a>) -> Self {
        Self { make: Some(make), kept: Arc::default(), shells: Arc::default() }
    }

    /// The device of this design.
    ///
    /// # Errors
    ///
    /// [`BenchmarkError::Design`] where nobody makes its model.
    pub(crate) fn of(&self, skin: &SkinDescription) -> Result<Nominal, BenchmarkError> {
        let hash = skin.hash();
        let refused = |reason: String| BenchmarkError::Design { skin: skin.name.clone(), reason };
        kept(
            &self.kept,
            |nominal| nominal.hash == hash,
            || {
                let make = self.make.ok_or_else(|| {
                    refused("no forward model was given to the benchmark for this sensor family".to_owned())
                })?;
                let model = make(skin).map_err(refused)?;
                Ok(Nominal { hash: hash.clone(), model, answered: Arc::default() })
            },
        )
    }

    /// The influence of forces on the gauges of this shell; `None` where it cannot be solved.
    pub(crate) fn solved(&self, shell: &Solved) -> Option<Arc<Influence>> {
        let solve = || {
            let influence = Arc::new(shell.influence().ok_or(())?);
            Ok::<_, ()>(KeptShell { shell: shell.clone(), influence })
        };
        kept(&self.shells, |kept| kept.shell == *shell, solve).ok().map(|kept| kept.influence)
    }
}

/// The one of a list that `is` the wanted one, or a new one, before which the oldest is dropped.
fn kept<T: Clone, E>(
    list: &Mutex<Vec<T>>,
    is: impl Fn(&T) -> bool,
    make: impl FnOnce() -> Result<T, E>,
) -> Result<T, E> {
    // What another thread has left behind in a panic is made anew.
    if let Ok(list) = list.lock()
        && let Some(found) = list.iter().find(|item| is(item))
    {
        return Ok(found.clone());
    }
    let made = make()?;
    if let Ok(mut list) = list.lock() {
        list.truncate(KEPT - 1);
        list.insert(0, made.clone());
    }
    Ok(made)
}

impl Nominal {
    /// Noise-free readings of a device that is switched on when `script` begins, row after row. Those of the script before are
    /// kept.
    pub fn readings(&self, script: &Script) -> Result<Arc<Vec<f64>>, BenchmarkError> {
        if let Ok(answered) = self.answered.lock()
            && let Some(before) = answered.as_ref().filter(|a| a.script == *script)
        {
            return Ok(Arc::clone(&before.readings));
        }
        let readings = Arc::new(self.stepped(script)?);
        if let Ok(mut answered) = self.answered.lock() {
            *answered = Some(Answered { script: script.clone(), readings: Arc::clone(&readings) });
        }
        Ok(readings)
    }

    /// Noise-free readings of such a device that is pressed as the causes have it.
    pub fn pressed(&self, causes: &Causes, script: &Script) -> Result<Vec<f64>, BenchmarkError> {
        if loads::act_on_loads(causes) {
            self.stepped(&loads::really(causes, script, self.model.surface()))
        } else {
            Ok(self.readings(script)?.as_ref().clone())
        }
    }

    /// As [`readings`](Self::readings), of a script that was changed by a cause: nothing is kept.
    pub fn stepped(&self, script: &Script) -> Result<Vec<f64>, BenchmarkError> {
        let channels = self.model.channels();
        let mut readings = vec![0.0; channels * script.instants.len()];
        let mut state = self.model.start(0);
        for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
            state.step(instant.time, &instant.moment.stimulus, row)?;
        }
        Ok(readings)
    }
}
