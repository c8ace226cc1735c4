//! Transfer, reconstruction and sensitivity network: from readings to contacts, and as graphs. How they are trained is in
//! [`Stages`].

mod sensitivity;
mod settings;
mod stages;

use std::sync::Arc;

use dermis_inference::onnx::{GraphBuilder, OnnxError};
use dermis_inference::{Interface, MapContacts, Model, PeakSection, Runtime};
use dermis_inversion::PeakSettings;
use dermis_model::ForwardModel;
use serde::Serialize;

use super::{LinearMap, MapBasis, MapRegressor, NetMap, ProgressFn, Recorded, Scenes, VirtualSensors};
use crate::LearnError;
use crate::train::States;
use sensitivity::Sensitivity;
pub use settings::{PipelineSettings, SensitivityOutput};
pub use stages::{Paired, Stages};

/// Contacts at most.
const CONTACTS: usize = 4;

/// The transfer.
#[derive(Debug, Clone, PartialEq)]
pub enum Transfer {
    /// A matrix, and the root mean square of the signals it was fitted to.
    Linear(LinearMap, f32),
    /// A network.
    Network(NetMap),
}

impl MapRegressor for Transfer {
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
    /// Root mean square \[m\] over whole maps of simulated contacts at held-out locations, by their number from 1 on; the virtual
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
/// `choose` (single contacts at other locations) is what errors of the transfer are measured on.
///
/// # Errors
///
/// [`LearnError::Training`] where the model knows no displacements, nothing was recorded, or a fit goes wrong.
pub fn train(
    model: &Arc<dyn ForwardModel>,
    sensors: &VirtualSensors,
    scenes: &Scenes,
    recorded: (&[Recorded], &[Recorded]),
    settings: &PipelineSettings,
    runtime: &Runtime,
    progress: ProgressFn<'_>,
) -> Result<(Pipeline, Trained), LearnError> {
    Stages { model, sensors, scenes, settings, states: None::<&States>, progress }.train(recorded, runtime)
}

impl Pipeline {
    /// Widths of the layers of transfer, reconstruction and sensitivity network: inputs, hidden ones, outputs.
    #[must_use]
    pub fn layers(&self) -> [&[usize]; 3] {
        let transfer = match &self.transfer {
            Transfer::Linear(linear, _) => linear.network().layers(),
            Transfer::Network(net) => net.network().layers(),
        };
        [transfer, self.reconstruction.network().layers(), self.sensitivity.layers()]
    }

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
        let map = if self.basis.is_whole() {
            amplitudes
        } else {
            let shapes = g.constant("shapes", &[rank, points], self.basis.shapes());
            g.matmul(&amplitudes, &shapes)
        };
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
