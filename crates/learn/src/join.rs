//! A transfer network and a network that was trained on the forward model become one bundle, which a node loads.
//!
//! How the two graphs become one: [`dermis_inference::join`]. What is measured here is the whole, on bags of the device.

use std::path::Path;
use std::sync::Arc;

use dermis_inference::trial::{self, Candidate};
use dermis_inference::{Bundle, Joined, Limits, Model, Outputs, Runtime, join};
use dermis_model::ForwardModel;
use dermis_skin::SkinDescription;
use serde_json::json;

use crate::dataset::Dataset;
use crate::evaluate::Evaluation;
use crate::evaluator::GraphEvaluator;
use crate::target::Maps;
use crate::{LearnError, SplitConfig, card};

/// What to make a bundle of.
pub struct JoinRequest<'a> {
    /// Skin that both are for.
    pub skin: &'a SkinDescription,
    /// Folder of the bundle with the target `signal`, which the readings of the device go through first.
    pub transfer: &'a Path,
    /// Folder of the bundle that was trained on the model's readings.
    pub reconstruction: &'a Path,
    /// Data of the device to measure the whole on, and the part that counts; all of them where it is `None`.
    pub data: Option<(&'a Dataset, Option<SplitConfig>)>,
    /// The skin's forward model, where there is one: how far tips sink in decides where their force acts.
    pub model: Option<Arc<dyn ForwardModel>>,
    /// Folder of the bundle; an older bundle is replaced.
    pub out: &'a Path,
    /// Runtime of this process.
    pub runtime: &'a Runtime,
}

/// Joins both bundles, measures the whole where there are data, and writes the bundle; its errors.
///
/// # Errors
///
/// [`LearnError`] says which bundle cannot be read or does not fit, and why; nothing is written then.
pub fn join_bundles(request: &JoinRequest<'_>) -> Result<Option<Evaluation>, LearnError> {
    let load = |folder: &Path| Bundle::load(folder, request.skin);
    let Joined { mut writer, graph } = join(&load(request.transfer)?, &load(request.reconstruction)?)?;
    let interface = writer.manifest.model.clone().unwrap_or_default().interface;
    let limits = Limits::default();
    trial::check(request.runtime, &Candidate { graph: &graph, interface: &interface, ranges: &[] }, &limits)?;
    let model = Model::load(request.runtime, &graph, &interface)?;
    let mut measured = None;
    if let Some((data, split)) = request.data {
        let evaluation = measure(request, &writer.manifest, model, (data, split))?;
        card::measured(&mut writer.manifest, &evaluation);
        writer.manifest.training.data_hash = data.hash();
        writer.manifest.training.held_out.clone_from(&evaluation.data);
        writer.card.extend(card::of_measured(data, split, &evaluation)?);
        measured = Some(evaluation);
    }
    writer.card.insert("program".into(), json!(format!("dermis {}", env!("CARGO_PKG_VERSION"))));
    writer.write(request.out, &graph)?;
    Ok(measured)
}

/// Errors of the whole.
fn measure(
    request: &JoinRequest<'_>,
    manifest: &dermis_inference::Manifest,
    model: Model,
    (data, split): (&Dataset, Option<SplitConfig>),
) -> Result<Evaluation, LearnError> {
    let decoder = Outputs::new(manifest.output.clone())?;
    let taken = (&manifest.input, manifest.baseline);
    let mut evaluator = GraphEvaluator::new(request.out, (model, decoder), taken, request.skin)?;
    let (held_out, name) = SplitConfig::evaluated(split, data)?;
    let maps = Maps::new(request.skin, request.model.clone(), &[])?;
    Ok(evaluator.evaluate(data, held_out.as_deref(), maps, name)?.0)
}

#[cfg(test)]
mod tests;
