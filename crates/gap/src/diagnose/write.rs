//! Coefficients of columns as effects with values, in the words of a skin description.

use dermis_model::diagnosis::Signature;
use dermis_skin::{Effect, SkinDescription};

use super::data::Data;
use super::select::Selected;
use crate::algebra::{cholesky_solve, dot};
use crate::constants::refine::{HELD, STARTS};
use crate::constants::select::PRIOR;
use crate::design;
use crate::effects;
use crate::signatures::{Candidate, uptime};
use crate::statistics::{Column, Fit};
use crate::whitening::whiten;

/// What one column stands for: effect, parameter, amount for a coefficient of 1.
type Part = (String, String, f64);

/// What a candidate with the coefficients of a fit is in the words of a skin description; empty where there are none for it.
pub(super) fn effects(
    data: &Data<'_>,
    selected: &Selected,
    candidate: usize,
    fit: &Fit,
    weights: &[f64],
) -> Vec<Effect> {
    let of = &data.signatures.candidates[candidate];
    if let Signature::DecayFromPowerOn { time, share } = effects::of(&of.name).signature {
        return vec![decay(data, &selected.columns, of, fit, (time, share))];
    }
    if !of.linear.is_empty() {
        let parts = of.columns.iter().zip(&of.linear).map(|(c, part)| (part, fit.of(*c)));
        return proportional(data.simulator.skin, parts);
    }
    if !of.starts.is_empty() {
        return starts(&selected.columns, of, fit).into_iter().take(1).collect();
    }
    channel_by_channel(data, &selected.columns, of, fit, weights)
}

/// The same where a device can have such values, nothing otherwise: a place beside the surface, say.
pub(super) fn possible(data: &Data<'_>, effects: Vec<Effect>) -> Vec<Effect> {
    let skin = data.simulator.with(&effects);
    let first: Vec<usize> = data.samples.frames().into_iter().take(1).collect();
    let possible = data.simulator.readings(&skin, data.recording, &first).is_ok();
    if possible { effects } else { Vec::new() }
}

/// Coefficients of linear parts.
fn proportional<'p>(skin: &SkinDescription, parts: impl Iterator<Item = (&'p Part, f64)>) -> Vec<Effect> {
    let mut found: Vec<Effect> = Vec::new();
    // A direction that stands for no amount is fitted with the one that does.
    for ((name, parameter, amount), coefficient) in parts.filter(|((.., amount), _)| *amount != 0.0) {
        let value = match design::value(skin, name) {
            Some(nominal) => design::within(nominal, nominal + coefficient * amount),
            None => effects::value(effects::of(name), coefficient, *amount),
        };
        match found.iter_mut().find(|e| e.name == *name) {
            Some(effect) => {
                effect.parameters.insert(parameter.clone(), value);
            }
            None => found.push(Effect::new(name.clone()).with(parameter.clone(), value)),
        }
    }
    found
}

/// Realisations that are nearest to what the linear fit says, the nearest first.
pub(super) fn starts(columns: &[Column], of: &Candidate, fit: &Fit) -> Vec<Effect> {
    let theta: Vec<f64> = of.columns.iter().map(|c| fit.of(*c)).collect();
    let norms: Vec<f64> = of.columns.iter().map(|c| dot(&columns[*c].values, &columns[*c].values)).collect();
    let energy = |a: &[f64]| -> f64 { a.iter().zip(a).zip(&norms).map(|((a, b), n)| a * b * n).sum() };
    let mut ranked: Vec<(f64, &Effect)> = of
        .starts
        .iter()
        .map(|(effect, at)| {
            let away: Vec<f64> = theta.iter().zip(at).map(|(t, a)| t - a).collect();
            (energy(&away), effect)
        })
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut found: Vec<Effect> = ranked.into_iter().take(STARTS).map(|(_, e)| e.clone()).collect();
    // A strength that is not 1 is what the file said; values are fitted at full strength.
    found.iter_mut().for_each(|e| e.strength = 1.0);
    found
}

/// One parameter of a decay from power-on.
struct Course {
    parameter: String,
    /// Value in its unit for a value of 1 in the course.
    unit: f64,
    /// One value a sample.
    values: Vec<f32>,
    /// Columns that are in it.
    count: usize,
}

/// What decays from power-on: columns say the course of each channel and of all, a file the values at power-on and one time constant
/// for all.
fn decay(
    data: &Data<'_>,
    columns: &[Column],
    of: &Candidate,
    fit: &Fit,
    (time, share): (&str, (&str, f64)),
) -> Effect {
    let n = data.samples.list.len();
    // Readings in deviations of the noise, root mean square: what a share of the sensitivity is worth.
    let model = whiten(&data.signatures.nominal, data.sigma);
    let weight = (dot(&model, &model) / n.max(1) as f64).sqrt().max(1e-9);
    let tared = data.signatures.zero.is_subtracted();
    let decays: Vec<Vec<f32>> =
        uptime::decays(data.samples, tared).iter().map(uptime::Course::since_zero).collect();
    let mut courses: Vec<Course> = Vec::new();
    for (&c, (_, parameter, amount)) in of.columns.iter().zip(&of.linear) {
        let (column, x) = (&columns[c], fit.of(c) as f32);
        if courses.last().is_none_or(|last| last.parameter != *parameter) {
            let unit = column.channel.map_or(1.0 / weight, |k| data.sigma[k]);
            courses.push(Course { parameter: parameter.clone(), unit, values: vec![0.0; n], count: 0 });
        }
        let Some(course) = courses.last_mut() else { continue };
        match column.channel {
            Some(_) => course.values.iter_mut().zip(&column.values).for_each(|(w, v)| *w += x * v),
            // Of a column of all channels only the course itself is wanted.
            None => {
                let factor = x * (amount * weight) as f32;
                let of = decays.get(course.count).map_or(&[][..], Vec::as_slice);
                course.values.iter_mut().zip(of).for_each(|(w, v)| *w += factor * v);
            }
        }
        course.count += 1;
    }
    let values: Vec<Vec<f32>> = courses.iter().map(|c| c.values.clone()).collect();
    let (values, seconds) = uptime::fit_decay(data.samples, tared, &values);
    let mut effect = Effect::new(of.name.clone()).with(time, seconds);
    for (course, value) in courses.into_iter().zip(values) {
        let value = value * course.unit;
        if value.is_finite() {
            let value = if course.parameter == share.0 { value.max(share.1) } else { value };
            effect.parameters.insert(course.parameter, value);
        }
    }
    effect
}

/// What a random effect does to each channel, said by the effects that describe channels: offsets, gains and locations. Empty where they
/// do not hold most of it.
fn channel_by_channel(
    data: &Data<'_>,
    columns: &[Column],
    of: &Candidate,
    fit: &Fit,
    weights: &[f64],
) -> Vec<Effect> {
    let list = &data.samples.list;
    let words: Vec<(usize, &Part)> = data
        .signatures
        .candidates
        .iter()
        .filter(|c| effects::of(c.written_as.as_deref().unwrap_or(&c.name)).describes_channels)
        .flat_map(|c| c.columns.iter().copied().zip(&c.linear))
        .collect();
    let (mut held, mut all) = (0.0, 0.0);
    let mut parts: Vec<(&Part, f64)> = Vec::new();
    for k in 0..data.channels() {
        let mut wanted = vec![0.0f32; list.len()];
        for &c in of.columns.iter().filter(|c| columns[**c].channel == Some(k)) {
            let x = fit.of(c) as f32;
            wanted.iter_mut().zip(&columns[c].values).for_each(|(w, v)| *w += x * v);
        }
        for (w, sample) in wanted.iter_mut().zip(list) {
            *w *= weights[sample.group] as f32;
        }
        let own: Vec<&(usize, &Part)> =
            words.iter().filter(|(c, _)| columns[*c].channel == Some(k)).collect();
        let m = own.len();
        let mut a = vec![0.0; m * m];
        let mut b = vec![0.0; m];
        for (i, (c, _)) in own.iter().enumerate() {
            b[i] = dot(&columns[*c].values, &wanted);
            for (j, (d, _)) in own.iter().enumerate() {
                let products = columns[*c].values.iter().zip(&columns[*d].values).zip(list);
                a[i * m + j] =
                    products.map(|((x, y), s)| weights[s.group] * f64::from(*x) * f64::from(*y)).sum();
            }
            a[i * m + i] = a[i * m + i] * (1.0 + 1e-6) + PRIOR;
        }
        let score = b.clone();
        if cholesky_solve(&mut a, m, &mut b).is_some() {
            held += b.iter().zip(&score).map(|(x, s)| x * s).sum::<f64>();
            parts.extend(own.iter().zip(&b).map(|((_, part), x)| (*part, *x)));
        }
        all += dot(&wanted, &wanted);
    }
    if all > 0.0 && held > HELD * all {
        proportional(data.simulator.skin, parts.into_iter())
    } else {
        Vec::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_become_values_of_effects() {
        let part = |name: &str, parameter: &str, amount| (name.to_owned(), parameter.to_owned(), amount);
        let parts = [
            part("channel-gain", "a", 0.05),
            part("channel-gain", "b", 0.05),
            part("delay", "time", 0.1),
            part("delay", "time", 0.0),
            part("medium.spread", "value", 0.25),
        ];
        let found = proportional(&crate::testing::skin(), parts.iter().zip([2.0, -1.0, 0.5, 9.0, 0.4]));
        assert_eq!(found.len(), 3);
        assert!((found[0].parameters["a"] - 1.1).abs() < 1e-12 && found[0].parameters["b"] == 0.95);
        assert_eq!(found[1].parameters["time"], 0.05);
        assert_eq!(found[2].parameters["value"], 1.1);
    }
}
