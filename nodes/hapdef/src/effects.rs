//! What a device has that its design has not: the effects of strain gauges on a shell.
//!
//! [`EFFECTS`] lists them. Those that change what the model is computed from act in [`shape`]; those that remember, the hand that
//! touches and the electronics act in a `ShellMemory`, whatever their order in the file, in the order of the signal: what touches
//! (`oblique-force`, `friction`), the shell (`creep`), the gauges (`temperature`, `zero-drift`), the noise, the amplifier and its
//! converter (`saturation`, and the bridge of the skin description).
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
