//! Why a bundle cannot be used or written.

use std::path::PathBuf;

use crate::correction::CorrectionError;
use crate::manifest::ManifestError;
use crate::model::ModelError;

/// A bundle that cannot be used or written, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BundleError {
    /// There is no such folder.
    #[error(
        "model bundle {path}: there is no such folder; train one with `dermis train` or correct the path"
    )]
    NoFolder {
        /// Folder that was requested.
        path: PathBuf,
    },
    /// A file of the bundle is not there.
    #[error(
        "model bundle {path}: holds no `{file}`, so it is not a whole bundle; copy it again or train it anew"
    )]
    NoFile {
        /// Folder of the bundle.
        path: PathBuf,
        /// File that is missing.
        file: &'static str,
    },
    /// A file or folder cannot be read or written.
    #[error("model bundle: {path} cannot be {action}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// `read` or `written`.
        action: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// What lies in a file's place is none.
    #[error(
        "model bundle file {path}: is no plain file, but a pipe, a device or a folder; copy the bundle again"
    )]
    NotAFile {
        /// What lies there.
        path: PathBuf,
    },
    /// A file is longer than any of its kind is.
    #[error(
        "model bundle file {path}: has {found} bytes, and at most {most} are read; is it the right file?"
    )]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Its length.
        found: u64,
        /// The longest that is read.
        most: u64,
    },
    /// The manifest is wrong.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The graph's file is shorter or longer than the manifest says.
    #[error(
        "model file {path}: has {found} bytes where bundle.toml field `{field}.bytes` says {expected}: it was cut short \
         or replaced; copy the bundle again"
    )]
    Length {
        /// File of the graph.
        path: PathBuf,
        /// Table of the manifest that speaks of it.
        field: &'static str,
        /// Its length.
        found: u64,
        /// Length that the manifest says.
        expected: u64,
    },
    /// The graph's file has another content than the manifest says.
    #[error(
        "model file {path}: has hash {found} where bundle.toml field `{field}.hash` says {expected}: it was damaged or \
         replaced; copy the bundle again"
    )]
    Content {
        /// File of the graph.
        path: PathBuf,
        /// Table of the manifest that speaks of it.
        field: &'static str,
        /// Its hash.
        found: String,
        /// Hash that the manifest says.
        expected: String,
    },
    /// The graph cannot be used.
    #[error("model file {path}: {source}")]
    Model {
        /// File of the graph.
        path: PathBuf,
        /// What is wrong with it.
        source: ModelError,
    },
    /// The correction of the forward model cannot be used.
    #[error("model bundle file {path}: {source}")]
    Correction {
        /// Its file.
        path: PathBuf,
        /// What is wrong with it.
        source: CorrectionError,
    },
    /// The model was trained for another skin.
    #[error(transparent)]
    AnotherSkin(Box<SkinMismatch>),
    /// The manifest names the skin's hash, but other channels or another unit: someone has edited it.
    #[error(
        "bundle file {path}: field `{field}`: {difference}, though `skin.hash` is that of skin `{skin}`; restore the file"
    )]
    Contradiction {
        /// The manifest.
        path: PathBuf,
        /// `skin.channels` or `skin.unit`.
        field: &'static str,
        /// What differs.
        difference: String,
        /// Name of the skin.
        skin: String,
    },
    /// The folder to write holds something else.
    #[error("model bundle {path}: the folder exists and is no bundle; choose another one")]
    Occupied {
        /// Folder that was requested.
        path: PathBuf,
    },
    /// The card cannot be written as JSON, or the manifest as TOML.
    #[error("model bundle {path}: {file} cannot be encoded: {reason}")]
    Encode {
        /// Folder of the bundle.
        path: PathBuf,
        /// The file.
        file: &'static str,
        /// Why.
        reason: String,
    },
}

/// The skin that a model was trained for, and the one that it is to be used on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "model bundle {path}: was trained for skin `{bundle_skin}` ({bundle_hash}), not for `{skin}` ({skin_hash}): \
     {difference}; train a model for this skin"
)]
pub struct SkinMismatch {
    /// Folder of the bundle.
    pub path: PathBuf,
    /// Name of the skin that it was trained for.
    pub bundle_skin: String,
    /// Hash of the skin that it was trained for.
    pub bundle_hash: String,
    /// Name of the skin that it is to be used on.
    pub skin: String,
    /// Hash of the skin that it is to be used on.
    pub skin_hash: String,
    /// What differs.
    pub difference: String,
}
