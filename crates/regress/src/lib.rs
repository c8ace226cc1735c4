//! Regression that is small enough to be fitted thousands of times: support vectors, nearest neighbours, and folds that do
//! not part what belongs together.
//!
//! Everything works on tables of `f64`, row by row ([`Rows`]), one row a reading of a skin. [`Svr`] is ε-support vector
//! regression with radial basis functions for any number of outputs over the same inputs. Where many fits share their inputs
//! — the greedy search for sensing elements adds one column at a time — [`solve`] takes the kernel matrix itself, so that
//! outputs and folds share it, which the crates at hand do not offer.

mod error;
mod folds;
mod neighbours;
mod rows;
mod svr;

pub use error::RegressError;
pub use folds::{folds, shuffled};
pub use neighbours::Neighbours;
pub use rows::{Rows, Standard};
pub use svr::{Dual, Svr, SvrSettings, gram, solve, squared_distances};
