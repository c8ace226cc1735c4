//! What a skin can know at best, from its forward model alone.
//!
//! [`cramer_rao`] bounds position and force of any number of contacts that one frame shows; [`over_surface`] does so for
//! one contact at every point of a skin, and [`two_contacts`] for two that come ever closer. The bounds are local and take
//! the model for true: a floor below every estimator without bias, and no forecast.

mod bound;
mod error;
mod isoline;
mod line;
pub mod normalised;
mod path;
pub mod resolution;
mod responses;
mod solver;
mod surface;
#[cfg(test)]
mod testing;

pub use bound::{BandBox, ContactBound, Unknowns, cramer_rao, strongest_bands};
pub use error::TheoryError;
pub use isoline::{Isoline, IsolineFit, IsolinePoint};
pub use line::{Line, LineTaxel};
pub use path::Path;
pub use responses::{Press, Responses, force_ladder, noise_of_repeats};
pub use solver::{Averaging, IsolineSolver, Solution, SolverOptions};
pub use surface::{Summary, SurfaceBound, TwoContacts, over_surface, two_contacts};
