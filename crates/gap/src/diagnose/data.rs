//! What the stages that name causes work on, and the algebra that they share.

use dermis_skin::Effect;
use indicatif::ProgressBar;

use super::Options;
use crate::noise::Gap;
use crate::nonlinear_refinement::{ModelDiscrepancy, Target};
use crate::recording::Recording;
use crate::samples::Samples;
use crate::select::Selector;
use crate::signatures::Signatures;
use crate::simulate::Simulator;
use crate::statistics::{Column, Fit, Gram, Statistics};
use crate::{GapError, whitening};

/// One recording beside its model.
#[derive(Clone, Copy)]
pub(super) struct Data<'a> {
    pub simulator: &'a Simulator<'a>,
    pub recording: &'a Recording,
    pub samples: &'a Samples,
    /// Samples × channels, in the unit of the skin; NaN where they were cut off.
    pub readings: &'a [f32],
    /// Deviation of each channel's noise.
    pub sigma: &'a [f64],
    pub signatures: &'a Signatures,
    pub gap: &'a Gap,
    pub options: &'a Options,
}

impl Data<'_> {
    pub fn channels(&self) -> usize {
        self.sigma.len()
    }

    /// Energy of readings about their means over groups with these weights.
    pub fn scale(&self, weights: &[f64]) -> f64 {
        let usable = self.sigma.iter().filter(|s| s.is_finite()).count() as f64;
        let samples: f64 = self.samples.list.iter().map(|s| weights[s.group]).sum();
        samples * usable * self.gap.variance
    }

    /// Energy of the noise over these groups.
    pub fn floor(&self, weights: &[f64]) -> f64 {
        self.gap.floor * self.scale(weights)
    }

    /// Whitened energy that is left in each group.
    pub fn group_losses(&self, left: &[f32]) -> Vec<f64> {
        let mut losses = vec![0.0; self.samples.groups];
        for (sample, values) in self.samples.list.iter().zip(left.chunks_exact(self.channels())) {
            losses[sample.group] += values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
        }
        losses
    }

    /// Readings of the full simulator with these effects.
    pub fn simulate(&self, effects: &[Effect]) -> Result<Vec<f32>, GapError> {
        let skin = self.simulator.with(effects);
        self.simulator.readings(&skin, self.recording, &self.samples.frames())
    }

    /// What a fit on the full simulator aims at.
    pub fn target<'b>(
        &'b self,
        weights: &'b [f64],
        discrepancy: &'b ModelDiscrepancy,
        progress: &'b ProgressBar,
    ) -> Target<'b> {
        Target {
            discrepancy,
            recording: self.recording,
            samples: self.samples,
            readings: self.readings,
            sigma: self.sigma,
            weights,
            stop: &self.options.stop,
            progress,
        }
    }

    /// Selection over groups with these weights.
    pub fn selector<'b>(
        &'b self,
        statistics: &'b Statistics,
        gram: &'b Gram,
        weights: &[f64],
    ) -> Selector<'b> {
        Selector::new(
            statistics,
            &self.signatures.candidates,
            &self.signatures.discrepancy,
            gram,
            (self.scale(weights), self.gap.systematic.max(0.0), self.gap.interval[0]),
            weights,
            &self.options.select,
        )
    }

    /// A whitened residual without what a fit makes of it.
    pub fn without(
        &self,
        residual: &[f32],
        columns: &[Column],
        terms: impl Iterator<Item = (usize, f64)>,
    ) -> Vec<f32> {
        let mut left = residual.to_vec();
        let channels = self.channels();
        for (column, x) in terms {
            let (column, x) = (&columns[column], x as f32);
            match column.channel {
                Some(k) => {
                    let own = left.iter_mut().skip(k).step_by(channels);
                    own.zip(&column.values).for_each(|(l, v)| *l -= x * v);
                }
                None => left.iter_mut().zip(&column.values).for_each(|(l, v)| *l -= x * v),
            }
        }
        left
    }

    /// Readings without what a fit makes of these columns.
    pub fn readings_without(&self, columns: &[Column], fit: &Fit, of: &[usize]) -> Vec<f32> {
        let nothing = vec![0.0; self.readings.len()];
        let less = self.without(&nothing, columns, fit.terms().filter(|(c, _)| of.contains(c)));
        let scaled = less.iter().zip(self.sigma.iter().cycle());
        let moved = scaled.map(|(l, sigma)| if sigma.is_finite() { l * *sigma as f32 } else { 0.0 });
        self.readings.iter().zip(moved).map(|(r, m)| r + m).collect()
    }

    /// Whitened residual of these simulated readings.
    pub fn residual(&self, simulated: &[f32]) -> Vec<f32> {
        whitening::residual(self.readings, simulated, self.sigma)
    }
}
