//! Placement by what elements tell of contacts: the Cramér–Rao bound of place and force, and what is left between the presses that
//! an estimator has learnt.
//!
//! The bound is local and takes the model for known: it is blind to distant locations that read alike, and to how an estimator
//! fills in between the presses that it has learnt. Both show when every press is foretold from all the others: the mean of a
//! Gaussian process from readings to locations, whose errors on what is left out have a closed form (C. E. Rasmussen,
//! C. K. I. Williams, *Gaussian Processes for Machine Learning*, 2006, 5.4.2). The expected error of a press is the root of the
//! sum of both squares. It takes the inverse of a matrix for every set of elements that is tried, so that all candidates are
//! compared on few locations first, and the best of them on many.

use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::{Mat, Par, Side};
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::{Field, Sets, Watch};

/// Settings of the search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BoundSettings {
    /// Whether what is left between the presses that are known counts, beside the bound.
    pub between: bool,
    /// γ of the process' kernel exp(−γd/k), d the squared distance of the standardised readings of k elements.
    pub gamma: f64,
    /// Variance on top of the process, whose own is 1.
    pub ridge: f64,
    /// Locations that all candidates are compared on.
    pub coarse: usize,
    /// Best of them that are compared on `fine` locations.
    pub closely: usize,
    /// Locations that those are compared on.
    pub fine: usize,
}

impl Default for BoundSettings {
    fn default() -> Self {
        Self { between: true, gamma: 3.0, ridge: 1e-2, coarse: 150, closely: 10, fine: 450 }
    }
}

/// What is known of every press before any element, and what elements add.
struct Problem {
    presses: usize,
    /// Presses at one place.
    forces: usize,
    /// Candidate by candidate: derivatives by both directions and by the force, in units of the noise.
    slopes: Vec<[Vec<f32>; 3]>,
    /// Candidate by candidate: standardised readings.
    readings: Vec<Vec<f32>>,
    /// \[m\] coordinates of the presses from their middle, presses × 3.
    locations: Mat<f32>,
    /// Covariance of directions and force before anything is read.
    prior: Matrix3<f64>,
    /// γ and ridge of the process, where it counts.
    process: Option<(f32, f32)>,
}

/// What a set of elements leaves open.
struct State {
    elements: usize,
    /// Covariance of every press: xx, xy, yy, xf, yf, ff.
    covariance: [Vec<f32>; 6],
    /// Squared distance between the readings of a press and of those before it, press by press.
    unlike: Vec<f32>,
}

impl Problem {
    fn new(field: &Field, settings: &BoundSettings) -> Self {
        let spreads = field.spreads();
        // What hardly varies more than its noise tells little apart.
        let unit = |j: usize| field.noise[j].hypot(spreads[j].1);
        let presses = field.presses();
        let column = |matrix: &nalgebra::DMatrix<f64>, j: usize, unit: f64| -> Vec<f32> {
            matrix.column(j).iter().map(|v| (v / unit) as f32).collect()
        };
        let candidates = field.candidates();
        let slopes =
            (0..candidates).map(|j| [0, 1, 2].map(|k| column(&field.slopes[k], j, field.noise[j]))).collect();
        let readings = (0..candidates).map(|j| column(&field.readings, j, unit(j))).collect();
        let sum: nalgebra::Vector3<f64> = field.locations.iter().map(|p| p.point.coords).sum();
        let middle = sum / field.locations.len().max(1) as f64;
        let from_middle = |p: usize| field.location_of(p).point.coords - middle;
        let locations = Mat::from_fn(presses, 3, |p, k| from_middle(p)[k] as f32);
        // Anywhere on the skin, in either direction alike.
        let squares: f64 = (0..presses).map(|p| from_middle(p).norm_squared()).sum();
        let place = squares / presses.max(1) as f64 / 2.0;
        let low = field.forces.iter().copied().fold(f64::INFINITY, f64::min);
        let high = field.forces.iter().copied().fold(0.0, f64::max);
        // Any force of the range; known where there is but one.
        let force = (high - low).max(0.0).powi(2) / 12.0;
        let prior = Matrix3::from_diagonal(&nalgebra::Vector3::new(place, place, force));
        let process = settings.between.then_some((settings.gamma as f32, settings.ridge as f32));
        Self { presses, forces: field.forces.len().max(1), slopes, readings, locations, prior, process }
    }

    fn start(&self) -> State {
        let p = &self.prior;
        let each = [p[(0, 0)], 0.0, p[(1, 1)], 0.0, 0.0, p[(2, 2)]];
        let pairs =
            if self.process.is_some() { self.presses * self.presses.saturating_sub(1) / 2 } else { 0 };
        State {
            elements: 0,
            covariance: each.map(|v| vec![v as f32; self.presses]),
            unlike: vec![0.0; pairs],
        }
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
        if self.process.is_some() {
            let read = &self.readings[element];
            let mut unlike = state.unlike.as_mut_slice();
            for (m, own) in read.iter().enumerate() {
                let (row, rest) = unlike.split_at_mut(m);
                row.iter_mut().zip(read).for_each(|(d, r)| *d += (own - r) * (own - r));
                unlike = rest;
            }
        }
        state.elements += 1;
    }

    /// \[m\] expected error, on average over the presses, once `element` is added. The root is taken press by press, so that
    /// single bad locations do not decide.
    fn score(&self, state: &State, element: usize) -> f64 {
        let [xx, _, yy, ..] = &state.covariance;
        let left = match self.process {
            Some(process) => self.left_out(state, element, process),
            None => vec![0.0; self.presses],
        };
        let mut sum = 0.0;
        for (m, left) in left.into_iter().enumerate() {
            let ([x, y, _], s) = self.gain(state, element, m);
            let local = (xx[m] + yy[m] - (x * x + y * y) / s).max(0.0);
            sum += f64::from(local + left).sqrt();
        }
        sum / self.presses.max(1) as f64
    }

    /// \[m²\] how far off every press is foretold from the others by the mean of a process: with K the covariance of the readings
    /// and b the presses at one place, K⁻¹[b, b]⁻¹ (K⁻¹ Y)[b], Y the locations from their middle.
    fn left_out(&self, state: &State, element: usize, (gamma, ridge): (f32, f32)) -> Vec<f32> {
        let n = self.presses;
        let read = &self.readings[element];
        let by = -gamma / (state.elements + 1) as f32;
        let mut covariance = Mat::<f32>::zeros(n, n);
        let mut unlike = state.unlike.as_slice();
        for (i, own) in read.iter().enumerate() {
            let (row, rest) = unlike.split_at(i);
            // Only the lower half is used.
            for (j, (d, other)) in row.iter().zip(read).enumerate() {
                covariance[(i, j)] = (by * (d + (own - other) * (own - other))).exp();
            }
            covariance[(i, i)] = 1.0 + ridge;
            unlike = rest;
        }
        // The ridge keeps it positive definite; were it not, this element would tell nothing.
        let Ok(factor) = covariance.llt(Side::Lower) else {
            return (0..n).map(|m| (0..3).map(|k| self.locations[(m, k)].powi(2)).sum()).collect();
        };
        // K⁻¹ = (L⁻¹)ᵀ L⁻¹, of which a few products are needed.
        let mut root = covariance;
        root.fill(0.0);
        invert_lower_triangular(root.as_mut(), factor.L(), Par::Seq);
        let solved = root.transpose() * (&root * &self.locations);
        let mut out = vec![0.0f32; n];
        let count = self.forces;
        for begin in (0..n).step_by(count) {
            let dot = |i: usize, j: usize| -> f32 {
                let (a, b) = (root.col(begin + i), root.col(begin + j));
                let from = begin + i.max(j);
                a.iter().zip(b.iter()).skip(from).map(|(a, b)| a * b).sum()
            };
            let block = nalgebra::DMatrix::from_fn(count, count, dot);
            let Some(block) = block.try_inverse() else { continue };
            for k in 0..3 {
                let weights = nalgebra::DVector::from_fn(count, |i, _| solved[(begin + i, k)]);
                for (out, error) in out[begin..].iter_mut().zip((&block * weights).iter()) {
                    *out += error * error;
                }
            }
        }
        out
    }
}

/// As many of the locations, evenly.
fn thinned(field: &Field, most: usize) -> Field {
    let (all, most) = (field.locations.len(), most.clamp(1, field.locations.len().max(1)));
    field.at(&(0..most).map(|n| n * all / most).collect::<Vec<_>>())
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
    let coarse = Problem::new(&thinned(field, settings.coarse), settings);
    let fine = Problem::new(&thinned(field, settings.fine), settings);
    let (mut roughly, mut closely) = (coarse.start(), fine.start());
    let budget = budget.min(among.len());
    let mut order: Vec<usize> = Vec::new();
    for k in 0..budget {
        let open: Vec<usize> = among.iter().copied().filter(|c| !order.contains(c)).collect();
        let best = settings.closely.clamp(1, open.len());
        let steps = (open.len() + best) as f64;
        let at = |done: usize| watch((k as f64 + done as f64 / steps) / budget as f64);
        let mut scored = Vec::with_capacity(open.len());
        for (n, candidate) in open.iter().enumerate() {
            if !at(n) {
                return None;
            }
            scored.push((coarse.score(&roughly, *candidate), *candidate));
        }
        scored.sort_by(|a, b| a.0.total_cmp(&b.0));
        scored.truncate(best);
        for (n, (score, candidate)) in scored.iter_mut().enumerate() {
            if !at(open.len() + n) {
                return None;
            }
            *score = fine.score(&closely, *candidate);
        }
        let (_, next) = scored.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
        coarse.add(&mut roughly, next);
        fine.add(&mut closely, next);
        order.push(next);
    }
    Some(Sets::nested(&order))
}

/// \[m\] what [`by_bound`] makes least, of any elements; the spread of the locations where there are none.
#[must_use]
pub fn expected_error(field: &Field, elements: &[usize], settings: &BoundSettings) -> f64 {
    let problem = Problem::new(field, settings);
    match elements.split_last() {
        Some((last, before)) => {
            let mut state = problem.start();
            before.iter().for_each(|e| problem.add(&mut state, *e));
            problem.score(&state, *last)
        }
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
        BoundSettings { between: false, ..BoundSettings::default() }
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
        let settings = BoundSettings::default();
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
    fn locations_that_read_alike_are_distinguished() {
        // Two elements that mirror each other cannot tell which side is pressed; the local bound does not mind.
        let field = plate(9, 9);
        let local = purely_local();
        let all = BoundSettings { between: true, ..local };
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
