//! Forward models: what would the channels of a skin read for this history of stimuli?
//!
//! | word | type | what it is |
//! |---|---|---|
//! | stimulus | [`Stimulus`], [`Indentation`], [`Tip`] | what touches the skin: the input of a forward model |
//! | forward model | [`ForwardModel`] | stimulus → channels |
//! | untouched readings | [`Untouched`] | what is subtracted from readings to have signals |
//! | state | [`DeviceState`], [`Memory`] | a device from when it was switched on, and what it remembers from frame to frame |
//! | derivatives | [`ForwardModel::jacobian`], [`Differences`] | channels by the [`Unknowns`] of contacts |
//! | common effects | [`COMMON`], [`device()`] | what every device may have: electronics, placement, the rig |
//! | work in parallel | [`in_parallel`] | the same of many contacts, pixels, devices at a time |
//! | wrappers | [`Wrapper`], [`WithNoise`] | models around models |
//!
//! Everything that works on readings (testbed, training, inversion, bounds, diagnosis) is written on [`ForwardModel`].

mod case;
mod differences;
mod effects;
mod forward;
mod parallel;
mod state;
mod stimulus;
#[cfg(any(test, feature = "test-suite"))]
pub mod suite;
mod unknowns;
mod untouched;
mod with_effects;
mod wrapper;

pub use case::Case;
pub use differences::{Differences, MovedForce};
pub use effects::{
    COMMON, CommonEffect, CommonParameters, NEUTRAL_TEMPERATURE, Stage, common_effect, diagnosis, full_scale,
};
pub use forward::ForwardModel;
pub use parallel::in_parallel;
pub use state::{DeviceState, Memory, Memoryless, Stepped};
pub use stimulus::{Indentation, Stimulus, Tip, TipShape};
pub use unknowns::{Unknown, Unknowns, tangents};
pub use untouched::Untouched;
pub use with_effects::device;
pub use wrapper::{WithNoise, Wrapper};
