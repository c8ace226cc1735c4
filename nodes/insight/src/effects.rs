//! What a device has that its design has not: the effects of a camera in a soft thumb.
//!
//! [`EFFECTS`] lists them. Most of them change what the model is computed from (`shape`). What creeps, drags and is read row by row acts as a
//! device is stepped (`Dynamics`), on pictures as on numbers.
//!
//! Each is the identity at strength 0, bit for bit, and its deviation from the nominal readings grows with the strength. What is drawn at
//! random has a stream of its own for each effect.

mod dynamics;
mod shape;
mod table;
#[cfg(test)]
mod tests;

pub(crate) use dynamics::{Dynamics, Started};
pub(crate) use shape::shape;
pub use table::EFFECTS;
