//! The start configuration of the node.

use std::path::PathBuf;

use dermis_node::{NetworkChoice, NodeError, NodeOptions, parse_remapping};

use crate::file::RuleFileError;
use crate::rules::Rules;

/// Why the node does not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The rule file cannot be used.
    #[error(transparent)]
    Rules(#[from] RuleFileError),
    /// ROS refused.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// The system gave no thread.
    #[error("cannot start a thread of the reflex node: {0}")]
    Thread(std::io::Error),
}

/// The start configuration of the node.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Rule file.
    pub rules: PathBuf,
    /// Node name; the rule file's `name` where absent.
    pub name: Option<String>,
    /// ROS namespace.
    pub namespace: String,
    /// Remappings of topics and services, `from:=to`.
    pub remap: Vec<String>,
    /// Who can reach the node.
    pub network: NetworkChoice,
    /// ROS domain; `ROS_DOMAIN_ID` where absent.
    pub domain_id: Option<u16>,
    /// Whether ages of messages are by `/clock`.
    pub use_sim_time: bool,
    /// Whether the node configures and activates itself; otherwise a lifecycle manager does.
    pub autostart: bool,
    /// Whether transitions and parameters of other nodes are refused, so that nobody switches it off.
    pub locked: bool,
}

impl Config {
    /// A node with these rules, and everything else as it is by default.
    #[must_use]
    pub fn new(rules: impl Into<PathBuf>) -> Self {
        Self {
            rules: rules.into(),
            name: None,
            namespace: "/".to_owned(),
            remap: Vec::new(),
            network: NetworkChoice::default(),
            domain_id: None,
            use_sim_time: false,
            autostart: true,
            locked: false,
        }
    }

    pub(crate) fn options(&self, rules: &Rules) -> Result<NodeOptions, NodeError> {
        // ROS names have no `-`.
        let name = self.name.clone().unwrap_or_else(|| rules.name.replace('-', "_"));
        let mut options = NodeOptions::new(name)
            .namespace(&self.namespace)
            .network(self.network.clone())
            .use_sim_time(self.use_sim_time);
        options.domain_id = self.domain_id;
        for rule in &self.remap {
            let (from, to) = parse_remapping(rule)?;
            options = options.remap(from, to);
        }
        if self.locked {
            let why = "this reflex node was started with `--locked`";
            options = options.refuse_lifecycle(why).refuse_parameters(why);
        }
        Ok(options)
    }
}
