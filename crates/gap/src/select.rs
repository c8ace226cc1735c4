//! Which effects make the gap: models are compared on held-out groups, with what cannot be told apart.
//!
//! A model is the columns of the effects in it, beside those of the simulator's own error: laws that it simplifies. The error has
//! a prior: it may make up a gap that does not matter ([`SelectOptions::margin`]), and what goes beyond costs. What no model
//! explains is no noise but the error of laws, which goes on from press to press: so the likelihood is that of as many independent
//! pieces as there are places, with the spread that the best model leaves. An effect that beats the simulator's own error by that
//! measure is named firmly; one that does not may as well be it.

use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::ProgressBar;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::library::{Candidate, Gram};
use crate::statistics::{Factor, Fit, Statistics, Sum};

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
    /// The same beside others that do not act in proportion: what their columns leave may look like one.
    pub beside_bent: f64,
    /// Probability of a false alarm over the whole library.
    pub level: f64,
    /// Effects at most.
    pub most: usize,
    /// Folds of cross-validation.
    pub folds: usize,
    /// Sign flips.
    pub flips: usize,
    /// Odds against an effect from which on it can be told from the one that is named.
    pub odds: f64,
    /// Independent pieces of evidence that a place of contact gives.
    pub pieces: f64,
    /// Of everything random.
    pub seed: u64,
}

impl Default for SelectOptions {
    fn default() -> Self {
        Self {
            margin: 0.005,
            floor: 0.002,
            share: 0.05,
            beside: 0.01,
            beside_bent: 0.12,
            level: 0.01,
            most: 5,
            folds: 6,
            flips: 299,
            odds: 20.0,
            pieces: 0.5,
            seed: 1,
        }
    }
}

/// How well an effect stands against the simulator's own error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tier {
    /// It explains what the declared tolerances of the simulator cannot.
    Strict,
    /// It, or the simulator's own error.
    Loose,
}

/// An effect that cannot be told from the one that is named.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
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
pub struct Pick {
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
    /// All that cannot be told apart, the named one first.
    pub class: Vec<Member>,
    /// More general effects that contain the named one.
    pub covers: Vec<usize>,
}

/// What selection found.
#[derive(Debug, Clone, Default)]
pub struct Selection {
    /// Accepted effects, the strongest first.
    pub picks: Vec<Pick>,
    /// Reduction by the simulator's own error alone.
    pub form: f64,
    /// Reduction by the accepted effects alone.
    pub library: f64,
    /// Reduction by both.
    pub both: f64,
    /// Gains of every candidate alone: strict, loose.
    pub alone: Vec<[f64; 2]>,
}

/// Weak prior on coefficients of effects.
const PRIOR: f64 = 0.05;
/// Share of the energy of what an effect does that its law leaves at least: a fifth of the amplitude.
const LAW: f64 = 0.04;
/// Share of the information criterion's price of a column that is asked: cross-validation has paid some of it.
const OCCAM: f64 = 0.5;
/// Margins that a gap must surely exceed for any name, and for one that may as well be the simulator's own error.
pub(crate) const CLEARLY: f64 = 1.0;
pub(crate) const SURELY: f64 = 1.4;
/// Share of a gap of hardly more than what does not matter that an effect must explain beyond the simulator's own error.
const BEYOND: f64 = 0.5;
/// Columns of one effect that are paid for, at most.
const MANY: usize = 6;
/// The same of one that goes its own way through time, which can follow the temperature as well.
const BENDS: usize = 12;

/// The effect that makes the best model beside those that are accepted.
struct Step {
    best: usize,
    /// All of them.
    with: Vec<usize>,
    /// Reduction of the held-out error.
    gain: f64,
    /// By how much the model with it is better.
    won: f64,
}

/// Selection over one set of groups.
pub struct Selector<'a> {
    statistics: &'a Statistics,
    candidates: &'a [Candidate],
    form: &'a [usize],
    /// Inverse variance of coefficients of the simulator's own error, in its prior.
    tight: f64,
    /// Energy that one independent piece of evidence leaves.
    piece: Cell<f64>,
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
        form: &'a [usize],
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
        let energy: f64 = form.iter().map(|&f| total.diagonal(f)).sum();
        let tight = energy / (options.margin * scale).max(1e-300);
        let made = Self {
            statistics,
            candidates,
            form,
            tight,
            piece: Cell::new(1.0),
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

    /// Independent pieces of evidence.
    fn pieces(&self) -> f64 {
        self.options.pieces * self.weights.iter().filter(|w| **w > 0.0).count().max(2) as f64
    }

    /// Measures what a piece of evidence leaves on the best model with at most one effect beside `set`, with the simulator's own
    /// error nearly free.
    fn calibrate(&self, set: &[usize]) {
        self.piece.set(0.1 / self.tight);
        let left = |set: &[usize]| self.losses(set, Tier::Strict).iter().sum::<f64>();
        let with = |e: usize| -> Vec<usize> { set.iter().copied().chain([e]).collect() };
        let others = (0..self.candidates.len()).filter(|e| !set.contains(e));
        let best = others.map(|e| left(&with(e))).fold(left(set), f64::min);
        // The law of no effect is known better than to some share of what the effect does.
        let least = LAW * self.systematic * self.scale;
        self.piece.set((best.max(least) / self.pieces()).max(1e-300));
    }

    /// The same with pieces of evidence that count as those of another one.
    #[must_use]
    pub fn measured_as(self, other: &Self) -> Self {
        self.piece.set(other.piece.get());
        self
    }

    /// How badly a model does: twice the negative logarithm of its posterior probability, up to a constant.
    pub fn score(&self, set: &[usize]) -> f64 {
        let fit = self.fit_all(set, Tier::Strict);
        if set.iter().any(|e| !self.possible(*e, &fit)) {
            return f64::INFINITY;
        }
        let left: f64 = self.losses(set, Tier::Strict).iter().sum();
        self.weigh(left, self.form_cost(&fit), set)
    }

    /// Whether an effect can be what a fit makes of it: many act in one direction only.
    fn possible(&self, effect: usize, fit: &Fit) -> bool {
        let of = &self.candidates[effect];
        let along = |at: &[f64]| -> f64 {
            of.columns.iter().zip(at).map(|(&c, a)| fit.of(c) * a * self.total.diagonal(c)).sum()
        };
        of.starts.is_empty() || of.starts.iter().any(|(_, at)| along(at) > 0.0)
    }

    /// The same from what a model leaves, what its share of the simulator's own error costs, and the effects in it.
    #[must_use]
    pub fn weigh(&self, left: f64, form: f64, set: &[usize]) -> f64 {
        // Columns of one effect that differ from channel to channel, or go through time, hang together.
        let price = |c: &Candidate| c.columns.len().min(if c.wanders { BENDS } else { MANY });
        let columns: usize = set.iter().map(|e| price(&self.candidates[*e])).sum();
        left / self.piece.get() + form + columns as f64 * self.pieces().ln() * OCCAM
    }

    /// What coefficients of the simulator's own error cost under their prior.
    #[must_use]
    pub fn form_cost(&self, fit: &Fit) -> f64 {
        let of = fit.set.iter().zip(&fit.theta).filter(|(c, _)| self.form.contains(c));
        of.map(|(_, x)| x * x * self.tight).sum()
    }

    /// Inverse variance of a coefficient, in units of the residual's.
    #[must_use]
    pub fn prior(&self, column: usize) -> f64 {
        if self.form.contains(&column) { self.tight * self.piece.get() } else { PRIOR }
    }

    /// Columns of these candidates, and of the simulator's own error in the strict tier.
    fn columns(&self, set: &[usize], tier: Tier) -> Vec<usize> {
        let mut columns: Vec<usize> =
            set.iter().flat_map(|c| self.candidates[*c].columns.iter().copied()).collect();
        if tier == Tier::Strict {
            columns.extend(self.form);
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
        let inexact = |e: &usize| self.candidates[*e].bent || self.candidates[*e].wanders;
        // What is little of a gap that matters counts beside what makes the most of it.
        let (floor, share) = match others {
            [] => (self.options.floor, self.options.share),
            others if others.iter().any(inexact) => (self.options.floor, self.options.beside_bent),
            _ => (0.5 * self.options.floor, self.options.beside),
        };
        floor.max(share * self.systematic)
    }

    /// Selects.
    #[must_use]
    pub fn select(&self) -> Selection {
        let none = self.losses(&[], Tier::Loose);
        let strict_none = self.losses(&[], Tier::Strict);
        let mut found = Selection { form: self.gain(&none, &strict_none), ..Selection::default() };
        found.alone = (0..self.candidates.len())
            .map(|e| {
                [
                    self.gain(&strict_none, &self.losses(&[e], Tier::Strict)),
                    self.gain(&none, &self.losses(&[e], Tier::Loose)),
                ]
            })
            .collect();
        let mut set: Vec<usize> = Vec::new();
        // Whether the last one may as well be the simulator's own error.
        let mut loose = false;
        let mut ps: Vec<f64> = Vec::new();
        while set.len() < self.options.most {
            let Some(Step { best, with, gain, won }) = self.step(&set) else { break };
            if gain < self.least(&set) || won <= 0.0 {
                break;
            }
            // Near the size that does not matter, what the simulator's own error may do as well is no finding.
            let beyond = self.gain(&self.losses(&set, Tier::Strict), &self.losses(&with, Tier::Strict));
            let clear = self.least > CLEARLY || beyond >= BEYOND * self.systematic;
            let firm = won > self.firm() && clear;
            // What is left that surely matters, and goes away with an effect that may as well be the simulator's own error, is told as such.
            let rest = self.systematic - self.gain(&none, &self.losses(&set, Tier::Loose));
            let surely = self.least * (rest / self.systematic).min(1.0) > SURELY;
            let loosely = surely && (set.is_empty() || gain >= BEYOND * rest);
            if !(firm || loosely) {
                break;
            }
            let p = self.significance(&set, best);
            // Effects of many columns have little power in that test; evidence this strong needs none.
            if p > self.options.level && won < 3.0 * self.firm() {
                break;
            }
            if !firm {
                loose = true;
            }
            set = with;
            ps.push(p);
            self.prune(&mut set, &mut ps);
            if !firm {
                break;
            }
        }
        self.calibrate(&set[..set.len().saturating_sub(1)]);
        if set.len() > 1 {
            self.swap(&mut set);
        }
        let after = self.losses(&set, Tier::Loose);
        found.library = self.gain(&none, &after);
        found.both = self.gain(&none, &self.losses(&set, Tier::Strict));
        let shapley = self.shapley(&set, if loose { Tier::Loose } else { Tier::Strict });
        for (i, &candidate) in set.iter().enumerate() {
            let tier = if loose && i + 1 == set.len() { Tier::Loose } else { Tier::Strict };
            let others: Vec<usize> = set.iter().copied().filter(|c| *c != candidate).collect();
            let (class, covers) = self.class(candidate, &others, tier);
            found.picks.push(Pick {
                candidate,
                tier,
                gain: class.first().map_or(0.0, |m| m.gain),
                solo: found.alone[candidate][usize::from(tier == Tier::Loose)],
                shapley: shapley[i],
                p: ps.get(i).copied().unwrap_or(f64::NAN),
                class,
                covers,
            });
        }
        found.picks.sort_by(|a, b| b.shapley.total_cmp(&a.shapley));
        found
    }

    /// Candidates that forward steps accept, without tests of significance: for resampling.
    #[must_use]
    pub fn quick(&self) -> Vec<usize> {
        let mut set: Vec<usize> = Vec::new();
        while set.len() < self.options.most {
            let Some(Step { with, gain, won, .. }) = self.step(&set) else { break };
            if gain < self.least(&set) || (!set.is_empty() && won < self.firm()) {
                break;
            }
            set = with;
        }
        set
    }

    /// By how much an effect has to beat the simulator's own error: every one of the library has its chance to by accident.
    fn firm(&self) -> f64 {
        2.0 * (self.candidates.len().max(1) as f64 / self.options.level).ln()
    }

    /// The step forwards from `set`; `None` where every effect is in it.
    fn step(&self, set: &[usize]) -> Option<Step> {
        self.calibrate(set);
        let score = self.score(set);
        let (best, better) = self.best(set)?;
        let with: Vec<usize> = set.iter().copied().chain([best]).collect();
        // Held against the gap itself, and against what is left beside the simulator's own error.
        let gain = |tier| self.gain(&self.losses(set, tier), &self.losses(&with, tier));
        let gain = gain(Tier::Loose).max(gain(Tier::Strict));
        let won = if better < score { score - better } else { 0.0 };
        Some(Step { best, with, gain, won })
    }

    /// The effect beside `set` that makes the best model, and its score.
    fn best(&self, set: &[usize]) -> Option<(usize, f64)> {
        if let Some((_, progress)) = self.watch {
            progress.inc_length((self.candidates.len() - set.len()) as u64);
        }
        (0..self.candidates.len())
            .filter(|e| !set.contains(e))
            .take_while(|_| self.watch.is_none_or(|(stop, _)| !stop.load(Ordering::Relaxed)))
            .map(|e| {
                if let Some((_, progress)) = self.watch {
                    progress.inc(1);
                }
                let with: Vec<usize> = set.iter().copied().chain([e]).collect();
                (e, self.score(&with))
            })
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Drops what is no longer needed.
    fn prune(&self, set: &mut Vec<usize>, ps: &mut Vec<f64>) {
        let mut index = 0;
        while set.len() > 1 && index < set.len() {
            let all = self.losses(set, Tier::Strict);
            let rest: Vec<usize> = set.iter().copied().filter(|c| *c != set[index]).collect();
            let lost = self.gain(&self.losses(&rest, Tier::Strict), &all);
            // The last one has just been accepted.
            if lost < self.least(&rest) && index + 1 < set.len() {
                set.remove(index);
                ps.remove(index);
            } else {
                index += 1;
            }
        }
    }

    /// Exchanges an accepted effect for another where that is clearly better.
    fn swap(&self, set: &mut [usize]) {
        for _ in 0..set.len() {
            let now = self.score(set);
            let mut best: Option<(usize, usize, f64)> = None;
            for i in 0..set.len() {
                for e in 0..self.candidates.len() {
                    if set.contains(&e) {
                        continue;
                    }
                    let mut other = set.to_vec();
                    other[i] = e;
                    let score = self.score(&other);
                    if best.is_none_or(|b| score < b.2) {
                        best = Some((i, e, score));
                    }
                }
            }
            match best {
                Some((i, e, score)) if now - score > 2.0 * self.options.odds.ln() => set[i] = e,
                _ => break,
            }
        }
    }

    /// What cannot be told from `named`, and more general effects that contain it.
    fn class(&self, named: usize, others: &[usize], tier: Tier) -> (Vec<Member>, Vec<usize>) {
        let with = |e: usize| -> Vec<usize> { others.iter().copied().chain([e]).collect() };
        let before = self.losses(others, tier);
        let gain = self.gain(&before, &self.losses(&with(named), tier));
        let (none, score) = (self.score(others), self.score(&with(named)));
        let fit = self.fit_all(&with(named), tier);
        let mut members = vec![Member { candidate: named, gain, score, angle: 0.0 }];
        let mut covers = Vec::new();
        for e in 0..self.candidates.len() {
            if e == named || others.contains(&e) {
                continue;
            }
            let own = self.score(&with(e));
            // What linear signatures put behind may be before once it is simulated in full.
            if own > none {
                continue;
            }
            let other = self.gain(&before, &self.losses(&with(e), tier));
            let (a, b) = (&self.candidates[named], &self.candidates[e]);
            let inside = self.gram.explained(&a.columns, &b.columns);
            let general = b.columns.len() >= 2 * a.columns.len() && inside > 0.95;
            if general && !(a.rig && b.family) {
                covers.push(e);
                continue;
            }
            members.push(Member { candidate: e, gain: other, score: own, angle: self.angle(named, e, &fit) });
        }
        members[1..].sort_by(|a, b| a.score.total_cmp(&b.score));
        (members, covers)
    }

    /// \[rad\] between the fitted change of `named` and the span of `other`.
    fn angle(&self, named: usize, other: usize, fit: &Fit) -> f64 {
        let own = &self.candidates[named].columns;
        let span = &self.candidates[other].columns;
        let (set, theta): (Vec<usize>, Vec<f64>) =
            fit.set.iter().copied().zip(fit.theta.iter().copied()).filter(|(c, _)| own.contains(c)).unzip();
        let energy = self.total.energy(&set, &theta);
        let factor = self.total.factor(span, |_, g| g * (1.0 + 1e-9) + 1e-12);
        let Some(factor) = factor.filter(|_| energy > 0.0) else { return std::f64::consts::FRAC_PI_2 };
        let held = factor.held(&self.total.project(&set, &theta, span));
        (held / energy).clamp(0.0, 1.0).sqrt().acos()
    }

    /// Westfall and Young's max-T: how often the best of the library is as good as `chosen` where the sign of each group's
    /// residual is drawn.
    fn significance(&self, set: &[usize], chosen: usize) -> f64 {
        let base = self.fit_all(set, Tier::Loose);
        let inside = &base.set;
        let groups: Vec<usize> = (0..self.weights.len()).filter(|g| self.weights[*g] > 0.0).collect();
        let every: Vec<usize> = (0..self.total.columns()).collect();
        let residual: Vec<Vec<f64>> = groups
            .iter()
            .map(|&g| {
                let fitted = self.statistics.project(g, &base, &every);
                self.statistics.score(g).iter().zip(fitted).map(|(b, f)| self.weights[g] * (b - f)).collect()
            })
            .collect();
        // What a candidate's columns hold beyond the accepted ones is what both hold without what these do.
        let accepted = |_: usize, g: f64| g * (1.0 + 1e-9) + PRIOR + 1e-12;
        let before = self.total.factor(inside, accepted);
        struct Test {
            columns: Vec<usize>,
            factor: Option<Factor>,
            own: f64,
        }
        let mut tests = Vec::new();
        let mut own = 0;
        for e in (0..self.candidates.len()).filter(|e| !set.contains(e)) {
            if e == chosen {
                own = tests.len();
            }
            let of = &self.candidates[e].columns;
            let columns: Vec<usize> = inside.iter().chain(of).copied().collect();
            let diagonal = |c: usize, g: f64| {
                if inside.contains(&c) { accepted(c, g) } else { g * (1.0 + 1e-6) + PRIOR }
            };
            let factor = self.total.factor(&columns, diagonal);
            tests.push(Test { columns, factor, own: of.len() as f64 });
        }
        let score = |signs: &[f64]| {
            let mut u = vec![0.0; every.len()];
            for (scores, s) in residual.iter().zip(signs) {
                u.iter_mut().zip(scores).for_each(|(u, score)| *u += s * score);
            }
            u
        };
        let held = |factor: &Factor, columns: &[usize], u: &[f64]| {
            factor.held(&columns.iter().map(|c| u[*c]).collect::<Vec<f64>>())
        };
        // Per degree of freedom, in units of its own spread, so that effects of many columns have no advantage.
        let statistic = |test: &Test, u: &[f64], taken: f64| {
            let Some(factor) = &test.factor else { return 0.0 };
            (held(factor, &test.columns, u) - taken - test.own) / (2.0 * test.own).sqrt()
        };
        let taken = |u: &[f64]| before.as_ref().map_or(0.0, |factor| held(factor, inside, u));
        let Some(test) = tests.get(own) else { return 1.0 };
        let u = score(&vec![1.0; groups.len()]);
        let observed = statistic(test, &u, taken(&u));
        let mut rng = ChaCha8Rng::seed_from_u64(self.options.seed ^ 0xf11b);
        let mut above = 0;
        for flip in 0..self.options.flips {
            let signs: Vec<f64> =
                groups.iter().map(|_| if rng.random_bool(0.5) { 1.0 } else { -1.0 }).collect();
            let u = score(&signs);
            let taken = taken(&u);
            let best = tests.iter().map(|t| statistic(t, &u, taken)).fold(f64::NEG_INFINITY, f64::max);
            above += usize::from(best >= observed);
            // Enough is known.
            if above as f64 > self.options.level * (self.options.flips + 1) as f64 * 4.0 {
                return above as f64 / (flip + 1) as f64;
            }
        }
        (above + 1) as f64 / (self.options.flips + 1) as f64
    }

    /// Shapley's values of the reductions over all orders, in shares of their sum.
    fn shapley(&self, set: &[usize], tier: Tier) -> Vec<f64> {
        let n = set.len();
        let value: Vec<f64> = (0..1usize << n)
            .map(|mask| {
                let with: Vec<usize> = (0..n).filter(|i| mask >> i & 1 == 1).map(|i| set[i]).collect();
                -self.losses(&with, tier).iter().sum::<f64>() / self.scale
            })
            .collect();
        let factorial = |k: usize| (1..=k).product::<usize>() as f64;
        let mut shares: Vec<f64> = (0..n)
            .map(|i| {
                (0..1usize << n)
                    .filter(|mask| mask >> i & 1 == 0)
                    .map(|mask| {
                        let size = mask.count_ones() as usize;
                        let weight = factorial(size) * factorial(n - size - 1) / factorial(n);
                        weight * (value[mask | 1 << i] - value[mask])
                    })
                    .sum()
            })
            .collect();
        let all: f64 = shares.iter().sum();
        shares.iter_mut().for_each(|s| *s /= if all > 0.0 { all } else { 1.0 });
        shares
    }
}

/// Distribution function of the normal distribution (Abramowitz and Stegun 7.1.26, within 2e-7).
#[must_use]
pub fn normal(z: f64) -> f64 {
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let poly = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = 0.5 * poly * (-x * x).exp();
    if z > 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_normal_distribution_is_that_of_the_tables() {
        for (z, p) in [(0.0, 0.5), (-1.959_964, 0.025), (2.326_348, 0.99), (-5.0, 2.8665e-7)] {
            approx::assert_abs_diff_eq!(normal(z), p, epsilon = 2e-7);
        }
    }
}
