//! What a launch starts, and what it asks of the program that launches.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use regex::Regex;
use serde::Deserialize;
use serde_json::{Map, Value};

use super::scope::Network;
use crate::backoff::Backoff;
use crate::file::loose;
use crate::log::LogLimits;

/// What the program that launches knows and this crate does not: its own nodes and commands.
pub trait Host {
    /// The program's own file, which runs its nodes and commands.
    fn program(&self) -> &Path;

    /// Whether the program takes these arguments.
    ///
    /// # Errors
    ///
    /// One sentence on what it does not take.
    fn check(&self, arguments: &[String]) -> Result<(), String>;

    /// Whether what the program does with these arguments can share a process: whether its command `container` takes them.
    fn can_share(&self, arguments: &[String]) -> bool {
        let _ = arguments;
        false
    }

    /// Checks that `text` is a reach over the network, as `--network` takes it.
    ///
    /// # Errors
    ///
    /// One sentence on what would be one.
    fn network(&self, text: &str) -> Result<(), String>;

    /// The configuration of a node, checked as far as can be without starting it, with absolute paths.
    ///
    /// # Errors
    ///
    /// The fields that cannot be used, and why.
    fn node(&self, request: &NodeRequest<'_>) -> Result<Value, Vec<Refusal>>;

    /// Which of these nodes cannot run beside each other: label and configuration, as [`node`](Self::node) gave it, of each. Of those
    /// that cannot, its index, its field, and why.
    fn together(&self, nodes: &[(&str, &Value)]) -> Vec<(usize, Refusal)> {
        let _ = nodes;
        Vec::new()
    }
}

/// A node that a launch file asks for.
#[derive(Debug)]
#[non_exhaustive]
pub struct NodeRequest<'a> {
    /// Which node, as the command that runs it.
    pub kind: &'a str,
    /// Node name.
    pub name: &'a str,
    /// Full namespace.
    pub namespace: &'a str,
    /// ROS domain, where the file names one.
    pub domain_id: Option<u16>,
    /// Remappings `from:=to`.
    pub remap: &'a [String],
    /// Start values of parameters.
    pub parameters: &'a Map<String, Value>,
    /// The rest of its configuration: a table, or the path of a file; null where absent.
    pub config: &'a Value,
    /// Launch file that asks.
    pub file: &'a Path,
    /// Folder that relative paths start at.
    pub folder: &'a Path,
}

/// A field of a process that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// Path of the field within the process, e.g. `config.skin`.
    pub field: String,
    /// What is wrong, and what to do.
    pub reason: String,
}

/// When a process that ended by itself is started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Restart {
    /// Never.
    #[default]
    Never,
    /// Where it ended with another exit code than 0, by a signal, or was not ready in time.
    OnFailure,
    /// However it ended.
    Always,
}

/// How a process is stopped: an interrupt (as Ctrl-C), then SIGTERM, then SIGKILL.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stop {
    /// \[s\] from the interrupt to SIGTERM.
    #[serde(deserialize_with = "loose")]
    pub interrupt: f64,
    /// \[s\] from SIGTERM to SIGKILL.
    #[serde(deserialize_with = "loose")]
    pub terminate: f64,
}

impl Default for Stop {
    fn default() -> Self {
        Self { interrupt: 5.0, terminate: 2.0 }
    }
}

/// What shows that a process can be used.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Ready {
    /// A file, link or folder that was not there before its start, or is another one since.
    File {
        /// Where.
        path: PathBuf,
        /// Longest wait.
        within: Duration,
    },
    /// A line that it prints.
    Line {
        /// What is found in it.
        pattern: Regex,
        /// Longest wait.
        within: Duration,
    },
}

/// A node in a process that it shares with others.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SharedNode {
    /// Namespace and name.
    pub label: String,
    /// Command and arguments.
    pub arguments: Vec<String>,
    /// Its configuration, as of a [`Process`].
    pub config: Option<Value>,
}

/// One process.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Process {
    /// Namespace and name, as logs and `after` call it: `left/pad`.
    pub label: String,
    /// Launch file that asks for it.
    pub file: PathBuf,
    /// Path of its entry in that file.
    pub field: String,
    /// Whether it is this program itself.
    pub own: bool,
    /// Program file.
    pub program: PathBuf,
    /// Arguments.
    pub arguments: Vec<String>,
    /// Configuration of a node, as it is written to the file that `arguments` names.
    pub config: Option<Value>,
    /// Where it is a container, the nodes that run in it.
    pub nodes: Vec<SharedNode>,
    /// Variables on top of the environment of the launch.
    pub environment: BTreeMap<String, String>,
    /// Working directory.
    pub directory: PathBuf,
    /// Processes of the plan that must be ready before.
    pub after: Vec<usize>,
    /// What shows that it can be used; at once where absent.
    pub ready: Option<Ready>,
    /// When it is started again.
    pub restart: Restart,
    /// How long after.
    pub backoff: Backoff,
    /// Whether its end is the end of the launch.
    pub required: bool,
    /// How it is stopped.
    pub stop: Stop,
}

impl Process {
    /// Sets who can reach it over the network, in place of what the file sets: a reach as `--network` takes it, or the path of a
    /// configuration file of zenoh.
    pub fn set_network(&mut self, reach: bool, value: &str) {
        let network =
            if reach { Network::Reach(value.to_owned()) } else { Network::File(PathBuf::from(value)) };
        let variables = network.variables(self.own);
        self.environment.extend(variables.into_iter().map(|(name, value)| (name.to_owned(), value)));
    }

    /// Gives an option to every node with a configuration, except to those whose arguments have one of `instead` already: what
    /// the command line says wins over a configuration.
    pub fn set_option(&mut self, flag: &str, value: &str, instead: &[&str]) {
        let add = |arguments: &mut Vec<String>| {
            let said = |argument: &String| instead.iter().any(|flag| argument.starts_with(flag));
            if !arguments.iter().any(said) {
                arguments.extend([flag.to_owned(), value.to_owned()]);
            }
        };
        if self.config.is_some() {
            add(&mut self.arguments);
        }
        for node in self.nodes.iter_mut().filter(|node| node.config.is_some()) {
            add(&mut node.arguments);
        }
        if !self.nodes.is_empty() {
            self.arguments = super::container::arguments(&self.nodes);
        }
    }
}

/// An argument of a launch file.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Declared {
    /// Name.
    pub name: String,
    /// Its value in this launch.
    pub value: String,
    /// What it is for.
    pub about: String,
}

/// What is started, in this order.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Plan {
    /// The launch file.
    pub file: PathBuf,
    /// Its arguments.
    pub arguments: Vec<Declared>,
    /// Its processes.
    pub processes: Vec<Process>,
    /// How much they may log.
    pub log_limits: LogLimits,
}
