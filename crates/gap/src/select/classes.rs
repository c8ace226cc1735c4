//! What cannot be told from an accepted effect, and each effect's share of what all explain.

use super::{IndistinguishableEffect, Selector, Tier};
use crate::constants::select::COVERED;
use crate::statistics::Fit;

impl Selector<'_> {
    /// What cannot be told from `named`, and more general effects that contain it.
    pub(super) fn class(
        &self,
        named: usize,
        others: &[usize],
        tier: Tier,
    ) -> (Vec<IndistinguishableEffect>, Vec<usize>) {
        let with = |e: usize| -> Vec<usize> { others.iter().copied().chain([e]).collect() };
        let before = self.losses(others, tier);
        let gain = self.gain(&before, &self.losses(&with(named), tier));
        let (none, score) = (self.score(others), self.score(&with(named)));
        let fit = self.fit_all(&with(named), tier);
        let mut members = vec![IndistinguishableEffect { candidate: named, gain, score, angle: 0.0 }];
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
            // A number has a second column where it bends, and is no more general by that.
            let general = !b.number && b.columns.len() >= 2 * a.columns.len() && inside > COVERED;
            if general && !(a.rig && b.family) {
                covers.push(e);
                continue;
            }
            members.push(IndistinguishableEffect {
                candidate: e,
                gain: other,
                score: own,
                angle: self.angle(named, e, &fit),
            });
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
    /// Shapley's values of the reductions over all orders, in shares of their sum.
    pub(super) fn shapley(&self, set: &[usize], tier: Tier) -> Vec<f64> {
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
