//! What people do with running skins, as a library: a request goes in, findings come out.
//!
//! | module | what it does |
//! |---|---|
//! | [`record`] | records what nodes publish into a bag |
//! | [`play`] | publishes what a bag holds |
//! | [`slice`] | copies a part of a bag |
//! | [`watch`] | follows the contacts of every skin in the ROS graph |
//! | [`device`] | puts a modelled or a recorded skin behind a pseudo-terminal |
//! | [`robot`] | moves a robot that carries such skins, and says where they are really touched |
//! | [`collect`] | has the virtual testbed press a modelled skin and writes a labelled bag |
//! | [`demo`] | runs a modelled skin, its node and a subscriber, and compares with the ground truth |
//! | [`launching`] | checks what launch files say of nodes |
//!
//! A request says what a command line says, with the same names, units and defaults. The ROS 2 backend is handed in by the
//! program, and so are the sensor families. What goes on meanwhile is reported to a [`Progress`]. Findings serialise to the record
//! that `--json` prints; their text is made in `dermis-report`.

pub mod collect;
pub mod demo;
pub mod device;
pub mod effects;
mod error;
mod foreign;
pub mod launching;
pub mod play;
pub mod quantity;
pub mod record;
pub mod robot;
pub mod slice;
mod stats;
mod touch;
pub mod watch;
mod written;

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use dermis_model::ForwardModel;
use dermis_sensor::Registry;
use dermis_skin::SkinDescription;

pub use error::OperateError;
pub use stats::{Samples, Spread};
pub use touch::{Touch, pressing_force};

/// How often what is watched is checked.
const LOOK: Duration = Duration::from_millis(200);

/// Who hears how work goes on.
pub trait Progress: Send + Sync {
    /// A sentence for a person, at once.
    fn note(&self, sentence: &str);
}

/// The forward model of a skin that was read from `path`, with the effects that its description switches on; refusals name
/// that file.
fn model_of_file(
    path: &Path,
    skin: &SkinDescription,
    sensors: &Registry,
) -> Result<Arc<dyn ForwardModel>, OperateError> {
    Ok(sensors.of(skin)?.model(skin).map_err(|error| error.in_file(path))?)
}
