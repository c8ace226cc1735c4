//! Measuring model bundles on labelled bags, with the node's own estimator.
//!
//! Frames are answered in their order, as a node would; errors are summed up over contacts and by force, beside the
//! Cramér–Rao bound on the same contacts and, where they are requested, beside other ways that learn from recordings.

mod answers;
mod beside;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use dermis_learn::cli::{Labels, ReadMaps};
use dermis_learn::target::Maps;
use dermis_learn::{
    Bounds, Dataset, Evaluation, Evaluator, Requirement, SampleId, SplitConfig, SplitKind, Verdicts,
    frame_bounds,
};
use dermis_model::{ForwardModel, Unknowns};
use dermis_skin::{Estimator, SkinDescription};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use crate::{Families, LeftOut, Progress, labelled};

use answers::Answers;
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
    #[arg(long, required_unless_present_any = ["invert", "answers"])]
    pub model: Vec<PathBuf>,
    /// Without a bundle: find the contacts on the skin's forward model, as a node does that has none.
    #[arg(long, conflicts_with_all = ["model", "held_out", "beside"])]
    pub invert: bool,
    /// Without a bundle: what another program made of the frames of the bags. Each line is of one frame:
    /// `{"stamp_ns": 12, "contacts": [{"position": [x, y, z], "force": [x, y, z]}]}`, in metres and newtons in the link frame.
    #[arg(long, value_name = "FILE.jsonl", conflicts_with_all = ["model", "invert", "held_out", "unattended"])]
    pub answers: Option<PathBuf>,
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
    /// Besides the figures with everything, those of frames in which every channel is within its range: what saturation costs is left
    /// out of these, and requirements are held against them.
    #[arg(long)]
    pub in_range: bool,
    /// How the bags are read.
    #[command(flatten)]
    pub labels: Labels,
    /// How contacts are read off maps of forces.
    #[command(flatten)]
    pub read_maps: ReadMaps,
    /// Ascending forces [N] at which the bins of errors by force begin, e.g. `0.02,0.14,0.2,0.4,0.6,0.9,1.2,1.5`.
    #[arg(long, value_delimiter = ',', default_values_t = dermis_learn::FORCE_BINS)]
    pub bins: Vec<f64>,
    /// A figure that must be reached, in SI units, e.g. `position_rms<=0.0005`; may be repeated.
    #[arg(long)]
    #[serde(with = "written")]
    pub require: Vec<Requirement>,
    /// Labelled bag with single contacts that support vectors, nearest neighbours, extra trees, a Gaussian process and a feed-forward
    /// network learn from, to be measured beside the model on frames of one contact, by force; may be repeated.
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
            invert: false,
            answers: None,
            held_out: false,
            split: None,
            unattended: false,
            in_range: false,
            labels: Labels::default(),
            read_maps: ReadMaps::default(),
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
    /// Errors with every frame, where `evaluation` leaves some out, and what it leaves out.
    pub everything: Option<(Evaluation, Vec<LeftOut>)>,
    /// Errors of what was requested.
    pub evaluation: Evaluation,
    /// What any estimator without bias could reach on the same contacts.
    pub bound: Option<Bounds>,
    /// Errors on the frames that the other ways answer, too.
    pub own: Option<Evaluation>,
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
            if let Some((everything, left_out)) = &self.everything {
                object.insert("with_everything".to_owned(), json!(everything));
                object.insert("left_out".to_owned(), json!(left_out));
            }
            if !self.others.is_empty() {
                object.insert("beside".to_owned(), json!(self.others));
                object.insert("own_beside".to_owned(), json!(self.own));
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
    let mut estimator: Box<dyn Estimator> = match &options.answers {
        Some(file) => Box::new(Answers::read(file, &skin.surface())?),
        None if options.invert => families.inverting(&skin)?,
        None => families.estimator(&skin, &options.model)?,
    };
    let mut how = options.labels.options()?;
    how.tare_when_idle = !options.unattended;
    let data = labelled(&options.bags, &skin, &how, progress)?;
    let split = match (options.held_out, options.split) {
        (true, _) => Some(split_of(&options.model[0])?),
        (false, Some(kind)) => Some(SplitConfig { kind, ..SplitConfig::default() }),
        (false, None) => None,
    };
    let (targets, name) = SplitConfig::evaluated(split, &data)?;
    let kept = options.in_range.then(|| in_range(&data, targets.as_deref()));
    let model = families.model(&skin).ok();
    // Maps that nobody can know here are not compared.
    let maps = Maps::new(&skin, model.clone(), &[])?;
    let mut evaluator = Evaluator::of(&data).by_force(&options.bins).with_maps(maps);
    if let Some(reading) = options.read_maps.reading(&skin.surface())? {
        evaluator = evaluator.with_map_reading(reading);
    }
    if let Some((kept, _)) = &kept {
        evaluator = evaluator.maps_of(kept);
    }
    evaluator.run(estimator.as_mut(), &data, targets.as_deref())?;
    let mut own = None;
    let others = if options.beside.is_empty() {
        Vec::new()
    } else {
        let only = kept.as_ref().map(|(kept, _)| kept.as_slice()).or(targets.as_deref());
        let (ids, others) =
            beside::beside(&skin, &options.beside, &options.labels, &data, only, &options.bins, progress)?;
        let same = evaluator.restricted(&ids).finish("the model, on the same frames");
        own = Some(bounded(same, model.as_deref(), &data, Some(&ids), &options.bins)?.0);
        others
    };
    let (everything, evaluation, bound) = match kept {
        None => {
            let (evaluation, bound) =
                bounded(evaluator.finish(name), model.as_deref(), &data, targets.as_deref(), &options.bins)?;
            (None, evaluation, bound)
        }
        Some((kept, left_out)) => {
            let part = evaluator.restricted(&kept).with_maps_of(&mut evaluator);
            let part = part.finish(format!("{name}, every channel within its range"));
            let of = |e, ids| bounded(e, model.as_deref(), &data, ids, &options.bins);
            let (all, _) = of(evaluator.finish(name), targets.as_deref())?;
            let (evaluation, bound) = of(part, Some(&kept))?;
            (Some((all, left_out)), evaluation, bound)
        }
    };
    let verdicts = Verdicts::of(&options.require, &evaluation);
    Ok(Findings { everything, evaluation, bound, own, others, verdicts })
}

/// Frames in which every channel is within its range, and what of the touched ones is not among them.
fn in_range(data: &Dataset, targets: Option<&[SampleId]>) -> (Vec<SampleId>, Vec<LeftOut>) {
    let mut kept: Vec<SampleId> =
        targets.map_or_else(|| data.labelled().map(|(id, ..)| id).collect(), <[SampleId]>::to_vec);
    let touched = |ids: &[SampleId]| {
        let truth = |id: &SampleId| data.sample(*id).and_then(|s| s.truth.as_ref());
        ids.iter().filter_map(truth).filter(|t| t.touched()).count()
    };
    let all = touched(&kept);
    kept.retain(|id| data.sample(*id).is_some_and(|s| s.flags.iter().all(|f| f.is_ok())));
    let lost = all - touched(&kept);
    let left_out = LeftOut::list(all, &[(lost, "a channel is out of its range".to_owned())]);
    (kept, left_out)
}

/// An evaluation beside the bounds of its frames, which are `ids` or all, and the bounds alone.
fn bounded(
    evaluation: Evaluation,
    model: Option<&dyn ForwardModel>,
    data: &Dataset,
    ids: Option<&[SampleId]>,
    bins: &[f64],
) -> Result<(Evaluation, Option<Bounds>)> {
    let Some(model) = model else { return Ok((evaluation, None)) };
    let bounds = frame_bounds(model, data, ids, unknowns(data, &evaluation))?;
    Ok((evaluation.against(&bounds, bins), bounds.summary(bins)))
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
