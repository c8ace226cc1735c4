//! Other ways to one contact, learned from recordings and measured beside a model.

use std::path::PathBuf;

use anyhow::{Result, bail};
use dermis_estimate::ContactFinder;
use dermis_estimate::finder::RegressionFinder;
use dermis_learn::cli::Labels;
use dermis_learn::real2sim::Recorded;
use dermis_learn::{Dataset, Evaluation, Evaluator, SampleId};
use dermis_skin::{Estimate, SkinDescription};
use serde::Serialize;
use serde_json::{Value, json};

use crate::real2sim::regressions;
use crate::real2sim::train::parts;
use crate::{Progress, conditioned};

/// Recorded readings that neighbours and the network learn from at most, and support vectors.
const LEARNED: usize = 12_000;
const VECTORS: usize = 2500;
/// Readings that every way is asked at most: more of them change the last digit.
const ASKED: usize = 12_000;

/// What another way makes of the same recordings.
#[derive(Debug, Serialize)]
pub struct BaselineComparison {
    /// Its name.
    pub method: &'static str,
    /// Settings that were chosen on places that nothing was learned from.
    pub settings: Value,
    /// Its errors.
    pub evaluation: Evaluation,
}

/// Learns from `bags`, and answers the touched frames of one contact of `data` (of these `only`).
pub(super) fn beside(
    skin: &SkinDescription,
    bags: &[PathBuf],
    labels: &Labels,
    data: &Dataset,
    only: Option<&[SampleId]>,
    bins: &[f64],
    progress: &dyn Progress,
) -> Result<Vec<BaselineComparison>> {
    let learned = Dataset::from_bags(bags, skin, &labels.options()?)?;
    let single: Vec<SampleId> =
        learned.labelled().filter(|(_, _, t)| t.single().is_some()).map(|(id, ..)| id).collect();
    let (learn, choose) = parts(&learned, &single);
    let least = bins.first().copied().unwrap_or_default();
    let of = |ids: &[SampleId], most| Recorded::of(&learned, ids, least, most);
    let (learn, choose) = (of(&learn, LEARNED)?, of(&choose, LEARNED / 4)?);
    if learn.is_empty() || choose.is_empty() {
        bail!(
            "the bags of `--beside` hold no single contact of {least} N or more, of known place, force and tip"
        );
    }
    let mut asked: Vec<SampleId> = match only {
        Some(ids) => ids.to_vec(),
        None => data.labelled().map(|(id, ..)| id).collect(),
    };
    let felt = |id: &SampleId| {
        data.sample(*id).is_some_and(|s| {
            let heavy = |t: &dermis_learn::Truth| {
                t.single().and_then(dermis_learn::TruthContact::normal_force).is_some_and(|f| f >= least)
            };
            s.truth.as_ref().is_some_and(heavy)
        })
    };
    asked.retain(felt);
    let mut asked = data.gather(&asked)?;
    asked.retain(|(_, sample)| sample.tared.iter().any(|v| v.is_finite()));
    let every = asked.len().div_ceil(ASKED).max(1);
    let mut found = Vec::new();
    let mut measure = |method: &'static str, settings: Value, mut finder: RegressionFinder| -> Result<()> {
        progress.begin(&format!("{method}: answering"));
        let mut evaluator = Evaluator::new().by_force(bins);
        for (id, sample) in asked.iter().step_by(every) {
            let Some(truth) = sample.truth.as_ref() else { continue };
            let contacts = finder.find(&conditioned(sample))?;
            evaluator.push(id.run, truth, &Estimate { contacts, ..Estimate::default() });
        }
        found.push(BaselineComparison { method, settings, evaluation: evaluator.finish(method) });
        Ok(())
    };
    progress.begin("support vectors: learning");
    let (vectors, settings) = regressions::tuned_vectors(skin, &learn, &choose, VECTORS)?;
    let [x, y, z, force] = settings;
    measure("support vectors", json!({ "x": x, "y": y, "z": z, "force": force }), vectors)?;
    progress.begin("nearest neighbours: learning");
    let (neighbours, count) = regressions::tuned_neighbours(skin, &learn, &choose)?;
    measure("nearest neighbours", json!({ "count": count }), neighbours)?;
    progress.begin("feed-forward network: learning");
    let network = regressions::network(skin, &learn)?;
    measure("feed-forward network", json!({ "learned": learn.len() }), network)?;
    Ok(found)
}
