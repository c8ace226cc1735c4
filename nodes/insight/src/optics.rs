//! What the camera sees of the inside: lens, lamps, and the table from which pictures are made.

mod casting;
mod clipping;
pub mod displaced;
mod grouped;
pub mod lens;
pub mod light;
mod numbers;
pub mod observer;
pub mod picture;
pub mod ridges;
pub mod shading;
pub mod slopes;
pub mod table;
mod visibility;

pub use lens::Camera;
pub use light::{Lamp, Light};
pub use observer::Observer;
pub use picture::{Noise, Picture};
pub use shading::Shading;
pub use table::Table;
