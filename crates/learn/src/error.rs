//! What can be wrong with data, configuration or training.

use std::path::PathBuf;

use dermis_bag::BagError;
use dermis_inference::{BundleError, FeatureError, ModelError, OutputError};
use dermis_skin::EstimateError;

/// Why there is no data set, split, model or evaluation.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearnError {
    /// A bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A bag holds no frames of the skin.
    #[error("bag {bag}: holds no frames of skin `{skin}`; it has {found}")]
    NoFrames {
        /// The bag.
        bag: PathBuf,
        /// Skin that was asked for.
        skin: String,
        /// Skins that the bag has.
        found: String,
    },
    /// A bag holds frames but no ground truth.
    #[error(
        "bag {bag}: holds {frames} frames of skin `{skin}` but no ground truth (dermis_msgs/msg/Indentation) for it; \
         record one with `dermis collect`, or `dermis import` a labelled recording"
    )]
    NoTruth {
        /// The bag.
        bag: PathBuf,
        /// Skin that was asked for.
        skin: String,
        /// Number of its frames.
        frames: usize,
    },
    /// Ground truth and frames never meet.
    #[error(
        "bag {bag}: none of {frames} frames has ground truth within {tolerance} s of its stamp; check that both were \
         stamped by the same clock"
    )]
    NeverMeet {
        /// The bag.
        bag: PathBuf,
        /// Number of frames.
        frames: usize,
        /// \[s\] largest distance in time that counts as the same instant.
        tolerance: f64,
    },
    /// The frames are not those that the skin description says.
    #[error("bag {bag}: frame {sequence}: {reason}; check the skin description")]
    Frame {
        /// The bag.
        bag: PathBuf,
        /// Sequence number of the frame.
        sequence: u64,
        /// What does not fit.
        reason: String,
    },
    /// No untouched reading to take the zero from.
    #[error(
        "bag {bag}: the zero is unknown for every labelled frame, since no stretch of {tare} s (and 3 frames) before \
         them is labelled untouched; record idle frames first, or train with `baseline = \"raw\"`"
    )]
    NoZero {
        /// The bag.
        bag: PathBuf,
        /// \[s\] of untouched readings that a tare averages.
        tare: f64,
    },
    /// A split that leaves one part empty.
    #[error("split by {kind}: {reason}")]
    Split {
        /// What it splits by.
        kind: &'static str,
        /// Why it cannot be, and what to do.
        reason: String,
    },
    /// A quantity that the ground truth does not hold.
    #[error("target `{target}`: {reason}; the ground truth holds {known}")]
    Target {
        /// Name of the target.
        target: String,
        /// What is wrong with it.
        reason: String,
        /// Targets that there are.
        known: String,
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
    /// Features refuse their configuration or a frame.
    #[error(transparent)]
    Feature(#[from] FeatureError),
    /// Outputs refuse their configuration or a value.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A model bundle cannot be read or written.
    #[error(transparent)]
    Bundle(#[from] BundleError),
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
        /// Epochs asked for.
        epochs: u32,
        /// Where the state lies.
        path: PathBuf,
    },
    /// Training went wrong.
    #[error("training: {reason}")]
    Training {
        /// What happened, and what to do.
        reason: String,
    },
}

#[cfg(feature = "train")]
impl LearnError {
    /// Maps an I/O error at a path.
    pub(crate) fn io(path: impl Into<PathBuf>, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, action, source }
    }
}
