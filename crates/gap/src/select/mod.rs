//! Stage `select`: which effects make the gap.
//!
//! Problem: of some thirty candidates, each a subspace of columns, find the few that make a residual, and say what cannot be told
//! from them. Method: forward steps with backward drops and swaps (FAMoS, Gabel 2019) over Bayesian linear models, compared on
//! held-out groups of contacts. A model is the columns of the effects in it, beside those of the model discrepancy (Kennedy and
//! O'Hagan 2001): laws that the simulator simplifies. The discrepancy has a prior: it may make up a gap that does not matter
//! ([`SelectOptions::margin`]), and what goes beyond costs. A step must pass a permutation test over the whole library (max-T,
//! Westfall and Young 1993).
//!
//! Assumptions: what no model explains is no noise but the error of laws, which goes on from press to press. So the likelihood is
//! that of as many effective samples as there are locations, times a factor, with the spread that the best model leaves. An effect
//! that beats the model discrepancy by that measure is named firmly; one that does not may as well be it. Cost: algebra over
//! [`Statistics`] only, a few thousand solves; no simulation.

mod classes;
mod pairs;
mod significance;
mod steps;

use std::cell::Cell;
use std::sync::atomic::AtomicBool;

use indicatif::ProgressBar;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::constants::select as constants;
use crate::signatures::Candidate;
use crate::statistics::{Fit, Gram, Statistics, Sum};

/// How causes are selected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SelectOptions {
    /// Systematic gap below which there is none that matters, in shares of the readings' variance.
    pub margin: f64,
    /// Least gain of an effect, in the same.
    pub floor: f64,
    /// Least gain of an effect as a share of the systematic gap.
    pub share: f64,
    /// The same of an effect beside others.
    pub beside: f64,
    /// The same beside others that are nonlinear or drift: what their columns leave may look like one.
    pub beside_nonlinear: f64,
    /// Probability of a false alarm over the whole library.
    pub level: f64,
    /// Effects at most.
    pub most: usize,
    /// Folds of cross-validation.
    pub folds: usize,
    /// Sign permutations.
    pub permutations: usize,
    /// Posterior odds against an effect from which on it can be told from the one that is named.
    pub decisive_odds: f64,
    /// Effective samples that a place of contact gives: errors of laws go on from press to press.
    pub effective_samples: f64,
    /// Of everything random.
    pub seed: u64,
}

impl Default for SelectOptions {
    fn default() -> Self {
        Self {
            margin: constants::MARGIN,
            floor: constants::FLOOR,
            share: constants::SHARE,
            beside: constants::BESIDE,
            beside_nonlinear: constants::BESIDE_NONLINEAR,
            level: constants::LEVEL,
            most: constants::MOST,
            folds: constants::FOLDS,
            permutations: constants::PERMUTATIONS,
            decisive_odds: constants::DECISIVE_ODDS,
            effective_samples: constants::EFFECTIVE_SAMPLES,
            seed: 1,
        }
    }
}

/// How well an effect stands against the model discrepancy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tier {
    /// It explains what the declared tolerances of the simulator cannot.
    Strict,
    /// It, or the model discrepancy.
    Loose,
}

/// An effect that cannot be distinguished from the one that is named.
#[derive(Debug, Clone, PartialEq)]
pub struct IndistinguishableEffect {
    /// Index of the candidate.
    pub candidate: usize,
    /// Its gain in the place of the one that is named.
    pub gain: f64,
    /// How badly its model does ([`Selector::weigh`]).
    pub score: f64,
    /// \[rad\] between what the one that is named changes and the nearest that this one can.
    pub angle: f64,
}

/// An effect that is accepted.
#[derive(Debug, Clone, PartialEq)]
pub struct AcceptedEffect {
    /// Index of the candidate that gives the name.
    pub candidate: usize,
    /// Tier.
    pub tier: Tier,
    /// Reduction of the held-out error when it comes last, in shares of the readings' variance.
    pub gain: f64,
    /// The same when it comes alone.
    pub solo: f64,
    /// Share of the reduction that is its own (Shapley's value over all orders).
    pub shapley: f64,
    /// Probability of such a statistic for the best of the library where signs are random.
    pub p: f64,
    /// All that cannot be distinguished, the named one first.
    pub class: Vec<IndistinguishableEffect>,
    /// More general effects that contain the named one.
    pub covers: Vec<usize>,
}

/// What selection found.
#[derive(Debug, Clone, Default)]
pub struct Selection {
    /// Accepted effects, the strongest first.
    pub picks: Vec<AcceptedEffect>,
    /// Reduction by the model discrepancy alone.
    pub discrepancy: f64,
    /// Reduction by the accepted effects alone.
    pub library: f64,
    /// Reduction by both.
    pub both: f64,
    /// Gains of every candidate alone: strict, loose.
    pub alone: Vec<[f64; 2]>,
}

/// Selection over one set of groups.
pub struct Selector<'a> {
    statistics: &'a Statistics,
    candidates: &'a [Candidate],
    discrepancy: &'a [usize],
    /// Inverse variance of coefficients of the model discrepancy, in its prior.
    tight: f64,
    /// Energy that one effective sample leaves.
    residual_per_sample: Cell<f64>,
    gram: &'a Gram,
    /// Energy of the readings about their means.
    scale: f64,
    /// Energy of the systematic gap, as a share of it.
    systematic: f64,
    /// What the systematic gap is at least, in margins.
    least: f64,
    options: &'a SelectOptions,
    weights: Vec<f64>,
    total: Sum,
    /// Sums over each fold, and over all others.
    folds: Vec<[Sum; 2]>,
    /// Ends it early, and shows models that were compared.
    watch: Option<(&'a AtomicBool, &'a ProgressBar)>,
}

impl<'a> Selector<'a> {
    /// Selection over groups with these weights. `variance` is the readings' variance times their number over these groups,
    /// `systematic` the share of it that is systematic gap, and `least` what that surely is.
    #[must_use]
    pub fn new(
        statistics: &'a Statistics,
        candidates: &'a [Candidate],
        discrepancy: &'a [usize],
        gram: &'a Gram,
        (scale, systematic, least): (f64, f64, f64),
        weights: &[f64],
        options: &'a SelectOptions,
    ) -> Self {
        let total = statistics.sum(weights);
        let mut groups: Vec<usize> = (0..weights.len()).filter(|g| weights[*g] > 0.0).collect();
        groups.shuffle(&mut ChaCha8Rng::seed_from_u64(options.seed));
        let folds = options.folds.clamp(2, groups.len().max(2));
        let folds = (0..folds)
            .map(|f| {
                let mut of = vec![0.0; weights.len()];
                groups.iter().skip(f).step_by(folds).for_each(|g| of[*g] = weights[*g]);
                let own = statistics.sum(&of);
                let rest = total.minus(&own);
                [own, rest]
            })
            .collect();
        // Coefficients of a standard deviation of `1/sqrt(tight)` make up the margin on average.
        let energy: f64 = discrepancy.iter().map(|&f| total.diagonal(f)).sum();
        let tight = energy / (options.margin * scale).max(1e-300);
        let made = Self {
            statistics,
            candidates,
            discrepancy,
            tight,
            residual_per_sample: Cell::new(1.0),
            gram,
            scale,
            systematic,
            least: least / options.margin.max(1e-300),
            options,
            weights: weights.to_vec(),
            total,
            folds,
            watch: None,
        };
        made.calibrate(&[]);
        made
    }

    /// With something that ends it early, after which what it says is worth nothing, and something that shows how far it is.
    #[must_use]
    pub fn watched(mut self, stop: &'a AtomicBool, progress: &'a ProgressBar) -> Self {
        self.watch = Some((stop, progress));
        self
    }

    /// Number of effective samples.
    fn effective_samples(&self) -> f64 {
        self.options.effective_samples * self.weights.iter().filter(|w| **w > 0.0).count().max(2) as f64
    }

    /// Measures what an effective sample leaves on the best model with at most one effect beside `set`, with the model discrepancy nearly free.
    fn calibrate(&self, set: &[usize]) {
        self.residual_per_sample.set(constants::NEARLY_FREE / self.tight);
        let left = |set: &[usize]| self.losses(set, Tier::Strict).iter().sum::<f64>();
        let with = |e: usize| -> Vec<usize> { set.iter().copied().chain([e]).collect() };
        let others = (0..self.candidates.len()).filter(|e| !set.contains(e));
        let best = others.map(|e| left(&with(e))).fold(left(set), f64::min);
        // The law of no effect is known better than to some share of what the effect does.
        let least = constants::LAW * self.systematic * self.scale;
        self.residual_per_sample.set((best.max(least) / self.effective_samples()).max(1e-300));
    }

    /// The same with effective samples that count as those of another one.
    #[must_use]
    pub fn measured_as(self, other: &Self) -> Self {
        self.residual_per_sample.set(other.residual_per_sample.get());
        self
    }

    /// How badly a model does: twice the negative logarithm of its posterior probability, up to a constant.
    pub fn score(&self, set: &[usize]) -> f64 {
        let fit = self.fit_all(set, Tier::Strict);
        if set.iter().any(|e| !self.possible(*e, &fit)) {
            return f64::INFINITY;
        }
        let left: f64 = self.losses(set, Tier::Strict).iter().sum();
        self.weigh(left, self.discrepancy_cost(&fit), set)
    }

    /// Whether an effect can be what a fit makes of it: many act in one direction only.
    fn possible(&self, effect: usize, fit: &Fit) -> bool {
        let of = &self.candidates[effect];
        let along = |at: &[f64]| -> f64 {
            of.columns.iter().zip(at).map(|(&c, a)| fit.of(c) * a * self.total.diagonal(c)).sum()
        };
        of.starts.is_empty() || of.starts.iter().any(|(_, at)| along(at) > 0.0)
    }

    /// The same from what a model leaves, what its share of the model discrepancy costs, and the effects in it.
    #[must_use]
    pub fn weigh(&self, left: f64, discrepancy: f64, set: &[usize]) -> f64 {
        // Columns of one effect that differ from channel to channel, or go through time, hang together.
        let price = |c: &Candidate| {
            c.columns.len().min(if c.drifts_randomly { constants::MANY_DRIFTING } else { constants::MANY })
        };
        let columns: usize = set.iter().map(|e| price(&self.candidates[*e])).sum();
        left / self.residual_per_sample.get()
            + discrepancy
            + columns as f64 * self.effective_samples().ln() * constants::OCCAM
    }

    /// What coefficients of the model discrepancy cost under their prior.
    #[must_use]
    pub fn discrepancy_cost(&self, fit: &Fit) -> f64 {
        let of = fit.set.iter().zip(&fit.theta).filter(|(c, _)| self.discrepancy.contains(c));
        of.map(|(_, x)| x * x * self.tight).sum()
    }

    /// Inverse variance of a coefficient, in units of the residual's.
    #[must_use]
    pub fn prior(&self, column: usize) -> f64 {
        if self.discrepancy.contains(&column) {
            self.tight * self.residual_per_sample.get()
        } else {
            constants::PRIOR
        }
    }

    /// Columns of these candidates, and of the model discrepancy in the strict tier.
    fn columns(&self, set: &[usize], tier: Tier) -> Vec<usize> {
        let mut columns: Vec<usize> =
            set.iter().flat_map(|c| self.candidates[*c].columns.iter().copied()).collect();
        if tier == Tier::Strict {
            columns.extend(self.discrepancy);
        }
        columns
    }

    fn fit(&self, sum: &Sum, set: &[usize], tier: Tier) -> Fit {
        sum.fit(&self.columns(set, tier), |c| self.prior(c))
    }

    /// Fit of these candidates on all groups.
    #[must_use]
    pub fn fit_all(&self, set: &[usize], tier: Tier) -> Fit {
        self.fit(&self.total, set, tier)
    }

    /// Held-out loss of each fold.
    fn losses(&self, set: &[usize], tier: Tier) -> Vec<f64> {
        self.folds.iter().map(|[own, rest]| own.loss(&self.fit(rest, set, tier))).collect()
    }

    fn gain(&self, before: &[f64], after: &[f64]) -> f64 {
        (before.iter().sum::<f64>() - after.iter().sum::<f64>()) / self.scale
    }

    /// Least gain of an effect that counts beside `others`.
    fn least(&self, others: &[usize]) -> f64 {
        let inexact = |e: &usize| self.candidates[*e].nonlinear || self.candidates[*e].drifts_randomly;
        // What is little of a gap that matters counts beside what makes the most of it.
        let (floor, share) = match others {
            [] => (self.options.floor, self.options.share),
            others if others.iter().any(inexact) => (self.options.floor, self.options.beside_nonlinear),
            _ => (constants::SECOND * self.options.floor, self.options.beside),
        };
        floor.max(share * self.systematic)
    }
}
