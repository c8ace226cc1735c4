//! What groups and files set for the entries within them: namespace, environment, ROS domain, network, log level, container.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::error::LaunchError;
use crate::faults::Faults;
use crate::file::Text;

/// Levels of `log`; it may also be a filter.
pub(super) const LEVELS: [&str; 6] = ["off", "error", "warn", "info", "debug", "trace"];

/// What groups and files set for the entries within them.
#[derive(Debug, Clone, Default)]
pub(super) struct LaunchContext {
    /// Absolute, without a slash at the end.
    pub(super) namespace: String,
    pub(super) environment: BTreeMap<String, String>,
    pub(super) domain_id: Option<u16>,
    pub(super) network: Option<Network>,
    pub(super) log: Option<String>,
    /// Process that nodes share.
    pub(super) container: Option<String>,
    /// Folder of the file.
    pub(super) folder: PathBuf,
}

/// Who can reach processes over the network.
#[derive(Debug, Clone)]
pub(super) enum Network {
    /// As `--network` takes it.
    Reach(String),
    /// A configuration file of zenoh.
    File(PathBuf),
}

impl Network {
    /// The environment variables for a process: ours for our own programs, those of ROS 2 for others. An empty one counts as
    /// unset, and so replaces what the launch itself inherited.
    pub(super) fn variables(&self, own: bool) -> Vec<(&'static str, String)> {
        let pairs = match (self, own) {
            (Self::Reach(reach), true) => {
                [("DERMIS_NETWORK", reach.clone()), ("DERMIS_ZENOH_CONFIG", String::new())]
            }
            (Self::File(file), true) => {
                [("DERMIS_NETWORK", String::new()), ("DERMIS_ZENOH_CONFIG", file.display().to_string())]
            }
            (Self::File(file), false) => {
                return vec![("ZENOH_SESSION_CONFIG_URI", file.display().to_string())];
            }
            (Self::Reach(reach), false) => {
                let range = match reach.as_str() {
                    "loopback" => "LOCALHOST",
                    "lan" => "SUBNET",
                    "off" => "OFF",
                    // ROS 2 has no variable for an address.
                    _ => return vec![],
                };
                [("ROS_AUTOMATIC_DISCOVERY_RANGE", range.to_owned()), ("ROS_LOCALHOST_ONLY", "0".to_owned())]
            }
        };
        pairs.into()
    }
}

/// Errors of one field of a file.
pub(super) struct At<'a> {
    pub(super) file: &'a Path,
    pub(super) field: &'a str,
}

impl At<'_> {
    pub(super) fn refuse(&self, field: &str, reason: impl Into<String>) -> LaunchError {
        let field = match (self.field, field) {
            ("", field) => field.to_owned(),
            (at, "") => at.to_owned(),
            (at, field) => format!("{at}.{field}"),
        };
        LaunchError::Field { path: self.file.to_owned(), field, reason: reason.into() }
    }
}

impl LaunchContext {
    /// The scope within a file, group or process that sets these keys; the inner one wins.
    pub(super) fn inside(
        &self,
        at: &At,
        namespace: Option<&Text>,
        environment: &BTreeMap<String, Text>,
        domain_id: Option<u16>,
        log: Option<&Text>,
        faults: &mut Faults,
    ) -> Self {
        let mut inner = self.clone();
        if let Some(Text(namespace)) = namespace {
            let joined = match namespace.strip_prefix('/') {
                Some(absolute) => absolute.to_owned(),
                None => format!("{}/{namespace}", self.namespace),
            };
            let tokens: Vec<&str> = joined.split('/').filter(|t| !t.is_empty()).collect();
            if let Some(bad) = tokens.iter().find(|token| !is_name(token, false)) {
                faults.push(at.refuse(
                    "namespace",
                    format!("`{bad}` is no part of a namespace; it begins with a letter and goes on with letters, digits or `_`"),
                ));
            }
            inner.namespace = tokens.iter().fold(String::new(), |all, token| all + "/" + token);
        }
        for (name, Text(value)) in environment {
            if name.is_empty() || name.contains(['=', '\0']) || value.contains('\0') {
                faults.push(at.refuse(&format!("environment.{name}"), "is no environment variable"));
            }
            inner.environment.insert(name.clone(), value.clone());
        }
        if let Some(domain) = domain_id {
            if domain > 232 {
                faults.push(at.refuse("domain_id", format!("{domain} is no ROS domain; give 0 to 232")));
            }
            inner.domain_id = Some(domain);
        }
        if let Some(Text(log)) = log {
            if !LEVELS.contains(&log.as_str()) && !log.contains(['=', ',']) {
                faults.push(at.refuse(
                    "log",
                    format!(
                        "`{log}` is no level; give one of {}, or a filter such as `info,dermis_node=debug`",
                        LEVELS.join(", ")
                    ),
                ));
            }
            inner.log = Some(log.clone());
        }
        inner
    }
}

/// The texts as plain strings.
pub(super) fn texts(texts: &[Text]) -> Vec<String> {
    texts.iter().map(|text| text.0.clone()).collect()
}

/// Whether a text is a name of ROS, or, where `free`, one that may have `-` and `.` too.
pub(super) fn is_name(name: &str, free: bool) -> bool {
    let more = |c: char| c.is_ascii_alphanumeric() || c == '_' || (free && (c == '-' || c == '.'));
    name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') && name.chars().all(more)
}
