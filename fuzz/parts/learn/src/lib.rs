//! The file of a label map, as `dermis-learn` has it.

#![allow(dead_code, reason = "the rest of the crate uses more of this file")]

#[path = "../../../../crates/learn/src/map/file.rs"]
mod file;

use std::path::PathBuf;

pub use file::LabelMap;

/// What can be wrong with the file: a part of the crate's own error.
#[derive(Debug, thiserror::Error)]
pub enum LearnError {
    /// A field cannot be used.
    #[error("{file}: field `{field}`: {reason}")]
    Config { file: String, field: String, reason: String },
    /// The file cannot be read.
    #[error("{path} cannot be {action}: {source}")]
    Io { path: PathBuf, action: &'static str, source: std::io::Error },
}

impl LearnError {
    fn io(path: impl Into<PathBuf>, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, action, source }
    }

    fn toml(text: &str, file: &str, error: &toml::de::Error) -> Self {
        let before = error.span().and_then(|s| text.get(..s.start)).unwrap_or_default();
        Self::Config {
            file: file.to_owned(),
            field: format!("(line {})", before.matches('\n').count() + 1),
            reason: error.message().to_owned(),
        }
    }
}
