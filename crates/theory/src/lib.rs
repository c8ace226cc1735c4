//! What a skin can know at best, from its forward model or from a recording.
//!
//! Two ways, which meet:
//!
//! - the Cramér–Rao bound: [`cramer_rao`] bounds position and force of any number of contacts that one frame shows;
//!   [`over_surface`] does so for one contact at every point of a skin, and [`two_contacts`] for two that come ever closer.
//!   The bounds are local and take the model for true: a floor below every estimator without bias, and no forecast;
//! - taxel value isolines (H. Sun, *Machine Learning for Haptics*, 2023, chapter 5): [`Responses`] hold what channels read
//!   over locations and forces, of a model or of a recording; an [`Isoline`] is the force that it takes, at every place, for a
//!   channel to read one value; a [`Line`] crosses those of the taxels along a [`Path`], and its [`LineStudy`] is all that
//!   follows. [`IsolineSolver`] finds contacts by such crossings.
//!
//! [`placement`] chooses where sensing elements go, of thousands of locations where they could. [`normalised`] is the setting of two ideal taxels in which the thesis explains it. Nothing here knows a sensor by name,
//! and distances are those along the surface, be it flat or curved.

mod bound;
mod error;
mod isoline;
mod line;
pub mod normalised;
mod path;
pub mod placement;
pub mod resolution;
mod responses;
mod solver;
mod study;
mod surface;
#[cfg(test)]
mod testing;

pub use bound::{BandBox, ContactBound, cramer_rao, strongest_bands};
pub use error::TheoryError;
pub use isoline::{Isoline, IsolineFit, IsolinePoint};
pub use line::{Line, LineTaxel};
pub use path::Path;
pub use responses::{Press, Responses, force_ladder, noise_of_repeats};
pub use solver::{Averaging, IsolineSolver, Solution, SolverOptions};
pub use study::{
    Averages, ByForce, Factors, LineMap, LineStudy, MOST_BANDS, MOST_STUDIED, StudyOptions, TaxelStudy,
    longest_row,
};
pub use surface::{Summary, SurfaceBound, TwoContacts, over_surface, over_surface_and_bands, two_contacts};
