//! The rule file, as `dermis-reflex` has it.

#![allow(dead_code, reason = "the rest of the crate uses more of these files")]

#[path = "../../../../nodes/reflex/src/file.rs"]
mod file;
#[path = "../../../../nodes/reflex/src/rules.rs"]
mod rules;

pub use rules::Rules;
