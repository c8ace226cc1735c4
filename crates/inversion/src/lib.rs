//! From readings to contacts by maximum likelihood on a forward model.
//!
//! A learned model answers in one step and knows what it was trained on. A forward model can be inverted:
//! which contacts would have made these readings? [`Inverter`] finds them, one or several, with the error that the noise
//! leaves, for any [`ForwardModel`](dermis_model::ForwardModel). [`Calibration`] measures on labelled readings how far a
//! device and its forward model are apart, so that the answer does not believe the model more than it deserves, and
//! [`Corrected`] takes what presses at known locations show of the difference into the model.
//!
//! [`PeakFinder`] and [`ForcePeakFinder`] need no forward model: contacts as the peaks of a displacement map, or of a map of forces,
//! that something else has found.

mod calibrate;
mod contact;
mod corrected;
mod dictionary;
mod fit;
mod force_peaks;
mod inverter;
mod local;
mod pairs;
mod peaks;
mod settings;
mod sparse;
#[cfg(test)]
mod testing;

pub use calibrate::{Calibration, CalibrationError};
pub use contact::{ContactEstimate, Reading, Solution};
pub use corrected::{Corrected, Correction, CorrectionSettings, Press};
pub use force_peaks::{ForcePeak, ForcePeakFinder};
pub use inverter::Inverter;
pub use peaks::{Peak, PeakFinder, PeakSettings, suppress};
pub use settings::{ForcePrior, InverterError, Search, Settings};
pub use sparse::SparseSettings;
