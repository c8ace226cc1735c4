//! Which regressors may be the model.

use clap::ValueEnum;
use dermis_regress::Method;
use serde::{Deserialize, Serialize};

use super::config::TrainConfig;
use crate::LearnError;

/// Which regressors may be the model. Of several, each quantity (positions, forces, contact) is answered by the one that errs least
/// on it in cross-validation within the training part: between runs where there are several, else between locations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelChoice {
    /// Who is judged.
    pub candidates: Vec<Candidate>,
    /// Rows that support vectors learn from at most; of more, every n-th is taken. Their graph grows with it, and so does that of a
    /// Gaussian process, which learns from up to 10,000 rows by a sum over `most` of them (sparse, by subset of regressors).
    pub most: usize,
    /// Folds at most.
    pub folds: usize,
}

impl Default for ModelChoice {
    fn default() -> Self {
        Self { candidates: vec![Candidate::Network], most: 2000, folds: 5 }
    }
}

impl ModelChoice {
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// A regressor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Candidate {
    /// The network, or the mean of several (`network.members`).
    Network,
    /// ε-support vectors.
    Vectors,
    /// The mean of a Gaussian process.
    Gaussian,
    /// The mean of the answers of all other candidates, each with the same weight. Its mean square error is no larger than theirs
    /// is on average, and often smaller than the smallest, where their errors differ (R. T. Clemen, *Combining forecasts: a
    /// review*, International Journal of Forecasting 5, 1989).
    Mean,
    /// Extremely randomised trees. Only to be compared with: see [`exports`](Self::exports).
    Trees,
    /// Nearest neighbours. Only to be compared with: see [`exports`](Self::exports).
    Neighbours,
}

impl Candidate {
    /// For people.
    #[must_use]
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Mean => "mean of all",
            _ => self.method().map_or("network", Method::in_words),
        }
    }

    /// The regression, of all but networks and means.
    fn method(self) -> Option<Method> {
        match self {
            Self::Network | Self::Mean => None,
            Self::Vectors => Some(Method::Vectors),
            Self::Gaussian => Some(Method::Gaussian),
            Self::Trees => Some(Method::Trees),
            Self::Neighbours => Some(Method::Neighbours),
        }
    }

    /// Whether a bundle can hold it. Trees are an operator of their own in ONNX (`TreeEnsembleRegressor`), which the embedded
    /// runtime does not have; neighbours sort.
    #[must_use]
    pub fn exports(self) -> bool {
        !matches!(self, Self::Trees | Self::Neighbours)
    }

    /// The regression, of one that is a sum of kernels: those that a bundle can hold.
    pub(super) fn kernel(self) -> Option<Method> {
        self.method().filter(|_| self.exports())
    }
}

/// Says which candidates cannot be; `wrong` makes the error of a field.
pub(super) fn check(
    config: &TrainConfig,
    wrong: &dyn Fn(&str, String) -> Result<(), LearnError>,
) -> Result<(), LearnError> {
    let ModelChoice { candidates, most, folds } = &config.model;
    for (i, candidate) in candidates.iter().enumerate() {
        let field = format!("model.candidates[{i}]");
        if !candidate.exports() {
            let who = candidate.in_words();
            return wrong(
                &field,
                format!(
                    "is {who}, which no bundle can hold: the embedded runtime has no operator for them; `dermis compare` \
                         measures them"
                ),
            );
        }
        if candidates[..i].contains(candidate) {
            return wrong(&field, format!("{} is already a candidate", candidate.in_words()));
        }
    }
    if let Some(i) = candidates.iter().position(|c| *c == Candidate::Mean)
        && candidates.len() < 3
    {
        let field = format!("model.candidates[{i}]");
        return wrong(&field, "is the mean of all others, and there are fewer than two".into());
    }
    let only_network = candidates.as_slice() == [Candidate::Network];
    if candidates.is_empty() {
        return wrong("model.candidates", "is empty: someone has to be the model".into());
    }
    if !only_network && (config.network.conv.is_some() || !config.maps().is_empty()) {
        return wrong(
            "model.candidates",
            "is for scalar targets and dense networks; leave it out, or maps and `network.conv`".into(),
        );
    }
    if !(10..=20_000).contains(most) {
        return wrong("model.most", format!("is {most} and must be 10 to 20000"));
    }
    if !(2..=20).contains(folds) {
        return wrong("model.folds", format!("is {folds} and must be 2 to 20"));
    }
    Ok(())
}
