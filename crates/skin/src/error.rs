//! What can be wrong with a skin description.

use std::path::PathBuf;

use dermis_io::toml::Fault;

/// A skin description that cannot be used, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SkinError {
    /// The file cannot be read.
    #[error("skin file {path}: cannot be read: {source}; check the path and its permissions")]
    Read {
        /// File that was requested.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The text is not TOML, or a field has the wrong type.
    #[error("skin file {file}: field `{field}`: {reason}")]
    Parse {
        /// File that the text came from.
        file: String,
        /// Path of the field, e.g. `taxels[3].position`.
        field: String,
        /// What was expected.
        reason: String,
    },
    /// Keys that no version of the format knows: most often a misspelt one.
    #[error("skin file {file}: unknown key `{key}`; remove it or correct its spelling (known here: {known})")]
    UnknownKey {
        /// File that the text came from.
        file: String,
        /// Path of the key.
        key: String,
        /// Keys that are known at the top level.
        known: String,
    },
    /// The fields parse, but what they say is impossible.
    #[error("skin file {file}: field `{field}`: {reason}")]
    Impossible {
        /// File that the text came from.
        file: String,
        /// Path of the field.
        field: String,
        /// Why it cannot be, and what would be right.
        reason: String,
    },
    /// The file of effects cannot be read.
    #[error("effects file {path}: cannot be read: {source}; check the path and its permissions")]
    ReadEffects {
        /// File that was requested.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The text is not TOML, or says something impossible.
    #[error("effects file {file}: field `{field}`: {reason}")]
    Effects {
        /// File that the text came from.
        file: String,
        /// Path of the field, e.g. `effects[2].strength`.
        field: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl SkinError {
    pub(crate) fn parse(file: &str, fault: Fault) -> Self {
        let (field, reason) = fault.into_field();
        Self::Parse { file: file.to_owned(), field, reason }
    }
}
