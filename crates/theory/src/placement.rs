//! Where to put sensing elements: k of thousands of candidates (H. Sun, *Machine Learning for Haptics*, 2023, 2.2.2–2.3.1).
//!
//! A forward model whose elements are the candidates is evaluated once for what each of them would read under presses all over the skin
//! ([`Field`]); everything else works on those numbers. [`feasible`] leaves out what lies at an edge or close to a support, and
//! [`reduce`] what the others tell anyway. Five methods choose:
//!
//! - [`greedy_svr`] adds the element that reduces the cross-validated error of a support vector regression most (Alg. 1);
//! - [`pca_qr`] takes the pivots of the principal components (Alg. 2);
//! - [`GaussianField`] knows where elements are and nothing of what they read, by entropy or by mutual information (Alg. 3, 4);
//! - [`by_bound`], ours, adds the element that reduces the expected error of a contact most: its Cramér–Rao bound, and how far off
//!   a press is foretold from the others.
//!
//! [`evaluate`] trains the same estimator on all of them: how far off it is on presses that nobody saw, and once elements fail.

mod evaluate;
mod feasible;
mod field;
mod gaussian;
mod greedy;
mod information;
mod linear;
#[cfg(test)]
mod testing;

use serde::{Deserialize, Serialize};

pub use evaluate::{ByCount, ByFailures, Evaluation, EvaluationSettings, evaluate};
pub use feasible::{Feasibility, Verdict, feasible};
pub use field::{Field, Location};
pub use gaussian::GaussianField;
pub use greedy::{GreedySettings, greedy_svr};
pub use information::{BoundSettings, by_bound, expected_error};
pub use linear::{Reduction, pca_qr, reduce};

/// How elements are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Greedy on the cross-validated error of a support vector regression.
    GreedySvr,
    /// Pivots of the principal components.
    PcaQr,
    /// Greedy on the variance that a Gaussian process leaves.
    GpEntropy,
    /// Greedy on what the chosen say of the others.
    GpMi,
    /// Greedy on the Cramér–Rao bound and on what is left between the presses that are known.
    Crlb,
}

impl Method {
    /// All of them, in the order of the thesis; ours last.
    pub const ALL: [Self; 5] = [Self::GreedySvr, Self::PcaQr, Self::GpEntropy, Self::GpMi, Self::Crlb];

    /// As options and files call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::GreedySvr => "greedy-svr",
            Self::PcaQr => "pca-qr",
            Self::GpEntropy => "gp-entropy",
            Self::GpMi => "gp-mi",
            Self::Crlb => "crlb",
        }
    }
}

/// Elements that a method chose: `sets[k - 1]` are the candidates for a budget of k, in the order in which they were found.
/// Greedy methods add to the smaller set; others choose anew for every budget.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Sets(pub Vec<Vec<usize>>);

impl Sets {
    /// Of elements that were found one after the other.
    #[must_use]
    pub fn nested(order: &[usize]) -> Self {
        Self((1..=order.len()).map(|k| order[..k].to_vec()).collect())
    }

    /// The largest.
    #[must_use]
    pub fn last(&self) -> &[usize] {
        self.0.last().map_or(&[], Vec::as_slice)
    }
}

/// Receives the progress of a long search, from 0 to 1; says whether it goes on. A search that is stopped returns what it has.
pub type Watch<'a> = &'a (dyn Fn(f64) -> bool + Sync);
