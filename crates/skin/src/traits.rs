//! Frame → contacts, and what models and estimators refuse.

use std::path::{Path, PathBuf};

use crate::{Estimate, Frame};

/// Why a forward model has no answer.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The stimulus cannot be: off the surface, or not a number.
    #[error("contact {index}: {reason}")]
    Stimulus {
        /// Which contact.
        index: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// The skin description lacks something that the model needs, or asks for something it cannot do.
    #[error("skin `{skin}`: field `{field}`: {reason}")]
    Description {
        /// Name of the skin.
        skin: String,
        /// Path of the field.
        field: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The same of a skin description that was read from a file.
    #[error("skin file {path}: field `{field}`: {reason}")]
    File {
        /// The file.
        path: PathBuf,
        /// Path of the field.
        field: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl ModelError {
    /// The same, of a skin description that was read from this file.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Description { field, reason, .. } => Self::File { path: path.to_owned(), field, reason },
            other => other,
        }
    }

    /// Whether it is about the table `medium` of a skin description.
    #[must_use]
    pub fn is_of_medium(&self) -> bool {
        matches!(self, Self::Description { field, .. } if field == "medium" || field.starts_with("medium."))
    }
}

/// Why an estimator has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EstimateError {
    /// The frame does not belong to this skin.
    #[error("frame {sequence} has {found} channels where the skin has {expected}")]
    Channels {
        /// Sequence number of the frame.
        sequence: u64,
        /// Channels in the frame.
        found: usize,
        /// Channels of the skin.
        expected: usize,
    },
    /// The model failed.
    #[error("frame {sequence}: {reason}")]
    Model {
        /// Sequence number of the frame.
        sequence: u64,
        /// What the model said.
        reason: String,
    },
}

/// Frame → contacts. Estimators keep state (tare, filters, tracks), so frames come in order.
pub trait Estimator: Send {
    /// What this frame says.
    ///
    /// # Errors
    ///
    /// [`EstimateError::Channels`] for a frame of another skin, [`EstimateError::Model`] where inference fails.
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError>;

    /// Forget everything that earlier frames left behind, e.g. before another recording.
    fn reset(&mut self);

    /// Take a new zero from the frames that follow: the caller knows that nothing touches the skin, whatever the
    /// readings look like. History that was seen with the zero before is forgotten.
    fn tare(&mut self) {
        self.reset();
    }
}
