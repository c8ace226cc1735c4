//! Stage `select`: the effects that make the gap, to first order.

use std::sync::atomic::Ordering;

use super::announce;
use super::data::Data;
use crate::noise::Gap;
use crate::select::{Selection, Tier};
use crate::statistics::{Column, Gram, Statistics};
use crate::{GapError, whitening};

/// Effects that were selected, and the algebra that they were selected by.
pub(super) struct Selected {
    /// Columns of signatures in deviations of the measured noise.
    pub columns: Vec<Column>,
    pub statistics: Statistics,
    pub gram: Gram,
    pub selection: Selection,
}

impl Selected {
    /// The accepted candidates, the strongest first.
    pub fn set(&self) -> Vec<usize> {
        self.selection.picks.iter().map(|p| p.candidate).collect()
    }
}

/// Selects the effects that make a whitened residual.
pub(super) fn select(data: &Data<'_>, whitened: &[f32]) -> Result<Selected, GapError> {
    let declared = data.simulator.skin.channel_noise();
    let columns: Vec<Column> = data
        .signatures
        .columns
        .iter()
        .map(|c| whitening::rescale(c, &declared, data.sigma, data.readings))
        .collect();
    let statistics = Statistics::new(&columns, whitened, data.samples, data.channels());
    let gram = Gram::of(&statistics);
    let weights = data.samples.training();
    let progress = &data.options.progress;
    announce(progress, "comparing effects", 0);
    let training = data.selector(&statistics, &gram, &weights).watched(&data.options.stop, progress);
    let selection = training.select();
    if data.options.stop.load(Ordering::Relaxed) {
        return Err(GapError::Interrupted);
    }
    Ok(Selected { columns, statistics, gram, selection })
}

/// The gap with the irreproducible part that goes away with the selected effects: they follow time or temperature. `None` where
/// there is none.
pub(super) fn with_irreproducible(data: &Data<'_>, selected: &Selected, whitened: &[f32]) -> Option<Gap> {
    let part = data.gap.irreproducible.filter(|_| !selected.selection.picks.is_empty())?;
    let weights = data.samples.training();
    let training = data.selector(&selected.statistics, &selected.gram, &weights);
    let fit = training.fit_all(&selected.set(), Tier::Loose);
    let left = data.without(whitened, &selected.columns, fit.terms());
    let scaled = whitening::whiten(data.readings, data.sigma);
    let seed = data.options.select.seed;
    let still = whitening::measure(&left, &scaled, data.samples, data.sigma, seed).irreproducible;
    let part = part - still.unwrap_or(part);
    (part > 0.0).then(|| {
        let mut gap = data.gap.clone();
        gap.counts_as_noise(-part);
        gap.irreproducible = still;
        gap
    })
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Case, with_simulator};
    use super::*;
    use crate::testing::gains;

    #[test]
    fn the_effect_that_makes_a_residual_is_selected_and_no_other() {
        with_simulator(|simulator| {
            let case = Case::of(simulator, &[gains()]);
            let data = case.data(simulator);
            let found = select(&data, &case.measured.whitened).unwrap();
            let names: Vec<&str> =
                found.set().iter().map(|c| data.signatures.candidates[*c].name.as_str()).collect();
            assert_eq!(names, ["channel-gain"]);
            let pick = &found.selection.picks[0];
            // All of the systematic gap, which locations of training hold more or less of: 4 % in a standard deviation.
            assert!((pick.gain / data.gap.systematic - 1.0).abs() < 0.2, "{pick:?} {:?}", data.gap);
            assert_eq!(pick.class[0].candidate, pick.candidate);
            // Signatures reproduce the whitened residual: only noise, of variance 1, is left.
            let weights = data.samples.training();
            let selector = data.selector(&found.statistics, &found.gram, &weights);
            let fit = selector.fit_all(&found.set(), Tier::Loose);
            let left = data.without(&case.measured.whitened, &found.columns, fit.terms());
            let square = left.iter().map(|v| v * v).sum::<f32>() / left.len() as f32;
            assert!((square - 1.0).abs() < 0.2, "{square}");
            // Nothing differs between presses that were done alike, for there are none.
            assert!(with_irreproducible(&data, &found, &case.measured.whitened).is_none());
        });
    }

    #[test]
    fn noise_alone_selects_nothing() {
        with_simulator(|simulator| {
            let case = Case::of(simulator, &[]);
            let data = case.data(simulator);
            let found = select(&data, &case.measured.whitened).unwrap();
            assert!(found.set().is_empty(), "{:?}", found.selection.picks);
        });
    }

    #[test]
    fn a_selection_that_is_stopped_is_none() {
        with_simulator(|simulator| {
            let case = Case::of(simulator, &[gains()]);
            let data = case.data(simulator);
            data.options.stop.store(true, Ordering::Relaxed);
            assert!(matches!(select(&data, &case.measured.whitened), Err(GapError::Interrupted)));
        });
    }
}
