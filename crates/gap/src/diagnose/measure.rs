//! Stage `measure`: how large the gap is, and what of it is no matter of presses.

use dermis_model::diagnosis::Evidence;
use dermis_model::{COMMON, common_effect};
use dermis_skin::{Effect, SkinDescription};

use super::check::{Known, Prepared};
use super::report::known_effect;
use crate::constants::report::{IRREPRODUCIBLE, UNSYSTEMATIC};
use crate::mains_interference::{self, Interference};
use crate::noise::Gap;
use crate::recording::Recording;
use crate::report::NamedEffect;
use crate::samples::Samples;
use crate::select::SelectOptions;
use crate::whitening::{mask_saturated, measure, residual, whiten};
use crate::zero_level::ZeroLevel;

/// Readings beside the nominal model.
pub(super) struct Measured {
    pub readings: Vec<f32>,
    pub sigma: Vec<f64>,
    /// Readings minus nominal model, whitened.
    pub whitened: Vec<f32>,
    /// Readings, whitened.
    pub scaled: Vec<f32>,
    /// Signals: readings without what the nominal model reads untouched, whitened.
    pub signals: Vec<f32>,
    /// Signals of the nominal model, whitened.
    pub modelled: Vec<f32>,
    pub gap: Gap,
    /// Effects that are known before any residual is explained, with the gap that each makes.
    pub known: Vec<NamedEffect>,
    /// All that is switched on for them.
    pub fixed: Vec<Effect>,
    /// Those of it that models are simulated with.
    pub beside: Vec<Effect>,
}

/// Measures the gap. `zero` is what the nominal model reads untouched.
pub(super) fn gap(
    prepared: Prepared,
    (skin, zero): (&SkinDescription, &ZeroLevel),
    samples: &Samples,
    seed: u64,
) -> Measured {
    let Prepared { mut readings, sigma, nominal, mut known, beside, step, .. } = prepared;
    let channels = sigma.len();
    let scaled = whiten(&readings, &sigma);
    let signals = whiten(&zero.signals(&readings, channels), &sigma);
    match (zero.restored(&readings, channels), zero.restored(&nominal, channels)) {
        // Ranges of channels speak of readings with their zero.
        (Some(mut whole), Some(model)) => {
            mask_saturated(&mut whole, &model, skin, &sigma);
            let cut = readings.iter_mut().zip(&whole).filter(|(_, whole)| whole.is_nan());
            cut.for_each(|(reading, _)| *reading = f32::NAN);
        }
        _ => mask_saturated(&mut readings, &nominal, skin, &sigma),
    }
    let whitened = residual(&readings, &nominal, &sigma);
    let mut gap = measure(&whitened, &scaled, samples, &sigma, seed);
    // A reading lies anywhere within its step, and frame after frame at the same place of it.
    let stepped =
        (rounding(step, !beside.is_empty(), &nominal, &sigma) / gap.variance - gap.frame_noise()).max(0.0);
    gap.counts_as_noise(stepped);
    credit(&mut known, gap.fvu_before - stepped);
    let fixed = known.iter().flat_map(|k| k.effects.iter().cloned()).collect();
    let known = known.into_iter().map(|k| k.named).collect();
    let modelled = whiten(&zero.signals(&nominal, channels), &sigma);
    Measured { readings, sigma, whitened, scaled, signals, modelled, gap, known, fixed, beside }
}

/// Gives each known effect the part of the gap that it made; `after` is what all of them leave.
fn credit(known: &mut [Known], mut after: f64) {
    for Known { named, before, .. } in known.iter_mut().rev() {
        named.gain = *before - after;
        named.solo = named.gain;
        named.class[0].gain = named.gain;
        after = *before;
    }
}

/// Energy of what a converter with this step adds to what a model reads (samples × channels), a reading, in deviations of the noise.
/// Noise decides on which step a reading falls: what lies on the edge of one, as zero does where it rounds down, is off by half of
/// it.
fn rounding(step: f64, down: bool, model: &[f32], sigma: &[f64]) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    for (i, m) in model.iter().enumerate() {
        let sigma = sigma[i % sigma.len()];
        if !(step > 0.0 && sigma.is_finite() && m.is_finite()) {
            continue;
        }
        let centre = f64::from(*m);
        // A model that stands for rounding down lies half of a step lower.
        let before = if down { centre + 0.5 * step } else { centre };
        let counts = |v: f64| if down { (v / step).floor() } else { (v / step).round() };
        // The middles of six parts of equal probability.
        let off =
            [-1.383, -0.674, -0.21, 0.21, 0.674, 1.383].map(|z| step * counts(before + z * sigma) - centre);
        sum += off.iter().map(|o| o * o).sum::<f64>() / 6.0 / (sigma * sigma);
        n += 1;
    }
    sum / n.max(1) as f64
}

/// Interference that matters.
pub(super) struct FoundInterference {
    pub line: Interference,
    /// Its size, as a share of the readings' variance.
    pub size: f64,
    /// The effect that makes it.
    pub effect: Option<(NamedEffect, Effect)>,
}

/// Finds interference of one frequency in untouched frames that is more than the margin, and counts it as noise.
pub(super) fn interference(
    recording: &Recording,
    skin: &SkinDescription,
    gap: &mut Gap,
    options: &SelectOptions,
) -> Option<FoundInterference> {
    let line = mains_interference::find(recording)?;
    // Frames that follow each other differ by more than interference itself where it changes its sign between them, and by less where
    // it hardly moves.
    let turn = (std::f64::consts::TAU * line.frequency / line.rate).cos();
    let twins = gap.frame_noise();
    let noise = twins / (1.0 - turn * line.share);
    let size = line.share * noise;
    if size.is_nan() || size <= options.margin {
        return None;
    }
    gap.counts_as_noise(noise - twins);
    Some(FoundInterference { line, size, effect: interference_effect(&line, size, &skin.unit) })
}

/// Interference as an effect that is named: its gain is its size, since no residual holds it.
fn interference_effect(line: &Interference, size: f64, unit: &str) -> Option<(NamedEffect, Effect)> {
    let (name, amplitude, frequency) = COMMON.iter().find_map(|info| match info.diagnosis.evidence {
        Evidence::Spectrum { amplitude, frequency } => Some((info.name, amplitude, frequency)),
        _ => None,
    })?;
    let effect = Effect::new(name).with(amplitude, line.amplitude).with(frequency, line.frequency);
    let info = common_effect(name);
    let mut named = known_effect(&effect, info.map_or("", |i| i.what), unit);
    for value in &mut named.theta {
        value.unit = match info.map_or("", |i| i.unit_of(&value.name)) {
            "" => unit.to_owned(),
            other => other.to_owned(),
        };
    }
    (named.gain, named.solo, named.class[0].gain) = (size, size, size);
    Some((named, effect))
}

/// What there is to explain.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scope {
    /// Presses that were done alike differ by more than noise: what does not come again is a gap as well.
    pub irreproducible: bool,
    /// The gap is too small to matter.
    pub negligible: bool,
    /// There is something systematic to explain.
    pub established: bool,
}

/// Says what there is to explain.
pub(super) fn scope(gap: &Gap, options: &SelectOptions, irreproducible: bool) -> Scope {
    let negligible = gap.interval[1] < options.margin && !irreproducible;
    // Where not even the sign of the systematic part is known there is nothing to explain.
    let systematic = gap.interval[0] > 0.0 && gap.systematic >= UNSYSTEMATIC * gap.fvu_before;
    Scope { irreproducible, negligible, established: irreproducible || systematic }
}

/// Whether presses that were done alike differ by more than noise of single frames.
pub(super) fn irreproducible(gap: &Gap, options: &SelectOptions) -> bool {
    gap.irreproducible.is_some_and(|i| i > options.margin.max(IRREPRODUCIBLE * gap.floor))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_takes_a_twelfth_of_its_square_and_a_quarter_at_its_edge() {
        let sigma = [0.01];
        let spread: Vec<f32> = (0..3000).map(|i| 0.1 * i as f32).collect();
        let noise = |down: bool, model: &[f32]| rounding(10.0, down, model, &sigma) * 1e-4;
        approx::assert_relative_eq!(noise(false, &spread), 100.0 / 12.0, max_relative = 0.02);
        approx::assert_relative_eq!(noise(true, &spread), 100.0 / 12.0, max_relative = 0.02);
        // What rounds down reads zero or a step less where nothing touches: its model stands between them.
        approx::assert_relative_eq!(noise(true, &[-5.0; 8]), 25.0, max_relative = 1e-6);
        assert!(noise(false, &[0.0; 8]) < 1e-3);
        assert_eq!(rounding(0.0, false, &spread, &sigma), 0.0);
    }

    #[test]
    fn what_lies_at_the_end_of_a_range_is_left_out_of_tared_readings_too() {
        let mut skin = crate::testing::skin();
        let mut channels = skin.channels().to_vec();
        channels.iter_mut().for_each(|channel| channel.range = Some([0.0, 1000.0]));
        skin.set_channels(channels);
        let untouched = dermis_model::Untouched::from(vec![900.0; 3]);
        let samples = crate::statistics::tests::samples(&[0, 1]);
        let measured = |zero: &ZeroLevel, shift: f32| {
            let prepared = Prepared {
                readings: [10.0, 99.0, 20.0, 30.0, 40.0, 99.0].map(|v| v + shift).to_vec(),
                sigma: vec![5.0; 3],
                nominal: [12.0, 90.0, 20.0, 30.0, 40.0, 90.0].map(|v| v + shift).to_vec(),
                problems: Vec::new(),
                known: Vec::new(),
                beside: Vec::new(),
                step: 0.0,
            };
            super::gap(prepared, (&skin, zero), &samples, 1)
        };
        // 99 above a zero of 900 is within 5 of 1000.
        let tared = measured(&ZeroLevel::new(&untouched, &untouched, true), 0.0);
        let cut: Vec<bool> = tared.readings.iter().map(|v| v.is_nan()).collect();
        assert_eq!(cut, [false, true, false, false, false, true]);
        let read = measured(&ZeroLevel::new(&untouched, &untouched, false), 900.0);
        assert_eq!(read.readings.iter().map(|v| v.is_nan()).collect::<Vec<_>>(), cut);
        // Axes and checks see what touches make, as it was read or tared.
        assert_eq!((&tared.modelled, &tared.signals), (&read.modelled, &read.signals));
        assert_eq!(tared.modelled[0], 12.0 / 5.0);
    }

    fn gap(systematic: f64, interval: [f64; 2], again: Option<f64>) -> Gap {
        Gap {
            fvu_before: 0.1,
            floor: 0.01,
            systematic,
            interval,
            zero: 0.0,
            irreproducible: again,
            repeats: 20,
            variance: 1.0,
        }
    }

    #[test]
    fn there_is_something_to_explain_only_where_it_is_sure_and_matters() {
        let options = SelectOptions::default();
        let scope = |gap: &Gap| {
            let s = scope(gap, &options, irreproducible(gap, &options));
            (s.irreproducible, s.negligible, s.established)
        };
        assert_eq!(scope(&gap(0.001, [0.0005, 0.003], None)), (false, true, false));
        assert_eq!(scope(&gap(0.05, [0.04, 0.06], None)), (false, false, true));
        assert_eq!(scope(&gap(0.05, [-0.01, 0.1], None)), (false, false, false));
        assert_eq!(scope(&gap(0.001, [-0.001, 0.003], Some(0.008))), (true, false, true));
    }

    #[test]
    fn known_effects_get_what_each_took_away() {
        let effect = Effect::new("e");
        let known = |before| Known { named: known_effect(&effect, "", ""), before, effects: Vec::new() };
        let mut all = [known(0.5), known(0.2)];
        credit(&mut all, 0.05);
        assert!((all[0].named.gain - 0.3).abs() < 1e-12 && (all[1].named.gain - 0.15).abs() < 1e-12);
    }
}
