//! The rule file, as `dermis-reflex` has it.

#![allow(dead_code, reason = "the rest of the crate uses more of these files")]

// A module with a path of its own: the files below `file` are found beside it.
#[path = "../../../../nodes/reflex/src"]
mod reflex {
    pub mod file;
    pub mod rules;
}

use reflex::rules;
pub use reflex::rules::Rules;
