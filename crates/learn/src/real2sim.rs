//! Several contacts from few readings by way of a simulation, in the manner of HapDefX (H. Sun and G. Martius, *Front.
//! Neurorobot.* 13 (2019) 51).
//!
//! A device can be pressed at one location at a time all over, but hardly at all pairs, triples and quadruples of locations; its
//! forward model can. So three networks share the work:
//!
//! | network | from → to | learned from |
//! |---|---|---|
//! | transfer | readings of the device → [virtual sensors](VirtualSensors) of the model | recorded single contacts |
//! | reconstruction | virtual sensors → displacement of every point of the surface | simulated contacts, one to four |
//! | sensitivity | position and displacement of a peak → force | peaks of reconstructed maps |
//!
//! Peaks of the map ([`PeakFinder`](dermis_inversion::PeakFinder)) are contacts; the weak ones are suppressed. Nothing here knows
//! a sensor family: a [`ForwardModel`](dermis_model::ForwardModel) with displacements is all.
//!
//! Maps have thousands of points, but are sums of a few shapes: networks give the amplitudes of these ([`MapBasis`]), and one
//! matrix product the map. Every figure is measured on whole maps.

mod basis;
mod contacts;
mod pipeline;
mod regressor;
mod scenes;
mod sensors;
mod settings;
mod table;

pub use crate::recordings::{Recorded, superpose};
pub use basis::MapBasis;
pub use contacts::{matched, tune};
pub use pipeline::{Paired, Pipeline, PipelineSettings, SensitivityOutput, Stages, Trained, Transfer, train};
pub use regressor::{LinearMap, MapRegressor, NearestMaps, NetMap};
pub use scenes::{Compliance, Part, SceneSettings, Scenes};
pub use sensors::{Simulated, VirtualSensors, simulate};
pub use settings::Settings;
pub use table::{Cell, Table, TableSettings, table};

/// Receives the progress of long work: what is being done, and which share of it is done.
pub type ProgressFn<'a> = &'a (dyn Fn(&str, f64) + Sync);

#[cfg(test)]
mod tests;
