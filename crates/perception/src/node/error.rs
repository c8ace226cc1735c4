//! [`RunError`]: why a node does not start.

use std::path::PathBuf;

use dermis_estimate::SetupError;
use dermis_inference::RuntimeError;
use dermis_node::NodeError;
use dermis_skin::{InstanceError, SkinError};
use dermis_transport::TransportError;

/// Why the node does not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The skin description cannot be used.
    #[error(transparent)]
    Skin(#[from] SkinError),
    /// The skin belongs to another node.
    #[error(
        "skin file {path}: field `sensor`: is \"{found}\", which this node does not read; it reads \"{expected}\""
    )]
    Sensor {
        /// Skin description file.
        path: PathBuf,
        /// Sensor family that it names.
        found: String,
        /// Sensor family of this node.
        expected: &'static str,
    },
    /// The device's name, coordinate frame or mount cannot be.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// What the sensor family reads of the skin description cannot be: its medium, or its wire.
    #[error("skin file {path}: field `{field}`: {reason}")]
    Medium {
        /// Skin description file.
        path: PathBuf,
        /// Path of the field.
        field: String,
        /// What is wrong with it, and what would be right.
        reason: String,
    },
    /// The source URL cannot be used.
    #[error(transparent)]
    Source(#[from] TransportError),
    /// A model or a masked channel does not fit.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// A correction that nothing is corrected by.
    #[error(
        "`correction`: none of the models refines its answer on the forward model, which {path} corrects; leave it out, or \
         add `inversion` to a model with `dermis refine`"
    )]
    UnusedCorrection {
        /// File of the correction.
        path: PathBuf,
    },
    /// No runtime for models.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// ROS refused.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// A start value of a parameter that is no parameter value.
    #[error(
        "parameter `{name}`: {value} is no parameter value; give a truth value, a number, a text or a list of them"
    )]
    ParameterValue {
        /// Name of the parameter.
        name: String,
        /// The value as configured.
        value: String,
    },
    /// A start value of a parameter that the configuration decides.
    #[error(
        "parameter `{name}` follows from the configuration: write `{key}` there, and leave it out of `parameters`"
    )]
    FixedParameter {
        /// Name of the parameter.
        name: &'static str,
        /// Key of the configuration.
        key: &'static str,
    },
    /// Start values of parameters that this node does not have.
    #[error("parameter `{names}` is none of this node; its parameters are {known}")]
    UnknownParameter {
        /// Names as configured.
        names: String,
        /// Parameters that exist.
        known: String,
    },
    /// The system gave no thread.
    #[error("cannot start the thread of skin `{skin}`: {source}")]
    Thread {
        /// Name of the skin.
        skin: String,
        /// What the system said.
        source: std::io::Error,
    },
}
