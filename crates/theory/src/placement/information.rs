//! Placement by what elements tell of contacts: the Cramér–Rao bound of place and force, and which places look alike.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::{Field, Sets, Watch};

/// Settings of the search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BoundSettings {
    /// Share of a channel's spread that an estimator cannot make use of, beside the noise: what calibration and
    /// interpolation leave. Without it elements that read much in one spot and nothing elsewhere would look good.
    pub share: f64,
    /// Whether places are told apart that lie far from each other and read alike. The bound is local and blind to that.
    pub ambiguity: bool,
    /// Rounds in which each element may be exchanged for a better one, for every budget.
    pub rounds: usize,
    /// Candidates that are exchanged for at most: those that help most by themselves.
    pub exchanged: usize,
}

impl Default for BoundSettings {
    fn default() -> Self {
        Self { share: 0.02, ambiguity: true, rounds: 1, exchanged: 200 }
    }
}

/// What is known of every press before any element, and what elements add.
struct Problem {
    presses: usize,
    /// Candidate by candidate: derivatives by both directions and by the force, in units of the noise.
    slopes: Vec<[Vec<f32>; 3]>,
    /// Candidate by candidate: readings in units of the noise.
    readings: Vec<Vec<f32>>,
    /// \[m²\] squared distance between any two presses.
    apart: Vec<f32>,
    /// Covariance of directions and force before anything is read.
    prior: Matrix3<f64>,
    ambiguity: bool,
}

/// What a set of elements leaves open.
#[derive(Clone)]
struct State {
    /// Covariance of every press: xx, xy, yy, xf, yf, ff.
    covariance: [Vec<f32>; 6],
    /// Squared distance between the readings of any two presses, in units of the noise.
    unlike: Vec<f32>,
}

impl Problem {
    fn new(field: &Field, settings: &BoundSettings) -> Self {
        let presses = field.presses();
        let spreads = field.spreads();
        let noise: Vec<f64> =
            field.noise.iter().zip(&spreads).map(|(n, (_, s))| n.hypot(settings.share * s)).collect();
        let column = |matrix: &nalgebra::DMatrix<f64>, j: usize| -> Vec<f32> {
            matrix.column(j).iter().map(|v| (v / noise[j]) as f32).collect()
        };
        let candidates = field.candidates();
        let slopes = (0..candidates).map(|j| [0, 1, 2].map(|k| column(&field.slopes[k], j))).collect();
        let readings = (0..candidates).map(|j| column(&field.readings, j)).collect();
        let point = |p: usize| field.place_of(p).point;
        let mut apart = vec![0.0f32; presses * presses];
        for a in 0..presses {
            for b in 0..presses {
                apart[a * presses + b] = (point(a) - point(b)).norm_squared() as f32;
            }
        }
        // Anywhere on the skin: half of the mean squared distance from the middle along each direction.
        let total: f64 = apart.iter().map(|v| f64::from(*v)).sum();
        let place = total / (2.0 * (presses * presses).max(1) as f64) / 2.0;
        let low = field.forces.iter().copied().fold(f64::INFINITY, f64::min);
        let high = field.forces.iter().copied().fold(0.0, f64::max);
        // Any force of the range; known where there is but one.
        let force = (high - low).max(0.0).powi(2) / 12.0;
        let prior = Matrix3::from_diagonal(&nalgebra::Vector3::new(place, place, force));
        Self { presses, slopes, readings, apart, prior, ambiguity: settings.ambiguity }
    }

    fn start(&self) -> State {
        let p = &self.prior;
        let each = [p[(0, 0)], 0.0, p[(1, 1)], 0.0, 0.0, p[(2, 2)]];
        let pairs = if self.ambiguity { self.presses * self.presses } else { 0 };
        State { covariance: each.map(|v| vec![v as f32; self.presses]), unlike: vec![0.0; pairs] }
    }

    fn of(&self, elements: &[usize]) -> State {
        let mut state = self.start();
        elements.iter().for_each(|e| self.add(&mut state, *e));
        state
    }

    /// P g, and 1 + gᵀPg, of press `m`.
    #[inline]
    fn gain(&self, state: &State, element: usize, m: usize) -> ([f32; 3], f32) {
        let [a, b, c] = &self.slopes[element];
        let (a, b, c) = (a[m], b[m], c[m]);
        let [xx, xy, yy, xf, yf, ff] = &state.covariance;
        let x = xx[m] * a + xy[m] * b + xf[m] * c;
        let y = xy[m] * a + yy[m] * b + yf[m] * c;
        let f = xf[m] * a + yf[m] * b + ff[m] * c;
        ([x, y, f], 1.0 + a * x + b * y + c * f)
    }

    /// Takes what an element tells into account: one rank of information a press (Sherman–Morrison).
    fn add(&self, state: &mut State, element: usize) {
        for m in 0..self.presses {
            let ([x, y, f], s) = self.gain(state, element, m);
            let [xx, xy, yy, xf, yf, ff] = &mut state.covariance;
            xx[m] -= x * x / s;
            xy[m] -= x * y / s;
            yy[m] -= y * y / s;
            xf[m] -= x * f / s;
            yf[m] -= y * f / s;
            ff[m] -= f * f / s;
        }
        if self.ambiguity {
            let read = &self.readings[element];
            for (row, own) in state.unlike.chunks_exact_mut(self.presses).zip(read) {
                row.iter_mut().zip(read).for_each(|(d, r)| *d += (own - r) * (own - r));
            }
        }
    }

    /// \[m\] expected error, on average over the presses, once `element` is added. The root is taken press by press, so that
    /// single bad places do not decide.
    fn score(&self, state: &State, element: usize) -> f64 {
        let [xx, _, yy, ..] = &state.covariance;
        let mut sum = 0.0;
        let read = &self.readings[element];
        for m in 0..self.presses {
            let ([x, y, _], s) = self.gain(state, element, m);
            let local = (xx[m] + yy[m] - (x * x + y * y) / s).max(0.0);
            let far = if self.ambiguity {
                let span = m * self.presses..(m + 1) * self.presses;
                alike(&state.unlike[span.clone()], &self.apart[span], read, read[m])
            } else {
                0.0
            };
            sum += f64::from(local + far).sqrt();
        }
        sum / self.presses.max(1) as f64
    }

    fn total(&self, state: &State) -> f64 {
        let [xx, _, yy, ..] = &state.covariance;
        let mut sum = 0.0;
        for m in 0..self.presses {
            let far = if self.ambiguity {
                let span = m * self.presses..(m + 1) * self.presses;
                let nothing = vec![0.0; self.presses];
                alike(&state.unlike[span.clone()], &self.apart[span], &nothing, 0.0)
            } else {
                0.0
            };
            sum += f64::from((xx[m] + yy[m]).max(0.0) + far).sqrt();
        }
        sum / self.presses.max(1) as f64
    }

    /// The candidate of the least score among `open`.
    fn best(&self, state: &State, open: &[usize]) -> Option<(f64, usize)> {
        open.iter().map(|c| (self.score(state, *c), *c)).min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// \[m²\] mean squared distance of the presses that one could be mistaken for: weighted by how alike they read. The weights
/// have the heavy tails of an estimator that does not know its noise: (1 + d²/32)⁻⁸ ≈ exp(−d²/4), which is the chance of two
/// readings with noise to be swapped.
#[inline]
fn alike(unlike: &[f32], apart: &[f32], read: &[f32], own: f32) -> f32 {
    let (mut total, mut moment) = (0.0f32, 0.0f32);
    for ((d, far), r) in unlike.iter().zip(apart).zip(read) {
        let step = own - r;
        let base = 1.0 + (d + step * step) * (1.0 / 32.0);
        let two = base * base;
        let four = two * two;
        let weight = 1.0 / (four * four);
        total += weight;
        moment += weight * far;
    }
    // A press is always like itself: the total is at least 1.
    moment / total
}

/// Elements that make the expected error of contacts least, for every budget: greedily, then each exchanged where another one
/// is better. `None` where `watch` stopped it.
#[must_use]
pub fn by_bound(field: &Field, budget: usize, settings: &BoundSettings, watch: Watch<'_>) -> Option<Sets> {
    let problem = Problem::new(field, settings);
    let candidates = field.candidates();
    let all: Vec<usize> = (0..candidates).collect();
    let budget = budget.min(candidates);
    let mut order: Vec<usize> = Vec::new();
    let mut sets = Vec::new();
    let mut state = problem.start();
    for k in 1..=budget {
        if !watch((k - 1) as f64 / budget as f64) {
            return None;
        }
        // Each budget starts from the better set of the one before.
        let open: Vec<usize> = all.iter().copied().filter(|c| !order.contains(c)).collect();
        let mut scored: Vec<(f64, usize)> = open.iter().map(|c| (problem.score(&state, *c), *c)).collect();
        scored.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(&(mut reached, first)) = scored.first() else { break };
        order.push(first);
        let few: Vec<usize> = scored.iter().take(settings.exchanged).map(|(_, c)| *c).collect();
        for _ in 0..if k > 1 { settings.rounds } else { 0 } {
            let mut better = false;
            for at in 0..order.len() {
                let mut rest = order.clone();
                rest.remove(at);
                let without = problem.of(&rest);
                let open: Vec<usize> = few.iter().copied().filter(|c| !order.contains(c)).collect();
                if let Some((score, candidate)) = problem.best(&without, &open)
                    && score < reached * (1.0 - 1e-6)
                {
                    (reached, order[at], better) = (score, candidate, true);
                }
            }
            if !better {
                break;
            }
        }
        state = problem.of(&order);
        sets.push(order.clone());
    }
    Some(Sets(sets))
}

/// \[m\] what [`by_bound`] makes least, of any elements.
#[must_use]
pub fn expected_error(field: &Field, elements: &[usize], settings: &BoundSettings) -> f64 {
    let problem = Problem::new(field, settings);
    problem.total(&problem.of(elements))
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand::seq::index::sample;

    use super::super::testing::plate;
    use super::*;

    fn purely_local() -> BoundSettings {
        BoundSettings { share: 0.0, ambiguity: false, ..BoundSettings::default() }
    }

    #[test]
    fn without_ambiguity_it_is_the_bound_of_a_contact() {
        // Enough elements that nothing but they decides: the prior weighs next to nothing.
        let field = plate(9, 5).at(&[40, 41, 77]);
        let elements: Vec<usize> = (0..45).collect();
        let mut sum = 0.0;
        for p in 0..3 {
            let mut information = nalgebra::Matrix2::<f64>::zeros();
            for e in &elements {
                let g = nalgebra::Vector2::from_fn(|k, _| field.slopes[k][(p, *e)] / field.noise[*e]);
                information += g * g.transpose();
            }
            sum += information.try_inverse().unwrap().trace().sqrt();
        }
        approx::assert_relative_eq!(
            expected_error(&field, &elements, &purely_local()),
            sum / 3.0,
            max_relative = 1e-3
        );
    }

    #[test]
    fn it_ties_an_exhaustive_search_of_pairs_and_stays_near_it() {
        let field = plate(5, 3);
        let settings = BoundSettings { rounds: 3, ..BoundSettings::default() };
        let found = by_bound(&field, 3, &settings, &|_| true).unwrap();
        let pairs = (0..15).flat_map(|a| (a + 1..15).map(move |b| [a, b]));
        let least = pairs.map(|p| expected_error(&field, &p, &settings)).fold(f64::INFINITY, f64::min);
        approx::assert_relative_eq!(
            expected_error(&field, &found.0[1], &settings),
            least,
            max_relative = 1e-6
        );
        let mut least = f64::INFINITY;
        for a in 0..15 {
            for b in a + 1..15 {
                for c in b + 1..15 {
                    least = least.min(expected_error(&field, &[a, b, c], &settings));
                }
            }
        }
        approx::assert_relative_eq!(
            expected_error(&field, found.last(), &settings),
            least,
            max_relative = 0.07
        );
    }

    #[test]
    fn it_beats_chance_and_more_elements_are_better() {
        let field = plate(13, 9);
        let settings = BoundSettings::default();
        let found = by_bound(&field, 6, &settings, &|_| true).unwrap();
        let errors: Vec<f64> = found.0.iter().map(|s| expected_error(&field, s, &settings)).collect();
        assert!(errors.windows(2).all(|w| w[1] < w[0]), "{errors:?}");
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for _ in 0..200 {
            let any = sample(&mut random, field.candidates(), 6).into_vec();
            assert!(expected_error(&field, &any, &settings) > errors[5]);
        }
    }

    #[test]
    fn places_that_read_alike_are_told_apart() {
        // Two elements that mirror each other cannot tell which side is pressed; the local bound does not mind.
        let field = plate(9, 9);
        let local = purely_local();
        let all = BoundSettings { ambiguity: true, ..local };
        // On the middle line along x: y and −y read alike.
        let line = [36, 38, 40, 42, 44];
        assert!(expected_error(&field, &line, &all) > 2.0 * expected_error(&field, &line, &local));
    }

    #[test]
    fn it_can_be_stopped() {
        assert!(by_bound(&plate(5, 3), 3, &BoundSettings::default(), &|share| share < 0.5).is_none());
    }
}
