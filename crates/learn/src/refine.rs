//! Refining what a bundle says on the skin's forward model: what recordings tell of that model.

use dermis_inversion::{Calibration, Settings};
use dermis_skin::{ChannelFlags, ForwardModel, Indentation, Stimulus, Surface, Unknowns};
use nalgebra::{Point3, Vector3};

use crate::LearnError;
use crate::bounds::stimulus;
use crate::dataset::{Dataset, SampleId};

/// Frames that are measured on at most; of more, every n-th is taken.
const MOST: usize = 20_000;
/// Room above the largest force of the data.
const ROOM: f64 = 1.2;
/// \[m\] around what was pressed where contacts are looked for, too.
const AROUND: f64 = 3e-3;
/// Share of the surface that may lie outside of what was pressed before it is left out.
const LEFT_OUT: f64 = 0.02;

/// Settings of an inversion that fit these samples: gains of the channels against the forward model, and how far the two
/// still differ. The tip is the one that pressed most often.
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
    let step = only.len().div_ceil(MOST).max(1);
    let mut frames: Vec<(Stimulus, Vec<f32>)> = Vec::new();
    for id in only.iter().step_by(step) {
        let Some(sample) = data.sample(*id) else { continue };
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
        frames.iter().flat_map(|(s, _)| s.contacts.iter().map(|c| c.diameter)).collect();
    diameters.sort_by(f64::total_cmp);
    let most_often = diameters.chunk_by(|a, b| a == b).max_by_key(|run| run.len()).map(|run| run[0]);
    let forces = frames.iter().flat_map(|(s, _)| s.contacts.iter().map(|c| c.force.norm()));
    let force_max = forces.fold(0.0, f64::max) * ROOM;
    let calibration = Calibration::measure(model, unknowns, frames.iter().map(|(s, v)| (s, v.as_slice())))
        .map_err(|e| failed(e.to_string()))?;
    let mut settings = Settings::new(most_often.unwrap_or(0.004), force_max);
    settings.gains = calibration.gains;
    settings.model_error = calibration.model_error;
    settings.unknowns = unknowns;
    settings.contacts = contacts;
    settings.region = region(model.surface(), frames.iter().flat_map(|(s, _)| &s.contacts));
    Ok(settings)
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
