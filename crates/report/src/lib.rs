//! What only a person reads: findings of studies and of running skins as text, HTML pages and figures, each made once, here.
//!
//! Pages need nothing beside them. Figures are drawn by `dermis-figures`.

pub mod bounds;
pub mod collection;
pub mod comparison;
pub mod demo;
pub mod effects;
pub mod evaluation;
pub mod gap;
pub mod placement;
pub mod real2sim;
pub mod recording;
pub mod refinement;
pub mod skin;
pub mod sweep;
pub mod touch;
pub mod validation;
