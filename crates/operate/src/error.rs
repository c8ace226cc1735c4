//! What can go wrong while skins run.

use std::io;
use std::path::PathBuf;

use dermis_bag::BagError;
use dermis_body::RobotError;
use dermis_learn::LearnError;
use dermis_node::NodeError;
use dermis_perception::RunError;
use dermis_sensor::UnknownSensor;
use dermis_skin::{InstanceError, ModelError, SkinError};
use dermis_testbed::TestbedError;

/// Why something cannot be done with running skins.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OperateError {
    /// The network or the ROS installation refused.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// A bag cannot be written or read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A skin description or a file of effects cannot be used.
    #[error(transparent)]
    Skin(#[from] SkinError),
    /// No family reads the skin.
    #[error(transparent)]
    Sensor(#[from] UnknownSensor),
    /// The skin cannot be simulated.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A device cannot have this name or this coordinate frame.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// The virtual testbed refused.
    #[error(transparent)]
    Testbed(#[from] TestbedError),
    /// A robot file cannot be used.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// Joint states at a rate that cannot be.
    #[error("--rate {0} Hz cannot be: joint states come 1 to 1000 times a second")]
    JointRate(f64),
    /// Joints that swing through more than their range.
    #[error("--swing {0} is no share of a joint's range: give 0 to 1")]
    Swing(f64),
    /// A map of labels cannot be read.
    #[error(transparent)]
    Labels(#[from] LearnError),
    /// A skin's node does not start.
    #[error(transparent)]
    Run(#[from] RunError),
    /// What was shown cannot be written, or a signal cannot be waited for.
    #[error(transparent)]
    Io(#[from] io::Error),

    /// A speed of a player that is none.
    #[error("--rate {0} is no speed: give a number from 0 up")]
    Rate(f64),
    /// A bag without messages.
    #[error("{} has no messages to play", .0.display())]
    Empty(PathBuf),
    /// A bag without messages, of which a part is wanted.
    #[error("{} has no messages", .0.display())]
    NothingToSlice(PathBuf),
    /// A part that ends before it begins.
    #[error("--from must lie before --to")]
    FromAfterTo,
    /// Playing would begin after the end.
    #[error("--start-offset is beyond the end of {}, which is {seconds:.3} s long", .bag.display())]
    BeyondEnd {
        /// The bag.
        bag: PathBuf,
        /// \[s\] how long it is.
        seconds: f64,
    },
    /// A bag has no skin of this name.
    #[error("{} has no skin `{skin}`; it has {known}", .bag.display())]
    NoSuchSkin {
        /// The bag.
        bag: PathBuf,
        /// The name.
        skin: String,
        /// Names that there are.
        known: String,
    },
    /// None of the topics of a bag can be published.
    #[error("nothing of {} can be played", .0.display())]
    NothingToPlay(PathBuf),
    /// The thread that plays ended by a panic.
    #[error("the player ended by a panic")]
    PlayerPanicked(#[source] tokio::task::JoinError),

    /// A type that is not built in, and nothing tells its hash.
    #[error("type {type_name} is not known here, and the {place} has no hash of it")]
    UnknownType {
        /// The type.
        type_name: String,
        /// Where its hash would be: the graph or the bag.
        place: &'static str,
    },
    /// A type that is not built in, or in another version, and its definition is not found.
    #[error("{node} publishes {other}{type_name}, which is not known here")]
    ForeignType {
        /// Who publishes it.
        node: String,
        /// `another version of `, or nothing.
        other: &'static str,
        /// The type.
        type_name: String,
        /// Where its definition was looked for.
        source: NoDefinition,
    },
    /// Publishers of one topic publish different types.
    #[error("its publishers disagree on the type: {0}")]
    TypesDisagree(String),

    /// There was no room for the folder of a recording until it was to end.
    #[error("nothing was recorded: there was no room for {}", .0.display())]
    NoRoom(PathBuf),
    /// Topics that were requested by name brought nothing.
    #[error("nothing was recorded of what was requested by name: {0}")]
    Silent(String),
    /// A bag that is complete and sound, of a recording that lacks something.
    #[error("the recording is not complete: {0}")]
    Incomplete(String),

    /// Skins that were requested are not there.
    #[error("{0}")]
    NotHeard(String),
    /// Skins did not obey a command.
    #[error("{0} was not tared")]
    NotTared(String),

    /// There is no folder for temporary files.
    #[error("no temporary folder for the demo's skin and model")]
    NoFolder(#[source] io::Error),
    /// The simulated device of a demo ended.
    #[error("the simulated device stopped by itself")]
    DeviceStopped,
    /// Nothing came from the node of a demo.
    #[error("no contact array arrived in {0:.0} s: run with DERMIS_LOG=info to see what the node says")]
    NoContacts(f64),

    /// A zenoh configuration file that is not there.
    #[error("zenoh configuration {}", .path.display())]
    ZenohConfig {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// A message definition that is not installed.
#[derive(Debug, thiserror::Error)]
#[error("no definition of {0} below AMENT_PREFIX_PATH: source the workspace that has its package")]
pub struct NoDefinition(pub String);

impl OperateError {
    /// The sentence with all of its causes.
    pub(crate) fn whole(&self) -> String {
        let mut text = self.to_string();
        let mut cause = std::error::Error::source(self);
        while let Some(error) = cause {
            text = format!("{text}: {error}");
            cause = error.source();
        }
        text
    }
}
