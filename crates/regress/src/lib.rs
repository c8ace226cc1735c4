//! Regression: support vectors, Gaussian processes, extremely randomised trees, nearest neighbours; folds that do not part what belongs
//! together, and settings chosen by them ([`Method::tuned`]).
//!
//! Everything works on tables of `f64`, row by row ([`Rows`]), one row a reading of a skin. [`Svr`] is ε-support vector
//! regression with radial basis functions for any number of outputs over the same inputs. Where many fits share their inputs
//! — the greedy search for sensing elements adds one column at a time — [`solve`] takes the kernel matrix itself, so that
//! outputs and folds share it, which the crates at hand do not offer. [`dense`] has the numbers of networks, whose fitting `dermis-learn` leads.

mod choice;
pub mod dense;
mod error;
mod folds;
mod gaussian;
mod kernel;
mod neighbours;
mod rows;
mod svr;
mod trees;

pub use choice::{Fitted, Method, Settings, Tuning};
pub use error::RegressError;
pub use folds::{folds, shuffled};
pub use gaussian::{EXACT, GaussianSettings, SUPPORTS, gaussian_process};
pub use kernel::{Kernel, KernelExpansion};
pub use neighbours::Neighbours;
pub use rows::{Rows, Standard, stride};
pub use svr::{Dual, Svr, SvrSettings, gram, solve, squared_distances};
pub use trees::{TreeSettings, Trees};
