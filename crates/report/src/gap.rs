//! Diagnoses of a gap, and scores of the diagnosis.

mod page;
mod protocol;
mod scorecard;
mod text;

pub use page::html;
pub use protocol::instructions;
pub use scorecard::{markdown, svg};
pub use text::text;

use dermis_studies::gap::generation;

/// What a benchmark set holds, for people.
#[must_use]
pub fn generated(found: &generation::Findings) -> String {
    format!(
        "{}: {} cases of {} on {}, sha256 {}; ground truths in {}\n",
        found.set.display(),
        found.cases,
        found.kind,
        found.skin,
        found.sha256,
        found.truth.display()
    )
}
