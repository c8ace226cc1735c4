//! Which simulations signatures need: one job each.

use dermis_model::COMMON;
use dermis_model::diagnosis::{Needs, Signature};
use dermis_skin::{Effect, SkinDescription};

use crate::constants::signatures::{DEVICES, SHIFT, TOLERANCE};
use crate::design;
use crate::effects;
use crate::samples::Samples;
use crate::simulate::Simulator;

/// One simulation that signatures need.
pub(super) struct Job {
    pub skin: SkinDescription,
    pub purpose: Purpose,
}

/// What a simulation is for.
pub(super) enum Purpose {
    /// Of a family's effect: its place in the family's list, what was switched on, device where drawn.
    Family(usize, Effect, Option<u64>),
    /// Of a common effect: name, parameter, amount for which its column is.
    Common(&'static str, String, f64),
    /// All taxels moved along an axis.
    Taxels(usize, f64),
    /// A number of the description: its path, and the relative change.
    Number(String, f64),
    /// One side of a tolerance of the rig: its name, and the side.
    Tolerance(String, f64),
}

/// All simulations that signatures need.
pub(super) fn all(simulator: &Simulator<'_>, samples: &Samples) -> Vec<Job> {
    let mut jobs = Vec::new();
    family(simulator, &mut jobs);
    common(simulator, samples, &mut jobs);
    taxels(simulator.skin, &mut jobs);
    tolerances(simulator, &mut jobs);
    jobs
}

/// Every effect of the family at its typical parameters, for several devices where it is drawn, and at the ends of each range.
fn family(simulator: &Simulator<'_>, jobs: &mut Vec<Job>) {
    for (index, info) in simulator.effects.iter().enumerate() {
        let base = simulator.skin.effects.iter().find(|e| e.name == info.name && e.strength > 0.0);
        let base = base.cloned().unwrap_or_else(|| Effect::new(info.name));
        let mut realise = |effect: Effect, device: Option<u64>| {
            let skin = simulator.with(std::slice::from_ref(&effect));
            jobs.push(Job { skin, purpose: Purpose::Family(index, effect, device) });
        };
        let drawn =
            |effect: Effect, device: u64| if info.random { effect.seed(1000 + device) } else { effect };
        for device in 0..if info.random { DEVICES } else { 1 } {
            realise(drawn(base.clone(), device), info.random.then_some(device));
        }
        for parameter in info.parameters {
            for value in parameter.range {
                if value != info.value(&base, parameter.name) {
                    let effect = base.clone().with(parameter.name, value);
                    // Devices that differ by more than a parameter say nothing of either.
                    realise(drawn(effect, 0), None);
                }
            }
        }
    }
}

/// The common effects whose signature is simulated.
fn common(simulator: &Simulator<'_>, samples: &Samples, jobs: &mut Vec<Job>) {
    let skin = simulator.skin;
    let period = 1.0 / skin.rate;
    let flat = samples.list.iter().all(|s| !s.position[2].is_finite() || s.position[2].abs() < 1e-6);
    let noise = skin.channel_noise();
    for of in COMMON {
        let Signature::Simulated(variations) = of.diagnosis.signature else { continue };
        for variation in variations {
            let possible = match variation.needs {
                Needs::Nothing => true,
                Needs::SeveralChannels => skin.channels().len() > 1,
                Needs::CurvedSurface => !flat,
            };
            if !possible {
                continue;
            }
            let amount = effects::amount(variation.amount, period, &noise);
            let effect = Effect::new(of.name).with(variation.parameter, of.diagnosis.neutral + amount);
            let skin = simulator.with(&[effect]);
            let purpose = Purpose::Common(of.name, variation.parameter.to_owned(), amount);
            jobs.push(Job { skin, purpose });
        }
    }
}

/// All taxels moved along each axis, to either side.
fn taxels(skin: &SkinDescription, jobs: &mut Vec<Job>) {
    for axis in 0..3 {
        for by in [SHIFT, -SHIFT] {
            let mut moved = skin.clone();
            moved.taxels.iter_mut().for_each(|t| t.position[axis] += by);
            jobs.push(Job { skin: moved, purpose: Purpose::Taxels(axis, by) });
        }
    }
}

/// Every number of the description, and every effect that stands for one of the rig, within its tolerance.
fn tolerances(simulator: &Simulator<'_>, jobs: &mut Vec<Job>) {
    for number in design::numbers(simulator.skin) {
        for by in [TOLERANCE, -TOLERANCE] {
            let other = design::hypothesis(&number.path, number.value * (1.0 + by));
            let skin = simulator.with(&[other]);
            jobs.push(Job { skin, purpose: Purpose::Number(number.path.clone(), by) });
        }
    }
    for of in effects::with(|p| p.tolerance.is_some()) {
        let Some((parameter, name)) = of.diagnosis.tolerance else { continue };
        for side in [1.0, -1.0] {
            let effect = Effect::new(of.name).with(parameter, of.diagnosis.neutral + side * TOLERANCE);
            let purpose = Purpose::Tolerance(name.to_owned(), side);
            jobs.push(Job { skin: simulator.with(&[effect]), purpose });
        }
    }
}

/// Jobs in batches of about `size`; those of one effect stay together.
pub(super) fn batches(jobs: Vec<Job>, size: usize) -> Vec<Vec<Job>> {
    let effect = |job: &Job| if let Purpose::Family(index, ..) = job.purpose { index } else { 0 };
    let mut found = Vec::new();
    let mut batch: Vec<Job> = Vec::new();
    let mut left = jobs.into_iter().peekable();
    while let Some(job) = left.next() {
        let ends = left.peek().is_none_or(|next| effect(next) != effect(&job));
        batch.push(job);
        if ends && (batch.len() >= size || left.peek().is_none()) {
            found.push(std::mem::take(&mut batch));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_keep_an_effect_together() {
        let skin =
            SkinDescription::from_toml(include_str!("../../../../launch/skins/baro-line.toml"), "line");
        let skin = skin.unwrap();
        let job = |index| Job { skin: skin.clone(), purpose: Purpose::Family(index, Effect::new("e"), None) };
        let jobs: Vec<Job> = [0, 0, 0, 1, 2, 2].map(job).into();
        let sizes: Vec<usize> = batches(jobs, 2).iter().map(Vec::len).collect();
        assert_eq!(sizes, [3, 3]);
    }
}
