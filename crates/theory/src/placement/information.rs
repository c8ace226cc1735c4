//! Placement by what elements tell of contacts: the Cramér–Rao bound of place and force, and which places read alike.
//!
//! The bound is local and takes the model for known: it is blind to distant places that read alike, and to how an estimator
//! fills in between the presses that it has learnt. Both show in one further number a press: how far off the mean of all other
//! places is, weighted by how alike they read. The expected error of a press is the root of the sum of both squares.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::{Field, Sets, Watch};

/// Settings of the search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BoundSettings {
    /// Whether places that read alike count, beside the bound.
    pub alike: bool,
    /// Share of a channel's spread within which readings count as alike, beside its noise.
    pub share: f64,
    /// Places that all candidates are compared on. Those that do best there are compared on all places.
    pub coarse: usize,
    /// How many do best: one in so many.
    pub one_in: usize,
    /// Rounds in which each element may be exchanged for a better one, for every budget. This fits the places at hand better,
    /// and others no better: 0 is as good.
    pub rounds: usize,
}

impl Default for BoundSettings {
    fn default() -> Self {
        Self { alike: true, share: 0.15, coarse: 250, one_in: 6, rounds: 0 }
    }
}

/// What is known of every press before any element, and what elements add.
struct Problem {
    presses: usize,
    /// Presses at one place.
    forces: usize,
    /// Candidate by candidate: derivatives by both directions and by the force, in units of the noise.
    slopes: Vec<[Vec<f32>; 3]>,
    /// Candidate by candidate: readings in units of what counts as alike.
    readings: Vec<Vec<f32>>,
    /// \[m\] coordinates of the presses from their middle.
    places: [Vec<f32>; 3],
    /// Covariance of directions and force before anything is read.
    prior: Matrix3<f64>,
    alike: bool,
}

/// What a set of elements leaves open.
#[derive(Clone)]
struct State {
    elements: usize,
    /// Covariance of every press: xx, xy, yy, xf, yf, ff.
    covariance: [Vec<f32>; 6],
    /// Squared distance between the readings of any two presses.
    unlike: Vec<f32>,
}

impl Problem {
    fn new(field: &Field, settings: &BoundSettings) -> Self {
        let presses = field.presses();
        let column = |matrix: &nalgebra::DMatrix<f64>, j: usize, unit: f64| -> Vec<f32> {
            matrix.column(j).iter().map(|v| (v / unit) as f32).collect()
        };
        let candidates = field.candidates();
        let slopes =
            (0..candidates).map(|j| [0, 1, 2].map(|k| column(&field.slopes[k], j, field.noise[j]))).collect();
        let spreads = field.spreads();
        let unit = |j: usize| field.noise[j].hypot(settings.share * spreads[j].1);
        let readings = (0..candidates).map(|j| column(&field.readings, j, unit(j))).collect();
        let sum: nalgebra::Vector3<f64> = field.places.iter().map(|p| p.point.coords).sum();
        let middle = sum / field.places.len().max(1) as f64;
        let from_middle = |p: usize| field.place_of(p).point.coords - middle;
        let places = [0, 1, 2].map(|k| (0..presses).map(|p| from_middle(p)[k] as f32).collect());
        // Anywhere on the skin, in either direction alike.
        let squares: f64 = (0..presses).map(|p| from_middle(p).norm_squared()).sum();
        let place = squares / presses.max(1) as f64 / 2.0;
        let low = field.forces.iter().copied().fold(f64::INFINITY, f64::min);
        let high = field.forces.iter().copied().fold(0.0, f64::max);
        // Any force of the range; known where there is but one.
        let force = (high - low).max(0.0).powi(2) / 12.0;
        let prior = Matrix3::from_diagonal(&nalgebra::Vector3::new(place, place, force));
        Self {
            presses,
            forces: field.forces.len().max(1),
            slopes,
            readings,
            places,
            prior,
            alike: settings.alike,
        }
    }

    fn start(&self) -> State {
        let p = &self.prior;
        let each = [p[(0, 0)], 0.0, p[(1, 1)], 0.0, 0.0, p[(2, 2)]];
        let pairs = if self.alike { self.presses * self.presses } else { 0 };
        State {
            elements: 0,
            covariance: each.map(|v| vec![v as f32; self.presses]),
            unlike: vec![0.0; pairs],
        }
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
        if self.alike {
            let read = &self.readings[element];
            for (row, own) in state.unlike.chunks_exact_mut(self.presses).zip(read) {
                row.iter_mut().zip(read).for_each(|(d, r)| *d += (own - r) * (own - r));
            }
        }
        state.elements += 1;
    }

    /// \[m\] expected error, on average over the presses, once `element` is added. The root is taken press by press, so that
    /// single bad places do not decide.
    fn score(&self, state: &State, element: usize) -> f64 {
        let [xx, _, yy, ..] = &state.covariance;
        let mut sum = 0.0;
        for m in 0..self.presses {
            let ([x, y, _], s) = self.gain(state, element, m);
            let local = (xx[m] + yy[m] - (x * x + y * y) / s).max(0.0);
            let mistaken = if self.alike { self.mistaken(state, element, m) } else { 0.0 };
            sum += f64::from(local + mistaken).sqrt();
        }
        sum / self.presses.max(1) as f64
    }

    /// \[m²\] how far off the mean of all other places is that read like press `m`. The weights (1 + d²/k)⁻² of readings of
    /// k channels at a distance d have heavy tails: where nothing reads alike, the least unlike decide, as they would for an
    /// estimator that has learnt nothing nearer.
    #[inline]
    fn mistaken(&self, state: &State, element: usize, m: usize) -> f32 {
        let read = &self.readings[element];
        let per_channel = 1.0 / (state.elements + 1) as f32;
        let unlike = &state.unlike[m * self.presses..(m + 1) * self.presses];
        let [xs, ys, zs] = &self.places;
        let own = read[m];
        let (mut total, mut x, mut y, mut z) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        let place = m / self.forces * self.forces;
        // Not from itself, nor from the same place under another force.
        for part in [0..place, place + self.forces..self.presses] {
            let others = unlike[part.clone()].iter().zip(&read[part.clone()]);
            let at = xs[part.clone()].iter().zip(&ys[part.clone()]).zip(&zs[part]);
            for ((d, r), ((px, py), pz)) in others.zip(at) {
                let step = own - r;
                let base = 1.0 + (d + step * step) * per_channel;
                let weight = 1.0 / (base * base);
                total += weight;
                x += weight * px;
                y += weight * py;
                z += weight * pz;
            }
        }
        if total > 0.0 {
            (x / total - xs[m]).powi(2) + (y / total - ys[m]).powi(2) + (z / total - zs[m]).powi(2)
        } else {
            0.0
        }
    }

    /// The candidate of the least score among `open`.
    fn best(&self, state: &State, open: &[usize]) -> Option<(f64, usize)> {
        open.iter().map(|c| (self.score(state, *c), *c)).min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// Elements of `among` that make the expected error of contacts least, one after the other, for every budget. `None` where
/// `watch` stopped it.
#[must_use]
pub fn by_bound(
    field: &Field,
    among: &[usize],
    budget: usize,
    settings: &BoundSettings,
    watch: Watch<'_>,
) -> Option<Sets> {
    let fine = Problem::new(field, settings);
    let every = field.places.len().div_ceil(settings.coarse.max(1)).max(1);
    let coarse = (every > 1).then(|| {
        let few: Vec<usize> = (0..field.places.len()).step_by(every).collect();
        Problem::new(&field.at(&few), settings)
    });
    let budget = budget.min(among.len());
    let mut order: Vec<usize> = Vec::new();
    let mut sets = Vec::new();
    for k in 1..=budget {
        let mut open: Vec<usize> = among.iter().copied().filter(|c| !order.contains(c)).collect();
        if let Some(coarse) = &coarse {
            let state = coarse.of(&order);
            let mut scored = Vec::with_capacity(open.len());
            for (n, candidate) in open.iter().enumerate() {
                if !watch((k as f64 - 1.0 + 0.5 * n as f64 / open.len() as f64) / budget as f64) {
                    return None;
                }
                scored.push((coarse.score(&state, *candidate), *candidate));
            }
            scored.sort_by(|a, b| a.0.total_cmp(&b.0));
            scored.truncate((open.len() / settings.one_in.max(1)).max(10));
            open = scored.into_iter().map(|(_, c)| c).collect();
        }
        if !watch((k as f64 - 0.5) / budget as f64) {
            return None;
        }
        let (mut reached, first) = fine.best(&fine.of(&order), &open)?;
        order.push(first);
        for _ in 0..if k > 1 { settings.rounds } else { 0 } {
            let mut better = false;
            for at in 0..order.len() {
                let mut rest = order.clone();
                rest.remove(at);
                let open: Vec<usize> = among.iter().copied().filter(|c| !order.contains(c)).collect();
                if let Some((score, candidate)) = fine.best(&fine.of(&rest), &open)
                    && score < reached * (1.0 - 1e-6)
                {
                    (reached, order[at], better) = (score, candidate, true);
                }
            }
            if !better {
                break;
            }
        }
        sets.push(order.clone());
    }
    Some(Sets(sets))
}

/// \[m\] what [`by_bound`] makes least, of any elements; the spread of the places where there are none.
#[must_use]
pub fn expected_error(field: &Field, elements: &[usize], settings: &BoundSettings) -> f64 {
    let problem = Problem::new(field, settings);
    match elements.split_last() {
        Some((last, before)) => problem.score(&problem.of(before), *last),
        None => (problem.prior[(0, 0)] * 2.0).sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand::seq::index::sample;

    use super::super::testing::plate;
    use super::*;

    fn purely_local() -> BoundSettings {
        BoundSettings { alike: false, ..BoundSettings::default() }
    }

    #[test]
    fn by_itself_it_is_the_bound_of_a_contact() {
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
    fn it_stays_near_an_exhaustive_search() {
        let field = plate(5, 3);
        let settings = BoundSettings { rounds: 3, ..BoundSettings::default() };
        let found = by_bound(&field, &(0..15).collect::<Vec<_>>(), 3, &settings, &|_| true).unwrap();
        let pairs = (0..15).flat_map(|a| (a + 1..15).map(move |b| [a, b]));
        let least = pairs.map(|p| expected_error(&field, &p, &settings)).fold(f64::INFINITY, f64::min);
        approx::assert_relative_eq!(
            expected_error(&field, &found.0[1], &settings),
            least,
            max_relative = 0.02
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
        let found = by_bound(&field, &(0..117).collect::<Vec<_>>(), 6, &settings, &|_| true).unwrap();
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
        let all = BoundSettings { alike: true, ..local };
        // On the middle line along x: y and −y read alike.
        let line = [36, 38, 40, 42, 44];
        assert!(expected_error(&field, &line, &all) > 2.0 * expected_error(&field, &line, &local));
    }

    #[test]
    fn it_can_be_stopped() {
        assert!(
            by_bound(&plate(5, 3), &[0, 1, 2, 3], 3, &BoundSettings::default(), &|share| share < 0.5)
                .is_none()
        );
    }
}
