//! `dermis refine`: has a bundle's answers refined on the skin's forward model, where recordings show that this helps.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use dermis_inference::Bundle;
use dermis_inversion::{ForcePrior, Settings};
use dermis_learn::cli::Labels;
use dermis_learn::{Dataset, Evaluation, SampleId, evaluate, refine};
use dermis_skin::{SkinDescription, Unknowns};
use serde_json::json;

use crate::evaluate::split_of;

/// What to refine, and on what it is measured.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    #[arg(long)]
    skin: PathBuf,
    /// Model bundle; its manifest is amended.
    #[arg(long)]
    model: PathBuf,
    /// Contacts at once, at most.
    #[arg(long, default_value_t = 1)]
    contacts: usize,
    /// What is looked for in each contact.
    #[arg(long, value_enum, default_value_t = Looked::Normal)]
    unknowns: Looked,
    /// How likely forces are before a reading; `log` for skins with places where nothing gives way.
    #[arg(long, value_enum, default_value_t = Prior::Uniform)]
    force_prior: Prior,
    /// Refine whatever the recordings say, and switch it on even where the model alone is better.
    #[arg(long)]
    always: bool,
    #[command(flatten)]
    labels: Labels,
    /// One JSON object.
    #[arg(long)]
    json: bool,
    /// The labelled bags that the model was trained on.
    #[arg(required = true)]
    bags: Vec<PathBuf>,
}

/// [`Unknowns`], as the command line says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Looked {
    /// Place along x, pressing force.
    Line,
    /// Place on the surface, pressing force.
    Normal,
    /// Place on the surface, all of the force.
    Full,
}

/// [`ForcePrior`], as the command line says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Prior {
    /// Every force is as likely as any other.
    Uniform,
    /// Every ratio is as likely as any other.
    Log,
}

impl From<Prior> for ForcePrior {
    fn from(prior: Prior) -> Self {
        match prior {
            Prior::Uniform => Self::Uniform,
            Prior::Log => Self::Log,
        }
    }
}

impl From<Looked> for Unknowns {
    fn from(looked: Looked) -> Self {
        match looked {
            Looked::Line => Self::Line,
            Looked::Normal => Self::Normal,
            Looked::Full => Self::Full,
        }
    }
}

/// Measures gains on the training part, compares with and without on half of the places that were held out, and reports on
/// the other half.
pub fn run(options: &Options) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let family = crate::registry::family(&skin)?;
    let model = crate::registry::forward(&options.skin, &skin)?;
    let mut bundle = Bundle::load(&options.model, &skin)?;
    let data = Dataset::from_bags(&options.bags, &skin, &options.labels.options()?)?;
    let split = split_of(&options.model)?.apply(&data)?;
    let (choosing, reporting) = halves(&data, &split.test);
    if choosing.is_empty() || reporting.is_empty() {
        bail!("fewer than two places are held out: record more, or hold out a larger share");
    }
    let mut settings =
        refine::settings(model.as_ref(), &data, &split.train, options.unknowns.into(), options.contacts)?;
    settings.force_prior = options.force_prior.into();

    let trial = tempfile::tempdir().context("a folder for the trial cannot be made")?;
    let with = copy(&bundle, &skin, trial.path().join("with"), Some(&settings))?;
    let without = copy(&bundle, &skin, trial.path().join("without"), None)?;
    let measure = |folder: &Path, on: &[SampleId]| -> Result<Evaluation> {
        let mut estimator = (family.estimator)(&skin, &[folder.to_owned()])?;
        Ok(evaluate(estimator.as_mut(), &data, Some(on), "held out")?)
    };
    let ratio = ratio(&measure(&with, &choosing)?, &measure(&without, &choosing)?);
    let helps = ratio.is_none_or(|r| r < 1.0);
    let on = helps || options.always;
    let before = measure(&without, &reporting)?;
    let after = measure(&with, &reporting)?;

    let mut manifest = bundle.manifest().clone();
    manifest.inversion = on.then(|| settings.clone());
    let chosen = if on { &after } else { &before };
    dermis_learn::card::measured(&mut manifest, chosen);
    bundle.amend(manifest)?;
    let record = json!({
        "on": on, "ratio_on_chosen_half": ratio, "settings": settings, "before": before, "after": after,
    });
    amend_card(&options.model, &record)?;
    if options.json {
        println!("{record}");
    } else {
        tell(&settings, ratio, on, &before, &after);
    }
    Ok(())
}

/// Held-out samples by place: every other place to each half.
fn halves(data: &Dataset, held_out: &[SampleId]) -> (Vec<SampleId>, Vec<SampleId>) {
    let place = |id: &SampleId| data.sample(*id).and_then(|s| s.truth.as_ref()).map(|t| t.location);
    let places: BTreeSet<u32> = held_out.iter().filter_map(place).collect();
    let chosen: BTreeSet<u32> = places.into_iter().step_by(2).collect();
    held_out.iter().copied().partition(|id| place(id).is_some_and(|p| chosen.contains(&p)))
}

/// The bundle in another folder, with these settings.
fn copy(
    bundle: &Bundle,
    skin: &SkinDescription,
    to: PathBuf,
    settings: Option<&Settings>,
) -> Result<PathBuf> {
    std::fs::create_dir(&to).with_context(|| format!("{} cannot be made", to.display()))?;
    for entry in std::fs::read_dir(bundle.path()).with_context(|| format!("{}", bundle.path().display()))? {
        let entry = entry?;
        std::fs::copy(entry.path(), to.join(entry.file_name()))
            .with_context(|| format!("{} cannot be copied", entry.path().display()))?;
    }
    let mut copied = Bundle::load(&to, skin)?;
    let mut manifest = copied.manifest().clone();
    manifest.inversion = settings.cloned();
    copied.amend(manifest)?;
    Ok(to)
}

/// Geometric mean over the bins of force from 0.1 N on of the ratio of the errors of place, or of force where the bundle
/// gives no place; `None` where they have no bin in common.
fn ratio(with: &Evaluation, without: &Evaluation) -> Option<f64> {
    let name = if with.by_force.contains_key("position") { "position" } else { "force.normal" };
    let (a, b) = (with.by_force.get(name)?, without.by_force.get(name)?);
    let logs: Vec<f64> = a
        .iter()
        .filter(|bin| bin.from >= 0.1)
        .filter_map(|bin| {
            let other = b.iter().find(|o| o.from.to_bits() == bin.from.to_bits())?;
            let ratio = bin.rms / other.rms;
            (ratio.is_finite() && ratio > 0.0).then(|| ratio.ln())
        })
        .collect();
    (!logs.is_empty()).then(|| (logs.iter().sum::<f64>() / logs.len() as f64).exp())
}

/// Puts what was measured into the card.
fn amend_card(bundle: &Path, record: &serde_json::Value) -> Result<()> {
    let path = bundle.join("card.json");
    let text =
        std::fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
    let mut card: serde_json::Value =
        serde_json::from_str(&text).with_context(|| format!("{} is not JSON", path.display()))?;
    let object = card.as_object_mut().with_context(|| format!("{} is no object", path.display()))?;
    object.insert("inversion".into(), record.clone());
    let written = || format!("{} cannot be written", path.display());
    let scratch = tempfile::NamedTempFile::new_in(bundle).with_context(written)?;
    std::fs::write(scratch.path(), serde_json::to_string_pretty(&card)? + "\n").with_context(written)?;
    let readable = std::os::unix::fs::PermissionsExt::from_mode(0o644);
    std::fs::set_permissions(scratch.path(), readable).with_context(written)?;
    scratch.persist(&path).with_context(written)?;
    Ok(())
}

fn tell(settings: &Settings, ratio: Option<f64>, on: bool, before: &Evaluation, after: &Evaluation) {
    let (low, high) =
        settings.gains.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), g| (l.min(*g), h.max(*g)));
    println!(
        "channel gains against the forward model: {low:.3} to {high:.3}; model and device differ by {:.2} % of a signal",
        settings.model_error * 100.0
    );
    if let Some(ratio) = ratio {
        println!(
            "with the forward model the error is {ratio:.3} times that of the model alone (choosing half)"
        );
    }
    println!("refinement is {}\n", if on { "on" } else { "off: the model alone is better" });
    print!("model alone, other half: {before}\nwith the forward model, other half: {after}");
}
