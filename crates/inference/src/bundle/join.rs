//! Two bundles one after the other in one: a transfer network and what was learned on the forward model.
//!
//! Problem: a transfer network gives the readings that the forward model would have for what touches a device, and a reconstruction
//! network that was trained on the model gives contacts or maps for them (thesis, chapter 4: Transfer-Net and Recon-Net). They are
//! trained apart, and a node loads one bundle. Method: both graphs become one ([`onnx::chain`](crate::onnx::chain)). Between them
//! stand one factor and one summand for each channel, which undo the scaling of the transfer's output and do that of the reconstruction's input:
//! with the output y = raw · s + m and the input z = (y − μ) / σ, z = raw · s / σ + (m − μ) / σ. Everything behind the map's pixels,
//! such as the mixing into forces on the surface's points, is in the reconstruction's graph already. Assumptions: the reconstruction takes
//! the newest tared frame alone. Cost: that of both networks, and of one multiplication and one addition a channel.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::{Bundle, BundleWriter};
use crate::features::{FeatureConfig, Missing, Taps};
use crate::interface::{Interface, TensorPort};
use crate::manifest::{Baseline, ModelSection};
use crate::onnx::{ChainError, GraphBuilder, OnnxError, chain};
use crate::outputs::{Link, OutputSpec};

/// Name of the output that holds, in the unit of the skin, what the forward model reads for the true contacts, minus its untouched
/// readings: one number a channel.
pub const SIGNAL: &str = "signal";

/// Bundles that cannot be joined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JoinError {
    /// One of them is not what it has to be.
    #[error("model bundle {path}: {problem}")]
    Unfit {
        /// The bundle.
        path: PathBuf,
        /// What is wrong with it, and what to do.
        problem: String,
    },
    /// The graphs do not fit each other.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// What stands between them cannot be written.
    #[error(transparent)]
    Graph(#[from] OnnxError),
}

/// A bundle that is not written yet, and its graph.
#[derive(Debug, Clone)]
pub struct Joined {
    /// Manifest and card.
    pub writer: BundleWriter,
    /// The ONNX file.
    pub graph: Vec<u8>,
}

/// The bundle that takes what `transfer` takes and gives what `reconstruction` gives for the signal of `transfer`.
///
/// Errors of the reconstruction were measured on its own inputs and say nothing of the whole: no sigma and no metric is taken over,
/// and neither are a refinement on the forward model and its correction (`dermis refine` learns them of the whole).
///
/// # Errors
///
/// [`JoinError`] names the bundle that does not fit, and why.
pub fn join(transfer: &Bundle, reconstruction: &Bundle) -> Result<Joined, JoinError> {
    let (first, own, signal) = transfer_of(transfer)?;
    let (second, model) = reconstruction_of(reconstruction)?;
    let (from, to) = (&transfer.manifest, &reconstruction.manifest);
    if from.skin.hash != to.skin.hash {
        let problem = format!(
            "is of skin `{}` ({}) and {} of skin `{}` ({}); train both on the same skin file",
            to.skin.name,
            to.skin.hash,
            transfer.path.display(),
            from.skin.name,
            from.skin.hash
        );
        return Err(unfit(&reconstruction.path, problem));
    }
    let between = scaling(signal, &own.interface.output_shape, &to.input, &model.interface.input_shape)?;
    let graph = chain(&[("transfer", first), ("scaling", &between), ("reconstruction", second)])?;

    let input = TensorPort { name: own.interface.input.clone(), shape: own.interface.input_shape.clone() };
    let outputs: Vec<TensorPort> = model
        .interface
        .outputs()
        .map(|(name, shape)| TensorPort { name: name.to_owned(), shape: shape.to_vec() })
        .collect();
    let mut manifest = to.clone();
    manifest.description = format!("{}; behind a transfer network: {}", to.description, from.description);
    (manifest.baseline, manifest.input, manifest.normalisation) = (from.baseline, from.input.clone(), None);
    manifest.model =
        Some(ModelSection { interface: Interface::of(&[input], &outputs), ..Default::default() });
    (manifest.inversion, manifest.correction) = (None, None);
    manifest.metrics.clear();
    manifest.training.held_out.clear();
    manifest.training.data_hash.clear();
    for value in &mut manifest.output.values {
        value.sigma = None;
        value.sigma_by_force.clear();
    }
    if let Some(peaks) = &mut manifest.force_peaks {
        (peaks.position_sigma, peaks.force_sigma) = (None, None);
    }
    let mut writer = BundleWriter::new(manifest);
    writer.sensitivity.clone_from(&reconstruction.sensitivity);
    for (key, bundle) in [("transfer", transfer), ("reconstruction", reconstruction)] {
        let manifest = &bundle.manifest;
        let part = json!({
            "name": manifest.name,
            "description": manifest.description,
            "model": manifest.model.as_ref().map(|model| &model.hash),
            "training": manifest.training,
            "metrics": manifest.metrics,
        });
        writer.card.insert(key.to_owned(), part);
    }
    Ok(Joined { writer, graph })
}

fn unfit(path: &Path, problem: impl Into<String>) -> JoinError {
    JoinError::Unfit { path: path.to_owned(), problem: problem.into() }
}

/// Graph of a bundle, and what it takes and gives.
fn network_of(bundle: &Bundle) -> Result<(&[u8], &ModelSection), JoinError> {
    let network = bundle.graph.as_deref().zip(bundle.manifest.model.as_ref());
    network.ok_or_else(|| {
        unfit(&bundle.path, "has no network to join; name a bundle that `dermis train` has written")
    })
}

/// Graph and signal of a transfer network, and what it takes and gives.
fn transfer_of(bundle: &Bundle) -> Result<(&[u8], &ModelSection, &OutputSpec), JoinError> {
    let (graph, model) = network_of(bundle)?;
    let channels = bundle.manifest.skin.channels.len();
    match &bundle.manifest.output.values[..] {
        [signal] if signal.name == SIGNAL && signal.count == channels && signal.link == Link::Linear => {
            Ok((graph, model, signal))
        }
        values => {
            let names: Vec<&str> = values.iter().map(|value| value.name.as_str()).collect();
            let problem = format!(
                "gives {} and not `{SIGNAL}` alone, one number for each of {channels} channels; train it with `targets = [\"{SIGNAL}\"]`",
                names.join(", ")
            );
            Err(unfit(&bundle.path, problem))
        }
    }
}

/// Graph of a network that takes the newest tared frame.
fn reconstruction_of(bundle: &Bundle) -> Result<(&[u8], &ModelSection), JoinError> {
    let manifest = &bundle.manifest;
    let (graph, model) = network_of(bundle)?;
    if manifest.baseline != Baseline::Tared {
        let problem = "takes readings with their zero, which a transfer network does not give; train it with `baseline = \"tared\"`";
        return Err(unfit(&bundle.path, problem));
    }
    let FeatureConfig { taps, low_pass, difference, missing, image, .. } = &manifest.input;
    let newest = match taps {
        Taps::Frames(delays) => delays[..] == [0],
        Taps::Seconds(delays) => delays[..] == [0.0],
    };
    if !newest
        || !low_pass.is_empty()
        || !difference.is_empty()
        || *missing != Missing::Mean
        || image.is_some()
    {
        let problem = "takes more than the newest frame of the channels; train it without `[features]`, and give those to the transfer \
                       network";
        return Err(unfit(&bundle.path, problem));
    }
    Ok((graph, model))
}

/// From the raw output of a transfer network to the normalised input of another.
fn scaling(
    signal: &OutputSpec,
    given: &[usize],
    input: &FeatureConfig,
    taken: &[usize],
) -> Result<Vec<u8>, OnnxError> {
    let of = |number: &dyn Fn(f64, f64) -> f64| -> Vec<f32> {
        let each = input.mean.iter().zip(&input.scale);
        each.map(|(mean, scale)| number(f64::from(*mean), f64::from(*scale)) as f32).collect()
    };
    let channels = input.channels();
    let mut g = GraphBuilder::new("scaling");
    let raw = g.input("raw", given);
    let factor = g.constant("factor", &[1, channels], &of(&|_, scale| signal.scale / scale));
    let summand = g.constant("summand", &[1, channels], &of(&|mean, scale| (signal.mean - mean) / scale));
    let row = g.reshape(&raw, &[1, channels]);
    let scaled = g.mul(&row, &factor);
    let moved = g.add(&scaled, &summand);
    let shaped = g.reshape(&moved, taken);
    g.output("normalised", &shaped, taken);
    g.finish()
}
