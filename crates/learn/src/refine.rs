//! Refining what a bundle says on the skin's forward model: what recordings tell of that model.

use std::collections::BTreeSet;
use std::sync::Arc;

use dermis_inversion::{
    Calibration, Correction, CorrectionSettings, Inverter, InverterError, Press, Reading, Settings,
};
use dermis_model::{ForwardModel, Indentation, Stimulus, TipShape, Unknowns};
use dermis_skin::{ChannelFlags, Surface, TipKind};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::LearnError;
use crate::bounds::stimulus;
use crate::dataset::{Dataset, SampleId};
use crate::recordings::Recorded;

/// Frames that are measured on at most; of more, every n-th is taken.
const MOST: usize = 20_000;
/// Room above the largest force of the data.
const ROOM: f64 = 1.2;
/// \[m\] around what was pressed where contacts are looked for, too.
const AROUND: f64 = 3e-3;
/// Share of the surface that may lie outside of what was pressed before it is left out.
const LEFT_OUT: f64 = 0.02;

/// Share of untouched frames that may count as touched.
const UNTOUCHED: f64 = 1e-3;
/// Of them, so many at least have to be expected among what it is measured on.
const FEWEST: f64 = 1.0;
/// Times that the presence is raised at most.
const HIGHEST: f64 = 30.0;

/// Receives the progress of long work, from 0 to 1; says whether it goes on.
pub type Watch<'a> = &'a dyn Fn(f64) -> bool;

/// Settings of an inversion that fit these samples: gains of the channels against the forward model, and how far the two
/// still differ. The tip is the one that pressed most often. Pixels have no gains of their own, and neither have the numbers of a picture.
///
/// # Errors
///
/// [`LearnError::Refinement`] where the samples do not tell: no contact is known whole, or a channel was never pressed.
pub fn settings(
    model: &dyn ForwardModel,
    data: &Dataset,
    only: &[SampleId],
    unknowns: Unknowns,
    contacts: usize,
) -> Result<Settings, LearnError> {
    let failed = |reason: String| LearnError::Refinement { skin: data.skin().name.clone(), reason };
    let step = dermis_regress::stride(only.len(), MOST);
    let mut frames: Vec<(Stimulus, Vec<f32>)> = Vec::new();
    let targets: Vec<SampleId> = only.iter().copied().step_by(step).collect();
    for (_, sample) in data.gather(&targets)? {
        let Some(truth) = sample.truth.as_ref().filter(|t| t.touched()) else { continue };
        let Some(stimulus) = stimulus(truth) else { continue };
        // A force cell's noise pulls at the skin now and then, which no forward model knows.
        if stimulus.contacts.iter().zip(&truth.contacts).any(|(s, t)| s.force.dot(&t.normal) >= 0.0) {
            continue;
        }
        let usable = |flags: &ChannelFlags| !flags.is_invalid() && !flags.contains(ChannelFlags::SATURATED);
        let signal = sample.tared.iter().zip(&sample.frame.flags);
        frames.push((stimulus, signal.map(|(v, f)| if usable(f) { *v } else { f32::NAN }).collect()));
    }
    if frames.is_empty() {
        return Err(failed(
            "no training sample says where, how hard and with which tip it was pressed".into(),
        ));
    }
    let mut diameters: Vec<f64> =
        frames.iter().flat_map(|(s, _)| s.contacts.iter().map(Indentation::diameter)).collect();
    diameters.sort_by(f64::total_cmp);
    let most_often = diameters.chunk_by(|a, b| a == b).max_by_key(|run| run.len()).map(|run| run[0]);
    let forces = frames.iter().flat_map(|(s, _)| s.contacts.iter().map(|c| c.force.norm()));
    let force_max = forces.fold(0.0, f64::max) * ROOM;
    let labelled = frames.iter().map(|(s, v)| (s, v.as_slice()));
    let is_pictured = dermis_estimate::is_pictured(data.skin());
    let calibration = match is_pictured {
        true => Calibration::without_gains(model, unknowns, labelled),
        false => Calibration::measure(model, unknowns, labelled),
    };
    let calibration = calibration.map_err(|e| failed(e.to_string()))?;
    let mut settings = Settings::new(most_often.unwrap_or(0.004), force_max);
    let shapes = || frames.iter().flat_map(|(s, _)| &s.contacts).map(|c| &c.tip.shape);
    let flat = shapes().filter(|shape| matches!(shape, TipShape::FlatPunch { .. })).count();
    if 2 * flat > shapes().count() {
        settings.tip = TipKind::FlatPunch;
    }
    settings.gains = if is_pictured { Vec::new() } else { calibration.gains };
    settings.model_error = calibration.model_error;
    settings.unknowns = unknowns;
    settings.contacts = contacts;
    settings.region = region(model.surface(), frames.iter().flat_map(|(s, _)| &s.contacts));
    Ok(settings)
}

/// A correction, and what is known about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Learned {
    /// What it is.
    pub correction: Correction,
    /// How it was learned.
    pub settings: CorrectionSettings,
    /// Recorded presses that it was learned from.
    pub presses: usize,
    /// Root mean square, in units of the noise, of what the model leaves of `chosen`: without it, and with it.
    pub left: [f64; 2],
}

/// The correction, learned from `recorded`, that leaves least of presses at other locations (`chosen`). `gains` are those of
/// [`settings`]. `watch` receives the progress, from 0 to 1, and says whether it goes on; `None` where it does not.
///
/// # Errors
///
/// [`InverterError::Model`] where the model has no answer for a press.
pub fn correction(
    model: &dyn ForwardModel,
    recorded: &[Recorded],
    chosen: &[Recorded],
    gains: &[f64],
    watch: Watch<'_>,
) -> Result<Option<Learned>, InverterError> {
    fn presses(recorded: &[Recorded], most: usize) -> Vec<Press<'_>> {
        let step = dermis_regress::stride(recorded.len(), most);
        recorded.iter().step_by(step).map(|r| (&r.contact, r.signal.as_slice())).collect()
    }
    let (some, all, test) = (presses(recorded, 3000), presses(recorded, 12_000), presses(chosen, 1500));
    let without =
        Correction::fit(model, &[], gains, &CorrectionSettings::default())?.remainder(model, &test)?;
    let (mut least, mut settings) = (f64::INFINITY, CorrectionSettings::default());
    let mut done = 0.0;
    for length in [0.006, 0.009, 0.013, 0.019] {
        for ridge in [1e-6, 1e-4, 1e-2] {
            // The last fit, of all presses, takes about as long as three of these.
            if !watch(done / 15.0) {
                return Ok(None);
            }
            done += 1.0;
            let tried = CorrectionSettings { length, ridge, ..CorrectionSettings::default() };
            let left = Correction::fit(model, &some, gains, &tried)?.remainder(model, &test)?;
            if left < least {
                (least, settings) = (left, tried);
            }
        }
    }
    if !watch(done / 15.0) {
        return Ok(None);
    }
    let correction = Correction::fit(model, &all, gains, &settings)?;
    let with = correction.remainder(model, &test)?;
    Ok(Some(Learned { correction, settings, presses: all.len(), left: [without, with] }))
}

/// Readings, all of them known.
#[must_use]
pub fn exact(signal: &[f32]) -> Vec<Reading> {
    signal.iter().map(|v| Reading::Exact(f64::from(*v))).collect()
}

/// Sets the [evidence](Settings::evidence) that gives the right number of contacts on `frames`, sums of recorded contacts
/// ([`superpose`](crate::superpose)), as often as any other but for what so many frames leave to chance: of those within one standard
/// error of the best the largest, which finds the fewest contacts that are not there. `watch` receives the progress, from 0 to 1, and
/// says whether it goes on; false where it did not, and nothing was set.
///
/// # Errors
///
/// [`InverterError`] where the settings cannot be or the model has no answer.
pub fn tune_evidence(
    model: &Arc<dyn ForwardModel>,
    settings: &mut Settings,
    frames: &[(Stimulus, Vec<f32>)],
    watch: Watch<'_>,
) -> Result<bool, InverterError> {
    const TRIED: [f64; 7] = [6.0, 10.0, 15.0, 22.0, 30.0, 45.0, 70.0];
    let mut rights = [0usize; TRIED.len()];
    let total = (TRIED.len() * frames.len()).max(1) as f64;
    for (k, evidence) in TRIED.into_iter().enumerate() {
        let tried = Inverter::new(Arc::clone(model), Settings { evidence, ..settings.clone() })?;
        for (n, (stimulus, signal)) in frames.iter().enumerate() {
            if !watch((k * frames.len() + n) as f64 / total) {
                return Ok(false);
            }
            let found = tried.search(&exact(signal))?.contacts.len();
            rights[k] += usize::from(found == stimulus.contacts.len());
        }
    }
    if let Some(chosen) = simplest(&rights, frames.len()) {
        settings.evidence = TRIED[chosen];
    }
    Ok(true)
}

/// The last that is right about as often as the best: within a standard error of a share of `of`. `None` where none is ever right.
fn simplest(rights: &[usize], of: usize) -> Option<usize> {
    let best = *rights.iter().max().filter(|best| **best > 0)?;
    let share = best as f64 / of.max(1) as f64;
    let error = (share * (1.0 - share).max(0.0) * of as f64).sqrt();
    rights.iter().rposition(|right| *right as f64 >= best as f64 - error)
}

/// Raises the [presence](Settings::presence) until [`UNTOUCHED`] of the untouched samples of `only` at most would count as touched,
/// each after a contact that was detected to its end: a zero follows drift with a lag, and not at all while contacts follow each
/// other, and what it leaves looks like a light contact. Too few untouched samples leave it as it is. `watch` receives the progress,
/// from 0 to 1, and says whether it goes on; false where it did not, and nothing was set.
///
/// # Errors
///
/// [`LearnError`] where the settings cannot be, or a bag cannot be read once more.
pub fn tune_presence(
    model: &Arc<dyn ForwardModel>,
    settings: &mut Settings,
    data: &Dataset,
    only: &[SampleId],
    watch: Watch<'_>,
) -> Result<bool, LearnError> {
    let failed =
        |e: InverterError| LearnError::Refinement { skin: data.skin().name.clone(), reason: e.to_string() };
    let inverter = Inverter::new(Arc::clone(model), settings.clone()).map_err(failed)?;
    let only: BTreeSet<SampleId> = only.iter().copied().collect();
    // `None`: touched.
    let mut seen: Vec<Option<(f64, f64)>> = Vec::new();
    let total = only.len().max(1) as f64;
    let mut inspected = 0_u32;
    for run in 0..data.runs().len() {
        for (sample, read) in data.stream(run)?.enumerate() {
            let read = read?;
            if !only.contains(&SampleId { run, sample }) {
                continue;
            }
            if !watch(f64::from(inspected) / total) {
                return Ok(false);
            }
            inspected += 1;
            let Some(truth) = &read.truth else { continue };
            if truth.touched() {
                seen.push(None);
            } else if !read.tared.iter().all(|v| v.is_nan()) {
                let readings: Vec<Reading> =
                    read.tared.iter().zip(&read.frame.flags).map(|(v, f)| Reading::of(*v, *f)).collect();
                seen.push(Some(inverter.evidence(&readings)));
            }
        }
    }
    settings.presence = presence(settings, &seen);
    Ok(true)
}

/// The least presence, from that of `settings` on, that takes few enough of the untouched frames `seen` (`None`: touched) for
/// touched.
fn presence(settings: &Settings, seen: &[Option<(f64, f64)>]) -> f64 {
    let untouched = seen.iter().flatten().count();
    if (untouched as f64) < FEWEST / UNTOUCHED {
        return settings.presence;
    }
    let mut tried = settings.clone();
    loop {
        let (mut before, mut wrong) = (false, 0);
        for evidence in seen {
            before = evidence.is_none_or(|evidence| tried.exceeds_threshold(evidence, before));
            wrong += usize::from(before && evidence.is_some());
        }
        // Beyond what any drift looks like, what untouched frames show is no drift.
        if wrong as f64 <= UNTOUCHED * untouched as f64 || tried.presence > HIGHEST * settings.presence {
            return tried.presence;
        }
        tried.presence *= 1.05;
    }
}

/// The box that was pressed, where it leaves out a part of the surface: nobody knows what the model is worth there.
fn region<'a>(surface: &Surface, contacts: impl Iterator<Item = &'a Indentation>) -> Option<[[f64; 3]; 2]> {
    let mut found: Option<(Point3<f64>, Point3<f64>)> = None;
    for contact in contacts {
        let p = contact.position;
        found = Some(found.map_or((p, p), |(low, high)| (low.inf(&p), high.sup(&p))));
    }
    let (low, high) = found?;
    let by = Vector3::repeat(AROUND);
    let (low, high) = (low - by, high + by);
    let inside = |p: &Point3<f64>| (0..3).all(|k| (low[k]..=high[k]).contains(&p[k]));
    let outside = surface.points.iter().zip(&surface.areas).filter(|(p, _)| !inside(p));
    let left: f64 = outside.map(|(_, area)| area).sum();
    (left > LEFT_OUT * surface.areas.iter().sum::<f64>()).then_some([low.coords.into(), high.coords.into()])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_is_as_large_as_chance_allows() {
        // 180 frames of which 153 are right: 4.8 frames are chance.
        assert_eq!(simplest(&[120, 150, 153, 151, 149, 140, 100], 180), Some(4));
        assert_eq!(simplest(&[120, 150, 153, 147, 140, 130, 100], 180), Some(2));
        assert_eq!(simplest(&[180, 180, 12], 180), Some(1), "what is always right leaves nothing to chance");
        assert_eq!(simplest(&[0; 7], 180), None);
    }

    #[test]
    fn drift_that_looks_like_a_light_contact_does_not_count_as_one() {
        let settings = Settings::new(0.004, 5.0);
        // Presses, and between them untouched frames: noise alone, then a zero that lags more and more.
        let seen = |drift: f64| -> Vec<Option<(f64, f64)>> {
            (0..200)
                .flat_map(|press| {
                    let lag = drift * f64::from(press) / 200.0;
                    let idle = (0..20).map(move |k| Some((8.0 + lag + f64::from(k * 7 % 20) / 4.0, 1.1)));
                    std::iter::repeat_n(None, 10).chain(idle)
                })
                .collect()
        };
        assert_eq!(presence(&settings, &seen(0.0)), settings.presence, "noise alone is no contact");
        let raised = Settings { presence: presence(&settings, &seen(40.0)), ..settings.clone() };
        // Half of it is above what nearly all of the first untouched frames reach.
        assert!((90.0..100.0).contains(&raised.presence), "{}", raised.presence);
        let wrong = |settings: &Settings| {
            let mut before = false;
            let detected = seen(40.0).into_iter().filter(|evidence| {
                before = evidence.is_none_or(|evidence| settings.exceeds_threshold(evidence, before));
                before && evidence.is_some()
            });
            detected.count()
        };
        assert!(wrong(&settings) > 2000 && wrong(&raised) <= 4, "{}, {}", wrong(&settings), wrong(&raised));
        // A handful of frames says nothing about one in a thousand.
        assert_eq!(presence(&settings, &seen(40.0)[..600]), settings.presence);
    }
}
