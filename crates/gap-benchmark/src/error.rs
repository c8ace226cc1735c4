//! What can go wrong with reference devices and benchmark sets.

use std::path::PathBuf;

use dermis_bag::BagError;
use dermis_skin::{ModelError, SkinDescription, SkinError};
use dermis_testbed::TestbedError;

/// A reference device or a benchmark set that cannot be, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BenchmarkError {
    /// No reference device is like this skin.
    #[error("skin `{skin}`: field `{field}`: {reason}")]
    Skin {
        /// Name of the skin.
        skin: String,
        /// Path of the field.
        field: String,
        /// What is wrong with it, and what would be right.
        reason: String,
    },
    /// A requested cause is known to no reference device.
    #[error("`{id}` is no cause of such a reference device; it has {known}")]
    Cause {
        /// As it was requested.
        id: String,
        /// What there is.
        known: String,
    },
    /// The model of a design that the benchmark does not compute itself cannot be had.
    #[error("skin `{skin}`: the model of its design, which the benchmark is handed, cannot be had: {reason}")]
    Design {
        /// Name of the skin.
        skin: String,
        /// Why not.
        reason: String,
    },
    /// A file or folder cannot be read or written.
    #[error("{path}: cannot be {action}: {source}")]
    Io {
        /// Which.
        path: PathBuf,
        /// What was to be done with it.
        action: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file does not say what it should.
    #[error("{path}: {reason}")]
    File {
        /// Which.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A ground truth is not the one whose hash was published.
    #[error(
        "{path}: has SHA-256 {found} where the manifest published {published}: it was changed after it was sealed"
    )]
    Seal {
        /// The ground truth.
        path: PathBuf,
        /// Of what lies there.
        found: String,
        /// Of what was sealed.
        published: String,
    },
    /// What touches the skin cannot be planned.
    #[error(transparent)]
    Testbed(#[from] TestbedError),
    /// A stimulus has no answer.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The skin description is wrong.
    #[error(transparent)]
    Description(#[from] SkinError),
    /// The bag cannot be written.
    #[error(transparent)]
    Bag(#[from] BagError),
}

impl BenchmarkError {
    /// A skin that no reference device is like, by the field that says so.
    pub(crate) fn skin(skin: &SkinDescription, field: &str, reason: &str) -> Self {
        Self::Skin { skin: skin.name.clone(), field: field.to_owned(), reason: reason.to_owned() }
    }

    pub(crate) fn io(path: &std::path::Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }
}
