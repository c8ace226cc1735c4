//! Stage `refine`: values of the selected effects on the full simulator.
//!
//! Signatures are linear: what is small (a shift, a delay) is found by them, and what is large is not. So each selected effect, and each
//! candidate that cannot be told from it, is fitted by least squares on the full simulator (Levenberg and Marquardt) beside the
//! others, with the model discrepancy making the best of what is left. The label goes to the one that does best; effects that the
//! others do as well without are dropped.

mod values;

use dermis_skin::Effect;

use super::data::Data;
use super::select::Selected;
use super::{announce, prior, write};
use crate::GapError;
use crate::nonlinear_refinement::ModelDiscrepancy;
use crate::report::{Alternative, NamedEffect, Value};
use crate::select::{AcceptedEffect, IndistinguishableEffect, Selector, Tier};
use crate::statistics::{Column, Fit, Statistics};

/// A candidate with values, and what the full simulator makes of it.
#[derive(Clone)]
pub(super) struct FittedCandidate {
    pub candidate: usize,
    pub effects: Vec<Effect>,
    /// What it leaves, in deviations of the noise.
    left: Vec<f32>,
    /// The energy of it in training, with the model discrepancy making the best of it.
    energy: f64,
    /// How badly its model does ([`Selector::weigh`]).
    score: f64,
    values: Vec<Value>,
}

/// Named effects with their values.
#[derive(Default)]
pub(super) struct Refined {
    pub named: Vec<NamedEffect>,
    /// For each of them the candidates that can be simulated, the best first; none where its signature only says what it does.
    pub fits: Vec<Vec<FittedCandidate>>,
    /// Its candidates.
    pub set: Vec<usize>,
    pub warnings: Vec<String>,
}

impl Refined {
    /// What is switched on for all of them.
    pub fn effects(&self) -> Vec<Effect> {
        let mut effects: Vec<Effect> = Vec::new();
        for first in self.fits.iter().filter_map(|of| of.first()) {
            Effect::merge(&mut effects, first.effects.clone());
        }
        effects
    }
}

/// What all fits of this stage share.
#[derive(Clone, Copy)]
struct Refiner<'a> {
    data: Data<'a>,
    selected: &'a Selected,
    training: &'a Selector<'a>,
    weights: &'a [f64],
    discrepancy: &'a ModelDiscrepancy,
    /// Effects that are switched on whatever else is.
    fixed: &'a [Effect],
}

/// Fits the values of what was selected. `fixed` are effects that are switched on in any case.
pub(super) fn refine(data: &Data<'_>, selected: &Selected, fixed: &[Effect]) -> Result<Refined, GapError> {
    let weights = data.samples.training();
    let training = data.selector(&selected.statistics, &selected.gram, &weights);
    let own: Vec<&Column> = data.signatures.discrepancy.iter().map(|c| &selected.columns[*c]).collect();
    let prior = data.signatures.discrepancy.first().map_or(1.0, |f| training.prior(*f));
    let discrepancy = ModelDiscrepancy::new(&own, data.samples, data.channels(), &weights, prior);
    announce(&data.options.progress, "fitting values", 0);
    let refiner = Refiner {
        data: *data,
        selected,
        training: &training,
        weights: &weights,
        discrepancy: &discrepancy,
        fixed,
    };
    let mut found = Refined { set: selected.set(), ..Refined::default() };
    for pick in &selected.selection.picks {
        refiner.pick(pick, &mut found)?;
    }
    refiner.drop_unneeded(&mut found)?;
    Ok(found)
}

impl Refiner<'_> {
    /// Names one selected effect, fitted beside the others.
    fn pick(&self, pick: &AcceptedEffect, found: &mut Refined) -> Result<(), GapError> {
        let candidates = &self.data.signatures.candidates;
        let set = self.selected.set();
        let fit = self.training.fit_all(&set, Tier::Loose);
        // What another one is named needs no second name.
        let taken = |c: usize| found.fits.iter().any(|of| of.iter().any(|t| t.candidate == c));
        let mut members: Vec<&IndistinguishableEffect> = pick.class.iter().collect();
        members.retain(|m| m.candidate == pick.candidate || !taken(m.candidate));
        members.truncate(self.data.options.nonlinear_refinement.max(1));
        let (beside, unwritten) = self.others(pick, &fit, &found.fits);
        let readings = self.data.readings_without(&self.selected.columns, &fit, &unwritten);
        let alone = Refiner { data: Data { readings: &readings, ..self.data }, ..*self };
        let mut of = Vec::new();
        let mut open: Vec<IndistinguishableEffect> = Vec::new();
        for member in members {
            let candidate = member.candidate;
            let model: Vec<usize> =
                set.iter().map(|c| if *c == pick.candidate { candidate } else { *c }).collect();
            let refit = if candidate == pick.candidate {
                fit.clone()
            } else {
                self.training.fit_all(&model, Tier::Loose)
            };
            match alone.fit(candidate, &refit, &beside) {
                Ok(Some(mut one)) => {
                    one.score = self.training.weigh(one.energy, 0.0, &model) + prior::cost(&one.values);
                    of.push(one);
                }
                Ok(None) => open.push(member.clone()),
                Err(GapError::Interrupted) => return Err(GapError::Interrupted),
                Err(error) => {
                    found.warnings.push(format!("{}: {error}", candidates[candidate].name));
                    open.push(member.clone());
                }
            }
        }
        if set.len() > 1 {
            alone.score_open(&mut open, pick.candidate, &beside)?;
        }
        let mut named = self.name(pick, &mut of, &open);
        // The label decides what the others stand beside: the first, or none where it cannot be written.
        if of.first().is_some_and(|t| candidates[t.candidate].name != named.label) {
            of.clear();
        }
        alone.name_aliases(&mut named, &mut of, &beside)?;
        found.named.push(named);
        found.fits.push(of);
        Ok(())
    }

    /// What a selected effect stands beside: the others with values, and columns of those that cannot be written.
    fn others(
        &self,
        pick: &AcceptedEffect,
        fit: &Fit,
        fits: &[Vec<FittedCandidate>],
    ) -> (Vec<Effect>, Vec<usize>) {
        let mut beside = self.fixed.to_vec();
        // What cannot be written is taken out of the readings as its signature says.
        let mut unwritten: Vec<usize> = Vec::new();
        for (j, other) in self.selected.selection.picks.iter().enumerate() {
            if other.candidate == pick.candidate {
                continue;
            }
            let effects = match fits.get(j) {
                Some(done) => done.first().map_or_else(Vec::new, |t| t.effects.clone()),
                None => {
                    let linear =
                        write::effects(&self.data, self.selected, other.candidate, fit, self.weights);
                    write::possible(&self.data, linear)
                }
            };
            if effects.is_empty() {
                unwritten.extend(&self.data.signatures.candidates[other.candidate].columns);
            }
            Effect::merge(&mut beside, effects);
        }
        (beside, unwritten)
    }

    /// Candidates that cannot be simulated are where their signatures put them beside what is simulated in full.
    fn score_open(
        &self,
        open: &mut [IndistinguishableEffect],
        named: usize,
        beside: &[Effect],
    ) -> Result<(), GapError> {
        if open.is_empty() {
            return Ok(());
        }
        let rest = self.data.residual(&self.data.simulate(beside)?);
        let rest = Statistics::new(&self.selected.columns, &rest, self.data.samples, self.data.channels());
        let selector =
            self.data.selector(&rest, &self.selected.gram, self.weights).measured_as(self.training);
        let others: Vec<usize> = self.selected.set().into_iter().filter(|c| *c != named).collect();
        for member in open {
            member.score = selector.score(&[member.candidate]) + self.training.weigh(0.0, 0.0, &others);
        }
        Ok(())
    }

    /// Drops effects that the others, fitted again on the full simulator, do as well without: signatures are linear, and what is large
    /// may have needed one more of them.
    fn drop_unneeded(&self, found: &mut Refined) -> Result<(), GapError> {
        let Refined { named, fits, set, .. } = found;
        let Some(mut score) = fits.last().and_then(|of| of.first()).map(|t| t.score) else { return Ok(()) };
        let mut i = 0;
        while set.len() > 1 && i < set.len() && fits.iter().all(|of| !of.is_empty()) {
            // The others, the strongest of them fitted again.
            let again =
                (0..set.len()).filter(|j| *j != i).max_by(|a, b| named[*a].gain.total_cmp(&named[*b].gain));
            let Some(again) = again else { return Ok(()) };
            let mut beside = self.fixed.to_vec();
            for (_, of) in fits.iter().enumerate().filter(|(j, _)| *j != i && *j != again) {
                Effect::merge(&mut beside, of[0].effects.clone());
            }
            let candidate = fits[again][0].candidate;
            let of = |j: usize| if j == again { candidate } else { set[j] };
            let model: Vec<usize> = (0..set.len()).filter(|j| *j != i).map(of).collect();
            let fit = self.training.fit_all(&model, Tier::Loose);
            match self.fit(candidate, &fit, &beside) {
                Ok(Some(mut one)) => {
                    one.score = self.training.weigh(one.energy, 0.0, &model) + prior::cost(&one.values);
                    if one.score <= score {
                        score = one.score;
                        named[again].theta.clone_from(&one.values);
                        fits[again][0] = one;
                        fits.remove(i);
                        named.remove(i);
                        set.remove(i);
                        continue;
                    }
                }
                Ok(None) => return Ok(()),
                Err(GapError::Interrupted) => return Err(GapError::Interrupted),
                // What it would be without the other no device can have.
                Err(_) => {}
            }
            i += 1;
        }
        Ok(())
    }

    /// Names an effect: the label may change, where the full simulator says so.
    fn name(
        &self,
        pick: &AcceptedEffect,
        fits: &mut Vec<FittedCandidate>,
        linear: &[IndistinguishableEffect],
    ) -> NamedEffect {
        let candidates = &self.data.signatures.candidates;
        let statistics = &self.selected.statistics;
        let open = 2.0 * self.data.options.select.decisive_odds.ln();
        let chance = |worse: f64| 1.0 / (1.0 + (0.5 * worse).min(300.0).exp());
        fits.sort_by(|a, b| a.score.total_cmp(&b.score));
        let best = fits.first().map_or(f64::INFINITY, |t| t.score);
        let best = linear.iter().map(|m| m.score).fold(best, f64::min);
        fits.retain(|t| t.score - best < open);
        let weights = self.weights;
        let before: f64 = (0..self.data.samples.groups).map(|g| statistics.energy(g) * weights[g]).sum();
        let gain = |t: &FittedCandidate| {
            let left: f64 = self.data.group_losses(&t.left).iter().zip(weights).map(|(l, w)| l * w).sum();
            (before - left) / self.data.scale(weights)
        };
        let angle = |candidate: usize| {
            pick.class.iter().find(|m| m.candidate == candidate).map_or(f64::NAN, |m| m.angle)
        };
        let mut class: Vec<(usize, f64, f64, f64)> =
            fits.iter().map(|t| (t.candidate, gain(t), chance(t.score - best), angle(t.candidate))).collect();
        for member in linear.iter().filter(|m| m.score - best < open) {
            class.push((member.candidate, member.gain, chance(member.score - best), member.angle));
        }
        class.sort_by(|a, b| b.2.total_cmp(&a.2));
        let label = class.first().map_or(pick.candidate, |c| c.0);
        let own = fits.first().filter(|t| t.candidate == label);
        NamedEffect {
            label: candidates[label].name.clone(),
            what: candidates[label].what.clone(),
            p_confuse: class.iter().skip(1).map(|c| c.2).fold(0.0, f64::max),
            class: class
                .iter()
                .map(|(c, gain, p, angle)| Alternative {
                    name: candidates[*c].name.clone(),
                    gain: *gain,
                    p_confuse: *p,
                    angle: Some(angle.to_degrees()).filter(|a| a.is_finite()),
                    rig: candidates[*c].rig,
                    alias: false,
                    values: fits
                        .iter()
                        .find(|t| t.candidate == *c)
                        .map_or_else(Vec::new, |t| t.values.clone()),
                    effects: fits
                        .iter()
                        .find(|t| t.candidate == *c)
                        .map_or_else(Vec::new, |t| t.effects.clone()),
                })
                .collect(),
            covers: pick.covers.iter().map(|c| candidates[*c].name.clone()).collect(),
            tier: pick.tier,
            theta: own.map_or_else(Vec::new, |t| t.values.clone()),
            gain: pick.gain,
            solo: pick.solo,
            shapley: pick.shapley,
            p_max_t: pick.p,
            covariate_alias: Vec::new(),
            written: own.is_some_and(|t| !t.effects.is_empty()),
        }
    }
}

/// Effects on top of others.
fn with(beside: &[Effect], own: &[Effect]) -> Vec<Effect> {
    let mut all = beside.to_vec();
    Effect::merge(&mut all, own.iter().cloned());
    all
}

#[cfg(test)]
impl FittedCandidate {
    /// What another stage needs of a candidate with values.
    pub(super) fn written(candidate: usize, effects: Vec<Effect>) -> Self {
        Self { candidate, effects, left: Vec::new(), energy: 0.0, score: 0.0, values: Vec::new() }
    }
}

#[cfg(test)]
mod tests;
