//! Other ways to one contact, learned from recordings and measured beside a model.

use std::path::PathBuf;

use anyhow::{Result, bail};
use dermis_estimate::ContactFinder;
use dermis_estimate::finder::RegressionFinder;
use dermis_learn::cli::Labels;
use dermis_learn::real2sim::Recorded;
use dermis_learn::{Dataset, Evaluation, Evaluator, MOST_BOUNDED, SampleId};
use dermis_regress::Method;
use dermis_skin::{Estimate, SkinDescription};
use serde::Serialize;
use serde_json::Value;

use crate::regressions::{self, Learned as Presses, Most};
use crate::{Progress, labelled};

/// Recorded readings that neighbours, trees and Gaussian processes learn from at most, support vectors, and the network.
const MOST: Most = Most { all: 30_000, vectors: 2500 };
const NETWORK: usize = 12_000;
/// Target readings of every way at most: as many as are held against their bound.
const MOST_TARGETS: usize = MOST_BOUNDED;

/// What another way makes of the same recordings.
#[derive(Debug, Serialize)]
pub struct BaselineComparison {
    /// Its name.
    pub method: &'static str,
    /// Settings that were chosen on locations that nothing was learned from, for place and force, and how many frames it learned from.
    pub settings: Value,
    /// Its errors.
    pub evaluation: Evaluation,
}

/// Learns from `bags`, and answers the touched frames of one contact of `data` (of these `only`), of many every n-th: which, and what
/// every way made of them.
pub(super) fn beside(
    skin: &SkinDescription,
    bags: &[PathBuf],
    labels: &Labels,
    data: &Dataset,
    only: Option<&[SampleId]>,
    bins: &[f64],
    progress: &dyn Progress,
) -> Result<(Vec<SampleId>, Vec<BaselineComparison>)> {
    let learned = labelled(bags, skin, &labels.options()?, progress)?;
    let single: Vec<SampleId> =
        learned.labelled().filter(|(_, _, t)| t.single().is_some()).map(|(id, ..)| id).collect();
    let least = bins.first().copied().unwrap_or_default();
    let recorded = Recorded::of(&learned, &single, least, MOST.all)?;
    if recorded.is_empty() {
        bail!(
            "the bags of `--beside` hold no single contact of {least} N or more, of known place, force and tip"
        );
    }
    let mut targets: Vec<SampleId> = match only {
        Some(ids) => ids.to_vec(),
        None => data.labelled().map(|(id, ..)| id).collect(),
    };
    let detectable = |id: &SampleId| {
        data.sample(*id).is_some_and(|s| {
            let heavy = |t: &dermis_learn::Truth| {
                t.single().and_then(dermis_learn::TruthContact::normal_force).is_some_and(|f| f >= least)
            };
            s.truth.as_ref().is_some_and(heavy)
        })
    };
    targets.retain(detectable);
    let mut targets = data.gather(&targets)?;
    targets.retain(|(_, sample)| sample.tared.iter().any(|v| v.is_finite()));
    let every = dermis_regress::stride(targets.len(), MOST_TARGETS);
    let targets: Vec<_> = targets.into_iter().step_by(every).collect();
    let mut found = Vec::new();
    let mut measure = |method: &'static str, settings: Value, mut finder: RegressionFinder| -> Result<()> {
        progress.begin(&format!("{method}: answering"));
        let mut evaluator = Evaluator::of(data).by_force(bins);
        for (id, sample) in &targets {
            let Some(truth) = sample.truth.as_ref() else { continue };
            let contacts = finder.find(&sample.conditioned())?;
            evaluator.push(*id, truth, &Estimate { contacts, ..Estimate::default() });
        }
        found.push(BaselineComparison { method, settings, evaluation: evaluator.finish(method) });
        Ok(())
    };
    let presses = Presses::of(skin, &recorded);
    for method in [Method::Vectors, Method::Neighbours, Method::Trees, Method::Gaussian] {
        progress.begin(&format!("{}: learning", method.in_words()));
        let (finder, settings) = regressions::tuned(method, skin, &presses, MOST)?;
        measure(method.in_words(), settings, finder)?;
    }
    progress.begin("feed-forward network: learning");
    let (network, settings) = regressions::network(skin, &presses, NETWORK)?;
    measure("feed-forward network", settings, network)?;
    Ok((targets.iter().map(|(id, _)| *id).collect(), found))
}
