//! Estimators side by side on the same held-out readings, with the bound beside them.
//!
//! Networks of bundles, the same refined on the forward model, nearest neighbours in units of the noise, and the thesis'
//! numeric solution by isolines answer the same frames of one contact; the Cramér–Rao bound says what is possible.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_estimate::finder;
use dermis_inference::{Bundle, Model, Outputs, Runtime, RuntimeConfig};
use dermis_inversion::{Inverter, Reading};
use dermis_learn::cli::Labels;
use dermis_learn::{Bounds, Dataset, Evaluation, Evaluator, Sample, SampleId, Truth, bounds};
use dermis_model::{ForwardModel, Indentation};
use dermis_skin::{Contact, Estimate, ForceComponents, SkinDescription, Surface};
use dermis_theory::{IsolineSolver, Press, SolverOptions};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use crate::evaluation::{split_of, unknowns};
use crate::{Families, Progress};

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
    /// Neighbours of the nearest-neighbour estimator.
    #[arg(long, default_value_t = Request::default().neighbours)]
    pub neighbours: usize,
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
    /// Different places of these.
    pub places: usize,
    /// \[N\] at which the bins of errors by force begin.
    pub bins: Vec<f64>,
    /// Name of each estimator and what it made of them.
    pub methods: Vec<(String, Evaluation)>,
    /// What any estimator without bias could reach.
    pub bound: Option<Bounds>,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        json!({
            "skin": self.skin.name, "readings": self.readings, "places": self.places, "bins_n": self.bins,
            "methods":
                self.methods.iter().map(|(name, e)| json!({ "name": name, "evaluation": e })).collect::<Vec<_>>(),
            "bound": self.bound,
        })
        .serialize(serializer)
    }
}

/// Something that answers one reading.
trait Method {
    fn answer(&mut self, sample: &Sample, id: SampleId) -> Result<Option<Contact>>;
}

/// A network by itself, and refined where its bundle says so.
struct Learned {
    model: Model,
    outputs: Outputs,
    inputs: std::collections::BTreeMap<SampleId, Vec<f32>>,
    surface: Surface,
    flat: bool,
    inverter: Option<Inverter>,
}

impl Learned {
    fn new(bundle: &Bundle, skin: &SkinDescription, data: &Dataset, runtime: &Runtime) -> Result<Self> {
        let (ids, rows) = data.inputs(&bundle.manifest().input, bundle.manifest().baseline)?;
        let width = bundle.manifest().input.input_len();
        let inputs = ids.into_iter().zip(rows.chunks_exact(width).map(<[f32]>::to_vec)).collect();
        Ok(Self {
            model: bundle.session(runtime)?,
            outputs: bundle.outputs(),
            inputs,
            surface: skin.surface(),
            flat: matches!(skin.surface, dermis_skin::SurfaceSpec::Rectangle { .. }),
            inverter: None,
        })
    }

    fn network(&mut self, id: SampleId) -> Result<Option<Contact>> {
        let Some(input) = self.inputs.get(&id) else { return Ok(None) };
        let mut raw = Vec::new();
        self.model.run(input, &mut raw)?;
        self.outputs.decode(&raw)?;
        let get = |name: &str| self.outputs.get(name);
        let (Some(x), Some(y)) = (get("position.x"), get("position.y")) else { return Ok(None) };
        let z = if self.flat { 0.0 } else { get("position.z").unwrap_or(f64::NAN) };
        let (position, normal) = self.surface.project(&Point3::new(x, y, z));
        let mut contact = Contact::at(position, normal);
        if let Some(force) = self.outputs.force() {
            contact.force = Vector3::from(force);
            contact.force_components = ForceComponents::Full;
        } else if let Some(pressing) = self.outputs.normal_force() {
            contact.force = -normal * pressing;
            contact.force_components = ForceComponents::Normal;
        }
        Ok(Some(contact))
    }
}

/// Readings of a sample, as an inverter takes them.
fn readings(sample: &Sample) -> Vec<Reading> {
    finder::readings(&sample.tared, &sample.frame.flags).collect()
}

impl Method for Learned {
    fn answer(&mut self, sample: &Sample, id: SampleId) -> Result<Option<Contact>> {
        let Some(learned) = self.network(id)? else { return Ok(None) };
        let Some(inverter) = &self.inverter else { return Ok(Some(learned)) };
        let pressing = learned.normal_force();
        let hint = (pressing > 0.0).then_some(Indentation::sphere(
            learned.position,
            learned.force,
            inverter.settings().diameter,
        ));
        let found = inverter.solve(&readings(sample), hint.as_ref())?.contacts.into_iter().next();
        Ok(Some(found.map_or(learned, |found| {
            let mut contact = Contact::at(found.position, found.normal);
            contact.force = found.force;
            contact.force_components = inverter.settings().unknowns.force_components();
            contact
        })))
    }
}

/// Mean of the contacts whose readings are nearest, weighted by the inverse of their distance.
struct Neighbours {
    count: usize,
    noise: Vec<f32>,
    rows: Vec<f32>,
    contacts: Vec<(Point3<f64>, Vector3<f64>)>,
    surface: Surface,
    components: ForceComponents,
}

impl Neighbours {
    fn new(count: usize, data: &Dataset, train: &[SampleId], components: ForceComponents) -> Result<Self> {
        let noise: Vec<f32> = data.skin().channel_noise().iter().map(|n| *n as f32).collect();
        let (mut rows, mut contacts) = (Vec::new(), Vec::new());
        let train = data.gather(train)?;
        for (sample, truth) in train.iter().filter_map(|(_, sample)| labelled(sample)) {
            let Some(contact) = truth.single().filter(|c| c.force.iter().all(|v| v.is_finite())) else {
                continue;
            };
            rows.extend(whitened(sample, &noise));
            contacts.push((contact.position, contact.force));
        }
        Ok(Self { count, noise, rows, contacts, surface: data.skin().surface(), components })
    }
}

fn labelled(sample: &Sample) -> Option<(&Sample, &Truth)> {
    Some((sample, sample.truth.as_ref()?))
}

/// In units of the noise; what is missing is 0.
fn whitened<'a>(sample: &'a Sample, noise: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
    sample.tared.iter().zip(noise).map(|(v, n)| if v.is_finite() { v / n } else { 0.0 })
}

impl Method for Neighbours {
    fn answer(&mut self, sample: &Sample, _: SampleId) -> Result<Option<Contact>> {
        let row: Vec<f32> = whitened(sample, &self.noise).collect();
        let mut nearest: Vec<(f32, usize)> = Vec::with_capacity(self.count + 1);
        for (index, other) in self.rows.chunks_exact(row.len()).enumerate() {
            let distance: f32 = row.iter().zip(other).map(|(a, b)| (a - b) * (a - b)).sum();
            if nearest.len() < self.count || nearest.last().is_some_and(|(worst, _)| distance < *worst) {
                let at = nearest.partition_point(|(d, _)| *d < distance);
                nearest.insert(at, (distance, index));
                nearest.truncate(self.count);
            }
        }
        let (mut place, mut force, mut total) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        for (distance, index) in nearest {
            let weight = 1.0 / f64::from(distance.max(1e-6).sqrt());
            place += self.contacts[index].0.coords * weight;
            force += self.contacts[index].1 * weight;
            total += weight;
        }
        if total == 0.0 {
            return Ok(None);
        }
        let (position, normal) = self.surface.project(&Point3::from(place / total));
        let mut contact = Contact::at(position, normal);
        contact.force = force / total;
        if self.components == ForceComponents::Normal {
            contact.force = normal * contact.force.dot(&normal);
        }
        contact.force_components = self.components;
        Ok(Some(contact))
    }
}

/// The thesis' numeric solution.
struct Isolines {
    solver: Arc<IsolineSolver>,
    taxels: usize,
    surface: Surface,
}

impl Method for Isolines {
    fn answer(&mut self, sample: &Sample, _: SampleId) -> Result<Option<Contact>> {
        let values: Vec<f64> = sample.tared.iter().map(|v| f64::from(*v)).collect();
        Ok(self.solver.solve(&values, self.taxels).map(|solution| {
            let (position, normal) = self.surface.project(&solution.position);
            let mut contact = Contact::at(position, normal);
            contact.force = -normal * solution.force;
            contact.force_components = ForceComponents::Normal;
            contact
        }))
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
    let data = Dataset::from_bags(&options.bags, &skin, &options.labels.options()?)?;
    let split = split_of(&options.model[0])?.apply(&data)?;
    let least = options.bins.first().copied().context("`--bins` names no force")?;
    let clear = |id: &SampleId| {
        let truth = data.sample(*id).and_then(|s| s.truth.as_ref());
        truth
            .and_then(Truth::single)
            .and_then(dermis_learn::TruthContact::normal_force)
            .is_some_and(|f| f >= least)
    };
    let all: Vec<SampleId> = split.test.iter().copied().filter(clear).collect();
    let test: Vec<SampleId> = all.iter().copied().step_by(all.len().div_ceil(options.most).max(1)).collect();
    if test.is_empty() {
        bail!("nothing of one contact of {least} N or more was held out of these bags");
    }
    let asked = data.gather(&test)?;
    let mut methods = methods(options, &skin, &forward, &data, &split.train)?;
    let mut rows: Vec<(String, Evaluation)> = Vec::new();
    for (name, method) in &mut methods {
        progress.begin(name);
        let mut evaluator = Evaluator::new().by_force(&options.bins);
        for (n, (id, sample)) in asked.iter().enumerate() {
            let Some((sample, truth)) = labelled(sample) else { continue };
            let contacts = method.answer(sample, *id)?.into_iter().collect();
            evaluator.push(id.run, truth, &Estimate { contacts, ..Estimate::default() });
            progress.at((n + 1) as f64 / test.len() as f64);
        }
        rows.push((name.clone(), evaluator.finish(name.clone())));
    }
    let bound = rows
        .first()
        .map(|(_, first)| bounds(forward.as_ref(), &data, Some(&test), unknowns(&data, first), &options.bins))
        .transpose()?
        .flatten();
    let places: BTreeSet<u32> =
        asked.iter().filter_map(|(_, sample)| labelled(sample)).map(|(_, t)| t.location).collect();
    Ok(Findings {
        skin,
        readings: test.len(),
        places: places.len(),
        bins: options.bins.clone(),
        methods: rows,
        bound,
    })
}

type Named = (String, Box<dyn Method>);

fn methods(
    options: &Request,
    skin: &SkinDescription,
    forward: &Arc<dyn ForwardModel>,
    data: &Dataset,
    train: &[SampleId],
) -> Result<Vec<Named>> {
    let runtime = Runtime::load(&RuntimeConfig::default())?;
    let mut methods: Vec<Named> = Vec::new();
    let mut components = ForceComponents::Normal;
    for folder in &options.model {
        let bundle = Bundle::load(folder, skin)?;
        let name =
            folder.file_name().map_or_else(|| folder.display().to_string(), |n| n.to_string_lossy().into());
        if bundle.manifest().output.values.iter().any(|v| v.name == "force.x") {
            components = ForceComponents::Full;
        }
        methods.push((format!("{name}: network"), Box::new(Learned::new(&bundle, skin, data, runtime)?)));
        if let Some(settings) = &bundle.manifest().inversion {
            let mut refined = Learned::new(&bundle, skin, data, runtime)?;
            refined.inverter = Some(Inverter::new(Arc::clone(forward), settings.clone())?);
            methods.push((format!("{name}: with forward model"), Box::new(refined)));
        }
    }
    let neighbours = Neighbours::new(options.neighbours, data, train, components)?;
    methods.push((format!("{} nearest neighbours", options.neighbours), Box::new(neighbours)));
    let presses: Vec<Press> = data
        .gather(train)?
        .iter()
        .filter_map(|(_, sample)| labelled(sample))
        .filter_map(|(sample, truth)| {
            let contact = truth.single()?;
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
    let solver = if thin {
        let (through, along) = (Point3::from(middle), Vector3::x());
        IsolineSolver::line_of_presses(&presses, &noise, &surface, &through, &along, &SolverOptions::line())?
    } else {
        IsolineSolver::surface_of_presses(&presses, &noise, &skin.surface, &SolverOptions::surface())?
    };
    let solver = Arc::new(solver);
    for taxels in [solver.needed(), solver.needed() + 1] {
        let method = Isolines { solver: Arc::clone(&solver), taxels, surface: surface.clone() };
        methods.push((format!("isolines of {taxels} taxels"), Box::new(method)));
    }
    Ok(methods)
}
