//! Has a bundle's answers refined on the skin's forward model, where recordings show that this helps; with `correct` on that
//! model as recorded presses correct it.
//!
//! Gains, correction and evidence are learned from the training part of the recordings. Half of the held-out locations choose
//! whether refinement is on, the other half is reported, so that the choice does not flatter the report.

mod partial;
mod prepare;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use dermis_estimate::settings_without_bundle;
use dermis_inference::{Bundle, BundleWriter, CorrectionSection, Manifest, TrainingSection};
use dermis_inversion::{Correction, ForcePrior, Search, Settings};
use dermis_learn::cli::Labels;
use dermis_learn::refine::Learned;
use dermis_learn::target::Maps;
use dermis_learn::{Bin, Dataset, Evaluation, Evaluator, FORCE_BINS, SampleId, SplitConfig, evaluate_parts};
use dermis_model::Unknowns;
use dermis_skin::SkinDescription;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use self::partial::{DONE, Done, interrupted, key};
use self::prepare::prepare;
use crate::evaluation::split_of;
use crate::{Families, Progress, labelled};

/// What to refine, and on what it is measured.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description.
    #[arg(long)]
    pub skin: PathBuf,
    /// Model bundle; its manifest is amended.
    #[arg(long)]
    pub model: PathBuf,
    /// Without a network: contacts are found on the skin's forward model alone, as a node does it that has no bundle, with what the
    /// recordings tell of that model. The bundle is made where there is none yet.
    #[arg(long, conflicts_with_all = ["contacts", "unknowns", "force_prior", "distance", "search", "correct"])]
    pub invert: bool,
    /// Contacts at once, at most.
    #[arg(long, default_value_t = Request::default().contacts)]
    pub contacts: usize,
    /// What is looked for in each contact.
    #[arg(long, value_enum, default_value_t = Request::default().unknowns)]
    pub unknowns: UnknownsChoice,
    /// How likely forces are before a reading; `log` for skins with locations where nothing gives way.
    #[arg(long, value_enum, default_value_t = Request::default().force_prior)]
    pub force_prior: ForcePriorChoice,
    /// Distance [m] that contacts are apart at least, where there are several.
    #[arg(long, default_value_t = Request::default().distance)]
    pub distance: f64,
    /// How several contacts are looked for: one after the other, or the first two among all pairs of locations, for skins whose elements
    /// are few and feel half of the surface each; or near what is known already, for skins whose elements tell every place from every other.
    #[arg(long, value_enum, default_value_t = Request::default().search)]
    pub search: SearchChoice,
    /// Learn, from the recorded single contacts, how the device differs from its forward model as a function of place and force,
    /// and refine on the corrected model. Writes `correction.json` into the bundle.
    #[arg(long)]
    pub correct: bool,
    /// Refine whatever the recordings say, and switch it on even where the model alone is better.
    #[arg(long)]
    pub always: bool,
    /// How the bags are read.
    #[command(flatten)]
    pub labels: Labels,
    /// The labelled bags that the model was trained on, or that it shall be made of.
    #[arg(required = true)]
    pub bags: Vec<PathBuf>,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            skin: PathBuf::new(),
            model: PathBuf::new(),
            invert: false,
            contacts: 1,
            unknowns: UnknownsChoice::Normal,
            force_prior: ForcePriorChoice::Uniform,
            distance: 0.002,
            search: SearchChoice::Greedy,
            correct: false,
            always: false,
            labels: Labels::default(),
            bags: Vec::new(),
        }
    }
}

/// [`Unknowns`], as the command line says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UnknownsChoice {
    /// Place along x, pressing force.
    Line,
    /// Place on the surface, pressing force.
    Normal,
    /// Place on the surface, all of the force.
    Full,
}

/// [`ForcePrior`], as the command line says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ForcePriorChoice {
    /// Every force is as likely as any other.
    Uniform,
    /// Every ratio is as likely as any other.
    Log,
}

/// [`Search`], as the command line says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SearchChoice {
    /// One after the other.
    Greedy,
    /// The first two among all pairs of locations.
    Pairs,
    /// Near those of the frame before, or what the model says, as long as that explains the readings.
    Near,
}

impl From<SearchChoice> for Search {
    fn from(how: SearchChoice) -> Self {
        match how {
            SearchChoice::Greedy => Self::Greedy,
            SearchChoice::Pairs => Self::Pairs,
            SearchChoice::Near => Self::Near,
        }
    }
}

impl From<ForcePriorChoice> for ForcePrior {
    fn from(prior: ForcePriorChoice) -> Self {
        match prior {
            ForcePriorChoice::Uniform => Self::Uniform,
            ForcePriorChoice::Log => Self::Log,
        }
    }
}

impl From<UnknownsChoice> for Unknowns {
    fn from(looked: UnknownsChoice) -> Self {
        match looked {
            UnknownsChoice::Line => Self::Line,
            UnknownsChoice::Normal => Self::Normal,
            UnknownsChoice::Full => Self::Full,
        }
    }
}

/// Measures gains on the training part, compares with and without on half of the locations that were held out, and reports on
/// the other half.
///
/// # Errors
///
/// Where skin, bundle or bags cannot be read or the bundle cannot be written, too little was held out, or it was interrupted.
pub fn refine_bundle(options: &Request, families: &Families, bar: &dyn Progress) -> Result<Findings> {
    let skin = SkinDescription::load(&options.skin)?;
    let model = families.model_of_file(&options.skin, &skin)?;
    let unmeasured = options.invert.then(|| settings_without_bundle(&skin, model.as_ref()));
    let to_make = unmeasured.as_ref().filter(|_| !options.model.join(Bundle::MANIFEST).exists());
    if to_make.is_none() {
        // What cannot be refined is refused before hours of recordings are read.
        check_kind(&Bundle::load(&options.model, &skin)?, options.invert)?;
    }
    bar.begin("reading what was recorded");
    let data = labelled(&options.bags, &skin, &options.labels.options()?, bar)?;
    if let Some(settings) = to_make {
        make_without_network(&options.model, &skin, settings, &data)?;
    }
    let mut bundle = Bundle::load(&options.model, &skin)?;
    let split = split_of(&options.model)?.apply(&data)?;
    let (choosing, reporting) = halves(&data, &split.test);
    if choosing.is_empty() || reporting.is_empty() {
        bail!("fewer than two locations are held out: record more, or hold out a larger share");
    }
    let mut done = Done::of(&options.model, key(options, &bundle, &data));
    if done.refinement.is_none() {
        let model = Arc::clone(&model);
        done.refinement = prepare(options, unmeasured.as_ref(), model, &data, &split.train, bar)?;
        done.keep()?;
    }
    let Some(refinement) = done.refinement.clone() else { return Err(interrupted(&done)) };

    let trial = tempfile::tempdir().context("a folder for the trial cannot be made")?;
    let with = copy(&bundle, &skin, trial.path().join("with"), Some(&refinement), unmeasured.as_ref())?;
    let without = copy(&bundle, &skin, trial.path().join("without"), None, unmeasured.as_ref())?;
    let measure = |folder: &Path, what: &str| -> Result<Option<[Evaluation; 2]>> {
        bar.begin(what);
        let mut estimator = families.estimator(&skin, &[folder.to_owned()])?;
        let part = |half| -> Result<_> {
            // Maps that nobody can know here are not compared.
            let maps = Maps::new(&skin, Some(Arc::clone(&model)), &[])?;
            Ok((Evaluator::of(&data).by_force(&FORCE_BINS).with_maps(maps), "held out", half))
        };
        let parts = vec![part(choosing.as_slice())?, part(reporting.as_slice())?];
        let found = evaluate_parts(estimator.as_mut(), &data, parts, &|share| bar.at(share))?;
        Ok(found.and_then(|all| all.try_into().ok()))
    };
    if done.without.is_none() {
        let what = if options.invert { "the forward model as it was" } else { "the model alone" };
        done.without = measure(&without, what)?;
        done.keep()?;
    }
    if done.with.is_none() {
        let what = if options.invert { "the forward model as recorded" } else { "with the forward model" };
        done.with = measure(&with, what)?;
        done.keep()?;
    }
    let (Some([chosen_without, before]), Some([chosen_with, after])) = (&done.without, &done.with) else {
        return Err(interrupted(&done));
    };
    let ratio = ratio(chosen_with, chosen_without);
    let helps = ratio.is_none_or(|r| r < 1.0);
    let on = helps || options.always;

    let mut manifest = bundle.manifest().clone();
    let chosen_refinement = on.then_some(&refinement);
    refined(&mut manifest, chosen_refinement, unmeasured.as_ref());
    let chosen = if on { after } else { before };
    dermis_learn::card::measured(&mut manifest, chosen);
    bundle.amend(manifest, chosen_refinement.and_then(Refinement::correction))?;
    let findings = Findings {
        has_network: !options.invert,
        refinement: refinement.clone(),
        ratio,
        on,
        before: before.clone(),
        after: after.clone(),
    };
    amend_card(&options.model, &serde_json::to_value(&findings)?)?;
    done.forget()?;
    Ok(findings)
}

/// What refinement does to a bundle's errors.
pub struct Findings {
    /// Whether the forward model refines what a network says; it is all that there is otherwise.
    pub has_network: bool,
    /// Settings, and the correction where there is one.
    pub refinement: Refinement,
    /// Error with the forward model over that of the model alone, on the half that is chosen by.
    pub ratio: Option<f64>,
    /// Whether it is switched on.
    pub on: bool,
    /// Of the reported half, by the model alone.
    pub before: Evaluation,
    /// Of the same half, with the forward model.
    pub after: Evaluation,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        json!({
            "on": self.on, "ratio_on_chosen_half": self.ratio, "settings": self.refinement.settings,
            "before": self.before, "after": self.after,
            "correction": self.refinement.correction.as_ref().map(|(learned, _)| json!({
                "length_m": learned.settings.length, "ridge": learned.settings.ridge,
                "powers": learned.settings.powers, "presses": learned.presses,
                "left_without_in_noise": learned.left[0], "left_with_in_noise": learned.left[1],
            })),
        })
        .serialize(serializer)
    }
}

/// Makes a bundle that finds contacts on the skin's forward model alone, as a node does it that has none, and holds out what a trained one would.
fn make_without_network(
    folder: &Path,
    skin: &SkinDescription,
    settings: &Settings,
    data: &Dataset,
) -> Result<()> {
    let split = SplitConfig::default();
    let training = TrainingSection {
        data_hash: data.hash(),
        seed: split.seed,
        samples: split.apply(data)?.train.len() as u64,
        held_out: split.describe(),
    };
    let mut manifest = Manifest::of_inversion(&skin.name, skin, settings.clone(), training);
    manifest.description = "contacts by inversion of the skin's forward model; nothing was learned".into();
    let mut writer = BundleWriter::new(manifest);
    writer.card = dermis_learn::card::of_data(data)?;
    writer.card.insert("split".into(), serde_json::to_value(split)?);
    Ok(writer.write(folder, &[])?)
}

/// Refuses a bundle with a network where one without is requested, and the other way round.
fn check_kind(bundle: &Bundle, invert: bool) -> Result<()> {
    let (what, how) = match (bundle.manifest().model.is_some(), invert) {
        (true, true) => ("has a network", "leave out `--invert`, or choose another folder"),
        (false, false) => ("has no network", "say `--invert`"),
        _ => return Ok(()),
    };
    bail!("model bundle {}: {what}; {how}", bundle.path().display())
}

/// What recordings tell of the forward model.
#[derive(Clone, Serialize, Deserialize)]
pub struct Refinement {
    /// Of the inverter.
    pub settings: Settings,
    /// How the device differs from its model, and the hash of the recordings behind it.
    pub correction: Option<(Learned, String)>,
}

impl Refinement {
    fn correction(&self) -> Option<Correction> {
        self.correction.as_ref().map(|(learned, _)| learned.correction.clone())
    }
}

/// Has a manifest speak of a refinement, or of none; without a network, of what is used where nobody measured anything.
fn refined(manifest: &mut Manifest, refinement: Option<&Refinement>, unmeasured: Option<&Settings>) {
    manifest.inversion = refinement.map(|r| &r.settings).or(unmeasured).cloned();
    manifest.correction =
        refinement.and_then(|r| r.correction.as_ref()).map(|(learned, data_hash)| CorrectionSection {
            data_hash: data_hash.clone(),
            presses: learned.presses as u64,
            left: learned.left,
            ..CorrectionSection::default()
        });
}

/// Held-out samples by place: every other place to each half.
fn halves(data: &Dataset, held_out: &[SampleId]) -> (Vec<SampleId>, Vec<SampleId>) {
    let location = |id: &SampleId| data.sample(*id).and_then(|s| s.truth.as_ref()).map(|t| t.location);
    let locations: BTreeSet<u32> = held_out.iter().filter_map(location).collect();
    let chosen: BTreeSet<u32> = locations.into_iter().step_by(2).collect();
    held_out.iter().copied().partition(|id| location(id).is_some_and(|p| chosen.contains(&p)))
}

/// The bundle in another folder, refined like this.
fn copy(
    bundle: &Bundle,
    skin: &SkinDescription,
    to: PathBuf,
    refinement: Option<&Refinement>,
    unmeasured: Option<&Settings>,
) -> Result<PathBuf> {
    std::fs::create_dir(&to).with_context(|| format!("{} cannot be made", to.display()))?;
    for entry in std::fs::read_dir(bundle.path()).with_context(|| format!("{}", bundle.path().display()))? {
        let entry = entry?;
        if entry.file_name() == DONE {
            continue;
        }
        std::fs::copy(entry.path(), to.join(entry.file_name()))
            .with_context(|| format!("{} cannot be copied", entry.path().display()))?;
    }
    let mut copied = Bundle::load(&to, skin)?;
    let mut manifest = copied.manifest().clone();
    refined(&mut manifest, refinement, unmeasured);
    copied.amend(manifest, refinement.and_then(Refinement::correction))?;
    Ok(to)
}

/// Geometric mean over the bins of force from 0.1 N on of the ratio of the errors of place, or of force where the bundle
/// gives no place, or over the maps of touched frames where it gives neither; `None` where they have nothing in common.
fn ratio(with: &Evaluation, without: &Evaluation) -> Option<f64> {
    let name = if with.by_force.contains_key("position") { "position" } else { "force.normal" };
    let pairs: Vec<(f64, f64)> = match (with.by_force.get(name), without.by_force.get(name)) {
        (Some(a), Some(b)) => {
            let heavy = a.iter().filter(|bin| bin.from >= 0.1);
            let same = |bin: &Bin| b.iter().find(|o| o.from.to_bits() == bin.from.to_bits());
            heavy.filter_map(|bin| Some((bin.rms, same(bin)?.rms))).collect()
        }
        _ => {
            let other = |name| without.maps.get(name)?.touched.rms;
            with.maps.iter().filter_map(|(name, map)| Some((map.touched.rms?, other(name)?))).collect()
        }
    };
    let logs = pairs.into_iter().map(|(a, b)| (a / b).ln()).filter(|log| log.is_finite());
    let logs: Vec<f64> = logs.collect();
    (!logs.is_empty()).then(|| (logs.iter().sum::<f64>() / logs.len() as f64).exp())
}

/// Puts what was measured into the card.
fn amend_card(bundle: &Path, record: &serde_json::Value) -> Result<()> {
    let path = bundle.join("card.json");
    let text = dermis_io::read_text(&path, dermis_io::REPORT)
        .with_context(|| format!("{} cannot be read", path.display()))?;
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

#[cfg(test)]
mod tests;
