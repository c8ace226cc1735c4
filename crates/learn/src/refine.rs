//! Refining what a bundle says on the skin's forward model: what recordings tell of that model.

use dermis_inversion::{Calibration, Settings};
use dermis_skin::{ChannelFlags, ForwardModel, Stimulus, Unknowns};

use crate::LearnError;
use crate::bounds::stimulus;
use crate::dataset::{Dataset, SampleId};

/// Frames that are measured on at most; of more, every n-th is taken.
const MOST: usize = 20_000;
/// Room above the largest force of the data.
const ROOM: f64 = 1.2;

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
    Ok(settings)
}
