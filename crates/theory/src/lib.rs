//! What a skin can know at best, from its forward model alone.
//!
//! [`cramer_rao`] bounds position and force of any number of contacts that one frame shows; [`over_surface`] does so for
//! one contact at every point of a skin, and [`two_contacts`] for two that come ever closer. The bounds are local and take
//! the model for true: a floor below every estimator without bias, and no forecast.

mod bound;
mod error;
pub mod normalised;
mod surface;

pub use bound::{ContactBound, Unknowns, cramer_rao};
pub use error::TheoryError;
pub use surface::{Summary, SurfaceBound, TwoContacts, over_surface, two_contacts};
