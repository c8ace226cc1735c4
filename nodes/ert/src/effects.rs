//! What a device has that its design has not: the effects of fabric over foam.
//!
//! [`EFFECTS`] lists them. Most of them change what the model is computed from (`shape`); those of the foam's memory do, too, as
//! the model itself remembers. What drifts, and the time that a scan takes, act as a device is stepped (`Dynamics`).
//!
//! Each is the identity at strength 0, bit for bit, and its deviation from the nominal readings grows with the strength. What
//! is drawn at random has a stream of its own for each effect and electrode, so that another effect, or another electrode, changes
//! nothing of it.

mod dynamics;
mod shape;
mod table;
#[cfg(test)]
mod tests;

pub(crate) use dynamics::{Dynamics, Started};
pub(crate) use shape::shape;
pub use table::EFFECTS;
