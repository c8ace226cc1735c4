//! Finite elements, for media that no closed form describes.
//!
//! - [`Solid`]: linear elasticity on a mesh of 8-node hexahedra ([`HexMesh`]), locking-free up to ν = 0.4999;
//! - [`Block`]: a layer that ends somewhere, and [`free_sides`]: what that changes;
//! - [`Dome`]: an elastomer over a rigid core, both hemispheres on cylinders: a body of revolution, solved as a Fourier
//!   series around its axis.
//!
//! What a sensor inside a medium reads is found from the sensor's side. By reciprocity, the displacement that a source of
//! dilatation in the sensor's place makes at a point of the surface is the mean stress in that place under a force at
//! that point. One solution for a sensor therefore holds its answer to every force on the surface: its influence. Both
//! [`Block`] and [`Dome`] give it as a smooth function of the place ([`Bicubic`]). It does not depend on Young's modulus.

mod bicubic;
mod block;
mod dome;
mod mesh;
mod rim;
mod solid;
mod source;
pub(crate) mod sparse;

use nalgebra::Point3;

pub use bicubic::Bicubic;
pub use block::{Block, Sides};
pub use dome::{Dome, DomeShape};
pub use mesh::HexMesh;
pub use rim::free_sides;
pub use solid::Solid;

/// Where a sensor reads the mean compressive stress: points with weights, whose weighted sum is the reading. One point of
/// weight 1 is an ideal sensor; points over an area with weights that sum to 1 are one that averages.
pub type Probe = Vec<(Point3<f64>, f64)>;
