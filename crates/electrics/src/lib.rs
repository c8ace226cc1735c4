//! Currents in thin conductive sheets with electrodes on their rim: what electrical impedance tomography measures.
//!
//! [`Rim`] is the outline of a sheet and where its electrodes are, [`Sheet`] its mesh and the complete electrode model on it,
//! [`Adjacent`] which electrodes are driven and read, [`disc`] the analytic solution that the mesh is checked against. Nothing here knows
//! of a family of sensors.

mod adjacent;
mod cem;
pub mod disc;
mod fit;
mod mesh;
mod rim;

pub use adjacent::Adjacent;
pub use cem::{Contacts, Sheet};
pub use fit::{Fit, fit_scale};
pub use mesh::{Density, Mesh};
pub use rim::Rim;

/// Why a sheet cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ElectricsError {
    /// Something has a value that it cannot have.
    #[error("{what} is {value}, and must be {must}")]
    Value {
        /// What.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        must: &'static str,
    },
    /// Two electrodes share a part of the rim.
    #[error("electrodes {first} and {second} overlap: make them narrower, or place them further apart")]
    Overlap {
        /// From 0.
        first: usize,
        /// From 0.
        second: usize,
    },
    /// The equations were not solved.
    #[error(
        "the currents were not found within {steps} steps: {residual:.1e} of the drive is left; use a larger contact impedance"
    )]
    NotSolved {
        /// Steps that were done.
        steps: usize,
        /// Share of the right side that is left.
        residual: f64,
    },
}
