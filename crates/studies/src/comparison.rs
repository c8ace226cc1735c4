//! Estimators side by side on the same held-out readings, with the bound beside them.
//!
//! Bundles by themselves (a network's contact, or the peaks of a map) and as a node reads them, refined on the forward model where they
//! ask for it; nearest neighbours in units of the noise, regressions that take what our
//! networks take (`regressions`), and the thesis' numeric solution by isolines answer the same frames of one contact; the Cramér–Rao bound says what is possible. All but the
//! isolines are the finders of `dermis-estimate`, which the node's estimator is made of; none judges whether something touches. Force and
//! displacement maps that come with contacts are held against the true ones by the figures of `evaluate`.
//! Bags are read in order, and a bundle whose forward model searches in pairs follows contacts from frame to frame as the node does.
//!
//! Cost: one pass over the bags for all of them, and what follows contacts also looks at the frames between the targets; neighbours look at every reading of the training part for every answer.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_estimate::finder::{RegressionFinder, finder_of, learned_finder_of};
use dermis_estimate::{ConditionedFrame, ContactFinder, FindError};
use dermis_inference::{Bundle, Runtime, RuntimeConfig};
use dermis_learn::cli::Labels;
use dermis_learn::target::Maps;
use dermis_learn::{
    Bounds, Dataset, Evaluation, Evaluator, Sample, SampleId, Truth, TruthContact, frame_bounds,
};
use dermis_model::ForwardModel;
use dermis_regress::{Method, Rows};
use dermis_skin::{Contact, Estimate, ForceComponents, SkinDescription, Surface};
use dermis_theory::{IsolineSolver, Press, SolverOptions};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use crate::evaluation::{split_of, unknowns};
use crate::regressions::{self, Learned as Presses, Most};
use crate::{Families, LeftOut, Progress, called, labelled};

/// What to compare on what.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description.
    #[arg(long)]
    pub skin: PathBuf,
    /// Model bundle; several are compared. What was held out of the first one's training is what all are compared on.
    #[arg(long, required = true)]
    pub model: Vec<PathBuf>,
    /// Neighbours of the nearest-neighbour estimator in units of the noise.
    #[arg(long, default_value_t = Request::default().neighbours)]
    pub neighbours: usize,
    /// Readings that extra trees, tuned neighbours and a Gaussian process (of more than 8,000 sparse) learn from at most; of more, every
    /// n-th is taken.
    #[arg(long, default_value_t = Request::default().learn)]
    pub learn: usize,
    /// Readings that support vectors learn from at most; 0 leaves all four out.
    #[arg(long, default_value_t = Request::default().vectors)]
    pub vectors: usize,
    /// Readings that are compared at most; of more, every n-th is taken.
    #[arg(long, default_value_t = Request::default().most)]
    pub most: usize,
    /// Ascending forces [N] at which the bins of errors by force begin.
    #[arg(long, value_delimiter = ',', default_values_t = Request::default().bins)]
    pub bins: Vec<f64>,
    /// How the bags are read.
    #[command(flatten)]
    pub labels: Labels,
    /// The labelled bags that the models were trained on.
    #[arg(required = true)]
    pub bags: Vec<PathBuf>,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            skin: PathBuf::new(),
            model: Vec::new(),
            neighbours: 5,
            learn: 30_000,
            vectors: 2500,
            most: 6000,
            bins: vec![0.02, 0.14, 0.2, 0.4, 0.6, 0.9, 1.2],
            labels: Labels::default(),
            bags: Vec::new(),
        }
    }
}

/// Everything that was found.
pub struct Findings {
    /// The skin.
    pub skin: SkinDescription,
    /// Readings that every estimator answered.
    pub readings: usize,
    /// Different locations of these.
    pub locations: usize,
    /// \[N\] at which the bins of errors by force begin.
    pub bins: Vec<f64>,
    /// Name of each estimator and what it made of them.
    pub methods: Vec<(String, Evaluation)>,
    /// What any estimator without bias could reach on these very readings.
    pub bound: Option<Bounds>,
    /// Held-out touched readings that were not compared, and why.
    pub left_out: Vec<LeftOut>,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        json!({
            "skin": self.skin.name, "readings": self.readings, "locations": self.locations, "bins_n": self.bins,
            "methods":
                self.methods.iter().map(|(name, e)| json!({ "name": name, "evaluation": e })).collect::<Vec<_>>(),
            "bound": self.bound, "left_out": self.left_out,
        })
        .serialize(serializer)
    }
}

/// The thesis' numeric solution.
struct Isolines {
    solver: Arc<IsolineSolver>,
    taxels: usize,
    surface: Surface,
}

impl ContactFinder for Isolines {
    fn find(&mut self, frame: &ConditionedFrame<'_>) -> Result<Vec<Contact>, FindError> {
        let values: Vec<f64> = frame.signal.iter().map(|v| f64::from(*v)).collect();
        let contact = self.solver.solve(&values, self.taxels).map(|solution| {
            let (position, normal) = self.surface.project(&solution.position);
            let mut contact = Contact::at(position, normal);
            contact.force = -normal * solution.force;
            contact.force_components = ForceComponents::Normal;
            contact
        });
        Ok(contact.into_iter().collect())
    }

    fn single(&self) -> bool {
        true
    }
}

/// Compares.
///
/// # Errors
///
/// Where skin, bundles or bags cannot be read, or nothing of them was held out.
pub fn compare(options: &Request, families: &Families, progress: &dyn Progress) -> Result<Findings> {
    let skin = SkinDescription::load(&options.skin)?;
    let forward = families.model_of_file(&options.skin, &skin)?;
    let data = labelled(&options.bags, &skin, &options.labels.options()?, progress)?;
    let split = split_of(&options.model[0])?.apply(&data)?;
    let least = options.bins.first().copied().context("`--bins` names no force")?;
    let clear = |id: &SampleId| {
        let truth = data.sample(*id).and_then(|s| s.truth.as_ref());
        truth.and_then(Truth::single).and_then(TruthContact::normal_force).is_some_and(|f| f >= least)
    };
    let all: Vec<SampleId> = split.test.iter().copied().filter(clear).collect();
    let test: Vec<SampleId> =
        all.iter().copied().step_by(dermis_regress::stride(all.len(), options.most)).collect();
    if test.is_empty() {
        bail!("nothing of one contact of {least} N or more was held out of these bags");
    }
    let finders = methods(options, &skin, &forward, &data, &split.train, progress)?;
    progress.begin("answering");
    let mut rows = answer(finders, &data, &test, &options.bins, Some(&forward), progress)?;
    let bound = match rows.first() {
        None => None,
        Some((_, first)) => {
            let bounds = frame_bounds(forward.as_ref(), &data, Some(&test), unknowns(&data, first))?;
            rows = rows.into_iter().map(|(name, e)| (name, e.against(&bounds, &options.bins))).collect();
            bounds.summary(&options.bins)
        }
    };
    let left_out = left_out(&data, &split.test, (&all, &test), least);
    let locations: BTreeSet<u32> =
        test.iter().filter_map(|id| Some(data.sample(*id)?.truth.as_ref()?.location)).collect();
    Ok(Findings {
        skin,
        readings: test.len(),
        locations: locations.len(),
        bins: options.bins.clone(),
        methods: rows,
        bound,
        left_out,
    })
}

/// Why touched readings that were held out are not among those that are compared: `clear` ones of one contact, `test` of these.
fn left_out(
    data: &Dataset,
    held_out: &[SampleId],
    (clear, test): (&[SampleId], &[SampleId]),
    least: f64,
) -> Vec<LeftOut> {
    let truths = || held_out.iter().filter_map(|id| data.sample(*id)?.truth.as_ref()).filter(|t| t.touched());
    let (touched, single) = (truths().count(), truths().filter(|t| t.single().is_some()).count());
    LeftOut::list(
        touched,
        &[
            (touched - single, "several contacts at once".to_owned()),
            (single - clear.len(), format!("a contact of less than {least} N, or of unknown force")),
            (clear.len() - test.len(), "only every n-th reading is compared (`--most`)".to_owned()),
        ],
    )
}

type Named = (String, Box<dyn ContactFinder>);

/// What finders make of the target frames; true displacements are those of the `forward` model. The frames between them feed the history of what looks at several, as in a node; a
/// history that is not filled yet is an answer of no contact, as there.
fn answer(
    mut finders: Vec<Named>,
    data: &Dataset,
    targets: &[SampleId],
    bins: &[f64],
    forward: Option<&Arc<dyn ForwardModel>>,
    progress: &dyn Progress,
) -> Result<Vec<(String, Evaluation)>> {
    let wanted: BTreeSet<SampleId> = targets.iter().copied().collect();
    let evaluator = |_: &Named| {
        let maps = Maps::new(data.skin(), forward.cloned(), &[])?;
        anyhow::Ok(Evaluator::of(data).by_force(bins).with_maps(maps))
    };
    let mut evaluators = finders.iter().map(evaluator).collect::<Result<Vec<_>>>()?;
    let image = finders.iter().find_map(|(_, finder)| finder.image());
    if finders.iter().filter_map(|(_, finder)| finder.image()).any(|other| Some(other) != image) {
        bail!("these bundles take images of different sizes; compare them one after the other");
    }
    let mut done = 0_usize;
    for run in 0..data.runs().len() {
        finders.iter_mut().for_each(|(_, finder)| finder.reset());
        let of_run = SampleId { run, sample: 0 }..=SampleId { run, sample: usize::MAX };
        let Some(last) = wanted.range(of_run).next_back() else { continue };
        for (sample, read) in data.stream_images(run, image)?.enumerate().take(last.sample + 1) {
            let read = read?;
            if read.tare {
                // A history with two zeros would hold a step.
                finders.iter_mut().for_each(|(_, finder)| finder.reset());
            }
            let frame = read.conditioned();
            let id = SampleId { run, sample };
            let truth = read.truth.as_ref().filter(|_| wanted.contains(&id));
            for ((_, finder), evaluator) in finders.iter_mut().zip(&mut evaluators) {
                let Some(truth) = truth else {
                    finder.pass(&frame)?;
                    continue;
                };
                let estimate = match finder.estimate(&frame) {
                    Err(FindError::History(_)) => Estimate::default(),
                    found => found?,
                };
                evaluator.push(id, truth, &estimate);
                evaluator.push_maps(truth, &estimate)?;
            }
            done += usize::from(truth.is_some());
            progress.at(done as f64 / wanted.len() as f64);
        }
    }
    let rows = finders.into_iter().zip(evaluators);
    Ok(rows.map(|((name, _), evaluator)| (name.clone(), evaluator.finish(name))).collect())
}

/// Everything that answers, with its name.
fn methods(
    options: &Request,
    skin: &SkinDescription,
    forward: &Arc<dyn ForwardModel>,
    data: &Dataset,
    train: &[SampleId],
    progress: &dyn Progress,
) -> Result<Vec<Named>> {
    let runtime = Runtime::load(&RuntimeConfig::default())?;
    let mut methods: Vec<Named> = Vec::new();
    let mut components = ForceComponents::Normal;
    for folder in &options.model {
        let bundle = Bundle::load(folder, skin)?;
        if bundle.manifest().output.values.iter().any(|v| v.name == "force.x") {
            components = ForceComponents::Full;
        }
        methods.extend(of_bundle(&called(folder), &bundle, skin, forward, runtime)?);
    }
    let learned = data.gather(train)?;
    let name = format!("{} nearest neighbours", options.neighbours);
    match neighbours(options.neighbours, skin, &learned, components)? {
        Some(finder) => methods.push((name, Box::new(finder))),
        None => progress.note(&format!(
            "{name}: left out, for the training part holds no single contact of known place and force"
        )),
    }
    if options.vectors > 0 {
        let presses = presses(skin, &learned, components, options.bins.first().copied().unwrap_or_default());
        if presses.len() == 0 {
            progress
                .note("regressions are left out: the training part holds no single contact of known force");
        } else {
            for method in Method::ALL {
                progress.begin(&format!("{}: learning", method.in_words()));
                let most = Most { all: options.learn, vectors: options.vectors };
                let (finder, _) = regressions::tuned(method, skin, &presses, most)?;
                let name = match method {
                    Method::Neighbours => "tuned nearest neighbours, direction and log-norm",
                    _ => method.in_words(),
                };
                methods.push((name.to_owned(), Box::new(finder)));
            }
        }
    }
    let solver = Arc::new(isolines(skin, &learned)?);
    for taxels in [solver.needed(), solver.needed() + 1] {
        let method = Isolines { solver: Arc::clone(&solver), taxels, surface: skin.surface() };
        methods.push((format!("isolines of {taxels} taxels"), Box::new(method)));
    }
    Ok(methods)
}

/// What a bundle gives by itself, where anything was learned, and what a node makes of it, where it is refined.
fn of_bundle(
    name: &str,
    bundle: &Bundle,
    skin: &SkinDescription,
    forward: &Arc<dyn ForwardModel>,
    runtime: &Runtime,
) -> Result<Vec<Named>> {
    let mut methods = Vec::new();
    if let Some(learned) = learned_finder_of(bundle, skin, runtime)? {
        let from = if learned.single() { "network" } else { "peaks" };
        methods.push((format!("{name}: {from}"), learned));
    }
    if bundle.manifest().inversion.is_some() {
        let refined = finder_of(bundle, skin, || Ok(Arc::clone(forward)), runtime)?;
        methods.push((format!("{name}: with forward model"), refined));
    }
    Ok(methods)
}

/// Single contacts of samples, with what was read of them.
fn single(learned: &[(SampleId, Sample)]) -> impl Iterator<Item = (&Sample, &TruthContact)> {
    learned.iter().filter_map(|(_, sample)| Some((sample, sample.truth.as_ref()?.single()?)))
}

/// What regressions learn from: readings of one contact that presses with `least` \[N\] or more, of known place and force.
fn presses(
    skin: &SkinDescription,
    learned: &[(SampleId, Sample)],
    components: ForceComponents,
    least: f64,
) -> Presses {
    let noise = skin.channel_noise();
    let mut presses = Presses::new(skin, components);
    for (sample, contact) in single(learned) {
        let Some(force) = contact.normal_force().filter(|f| *f >= least) else { continue };
        let whole = components != ForceComponents::Full || contact.components == ForceComponents::Full;
        if !whole || !contact.position.iter().all(|v| v.is_finite()) {
            continue;
        }
        let whitened = sample.tared.iter().zip(&noise);
        let row: Vec<f64> =
            whitened.map(|(v, n)| if v.is_finite() { f64::from(*v) / n } else { 0.0 }).collect();
        let location = sample.truth.as_ref().map_or(0, |t| t.location);
        presses.push(&row, contact.position, &contact.force, force, location);
    }
    presses
}

/// Mean of the contacts whose readings are nearest in units of the noise, weighted by the inverse of their distance; `None`
/// where no contact is known.
fn neighbours(
    count: usize,
    skin: &SkinDescription,
    learned: &[(SampleId, Sample)],
    components: ForceComponents,
) -> Result<Option<RegressionFinder>> {
    let noise = skin.channel_noise();
    let (mut rows, mut contacts) = (Vec::new(), Vec::new());
    for (sample, contact) in single(learned) {
        let force = match (components, contact.normal_force()) {
            (ForceComponents::Full, _) => contact.force.as_slice().to_vec(),
            (_, Some(pressing)) => vec![pressing],
            (_, None) => continue,
        };
        if contact.position.iter().chain(&force).all(|v| v.is_finite()) {
            let whitened = sample.tared.iter().zip(&noise);
            rows.extend(whitened.map(|(v, n)| if v.is_finite() { f64::from(*v) / n } else { 0.0 }));
            contacts.extend(contact.position.iter().copied().chain(force));
        }
    }
    if rows.is_empty() {
        return Ok(None);
    }
    let outputs = if components == ForceComponents::Full { 6 } else { 4 };
    let nearest = dermis_regress::Neighbours::fit_as_given(
        Rows::new(&rows, noise.len(), "readings")?,
        Rows::new(&contacts, outputs, "contacts")?,
        count,
    )?;
    let regress = move |row: &[f64]| nearest.predict(row).map_err(|e| format!("failed: {e}"));
    Ok(Some(RegressionFinder::new(skin, Box::new(regress))))
}

/// Isolines through recorded presses: along a line where the surface is thin, otherwise over the surface.
fn isolines(skin: &SkinDescription, learned: &[(SampleId, Sample)]) -> Result<IsolineSolver> {
    let presses: Vec<Press> = single(learned)
        .filter_map(|(sample, contact)| {
            Some(Press {
                position: contact.position,
                force: contact.normal_force()?,
                readings: sample.tared.iter().map(|v| f64::from(*v)).collect(),
            })
        })
        .collect();
    let surface = skin.surface();
    let middle =
        surface.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / surface.points.len().max(1) as f64;
    let thin = surface.points.iter().map(|p| (p.y - middle.y).abs()).fold(0.0, f64::max) < 1e-3;
    let noise = skin.channel_noise();
    Ok(if thin {
        let (through, along) = (Point3::from(middle), Vector3::x());
        IsolineSolver::line_of_presses(&presses, &noise, &surface, &through, &along, &SolverOptions::line())?
    } else {
        IsolineSolver::surface_of_presses(&presses, &noise, &skin.surface, &SolverOptions::surface())?
    })
}

#[cfg(test)]
mod tests;
