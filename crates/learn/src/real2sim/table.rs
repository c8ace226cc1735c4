//! Who extrapolates to more contacts than were learned from: Table 3.1 of the thesis.

use dermis_model::ForwardModel;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::regressor::scale;
use super::{
    LinearMap, MapBasis, MapRegressor, NearestMaps, NetMap, Part, ProgressFn, Scenes, Simulated,
    VirtualSensors, simulate,
};
use crate::train::{NetworkConfig, TrainingConfig};
use crate::{LearnError, MapScores, MapSummary};

/// Contacts at most.
const CONTACTS: usize = 4;
/// Maps whose shapes are the basis, of each number of contacts.
const BASIS_MAPS: usize = 1000;

/// How the table is made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TableSettings {
    /// Samples to learn from with one, two, three and four contacts.
    pub samples: [usize; CONTACTS],
    /// Samples to test on, of each number of contacts.
    pub tests: usize,
    /// Standard deviation of what is added to every virtual sensor, as a share of their root mean square over single contacts.
    pub noise: f64,
    /// Share of the squares of the maps that the basis keeps.
    pub kept: f64,
    /// Neighbours.
    pub neighbours: usize,
    /// The network.
    pub network: NetworkConfig,
    /// How it is fitted.
    pub training: TrainingConfig,
}

impl Default for TableSettings {
    fn default() -> Self {
        Self {
            // 3 of 5 parts of the thesis' 27 000 and 6 000.
            samples: [16_200, 3_600, 3_600, 3_600],
            tests: 1_200,
            noise: 0.01,
            kept: 0.999,
            neighbours: 6,
            network: NetworkConfig { hidden: vec![256, 256, 256], ..NetworkConfig::default() },
            training: TrainingConfig { epochs: 60, learning_rate: 1e-3, ..TrainingConfig::default() },
        }
    }
}

/// One number of the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// `linear`, `neighbours` or `network`.
    pub method: String,
    /// Learned from one to this many contacts.
    pub trained: usize,
    /// Tested on this many contacts.
    pub tested: usize,
    /// Error over all points of the surface \[m\].
    pub error: MapSummary,
}

/// The table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// How it was made.
    pub settings: TableSettings,
    /// What the inputs were.
    pub sensors: String,
    /// Points of a map.
    pub points: usize,
    /// Shapes of the basis.
    pub rank: usize,
    /// Share of the squares of the maps that they keep.
    pub kept: f64,
    /// All numbers.
    pub cells: Vec<Cell>,
}

impl Table {
    /// Names of the methods, in the order of the thesis.
    pub const METHODS: [&'static str; 3] = ["linear", "neighbours", "network"];

    /// One number.
    #[must_use]
    pub fn cell(&self, method: &str, trained: usize, tested: usize) -> Option<&Cell> {
        self.cells.iter().find(|c| c.method == method && c.trained == trained && c.tested == tested)
    }

    /// By how much the thesis' two messages hold: root mean square errors of the best other method over those of the line, on two,
    /// three and four contacts learned from single ones only; and over those of the network, wherever the number of contacts was
    /// learned. The least of each: above 1 a message holds throughout.
    #[must_use]
    pub fn margins(&self) -> [f64; 2] {
        let margin = |method: &'static str, trained: usize, tested: usize| {
            let of = |m| self.cell(m, trained, tested).map_or(f64::NAN, |c| c.error.rms);
            let others =
                Self::METHODS.into_iter().filter(|m| *m != method).map(of).fold(f64::INFINITY, f64::min);
            others / of(method)
        };
        let line = (2..=CONTACTS).map(|tested| margin("linear", 1, tested)).fold(f64::INFINITY, f64::min);
        let network = (1..=CONTACTS)
            .flat_map(|trained| (1..=trained).map(move |tested| (trained, tested)))
            .map(|(trained, tested)| margin("network", trained, tested))
            .fold(f64::INFINITY, f64::min);
        [line, network]
    }

    /// Whether the messages hold.
    #[must_use]
    pub fn messages(&self) -> [bool; 2] {
        self.margins().map(|margin| margin > 1.0)
    }
}

/// Where simulated contacts come from.
struct Simulation<'a> {
    model: &'a dyn ForwardModel,
    sensors: &'a VirtualSensors,
    scenes: &'a Scenes,
}

/// Simulated contacts to learn from, to choose by and to test on; an entry for each number of contacts.
struct Parts {
    train: Vec<Simulated>,
    validation: Vec<Simulated>,
    test: Vec<Simulated>,
}

impl Simulation<'_> {
    /// Scenes of one part; their maps become amplitudes where a basis is given.
    fn run(
        &self,
        part: Part,
        contacts: usize,
        count: usize,
        basis: Option<&MapBasis>,
    ) -> Result<Simulated, LearnError> {
        simulate(self.model, self.sensors, &self.scenes.draw(part, contacts, count), basis, &|_, _| {})
    }

    /// The shapes that maps are made of.
    fn basis(&self, settings: &TableSettings) -> Result<MapBasis, LearnError> {
        let mut maps = Vec::new();
        for contacts in 1..=CONTACTS {
            let count = settings.samples[contacts - 1].min(BASIS_MAPS);
            maps.extend(self.run(Part::Train, contacts, count, None)?.maps);
        }
        let points = self.model.surface().points.len();
        Ok(MapBasis::measure(&maps, points, settings.kept, settings.training.seed))
    }

    /// All parts, with noise on the virtual sensors. Maps of those to test on are whole.
    fn parts(
        &self,
        settings: &TableSettings,
        basis: &MapBasis,
        progress: ProgressFn<'_>,
    ) -> Result<Parts, LearnError> {
        let (mut train, mut validation, mut test) = (Vec::new(), Vec::new(), Vec::new());
        for contacts in 1..=CONTACTS {
            progress("simulating contacts", contacts as f64 / (CONTACTS + 1) as f64);
            let count = settings.samples[contacts - 1];
            train.push(self.run(Part::Train, contacts, count, Some(basis))?);
            let few = (count / 3).clamp(1, settings.tests);
            validation.push(self.run(Part::Validation, contacts, few, Some(basis))?);
            test.push(self.run(Part::Test, contacts, settings.tests, None)?);
        }
        let deviation = settings.noise as f32 * scale(&train[0].sensors);
        let mut rng = ChaCha8Rng::seed_from_u64(settings.training.seed);
        for data in [&mut train, &mut validation, &mut test].into_iter().flatten() {
            data.sensors.iter_mut().for_each(|v| *v += deviation * rng.sample::<f32, _>(StandardNormal));
        }
        Ok(Parts { train, validation, test })
    }
}

/// Those of one to `trained` contacts together.
fn join(parts: &[Simulated], trained: usize) -> Simulated {
    let mut all = Simulated::default();
    parts[..trained].iter().for_each(|p| all.extend(p));
    all
}

/// Fits one method to `data`; what it leaves open is chosen on `chosen`.
fn fit(
    method: &str,
    (data, chosen): (&Simulated, &Simulated),
    width: usize,
    settings: &TableSettings,
) -> Result<Box<dyn MapRegressor>, LearnError> {
    let (inputs, maps) = (&data.sensors, &data.maps);
    let regressor: Box<dyn MapRegressor> = match method {
        "linear" => Box::new(LinearMap::fit(inputs, maps, width, (&chosen.sensors, &chosen.maps))?),
        "neighbours" => Box::new(NearestMaps::fit(inputs, maps, width, settings.neighbours)?),
        _ => Box::new(NetMap::fit(inputs, maps, width, &settings.network, &settings.training)?),
    };
    Ok(regressor)
}

/// Makes the table from a skin's nominal model.
///
/// # Errors
///
/// [`LearnError::Training`] where the model knows no displacements, or a fit goes wrong.
pub fn table(
    model: &dyn ForwardModel,
    sensors: &VirtualSensors,
    scenes: &Scenes,
    settings: &TableSettings,
    progress: ProgressFn<'_>,
) -> Result<Table, LearnError> {
    let points = model.surface().points.len();
    let simulation = Simulation { model, sensors, scenes };
    progress("simulating contacts", 0.0);
    let basis = simulation.basis(settings)?;
    let parts = simulation.parts(settings, &basis, progress)?;
    let mut cells = Vec::new();
    for trained in 1..=CONTACTS {
        let (data, chosen) = (join(&parts.train, trained), join(&parts.validation, trained));
        for (index, method) in Table::METHODS.into_iter().enumerate() {
            let done = (trained - 1) * Table::METHODS.len() + index;
            progress(
                &format!("{method}, learned from 1 to {trained} contacts"),
                done as f64 / (CONTACTS * Table::METHODS.len()) as f64,
            );
            let regressor = fit(method, (&data, &chosen), sensors.count(), settings)?;
            for (i, test) in parts.test.iter().enumerate() {
                let maps = basis.decode(&regressor.predict(&test.sensors)?);
                let mut scores = MapScores::new();
                for (truth, answer) in test.maps.chunks_exact(points).zip(maps.chunks_exact(points)) {
                    scores.push(truth, answer);
                }
                cells.push(Cell { method: method.into(), trained, tested: i + 1, error: scores.summary() });
            }
        }
    }
    Ok(Table {
        settings: settings.clone(),
        sensors: sensors.describe(),
        points,
        rank: basis.rank(),
        kept: basis.kept(),
        cells,
    })
}
