//! Where a simulated skin and a real one differ, which effect makes them differ, and how far that closes the gap.

#![allow(missing_docs)]
mod algebra;
mod axes;
mod checks;
mod data;
mod device;
mod diagnose;
mod error;
mod experiments;
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
mod store;
mod unknown;

pub use axes::{Axis, Bin, Map};
pub use checks::Missing;
pub use data::{Moment, Phase, Problem, Recording};
pub use device::{COMMON, CommonEffect, Parameters, common_effect, device};
pub use diagnose::{Diagnosis, Memory, Options, diagnose};
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
