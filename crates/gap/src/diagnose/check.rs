//! Stage `check`: whether a recording can be diagnosed, and what must be put right before readings and model are compared.

use dermis_model::diagnosis::Evidence;
use dermis_skin::{Effect, SkinDescription};

use super::report::known_effect;
use crate::algebra::mean;
use crate::constants::check::SAME_STEP;
use crate::effects;
use crate::noise;
use crate::recording::{Problem, Recording};
use crate::report::NamedEffect;
use crate::samples::{SampleOptions, Samples};
use crate::simulate::Simulator;
use crate::whitening::{measure, residual, whiten};
use crate::{GapError, checks, quantization};

/// What a recording holds.
pub(super) struct Checked {
    /// Deviation of each channel's noise, infinite where it gives nothing.
    pub sigma: Vec<f64>,
    pub samples: Samples,
    pub problems: Vec<Problem>,
}

/// Measures the noise, draws samples, and says what is wrong with clock and readings.
pub(super) fn recording(recording: &Recording, skin: &SkinDescription, options: &SampleOptions) -> Checked {
    let sigma = noise::deviations(recording, skin);
    let usable: Vec<bool> = sigma.iter().map(|s| s.is_finite()).collect();
    let samples = Samples::draw(recording, &usable, options);
    let mut problems: Vec<Problem> = recording.clock().into_iter().collect();
    problems.extend(checks::readings(recording, skin, &samples));
    Checked { sigma, samples, problems }
}

/// An effect that something else than the size of a residual shows, and the gap before it is taken away.
pub(super) struct Known {
    pub named: NamedEffect,
    pub before: f64,
    /// What is switched on for it.
    pub effects: Vec<Effect>,
}

/// Readings whose channels are in the order of the model's.
pub(super) struct Aligned {
    /// Samples × channels, in the unit of the skin.
    pub readings: Vec<f32>,
    pub sigma: Vec<f64>,
    pub nominal: Vec<f32>,
    /// For each channel, the channel whose readings it carries, where they were exchanged.
    pub order: Option<Vec<usize>>,
    pub problems: Vec<Problem>,
}

/// Compares readings with the nominal model, and puts exchanged channels right.
pub(super) fn align(
    simulator: &Simulator<'_>,
    recording: &Recording,
    samples: &Samples,
    sigma: Vec<f64>,
    nominal: &[f32],
) -> Result<Aligned, GapError> {
    let readings: Vec<f32> =
        samples.list.iter().flat_map(|s| recording.frame(s.frame).iter().copied()).collect();
    let agreement = checks::agreement(simulator, recording, samples, &readings, nominal, &sigma)?;
    let nominal = nominal.to_vec();
    Ok(Aligned { readings, sigma, nominal, order: agreement.order, problems: agreement.problems })
}

/// Readings that the model can be compared with.
pub(super) struct Prepared {
    pub readings: Vec<f32>,
    pub sigma: Vec<f64>,
    pub nominal: Vec<f32>,
    pub problems: Vec<Problem>,
    /// Effects that are known before any residual is explained.
    pub known: Vec<Known>,
    /// Those of them that models are simulated with from here on: readings are in the right order by now, and their steps count as
    /// noise.
    pub beside: Vec<Effect>,
    /// Step of the converter, 0 where there is none.
    pub step: f64,
}

/// Reorders exchanged channels, and finds the converter whose steps the readings come in.
pub(super) fn quantization(
    simulator: &Simulator<'_>,
    recording: &Recording,
    samples: &Samples,
    aligned: Aligned,
    seed: u64,
) -> Result<Prepared, GapError> {
    let Aligned { readings, sigma, nominal, order, .. } = aligned;
    let mut found = Prepared {
        readings,
        sigma,
        nominal,
        problems: Vec::new(),
        known: Vec::new(),
        beside: Vec::new(),
        step: 0.0,
    };
    if let Some(order) = order {
        let before = fvu(&found, samples, seed);
        let known = reorder(&mut found, simulator.skin, &order, before);
        found.known.extend(known);
    }
    let converter = converter(simulator, recording, samples, &found.readings, &found.sigma)?;
    if let Some(converter) = converter {
        let before = fvu(&found, samples, seed);
        let info = simulator.effects.iter().find(|i| i.name == converter.effect.name);
        let named = known_effect(&converter.effect, info.map_or("", |i| i.what), &simulator.skin.unit);
        let effects = std::iter::once(converter.effect).chain(converter.down.clone()).collect();
        found.known.push(Known { named, before, effects });
        found.nominal = converter.nominal.unwrap_or(found.nominal);
        found.step = converter.step;
        found.beside.extend(converter.down);
    }
    Ok(found)
}

/// Unexplained variance of readings beside the nominal model.
fn fvu(of: &Prepared, samples: &Samples, seed: u64) -> f64 {
    let whitened = residual(&of.readings, &of.nominal, &of.sigma);
    measure(&whitened, &whiten(&of.readings, &of.sigma), samples, &of.sigma, seed).fvu_before
}

/// Puts readings into the order of the model's channels.
fn reorder(of: &mut Prepared, skin: &SkinDescription, order: &[usize], before: f64) -> Option<Known> {
    let info = effects::with(|p| p.evidence == Evidence::ChannelOrder).next()?;
    let channels = of.sigma.len();
    let read = of.readings.clone();
    let deviations = of.sigma.clone();
    let names = skin.channels();
    let mut effect = Effect::new(info.name);
    let mut exchanged = Vec::new();
    for (at, from) in order.iter().enumerate() {
        if at != *from {
            of.sigma[*from] = deviations[at];
            for sample in 0..read.len() / channels {
                of.readings[sample * channels + from] = read[sample * channels + at];
            }
            effect.parameters.insert(names[at].name.clone(), *from as f64);
            exchanged.push(format!("{} carries {}", names[at].name, names[*from].name));
        }
    }
    of.problems.push(Problem::note(
        info.name,
        format!(
            "channels are in another order: {}; all that follows has them in the right one",
            exchanged.join(", ")
        ),
    ));
    let what = "Channels are read in another order than the skin's description says.";
    Some(Known { named: known_effect(&effect, what, "place"), before, effects: vec![effect] })
}

/// A converter whose step is more than the noise: the effect of the family that makes such readings.
struct Converter {
    effect: Effect,
    /// The step.
    step: f64,
    /// Readings of the model with `down`, and without steps.
    nominal: Option<Vec<f32>>,
    /// Half of a step on all channels, where the converter rounds down instead of to the nearest one.
    down: Option<Effect>,
}

/// Finds the step that readings come in where it is more than their declared noise, and the family's effect with a parameter that
/// is such a step.
fn converter(
    simulator: &Simulator<'_>,
    recording: &Recording,
    samples: &Samples,
    readings: &[f32],
    sigma: &[f64],
) -> Result<Option<Converter>, GapError> {
    let skin = simulator.skin;
    let noise = mean(&skin.channel_noise());
    let Some(found) = quantization::step(readings).filter(|s| *s > noise) else { return Ok(None) };
    let simulated =
        |effects: &[Effect]| simulator.readings(&simulator.with(effects), recording, &samples.frames());
    for info in simulator.effects.iter().filter(|i| !i.random) {
        for parameter in info.parameters.iter().filter(|p| p.unit == skin.unit) {
            let value = found.clamp(parameter.limits[0], parameter.limits[1]);
            let effect = Effect::new(info.name).with(parameter.name, value);
            let Ok(read) = simulated(std::slice::from_ref(&effect)) else { continue };
            if quantization::step(&read).is_none_or(|s| (s / found - 1.0).abs() > SAME_STEP) {
                continue;
            }
            let left = |read: &[f32]| -> f64 {
                let apart = readings.iter().zip(read).map(|(r, m)| f64::from(r - m));
                let shares = apart.enumerate().map(|(i, d)| (d / sigma[i % sigma.len()]).powi(2));
                shares.filter(|s| s.is_finite()).sum()
            };
            let down = lower(skin, 0.5 * found);
            let below = down.as_ref().and_then(|down| simulated(&[effect.clone(), down.clone()]).ok());
            if below.is_none_or(|below| left(&below) >= left(&read)) {
                return Ok(Some(Converter { effect, step: value, nominal: None, down: None }));
            }
            let nominal = down.as_ref().map(|down| simulated(std::slice::from_ref(down))).transpose()?;
            return Ok(Some(Converter { effect, step: value, nominal, down }));
        }
    }
    Ok(None)
}

/// All channels lower by so much, in the words of the effect that shifts channels.
fn lower(skin: &SkinDescription, by: f64) -> Option<Effect> {
    let mut effect = Effect::new(effects::with(|p| p.shifts_channels).next()?.name);
    for channel in skin.channels() {
        effect.parameters.insert(channel.name.clone(), -by);
    }
    Some(effect)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exchanged_channels_are_put_right_with_their_noise() {
        let skin =
            SkinDescription::from_toml(include_str!("../../../../launch/skins/baro-line.toml"), "line");
        let skin = skin.unwrap();
        let n = skin.channels().len();
        let mut order: Vec<usize> = (0..n).collect();
        order.swap(0, 2);
        let mut of = Prepared {
            readings: (0..n).map(|k| k as f32).collect(),
            sigma: (0..n).map(|k| 1.0 + k as f64).collect(),
            nominal: Vec::new(),
            problems: Vec::new(),
            known: Vec::new(),
            beside: Vec::new(),
            step: 0.0,
        };
        let known = reorder(&mut of, &skin, &order, 0.5).unwrap();
        assert_eq!((of.readings[0], of.readings[1], of.readings[2]), (2.0, 1.0, 0.0));
        assert_eq!((of.sigma[0], of.sigma[2]), (3.0, 1.0));
        assert_eq!(known.effects[0].parameters.len(), 2);
        assert_eq!(known.before, 0.5);
    }
}
