//! Stage `predict`: how far the named effects reduce the residual, on contacts that nothing was fitted to.
//!
//! Predicted: by what was fitted, less the optimism of the fit against cross-validation. Achieved: with the full simulator on the
//! groups that were kept. The interval is that of another recording of the same device: a bootstrap over groups (Efron and
//! Tibshirani 1993) that runs selection and fit again, the difference of predicted and achieved, the error of the floor, and what
//! depends on the past or drifts.

use std::sync::atomic::Ordering;

use dermis_model::in_parallel;
use dermis_skin::Effect;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::announce;
use super::contest::Judged;
use super::data::Data;
use super::refine::Refined;
use super::select::Selected;
use crate::GapError;
use crate::constants::Z90;
use crate::constants::predict::{APART, ELSEWHERE, FLOOR_ERROR, HELPS, HISTORY, LEAST_GAP, STRETCHED};
use crate::noise::Gap;
use crate::report::{NamedEffect, ResidualReduction};
use crate::rivals::{Rival, Structure};
use crate::select::{Selection, Tier};
use crate::statistics::Fit;
use crate::wording::percent;

/// Members of a class that is open: name, and what is switched on for it.
pub(super) type Members = Vec<(String, Vec<Effect>)>;

/// Causes and what they come to.
#[derive(Default)]
pub(super) struct Explained {
    /// The gap, where it is more than what presses have in common.
    pub gap: Option<Gap>,
    pub named: Vec<NamedEffect>,
    pub effects: Vec<Effect>,
    pub reduction: Option<ResidualReduction>,
    /// Unexplained variance on the groups that were kept: before, after, floor.
    pub held_out: Option<[f64; 3]>,
    /// Reduction by named effects, and with the model discrepancy.
    pub library: f64,
    pub both: f64,
    pub selection: Selection,
    /// Whitened residual after the named effects.
    pub left: Option<Vec<f32>>,
    /// Members of the first class that is open.
    pub members: Members,
    /// Shapes without a cause beside the named effects, and what these leave by channels and locations.
    pub rivals: Vec<Rival>,
    pub structure: Option<Structure>,
    /// What speaks for "unknown".
    pub judged: Judged,
    /// Whether the strongest name is that of another thing.
    pub contested: bool,
    pub warnings: Vec<String>,
}

impl Explained {
    /// Where no effect was selected.
    pub fn none(selection: Selection) -> Self {
        Self { library: selection.library, both: selection.both, selection, ..Self::default() }
    }
}

/// Weights of groups that are fitted and of those that are kept, and what the nominal model leaves in each group.
struct Groups<'a> {
    data: &'a Data<'a>,
    training: Vec<f64>,
    kept: Vec<f64>,
    before: Vec<f64>,
}

fn weighted(values: &[f64], weights: &[f64]) -> f64 {
    values.iter().zip(weights).map(|(v, w)| v * w).sum()
}

impl<'a> Groups<'a> {
    fn of(data: &'a Data<'a>, selected: &Selected) -> Self {
        let training = data.samples.training();
        let kept = training.iter().map(|w| 1.0 - w).collect();
        let before = (0..data.samples.groups).map(|g| selected.statistics.energy(g)).collect();
        Self { data, training, kept, before }
    }

    /// Share of the gap over groups with these weights that losses of groups leave away.
    fn reduction(&self, losses: &[f64], weights: &[f64]) -> f64 {
        let (b, a) = (weighted(&self.before, weights), weighted(losses, weights));
        (b - a) / (b - self.data.floor(weights)).max(LEAST_GAP * b)
    }

    /// Unexplained variance over the groups that were kept.
    fn fvu(&self, losses: &[f64]) -> f64 {
        weighted(losses, &self.kept) / self.data.scale(&self.kept).max(1e-300)
    }

    /// Relative error of the gap of the groups that were kept by that of the floor.
    fn doubt(&self) -> f64 {
        let floor = self.data.floor(&self.kept);
        let gap = (weighted(&self.before, &self.kept) - floor).max(1e-300);
        (FLOOR_ERROR * floor / gap).clamp(0.0, 1.0)
    }
}

/// Predicts. `fixed` are effects that are switched on in any case, `whitened` is the residual of the nominal model.
pub(super) fn predict(
    data: &Data<'_>,
    selected: &Selected,
    refined: Refined,
    fixed: &[Effect],
    whitened: &[f32],
) -> Result<Explained, GapError> {
    let candidates = &data.signatures.candidates;
    let groups = Groups::of(data, selected);
    let training = data.selector(&selected.statistics, &selected.gram, &groups.training);
    let fit = training.fit_all(&refined.set, Tier::Loose);
    let effects = refined.effects();
    let mut found = Explained::none(selected.selection.clone());
    (found.named, found.warnings) = (refined.named, refined.warnings);
    if effects.is_empty() {
        found.warnings.push(
            "none of the named effects can be switched on in a skin description: the residual reduction is that of its signature"
                .to_owned(),
        );
    }
    // What cannot be written is taken out of the readings as its signature says.
    let unwritten: Vec<usize> = refined
        .set
        .iter()
        .zip(&refined.fits)
        .filter(|(_, of)| of.is_empty())
        .flat_map(|(c, _)| candidates[*c].columns.iter().copied())
        .collect();
    let readings = data.readings_without(&selected.columns, &fit, &unwritten);
    let linear: Vec<f64> = (0..data.samples.groups).map(|g| selected.statistics.loss(g, &fit)).collect();
    let switched = if effects.is_empty() {
        None
    } else {
        let mut all = fixed.to_vec();
        Effect::merge(&mut all, effects.clone());
        Some(Data { readings: &readings, ..*data }.residual(&data.simulate(&all)?))
    };
    let (after, predicted, achieved) = reduce(&mut found, &groups, &linear, switched.as_deref());
    let spread = spread(&groups, selected, (&linear, &after))?;
    let reduction = interval(data, &found.named, groups.doubt(), (predicted, achieved, spread));
    found.reduction = Some(reduction);
    found.held_out = Some([groups.fvu(&groups.before), groups.fvu(&after), data.gap.floor]);
    let open = found.named.iter().zip(&refined.fits).find(|(n, of)| n.class.len() > 1 && of.len() > 1);
    if let Some((_, of)) = open {
        found.members =
            of.iter().map(|t| (candidates[t.candidate].name.clone(), t.effects.clone())).collect();
    }
    found.left = Some(switched.unwrap_or_else(|| left(data, selected, whitened, &fit)));
    found.effects = effects;
    Ok(found)
}

/// What signatures leave.
fn left(data: &Data<'_>, selected: &Selected, whitened: &[f32], fit: &Fit) -> Vec<f32> {
    data.without(whitened, &selected.columns, fit.terms())
}

/// What is left of each group, and the reduction that is predicted and achieved. Corrects what the library explains by what it does once
/// it is switched on.
fn reduce(
    found: &mut Explained,
    groups: &Groups<'_>,
    linear: &[f64],
    switched: Option<&[f32]>,
) -> (Vec<f64>, f64, Option<f64>) {
    let data = groups.data;
    let weights = &groups.training;
    // What cross-validation loses against the fit itself.
    let optimism = groups.reduction(linear, weights)
        - found.library * data.scale(weights)
            / (weighted(&groups.before, weights) - data.floor(weights)).max(1e-9);
    let optimism = optimism.max(0.0);
    let Some(left) = switched else {
        return (linear.to_vec(), groups.reduction(linear, weights) - optimism, None);
    };
    let after = data.group_losses(left);
    let predicted = groups.reduction(&after, weights) - optimism;
    let achieved = groups.reduction(&after, &groups.kept);
    // What holds on contacts that nothing was fitted to is what is explained.
    let systematic = data.gap.systematic;
    let discrepancy = found.both - found.library;
    if found.library - achieved * systematic > APART * systematic {
        for named in &mut found.named {
            named.tier = Tier::Loose;
        }
        found.warnings.push(format!(
            "to first order the named effects explain {} % of the systematic gap, and switched on they remove {} %: what makes it is \
             like them, and may be another",
            percent(found.library / systematic),
            percent(achieved)
        ));
    }
    // Where the words of a skin description say an effect badly, its signature still does; where they are no help at all on other
    // contacts, it was none, and what is far beyond the simulator's declared error is no matter of words.
    let stretched = (groups.fvu(&after) - data.gap.floor) / data.options.select.margin;
    let signature = if achieved > HELPS && stretched < STRETCHED { found.library } else { 0.0 };
    found.library = signature.max(achieved * systematic);
    found.both = found.library + discrepancy.max(0.0);
    (after, predicted, Some(achieved))
}

/// Standard deviation of the reduction over other draws of groups: selection, fit, and what is kept.
fn spread(
    groups: &Groups<'_>,
    selected: &Selected,
    (linear, after): (&[f64], &[f64]),
) -> Result<f64, GapError> {
    let data = groups.data;
    let options = data.options;
    let mut rng = ChaCha8Rng::seed_from_u64(options.select.seed ^ 0xb007);
    let count = groups.training.len();
    let train: Vec<usize> = (0..count).filter(|g| groups.training[*g] > 0.0).collect();
    let kept: Vec<usize> = (0..count).filter(|g| groups.training[*g] == 0.0).collect();
    let mut draw = |from: &[usize]| {
        let mut weights = vec![0.0; count];
        for _ in 0..from.len() {
            weights[from[rng.random_range(0..from.len())]] += 1.0;
        }
        weights
    };
    let draws: Vec<[Vec<f64>; 2]> = (0..options.resamples).map(|_| [draw(&train), draw(&kept)]).collect();
    announce(&options.progress, "drawing other locations", options.resamples);
    let again = |[again, ends]: &[Vec<f64>; 2]| {
        if options.stop.load(Ordering::Relaxed) {
            return None;
        }
        let selector = data.selector(&selected.statistics, &selected.gram, again);
        let picks: Vec<usize> = selector.quick();
        let fit = selector.fit_all(&picks, Tier::Loose);
        let losses: Vec<f64> = (0..data.samples.groups).map(|g| selected.statistics.loss(g, &fit)).collect();
        options.progress.inc(1);
        // How far this draw is from the one at hand, by the same linear signatures; and what other contacts would give.
        let moved = groups.reduction(&losses, &groups.kept) - groups.reduction(linear, &groups.kept);
        Some(moved + groups.reduction(after, ends) - groups.reduction(after, &groups.kept))
    };
    let drawn: Option<Vec<f64>> = in_parallel(draws.len(), |i| again(&draws[i])).into_iter().collect();
    let drawn = drawn.ok_or(GapError::Interrupted)?;
    Ok((drawn.iter().map(|d| d * d).sum::<f64>() / drawn.len().max(1) as f64).sqrt())
}

/// The reduction with its interval in another recording of the same device.
fn interval(
    data: &Data<'_>,
    named: &[NamedEffect],
    doubt: f64,
    (predicted, achieved, spread): (f64, Option<f64>, f64),
) -> ResidualReduction {
    // The floor is an estimate, too: nothing removes more than all.
    let predicted = predicted.min(1.0);
    let achieved = achieved.map(|a| a.min(1.0));
    let centre = achieved.unwrap_or(predicted);
    // What depends on the past meets another one, and what drifts randomly goes another way: switched on there, it is wrong twice.
    let share = |of: &dyn Fn(&str) -> bool| {
        let of = named.iter().filter(|named| of(&named.label)).map(|named| named.shapley);
        of.sum::<f64>().clamp(0.0, 1.0) * centre.max(0.0)
    };
    let past = HISTORY * share(&|name| data.simulator.is_stateful(name));
    let candidates = &data.signatures.candidates;
    let drifting = 2.0 * share(&|name| candidates.iter().any(|c| c.name == name && c.drifts_randomly));
    // Other presses meet the laws elsewhere, and the floor is an estimate.
    let parts = [Z90 * spread, centre - predicted, ELSEWHERE, doubt, past];
    let half = parts.iter().map(|p| p * p).sum::<f64>().sqrt();
    // What would make the gap more than twice as large is no statement of its reduction.
    let interval = [(centre - half - drifting).max(-1.0), (centre + half).min(1.0)];
    ResidualReduction { predicted, achieved, interval }
}

#[cfg(test)]
mod tests;
