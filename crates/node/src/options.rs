//! How a node is started.

use std::collections::BTreeMap;

use crate::error::NodeError;
use crate::names::parse_remapping;
use crate::network::{NetworkChoice, Reach};
use crate::parameters::ParameterValue;

/// How a node is started.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeOptions {
    /// Node name without namespace.
    pub name: String,
    /// Namespace, `/` for none.
    pub namespace: String,
    /// ROS domain; `None` reads `ROS_DOMAIN_ID`, or else 0.
    pub domain_id: Option<u16>,
    /// How far the node reaches; the environment decides where nothing is chosen, and the loopback where it says nothing.
    pub network: NetworkChoice,
    /// Remappings `from:=to` of topics and services, and `__node`, `__ns`.
    pub remappings: Vec<(String, String)>,
    /// Values of parameters that win over their defaults.
    pub parameters: BTreeMap<String, ParameterValue>,
    /// Whether to start with the time of `/clock`.
    pub use_sim_time: bool,
    /// Whether `/diagnostics` is published (at 1 Hz).
    pub diagnostics: bool,
    /// Threads that run callbacks, at least 1.
    pub threads: usize,
    /// Why other nodes may not set parameters; `None` where they may. Reading them is answered always.
    pub parameters_refused: Option<String>,
    /// Why other nodes may not take it through its lifecycle; `None` where they may. Its state is always reported.
    pub lifecycle_refused: Option<String>,
}

impl NodeOptions {
    /// A node with everything else as ROS has it by default.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            namespace: "/".to_owned(),
            domain_id: None,
            network: NetworkChoice::default(),
            remappings: Vec::new(),
            parameters: BTreeMap::new(),
            use_sim_time: false,
            diagnostics: true,
            threads: 2,
            parameters_refused: None,
            lifecycle_refused: None,
        }
    }

    /// Sets the namespace.
    #[must_use]
    pub fn namespace(mut self, namespace: impl Into<String>) -> Self {
        self.namespace = namespace.into();
        self
    }

    /// Sets the ROS domain.
    #[must_use]
    pub fn domain_id(mut self, domain_id: u16) -> Self {
        self.domain_id = Some(domain_id);
        self
    }

    /// Says how far the node reaches.
    #[must_use]
    pub fn network(mut self, network: NetworkChoice) -> Self {
        self.network = network;
        self
    }

    /// Keeps the node on this machine, or opens it to the local network.
    #[must_use]
    pub fn localhost_only(mut self, localhost_only: bool) -> Self {
        let reach = if localhost_only { Reach::Loopback } else { Reach::Lan };
        self.network = NetworkChoice { network: Some(reach), zenoh_config: None };
        self
    }

    /// Adds a remapping.
    #[must_use]
    pub fn remap(mut self, from: impl Into<String>, to: impl Into<String>) -> Self {
        self.remappings.push((from.into(), to.into()));
        self
    }

    /// Gives a parameter its value.
    #[must_use]
    pub fn parameter(mut self, name: impl Into<String>, value: impl Into<ParameterValue>) -> Self {
        self.parameters.insert(name.into(), value.into());
        self
    }

    /// Starts with the time of `/clock`, or not.
    #[must_use]
    pub fn use_sim_time(mut self, use_sim_time: bool) -> Self {
        self.use_sim_time = use_sim_time;
        self
    }

    /// Publishes `/diagnostics`, or not.
    #[must_use]
    pub fn diagnostics(mut self, diagnostics: bool) -> Self {
        self.diagnostics = diagnostics;
        self
    }

    /// Sets the number of threads that run callbacks.
    #[must_use]
    pub fn threads(mut self, threads: usize) -> Self {
        self.threads = threads;
        self
    }

    /// Refuses parameters that other nodes set, with this sentence. The services stay: clients wait for one that is not there.
    #[must_use]
    pub fn refuse_parameters(mut self, why: impl Into<String>) -> Self {
        self.parameters_refused = Some(why.into());
        self
    }

    /// Refuses transitions of the lifecycle that other nodes ask for; the sentence goes to the log, since the answer has no room for
    /// one.
    #[must_use]
    pub fn refuse_lifecycle(mut self, why: impl Into<String>) -> Self {
        self.lifecycle_refused = Some(why.into());
        self
    }

    /// Reads what ROS gives a process after `--ros-args`: `-r from:=to`, `-p name:=value`, with the long
    /// forms `--remap` and `--param`. Returns the arguments that are not for ROS.
    ///
    /// # Errors
    ///
    /// When a rule cannot be read or its value is missing.
    pub fn ros_args(&mut self, args: impl IntoIterator<Item = String>) -> Result<Vec<String>, NodeError> {
        let mut rest = Vec::new();
        let mut ros = false;
        let mut args = args.into_iter();
        while let Some(arg) = args.next() {
            match arg.as_str() {
                "--ros-args" => ros = true,
                "--" if ros => ros = false,
                "-r" | "--remap" | "-p" | "--param" if ros => {
                    let rule = args.next().ok_or_else(|| NodeError::Remapping { rule: arg.clone() })?;
                    let (from, to) = parse_remapping(&rule)?;
                    if arg == "-r" || arg == "--remap" {
                        self.remappings.push((from, to));
                    } else {
                        self.parameters.insert(from, ParameterValue::parse(&to));
                    }
                }
                _ if ros => return Err(NodeError::RosArgument { argument: arg }),
                _ => rest.push(arg),
            }
        }
        Ok(rest)
    }

    pub(crate) fn resolve_domain(&self) -> Result<u16, NodeError> {
        self.domain_id.map_or_else(
            || domain_from(std::env::var("ROS_DOMAIN_ID").ok().as_deref()),
            |id| domain_from(Some(&id.to_string())),
        )
    }
}

fn domain_from(variable: Option<&str>) -> Result<u16, NodeError> {
    match variable.map(str::trim) {
        None | Some("") => Ok(0),
        Some(text) => match text.parse::<u16>() {
            Ok(id) if id <= 232 => Ok(id),
            _ => Err(NodeError::Environment {
                variable: "ROS_DOMAIN_ID",
                value: text.to_owned(),
                reason: "it must be a whole number from 0 to 232",
            }),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_environment_of_ros_counts() {
        assert_eq!(domain_from(None).unwrap(), 0);
        assert_eq!(domain_from(Some("42")).unwrap(), 42);
        insta::assert_snapshot!(domain_from(Some("300")).unwrap_err(), @"environment variable ROS_DOMAIN_ID=`300` is not valid: it must be a whole number from 0 to 232");
    }

    #[test]
    fn ros_arguments_are_taken_out() {
        let mut options = NodeOptions::new("palm");
        let args = "--skin palm.toml --ros-args -r contacts:=/c --param rate:=50.0 -p on:=true -- --json";
        let rest = options.ros_args(args.split(' ').map(str::to_owned)).unwrap();
        assert_eq!(rest, ["--skin", "palm.toml", "--json"]);
        assert_eq!(options.remappings, [("contacts".to_owned(), "/c".to_owned())]);
        assert_eq!(options.parameters["rate"], ParameterValue::Double(50.0));
        assert_eq!(options.parameters["on"], ParameterValue::Bool(true));
        for bad in ["--ros-args -r", "--ros-args -r x", "--ros-args --nonsense"] {
            assert!(options.ros_args(bad.split(' ').map(str::to_owned)).is_err(), "{bad}");
        }
    }
}
