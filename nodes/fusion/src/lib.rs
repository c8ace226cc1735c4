//! One sense of touch for a whole robot: the contacts of all its skins, merged into contacts of its body.
//!
//! | module | question |
//! |---|---|
//! | [`Fuser`] | what does the whole body feel now? |
//! | `intake` | can what comes from one skin be used, and if not, why? |
//! | `group` | which contacts of skins that are rigidly connected are the same, and the same as before? |
//! | `track` | where is one contact, how does it move, how hard does it press? |
//! | `filter` | how certain is that, where errors of a skin stay? |
//! | `slip` | does a contact slip? |
//! | `torque` | what do joints feel beyond what skins explain? |
//! | `unknown` | which links can that be on? |
//! | `maps` | what force acts on each point of all skins? |
//! | `cause` | is a contact expected, or the robot's own? |
//! | [`Settings`] | what is assumed of skins and contacts? |
//! | [`messages`] | what the body feels, as messages |
//! | [`FusionNode`] | topics, parameters, lifecycle, diagnostics |

mod cause;
pub mod cli;
mod config;
mod filter;
mod fuser;
mod group;
mod intake;
mod maps;
pub mod messages;
mod node;
mod settings;
mod slip;
#[cfg(test)]
mod testing;
mod torque;
mod touch;
mod track;
mod unknown;

use dermis_node::Backend;

pub use cause::{Cause, CauseError, Expected, SelfContact};
pub use config::{Config, ConfigError, Transforms};
pub use fuser::{BodyState, Fuser, FuserError, SkinAt};
pub use intake::Health;
pub use node::{FusionNode, RunError};
pub use settings::{SettingError, Settings};
pub use slip::Slip;
pub use torque::{JointValues, TorqueError, TorqueSettings, Torques};
pub use touch::{BodyTouch, LinkLoad};

/// Runs a node until it is stopped by a signal or through its lifecycle.
///
/// # Errors
///
/// [`RunError`] says in one sentence why it does not start.
pub async fn run(config: &Config, backend: &dyn Backend) -> Result<(), RunError> {
    // Before the first message: a signal that nobody listens to ends the process without a last word.
    dermis_node::end_all_nodes_on_signal()?;
    let running = FusionNode::start(config, backend)?;
    running.node().wait_for_shutdown().await?;
    Ok(())
}
