//! What each effect would change in a recording: its signature, from our own simulator.
//!
//! Problem: an effect has few parameters and may be nonlinear in them, and a diagnosis compares thousands of models. Method: a
//! linear subspace per effect (its columns), as the snapshots of proper orthogonal decomposition (Sirovich 1987). Every effect is
//! realised several times: at its typical parameters, at the ends of each parameter's range, and, where it is drawn at random, for
//! several devices. The principal components of what these realisations change are its columns. So a parameter that acts
//! nonlinearly (a time constant, a threshold) needs no treatment of its own. An effect that differs from channel to channel gets
//! components for each channel where components for all channels together do not predict a device that they were not made from.
//!
//! Assumptions: changes of several effects add to first order; refinement on the full simulator corrects that. Cost: one simulation
//! of all samples for each job of [`jobs`], some 100 for a family of 15 effects.

pub(crate) mod common;
mod discrepancy;
mod drift;
mod family;
mod jobs;
mod numbers;
pub(crate) mod uptime;

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

use dermis_skin::{Effect, SkinDescription};
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};

use crate::GapError;
use crate::constants::signatures::AT_ONCE;
use crate::recording::Recording;
use crate::samples::Samples;
use crate::simulate::Simulator;
use crate::statistics::Column;
use crate::zero_level::ZeroLevel;

use jobs::{Job, Purpose};

/// A device with one effect of its family, its seed where it was drawn, and what it changes.
type Realisation = (Effect, Option<u64>, Vec<f32>);
/// How large a change was, and what it changes.
type Change = (f64, Vec<f32>);

/// An effect that may be the cause.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Name of the effect.
    pub name: String,
    /// One sentence for people.
    pub what: String,
    /// Whether its family knows it; otherwise it is common to all skins.
    pub family: bool,
    /// Whether it belongs to the rig.
    pub rig: bool,
    /// Whether it is a number of the skin's description; its name is the number's path.
    pub number: bool,
    /// Its columns.
    pub columns: Vec<usize>,
    /// Whether each channel has columns of its own.
    pub per_channel: bool,
    /// Whether it drifts randomly: repeats do not show it, and no device predicts another.
    pub drifts_randomly: bool,
    /// Whether its readings are not in proportion to what is drawn: where it is large its columns leave what looks like other
    /// effects.
    pub nonlinear: bool,
    /// Whether it follows the time since power-on: repeats do not show it either.
    pub depends_on_uptime: bool,
    /// A common effect that is the same thing, in whose parameters its values are written.
    pub written_as: Option<String>,
    /// Other names of the same thing: effects that no press tells from it.
    pub aliases: Vec<String>,
    /// Realisations: what was switched on, and coordinates of what it changed.
    pub starts: Vec<(Effect, Vec<f64>)>,
    /// What is written for each column and a coefficient of 1, for effects that are linear: effect, parameter, amount.
    pub linear: Vec<(String, String, f64)>,
}

/// Signatures of all effects in one recording, in deviations of the declared noise.
#[derive(Debug, Clone, Default)]
pub struct Signatures {
    /// Readings of the nominal model, samples × channels, in the unit of the skin.
    pub nominal: Vec<f32>,
    /// Columns of candidates, then of the model discrepancy.
    pub columns: Vec<Column>,
    /// Effects.
    pub candidates: Vec<Candidate>,
    /// Columns of the model discrepancy: tolerances of the simulator, each for a coefficient of 1.
    pub discrepancy: Vec<usize>,
    /// What the model discrepancy is made of.
    pub discrepancy_names: Vec<String>,
    /// Effects that cannot be seen in this recording, and why.
    pub silent: Vec<(String, String)>,
    /// What the nominal model reads where nothing touches.
    pub zero: ZeroLevel,
}

/// Changes of simulations that are no realisations of a family's effect.
#[derive(Default)]
struct Changes {
    /// By common effect: parameter, amount, change.
    common: BTreeMap<&'static str, Vec<(String, Change)>>,
    /// By axis that all taxels were moved along.
    taxels: [Vec<Change>; 3],
    /// By number of the description: relative change, and what it changes.
    numbers: BTreeMap<String, Vec<Change>>,
    /// By tolerance of the rig.
    tolerances: BTreeMap<String, Vec<Change>>,
}

impl Changes {
    fn sort(changed: Vec<(Purpose, Vec<f32>)>) -> Self {
        let mut found = Self::default();
        for (purpose, change) in changed {
            match purpose {
                Purpose::Family(..) => {}
                Purpose::Common(name, parameter, amount) => {
                    found.common.entry(name).or_default().push((parameter, (amount, change)));
                }
                Purpose::Taxels(axis, by) => found.taxels[axis].push((by, change)),
                Purpose::Number(path, by) => found.numbers.entry(path).or_default().push((by, change)),
                Purpose::Tolerance(name, side) => {
                    found.tolerances.entry(name).or_default().push((side, change));
                }
            }
        }
        found
    }
}

/// Runs jobs, and keeps what each changed against the nominal model.
struct Runner<'a> {
    simulator: &'a Simulator<'a>,
    recording: &'a Recording,
    samples: &'a Samples,
    stop: &'a AtomicBool,
    progress: &'a ProgressBar,
    /// Readings of the nominal model whose channels never end: a signature that is cut off at the end of the range is no longer in
    /// proportion to its effect.
    unlimited: Vec<f32>,
    noise: Vec<f64>,
    /// Effects of the family that cannot be simulated, and why.
    refused: BTreeMap<String, String>,
}

impl Runner<'_> {
    fn run(&mut self, jobs: Vec<Job>) -> Result<Vec<(Purpose, Vec<f32>)>, GapError> {
        let (skins, purposes): (Vec<SkinDescription>, Vec<Purpose>) =
            jobs.into_iter().map(|j| (j.skin, j.purpose)).unzip();
        let samples = (self.samples, false);
        let read = self.simulator.many(&skins, self.recording, samples, self.stop, self.progress)?;
        let mut changed = Vec::new();
        for (purpose, read) in purposes.into_iter().zip(read) {
            match (read, purpose) {
                (Ok(read), purpose) => changed.push((purpose, self.change(&read))),
                (Err(error), Purpose::Family(_, effect, _)) => {
                    self.refused.insert(effect.name, error.to_string());
                }
                (Err(_), _) => {}
            }
        }
        Ok(changed)
    }

    fn change(&self, readings: &[f32]) -> Vec<f32> {
        readings
            .iter()
            .zip(&self.unlimited)
            .enumerate()
            .map(|(i, (a, b))| (f64::from(a - b) / self.noise[i % self.noise.len()]) as f32)
            .collect()
    }
}

impl Signatures {
    /// Simulates all effects of the skin's family, and those that every skin can have.
    ///
    /// # Errors
    ///
    /// [`GapError`] where the nominal model fails; effects that cannot be simulated are listed as silent.
    pub fn simulate(
        simulator: &Simulator<'_>,
        recording: &Recording,
        samples: &Samples,
        stop: &AtomicBool,
        progress: &ProgressBar,
    ) -> Result<Self, GapError> {
        let frames = samples.frames();
        let skin = simulator.skin;
        let channels = recording.channels;
        let nominal = simulator.readings(skin, recording, &frames)?;
        let unlimited = simulator.unlimited(skin, recording, &frames)?;
        let noise = skin.channel_noise();
        let jobs = jobs::all(simulator, samples);
        progress.set_length(jobs.len() as u64);
        let refused = BTreeMap::new();
        let mut runner = Runner {
            simulator,
            recording,
            samples,
            stop,
            progress,
            unlimited,
            noise: noise.clone(),
            refused,
        };
        let zero = simulator.zero_level(recording)?;
        let mut found = Self { nominal, zero, ..Self::default() };
        let (families, others): (Vec<Job>, Vec<Job>) =
            jobs.into_iter().partition(|j| matches!(j.purpose, Purpose::Family(..)));
        let mut changes = Changes::sort(runner.run(others)?);
        found.add_common(skin, samples, &noise, &mut changes);
        for batch in jobs::batches(families, AT_ONCE) {
            let mut family: BTreeMap<usize, Vec<Realisation>> = BTreeMap::new();
            for (purpose, changed) in runner.run(batch)? {
                if let Purpose::Family(index, effect, device) = purpose {
                    family.entry(index).or_default().push((effect, device, changed));
                }
            }
            for (index, realised) in family {
                found.add_family(&simulator.effects[index], &realised, samples, channels);
            }
        }
        for (name, reason) in runner.refused {
            if !found.candidates.iter().any(|c| c.name == name) {
                found.silent.push((name, reason));
            }
        }
        found.add_numbers(skin, samples, &changes.numbers);
        found.merge_equal(simulator, samples, channels);
        found.add_discrepancy(changes, skin, samples, &noise);
        Ok(found)
    }
}

/// Change for an amount of 1: central where both sides are known, of one side otherwise.
fn central(sides: &[Change]) -> Option<Vec<f32>> {
    let plus = sides.iter().find(|(a, _)| *a > 0.0);
    let minus = sides.iter().find(|(a, _)| *a < 0.0);
    match (plus, minus) {
        (Some((a, p)), Some((b, m))) => {
            Some(p.iter().zip(m).map(|(p, m)| (p - m) / (a - b) as f32).collect())
        }
        (Some((a, v)), None) | (None, Some((a, v))) => Some(v.iter().map(|v| v / *a as f32).collect()),
        (None, None) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_central_where_both_sides_are_known() {
        assert_eq!(central(&[(2.0, vec![6.0]), (-2.0, vec![-2.0])]), Some(vec![2.0]));
        assert_eq!(central(&[(2.0, vec![6.0])]), Some(vec![3.0]));
        assert_eq!(central(&[(-2.0, vec![6.0])]), Some(vec![-3.0]));
        assert_eq!(central(&[]), None);
    }
}
