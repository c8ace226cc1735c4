//! Greedy choice by the cross-validated error of a support vector regression (thesis Alg. 1).

use std::sync::atomic::{AtomicUsize, Ordering};

use dermis_regress::{SvrSettings, folds, gram, solve};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use super::{Field, Sets, Watch};

/// Settings of the search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GreedySettings {
    /// Of every regression.
    pub svr: SvrSettings,
    /// Parts of the cross-validation.
    pub folds: usize,
    /// Draws noise and folds.
    pub seed: u64,
    /// Candidates that are tried at the same time.
    pub threads: usize,
}

impl Default for GreedySettings {
    fn default() -> Self {
        Self { svr: SvrSettings::default(), folds: 5, seed: 1, threads: 1 }
    }
}

/// Readings with noise of one draw, presses × candidates.
pub(super) fn noisy(field: &Field, seed: u64) -> nalgebra::DMatrix<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut out = field.readings.clone();
    for (mut column, noise) in out.column_iter_mut().zip(&field.noise) {
        for value in column.iter_mut() {
            let drawn: f64 = StandardNormal.sample(&mut random);
            *value += noise * drawn;
        }
    }
    out
}

/// One fold: training rows, validation rows.
struct Fold {
    taught: Vec<usize>,
    validated: Vec<usize>,
}

struct Search {
    /// Standardised readings with noise, candidate by candidate.
    columns: Vec<Vec<f64>>,
    /// Coordinates of the locations in units of their largest spread, and that spread \[m\].
    targets: Vec<Vec<f64>>,
    scale: f64,
    folds: Vec<Fold>,
    svr: SvrSettings,
}

impl Search {
    fn new(field: &Field, settings: &GreedySettings) -> Self {
        let readings = noisy(field, settings.seed);
        let columns = readings
            .column_iter()
            .map(|column| {
                let mean = column.mean();
                let spread = column.variance().sqrt();
                let by = if spread > 0.0 { 1.0 / spread } else { 0.0 };
                column.iter().map(|v| (v - mean) * by).collect()
            })
            .collect();
        let presses = field.presses();
        let coordinates: Vec<Vec<f64>> = (0..3)
            .map(|k| (0..presses).map(|p| field.location_of(p).point[k]).collect::<Vec<f64>>())
            .collect();
        let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
        let spread = |of: &[f64]| {
            let middle = mean(of);
            (of.iter().map(|v| (v - middle).powi(2)).sum::<f64>() / of.len().max(1) as f64).sqrt()
        };
        let scale = coordinates.iter().map(|c| spread(c)).fold(f64::MIN_POSITIVE, f64::max);
        // A coordinate that does not vary needs no regression.
        let targets = coordinates
            .iter()
            .filter(|c| spread(c) > 1e-6 * scale)
            .map(|c| {
                let middle = mean(c);
                c.iter().map(|v| (v - middle) / scale).collect()
            })
            .collect();
        let groups: Vec<usize> = (0..presses).map(|p| p / field.forces.len()).collect();
        let count = settings.folds.clamp(2, field.locations.len().max(2));
        let fold = folds(&groups, count, settings.seed);
        let folds = (0..count)
            .map(|k| Fold {
                taught: (0..presses).filter(|p| fold[*p] != k).collect(),
                validated: (0..presses).filter(|p| fold[*p] == k).collect(),
            })
            .collect();
        Self { columns, targets, scale, folds, svr: settings.svr }
    }

    /// \[m\] mean error of the cross-validation with these squared distances between presses, which are those of `count` elements.
    fn error(&self, distances: &[f64], count: usize) -> f64 {
        let n = self.columns.first().map_or(0, Vec::len);
        let kernel = gram(distances, self.svr.gamma / count as f64);
        let (mut sum, mut validated) = (0.0, 0);
        let mut part = Vec::new();
        let mut column = Vec::new();
        for fold in &self.folds {
            part.clear();
            for i in &fold.taught {
                let row = &kernel[i * n..(i + 1) * n];
                part.extend(fold.taught.iter().map(|j| row[*j]));
            }
            let mut squares = vec![0.0; fold.validated.len()];
            for target in &self.targets {
                column.clear();
                column.extend(fold.taught.iter().map(|i| target[*i]));
                let dual = solve(&part, &column, &self.svr);
                for (square, p) in squares.iter_mut().zip(&fold.validated) {
                    let row = &kernel[p * n..(p + 1) * n];
                    let answer: f64 = fold.taught.iter().zip(&dual.weights).map(|(i, w)| row[*i] * w).sum();
                    *square += (answer + dual.bias - target[*p]).powi(2);
                }
            }
            sum += squares.iter().map(|s| s.sqrt()).sum::<f64>();
            validated += squares.len();
        }
        sum / validated.max(1) as f64 * self.scale
    }

    fn with(&self, base: &[f64], candidate: usize, out: &mut Vec<f64>) {
        let column = &self.columns[candidate];
        out.clear();
        out.reserve(base.len());
        for (row, own) in base.chunks_exact(column.len()).zip(column) {
            out.extend(row.iter().zip(column).map(|(d, v)| d + (own - v) * (own - v)));
        }
    }
}

/// Elements one after the other, each the one that reduces the cross-validated error of the place most, and that error \[m\]
/// after each. Where `watch` stops it, those that were found so far.
#[must_use]
pub fn greedy_svr(
    field: &Field,
    among: &[usize],
    budget: usize,
    settings: &GreedySettings,
    watch: Watch<'_>,
) -> (Sets, Vec<f64>) {
    let search = Search::new(field, settings);
    let n = field.presses();
    let mut base = vec![0.0; n * n];
    let (mut order, mut errors) = (Vec::<usize>::new(), Vec::new());
    let budget = budget.min(among.len());
    let total = (0..budget).map(|k| among.len() - k).sum::<usize>().max(1) as f64;
    let done = AtomicUsize::new(0);
    while order.len() < budget {
        let open: Vec<usize> = among.iter().copied().filter(|c| !order.contains(c)).collect();
        let next = AtomicUsize::new(0);
        let stopped = std::sync::atomic::AtomicBool::new(false);
        let work = || {
            let mut found: Option<(f64, usize)> = None;
            let mut distances = Vec::new();
            loop {
                let at = next.fetch_add(1, Ordering::Relaxed);
                let Some(&candidate) = open.get(at) else { return found };
                if stopped.load(Ordering::Relaxed)
                    || !watch(done.fetch_add(1, Ordering::Relaxed) as f64 / total)
                {
                    stopped.store(true, Ordering::Relaxed);
                    return found;
                }
                search.with(&base, candidate, &mut distances);
                let error = search.error(&distances, order.len() + 1);
                // Of equal ones the first, however the threads take turns.
                if found.is_none_or(|known| (error, candidate) < known) {
                    found = Some((error, candidate));
                }
            }
        };
        let found: Vec<Option<(f64, usize)>> = if settings.threads > 1 {
            std::thread::scope(|scope| {
                let handles: Vec<_> = (0..settings.threads).map(|_| scope.spawn(work)).collect();
                handles.into_iter().map(|h| h.join().ok().flatten()).collect()
            })
        } else {
            vec![work()]
        };
        if stopped.load(Ordering::Relaxed) {
            break;
        }
        let best = found.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some((error, candidate)) = best else { break };
        let mut grown = Vec::new();
        search.with(&base, candidate, &mut grown);
        base = grown;
        order.push(candidate);
        errors.push(error);
    }
    (Sets::nested(&order), errors)
}

#[cfg(test)]
mod tests {
    use super::super::testing::plate;
    use super::*;

    #[test]
    fn it_takes_the_best_each_time_whatever_the_threads() {
        let field = plate(5, 3).at(&(0..120).step_by(2).collect::<Vec<_>>());
        let among: Vec<usize> = (0..15).collect();
        let settings = GreedySettings { folds: 3, ..GreedySettings::default() };
        let (sets, errors) = greedy_svr(&field, &among, 3, &settings, &|_| true);
        assert_eq!(sets.0.len(), 3);
        assert!(errors[2] < errors[1] && errors[1] < errors[0], "{errors:?}");
        let search = Search::new(&field, &settings);
        let n = field.presses();
        let mut out = Vec::new();
        for candidate in among.iter().copied() {
            search.with(&vec![0.0; n * n], candidate, &mut out);
            assert!(search.error(&out, 1) >= errors[0] - 1e-12);
        }
        let two = GreedySettings { threads: 2, ..settings };
        assert_eq!(greedy_svr(&field, &among, 3, &two, &|_| true), (sets, errors));
    }

    #[test]
    fn what_was_found_is_kept_where_it_is_stopped() {
        let field = plate(5, 3).at(&(0..60).collect::<Vec<_>>());
        let among: Vec<usize> = (0..15).collect();
        // 15 + 14 + 13 candidates are tried.
        let (sets, errors) = greedy_svr(&field, &among, 3, &GreedySettings::default(), &|s| s < 0.5);
        assert_eq!((sets.0.len(), errors.len()), (1, 1));
    }
}
