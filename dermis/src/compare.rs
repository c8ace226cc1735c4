//! `dermis compare`: estimators side by side on the same held-out readings, with the bound beside them.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_inference::{Bundle, Model, Outputs, Runtime, RuntimeConfig};
use dermis_inversion::{Inverter, Reading};
use dermis_learn::cli::Labels;
use dermis_learn::{Dataset, Evaluation, Evaluator, Sample, SampleId, Truth, bounds};
use dermis_model::{ForwardModel, Indentation};
use dermis_skin::{Contact, Estimate, ForceComponents, SkinDescription, Surface};
use dermis_theory::{IsolineSolver, Press, SolverOptions};
use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};

use crate::evaluate::{split_of, unknowns};

/// What to compare on what.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    #[arg(long)]
    skin: PathBuf,
    /// Model bundle; several are compared. What was held out of the first one's training is what all are compared on.
    #[arg(long, required = true)]
    model: Vec<PathBuf>,
    /// Neighbours of the nearest-neighbour estimator.
    #[arg(long, default_value_t = 5)]
    neighbours: usize,
    /// Readings that are compared at most; of more, every n-th is taken.
    #[arg(long, default_value_t = 6000)]
    most: usize,
    /// Ascending forces [N] at which the bins of errors by force begin.
    #[arg(long, value_delimiter = ',', default_values_t = [0.02, 0.14, 0.2, 0.4, 0.6, 0.9, 1.2])]
    bins: Vec<f64>,
    /// Folder for `comparison.json` and `comparison.html`.
    #[arg(short, long)]
    out: Option<PathBuf>,
    #[command(flatten)]
    labels: Labels,
    /// One JSON object.
    #[arg(long)]
    json: bool,
    /// The labelled bags that the models were trained on.
    #[arg(required = true)]
    bags: Vec<PathBuf>,
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
    sample.tared.iter().zip(&sample.frame.flags).map(|(value, flags)| Reading::of(*value, *flags)).collect()
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
    fn new(count: usize, data: &Dataset, train: &[SampleId], components: ForceComponents) -> Self {
        let noise: Vec<f32> = data.skin().channel_noise().iter().map(|n| *n as f32).collect();
        let (mut rows, mut contacts) = (Vec::new(), Vec::new());
        for (sample, truth) in train.iter().filter_map(|id| data.sample(*id)).filter_map(labelled) {
            let Some(contact) = truth.single().filter(|c| c.force.iter().all(|v| v.is_finite())) else {
                continue;
            };
            rows.extend(whitened(sample, &noise));
            contacts.push((contact.position, contact.force));
        }
        Self { count, noise, rows, contacts, surface: data.skin().surface(), components }
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
pub fn run(options: &Options) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let forward = crate::registry::forward(&options.skin, &skin)?;
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
    let mut methods = methods(options, &skin, &forward, &data, &split.train)?;
    let progress = ProgressBar::new((methods.len() * test.len()) as u64)
        .with_style(ProgressStyle::with_template("{msg} {wide_bar} {eta} left")?);
    let mut rows: Vec<(String, Evaluation)> = Vec::new();
    for (name, method) in &mut methods {
        progress.set_message(name.clone());
        let mut evaluator = Evaluator::new().by_force(&options.bins);
        for id in &test {
            let Some((sample, truth)) = data.sample(*id).and_then(labelled) else { continue };
            let contacts = method.answer(sample, *id)?.into_iter().collect();
            evaluator.push(id.run, truth, &Estimate { contacts, ..Estimate::default() });
            progress.inc(1);
        }
        rows.push((name.clone(), evaluator.finish(name.clone())));
    }
    progress.finish_and_clear();
    let bound = rows
        .first()
        .map(|(_, first)| bounds(forward.as_ref(), &data, Some(&test), unknowns(&data, first), &options.bins))
        .transpose()?
        .flatten();
    let places: BTreeSet<u32> =
        test.iter().filter_map(|id| data.sample(*id)).filter_map(labelled).map(|(_, t)| t.location).collect();
    let record = json!({
        "skin": skin.name, "readings": test.len(), "places": places.len(), "bins_n": options.bins,
        "methods": rows.iter().map(|(name, e)| json!({ "name": name, "evaluation": e })).collect::<Vec<_>>(),
        "bound": bound,
    });
    let text = table(&skin, &record);
    if let Some(folder) = &options.out {
        std::fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
        for (file, content) in [
            ("comparison.json", serde_json::to_string_pretty(&record)? + "\n"),
            ("comparison.html", page(&skin, &text)),
        ] {
            let path = folder.join(file);
            std::fs::write(&path, content)
                .with_context(|| format!("{} cannot be written", path.display()))?;
        }
    }
    if options.json {
        println!("{record}");
    } else {
        print!("{text}");
    }
    Ok(())
}

type Named = (String, Box<dyn Method>);

fn methods(
    options: &Options,
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
    let neighbours = Neighbours::new(options.neighbours, data, train, components);
    methods.push((format!("{} nearest neighbours", options.neighbours), Box::new(neighbours)));
    let presses: Vec<Press> = train
        .iter()
        .filter_map(|id| data.sample(*id))
        .filter_map(labelled)
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

/// One table for places and one for forces.
fn table(skin: &SkinDescription, record: &Value) -> String {
    let mut out = format!(
        "{}: {} readings at {} places that nothing was trained on\n",
        skin.name, record["readings"], record["places"]
    );
    let bins: Vec<f64> =
        record["bins_n"].as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
    for (quantity, bound, unit, factor) in
        [("position", "position", "mm", 1e3), ("force.normal", "normal_force", "N", 1.0)]
    {
        let _ = write!(out, "\n{quantity} RMSE [{unit}] by force [N]\n{:<38}", "");
        for (i, from) in bins.iter().enumerate() {
            let head = bins.get(i + 1).map_or_else(|| format!("{from}+"), |to| format!("{from}-{to}"));
            let _ = write!(out, "{head:>10}");
        }
        let _ = writeln!(out, "{:>10}{:>10}", "all", "missed");
        let cells = |found: &Value| -> String {
            bins.iter().fold(String::new(), |mut line, from| {
                let bin = found.as_array().into_iter().flatten().find(|b| b["from"].as_f64() == Some(*from));
                let rms = bin.and_then(|b| b["rms"].as_f64());
                let _ = match rms {
                    Some(rms) => write!(line, "{:>10.4}", rms * factor),
                    None => write!(line, "{:>10}", "-"),
                };
                line
            })
        };
        for method in record["methods"].as_array().into_iter().flatten() {
            let evaluation = &method["evaluation"];
            let name = method["name"].as_str().unwrap_or_default();
            let all = evaluation["quantities"][quantity]["rms"].as_f64().unwrap_or(f64::NAN) * factor;
            let missed = evaluation["missed"].as_f64().unwrap_or(0.0) * 100.0;
            let _ = writeln!(
                out,
                "{name:<38}{}{all:>10.4}{missed:>8.1} %",
                cells(&evaluation["by_force"][quantity])
            );
        }
        if !record["bound"].is_null() {
            let _ = writeln!(out, "{:<38}{}", "Cramér–Rao bound", cells(&record["bound"][bound]));
        }
    }
    out
}

fn page(skin: &SkinDescription, table: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{name}: estimators compared</title>\n\
         <style>body{{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:76rem;padding:0 1rem;color:#222}}\
         pre{{background:#f4f4f2;padding:1rem;overflow-x:auto;font-size:12px}}</style></head>\n\
         <body><h1>{name}: estimators compared</h1>\n<pre>{table}</pre></body></html>\n",
        name = skin.name
    )
}
