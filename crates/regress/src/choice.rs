//! Regressions by name, and their settings chosen by cross-validation.
//!
//! Problem: a comparison is fair where every regression has the settings that suit the data, chosen without what it is judged on. Method:
//! k-fold cross-validation over groups, e.g. locations, so that rows of one place are never on both sides (S. Arlot, A. Celisse, *A survey
//! of cross-validation procedures*, Statistics Surveys 4, 2010); the error is the mean length of the difference of all outputs. Cost:
//! folds × settings fits of at most [`Tuning::most`] rows.

use serde::{Deserialize, Serialize};

use crate::rows::stride;
use crate::{
    GaussianSettings, Kernel, KernelExpansion, Neighbours, RegressError, Rows, Svr, SvrSettings,
    TreeSettings, Trees, folds, gaussian_process,
};

/// A kind of regression.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Mean of the nearest rows.
    Neighbours,
    /// ε-support vectors.
    Vectors,
    /// Extremely randomised trees.
    Trees,
    /// Gaussian process.
    Gaussian,
}

/// A kind of regression with its settings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Settings {
    /// How many neighbours answer.
    Neighbours(usize),
    /// Of support vectors.
    Vectors(SvrSettings),
    /// Of trees.
    Trees(TreeSettings),
    /// Of a Gaussian process.
    Gaussian(GaussianSettings),
}

/// A fitted regression.
#[derive(Debug, Clone)]
pub enum Fitted {
    /// Mean of the nearest rows.
    Neighbours(Neighbours),
    /// Support vectors and Gaussian processes.
    Kernels(KernelExpansion),
    /// Trees.
    Trees(Trees),
}

/// How settings are chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tuning {
    /// Folds.
    pub folds: usize,
    /// Rows that are tried with at most; of more, every n-th is taken.
    pub most: usize,
    /// What folds are drawn by.
    pub seed: u64,
}

impl Default for Tuning {
    fn default() -> Self {
        Self { folds: 3, most: 900, seed: 1 }
    }
}

impl Method {
    /// Every kind.
    pub const ALL: [Self; 4] = [Self::Neighbours, Self::Vectors, Self::Trees, Self::Gaussian];

    /// For people.
    #[must_use]
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Neighbours => "nearest neighbours",
            Self::Vectors => "support vectors",
            Self::Trees => "extra trees",
            Self::Gaussian => "Gaussian process",
        }
    }

    /// Settings that are tried.
    #[must_use]
    pub fn grid(self) -> Vec<Settings> {
        let gammas = [0.03, 0.1, 0.3, 1.0, 3.0];
        match self {
            Self::Neighbours => [1, 2, 3, 4, 6, 9, 13, 19].map(Settings::Neighbours).to_vec(),
            Self::Vectors => {
                let of = |gamma, c, epsilon| SvrSettings { c, epsilon, gamma, ..SvrSettings::default() };
                let gammas = gammas.into_iter().flat_map(|g| [3.0, 30.0, 300.0].map(|c| (g, c)));
                let all = gammas.flat_map(|(g, c)| [1e-3, 1e-2].map(|e| Settings::Vectors(of(g, c, e))));
                all.collect()
            }
            Self::Trees => {
                let of = |leaf, share| TreeSettings { leaf, share, ..TreeSettings::default() };
                let leaves = [1, 2, 4].into_iter();
                leaves.flat_map(|l| [0.35, 1.0].map(|share| Settings::Trees(of(l, share)))).collect()
            }
            Self::Gaussian => {
                let kernels = [Kernel::Gaussian, Kernel::Matern].into_iter();
                let kernels = kernels.flat_map(|k| [0.01, 0.03, 0.1, 0.3, 1.0].map(|g| (k, g)));
                let of = |kernel, gamma, noise| GaussianSettings { kernel, gamma, noise, supports: None };
                let all = kernels
                    .flat_map(|(k, g)| [1e-5, 1e-4, 1e-3, 1e-2].map(|n| Settings::Gaussian(of(k, g, n))));
                all.collect()
            }
        }
    }

    /// The settings of the least error on groups that were not learned from, and that error. `groups` names the group of each row. Where
    /// there is one group only, the first settings.
    ///
    /// # Errors
    ///
    /// [`RegressError`] where the tables do not have equally many rows.
    pub fn tuned(
        self,
        inputs: Rows<'_>,
        targets: Rows<'_>,
        groups: &[usize],
        tuning: &Tuning,
    ) -> Result<(Settings, f64), RegressError> {
        Self::tuned_among(self.grid(), inputs, targets, groups, tuning)
    }

    /// The same among given settings.
    ///
    /// # Errors
    ///
    /// As [`tuned`](Self::tuned), and where there are no settings.
    pub fn tuned_among(
        among: impl IntoIterator<Item = Settings>,
        inputs: Rows<'_>,
        targets: Rows<'_>,
        groups: &[usize],
        tuning: &Tuning,
    ) -> Result<(Settings, f64), RegressError> {
        let mut best: Option<(Settings, f64)> = None;
        for settings in among {
            // A noise that is too small for these rows is no candidate.
            let Ok(error) = settings.validated(inputs, targets, groups, tuning) else { continue };
            if best.is_none_or(|(_, least)| error < least) {
                best = Some((settings, error));
            }
        }
        best.ok_or(RegressError::Empty)
    }
}

impl Settings {
    /// The same, with answers of a Gaussian process that are a sum over `most` rows at most.
    #[must_use]
    pub fn with_supports(self, most: usize) -> Self {
        match self {
            Self::Gaussian(settings) => Self::Gaussian(GaussianSettings { supports: Some(most), ..settings }),
            other => other,
        }
    }

    /// Fits every column of `targets`.
    ///
    /// # Errors
    ///
    /// [`RegressError`] where the tables do not have equally many rows, or a setting is out of its range.
    pub fn fit(&self, inputs: Rows<'_>, targets: Rows<'_>) -> Result<Fitted, RegressError> {
        Ok(match self {
            Self::Neighbours(count) => Fitted::Neighbours(Neighbours::fit(inputs, targets, *count)?),
            Self::Vectors(s) => Fitted::Kernels(Svr::fit(inputs, targets, s)?.into_expansion()),
            Self::Trees(s) => Fitted::Trees(Trees::fit(inputs, targets, s)?),
            Self::Gaussian(s) => Fitted::Kernels(gaussian_process(inputs, targets, s)?),
        })
    }

    /// Mean length of the difference of all outputs on groups that were not learned from; NaN where there is one group only.
    ///
    /// # Errors
    ///
    /// As [`fit`](Self::fit).
    pub fn validated(
        &self,
        inputs: Rows<'_>,
        targets: Rows<'_>,
        groups: &[usize],
        tuning: &Tuning,
    ) -> Result<f64, RegressError> {
        if targets.count() != inputs.count() || groups.len() != inputs.count() {
            return Err(RegressError::Size {
                what: "the table of targets",
                found: targets.count().min(groups.len()),
                expected: inputs.count(),
            });
        }
        let step = stride(inputs.count(), tuning.most);
        let some: Vec<usize> = (0..inputs.count()).step_by(step).collect();
        let of: Vec<usize> = some.iter().map(|i| groups[*i]).collect();
        let fold = folds(&of, tuning.folds, tuning.seed);
        let (mut sum, mut count) = (0.0, 0_usize);
        for held_out in 0..tuning.folds {
            let (learn, validation): (Vec<usize>, Vec<usize>) =
                (0..some.len()).partition(|i| fold[*i] != held_out);
            if learn.is_empty() || validation.is_empty() {
                continue;
            }
            let rows = |table: Rows<'_>| -> Vec<f64> {
                learn.iter().flat_map(|i| table.row(some[*i])).copied().collect()
            };
            let (x, t) = (rows(inputs), rows(targets));
            let fitted = self
                .fit(Rows::new(&x, inputs.width(), "inputs")?, Rows::new(&t, targets.width(), "targets")?)?;
            for i in validation {
                let answer = fitted.predict(inputs.row(some[i]))?;
                let squares = answer.iter().zip(targets.row(some[i])).map(|(a, b)| (a - b) * (a - b));
                sum += squares.sum::<f64>().sqrt();
                count += 1;
            }
        }
        Ok(if count > 0 { sum / count as f64 } else { f64::NAN })
    }
}

impl Fitted {
    /// The answer to one row, one number an output.
    ///
    /// # Errors
    ///
    /// [`RegressError::Size`] for a row of another width.
    pub fn predict(&self, row: &[f64]) -> Result<Vec<f64>, RegressError> {
        match self {
            Self::Neighbours(fitted) => fitted.predict(row),
            Self::Kernels(fitted) => fitted.predict(row),
            Self::Trees(fitted) => fitted.predict(row),
        }
    }

    /// What a graph needs to compute it; `None` for neighbours and trees, whose sorts and branches are no arithmetic.
    #[must_use]
    pub fn expansion(&self) -> Option<&KernelExpansion> {
        match self {
            Self::Kernels(fitted) => Some(fitted),
            Self::Neighbours(_) | Self::Trees(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_method_is_tuned_on_groups_of_its_own() {
        // Three rows a group, of a curve.
        let inputs: Vec<f64> = (0..90).map(|i| f64::from(i / 3) * 0.2 + f64::from(i % 3) * 1e-3).collect();
        let targets: Vec<f64> = inputs.iter().map(|x| x.sin()).collect();
        let groups: Vec<usize> = (0..90).map(|i| i / 3).collect();
        let (x, t) = (Rows::new(&inputs, 1, "inputs").unwrap(), Rows::new(&targets, 1, "targets").unwrap());
        for method in Method::ALL {
            let (settings, error) = method.tuned(x, t, &groups, &Tuning::default()).unwrap();
            for other in method.grid() {
                let theirs = other.validated(x, t, &groups, &Tuning::default()).unwrap_or(f64::INFINITY);
                assert!(error <= theirs, "{settings:?} {error} {other:?} {theirs}");
            }
            let answer = settings.fit(x, t).unwrap().predict(&[2.5]).unwrap()[0];
            // Held-out groups lie 0.2 from their neighbours, where the curve changes by at most 0.2.
            assert!(error < 0.2 && (answer - 2.5_f64.sin()).abs() < 0.2, "{method:?}: {error} {answer}");
            let json = serde_json::to_string(&settings).unwrap();
            assert_eq!(serde_json::from_str::<Settings>(&json).unwrap(), settings);
        }
    }

    #[test]
    fn rows_of_one_group_are_never_on_both_sides() {
        // The nearest neighbour of every row is its twin, which is of the same group: nothing is learned from it.
        let inputs: Vec<f64> = (0..40).map(|i| f64::from(i / 2)).collect();
        let targets: Vec<f64> = (0..40).map(|i| f64::from(i / 2 % 2)).collect();
        let groups: Vec<usize> = (0..40).map(|i| i / 2).collect();
        let (x, t) = (Rows::new(&inputs, 1, "inputs").unwrap(), Rows::new(&targets, 1, "targets").unwrap());
        let one = Settings::Neighbours(1);
        assert!(one.validated(x, t, &groups, &Tuning::default()).unwrap() > 0.4);
        let apart: Vec<usize> = (0..40).collect();
        assert!(one.validated(x, t, &apart, &Tuning { folds: 40, ..Tuning::default() }).unwrap() < 1e-6);
        assert!(one.validated(x, t, &[0; 40], &Tuning::default()).unwrap().is_nan());
    }
}
