//! Signatures of the effects that every skin can have: formulas over what the nominal model reads, or central differences.

use std::collections::BTreeSet;

use dermis_model::{common_effect, full_scale};
use dermis_skin::SkinDescription;

use super::{Candidate, Change, Changes, Signatures, central, uptime};
use crate::algebra::dot;
use crate::constants::check::KELVIN;
use crate::constants::signatures::{MOVED, NONLINEAR, SHIFT};
use crate::effects::{self, Properties, Signature};
use crate::samples::Samples;
use crate::statistics::Column;
use crate::zero_level::ZeroLevel;

/// \[K\] at which thermal effects are neutral.
const NEUTRAL: f64 = 293.15;

/// What one parameter of an effect changes.
pub(crate) struct Part {
    /// The effect in whose parameters it is written, where that is another one.
    effect: Option<&'static str>,
    pub(super) parameter: String,
    /// Value for which the column is.
    pub(super) amount: f64,
    pub(super) column: Column,
}

impl Part {
    fn new(parameter: impl Into<String>, amount: f64, column: Column) -> Self {
        Self { effect: None, parameter: parameter.into(), amount, column }
    }
}

/// What a formula says of an effect.
pub(crate) enum Parts {
    /// Its columns.
    Columns(Vec<Part>),
    /// Why it cannot be seen in this recording.
    Silent(&'static str),
    /// It is none that this skin can have.
    Inapplicable,
}

/// What formulas work on.
pub(crate) struct Context<'a> {
    skin: &'a SkinDescription,
    samples: &'a Samples,
    noise: &'a [f64],
    /// Readings of the nominal model, samples × channels.
    nominal: &'a [f32],
    zero: &'a ZeroLevel,
    /// Changes by all taxels moved along each axis.
    taxels: &'a [Vec<Change>; 3],
    names: Vec<String>,
    /// \[K\] of each sample.
    kelvin: Vec<f64>,
}

impl<'a> Context<'a> {
    fn new(
        skin: &'a SkinDescription,
        samples: &'a Samples,
        noise: &'a [f64],
        (nominal, zero): (&'a [f32], &'a ZeroLevel),
        taxels: &'a [Vec<Change>; 3],
    ) -> Self {
        let names = skin.channels().iter().map(|c| c.name.clone()).collect();
        let kelvin = samples.list.iter().map(|s| s.temperature).collect();
        Self { skin, samples, noise, nominal, zero, taxels, names, kelvin }
    }

    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn reading(&self, sample: usize, channel: usize) -> f64 {
        f64::from(self.nominal[sample * self.channels() + channel])
    }

    /// Mean deviation of the noise over channels.
    fn sigma(&self) -> f64 {
        self.noise.iter().sum::<f64>() / self.noise.len().max(1) as f64
    }

    /// \[K\] above the neutral temperature.
    fn warmth(&self, sample: usize) -> f64 {
        self.kelvin[sample] - NEUTRAL
    }

    /// One column for each channel: `amount` times `value` of sample and channel.
    fn of_channels(&self, amount: f64, value: impl Fn(usize, usize) -> f64) -> Vec<Part> {
        (0..self.channels())
            .map(|k| {
                let of = |i| (amount * value(i, k) / self.noise[k]) as f32;
                let values = (0..self.samples.list.len()).map(of).collect();
                Part::new(&self.names[k], amount, Column { channel: Some(k), values })
            })
            .collect()
    }

    /// One column for all channels: the reading times a factor of the sample.
    fn scaled(&self, factor: impl Fn(usize) -> f64) -> Column {
        let channels = self.channels();
        let value = |i: usize| {
            let (sample, k) = (i / channels, i % channels);
            factor(sample) * self.reading(sample, k) / self.noise[k]
        };
        let count = self.samples.list.len() * channels;
        Column { channel: None, values: (0..count).map(|i| value(i) as f32).collect() }
    }

    /// Why the temperature says nothing, where it does not.
    fn cold(&self) -> Option<&'static str> {
        if self.kelvin.iter().any(|t| !t.is_finite()) {
            return Some("the temperature is not recorded");
        }
        let (low, high) =
            self.kelvin.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), t| (l.min(*t), h.max(*t)));
        (high - low <= KELVIN).then_some("the temperature hardly changes in this recording")
    }
}

/// A constant for each channel.
pub(crate) fn offsets(of: &Context<'_>) -> Parts {
    Parts::Columns(of.of_channels(of.sigma(), |_, _| 1.0))
}

/// A factor for each channel. In a tared recording it scales signals: the zero was read with the same factor.
pub(crate) fn gains(of: &Context<'_>) -> Parts {
    Parts::Columns(of.of_channels(0.05, |i, k| of.reading(i, k)))
}

/// The square of the reading over the full scale, for each channel; in a tared recording less that of the zero.
pub(crate) fn curvatures(of: &Context<'_>) -> Parts {
    let full: Vec<f64> = of.skin.channels().iter().map(|c| full_scale(c, of.skin.noise)).collect();
    Parts::Columns(of.of_channels(0.05, |i, k| {
        let zero = of.zero.subtracted(k);
        ((of.reading(i, k) + zero).powi(2) - zero.powi(2)) / full[k]
    }))
}

/// Zeros that follow the temperature, linearly and by its square.
pub(crate) fn thermal_zeros(of: &Context<'_>) -> Parts {
    if let Some(why) = of.cold() {
        return Parts::Silent(why);
    }
    let mut zeros = of.of_channels(of.sigma(), |i, _| of.warmth(i));
    let squares = of.of_channels(0.1 * of.sigma(), |i, _| of.warmth(i) * of.warmth(i));
    zeros.extend(squares.into_iter().map(|part| Part { effect: Some("thermal-bend"), ..part }));
    Parts::Columns(zeros)
}

/// Factors that follow the temperature.
pub(crate) fn thermal_spans(of: &Context<'_>) -> Parts {
    match of.cold() {
        Some(why) => Parts::Silent(why),
        None => Parts::Columns(of.of_channels(0.01, |i, k| of.warmth(i) * of.reading(i, k))),
    }
}

/// A sensitivity that falls with the time in use, and with presses.
pub(crate) fn ageing(of: &Context<'_>) -> Parts {
    let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max).max(1e-9);
    let times: Vec<f64> = of.samples.list.iter().map(|s| s.time).collect();
    let counts = uptime::presses(of.samples);
    let (rate, wear) = (0.1 / largest(&times), 0.1 / largest(&counts));
    Parts::Columns(vec![
        Part::new("rate", rate, of.scaled(|i| -rate * times[i])),
        Part::new("wear", wear, of.scaled(|i| -wear * counts[i])),
    ])
}

/// Zeros, and one factor of all readings, that decay from power-on.
pub(crate) fn decays(of: &Context<'_>) -> Parts {
    let courses = uptime::decays(of.samples);
    let sigma = of.sigma();
    let mut parts: Vec<Part> = Vec::new();
    for k in 0..of.channels() {
        for course in &courses {
            let factor = (sigma / of.noise[k]) as f32;
            let values = course.iter().map(|v| v * factor).collect();
            parts.push(Part::new(&of.names[k], sigma, Column { channel: Some(k), values }));
        }
    }
    for course in &courses {
        parts.push(Part::new("span", 0.1, of.scaled(|i| 0.1 * f64::from(course[i]))));
    }
    Parts::Columns(parts)
}

/// Each taxel moved along each axis.
pub(crate) fn taxel_positions(of: &Context<'_>) -> Parts {
    let owners = of.skin.channel_taxels();
    // Channels of one taxel move together, which columns of a channel each cannot say.
    if owners.iter().collect::<BTreeSet<_>>().len() != owners.len() {
        return Parts::Inapplicable;
    }
    let channels = of.channels();
    let mut parts = Vec::new();
    for (axis, realised) in of.taxels.iter().enumerate() {
        let Some(slope) = central(realised) else { continue };
        for k in 0..channels {
            let value = |i: usize| slope[i * channels + k] * SHIFT as f32;
            let values = (0..of.samples.list.len()).map(value).collect();
            let name = format!("{}.{}", of.skin.taxels[owners[k]].name, ["x", "y", "z"][axis]);
            parts.push(Part::new(name, SHIFT, Column { channel: Some(k), values }));
        }
    }
    Parts::Columns(parts)
}

/// Columns of a simulated effect: for each parameter the central difference, and what a large amount changes beyond it.
pub(super) fn differences(mut realised: Vec<(String, Change)>) -> Vec<Part> {
    let mut parameters: Vec<String> = realised.iter().map(|(p, _)| p.clone()).collect();
    parameters.dedup();
    let mut parts = Vec::new();
    for parameter in parameters {
        let of: Vec<Change> = realised
            .iter_mut()
            .filter(|(p, _)| *p == parameter)
            .map(|(_, (amount, changed))| (*amount, std::mem::take(changed)))
            .collect();
        let reach = of.iter().map(|(a, _)| a.abs()).fold(0.0, f64::max);
        let Some(slope) = central(&of) else { continue };
        let values: Vec<f32> = slope.iter().map(|v| v * reach as f32).collect();
        let along = dot(&values, &values);
        // What a large amount changes beyond that is a direction of its own; the first one says the amount.
        let beyond = of.iter().find(|(amount, _)| *amount == reach).map(|(_, large)| {
            let part = (dot(large, &values) / along.max(1e-300)) as f32;
            large.iter().zip(&values).map(|(l, v)| l - part * v).collect::<Vec<f32>>()
        });
        parts.push(Part::new(&parameter, reach, Column { channel: None, values }));
        if let Some(values) = beyond.filter(|b| dot(b, b) > NONLINEAR * along) {
            parts.push(Part::new(parameter, 0.0, Column { channel: None, values }));
        }
    }
    parts
}

impl Signatures {
    /// Adds the effects of the table.
    pub(super) fn add_common(
        &mut self,
        skin: &SkinDescription,
        samples: &Samples,
        noise: &[f64],
        changes: &mut Changes,
    ) {
        let nominal = std::mem::take(&mut self.nominal);
        let least = MOVED * ((samples.list.len() * noise.len()) as f64).sqrt();
        let zero = std::mem::take(&mut self.zero);
        let context = Context::new(skin, samples, noise, (&nominal, &zero), &changes.taxels);
        for of in effects::TABLE {
            match of.signature {
                Signature::None => {}
                Signature::Formula(formula) => match formula(&context) {
                    Parts::Columns(parts) => self.add_linear(of, parts, least),
                    Parts::Silent(why) => self.silent.push((of.name.to_owned(), why.to_owned())),
                    Parts::Inapplicable => {}
                },
                Signature::Simulated(_) => {
                    if let Some(realised) = changes.common.remove(of.name) {
                        self.add_linear(of, differences(realised), least);
                    }
                }
            }
        }
        (self.nominal, self.zero) = (nominal, zero);
    }

    /// Adds an effect that is known by its columns, each of one parameter; those that move nothing are left out.
    fn add_linear(&mut self, of: &Properties, parts: Vec<Part>, least: f64) {
        let Some(info) = common_effect(of.name) else { return };
        let mut candidate = Candidate {
            name: of.name.to_owned(),
            what: info.what.to_owned(),
            family: false,
            rig: info.rig,
            number: false,
            columns: Vec::new(),
            per_channel: of.per_channel,
            drifts_randomly: false,
            nonlinear: of.nonlinear,
            depends_on_uptime: of.depends_on_uptime,
            written_as: None,
            aliases: Vec::new(),
            starts: Vec::new(),
            linear: Vec::new(),
        };
        for Part { effect, parameter, amount, column } in parts {
            if dot(&column.values, &column.values).sqrt() < least {
                continue;
            }
            candidate.columns.push(self.columns.len());
            candidate.linear.push((effect.unwrap_or(of.name).to_owned(), parameter, amount));
            self.columns.push(column);
        }
        if candidate.columns.is_empty() {
            self.silent.push((of.name.to_owned(), "nothing in this recording shows it".to_owned()));
        } else {
            self.candidates.push(candidate);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_amount_that_is_not_in_proportion_has_a_column_of_its_own() {
        let change = |amount: f64, values: [f32; 2]| ("time".to_owned(), (amount, values.to_vec()));
        let straight = differences(vec![change(1.0, [1.0, 0.0]), change(5.0, [5.0, 0.0])]);
        assert_eq!(straight.len(), 1);
        assert_eq!((straight[0].amount, straight[0].column.values.clone()), (5.0, vec![5.0, 0.0]));
        let curved = differences(vec![change(1.0, [1.0, 0.0]), change(5.0, [5.0, 2.0])]);
        assert_eq!(curved.len(), 2);
        assert_eq!((curved[1].amount, curved[1].column.values.clone()), (0.0, vec![0.0, 2.0]));
    }
}
