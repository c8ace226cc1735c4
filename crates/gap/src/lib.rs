//! Where a simulated skin and a real one differ, which effect makes them differ, and how far that reduces the gap.
//!
//! | word | type | what it is |
//! |---|---|---|
//! | recording | [`Recording`] | what was done to a skin and what it read; [`read`] takes it from bags |
//! | simulator | [`Simulator`] | the skin by design, its family's effects, and how its model is made |
//! | samples | [`Samples`] | the frames of a recording that are compared |
//! | common effects | [`COMMON`], [`device`] | effects that every skin can have, around its family's model |
//! | diagnosis | [`diagnose`], [`Report`] | verdict, size, place, causes with their classes, residual reduction |
//!
//! A gap is readings minus nominal model. Effects are compared by their signatures: what switching them on changes in our own
//! simulator, over the presses of the recording. Whatever is measured of an effect is measured on locations that it was not fitted
//! to. Energies are in deviations of the noise squared; shares are of the readings' variance (FVU) unless they say otherwise.
//!
//! Columns of effects are what switching an effect on changes in whole frames, of all contacts at once. Changes of several effects are
//! added to first order; nothing is taken to add up over contacts, so that a model need not superpose.
//!
//! Nothing here knows a sensor by name, and no stage of [`diagnose`] an effect.

mod algebra;
mod axes;
mod checks;
mod consistency_checks;
mod constants;
mod design;
mod diagnose;
mod effects;
mod error;
mod experiments;
mod explainability;
mod mains_interference;
mod noise;
mod nonlinear_refinement;
pub mod protocol;
mod quantization;
mod read;
mod recording;
mod report;
mod rivals;
mod samples;
mod select;
mod signatures;
mod simulate;
mod statistics;
mod store;
#[cfg(test)]
mod testing;
pub mod unknown;
mod whitening;
mod wording;
mod zero_level;

pub use axes::{Axis, Bin, Map};
pub use checks::Missing;
pub use consistency_checks::ConsistencyCheck;
pub use dermis_model::{COMMON, CommonEffect, CommonParameters, common_effect, device};
pub use dermis_skin::Phase;
pub use diagnose::{Diagnosis, Memory, Options, calibrate, diagnose};
pub use error::GapError;
pub use experiments::Experiment;
pub use noise::Gap;
pub use read::{read, touch};
pub use recording::{FrameLabel, Problem, Recording, Zero};
pub use report::*;
pub use rivals::{Rival, Shape, Structure};
pub use samples::{Sample, SampleOptions, Samples};
pub use select::{SelectOptions, Tier};
pub use simulate::{Make, Simulator};
pub use store::skin_text;
pub use whitening::mask_saturated;
