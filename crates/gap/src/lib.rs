//! Where a simulated skin and a real one differ, which effect makes them differ, and how far that closes the gap.

#![allow(missing_docs)]
mod algebra;
mod data;
mod device;
mod error;
mod library;
mod noise;
mod read;
mod rows;
mod select;
mod simulate;
mod statistics;

pub use data::{Moment, Phase, Problem, Recording};
pub use device::{COMMON, CommonEffect, Parameters, common_effect, device};
pub use error::GapError;
pub use noise::Gap;
pub use read::read;
pub use rows::{RowOptions, Row, Rows};
pub use select::{SelectOptions, Tier};
pub use simulate::{Make, Simulator};
