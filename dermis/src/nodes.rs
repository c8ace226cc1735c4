//! The nodes: `dermis run` for a skin of any family, and one command for each family by its name.

use anyhow::{Result, anyhow};
use clap::{ArgMatches, Args, Command, FromArgMatches, Subcommand};
use dermis_operate::launching;
use dermis_sensor::Sensor;
use dermis_skin::SkinDescription;

use crate::backend::{Backends, Choice};
use crate::registry::sensors;

/// The node of one skin.
#[derive(Args)]
pub struct Skin {
    #[command(flatten)]
    arguments: dermis_perception::cli::Arguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

/// Command of the node of any skin.
const RUN: &str = "run";

/// The node of one skin, and the family whose name was given.
pub struct Node {
    sensor: Option<&'static dyn Sensor>,
    options: Box<Skin>,
}

impl FromArgMatches for Node {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let Some((name, matches)) = matches.subcommand() else {
            return Err(clap::Error::new(clap::error::ErrorKind::MissingSubcommand));
        };
        Ok(Self { sensor: sensors().get(name), options: Box::new(Skin::from_arg_matches(matches)?) })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Subcommand for Node {
    fn augment_subcommands(command: Command) -> Command {
        let run = Skin::augment_args(Command::new(RUN))
            .mut_arg("skin", |skin| skin.long(None).index(1))
            .about("Run the node of a skin, of whatever family its file names: raw bytes in, contacts out");
        sensors().iter().fold(command.subcommand(run), |command, sensor| {
            command.subcommand(Skin::augment_args(Command::new(sensor.name())).about(sensor.about()))
        })
    }

    fn augment_subcommands_for_update(command: Command) -> Command {
        Self::augment_subcommands(command)
    }

    fn has_subcommand(name: &str) -> bool {
        name == RUN || sensors().get(name).is_some()
    }
}

/// Runs until Ctrl-C, or until it is shut down through its lifecycle.
pub async fn run(Node { sensor, options }: Node, backends: &Backends) -> Result<()> {
    let config = options.arguments.into_config()?;
    let sensor = match sensor {
        Some(sensor) => sensor,
        None => crate::registry::family(&SkinDescription::load(&config.skin)?)?,
    };
    dermis_perception::run(sensor, &config, backends.open(options.backend)?.as_ref()).await.map_err(|error| {
        match launching::reader(&error, sensors()) {
            Some(command) => anyhow!("{error}; `dermis {command}` reads it"),
            None => error.into(),
        }
    })
}
