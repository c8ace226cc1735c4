//! What can go wrong at the node API.

use std::time::Duration;

use dermis_msgs::CdrError;

use crate::backend::BackendError;

/// Failures of the node API.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    /// The network or the ROS installation refused.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// A name that ROS does not allow.
    #[error("{kind} name `{name}` is not valid: {reason}")]
    Name {
        /// `topic`, `service`, `node` or `namespace`.
        kind: &'static str,
        /// The name as given.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A remapping rule that cannot be read.
    #[error("remapping `{rule}` is not of the form `from:=to`")]
    Remapping {
        /// The rule as given.
        rule: String,
    },
    /// An argument after `--ros-args` that this node does not know.
    #[error(
        "argument `{argument}` after --ros-args is not known: use -r from:=to or -p name:=value, and end them with --"
    )]
    RosArgument {
        /// The argument as given.
        argument: String,
    },
    /// An environment variable that cannot be read.
    #[error("environment variable {variable}=`{value}` is not valid: {reason}")]
    Environment {
        /// The variable.
        variable: &'static str,
        /// Its value.
        value: String,
        /// What it should be.
        reason: &'static str,
    },
    /// A choice of the network that cannot be.
    #[error("network: {reason}")]
    Network {
        /// What is wrong, and what to do.
        reason: String,
    },
    /// Bytes on a topic or service that do not decode.
    #[error("message on {name} does not decode: {source}")]
    Decode {
        /// Topic or service.
        name: String,
        /// What is wrong with the bytes.
        source: CdrError,
    },
    /// No answer in time.
    #[error("service {name} did not answer within {timeout:?}: {hint}")]
    Timeout {
        /// Service.
        name: String,
        /// How long the call waited.
        timeout: Duration,
        /// Whether a server was there at all.
        hint: &'static str,
    },
    /// A parameter was refused.
    #[error("parameter `{name}`: {reason}")]
    Parameter {
        /// Parameter name.
        name: String,
        /// Why.
        reason: String,
    },
    /// A lifecycle transition that was not possible or failed.
    #[error("cannot {transition} node {node} in state {state}: {reason}")]
    Transition {
        /// Full node name.
        node: String,
        /// Transition label.
        transition: String,
        /// State the node was in.
        state: &'static str,
        /// Why.
        reason: String,
    },
    /// The node was shut down before.
    #[error("node {node} is shut down")]
    ShutDown {
        /// Full node name.
        node: String,
    },
    /// A thread of the node could not be started.
    #[error("cannot start a thread of node {node}: {reason}")]
    Thread {
        /// Full node name.
        node: String,
        /// What the system said.
        reason: String,
    },
}
