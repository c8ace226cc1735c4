//! The max-T test of Westfall and Young (1993): how often the best of the library is as good as a chosen effect where the sign of
//! each group's residual is drawn at random. It holds the probability of a false alarm over the whole library.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Selector, Tier};
use crate::constants::select::{ENOUGH, PRIOR};
use crate::statistics::Factor;

/// One effect beside the accepted ones.
struct Test {
    columns: Vec<usize>,
    factor: Option<Factor>,
    own: f64,
}

impl Test {
    /// Energy that it holds beyond `taken`, per degree of freedom in units of its own spread, so that effects of many columns have no
    /// advantage.
    fn statistic(&self, u: &[f64], taken: f64) -> f64 {
        let Some(factor) = &self.factor else { return 0.0 };
        (held(factor, &self.columns, u) - taken - self.own) / (2.0 * self.own).sqrt()
    }
}

fn held(factor: &Factor, columns: &[usize], u: &[f64]) -> f64 {
    factor.held(&columns.iter().map(|c| u[*c]).collect::<Vec<f64>>())
}

/// Sum of the scores of groups with these signs.
fn signed(scores: &[Vec<f64>], signs: &[f64], columns: usize) -> Vec<f64> {
    let mut u = vec![0.0; columns];
    for (scores, s) in scores.iter().zip(signs) {
        u.iter_mut().zip(scores).for_each(|(u, score)| *u += s * score);
    }
    u
}

impl Selector<'_> {
    /// Probability of a statistic as large as that of `chosen` beside `set` by chance.
    pub(super) fn significance(&self, set: &[usize], chosen: usize) -> f64 {
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
        let before = self.total.factor(inside, accepted);
        let others: Vec<usize> = (0..self.candidates.len()).filter(|e| !set.contains(e)).collect();
        let tests: Vec<Test> = others.iter().map(|e| self.test(inside, *e)).collect();
        let taken = |u: &[f64]| before.as_ref().map_or(0.0, |factor| held(factor, inside, u));
        let own = others.iter().position(|e| *e == chosen).unwrap_or(0);
        let Some(test) = tests.get(own) else { return 1.0 };
        let u = signed(&residual, &vec![1.0; groups.len()], every.len());
        let observed = test.statistic(&u, taken(&u));
        let mut rng = ChaCha8Rng::seed_from_u64(self.options.seed ^ 0xf11b);
        let mut above = 0;
        for permutation in 0..self.options.permutations {
            let signs: Vec<f64> =
                groups.iter().map(|_| if rng.random_bool(0.5) { 1.0 } else { -1.0 }).collect();
            let u = signed(&residual, &signs, every.len());
            let taken = taken(&u);
            let best = tests.iter().map(|t| t.statistic(&u, taken)).fold(f64::NEG_INFINITY, f64::max);
            above += usize::from(best >= observed);
            // Enough is known.
            if above as f64 > self.options.level * (self.options.permutations + 1) as f64 * ENOUGH {
                return above as f64 / (permutation + 1) as f64;
            }
        }
        (above + 1) as f64 / (self.options.permutations + 1) as f64
    }

    /// The test of one effect: what its columns hold beyond the accepted ones is what both hold without what these do.
    fn test(&self, inside: &[usize], effect: usize) -> Test {
        let of = &self.candidates[effect].columns;
        let columns: Vec<usize> = inside.iter().chain(of).copied().collect();
        let diagonal =
            |c: usize, g: f64| if inside.contains(&c) { accepted(c, g) } else { g * (1.0 + 1e-6) + PRIOR };
        let factor = self.total.factor(&columns, diagonal);
        Test { columns, factor, own: of.len() as f64 }
    }
}

/// The diagonal of columns of accepted effects.
fn accepted(_: usize, energy: f64) -> f64 {
    energy * (1.0 + 1e-9) + PRIOR + 1e-12
}
