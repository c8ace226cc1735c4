//! What is left, taken apart: by channel, smoothly over the place, in single locations, and in single locations of single channels.
//!
//! A decomposition of variance by nested regressions, each scored on locations that it was not fitted to, so that a richer one gains
//! nothing by its numbers alone.

use serde::{Deserialize, Serialize};

use super::columns::{Locations, of_all, of_channels, patches, smooth};
use super::{Field, held_out, of_channels as narrow};
use crate::constants::rivals::PRIOR;
use crate::statistics::{Column, Statistics};

/// Parts of what named effects leave, in shares of the gap before them; none below 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Structure {
    /// A factor of each channel.
    pub channel: f64,
    /// A factor of each channel that varies smoothly over place and force, beyond that.
    pub smooth_place: f64,
    /// A factor of all channels that differs in some locations, beyond these.
    pub local_place: f64,
    /// A factor of each channel that differs in some locations, beyond these.
    pub interaction: f64,
}

/// Takes `left` apart; shares are of the gap of `before`.
pub(super) fn of(field: &Field<'_>, before: &[f32], left: &[f32]) -> Structure {
    let (chosen, residual) = field.strongest(left);
    let count = chosen.len();
    let signals = narrow(field.signals, field.channels, &chosen);
    let energy = |values: &[f32]| values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
    let gap = energy(&narrow(before, field.channels, &chosen)) - field.floor(count);
    if gap <= 0.0 {
        return Structure::default();
    }
    let locations = Locations::of(field.samples);
    let (bumps, _) = patches(&locations, field.samples);
    let gains = vec![vec![1.0; field.samples.list.len()]];
    let mut columns: Vec<Column> = Vec::new();
    let mut sets: Vec<Vec<usize>> = vec![Vec::new()];
    let shared: Vec<Column> = bumps.iter().map(|f| of_all(&signals, count, f)).collect();
    let parts = [
        of_channels(&signals, count, &gains),
        of_channels(&signals, count, &smooth(&locations, &field.samples.list)[1..]),
        shared,
        of_channels(&signals, count, &bumps),
    ];
    for part in parts {
        let first = columns.len();
        columns.extend(part);
        let mut set = sets[sets.len() - 1].clone();
        set.extend(first..columns.len());
        sets.push(set);
    }
    let statistics = Statistics::new(&columns, &residual, field.samples, count);
    let losses: Vec<f64> = held_out(&statistics, &sets, &field.folds(), |_| PRIOR)
        .into_iter()
        .map(|(losses, _)| losses.iter().sum())
        .collect();
    // A step that only costs does not raise what the next one is held against.
    let mut best = losses[0];
    let mut gained = [0.0; 4];
    for (gained, loss) in gained.iter_mut().zip(&losses[1..]) {
        *gained = (best - loss).max(0.0) / gap;
        best = best.min(*loss);
    }
    let [channel, smooth_place, local_place, interaction] = gained;
    Structure { channel, smooth_place, local_place, interaction }
}
