//! Why a manifest cannot be used.

use super::SCHEMA_VERSION;

/// A manifest that cannot be used, and why.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ManifestError {
    /// The text is not TOML, or a field is missing or has the wrong type.
    #[error("bundle file {file}: field `{field}`: {reason}")]
    Parse {
        /// File that the text came from.
        file: String,
        /// Path of the field, or a line and column.
        field: String,
        /// What was expected.
        reason: String,
    },
    /// A key that this version of the format does not know.
    #[error("bundle file {file}: unknown key `{key}`; remove it or correct its spelling")]
    UnknownKey {
        /// File that the text came from.
        file: String,
        /// Path of the key.
        key: String,
    },
    /// A newer program wrote it.
    #[error(
        "bundle file {file}: field `schema`: is \"{found}\", newer than \"dermis-bundle/{SCHEMA_VERSION}\"; update dermis \
         or train the model again with this version"
    )]
    Newer {
        /// File that the text came from.
        file: String,
        /// Schema of the file.
        found: String,
    },
    /// The fields parse, but what they say is impossible.
    #[error("bundle file {file}: field `{field}`: {reason}")]
    Impossible {
        /// File that the text came from.
        file: String,
        /// Path of the field.
        field: String,
        /// Why it cannot be, and what would be right.
        reason: String,
    },
}
