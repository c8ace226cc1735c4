//! Elastic media, Green's functions and fields.
//!
//! A flat skin is a layer of elastomer on a rigid base, touched from above; what a sensor inside it feels is a
//! convolution of the contact pressure with the layer's Green's function. Both sides are axisymmetric around a
//! contact, so everything here lives in Hankel space:
//!
//! - [`Medium`]: the layer (or the half-space), its kernels for mean compressive stress at a depth and for the
//!   displacement of the surface;
//! - [`Load`]: point, disc and Hertz-like surface loads;
//! - [`SphereContact`]: a rigid sphere pressed into the medium: contact radius, indentation, pressure;
//! - [`RigidContact`]: a rigid tip of any shape on a surface that is known by its compliance at points;
//! - [`PressureTable`]: what a sensor at one depth reads for a sphere, tabulated over force and distance;
//! - [`Case`]: a figure and the reference that it is checked against.
//!
//! All quantities are in SI units. z points into the medium, its surface is z = 0. Strains are small and the
//! material is linear throughout.
//!
//! ```
//! use dermis_mechanics::{Base, Load, Medium};
//!
//! let pad = Medium::layer(70e3, 0.49, 0.010, Base::Bonded)?;
//! let press = Load::Disc { force: 1.0, radius: 0.001 };
//! let pressure = pad.pressure(&press, 0.005, 0.0)?;
//! assert!((pressure - 6882.0).abs() < 10.0);
//! # Ok::<(), dermis_mechanics::MechanicsError>(())
//! ```

pub mod calculix;

mod contact;
mod displacement;
mod error;
pub mod fem;
mod friction;
mod medium;
mod memory;
mod quadrature;
mod rigid;
pub mod shell;
mod table;

pub use contact::SphereContact;
pub use dermis_model::Case;
pub use displacement::{Displacement, SphereDisplacement};
pub use error::{MechanicsError, VerifyError};
pub use friction::Friction;
pub use medium::{Base, Load, Medium};
pub use memory::{Prony, RandomDrift, RandomWalk, Warmth, random_field, stream};
pub use quadrature::gauss_legendre;
pub use rigid::RigidContact;
pub use table::{PressureTable, Profile, SphereContacts};
