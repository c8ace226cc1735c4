//! What can be wrong with data, configuration or training.

use std::path::PathBuf;

use dermis_bag::BagError;
use dermis_inference::{BundleError, FeatureError, JoinError, ModelError, OutputError};
use dermis_skin::EstimateError;
use serde::de::DeserializeOwned;

use crate::Findings;

/// Why there is no data set, split, model or evaluation.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearnError {
    /// A bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A picture of a report cannot be drawn.
    #[error(transparent)]
    Figure(#[from] dermis_figures::DrawError),
    /// A bag that is not what it was when it was first read.
    #[error("bag {bag} has changed since it was first read: leave it alone until this command ends")]
    Changed {
        /// The bag.
        bag: PathBuf,
    },
    /// An image of a kind that is not known.
    #[error(
        "bag {bag}: an image has the encoding \"{encoding}\", or rows with something between them, and only whole \"mono8\" and \
         \"rgb8\" are read; convert it, or record the node's own topic `image`"
    )]
    Image {
        /// The bag.
        bag: PathBuf,
        /// As the message says.
        encoding: String,
    },
    /// An image that does not divide as a model wants it.
    #[error("bag {bag}: {source}; choose a size that divides it (`features.image`)")]
    ImageSize {
        /// The bag.
        bag: PathBuf,
        /// What does not fit.
        source: dermis_skin::ImageGridError,
    },
    /// The data cannot be used as requested; all reasons at once.
    #[error("{0}")]
    Unfit(Findings),
    /// A file of other people's formats cannot be written.
    #[error("{path} cannot be written: {reason}")]
    Export {
        /// The file.
        path: PathBuf,
        /// What the writer said.
        reason: String,
    },
    /// A split that leaves one part empty.
    #[error("split by {kind}: {reason}")]
    Split {
        /// What it splits by.
        kind: &'static str,
        /// Why it cannot be, and what to do.
        reason: String,
    },
    /// A configuration that cannot be.
    #[error("{file}: field `{field}`: {reason}")]
    Config {
        /// Where it came from.
        file: String,
        /// Path of the field.
        field: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A bound that cannot be read.
    #[error("requirement `{text}`: {reason}")]
    Requirement {
        /// As it was given.
        text: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// Bounds that are not reached.
    #[error("{missed} of {of} requirements missed")]
    Missed {
        /// Number of them.
        missed: usize,
        /// Number of all.
        of: usize,
    },
    /// Features refuse their configuration or a frame.
    #[error(transparent)]
    Feature(#[from] FeatureError),
    /// Outputs refuse their configuration or a value.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A model bundle cannot be read or written.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// Two bundles cannot become one.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A model does not run.
    #[error("model: {0}")]
    Model(#[from] ModelError),
    /// An estimator has no answer.
    #[error("bag {bag}: {source}")]
    Estimate {
        /// Bag that the frame is from.
        bag: PathBuf,
        /// What the estimator said.
        source: EstimateError,
    },
    /// A model that does not fit the skin.
    #[error(transparent)]
    Setup(Box<dermis_estimate::SetupError>),
    /// A model has no answer to a frame.
    #[error(transparent)]
    Find(#[from] dermis_estimate::FindError),
    /// A file cannot be read or written.
    #[error("{path} cannot be {action}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// `read` or `written`.
        action: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// A checkpoint that cannot be continued.
    #[error("checkpoint {path}: {reason}; train without `--resume` to begin anew")]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// Training was stopped.
    #[error("interrupted after epoch {epoch} of {epochs}; continue with `--resume` (state in {path})")]
    Interrupted {
        /// Epochs done by the member that has done fewest.
        epoch: u32,
        /// Epochs requested.
        epochs: u32,
        /// Where the state lies.
        path: PathBuf,
    },
    /// Recordings that do not tell what a refinement on the forward model needs.
    #[error("skin `{skin}`: cannot be refined on its forward model: {reason}")]
    Refinement {
        /// Name of the skin.
        skin: String,
        /// What is missing, and what to do.
        reason: String,
    },
    /// Training went wrong.
    #[error("training: {reason}")]
    Training {
        /// What happened, and what to do.
        reason: String,
    },
}

impl LearnError {
    /// Maps an I/O error at a path.
    pub(crate) fn io(path: impl Into<PathBuf>, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, action, source }
    }

    /// A file of TOML as a value.
    pub(crate) fn of_toml<T: DeserializeOwned>(text: &str, file: &str) -> Result<T, Self> {
        dermis_io::toml::parse(text).map_err(|fault| {
            let (field, reason) = fault.into_field();
            Self::Config { file: file.to_owned(), field, reason }
        })
    }
}
