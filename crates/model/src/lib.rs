//! Forward models: what would the channels of a skin read for this history of stimuli?
//!
//! | word | type | what it is |
//! |---|---|---|
//! | stimulus | [`Stimulus`] | what touches the skin: the input of a forward model |
//! | forward model | [`ForwardModel`] | stimulus → channels |
//! | state | [`Trajectory`] | what the effects of a device remember from frame to frame |
//! | common effects | [`COMMON`], [`device()`] | what every device may have: electronics, placement, the rig |
//!
//! Everything that works on readings (testbed, training, inversion, bounds, diagnosis) is written on [`ForwardModel`].

mod case;
mod device;
mod forward;
mod state;
#[cfg(feature = "test-suite")]
pub mod suite;
mod unknowns;

pub use case::Case;
pub use device::{COMMON, CURVED, CommonEffect, CommonParameters, common_effect, device, full_scale};
pub use forward::{ForwardModel, Indentation, Stimulus};
pub use state::{Memoryless, Trajectory};
pub use unknowns::{Unknown, Unknowns, tangents};
