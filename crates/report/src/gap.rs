//! Diagnoses of a gap, and scores of the diagnosis.

mod page;
mod scorecard;
mod text;

pub use page::html;
pub use scorecard::{markdown, svg};
pub use text::text;
