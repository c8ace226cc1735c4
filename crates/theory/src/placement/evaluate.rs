//! One estimator for all methods: how far off it is with the elements of each (thesis Fig. 2.5).

use dermis_regress::{RegressError, Rows, Svr, SvrSettings, folds, shuffled};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::greedy::noisy;
use super::{Field, Sets, Watch};
use crate::TheoryError;

/// Settings of the evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationSettings {
    /// What the estimator may be: that of the least cross-validated error among what teaches is taken.
    pub estimators: Vec<SvrSettings>,
    /// Parts of that cross-validation.
    pub folds: usize,
    /// Presses that it uses at most.
    pub chosen_on: usize,
    /// Each draws its own noise and its own `taught` share of the locations.
    pub seeds: Vec<u64>,
    /// Share of the locations that teach, of those that may.
    pub taught: f64,
    /// Failed elements, at most.
    pub failures: usize,
    /// Draws of failed elements, for each seed and number.
    pub draws: usize,
}

/// What a support vector regression of locations may be, from smooth to close.
pub(super) fn estimators() -> Vec<SvrSettings> {
    let pairs = [1.0, 3.0, 10.0].into_iter().flat_map(|gamma| [10.0, 100.0].map(|c| (gamma, c)));
    pairs.map(|(gamma, c)| SvrSettings { gamma, c, ..SvrSettings::default() }).collect()
}

impl Default for EvaluationSettings {
    fn default() -> Self {
        Self {
            estimators: estimators(),
            folds: 4,
            chosen_on: 1000,
            seeds: (1..=5).collect(),
            taught: 0.8,
            failures: 5,
            draws: 6,
        }
    }
}

/// Error with so many elements.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ByCount {
    /// Elements.
    pub elements: usize,
    /// \[m\] mean over the locations that were held out, seed by seed.
    pub errors: Vec<f64>,
    /// \[m\] mean of the above.
    pub mean: f64,
    /// \[m\] half of its 95 % interval over the seeds.
    pub interval: f64,
    /// \[m\] Cramér–Rao bound of the position, its mean over the same presses: what the noise alone leaves. `None` where it is
    /// unbounded somewhere.
    pub bound: Option<f64>,
    /// The estimator that was taken.
    pub estimator: SvrSettings,
}

/// Error once elements of the largest set fail.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ByFailures {
    /// Elements that failed.
    pub failed: usize,
    /// \[m\] mean error of an estimator that was taught without them, seed by seed.
    pub errors: Vec<f64>,
    /// \[m\] mean of the above.
    pub mean: f64,
    /// \[m\] half of its 95 % interval over the seeds.
    pub interval: f64,
    /// \[m\] mean error of the estimator that was taught with them, and now gets their mean in place of what they read.
    pub untaught: f64,
}

/// What a method's elements are worth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// By number of elements.
    pub by_count: Vec<ByCount>,
    /// By number of failed ones, from 0.
    pub by_failures: Vec<ByFailures>,
}

/// 97.5 % quantile of Student's distribution with 1 to 9 degrees of freedom.
const STUDENT: [f64; 9] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262];

fn summary(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count.max(1.0);
    if values.len() < 2 {
        return (mean, 0.0);
    }
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let quantile = STUDENT.get(values.len() - 2).copied().unwrap_or(1.96);
    (mean, quantile * (variance / count).sqrt())
}

/// Presses of one seed: readings with noise, and the locations.
struct Draw {
    teach: DMatrix<f64>,
    teach_locations: Vec<f64>,
    groups: Vec<usize>,
    ask: DMatrix<f64>,
    ask_locations: Vec<[f64; 3]>,
}

impl Draw {
    fn new(teach: &Field, ask: &Field, seed: u64, share: f64) -> Self {
        let count = ((teach.locations.len() as f64 * share).round() as usize).clamp(1, teach.locations.len());
        let mut locations = shuffled(teach.locations.len(), seed);
        // In random order: the first ones stand for all.
        locations.truncate(count);
        let taught = teach.at(&locations);
        let point = |field: &Field, p: usize| -> [f64; 3] { field.location_of(p).point.coords.into() };
        Self {
            teach: noisy(&taught, seed.wrapping_mul(2)),
            teach_locations: (0..taught.presses()).flat_map(|p| point(&taught, p)).collect(),
            groups: (0..taught.presses()).map(|p| p / taught.forces.len()).collect(),
            ask: noisy(ask, seed.wrapping_mul(2).wrapping_add(1)),
            ask_locations: (0..ask.presses()).map(|p| point(ask, p)).collect(),
        }
    }

    /// Readings of some elements, row by row.
    fn rows(from: &DMatrix<f64>, elements: &[usize]) -> Vec<f64> {
        from.row_iter().flat_map(|row| elements.iter().map(|e| row[*e]).collect::<Vec<_>>()).collect()
    }

    fn fit(&self, elements: &[usize], settings: &SvrSettings) -> Result<Svr, RegressError> {
        let inputs = Self::rows(&self.teach, elements);
        Svr::fit(
            Rows::new(&inputs, elements.len(), "the readings")?,
            Rows::new(&self.teach_locations, 3, "the locations")?,
            settings,
        )
    }

    /// \[m\] mean error on what nobody was taught. The mean of those that `failed` (positions in `elements`) replaces what they
    /// read.
    fn error(&self, svr: &Svr, elements: &[usize], failed: &[usize]) -> Result<f64, RegressError> {
        let rows = Self::rows(&self.ask, elements);
        let mut sum = 0.0;
        let mut read = Vec::new();
        for (row, location) in rows.chunks_exact(elements.len()).zip(&self.ask_locations) {
            read.clear();
            read.extend_from_slice(row);
            failed.iter().for_each(|f| read[*f] = svr.means()[*f]);
            sum += off(&svr.predict(&read)?, location);
        }
        Ok(sum / self.ask_locations.len().max(1) as f64)
    }

    /// The estimator of the least error among what teaches.
    fn choose(&self, elements: &[usize], settings: &EvaluationSettings) -> Result<SvrSettings, RegressError> {
        let fold = folds(&self.groups, settings.folds.max(2), 7);
        let inputs = Self::rows(&self.teach, elements);
        let (width, rows) = (elements.len(), self.groups.len().min(settings.chosen_on));
        let pick = |from: &[f64], width: usize, keep: &dyn Fn(usize) -> bool| -> Vec<f64> {
            (0..rows).filter(|r| keep(*r)).flat_map(|r| from[r * width..(r + 1) * width].to_vec()).collect()
        };
        let mut best: Option<(f64, SvrSettings)> = None;
        for estimator in &settings.estimators {
            let mut sum = 0.0;
            for k in 0..settings.folds.max(2) {
                let (x, y) = (
                    pick(&inputs, width, &|r| fold[r] != k),
                    pick(&self.teach_locations, 3, &|r| fold[r] != k),
                );
                let svr = Svr::fit(
                    Rows::new(&x, width, "the readings")?,
                    Rows::new(&y, 3, "the locations")?,
                    estimator,
                )?;
                for r in (0..rows).filter(|r| fold[*r] == k) {
                    let location = &self.teach_locations[r * 3..(r + 1) * 3];
                    sum += off(&svr.predict(&inputs[r * width..(r + 1) * width])?, location);
                }
            }
            if best.is_none_or(|(least, _)| sum < least) {
                best = Some((sum, *estimator));
            }
        }
        Ok(best.map_or_else(SvrSettings::default, |(_, s)| s))
    }
}

fn off(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(p, q)| (p - q).powi(2)).sum::<f64>().sqrt()
}

/// \[m\] mean over all presses of the bound of the position with some elements; `None` where they leave one open.
fn bound(field: &Field, elements: &[usize]) -> Option<f64> {
    let known = field.forces.len() < 2;
    let mut sum = 0.0;
    for p in 0..field.presses() {
        let mut information = nalgebra::Matrix3::<f64>::zeros();
        for e in elements {
            let g = nalgebra::Vector3::from_fn(|k, _| field.slopes[k][(p, *e)] / field.noise[*e]);
            information += g * g.transpose();
        }
        if known {
            // The estimator learns the one force, too.
            for k in 0..3 {
                (information[(2, k)], information[(k, 2)]) = (0.0, 0.0);
            }
            information[(2, 2)] = information[(0, 0)].max(f64::MIN_POSITIVE);
        }
        // In mm, so that rows and columns are alike.
        let scale = nalgebra::Matrix3::from_diagonal(&nalgebra::Vector3::new(
            1e-3,
            1e-3,
            if known { 1e-3 } else { 1.0 },
        ));
        let inverse = (scale * information * scale).try_inverse()?;
        let variance = (inverse[(0, 0)] + inverse[(1, 1)]) * 1e-6;
        if !(variance.is_finite() && variance >= 0.0) {
            return None;
        }
        sum += variance.sqrt();
    }
    Some(sum / field.presses().max(1) as f64)
}

/// Elements that fail, drawn alike for all methods: positions in a set of `count`.
fn failing(count: usize, failed: usize, draw: usize, seed: u64) -> Vec<usize> {
    let mut order = shuffled(count, seed.wrapping_mul(1000).wrapping_add(draw as u64));
    order.truncate(failed);
    order.sort_unstable();
    order
}

/// Trains the estimator on the presses of `teach` and evaluates it on those of `ask`, which are at other locations. `None` where `watch`
/// stopped it.
///
/// # Errors
///
/// [`TheoryError::Regress`] where readings are not finite.
pub fn evaluate(
    teach: &Field,
    ask: &Field,
    sets: &Sets,
    settings: &EvaluationSettings,
    watch: Watch<'_>,
) -> Result<Option<Evaluation>, TheoryError> {
    let draws: Vec<Draw> =
        settings.seeds.iter().map(|s| Draw::new(teach, ask, *s, settings.taught)).collect();
    let Some(first) = draws.first() else {
        return Ok(Some(Evaluation { by_count: Vec::new(), by_failures: Vec::new() }));
    };
    let largest = sets.last();
    let failures = settings.failures.min(largest.len().saturating_sub(1));
    let total = (sets.0.len() + failures).max(1) as f64;
    let mut by_count = Vec::new();
    for (n, elements) in sets.0.iter().enumerate() {
        if !watch(n as f64 / total) {
            return Ok(None);
        }
        let estimator = first.choose(elements, settings)?;
        let mut errors = Vec::new();
        for draw in &draws {
            errors.push(draw.error(&draw.fit(elements, &estimator)?, elements, &[])?);
        }
        let (mean, interval) = summary(&errors);
        let bound = bound(ask, elements);
        by_count.push(ByCount { elements: elements.len(), errors, mean, interval, bound, estimator });
    }
    let mut by_failures = Vec::new();
    if let Some(whole) = by_count.last() {
        let none = ByFailures {
            failed: 0,
            errors: whole.errors.clone(),
            mean: whole.mean,
            interval: whole.interval,
            untaught: whole.mean,
        };
        let estimator = whole.estimator;
        by_failures.push(none);
        let taught = draws.iter().map(|d| d.fit(largest, &estimator)).collect::<Result<Vec<_>, _>>()?;
        for failed in 1..=failures {
            if !watch((sets.0.len() + failed - 1) as f64 / total) {
                return Ok(None);
            }
            let mut errors = Vec::new();
            let mut untaught = 0.0;
            for ((draw, whole), seed) in draws.iter().zip(&taught).zip(&settings.seeds) {
                let mut sum = 0.0;
                for n in 0..settings.draws {
                    let gone = failing(largest.len(), failed, n, *seed);
                    let left: Vec<usize> =
                        (0..largest.len()).filter(|i| !gone.contains(i)).map(|i| largest[i]).collect();
                    sum += draw.error(&draw.fit(&left, &estimator)?, &left, &[])?;
                    untaught += draw.error(whole, largest, &gone)?;
                }
                errors.push(sum / settings.draws.max(1) as f64);
            }
            untaught /= (settings.draws * draws.len()).max(1) as f64;
            let (mean, interval) = summary(&errors);
            by_failures.push(ByFailures { failed, errors, mean, interval, untaught });
        }
    }
    Ok(Some(Evaluation { by_count, by_failures }))
}

#[cfg(test)]
mod tests {
    use super::super::testing::plate;
    use super::*;

    fn halves(field: &Field) -> (Field, Field) {
        let even = |odd: usize| (0..field.locations.len()).filter(|p| p % 3 / 2 == odd).collect::<Vec<_>>();
        (field.at(&even(0)), field.at(&even(1)))
    }

    #[test]
    fn more_elements_locate_better_and_failures_cost() {
        let (teach, ask) = halves(&plate(9, 5));
        let sets = Sets::nested(&[22, 2, 42, 20, 24, 38, 6]);
        let settings = EvaluationSettings {
            seeds: vec![1, 2, 3],
            draws: 4,
            failures: 9,
            ..EvaluationSettings::default()
        };
        let found = evaluate(&teach, &ask, &sets, &settings, &|_| true).unwrap().unwrap();
        let means: Vec<f64> = found.by_count.iter().map(|c| c.mean).collect();
        assert!(means[6] < 0.5 * means[1] && means[6] < 0.015, "{means:?}");
        // One element cannot bound two directions.
        assert_eq!(found.by_count[0].bound, None);
        assert!(found.by_count[6].bound.unwrap() < found.by_count[6].mean);
        let failed = &found.by_failures;
        assert_eq!(failed.iter().map(|f| f.failed).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(failed[0].mean, found.by_count[6].mean);
        assert!(failed[6].mean > 2.0 * failed[0].mean && failed[3].untaught > failed[3].mean);
        assert!(found.by_count.iter().all(|c| c.errors.len() == 3 && c.interval >= 0.0));
    }

    #[test]
    fn failed_elements_are_drawn_alike_and_without_repetition() {
        for failed in 1..=5 {
            let gone = failing(10, failed, 3, 7);
            assert_eq!(gone, failing(10, failed, 3, 7));
            assert_eq!(gone.len(), failed);
            assert!(gone.windows(2).all(|w| w[0] < w[1]) && gone.iter().all(|g| *g < 10));
        }
        assert_ne!(failing(10, 5, 3, 7), failing(10, 5, 4, 7));
    }

    #[test]
    fn intervals_are_students() {
        let (mean, interval) = summary(&[1.0, 2.0, 3.0]);
        assert_eq!(mean, 2.0);
        approx::assert_relative_eq!(interval, 4.303 / 3f64.sqrt(), max_relative = 1e-9);
        assert_eq!(summary(&[5.0]), (5.0, 0.0));
    }
}
