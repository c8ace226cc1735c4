//! A camera inside a soft thumb (thesis, chapter 6): the mechanics of its skin.
//!
//! Forces on the points of the outside ([`surface`]) become displacements of the inside, which the camera sees ([`elastic`]). The family is not
//! registered yet: lens, light, wire and effects are missing.

pub mod elastic;
pub mod shape;
pub mod surface;
