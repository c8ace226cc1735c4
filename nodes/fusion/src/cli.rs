//! The node's options on a command line.

use std::path::PathBuf;

use clap::Args;
use dermis_node::NetworkChoice;
use dermis_perception::cli::NetworkArguments;

use crate::config::{Config, ConfigError, Transforms};

/// What the program is for.
pub const ABOUT: &str =
    "Merge the contacts of all skins of a robot into one list for its body, with wrenches and joint torques";

/// The node's options on a command line.
#[derive(Debug, Clone, Args)]
pub struct Arguments {
    /// Robot file: URDF and skins on its links.
    #[arg(long, required_unless_present = "config")]
    robot: Option<PathBuf>,
    /// Configuration file (TOML) with expected contacts and assumptions, in place of `--robot`.
    #[arg(long, conflicts_with = "robot")]
    config: Option<PathBuf>,
    /// Answers a second; 0: one for each report.
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Most answers to reports a second; 1,000 where neither this nor the configuration says another.
    #[arg(long, value_name = "HZ")]
    max_rate: Option<f64>,
    /// Coordinate frames to publish: `off`, `skins`, or `robot` (every link, as robot_state_publisher does).
    #[arg(long, value_enum)]
    transforms: Option<Transforms>,
    /// Take joints that no joint state tells of for resting at 0: for demonstrations, and joints without encoders.
    #[arg(long)]
    assume_rest: bool,
    /// Node name.
    #[arg(long)]
    name: Option<String>,
    /// ROS namespace.
    #[arg(long)]
    namespace: Option<String>,
    /// Remapping of a topic or service, `from:=to`; may be given several times.
    #[arg(long)]
    remap: Vec<String>,
    #[command(flatten)]
    network: NetworkArguments,
}

impl Arguments {
    /// What the options say, on top of the configuration file where one is given.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] where the configuration file cannot be used.
    pub fn into_config(self) -> Result<Config, ConfigError> {
        let mut config = match self.config {
            Some(file) => Config::load(file)?,
            None => Config::new(self.robot.unwrap_or_default()),
        };
        let network = self.network.choice();
        if network != NetworkChoice::default() {
            config.network = network;
        }
        config.rate = self.rate.unwrap_or(config.rate);
        config.max_rate = self.max_rate.unwrap_or(config.max_rate);
        config.transforms = self.transforms.unwrap_or(config.transforms);
        config.assume_rest |= self.assume_rest;
        config.name = self.name.unwrap_or(config.name);
        config.namespace = self.namespace.unwrap_or(config.namespace);
        config.remap.extend(self.remap);
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        arguments: Arguments,
    }

    fn parse(arguments: &[&str]) -> Result<Config, String> {
        let all = std::iter::once(&"node").chain(arguments);
        let program = Program::try_parse_from(all).map_err(|e| e.to_string())?;
        program.arguments.into_config().map_err(|e| e.to_string())
    }

    #[test]
    fn options_win_over_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("f.toml");
        std::fs::write(&file, "robot = 'r.toml'\nrate = 50.0\nmax_rate = 500\nnamespace = '/left'").unwrap();
        let file = file.display().to_string();
        let config = parse(&["--config", &file, "--rate", "10", "--transforms", "robot"]).unwrap();
        assert_eq!((config.rate, config.max_rate, config.transforms), (10.0, 500.0, Transforms::Robot));
        assert_eq!((config.robot, config.namespace.as_str()), (folder.path().join("r.toml"), "/left"));
        assert_eq!(parse(&["--robot", "r.toml"]).unwrap(), Config::new("r.toml"));
        assert!(parse(&[]).unwrap_err().contains("--robot"));
        assert!(parse(&["--config", &file, "--robot", "r.toml"]).is_err());
    }
}
