//! The node's options on a command line, and the program of a family.

pub mod log_limit;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{ArgMatches, Args, Command, FromArgMatches};
use dermis_node::{HirozBackend, NetworkChoice, Reach};
use dermis_skin::Mount;
use log_limit::LogLimit;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use dermis_sensor::Sensor;
use serde::{Deserialize, Serialize};

use crate::{CacheConfig, Commands, Config, ConfigError};

/// Who can reach a program over the network, on a command line.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkArguments {
    /// Who can reach this program, and whom it looks for: `loopback` (programs of this machine; as where nothing is said),
    /// `lan` (every host), an IP address of this machine, or `off`.
    #[arg(long, value_name = "REACH", conflicts_with = "zenoh_config")]
    pub network: Option<Reach>,
    /// A zenoh configuration file (JSON5) that says so instead, e.g. with TLS and access control.
    #[arg(long, value_name = "FILE")]
    pub zenoh_config: Option<PathBuf>,
}

impl NetworkArguments {
    /// What was requested.
    #[must_use]
    pub fn choice(&self) -> NetworkChoice {
        NetworkChoice { network: self.network, zenoh_config: self.zenoh_config.clone() }
    }
}

/// The node's options on a command line.
#[derive(Debug, Clone, Args)]
pub struct Arguments {
    /// Configuration file (TOML or YAML) in place of `--skin` and `--source`.
    #[arg(long, conflicts_with_all = ["skin", "source"])]
    config: Option<PathBuf>,
    /// Skin description file.
    #[arg(long, required_unless_present = "config")]
    skin: Option<PathBuf>,
    /// Where the bytes come from, e.g. `serial:///dev/ttyACM0?baud=921600`.
    #[arg(long, required_unless_present = "config")]
    source: Option<String>,
    /// Folder of a model bundle; may be given several times.
    #[arg(long)]
    model: Vec<PathBuf>,
    /// Without a model bundle, find contacts on the skin's forward model alone.
    #[arg(long)]
    invert: bool,
    /// Channel to leave out; may be given several times.
    #[arg(long)]
    mask: Vec<String>,
    /// How this device differs from the forward model of its type: a correction.json of `dermis refine --correct`.
    #[arg(long, value_name = "FILE")]
    correction: Option<PathBuf>,
    /// Node name; the skin's name where absent.
    #[arg(long)]
    name: Option<String>,
    /// ROS namespace.
    #[arg(long)]
    namespace: Option<String>,
    /// Name of this device, unique on the robot; the skin's name, or the node's full name with `_` where it has one of its own.
    #[arg(long, value_name = "NAME")]
    instance: Option<String>,
    /// Coordinate frame of this device; that of the skin file where absent.
    #[arg(long, value_name = "LINK")]
    frame_id: Option<String>,
    /// Where this device is fixed on the robot: `parent,x,y,z`, then `roll,pitch,yaw` or a quaternion `qx,qy,qz,qw`, in metres
    /// and radians.
    #[arg(long, value_name = "LINK,X,Y,Z[,…]")]
    mount: Option<Mount>,
    /// Remapping of a topic or service, `from:=to`; may be given several times.
    #[arg(long)]
    remap: Vec<String>,
    /// Folder below which `~/load_model` finds bundles; may be given several times. Those that contain the models where absent.
    #[arg(long)]
    model_folder: Vec<PathBuf>,
    /// Commands that are obeyed: `all`, `none`, or some of tare, enable, load, lifecycle, parameters, with commas between them.
    #[arg(long, value_name = "all|none|LIST")]
    commands: Option<Commands>,
    /// Where what takes seconds to compute is kept for the next start: `auto` (the user's cache folder), `off`, or a folder.
    #[arg(long, value_name = "auto|off|FOLDER")]
    cache: Option<PathBuf>,
    /// End where a model cannot be used, instead of publishing readings only.
    #[arg(long)]
    strict: bool,
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
        let mut config = match (self.config, self.skin, self.source) {
            (Some(file), ..) => Config::load(file)?,
            (None, skin, source) => Config::new(skin.unwrap_or_default(), source.unwrap_or_default()),
        };
        config.models.extend(self.model);
        config.invert |= self.invert;
        config.masked.extend(self.mask);
        config.remap.extend(self.remap);
        config.strict |= self.strict;
        let network = self.network.choice();
        if network != NetworkChoice::default() {
            (config.network, config.zenoh_config) = (network.network, network.zenoh_config);
        }
        if !self.model_folder.is_empty() {
            config.model_folders = Some(self.model_folder);
        }
        config.commands = self.commands.unwrap_or(config.commands);
        config.cache = self.cache.map_or(config.cache, CacheConfig::from);
        config.name = self.name.or(config.name);
        config.namespace = self.namespace.unwrap_or(config.namespace);
        config.instance = self.instance.or(config.instance);
        config.frame_id = self.frame_id.or(config.frame_id);
        config.mount = self.mount.or(config.mount);
        config.correction = self.correction.or(config.correction);
        Ok(config)
    }
}

/// The whole of a program that is one family's node: options, log, the node over the embedded backend until it is stopped. `name`
/// and `version` are the program's.
#[must_use]
pub fn program(sensor: &'static dyn Sensor, name: &'static str, version: &'static str) -> ExitCode {
    if let Some(code) = dermis_inference::trial::serve() {
        return code;
    }
    dermis_skin::register(sensor);
    let command = Command::new(name).version(version).about(sensor.about());
    node_program(Arguments::augment_args(command), |options| {
        let config = Arguments::from_arg_matches(options)?.into_config()?;
        let runtime = tokio::runtime::Runtime::new()?;
        Ok(runtime.block_on(crate::run(sensor, &config, &HirozBackend::default()))?)
    })
}

/// The frame of a program that is one node: options, log, and one sentence where `run` fails.
#[must_use]
pub fn node_program(
    command: Command,
    run: impl FnOnce(&ArgMatches) -> Result<(), Box<dyn std::error::Error>>,
) -> ExitCode {
    dermis_io::pipe::end_quietly();
    let name = command.get_name().to_owned();
    let options = command.get_matches();
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "info".into());
    let limit = LogLimit::default();
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    tracing_subscriber::registry().with(filter).with(limit.clone()).with(lines).init();
    let done = run(&options);
    limit.finish();
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{name}: {error}");
            ExitCode::FAILURE
        }
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
    fn options_add_to_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("palm.toml");
        std::fs::write(&file, "skin = 'p.toml'\nsource = 's'\nnamespace = '/left'\nmodels = ['a']").unwrap();
        let file = file.display().to_string();
        let config = parse(&["--config", &file, "--model", "b", "--strict"]).unwrap();
        assert_eq!(config.models, [folder.path().join("a"), PathBuf::from("b")]);
        assert!(config.strict && config.namespace == "/left");
        let of = [
            "--instance",
            "left",
            "--frame-id",
            "left_link",
            "--mount",
            "wrist,0,0,0.1,0,0,-1.5",
            "--correction",
            "c",
        ];
        let config = parse(&[&["--config", &file][..], &of[..]].concat()).unwrap();
        assert_eq!(
            (config.instance.as_deref(), config.frame_id.as_deref()),
            (Some("left"), Some("left_link"))
        );
        assert_eq!(config.mount.unwrap().translation(), [0.0, 0.0, 0.1]);
        assert_eq!(config.correction, Some(PathBuf::from("c")));
        assert!(parse(&["--config", &file, "--mount", "wrist,0,0"]).unwrap_err().contains("parent,x,y,z"));
        assert_eq!(parse(&["--config", &file, "--network", "lan"]).unwrap().network, Some(Reach::Lan));
        assert!(parse(&["--config", &file, "--network", "lan", "--zenoh-config", "z.json5"]).is_err());
        assert!(parse(&["--config", &file, "--skin", "p"]).is_err());
    }

    #[test]
    fn commands_can_be_locked_on_the_command_line() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("palm.toml");
        std::fs::write(&file, "skin = 'p.toml'\nsource = 's'\ncommands = ['tare']\ncache = 'kept'").unwrap();
        let file = file.display().to_string();
        let plain = parse(&["--config", &file]).unwrap();
        assert_eq!(plain.commands, "tare".parse().unwrap());
        assert_eq!(plain.cache, CacheConfig::Folder(folder.path().join("kept")));
        let locked =
            parse(&["--config", &file, "--commands", "none", "--cache", "off", "--model-folder", "m"])
                .unwrap();
        assert_eq!((locked.commands, locked.cache), (Commands::none(), CacheConfig::Off));
        assert_eq!(locked.model_folders, Some(vec![PathBuf::from("m")]));
        assert!(
            parse(&["--config", &file, "--commands", "tear"]).unwrap_err().contains("no group of commands")
        );
    }

    #[test]
    fn a_skin_needs_a_source() {
        assert!(parse(&["--skin", "p"]).unwrap_err().contains("--source"));
        assert_eq!(parse(&["--skin", "p", "--source", "s"]).unwrap(), Config::new("p", "s"));
    }
}
