//! Who extrapolates to more contacts than were learned from: Table 3.1 of the thesis.

use dermis_model::ForwardModel;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::regressor::scale;
use super::{
    LinearMap, MapBasis, MapRegressor, NearestMaps, NetMap, Part, ProgressFn, Scenes, VirtualSensors,
    simulate,
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
    let quiet: ProgressFn<'_> = &|_, _| {};
    progress("simulating contacts", 0.0);
    let mut start = Vec::new();
    for contacts in 1..=CONTACTS {
        let scenes = scenes.draw(Part::Train, contacts, settings.samples[contacts - 1].min(BASIS_MAPS));
        start.extend(simulate(model, sensors, &scenes, None, quiet)?.maps);
    }
    let basis = MapBasis::measure(&start, points, settings.kept, settings.training.seed);
    drop(start);
    let part = |part, contacts, count, basis: Option<&MapBasis>| {
        simulate(model, sensors, &scenes.draw(part, contacts, count), basis, quiet)
    };
    let mut train = Vec::new();
    let mut validation = Vec::new();
    let mut test = Vec::new();
    for contacts in 1..=CONTACTS {
        progress("simulating contacts", contacts as f64 / (CONTACTS + 1) as f64);
        let count = settings.samples[contacts - 1];
        train.push(part(Part::Train, contacts, count, Some(&basis))?);
        validation.push(part(
            Part::Validation,
            contacts,
            (count / 3).clamp(1, settings.tests),
            Some(&basis),
        )?);
        test.push(part(Part::Test, contacts, settings.tests, None)?);
    }
    let deviation = settings.noise as f32 * scale(&train[0].sensors);
    let mut rng = ChaCha8Rng::seed_from_u64(settings.training.seed);
    for data in [&mut train, &mut validation, &mut test].into_iter().flatten() {
        data.sensors.iter_mut().for_each(|v| *v += deviation * rng.sample::<f32, _>(StandardNormal));
    }
    let width = sensors.count();
    let mut cells = Vec::new();
    for trained in 1..=CONTACTS {
        let join = |parts: &[super::Simulated]| {
            let mut all = super::Simulated::default();
            parts[..trained].iter().for_each(|p| all.extend(p));
            all
        };
        let (data, chosen) = (join(&train), join(&validation));
        for (index, method) in Table::METHODS.into_iter().enumerate() {
            let done = (trained - 1) * Table::METHODS.len() + index;
            progress(
                &format!("{method}, learned from 1 to {trained} contacts"),
                done as f64 / (CONTACTS * Table::METHODS.len()) as f64,
            );
            let regressor: Box<dyn MapRegressor> = match method {
                "linear" => Box::new(LinearMap::fit(
                    &data.sensors,
                    &data.maps,
                    width,
                    (&chosen.sensors, &chosen.maps),
                )?),
                "neighbours" => {
                    Box::new(NearestMaps::fit(&data.sensors, &data.maps, width, settings.neighbours)?)
                }
                _ => Box::new(NetMap::fit(
                    &data.sensors,
                    &data.maps,
                    width,
                    &settings.network,
                    &settings.training,
                )?),
            };
            for (i, test) in test.iter().enumerate() {
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
