//! Measuring model bundles on labelled bags, with the node's own estimator.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use dermis_learn::cli::Labels;
use dermis_learn::{
    Bounds, Dataset, Evaluation, Requirement, SampleId, SplitConfig, SplitKind, Verdicts, bounds, evaluate,
};
use dermis_skin::SkinDescription;
use dermis_theory::Unknowns;
use serde_json::json;

use crate::registry::Family;

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
    #[command(flatten)]
    labels: Labels,
    /// A figure that must be reached, in SI units, e.g. `position_rms<=0.0005`; may be repeated.
    #[arg(long)]
    require: Vec<Requirement>,
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
    let test = split.map(|s| s.apply(&data)).transpose()?.map(|s| s.test);
    let name = split.map_or_else(|| "all labelled frames".to_owned(), |s| s.describe());
    let evaluation = evaluate(estimator.as_mut(), &data, test.as_deref(), name)?;
    let bound = bound(family, &skin, &data, test.as_deref(), &evaluation)?;
    let verdicts = Verdicts::of(&options.require, &evaluation);
    if options.json {
        let mut value = evaluation.to_json();
        if let Some(object) = value.as_object_mut() {
            object.insert("figures".to_owned(), json!(evaluation.figures()));
            object.insert("requirements".to_owned(), json!(verdicts));
            object.insert("bound".to_owned(), json!(bound));
        }
        println!("{value}");
    } else {
        print!("{evaluation}");
        if let Some(bound) = &bound {
            print!("{bound}");
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
) -> Result<Option<Bounds>> {
    let Ok(model) = (family.model)(skin) else { return Ok(None) };
    let full = evaluation.quantities.contains_key("force.x");
    let unknowns = if full { Unknowns::Full } else { Unknowns::Normal };
    Ok(bounds(model.as_ref(), data, only, unknowns)?)
}

/// The split that a model was trained with.
fn split_of(model: &Path) -> Result<SplitConfig> {
    let path = model.join("card.json");
    let text = std::fs::read_to_string(&path).with_context(|| {
        format!("{} cannot be read: `--held-out` needs the data card of the model", path.display())
    })?;
    let card: serde_json::Value =
        serde_json::from_str(&text).with_context(|| format!("{} is not JSON", path.display()))?;
    let split = card.get("split").with_context(|| {
        format!("{}: field `split` is missing: pass `--split` instead of `--held-out`", path.display())
    })?;
    serde_json::from_value(split.clone()).with_context(|| format!("{}: field `split`", path.display()))
}
