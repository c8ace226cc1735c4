//! The start configuration of the node.
//!
//! ```toml
//! robot = "humanoid.toml"      # relative to this file
//! rate = 0.0                   # [Hz] of answers; 0: one for each report, `max_rate` a second at most
//! max_rate = 1000.0            # [Hz] of answers to reports, at most: a report waits for 2/max_rate at most
//! transforms = "skins"         # on /tf: `off`, `skins` (their frames), `robot` (links, too)
//! assume_rest = false          # whether joints that no joint state tells of are taken for resting at 0
//!
//! [[expected]]                 # a support or a tool: its force does not count
//! name = "backpack"
//! link = "back_shell"
//! position = [0.0, 0.0, 0.1]
//! radius = 0.05
//! force = [0.0, 0.0, -30.0]    # all that is measured there where absent
//!
//! [[self_contact]]             # links that may touch each other
//! links = ["left_hand", "chest_shell"]
//!
//! [settings]                   # see `Settings`
//! hold = 0.05
//!
//! [torques]                    # see `TorqueSettings`; where it is there, unexplained joint torques are contacts
//! deviation_share = 0.02
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dermis_body::HistoryLimits;
use dermis_node::{NetworkChoice, ParameterValue};
use serde::{Deserialize, Serialize};

use crate::cause::{Expected, SelfContact};
use crate::settings::Settings;
use crate::torque::TorqueSettings;

/// Which coordinate frames are published.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Transforms {
    /// None.
    Off,
    /// Those of the skins, which nobody else may know.
    #[default]
    Skins,
    /// Those of the skins and of every link, as `robot_state_publisher` does: only one of the two may run, because a frame has one
    /// parent.
    Robot,
}

/// The start configuration of the node; a file of it is TOML.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Robot file; relative to the configuration file.
    pub robot: PathBuf,
    /// \[Hz\] of answers; 0: one for each report, [`max_rate`](Self::max_rate) a second at most.
    #[serde(default)]
    pub rate: f64,
    /// \[Hz\] of answers to reports, at most: a report that comes sooner after an answer waits for the next.
    #[serde(default = "usual_max_rate")]
    pub max_rate: f64,
    /// Which coordinate frames are published.
    #[serde(default)]
    pub transforms: Transforms,
    /// Whether joints that no joint state tells of are taken for resting at 0.
    #[serde(default)]
    pub assume_rest: bool,
    /// Supports and tools.
    #[serde(default)]
    pub expected: Vec<Expected>,
    /// Links that may touch each other.
    #[serde(default)]
    pub self_contact: Vec<SelfContact>,
    /// Assumptions of the estimator.
    #[serde(default)]
    pub settings: Settings,
    /// Assumptions of joint torques. Where it is there, what joints feel beyond what skins explain is a contact; otherwise only
    /// a torque.
    #[serde(default)]
    pub torques: Option<TorqueSettings>,
    /// How long joint states count.
    #[serde(default)]
    pub joint_states: HistoryLimits,
    /// Name of the node.
    #[serde(default = "usual_name")]
    pub name: String,
    /// ROS namespace.
    #[serde(default = "root")]
    pub namespace: String,
    /// ROS domain; `ROS_DOMAIN_ID` where absent.
    #[serde(default)]
    pub domain_id: Option<u16>,
    /// Remappings of topics and services, `from:=to`.
    #[serde(default)]
    pub remap: Vec<String>,
    /// Whether the node configures and activates itself; otherwise a lifecycle manager does.
    #[serde(default = "yes")]
    pub autostart: bool,
    /// Whether stamps are those of `/clock`.
    #[serde(default)]
    pub use_sim_time: bool,
    /// Who can reach the node; the environment decides where nothing is said.
    #[serde(skip)]
    pub network: NetworkChoice,
    /// Start values of parameters.
    #[serde(skip)]
    pub parameters: BTreeMap<String, ParameterValue>,
}

fn usual_name() -> String {
    "fusion".into()
}

fn usual_max_rate() -> f64 {
    1000.0
}

fn root() -> String {
    "/".into()
}

fn yes() -> bool {
    true
}

/// A configuration that cannot be used, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("configuration {path}: cannot be read: {source}; check the path and its permissions")]
    Read {
        /// File that was requested.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A key is missing, unknown, or has a value that cannot be.
    #[error("configuration {path}: field `{field}`: {reason}")]
    Field {
        /// File that it came from.
        path: PathBuf,
        /// Path of the field.
        field: String,
        /// What is wrong.
        reason: String,
    },
}

impl Config {
    /// A node for this robot, with everything else as it is by default.
    #[must_use]
    pub fn new(robot: impl Into<PathBuf>) -> Self {
        Self {
            robot: robot.into(),
            rate: 0.0,
            max_rate: usual_max_rate(),
            transforms: Transforms::default(),
            assume_rest: false,
            expected: Vec::new(),
            self_contact: Vec::new(),
            settings: Settings::default(),
            torques: None,
            joint_states: HistoryLimits::default(),
            name: usual_name(),
            namespace: root(),
            domain_id: None,
            remap: Vec::new(),
            autostart: true,
            use_sim_time: false,
            network: NetworkChoice::default(),
            parameters: BTreeMap::new(),
        }
    }

    /// Reads a file.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] names the file and the field.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, ConfigError> {
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        let mut config = Self::parse(&text, path)?;
        config.robot = path.parent().unwrap_or(Path::new("")).join(&config.robot);
        Ok(config)
    }

    fn parse(text: &str, path: &Path) -> Result<Self, ConfigError> {
        dermis_io::toml::parse(text).map_err(|fault| {
            let (field, reason) = fault.into_field();
            ConfigError::Field { path: path.to_owned(), field, reason }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_says_what_differs() {
        let text = "robot = 'r.toml'\nrate = 200.0\ntransforms = 'robot'\n\
            [settings]\nhold = 0.1\n[[self_contact]]\nlinks = ['a', 'b']\n\
            [[expected]]\nname = 'bag'\nlink = 'a'\nposition = [0, 0, 0]\nradius = 0.1";
        let config = Config::parse(text, Path::new("f.toml")).unwrap();
        assert_eq!((config.rate, config.transforms, config.settings.hold), (200.0, Transforms::Robot, 0.1));
        assert_eq!((config.settings.births, config.expected[0].force), (2, None));
        assert_eq!(config.self_contact[0].links, ["a", "b"]);
        assert_eq!(Config::parse("robot = 'r.toml'", Path::new("f.toml")).unwrap(), Config::new("r.toml"));
    }

    #[test]
    fn refusals_name_file_and_field() {
        let wrong = |text: &str| Config::parse(text, Path::new("f.toml")).unwrap_err().to_string();
        insta::assert_snapshot!(wrong("rate = 1.0"), @"configuration f.toml: field `(whole file)`: missing field `robot`");
        assert!(wrong("robot = 'r'\nrtae = 1.0").contains("unknown field `rtae`"));
        assert!(
            wrong("robot = 'r'\n[settings]\nhold = 'long'").contains("field `settings.hold`: invalid type")
        );
        assert!(wrong("robot = ").starts_with("configuration f.toml: field `line 1, column 9`: "));
    }
}
