//! What can go wrong with a launch.

use std::path::PathBuf;

/// What can go wrong with a launch, with the file and the field that it is about.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LaunchError {
    /// A file cannot be read, or is neither TOML nor YAML.
    #[error("launch file {path}: {reason}")]
    Read {
        /// File that was requested.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A field cannot be used.
    #[error("launch file {path}: field `{field}`: {reason}")]
    Field {
        /// File that holds it.
        path: PathBuf,
        /// Path of the field in the file, e.g. `processes[2].parameters.rate`.
        field: String,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// An argument that was given from outside cannot be used.
    #[error("launch file {path}: argument `{argument}`: {reason}")]
    Argument {
        /// File that it was given to.
        path: PathBuf,
        /// The argument as given.
        argument: String,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// The system refused something that a launch needs.
    #[error("{what}: {source}")]
    System {
        /// What was tried.
        what: String,
        /// What the system said.
        source: std::io::Error,
    },
}

/// All that is wrong with a launch, in the order in which it was found; never empty.
#[derive(Debug)]
pub struct LaunchErrors(pub Vec<LaunchError>);

impl std::error::Error for LaunchErrors {}

impl std::fmt::Display for LaunchErrors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.0[..] {
            [one] => one.fmt(f),
            all => {
                write!(f, "{} mistakes:", all.len())?;
                all.iter().try_for_each(|error| write!(f, "\n  {error}"))
            }
        }
    }
}

impl From<LaunchError> for LaunchErrors {
    fn from(error: LaunchError) -> Self {
        Self(vec![error])
    }
}

impl LaunchError {
    pub(crate) fn system(what: impl Into<String>, source: impl Into<std::io::Error>) -> Self {
        Self::System { what: what.into(), source: source.into() }
    }
}
