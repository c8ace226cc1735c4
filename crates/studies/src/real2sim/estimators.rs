//! Ways from readings to contacts.

use std::sync::Arc;

use anyhow::{Result, bail};
use dermis_estimate::finder;
use dermis_inference::{Bundle, Features, MAP_DISPLACEMENT, MapContacts, Model, Outputs, Runtime};
use dermis_inversion::{Found, Inverter, Reading, SparseSettings};
use dermis_learn::Sample;
use dermis_learn::real2sim::Recorded;
use dermis_learn::train::{Batch, Mlp, NetworkConfig, TrainingConfig, fit};
use dermis_model::{ForwardModel, Indentation};
use dermis_regress::{Neighbours, Rows, Svr, SvrSettings};
use dermis_skin::{Contact, ForceComponents, SkinDescription, Surface};
use nalgebra::Point3;

/// Something that finds contacts in one sample.
pub trait Method {
    /// The contacts of a sample.
    fn contacts(&mut self, sample: &Sample) -> Result<Vec<Contact>>;

    /// Whether it answers with one contact, whatever touches.
    fn single(&self) -> bool {
        false
    }
}

/// Readings of a sample, as an inverter takes them.
fn readings(sample: &Sample) -> Vec<Reading> {
    finder::readings(&sample.tared, &sample.frame.flags).collect()
}

fn contact(found: &Found) -> Contact {
    finder::inverted(found, ForceComponents::Normal)
}

/// Peaks of the map of a bundle.
pub struct Peaks {
    features: Features,
    model: Model,
    outputs: Outputs,
    reader: MapContacts,
    raw: Vec<f32>,
}

impl Peaks {
    pub fn new(bundle: &Bundle, surface: &Surface, runtime: &Runtime) -> Result<Self> {
        let Some(reader) = MapContacts::of(bundle, surface, runtime)? else {
            bail!(
                "model bundle {}: bundle.toml has no `[peaks]`: train one with `dermis real2sim train`",
                bundle.path().display()
            );
        };
        let (model, outputs) = (bundle.session(runtime)?, bundle.outputs());
        Ok(Self { features: bundle.features(), model, outputs, reader, raw: Vec::new() })
    }

    /// The map \[m\] of a sample.
    pub fn map(&mut self, sample: &Sample) -> Result<&[f64]> {
        self.features.reset();
        self.features.push(sample.frame.stamp, &sample.tared)?;
        let Some(input) = self.features.input() else {
            bail!("the bundle wants a history of frames, where this compares frame by frame")
        };
        self.model.run(input, &mut self.raw)?;
        self.outputs.decode(&self.raw)?;
        Ok(self.outputs.values(MAP_DISPLACEMENT).unwrap_or_default())
    }
}

impl Method for Peaks {
    fn contacts(&mut self, sample: &Sample) -> Result<Vec<Contact>> {
        let map = self.map(sample)?.to_vec();
        Ok(self.reader.contacts(&map)?)
    }
}

/// Greedy maximum likelihood on a forward model.
pub struct Likely(pub Inverter);

impl Method for Likely {
    fn contacts(&mut self, sample: &Sample) -> Result<Vec<Contact>> {
        Ok(self.0.solve(&readings(sample), None)?.contacts.iter().map(contact).collect())
    }
}

/// Maximum likelihood on a forward model that begins at the best of all pairs.
pub struct Searched(pub Inverter);

impl Method for Searched {
    fn contacts(&mut self, sample: &Sample) -> Result<Vec<Contact>> {
        Ok(self.0.search(&readings(sample))?.contacts.iter().map(contact).collect())
    }
}

/// Where a refinement begins.
pub enum Begin {
    /// At what another method finds.
    Other(Box<dyn Method>),
    /// At a sparse recovery.
    Sparse(SparseSettings),
}

/// Maximum likelihood on a forward model, refined from somewhere.
pub struct Refined {
    pub inverter: Inverter,
    pub begin: Begin,
}

impl Method for Refined {
    fn contacts(&mut self, sample: &Sample) -> Result<Vec<Contact>> {
        let readings = readings(sample);
        let starts: Vec<Indentation> = match &mut self.begin {
            Begin::Sparse(settings) => self.inverter.sparse(&readings, settings)?,
            Begin::Other(method) => {
                let diameter = self.inverter.settings().diameter;
                let at = |c: Contact| Indentation::sphere(c.position, c.force, diameter);
                method.contacts(sample)?.into_iter().map(at).collect()
            }
        };
        if starts.is_empty() {
            return Ok(Vec::new());
        }
        Ok(self.inverter.refine(&readings, &starts)?.contacts.iter().map(contact).collect())
    }
}

/// Sparse recovery by itself.
pub struct Sparse {
    pub inverter: Inverter,
    pub settings: SparseSettings,
}

impl Method for Sparse {
    fn contacts(&mut self, sample: &Sample) -> Result<Vec<Contact>> {
        let surface = self.inverter.surface();
        let found = self.inverter.sparse(&readings(sample), &self.settings)?;
        let as_contact = |c: Indentation| {
            let (position, normal) = surface.project(&c.position);
            let mut contact = Contact::at(position, normal);
            contact.force = c.force;
            contact.force_components = ForceComponents::Normal;
            contact
        };
        Ok(found.into_iter().map(as_contact).collect())
    }
}

/// Regression of x, y, z \[m\] and the pressing force \[N\] of one contact.
enum Regression {
    Vectors {
        place: Box<Svr>,
        force: Box<Svr>,
    },
    /// One for each of x, y, z and the force.
    Tuned(Box<[Svr; 4]>),
    Neighbours(Neighbours),
    Network {
        net: Mlp,
        scales: [f32; 2],
    },
}

/// One contact by regression from readings.
pub struct Direct {
    regression: Regression,
    /// Of every channel: what readings are divided by.
    noise: Vec<f64>,
    surface: Surface,
}

/// Neighbours of the thesis.
const NEIGHBOURS: usize = 6;
/// Presses that settings are tried with at most, to learn from and to ask.
const TRIED: usize = 800;

/// γ, C and ε of support vectors that are tried.
fn grid() -> impl Iterator<Item = (f64, f64, f64)> {
    let gammas = [0.3, 1.0, 3.0, 10.0].into_iter();
    gammas.flat_map(|g| [3.0, 30.0, 300.0].map(|c| (g, c))).flat_map(|(g, c)| [1e-3, 1e-2].map(|e| (g, c, e)))
}

impl Direct {
    fn new(regression: Regression, skin: &SkinDescription) -> Self {
        Self { regression, noise: skin.channel_noise(), surface: skin.surface() }
    }

    /// Tables of whitened readings and of places and forces.
    fn tables(skin: &SkinDescription, recorded: &[Recorded]) -> (Vec<f64>, Vec<f64>) {
        let noise = skin.channel_noise();
        let (mut inputs, mut targets) = (Vec::new(), Vec::new());
        for press in recorded {
            inputs.extend(press.signal.iter().zip(&noise).map(|(v, n)| f64::from(*v) / n));
            let p = press.contact.position;
            targets.extend([p.x, p.y, p.z, press.contact.force.norm()]);
        }
        (inputs, targets)
    }

    /// Support vectors, each coordinate and the force for itself; of more than `most` presses every n-th is learned from.
    pub fn vectors(skin: &SkinDescription, recorded: &[Recorded], most: usize) -> Result<Self> {
        let step = recorded.len().div_ceil(most.max(1)).max(1);
        let some: Vec<Recorded> = recorded.iter().step_by(step).cloned().collect();
        let (inputs, targets) = Self::tables(skin, &some);
        let places: Vec<f64> = targets.chunks_exact(4).flat_map(|t| [t[0], t[1], t[2]]).collect();
        let forces: Vec<f64> = targets.chunks_exact(4).map(|t| t[3]).collect();
        let inputs = Rows::new(&inputs, skin.channels().len(), "readings")?;
        // Metres and newtons are scaled for themselves: outputs of one fit share a tube.
        let place = Svr::fit(inputs, Rows::new(&places, 3, "places")?, &SvrSettings::default())?;
        let force = Svr::fit(inputs, Rows::new(&forces, 1, "forces")?, &SvrSettings::default())?;
        let (place, force) = (Box::new(place), Box::new(force));
        Ok(Self::new(Regression::Vectors { place, force }, skin))
    }

    /// Support vectors, x, y, z and the force each with the settings of the least error on `choose`, which are returned, too. Of
    /// more than `most` presses every n-th is learned from, and fewer while settings are tried.
    pub fn tuned_vectors(
        skin: &SkinDescription,
        learn: &[Recorded],
        choose: &[Recorded],
        most: usize,
    ) -> Result<(Self, [SvrSettings; 4])> {
        let few = |of: &[Recorded], most: usize| -> Vec<Recorded> {
            of.iter().step_by(of.len().div_ceil(most.max(1)).max(1)).cloned().collect()
        };
        let width = skin.channels().len();
        let tables = |of: &[Recorded]| {
            let (inputs, targets) = Self::tables(skin, of);
            let columns = [0, 1, 2, 3].map(|k| targets.chunks_exact(4).map(|t| t[k]).collect::<Vec<f64>>());
            (inputs, columns)
        };
        let (some, some_columns) = tables(&few(learn, TRIED));
        let (asked, answers) = tables(&few(choose, TRIED));
        let (all, all_columns) = tables(&few(learn, most));
        let tune = |k: usize| -> Result<(Svr, SvrSettings)> {
            let mut best: Option<(f64, SvrSettings)> = None;
            for (gamma, c, epsilon) in grid() {
                let settings = SvrSettings { gamma, c, epsilon, ..SvrSettings::default() };
                let targets = Rows::new(&some_columns[k], 1, "targets")?;
                let svr = Svr::fit(Rows::new(&some, width, "readings")?, targets, &settings)?;
                let mut error = 0.0;
                for (row, answer) in asked.chunks_exact(width).zip(&answers[k]) {
                    error += svr.predict(row)?.first().map_or(f64::INFINITY, |v| (v - answer).abs());
                }
                if best.is_none_or(|(least, _)| error < least) {
                    best = Some((error, settings));
                }
            }
            let settings = best.map_or_else(SvrSettings::default, |(_, s)| s);
            let targets = Rows::new(&all_columns[k], 1, "targets")?;
            Ok((Svr::fit(Rows::new(&all, width, "readings")?, targets, &settings)?, settings))
        };
        let [x, y, z, force] = [tune(0)?, tune(1)?, tune(2)?, tune(3)?];
        let settings = [x.1, y.1, z.1, force.1];
        Ok((Self::new(Regression::Tuned(Box::new([x.0, y.0, z.0, force.0])), skin), settings))
    }

    /// Nearest neighbours, as many as locate best on `choose`; their number, too.
    pub fn tuned_neighbours(
        skin: &SkinDescription,
        learn: &[Recorded],
        choose: &[Recorded],
    ) -> Result<(Self, usize)> {
        let ((inputs, targets), (asked, answers)) = (Self::tables(skin, learn), Self::tables(skin, choose));
        let width = skin.channels().len();
        let fit = |count: usize| {
            Neighbours::fit(
                Rows::new(&inputs, width, "readings")?,
                Rows::new(&targets, 4, "contacts")?,
                count,
            )
        };
        let every = choose.len().div_ceil(TRIED).max(1);
        let mut best = (f64::INFINITY, NEIGHBOURS);
        for count in [1, 2, 3, 4, 6, 9, 13, 19] {
            let neighbours = fit(count)?;
            let mut error = 0.0;
            for (row, answer) in asked.chunks_exact(width).zip(answers.chunks_exact(4)).step_by(every) {
                let found = neighbours.predict(row)?;
                error += found.iter().zip(&answer[..3]).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            }
            if error < best.0 {
                best = (error, count);
            }
        }
        Ok((Self::new(Regression::Neighbours(fit(best.1)?), skin), best.1))
    }

    /// Nearest neighbours.
    pub fn neighbours(skin: &SkinDescription, recorded: &[Recorded]) -> Result<Self> {
        let (inputs, targets) = Self::tables(skin, recorded);
        let inputs = Rows::new(&inputs, skin.channels().len(), "readings")?;
        let neighbours = Neighbours::fit(inputs, Rows::new(&targets, 4, "contacts")?, NEIGHBOURS)?;
        Ok(Self::new(Regression::Neighbours(neighbours), skin))
    }

    /// A feed-forward network.
    pub fn network(skin: &SkinDescription, recorded: &[Recorded]) -> Result<Self> {
        let (inputs, targets) = Self::tables(skin, recorded);
        let most = recorded.iter().map(|r| r.contact.force.norm()).fold(1e-9, f64::max);
        let reach = recorded.iter().map(|r| r.contact.position.coords.amax()).fold(1e-9, f64::max);
        let scales = [reach as f32, most as f32];
        let data = Batch {
            inputs: direction(&inputs, skin.channels().len()),
            targets: targets
                .iter()
                .enumerate()
                .map(|(i, v)| *v as f32 / scales[usize::from(i % 4 == 3)])
                .collect(),
            width: skin.channels().len() + 1,
            outputs: 4,
            ..Batch::default()
        };
        let network = NetworkConfig { hidden: vec![256, 256, 256], ..NetworkConfig::default() };
        let training = TrainingConfig { epochs: 60, learning_rate: 1e-3, ..TrainingConfig::default() };
        let net = fit(&data, &network, &training, 0)?;
        Ok(Self::new(Regression::Network { net, scales }, skin))
    }
}

/// Rows as their direction, and the logarithm of their length: where a contact is shows in the one, how hard in the other.
fn direction(rows: &[f64], width: usize) -> Vec<f32> {
    let mut out = Vec::with_capacity(rows.len() / width.max(1) * (width + 1));
    for row in rows.chunks_exact(width) {
        let length = (row.iter().map(|v| v * v).sum::<f64>() + width as f64).sqrt();
        // About 1, as the other inputs are of a unit vector of some ten.
        out.extend(row.iter().map(|v| (v / length * (width as f64).sqrt()) as f32));
        out.push((length.ln() - 4.0) as f32);
    }
    out
}

impl Method for Direct {
    fn contacts(&mut self, sample: &Sample) -> Result<Vec<Contact>> {
        let whitened = sample.tared.iter().zip(&self.noise);
        let row: Vec<f64> =
            whitened.map(|(v, n)| if v.is_finite() { f64::from(*v) / n } else { 0.0 }).collect();
        let answer: Vec<f64> = match &self.regression {
            Regression::Vectors { place, force } => {
                let mut answer = place.predict(&row)?;
                answer.extend(force.predict(&row)?);
                answer
            }
            Regression::Tuned(each) => {
                let mut answer = Vec::with_capacity(4);
                for svr in each.iter() {
                    answer.extend(svr.predict(&row)?);
                }
                answer
            }
            Regression::Neighbours(neighbours) => neighbours.predict(&row)?,
            Regression::Network { net, scales } => net
                .predict(&direction(&row, row.len()))
                .iter()
                .enumerate()
                .map(|(i, v)| f64::from(v * scales[usize::from(i == 3)]))
                .collect(),
        };
        let [x, y, z, force] = answer[..] else { bail!("a regression gave {} numbers", answer.len()) };
        let (position, normal) = self.surface.project(&Point3::new(x, y, z));
        let mut contact = Contact::at(position, normal);
        contact.force = -normal * force.max(0.0);
        contact.force_components = ForceComponents::Normal;
        Ok(vec![contact])
    }

    fn single(&self) -> bool {
        true
    }
}

/// An inverter of these settings.
pub fn inverter(model: &Arc<dyn ForwardModel>, settings: &dermis_inversion::Settings) -> Result<Inverter> {
    Ok(Inverter::new(Arc::clone(model), settings.clone())?)
}
