//! The node's options on a command line.

use std::path::PathBuf;

use clap::Args;
use dermis_perception::cli::NetworkArguments;

use crate::Config;

/// The node's options on a command line.
#[derive(Debug, Clone, Args)]
pub struct Arguments {
    /// Rule file.
    rules: PathBuf,
    /// Only say whether the rule file can be used.
    #[arg(long)]
    pub check: bool,
    /// Node name; the rule file's name where absent.
    #[arg(long)]
    name: Option<String>,
    /// ROS namespace.
    #[arg(long, default_value = "/")]
    namespace: String,
    /// Remapping of a topic or service, `from:=to`; may be given several times.
    #[arg(long)]
    remap: Vec<String>,
    /// Refuse lifecycle transitions and parameters of other nodes, so that nobody switches the reflexes off.
    #[arg(long)]
    locked: bool,
    /// Wait for a lifecycle manager, instead of guarding from the start.
    #[arg(long)]
    no_autostart: bool,
    /// Take the age of messages by `/clock`.
    #[arg(long)]
    use_sim_time: bool,
    #[command(flatten)]
    network: NetworkArguments,
}

impl Arguments {
    /// What the options say.
    #[must_use]
    pub fn into_config(self) -> Config {
        Config {
            name: self.name,
            namespace: self.namespace,
            remap: self.remap,
            network: self.network.choice(),
            use_sim_time: self.use_sim_time,
            autostart: !self.no_autostart,
            locked: self.locked,
            ..Config::new(self.rules)
        }
    }
}
