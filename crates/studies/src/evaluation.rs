//! Measuring model bundles on labelled bags, with the node's own estimator.
//!
//! Frames are answered in their order, as a node would; errors are summed up over contacts and by force, beside the
//! Cramér–Rao bound on the same contacts and, where they are asked for, beside other ways that learn from recordings.

mod beside;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use dermis_learn::cli::Labels;
use dermis_learn::target::Maps;
use dermis_learn::{
    Bounds, Dataset, Evaluation, Evaluator, Requirement, SampleId, SplitConfig, SplitKind, Verdicts, bounds,
    evaluate_by,
};
use dermis_model::Unknowns;
use dermis_skin::SkinDescription;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use crate::{Families, Progress};

pub use beside::BaselineComparison;

/// \[m\] of width below which presses lie on a line.
const LINE: f64 = 1e-3;

/// What to measure on what.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description.
    #[arg(long)]
    pub skin: PathBuf,
    /// Model bundle; several may give different outputs.
    #[arg(long, required = true)]
    pub model: Vec<PathBuf>,
    /// Only what the (first) model did not see in training, as its data card says; for bags that it was trained on.
    #[arg(long)]
    pub held_out: bool,
    /// Only the held-out part of this split (location, press, time), whatever the card says.
    #[arg(long, conflicts_with = "held_out")]
    pub split: Option<SplitKind>,
    /// Leave the zero to the estimator, as in a node that nobody tells when to tare; otherwise it is taken anew where the
    /// bag says that nothing touches for long enough.
    #[arg(long)]
    pub unattended: bool,
    /// Only frames in which every channel is within its range: what saturation costs is left out.
    #[arg(long)]
    pub in_range: bool,
    /// How the bags are read.
    #[command(flatten)]
    pub labels: Labels,
    /// Ascending forces [N] at which the bins of errors by force begin, e.g. `0.02,0.14,0.2,0.4,0.6,0.9,1.2,1.5`.
    #[arg(long, value_delimiter = ',', default_values_t = dermis_learn::FORCE_BINS)]
    pub bins: Vec<f64>,
    /// A figure that must be reached, in SI units, e.g. `position_rms<=0.0005`; may be repeated.
    #[arg(long)]
    #[serde(with = "written")]
    pub require: Vec<Requirement>,
    /// Labelled bag with single contacts that support vectors, nearest neighbours and a feed-forward network learn from, to be
    /// measured beside the model on frames of one contact, by force; may be repeated.
    #[arg(long)]
    pub beside: Vec<PathBuf>,
    /// Labelled bags.
    #[arg(required = true)]
    pub bags: Vec<PathBuf>,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            skin: PathBuf::new(),
            model: Vec::new(),
            held_out: false,
            split: None,
            unattended: false,
            in_range: false,
            labels: Labels::default(),
            bins: dermis_learn::FORCE_BINS.to_vec(),
            require: Vec::new(),
            beside: Vec::new(),
            bags: Vec::new(),
        }
    }
}

/// Requirements as they are written on a command line.
mod written {
    use dermis_learn::Requirement;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    pub(super) fn serialize<S: Serializer>(all: &[Requirement], serializer: S) -> Result<S::Ok, S::Error> {
        all.iter().map(ToString::to_string).collect::<Vec<_>>().serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Requirement>, D::Error> {
        let all = Vec::<String>::deserialize(from)?;
        all.iter().map(|text| text.parse().map_err(D::Error::custom)).collect()
    }
}

/// Everything that was found.
pub struct Findings {
    /// Errors.
    pub evaluation: Evaluation,
    /// What any estimator without bias could reach on the same contacts.
    pub bound: Option<Bounds>,
    /// What other ways make of the same frames.
    pub others: Vec<BaselineComparison>,
    /// Which requirements are met.
    pub verdicts: Verdicts,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut value = self.evaluation.to_json();
        if let Some(object) = value.as_object_mut() {
            object.insert("figures".to_owned(), json!(self.evaluation.figures()));
            object.insert("requirements".to_owned(), json!(self.verdicts));
            object.insert("bound".to_owned(), json!(self.bound));
            if !self.others.is_empty() {
                object.insert("beside".to_owned(), json!(self.others));
            }
        }
        value.serialize(serializer)
    }
}

/// Evaluates.
///
/// # Errors
///
/// Where skin, bundles or bags cannot be read. A requirement that is missed is a finding.
pub fn evaluate(options: &Request, families: &Families, progress: &dyn Progress) -> Result<Findings> {
    let skin = SkinDescription::load(&options.skin)?;
    let mut estimator = families.estimator(&skin, &options.model)?;
    let mut how = options.labels.options()?;
    how.tare_when_idle = !options.unattended;
    let data = Dataset::from_bags(&options.bags, &skin, &how)?;
    for notice in data.notices() {
        progress.note(&notice);
    }
    let split = match (options.held_out, options.split) {
        (true, _) => Some(split_of(&options.model[0])?),
        (false, Some(kind)) => Some(SplitConfig { kind, ..SplitConfig::default() }),
        (false, None) => None,
    };
    let mut test = split.map(|s| s.apply(&data)).transpose()?.map(|s| s.test);
    if options.in_range {
        let whole = |id: &SampleId| data.sample(*id).is_some_and(|s| s.flags.iter().all(|f| f.is_ok()));
        let all = || data.labelled().map(|(id, ..)| id).collect();
        let mut kept = test.unwrap_or_else(all);
        kept.retain(whole);
        test = Some(kept);
    }
    let name = split.map_or_else(|| "all labelled frames".to_owned(), |s| s.describe());
    let model = families.model(&skin).ok();
    // Maps that nobody can know here are not compared.
    let maps = Maps::new(&skin, model.clone(), &[])?;
    let evaluator = Evaluator::new().by_force(&options.bins).with_maps(maps);
    let evaluation = evaluate_by(evaluator, estimator.as_mut(), &data, test.as_deref(), name)?;
    let bound = match &model {
        None => None,
        Some(model) => {
            let unknowns = unknowns(&data, &evaluation);
            bounds(model.as_ref(), &data, test.as_deref(), unknowns, &options.bins)?
        }
    };
    let others = if options.beside.is_empty() {
        Vec::new()
    } else {
        let labels = &options.labels;
        beside::beside(&skin, &options.beside, labels, &data, test.as_deref(), &options.bins, progress)?
    };
    let verdicts = Verdicts::of(&options.require, &evaluation);
    Ok(Findings { evaluation, bound, others, verdicts })
}

/// What was unknown to who was evaluated.
#[must_use]
pub fn unknowns(data: &Dataset, evaluation: &Evaluation) -> Unknowns {
    if evaluation.quantities.contains_key("force.x") {
        return Unknowns::Full;
    }
    // Presses on a line ask for the place along it.
    let across = data.labelled().flat_map(|(_, _, t)| t.contacts.iter().map(|c| c.position.y));
    let (low, high) = across.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), y| (l.min(y), h.max(y)));
    if high - low < LINE { Unknowns::Line } else { Unknowns::Normal }
}

/// The split that a model was trained with.
///
/// # Errors
///
/// Where the bundle has no data card, or the card names no split.
pub fn split_of(model: &Path) -> Result<SplitConfig> {
    let path = model.join("card.json");
    let text = dermis_io::read_text(&path, dermis_io::REPORT).with_context(|| {
        format!("{} cannot be read: `--held-out` needs the data card of the model", path.display())
    })?;
    let card: serde_json::Value =
        serde_json::from_str(&text).with_context(|| format!("{} is not JSON", path.display()))?;
    let split = card.get("split").with_context(|| {
        format!("{}: field `split` is missing: pass `--split` instead of `--held-out`", path.display())
    })?;
    serde_json::from_value(split.clone()).with_context(|| format!("{}: field `split`", path.display()))
}
