//! What can go wrong on a testbed.

use std::path::PathBuf;

use dermis_bag::BagError;
use dermis_skin::ModelError;
use dermis_transport::TransportError;

/// A plan, a collection or a simulated device that cannot be, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TestbedError {
    /// The plan file cannot be read.
    #[error("plan file {path}: cannot be read: {source}; check the path and its permissions")]
    ReadPlan {
        /// File that was requested.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The plan is not TOML, has an unknown key, or asks for something impossible.
    #[error("plan {file}: field `{field}`: {reason}")]
    Plan {
        /// File that the plan came from, or its name.
        file: String,
        /// Path of the field, e.g. `steps[2].force`.
        field: String,
        /// What is wrong with it, and what would be right.
        reason: String,
    },
    /// A device that cannot be simulated.
    #[error(transparent)]
    Simulated(#[from] ModelError),
    /// Model and skin description are not of the same skin.
    #[error(
        "the model has {model} channels where skin `{skin}` has {channels}: they describe different skins"
    )]
    Channels {
        /// Channels of the model.
        model: usize,
        /// Name of the skin.
        skin: String,
        /// Channels of the skin.
        channels: usize,
    },
    /// The model has no answer for a planned stimulus.
    #[error("press {press} of the plan: {source}")]
    Model {
        /// Number of the press.
        press: u64,
        /// What the model said.
        source: ModelError,
    },
    /// The bag cannot be written or read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The simulated device has no line to send on.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The simulated device lost its line, or its thread could not be started.
    #[error("simulated device of skin `{skin}`: {what}: {source}")]
    Device {
        /// Name of the skin.
        skin: String,
        /// What it was doing.
        what: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// The wire of the skin cannot carry its frames, or is not known here.
    #[error("simulated device of skin `{skin}`: its wire {reason}")]
    Wire {
        /// Name of the skin.
        skin: String,
        /// What is wrong.
        reason: String,
    },
    /// A recording does not fit the skin that it is replayed for.
    #[error("bag {path}: {reason}")]
    Recording {
        /// The bag.
        path: PathBuf,
        /// What does not fit.
        reason: String,
    },
    /// A collection cannot go on where another one stopped.
    #[error("bag {path}: cannot be gone on with: {reason}")]
    Resume {
        /// The bag.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A file or folder cannot be moved or removed.
    #[error("{path}: cannot be {action}: {source}")]
    Io {
        /// Which.
        path: PathBuf,
        /// What was to be done with it.
        action: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
}
