//! What a device has that its design has not: the effects of barometers in an elastomer.
//!
//! [`EFFECTS`] lists them. Those that change what the model is computed from act in [`shape`]; those that remember, and the
//! electronics, act in a `MediumMemory`, whatever their order in the file, in the order of the signal: what touches
//! (`friction`), the elastomer (`mullins`, `hysteresis`, `relaxation`), the port (`trapped-air`), the air around
//! (`ambient-pressure`), the bus (`read-skew`), the noise, the converter (`saturation`, `resolution`).
//!
//! Each is the identity at strength 0, bit for bit, and its deviation from the nominal readings grows with the strength. What
//! is drawn at random has a stream of its own for each effect and channel, so that another effect, or another channel, changes
//! nothing of it.

mod memory;
mod shape;
mod table;
#[cfg(test)]
mod tests;

pub(crate) use memory::Dynamics;
pub(crate) use shape::shape;
pub use table::EFFECTS;
