//! Signatures of the effects that every skin can have: formulas over what the nominal model reads, or central
//! differences, as the file of each effect declares ([`dermis_model::diagnosis`]).

use std::collections::BTreeSet;

use dermis_model::diagnosis::{Covariate, Share, Signature, SignatureSample};
use dermis_model::{COMMON, CommonEffect, NEUTRAL_TEMPERATURE, full_scale};
use dermis_skin::SkinDescription;

use super::{Candidate, Change, Changes, Signatures, central, uptime};
use crate::algebra::{dot, mean};
use crate::constants::check::KELVIN;
use crate::constants::signatures::{DECAY_SHARE, MOVED, NONLINEAR, SHIFT};
use crate::effects;
use crate::samples::Samples;
use crate::statistics::Column;
use crate::zero_level::ZeroLevel;

/// What one parameter of an effect changes.
pub(crate) struct Part {
    pub(super) parameter: String,
    /// Value for which the column is.
    pub(super) amount: f64,
    pub(super) column: Column,
}

impl Part {
    fn new(parameter: impl Into<String>, amount: f64, column: Column) -> Self {
        Self { parameter: parameter.into(), amount, column }
    }
}

/// What is known of the columns of an effect.
enum Parts {
    /// These.
    Columns(Vec<Part>),
    /// Why it cannot be seen in this recording.
    Silent(&'static str),
    /// It is none that this skin can have, or nothing in a residual shows it.
    Inapplicable,
}

/// What formulas work on.
struct Context<'a> {
    skin: &'a SkinDescription,
    samples: &'a Samples,
    noise: &'a [f64],
    /// Readings of the nominal model, samples × channels.
    nominal: &'a [f32],
    zero: &'a ZeroLevel,
    names: Vec<String>,
    /// Full scale of each channel.
    full_scale: Vec<f64>,
    /// Presses so far, at each sample.
    presses: Vec<f64>,
}

impl<'a> Context<'a> {
    fn new(
        skin: &'a SkinDescription,
        samples: &'a Samples,
        noise: &'a [f64],
        (nominal, zero): (&'a [f32], &'a ZeroLevel),
    ) -> Self {
        let channels = skin.channels();
        let names = channels.iter().map(|c| c.name.clone()).collect();
        let full_scale = channels.iter().map(|c| full_scale(c, skin.noise)).collect();
        let presses = uptime::presses(samples);
        Self { skin, samples, noise, nominal, zero, names, full_scale, presses }
    }

    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn reading(&self, sample: usize, channel: usize) -> f64 {
        f64::from(self.nominal[sample * self.channels() + channel])
    }

    fn at(&self, sample: usize, channel: usize) -> SignatureSample {
        let of = &self.samples.list[sample];
        SignatureSample {
            reading: self.reading(sample, channel) + self.zero.subtracted(channel),
            full_scale: self.full_scale[channel],
            warmer: of.temperature - NEUTRAL_TEMPERATURE,
            uptime: of.time,
            presses: self.presses[sample],
        }
    }

    /// In the frames that a sample's zero was measured from; `None` where nothing was subtracted.
    fn at_zero(&self, sample: usize, channel: usize) -> Option<SignatureSample> {
        let zero =
            self.samples.list[sample].zero.filter(|zero| zero.frames > 0 && self.zero.is_subtracted())?;
        Some(SignatureSample {
            reading: self.zero.subtracted(channel),
            full_scale: self.full_scale[channel],
            warmer: zero.temperature - NEUTRAL_TEMPERATURE,
            uptime: zero.time,
            presses: f64::from(zero.presses),
        })
    }

    /// One column for each channel: `amount` times the slope at sample and channel, less what a tare takes away of it. What only shifts
    /// channels (`stays`) is what the zero missed.
    fn of_channels(&self, amount: f64, slope: fn(&SignatureSample) -> f64, stays: bool) -> Vec<Part> {
        let tared = |i, k| if stays { 0.0 } else { self.at_zero(i, k).map_or(0.0, |zero| slope(&zero)) };
        (0..self.channels())
            .map(|k| {
                let of = |i| (amount * (slope(&self.at(i, k)) - tared(i, k)) / self.noise[k]) as f32;
                let values = (0..self.samples.list.len()).map(of).collect();
                Part::new(&self.names[k], amount, Column { channel: Some(k), values })
            })
            .collect()
    }

    /// One column for all channels: the reading times a factor of the sample, less the untouched reading times that of its zero.
    fn scaled(&self, factor: impl Fn(usize) -> [f64; 2]) -> Column {
        let channels = self.channels();
        let value = |i: usize| {
            let (sample, k) = (i / channels, i % channels);
            let ([now, then], untouched) = (factor(sample), self.zero.subtracted(k));
            (now * (self.reading(sample, k) + untouched) - then * untouched) / self.noise[k]
        };
        let count = self.samples.list.len() * channels;
        Column { channel: None, values: (0..count).map(|i| value(i) as f32).collect() }
    }

    /// One column for all channels, for the amount at which the largest share of a reading is the one that is wanted.
    fn share(&self, of: &Share) -> Part {
        let slopes: Vec<[f64; 2]> = (0..self.samples.list.len())
            .map(|i| [(of.slope)(&self.at(i, 0)), self.at_zero(i, 0).map_or(0.0, |zero| (of.slope)(&zero))])
            .collect();
        let amount = of.largest / slopes.iter().fold(0.0f64, |most, [s, _]| most.max(s.abs())).max(1e-9);
        Part::new(of.parameter, amount, self.scaled(|i| slopes[i].map(|slope| amount * slope)))
    }

    /// Zeros, and one factor of all readings, that decay from power-on.
    fn decays(&self, share: &str) -> Vec<Part> {
        let courses = uptime::decays(self.samples, self.zero.is_subtracted());
        let shown: Vec<Vec<f32>> = courses.iter().map(uptime::Course::since_zero).collect();
        let sigma = mean(self.noise);
        let mut parts: Vec<Part> = Vec::new();
        for k in 0..self.channels() {
            for course in &shown {
                let factor = (sigma / self.noise[k]) as f32;
                let values = course.iter().map(|v| v * factor).collect();
                parts.push(Part::new(&self.names[k], sigma, Column { channel: Some(k), values }));
            }
        }
        for course in &courses {
            let column =
                self.scaled(|i| [course.now[i], course.at_zero[i]].map(|v| DECAY_SHARE * f64::from(v)));
            parts.push(Part::new(share, DECAY_SHARE, column));
        }
        parts
    }

    /// Each taxel moved along each axis; `moved` holds changes by all taxels moved along each.
    fn taxels(&self, moved: &[Vec<Change>; 3]) -> Parts {
        let owners = self.skin.channel_taxels();
        // Channels of one taxel move together, which columns of a channel each cannot say.
        if owners.iter().collect::<BTreeSet<_>>().len() != owners.len() {
            return Parts::Inapplicable;
        }
        let channels = self.channels();
        let mut parts = Vec::new();
        for (axis, realised) in moved.iter().enumerate() {
            let Some(slope) = central(realised) else { continue };
            for k in 0..channels {
                let value = |i: usize| slope[i * channels + k] * SHIFT as f32;
                let values = (0..self.samples.list.len()).map(value).collect();
                let name = format!("{}.{}", self.skin.taxels[owners[k]].name, ["x", "y", "z"][axis]);
                parts.push(Part::new(name, SHIFT, Column { channel: Some(k), values }));
            }
        }
        Parts::Columns(parts)
    }

    /// Why the temperature says nothing, where it does not.
    fn cold(&self) -> Option<&'static str> {
        let kelvin = || self.samples.list.iter().map(|s| s.temperature);
        if kelvin().any(|t| !t.is_finite()) {
            return Some("the temperature is not recorded");
        }
        let (low, high) = kelvin().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), t| (l.min(t), h.max(t)));
        (high - low <= KELVIN).then_some("the temperature hardly changes in this recording")
    }

    /// The columns of an effect.
    fn parts(&self, of: &CommonEffect, changes: &mut Changes) -> Parts {
        if of.diagnosis.follows == Some(Covariate::Temperature)
            && let Some(why) = self.cold()
        {
            return Parts::Silent(why);
        }
        match of.diagnosis.signature {
            Signature::Channels { amount, slope } => {
                let amount = effects::amount(amount, 1.0 / self.skin.rate, self.noise);
                Parts::Columns(self.of_channels(amount, slope, of.diagnosis.shifts_channels))
            }
            Signature::Shares(shares) => Parts::Columns(shares.iter().map(|s| self.share(s)).collect()),
            Signature::DecayFromPowerOn { share, .. } => Parts::Columns(self.decays(share.0)),
            Signature::Taxels => self.taxels(&changes.taxels),
            Signature::Simulated(_) => match changes.common.remove(of.name) {
                Some(realised) => Parts::Columns(differences(realised)),
                None => Parts::Inapplicable,
            },
            Signature::None => Parts::Inapplicable,
        }
    }
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

/// Parts of a hypothesis, with the effect in whose parameters each is written.
type Written = Vec<(&'static str, Part)>;

impl Signatures {
    /// Adds the effects that every skin can have.
    pub(super) fn add_common(
        &mut self,
        skin: &SkinDescription,
        samples: &Samples,
        noise: &[f64],
        changes: &mut Changes,
    ) {
        let nominal = std::mem::take(&mut self.nominal);
        let zero = std::mem::take(&mut self.zero);
        let context = Context::new(skin, samples, noise, (&nominal, &zero));
        let mut hypotheses: Vec<(&CommonEffect, Written)> = Vec::new();
        let (additions, own): (Vec<_>, Vec<_>) =
            COMMON.iter().partition(|info| info.diagnosis.addition_to.is_some());
        for info in own {
            match context.parts(info, changes) {
                Parts::Columns(parts) => {
                    hypotheses.push((info, parts.into_iter().map(|part| (info.name, part)).collect()));
                }
                Parts::Silent(why) => self.silent.push((info.name.to_owned(), why.to_owned())),
                Parts::Inapplicable => {}
            }
        }
        for info in additions {
            let to = hypotheses.iter_mut().find(|(of, _)| info.diagnosis.addition_to == Some(of.name));
            if let (Some((_, written)), Parts::Columns(parts)) = (to, context.parts(info, changes)) {
                written.extend(parts.into_iter().map(|part| (info.name, part)));
            }
        }
        let least = MOVED * ((samples.list.len() * noise.len()) as f64).sqrt();
        for (info, parts) in hypotheses {
            self.add_linear(info, parts, least);
        }
        (self.nominal, self.zero) = (nominal, zero);
    }

    /// Adds an effect that is known by its columns, each of one parameter; those that move nothing are left out.
    fn add_linear(&mut self, of: &CommonEffect, parts: Written, least: f64) {
        let mut candidate = Candidate {
            name: of.name.to_owned(),
            what: of.what.to_owned(),
            family: false,
            rig: of.rig,
            number: false,
            columns: Vec::new(),
            per_channel: of.per_channel(),
            drifts_randomly: false,
            nonlinear: of.diagnosis.nonlinear,
            depends_on_uptime: of.diagnosis.depends_on_uptime,
            written_as: None,
            aliases: Vec::new(),
            starts: Vec::new(),
            linear: Vec::new(),
        };
        for (effect, Part { parameter, amount, column }) in parts {
            if dot(&column.values, &column.values).sqrt() < least {
                continue;
            }
            candidate.columns.push(self.columns.len());
            candidate.linear.push((effect.to_owned(), parameter, amount));
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
