//! Measuring model bundles on labelled bags, with the node's own estimator.

mod beside;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use dermis_learn::cli::Labels;
use dermis_learn::{
    Bounds, Dataset, Evaluation, Requirement, SampleId, SplitConfig, SplitKind, Verdicts, bounds, evaluate_by,
};
use dermis_model::Unknowns;
use dermis_skin::SkinDescription;
use serde_json::json;

use crate::registry::Family;

/// \[m\] of width below which presses lie on a line.
const LINE: f64 = 1e-3;

/// What to measure on what.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    #[arg(long)]
    skin: PathBuf,
    /// Model bundle; several may give different outputs.
    #[arg(long, required = true)]
    model: Vec<PathBuf>,
    /// Only what the (first) model did not see in training, as its data card says; for bags that it was trained on.
    #[arg(long)]
    held_out: bool,
    /// Only the held-out part of this split (location, press, time), whatever the card says.
    #[arg(long, conflicts_with = "held_out")]
    split: Option<SplitKind>,
    /// Leave the zero to the estimator, as in a node that nobody tells when to tare; otherwise it is taken anew where the
    /// bag says that nothing touches for long enough.
    #[arg(long)]
    unattended: bool,
    /// Only frames in which every channel is within its range: what saturation costs is left out.
    #[arg(long)]
    in_range: bool,
    #[command(flatten)]
    labels: Labels,
    /// Ascending forces [N] at which the bins of errors by force begin, e.g. `0.02,0.14,0.2,0.4,0.6,0.9,1.2,1.5`.
    #[arg(long, value_delimiter = ',', default_values_t = dermis_learn::FORCE_BINS)]
    bins: Vec<f64>,
    /// A figure that must be reached, in SI units, e.g. `position_rms<=0.0005`; may be repeated.
    #[arg(long)]
    require: Vec<Requirement>,
    /// Labelled bag with single contacts that support vectors, nearest neighbours and a feed-forward network learn from, to be
    /// measured beside the model on frames of one contact, by force; may be repeated.
    #[arg(long)]
    beside: Vec<PathBuf>,
    /// One JSON object.
    #[arg(long)]
    json: bool,
    /// Labelled bags.
    #[arg(required = true)]
    bags: Vec<PathBuf>,
}

/// Evaluates, and fails where a requirement is missed.
pub fn run(options: &Options) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let family = crate::registry::family(&skin)?;
    let mut estimator = (family.estimator)(&skin, &options.model)?;
    let mut how = options.labels.options()?;
    how.tare_when_idle = !options.unattended;
    let data = Dataset::from_bags(&options.bags, &skin, &how)?;
    for notice in data.notices() {
        eprintln!("note: {notice}");
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
    let evaluation = evaluate_by(estimator.as_mut(), &data, test.as_deref(), &options.bins, name)?;
    let bound = bound(family, &skin, &data, test.as_deref(), &evaluation, &options.bins)?;
    let others = if options.beside.is_empty() {
        Vec::new()
    } else {
        beside::beside(&skin, &options.beside, &options.labels, &data, test.as_deref(), &options.bins)?
    };
    let verdicts = Verdicts::of(&options.require, &evaluation);
    if options.json {
        let mut value = evaluation.to_json();
        if let Some(object) = value.as_object_mut() {
            object.insert("figures".to_owned(), json!(evaluation.figures()));
            object.insert("requirements".to_owned(), json!(verdicts));
            object.insert("bound".to_owned(), json!(bound));
            if !others.is_empty() {
                object.insert("beside".to_owned(), json!(others));
            }
        }
        println!("{value}");
    } else {
        print!("{evaluation}");
        if let Some(bound) = &bound {
            print!("{bound}");
        }
        if !others.is_empty() {
            println!("{}", beside::table(&evaluation, &others, bound.as_ref()));
        }
        print!("{verdicts}");
    }
    Ok(verdicts.require()?)
}

/// What any estimator without bias could reach at best on the same contacts, where the skin has a forward model.
fn bound(
    family: &Family,
    skin: &SkinDescription,
    data: &Dataset,
    only: Option<&[SampleId]>,
    evaluation: &Evaluation,
    edges: &[f64],
) -> Result<Option<Bounds>> {
    let Ok(model) = (family.model)(skin) else { return Ok(None) };
    Ok(bounds(model.as_ref(), data, only, unknowns(data, evaluation), edges)?)
}

/// What was unknown to who was evaluated.
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
