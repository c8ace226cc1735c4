//! What the training part of recordings tells of the forward model.

use std::collections::BTreeSet;
use std::sync::Arc;

use anyhow::{Result, bail};
use dermis_inversion::{Corrected, Settings};
use dermis_learn::{Dataset, Recorded, SampleId, refine, superpose};
use dermis_model::ForwardModel;

use super::{Refinement, Request};
use crate::Progress;

/// \[m\] from which on recorded contacts are far enough apart for their sum to be that of two.
const FAR: f64 = 0.030;
/// Recorded presses that a correction is learned from at most.
const PRESSES: usize = 12_000;
/// Sums of recorded contacts, of each number, on which the evidence for one contact more is chosen.
const SUMS: usize = 60;

/// Gains, correction and evidence, from the training part alone: four of five of its locations to learn from, the fifth to choose
/// by. What recordings do not tell is as in `unmeasured`, or as `options` say. `None` where it was interrupted.
pub(super) fn prepare(
    options: &Request,
    unmeasured: Option<&Settings>,
    model: Arc<dyn ForwardModel>,
    data: &Dataset,
    train: &[SampleId],
    bar: &dyn Progress,
) -> Result<Option<Refinement>> {
    bar.begin("gains of the channels");
    let location = |id: &SampleId| data.sample(*id).and_then(|s| s.truth.as_ref()).map(|t| t.location);
    let locations: BTreeSet<u32> = train.iter().filter_map(location).collect();
    let kept: BTreeSet<u32> = locations.into_iter().step_by(5).collect();
    let (choose, learn): (Vec<SampleId>, Vec<SampleId>) =
        train.iter().copied().partition(|id| location(id).is_some_and(|p| kept.contains(&p)));
    let (unknowns, contacts) = match unmeasured {
        Some(unmeasured) => (unmeasured.unknowns, unmeasured.contacts),
        None => (options.unknowns.into(), options.contacts),
    };
    let set = |settings: &mut Settings| {
        if let Some(unmeasured) = unmeasured {
            settings.force_max = unmeasured.force_max.max(settings.force_max);
            (settings.distance, settings.search) = (unmeasured.distance, unmeasured.search);
            (settings.force_prior, settings.shear) = (unmeasured.force_prior, unmeasured.shear);
            settings.widest = unmeasured.widest;
        } else {
            settings.distance = options.distance;
            settings.search = options.search.into();
            settings.force_prior = options.force_prior.into();
        }
    };
    let mut settings = refine::settings(
        model.as_ref(),
        data,
        if options.correct { &learn } else { train },
        unknowns,
        contacts,
    )?;
    set(&mut settings);
    let chosen = Recorded::of(data, &choose, 0.0, PRESSES / 4)?;
    let mut model = model;
    let mut correction = None;
    if options.correct {
        let recorded = Recorded::of(data, &learn, 0.0, PRESSES)?;
        if recorded.is_empty() || chosen.is_empty() {
            bail!(
                "the bags hold no single contacts of known place, force and tip at five locations or more to learn from"
            );
        }
        bar.begin("what the forward model does not know");
        let watch = |share: f64| bar.at(share);
        let Some(learned) = refine::correction(model.as_ref(), &recorded, &chosen, &settings.gains, &watch)?
        else {
            return Ok(None);
        };
        model = Arc::new(Corrected::new(model, learned.correction.clone())?);
        settings = refine::settings(model.as_ref(), data, &choose, unknowns, contacts)?;
        set(&mut settings);
        // They are in the correction; measured once more on a few locations they would only add noise.
        settings.gains.clear();
        correction = Some((learned, data.hash()));
    }
    if settings.in_pairs() {
        let sums: Vec<_> = (1..=contacts.min(3))
            .flat_map(|n| superpose(model.as_ref(), &chosen, n, SUMS, FAR.min(reach(&chosen) / 3.0), 77))
            .collect();
        bar.begin("how much evidence a contact needs");
        if !sums.is_empty() && !refine::tune_evidence(&model, &mut settings, &sums, &|share| bar.at(share))? {
            return Ok(None);
        }
    }
    bar.begin("how much of it a light one needs");
    if !refine::tune_presence(&model, &mut settings, data, train, &|share| bar.at(share))? {
        return Ok(None);
    }
    Ok(Some(Refinement { settings, correction }))
}

/// \[m\] farthest that recorded contacts are from the first.
fn reach(recorded: &[Recorded]) -> f64 {
    let first = recorded.first().map(|r| r.contact.position);
    let away = |r: &Recorded| first.map_or(0.0, |p| (r.contact.position - p).norm());
    recorded.iter().map(away).fold(0.0, f64::max)
}
