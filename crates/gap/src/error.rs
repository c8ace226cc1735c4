//! Why a recording gets no diagnosis: what is wrong with the simulator, the bag, its labels or a file.

use std::path::PathBuf;

use dermis_skin::ModelError;

/// Why there is no diagnosis.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GapError {
    /// The forward model has no answer.
    #[error("{what}: {source}")]
    Model {
        /// What was simulated.
        what: String,
        /// What the model said.
        source: ModelError,
    },
    /// The forward model of a changed skin cannot be made.
    #[error("{what}: {reason}")]
    Make {
        /// What was simulated.
        what: String,
        /// What stood in the way.
        reason: String,
    },
    /// A bag cannot be read.
    #[error(transparent)]
    Bag(#[from] dermis_bag::BagError),
    /// Readings and ground truth cannot be joined.
    #[error(transparent)]
    Learn(#[from] dermis_learn::LearnError),
    /// The recording is of another skin.
    #[error("{place}: {reason}")]
    Recording {
        /// Which recording.
        place: String,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// A file cannot be written or read.
    #[error("{path}: cannot be {what}: {source}")]
    File {
        /// Which file.
        path: PathBuf,
        /// `read` or `written`.
        what: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// Something cannot be put into words of a file format.
    #[error("{what} cannot be written: {reason}")]
    Format {
        /// What.
        what: &'static str,
        /// Why.
        reason: String,
    },
    /// The user has had enough.
    #[error("interrupted; what was simulated so far is kept where a cache folder was named")]
    Interrupted,
}
