//! What the stages that name causes start from, on the small skin of tests.

use dermis_skin::{Effect, SkinDescription};
use indicatif::ProgressBar;

use super::data::Data;
use super::select::Selected;
use super::{Options, check, measure};
use crate::recording::Recording;
use crate::samples::Samples;
use crate::select::{AcceptedEffect, IndistinguishableEffect, Selection, Tier};
use crate::signatures::Signatures;
use crate::simulate::Simulator;
use crate::statistics::{Column, Gram, Statistics};
use crate::testing::{EFFECTS, recorded, skin, small};
use crate::whitening;

/// A device beside its design, up to the measured gap.
pub(super) struct Case {
    pub recording: Recording,
    pub samples: Samples,
    pub measured: measure::Measured,
    signatures: Signatures,
    options: Options,
}

/// Runs `test` on the small skin's simulator.
pub(super) fn with_simulator<T>(test: impl FnOnce(&Simulator<'_>) -> T) -> T {
    let (skin, make) = (skin(), |skin: &SkinDescription| small(skin, 0.0));
    test(&Simulator { skin: &skin, effects: EFFECTS, make: &make })
}

impl Case {
    /// A device with these effects.
    pub(super) fn of(simulator: &Simulator<'_>, effects: &[Effect]) -> Self {
        let options = Options { resamples: 4, ..Options::default() };
        let recording = recorded(simulator, effects);
        let checked = check::recording(&recording, simulator.skin, &options.samples);
        let samples = checked.samples;
        let hidden = ProgressBar::hidden();
        let signatures =
            Signatures::simulate(simulator, &recording, &samples, &options.stop, &hidden).unwrap();
        let aligned =
            check::align(simulator, &recording, &samples, checked.sigma, &signatures.nominal).unwrap();
        let seed = options.select.seed;
        let prepared = check::quantization(simulator, &recording, &samples, aligned, seed).unwrap();
        let measured = measure::gap(prepared, (simulator.skin, &signatures.zero), &samples, seed);
        Self { recording, samples, measured, signatures, options }
    }

    pub(super) fn data<'a>(&'a self, simulator: &'a Simulator<'a>) -> Data<'a> {
        Data {
            simulator,
            recording: &self.recording,
            samples: &self.samples,
            readings: &self.measured.readings,
            sigma: &self.measured.sigma,
            signatures: &self.signatures,
            gap: &self.measured.gap,
            options: &self.options,
        }
    }
}

/// The candidate that an effect is.
pub(super) fn candidate(data: &Data<'_>, name: &str) -> usize {
    data.signatures.candidates.iter().position(|c| c.name == name).unwrap()
}

/// As if these effects had been selected, all alike, and explained on other contacts what their fit explains.
pub(super) fn chosen(data: &Data<'_>, names: &[&str], whitened: &[f32]) -> Selected {
    let declared = data.simulator.skin.channel_noise();
    let columns = data.signatures.columns.iter();
    let columns: Vec<Column> =
        columns.map(|c| whitening::rescale(c, &declared, data.sigma, data.readings)).collect();
    let statistics = Statistics::new(&columns, whitened, data.samples, data.channels());
    let gram = Gram::of(&statistics);
    let weights = data.samples.training();
    let set: Vec<usize> = names.iter().map(|name| candidate(data, name)).collect();
    let library = {
        let fit = data.selector(&statistics, &gram, &weights).fit_all(&set, Tier::Loose);
        let of = |g: usize| weights[g] * (statistics.energy(g) - statistics.loss(g, &fit));
        (0..data.samples.groups).map(of).sum::<f64>() / data.scale(&weights)
    };
    let gain = library / names.len() as f64;
    let picks = set.into_iter().map(|candidate| AcceptedEffect {
        candidate,
        tier: Tier::Strict,
        gain,
        solo: gain,
        shapley: 1.0 / names.len() as f64,
        p: 0.0,
        class: vec![IndistinguishableEffect { candidate, gain, score: 0.0, angle: 0.0 }],
        covers: Vec::new(),
    });
    let selection = Selection { picks: picks.collect(), library, both: library, ..Selection::default() };
    Selected { columns, statistics, gram, selection }
}
