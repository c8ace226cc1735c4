//! Where a simulated skin and a real one differ, which effect makes them differ, and how far that closes the gap.
//!
//! | word | type | what it is |
//! |---|---|---|
//! | recording | [`Recording`] | what was done to a skin and what it read; [`read`] takes it from bags |
//! | simulator | [`Simulator`] | the skin by design, its family's effects, and how its model is made |
//! | common effects | [`COMMON`], [`device`] | effects that every skin can have, around its family's model |
//! | diagnosis | [`diagnose`], [`Report`] | verdict, size, place, causes with their classes, closure |
//!
//! A gap is readings minus nominal model. Effects are compared by their signatures: what switching them on changes in our own
//! simulator, over the presses of the recording. Whatever is measured of an effect is measured on places that it was not fitted
//! to. Energies are in deviations of the noise squared; shares are of the readings' variance unless they say otherwise.
//!
//! Nothing here knows a sensor by name.

mod algebra;
mod axes;
mod checks;
mod data;
mod diagnose;
mod error;
mod experiments;
mod hum;
mod library;
mod noise;
mod parity;
mod polish;
mod read;
mod report;
mod rows;
mod select;
mod simulate;
mod statistics;
mod steps;
mod store;
mod unknown;

pub use axes::{Axis, Bin, Map};
pub use checks::Missing;
pub use data::{Moment, Problem, Recording, Zero};
pub use dermis_model::{COMMON, CommonEffect, CommonParameters, common_effect, device};
pub use dermis_skin::Phase;
pub use diagnose::{Diagnosis, Memory, Options, cut, diagnose};
pub use error::GapError;
pub use experiments::Experiment;
pub use noise::Gap;
pub use parity::Parity;
pub use read::read;
pub use report::*;
pub use rows::{Row, RowOptions, Rows};
pub use select::{SelectOptions, Tier};
pub use simulate::{Make, Simulator};
pub use store::skin_text;
