//! Transfer, reconstruction and sensitivity network: training, and as graphs.

use std::sync::Arc;

use dermis_inference::onnx::{GraphBuilder, OnnxError};
use dermis_inference::{Interface, MapContacts, Model, PeakSection, Runtime};
use dermis_inversion::PeakSettings;
use dermis_model::{ForwardModel, Indentation, Stimulus};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::regressor::scale;
use super::{
    Compliance, LinearMap, MapBasis, MapRegressor, NetMap, Part, ProgressFn, Recorded, Scenes, Simulated,
    VirtualSensors, matched, simulate, superpose, tune,
};
use crate::LearnError;
use crate::train::{Activation, Batch, Mlp, NetworkConfig, TrainingConfig, fit};

/// Contacts at most.
const CONTACTS: usize = 4;
/// \[m\] between a peak and the contact that it belongs to, at most.
const REACH: f64 = 0.015;
/// Maps whose shapes are the basis, of each number of contacts.
const BASIS_MAPS: usize = 1000;
/// Frames of each number of contacts whose peaks teach sensitivity and suppression.
const PEAK_FRAMES: usize = 2500;

/// How the three networks are trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PipelineSettings {
    /// Points of the surface near each element that are virtual sensors; 0: the channels of the skin as designed.
    pub each: usize,
    /// Recorded single contacts of which sums stand in for several at once, at most: 1 is what the thesis does.
    pub superpose: usize,
    /// Sums of each number of contacts.
    pub sums: usize,
    /// Whether the transfer is a matrix instead of a network.
    pub linear_transfer: bool,
    /// Simulated samples with one, two, three and four contacts.
    pub samples: [usize; CONTACTS],
    /// Share of the squares of the maps that the basis keeps.
    pub kept: f64,
    /// Hidden layers of the transfer.
    pub transfer: NetworkConfig,
    /// How it is fitted.
    pub transfer_training: TrainingConfig,
    /// Hidden layers of the reconstruction.
    pub reconstruction: NetworkConfig,
    /// How it is fitted.
    pub reconstruction_training: TrainingConfig,
    /// Hidden layers of the sensitivity.
    pub sensitivity: NetworkConfig,
    /// How it is fitted.
    pub sensitivity_training: TrainingConfig,
    /// Whether displacements are divided by the root of what each point gives way before peaks are looked for; the thesis does
    /// not.
    pub weighted: bool,
    /// Which peaks are contacts, before the suppression is tuned.
    pub peaks: PeakSettings,
}

impl Default for PipelineSettings {
    fn default() -> Self {
        let network = |hidden: &[usize], activation| NetworkConfig {
            hidden: hidden.to_vec(),
            activation,
            ..NetworkConfig::default()
        };
        let training = |epochs| TrainingConfig { epochs, learning_rate: 1e-3, ..TrainingConfig::default() };
        Self {
            each: 24,
            superpose: 1,
            sums: 10_000,
            linear_transfer: false,
            samples: [16_200, 3_600, 3_600, 3_600],
            kept: 0.999,
            transfer: network(&[128, 128, 128], Activation::Silu),
            transfer_training: training(80),
            reconstruction: network(&[256, 256, 256], Activation::Silu),
            reconstruction_training: training(60),
            sensitivity: network(&[48, 48], Activation::Silu),
            sensitivity_training: training(120),
            weighted: false,
            peaks: PeakSettings::default(),
        }
    }
}

impl PipelineSettings {
    /// Says what is impossible; `file` is what errors call the settings.
    ///
    /// # Errors
    ///
    /// [`LearnError::Config`] names the field.
    pub fn validate(&self, file: &str) -> Result<(), LearnError> {
        let wrong = |field: &str, reason: String| {
            Err(LearnError::Config { file: file.to_owned(), field: field.to_owned(), reason })
        };
        if !(1..=CONTACTS).contains(&self.superpose) {
            return wrong("superpose", format!("is {} and must be 1 to {CONTACTS}", self.superpose));
        }
        if self.samples[0] == 0 {
            return wrong("samples[0]", "is 0: single contacts are the least that is simulated".into());
        }
        if !(self.kept > 0.0 && self.kept < 1.0) {
            return wrong("kept", format!("is {} and must lie between 0 and 1", self.kept));
        }
        if let Err((field, reason)) = self.peaks.check() {
            return wrong(&format!("peaks.{field}"), reason);
        }
        Ok(())
    }
}

/// The transfer.
#[derive(Debug, Clone, PartialEq)]
enum Transfer {
    /// A matrix, and the root mean square of the signals it was fitted to.
    Linear(LinearMap, f32),
    Network(NetMap),
}

impl Transfer {
    fn predict(&self, signals: &[f32]) -> Result<Vec<f32>, LearnError> {
        match self {
            Self::Linear(linear, _) => linear.predict(signals),
            Self::Network(net) => net.predict(signals),
        }
    }
}

/// Readings → displacement map → contacts.
#[derive(Debug, Clone, PartialEq)]
pub struct Pipeline {
    channels: usize,
    transfer: Transfer,
    reconstruction: NetMap,
    basis: MapBasis,
    sensitivity: Sensitivity,
    peaks: PeakSettings,
    weights: Vec<f32>,
}

/// Place and displacement of a peak → force: the displacement times e to the power of what a network says.
#[derive(Debug, Clone, PartialEq)]
struct Sensitivity {
    centre: [f32; 4],
    factor: [f32; 4],
    /// Mean of ln(force / displacement), which the network's output is added to.
    level: f32,
    net: Mlp,
}

impl Sensitivity {
    fn fit(
        peaks: &[([f32; 4], f32)],
        network: &NetworkConfig,
        training: &TrainingConfig,
    ) -> Result<Self, LearnError> {
        let count = peaks.len().max(1) as f32;
        let (mut centre, mut factor) = ([0.0; 4], [1.0; 4]);
        for i in 0..4 {
            centre[i] = peaks.iter().map(|(x, _)| x[i]).sum::<f32>() / count;
            let square = peaks.iter().map(|(x, _)| (x[i] - centre[i]).powi(2)).sum::<f32>() / count;
            // A coordinate that does not vary, as z of a flat skin, says nothing.
            factor[i] = if square.sqrt() > 1e-7 { 1.0 / square.sqrt() } else { 0.0 };
        }
        let logarithm = |(x, force): &([f32; 4], f32)| (force / x[3]).ln();
        let level = peaks.iter().map(logarithm).sum::<f32>() / count;
        let mut data = Batch { width: 4, outputs: 1, ..Batch::default() };
        for peak in peaks {
            data.inputs.extend((0..4).map(|i| (peak.0[i] - centre[i]) * factor[i]));
            data.targets.push(logarithm(peak) - level);
        }
        Ok(Self { centre, factor, level, net: fit(&data, network, training, 0)? })
    }

    fn to_onnx(&self) -> Result<Vec<u8>, OnnxError> {
        let mut g = GraphBuilder::new("sensitivity");
        let input = g.input("input", &[1, 4]);
        let centre = g.constant("centre", &[1, 4], &self.centre);
        let factor = g.constant("factor", &[1, 4], &self.factor);
        let level = g.constant("level", &[1, 1], &[self.level]);
        let centred = g.sub(&input, &centre);
        let x = g.mul(&centred, &factor);
        let logarithm = self.net.to_graph(&mut g, &x, "sensitivity", 1.0);
        let logarithm = g.add(&logarithm, &level);
        let rigidity = g.exp(&logarithm);
        let displacement = g.slice(&input, 1, 3, 4);
        let force = g.mul(&displacement, &rigidity);
        g.output("output", &force, &[1, 1]);
        g.finish()
    }
}

/// What training came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trained {
    /// What the virtual sensors are.
    pub sensors: String,
    /// Number of them.
    pub virtual_sensors: usize,
    /// Shapes of the basis, and the share of the squares of the maps that they keep.
    pub rank: usize,
    /// That share.
    pub kept: f64,
    /// Recorded single contacts that were learned from.
    pub recorded: usize,
    /// Root mean square error of the transfer on recorded contacts that were held out, as a share of the virtual sensors' own.
    pub transfer_error: f64,
    /// Root mean square \[m\] over whole maps of simulated contacts at held-out places, by their number from 1 on; the virtual
    /// sensors are as the simulation says.
    pub map_rms: Vec<f64>,
    /// Peaks that taught the sensitivity.
    pub peaks: usize,
    /// Which peaks are contacts.
    pub settings: PeakSettings,
}

fn wrong(reason: impl Into<String>) -> LearnError {
    LearnError::Training { reason: reason.into() }
}

/// Trains all three on recorded single contacts of a device and the nominal `model` of its skin. `recorded` is parted by place;
/// `choose` (single contacts at other places) is what errors of the transfer are measured on.
///
/// # Errors
///
/// [`LearnError::Training`] where the model knows no displacements, nothing was recorded, or a fit goes wrong.
pub fn train(
    model: &Arc<dyn ForwardModel>,
    sensors: &VirtualSensors,
    scenes: &Scenes,
    (recorded, choose): (&[Recorded], &[Recorded]),
    settings: &PipelineSettings,
    runtime: &Runtime,
    told: ProgressFn<'_>,
) -> Result<(Pipeline, Trained), LearnError> {
    settings.validate("settings")?;
    if recorded.is_empty() || choose.is_empty() {
        return Err(wrong(
            "no single contact of known place, force and tip was recorded at some places to learn from and at others to choose by",
        ));
    }
    if settings.superpose > 1 && !model.superposes() {
        return Err(wrong(
            "this skin's readings of several contacts do not add up, so that sums of recorded presses are none of it: set `superpose` to 1",
        ));
    }
    let (channels, points) = (model.channels(), model.surface().points.len());
    let distance = scenes.settings().distance;
    let seed = scenes.settings().seed;
    let basis = basis(model.as_ref(), sensors, scenes, settings, told)?;

    // What the device reads, and what the simulation would.
    let pairs = |recorded: &[Recorded], most: usize, count: usize, seed: u64| {
        let mut all: Vec<(Stimulus, Vec<f32>)> = recorded
            .iter()
            .map(|r| {
                (Stimulus { contacts: vec![r.contact.clone()], ..Stimulus::default() }, r.signal.clone())
            })
            .collect();
        for contacts in 2..=most {
            all.extend(superpose(model.as_ref(), recorded, contacts, count, distance, seed));
        }
        all
    };
    let seen = |pairs: &[(Stimulus, Vec<f32>)]| -> Result<(Vec<f32>, Simulated), LearnError> {
        let stimuli: Vec<Stimulus> = pairs.iter().map(|(s, _)| s.clone()).collect();
        let simulated = simulate(model.as_ref(), sensors, &stimuli, Some(&basis), told)?;
        Ok((pairs.iter().flat_map(|(_, signal)| signal.iter().copied()).collect(), simulated))
    };
    let (signals, simulated) = seen(&pairs(recorded, settings.superpose, settings.sums, seed))?;
    let (held, held_simulated) = seen(&pairs(choose, 1, 0, seed))?;
    told("transfer network", 0.2);
    let transfer = if settings.linear_transfer {
        let validation = (held.as_slice(), held_simulated.sensors.as_slice());
        let linear = LinearMap::fit(&signals, &simulated.sensors, channels, validation)?;
        Transfer::Linear(linear, scale(&signals))
    } else {
        Transfer::Network(NetMap::fit(
            &signals,
            &simulated.sensors,
            channels,
            &settings.transfer,
            &settings.transfer_training,
        )?)
    };
    let residuals = difference(&transfer.predict(&held)?, &held_simulated.sensors);
    let transfer_error = f64::from(scale(&residuals) / scale(&held_simulated.sensors));

    told("reconstruction network", 0.3);
    let reconstruction = {
        let mut all = Simulated::default();
        for contacts in 1..=CONTACTS {
            let drawn = scenes.draw(Part::Train, contacts, settings.samples[contacts - 1]);
            all.extend(&simulate(model.as_ref(), sensors, &drawn, Some(&basis), told)?);
        }
        // What the transfer leaves is what the reconstruction will see on top: errors of held-out contacts, in proportion to
        // the signal.
        perturb(&mut all.sensors, sensors.count(), &residuals, &held_simulated.sensors, seed);
        if settings.superpose > 1 {
            all.extend(&Simulated { sensors: transfer.predict(&signals)?, maps: simulated.maps.clone() });
        }
        NetMap::fit(
            &all.sensors,
            &all.maps,
            sensors.count(),
            &settings.reconstruction,
            &settings.reconstruction_training,
        )?
    };
    told("maps of held-out places", 0.8);
    let mut map_rms = Vec::new();
    for contacts in 1..=CONTACTS {
        let drawn = scenes.draw(Part::Test, contacts, 500);
        let truth = simulate(model.as_ref(), sensors, &drawn, None, told)?;
        let maps = basis.decode(&reconstruction.predict(&truth.sensors)?);
        let mut scores = crate::MapScores::new();
        truth.maps.chunks_exact(points).zip(maps.chunks_exact(points)).for_each(|(t, a)| scores.push(t, a));
        map_rms.push(scores.summary().rms);
    }

    told("sensitivity network", 0.85);
    let nothing =
        Sensitivity { centre: [0.0; 4], factor: [0.0; 4], level: 0.0, net: Mlp::linear(4, 1, vec![0.0; 4]) };
    let mut pipeline = Pipeline {
        channels,
        transfer,
        reconstruction,
        basis,
        sensitivity: nothing,
        peaks: settings.peaks.clone(),
        weights: if settings.weighted {
            Compliance::of(model.as_ref(), scenes.settings().diameter)?.weights()
        } else {
            Vec::new()
        },
    };
    // Frames whose peaks are looked at: recorded singles, and sums of several, whatever the networks were trained on. The
    // thesis' network sees singles only; the suppression needs several, and sums of recorded ones are at hand.
    let mut frames: Vec<(Stimulus, Vec<f32>)> = Vec::new();
    let singles = pairs(recorded, 1, 0, seed);
    let step = singles.len().div_ceil(PEAK_FRAMES).max(1);
    frames.extend(singles.into_iter().step_by(step));
    for contacts in 2..=CONTACTS {
        // Nearer than two radii of the search, peaks run into one another whatever is set.
        let apart = distance.max(2.0 * settings.peaks.radius);
        frames.extend(superpose(
            model.as_ref(),
            recorded,
            contacts,
            PEAK_FRAMES / contacts,
            apart,
            seed ^ 0x5eed,
        ));
    }
    let mut found = Vec::with_capacity(frames.len());
    let mut reader = pipeline.contacts(model.surface(), runtime)?;
    for (stimulus, signal) in &frames {
        let map = pipeline.map(signal)?;
        found.push((stimulus, reader.candidates(&map)?));
    }
    // Without a sensitivity, the force of a peak is its displacement.
    let mut peaks: Vec<([f32; 4], f32)> = Vec::new();
    for (stimulus, contacts) in &found {
        for (t, index) in matched(&stimulus.contacts, contacts, REACH).into_iter().enumerate() {
            let Some(contact) = index.map(|i| &contacts[i]) else { continue };
            let (p, force) = (contact.position, pressing(&stimulus.contacts[t], model.as_ref()));
            let displacement = contact.normal_force();
            if force > 0.0 && displacement > 0.0 {
                peaks.push(([p.x as f32, p.y as f32, p.z as f32, displacement as f32], force as f32));
            }
        }
    }
    if peaks.is_empty() {
        return Err(wrong("no peak of the reconstructed maps lies near a contact: record more places"));
    }
    pipeline.sensitivity = Sensitivity::fit(&peaks, &settings.sensitivity, &settings.sensitivity_training)?;
    let mut reader = pipeline.contacts(model.surface(), runtime)?;
    let mut counted = Vec::with_capacity(frames.len());
    let mut least = f64::INFINITY;
    for (stimulus, signal) in &frames {
        let forces = reader
            .candidates(&pipeline.map(signal)?)?
            .iter()
            .map(dermis_skin::Contact::normal_force)
            .collect();
        counted.push((stimulus.contacts.len(), forces));
        least = stimulus.contacts.iter().map(|c| c.force.norm()).fold(least, f64::min);
    }
    pipeline.peaks = tune(&counted, least, &settings.peaks);
    let trained = Trained {
        sensors: sensors.describe(),
        virtual_sensors: sensors.count(),
        rank: pipeline.basis.rank(),
        kept: pipeline.basis.kept(),
        recorded: recorded.len(),
        transfer_error,
        map_rms,
        peaks: peaks.len(),
        settings: pipeline.peaks.clone(),
    };
    Ok((pipeline, trained))
}

fn pressing(contact: &Indentation, model: &dyn ForwardModel) -> f64 {
    -contact.force.dot(&model.surface().project(&contact.position).1)
}

fn basis(
    model: &dyn ForwardModel,
    sensors: &VirtualSensors,
    scenes: &Scenes,
    settings: &PipelineSettings,
    told: ProgressFn<'_>,
) -> Result<MapBasis, LearnError> {
    told("shapes of maps", 0.0);
    let mut maps = Vec::new();
    for contacts in 1..=CONTACTS {
        let drawn = scenes.draw(Part::Train, contacts, settings.samples[contacts - 1].min(BASIS_MAPS));
        maps.extend(simulate(model, sensors, &drawn, None, told)?.maps);
    }
    let points = model.surface().points.len();
    Ok(MapBasis::measure(&maps, points, settings.kept, scenes.settings().seed))
}

fn difference(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Adds to each row of `sensors` the residual of a row that is drawn, times the ratio of their sizes.
fn perturb(sensors: &mut [f32], width: usize, residuals: &[f32], of: &[f32], seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let size = |row: &[f32]| row.iter().map(|v| v * v).sum::<f32>().sqrt();
    let count = of.len() / width.max(1);
    for row in sensors.chunks_exact_mut(width) {
        let i = rng.random_range(0..count);
        let drawn = i * width..(i + 1) * width;
        let ratio = size(row) / size(&of[drawn.clone()]).max(f32::MIN_POSITIVE);
        // A contact that hardly showed says nothing of how errors grow.
        let ratio = ratio.min(10.0);
        row.iter_mut().zip(&residuals[drawn]).for_each(|(v, r)| *v += ratio * r);
    }
}

impl Pipeline {
    /// Displacement \[m\] of every point of the surface for a signal in the unit of the skin.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] for a signal of another skin.
    pub fn map(&self, signal: &[f32]) -> Result<Vec<f64>, LearnError> {
        if signal.len() != self.channels {
            return Err(wrong(format!("{} readings where the skin has {}", signal.len(), self.channels)));
        }
        let amplitudes = self.reconstruction.predict(&self.transfer.predict(signal)?)?;
        Ok(self.basis.decode(&amplitudes).into_iter().map(f64::from).collect())
    }

    /// Which peaks are contacts.
    #[must_use]
    pub fn peaks(&self) -> &PeakSettings {
        &self.peaks
    }

    /// What its bundle says of peaks.
    #[must_use]
    pub fn section(&self) -> PeakSection {
        PeakSection {
            settings: self.peaks.clone(),
            weights: self.weights.clone(),
            position_sigma: None,
            force_sigma: None,
            sensitivity: dermis_inference::ModelSection {
                interface: PeakSection::interface(),
                ..dermis_inference::ModelSection::default()
            },
        }
    }

    /// Reads contacts off its maps.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where the sensitivity network cannot be run.
    pub fn contacts(
        &self,
        surface: &dermis_skin::Surface,
        runtime: &Runtime,
    ) -> Result<MapContacts, LearnError> {
        let model = Model::load(runtime, &self.sensitivity_onnx()?, &PeakSection::interface())?;
        Ok(MapContacts::new(self.section(), model, surface))
    }

    /// The sensitivity network.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the graph cannot be written.
    pub fn sensitivity_onnx(&self) -> Result<Vec<u8>, LearnError> {
        self.sensitivity.to_onnx().map_err(unwritable)
    }

    /// All from readings to the map, as one graph: `input` is the signal divided by [`input_scale`](Self::input_scale),
    /// `output` the map divided by [`output_scale`](Self::output_scale).
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the graph cannot be written.
    pub fn to_onnx(&self) -> Result<Vec<u8>, LearnError> {
        let mut g = GraphBuilder::new("map");
        let input = g.input("input", &[1, self.channels]);
        // Between two networks one number leads from the outputs of the first to the inputs of the second.
        let between = match &self.transfer {
            Transfer::Linear(linear, _) => {
                let factor = self.input_scale() / self.reconstruction.input;
                linear.network().to_graph(&mut g, &input, "transfer", factor)
            }
            Transfer::Network(net) => {
                net.net.to_graph(&mut g, &input, "transfer", net.output / self.reconstruction.input)
            }
        };
        let amplitudes = self.reconstruction.net.to_graph(&mut g, &between, "reconstruction", 1.0);
        let (rank, points) = (self.basis.rank(), self.basis.points());
        let shapes = g.constant("shapes", &[rank, points], self.basis.shapes());
        let map = g.matmul(&amplitudes, &shapes);
        g.output("output", &map, &[1, points]);
        g.finish().map_err(unwritable)
    }

    /// Unit of the skin per unit of the graph's input.
    #[must_use]
    pub fn input_scale(&self) -> f32 {
        match &self.transfer {
            Transfer::Linear(_, scale) => *scale,
            Transfer::Network(net) => net.input,
        }
    }

    /// \[m\] per unit of the graph's output.
    #[must_use]
    pub fn output_scale(&self) -> f32 {
        self.reconstruction.output
    }

    /// What its graph takes and gives.
    #[must_use]
    pub fn interface(&self) -> Interface {
        Interface::flat(self.channels, self.basis.points())
    }
}

#[expect(clippy::needless_pass_by_value, reason = "as `map_err` hands it over")]
fn unwritable(error: OnnxError) -> LearnError {
    wrong(format!("the graph cannot be written: {error}"))
}
