//! Values of one candidate on the full simulator.

use dermis_model::common_effect;
use dermis_skin::Effect;

use super::{FittedCandidate, Refiner, with};
use crate::constants::Z90;
use crate::constants::select::PRIOR;
use crate::diagnose::{prior, write};
use crate::nonlinear_refinement::{self, Free};
use crate::report::{Alternative, NamedEffect, Value};
use crate::statistics::{Fit, Statistics};
use crate::{GapError, design, effects, whitening};

/// Effects with their values, what the full simulator reads with them, and the values for people.
type Written = (Vec<Effect>, Vec<f32>, Vec<Value>);
/// Effects with their values, what the full simulator reads with them, and half of the interval of each number.
type RefinedLinear = (Vec<Effect>, Vec<f32>, Vec<(Free, f64)>);

impl Refiner<'_> {
    /// A candidate with values, simulated in full beside `beside`; `None` where it cannot be written down.
    pub(super) fn fit(
        &self,
        candidate: usize,
        fit: &Fit,
        beside: &[Effect],
    ) -> Result<Option<FittedCandidate>, GapError> {
        let of = &self.data.signatures.candidates[candidate];
        let found = if of.starts.is_empty() || !of.linear.is_empty() {
            self.fit_linear(candidate, fit, beside)?
        } else {
            self.fit_family(candidate, fit, beside)?
        };
        let Some((effects, read, mut values)) = found else { return Ok(None) };
        prior::score(&self.data, &of.name, &mut values);
        let target = self.data.target(self.weights, self.discrepancy, &self.data.options.progress);
        let (_, energy) = target.residual(&read);
        let left = whitening::residual(self.data.readings, &read, self.data.sigma);
        Ok(Some(FittedCandidate { candidate, effects, left, energy, score: f64::INFINITY, values }))
    }

    /// Gives a named effect its other names. Those that are numbers of the description are fitted as such; where there is one, and no
    /// other effect, the description is corrected by that number.
    pub(super) fn name_aliases(
        &self,
        named: &mut NamedEffect,
        fits: &mut [FittedCandidate],
        beside: &[Effect],
    ) -> Result<(), GapError> {
        let candidates = &self.data.signatures.candidates;
        let skin = self.data.simulator.skin;
        let known = std::mem::take(&mut named.class);
        for (place, member) in known.into_iter().enumerate() {
            let of = candidates.iter().find(|c| c.name == member.name).map_or(&[][..], |c| &c.aliases);
            let (gain, p_confuse) = (member.gain, member.p_confuse);
            named.class.push(member);
            for name in of {
                let mut alias = Alternative {
                    name: name.clone(),
                    gain,
                    p_confuse,
                    angle: Some(0.0),
                    rig: common_effect(name).is_some_and(|c| c.rig),
                    alias: true,
                    values: Vec::new(),
                    effects: Vec::new(),
                };
                if let Some(nominal) = design::value(skin, name) {
                    let start = vec![design::hypothesis(name, nominal)];
                    let (effects, read, halves) = self.refine_linear(start, beside)?;
                    let value = effects.first().and_then(|e| e.parameters.get(design::VALUE).copied());
                    let Some(value) = value else { continue };
                    let half = halves.first().map(|(_, half)| *half).filter(|half| half.is_finite());
                    let interval = half.map(|half| [value - half, value + half]);
                    let (name, unit) = (name.clone(), String::new());
                    alias.values = vec![Value { name, value, unit, interval, plausibility: None }];
                    prior::score(&self.data, &alias.name, &mut alias.values);
                    alias.effects.clone_from(&effects);
                    if place == 0 {
                        named.theta.extend(alias.values.iter().cloned());
                        if let (1, Some(first)) = (of.len(), fits.first_mut()) {
                            first.left = whitening::residual(self.data.readings, &read, self.data.sigma);
                            first.effects = effects;
                            named.written = true;
                        }
                    }
                }
                named.class.push(alias);
            }
        }
        Ok(())
    }

    /// A candidate that is written by its coefficients.
    fn fit_linear(
        &self,
        candidate: usize,
        fit: &Fit,
        beside: &[Effect],
    ) -> Result<Option<Written>, GapError> {
        let of = &self.data.signatures.candidates[candidate];
        let own = write::effects(&self.data, self.selected, candidate, fit, self.weights);
        if own.is_empty() {
            return Ok(None);
        }
        let (own, read, fitted) = self.refine_linear(own, beside)?;
        let halves = half_widths(&self.selected.statistics, fit, &of.columns, self.weights);
        let mut values = Vec::new();
        for effect in &own {
            for (name, value) in &effect.parameters {
                let unit = common_effect(&effect.name).map_or("", |c| c.unit_of(name));
                let unit = if unit.is_empty() { self.data.simulator.skin.unit.as_str() } else { unit };
                let at = of.linear.iter().position(|(e, p, _)| *e == effect.name && p == name);
                let half = fitted
                    .iter()
                    .find(|(f, _)| f.effect == effect.name && f.parameter == *name)
                    .map(|(_, half)| *half)
                    .or_else(|| {
                        at.filter(|_| !of.depends_on_uptime).map(|i| halves[i] * of.linear[i].2.abs())
                    });
                let number = design::value(self.data.simulator.skin, &effect.name).is_some();
                let (name, unit) = if number { (&effect.name, "") } else { (name, unit) };
                let name = if own.len() > 1 { format!("{} of {}", name, effect.name) } else { name.clone() };
                values.push(Value {
                    name,
                    value: *value,
                    unit: unit.to_owned(),
                    interval: half.filter(|h| h.is_finite()).map(|h| [value - h, value + h]),
                    plausibility: None,
                });
            }
        }
        Ok(Some((own, read, values)))
    }

    /// A candidate of the family that starts from its realisations.
    fn fit_family(
        &self,
        candidate: usize,
        fit: &Fit,
        beside: &[Effect],
    ) -> Result<Option<Written>, GapError> {
        let data = &self.data;
        let of = &data.signatures.candidates[candidate];
        let Some(info) = data.simulator.effects.iter().find(|i| i.name == of.name) else { return Ok(None) };
        if info.random {
            return Ok(None);
        }
        let mut free: Vec<Free> = nonlinear_refinement::free(info);
        let mut starts: Vec<Vec<Effect>> = write::starts(&self.selected.columns, of, fit)
            .into_iter()
            .map(|effect| with(beside, &[effect]))
            .collect();
        if data.options.nonlinear_refinement == 0 {
            starts.truncate(1);
            free.clear();
        }
        let target = data.target(self.weights, self.discrepancy, &data.options.progress);
        let refined = nonlinear_refinement::fit(data.simulator, &target, &starts, &free)?;
        let effect = refined.effects.iter().find(|e| e.name == of.name).cloned();
        let Some(effect) = effect else { return Ok(None) };
        let values = info
            .parameters
            .iter()
            .map(|p| {
                let value = info.value(&effect, p.name);
                let half = free.iter().position(|f| f.parameter == p.name);
                let half = half.and_then(|i| refined.halves.get(i)).copied().filter(|h| h.is_finite());
                let interval = half.map(|h| [value - h, value + h]);
                Value {
                    name: p.name.to_owned(),
                    value,
                    unit: p.unit.to_owned(),
                    interval,
                    plausibility: None,
                }
            })
            .collect();
        Ok(Some((vec![effect], refined.readings, values)))
    }

    /// Effects with values of a linear fit, fitted on the full simulator where they have few of them: what is linear in small
    /// (a shift, a delay) is not in large, and a parameter that hardly shows must not run away. Their readings beside `beside`,
    /// and half of the 90 % interval of what was fitted.
    fn refine_linear(&self, own: Vec<Effect>, beside: &[Effect]) -> Result<RefinedLinear, GapError> {
        let data = &self.data;
        let period = 1.0 / data.simulator.skin.rate;
        let numbers = own.iter().filter_map(|e| design::free(data.simulator.skin, e));
        let free = own.iter().flat_map(|e| effects::free_numbers(e, period));
        let free: Vec<Free> = free.chain(numbers).collect();
        if free.is_empty() || data.options.nonlinear_refinement == 0 {
            let read = data.simulate(&with(beside, &own))?;
            return Ok((own, read, Vec::new()));
        }
        let mut neutral = own.clone();
        for effect in &mut neutral {
            for f in free.iter().filter(|f| f.effect == effect.name) {
                effect.parameters.insert(f.parameter.clone(), f.typical);
            }
        }
        let starts: Vec<Vec<Effect>> = [&own, &neutral].map(|e| with(beside, e)).into();
        let target = data.target(self.weights, self.discrepancy, &data.options.progress);
        let refined = nonlinear_refinement::fit(data.simulator, &target, &starts, &free)?;
        let fitted =
            own.iter().filter_map(|e| refined.effects.iter().find(|p| p.name == e.name).cloned()).collect();
        Ok((fitted, refined.readings, free.into_iter().zip(refined.halves).collect()))
    }
}

/// Half of the 90 % interval of coefficients, from the spread of scores over groups (the sandwich estimate of Huber 1967 and White
/// 1980, clustered by groups).
fn half_widths(statistics: &Statistics, fit: &Fit, of: &[usize], weights: &[f64]) -> Vec<f64> {
    let sum = statistics.sum(weights);
    let scores: Vec<Vec<f64>> = (0..statistics.groups())
        .filter(|g| weights[*g] > 0.0)
        .map(|g| {
            let fitted = statistics.project(g, fit, &fit.set);
            fit.set.iter().zip(fitted).map(|(&c, f)| weights[g] * (statistics.score(g)[c] - f)).collect()
        })
        .collect();
    let factor = sum.factor(&fit.set, |_, g| g * (1.0 + 1e-9) + PRIOR);
    of.iter()
        .map(|c| {
            let at = fit.set.iter().position(|s| s == c);
            let (Some(at), Some(factor)) = (at, &factor) else { return f64::NAN };
            let mut row = vec![0.0; fit.set.len()];
            row[at] = 1.0;
            let row = factor.solve(&row);
            let variance: f64 =
                scores.iter().map(|s| row.iter().zip(s).map(|(r, s)| r * s).sum::<f64>().powi(2)).sum();
            Z90 * variance.sqrt()
        })
        .collect()
}
