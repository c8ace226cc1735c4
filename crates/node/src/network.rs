//! Who can reach this program over the network, and whom it looks for.
//!
//! Problem: a node that listens on every interface lets every host of the network list its topics, call its services and
//! forge its messages. ROS 2 has no passwords, so that the only protection that works without any setup is not to listen.
//!
//! Solution: one type, [`Network`], says how far a program reaches. Nodes over both backends and the JSON bridge use it,
//! and nothing else decides on it. It is resolved from, in this order:
//!
//! 1. what was requested explicitly: `--network`, `--zenoh-config`, or the keys `network` and `zenoh_config` of a
//!    node's configuration ([`NetworkChoice`]);
//! 2. `DERMIS_NETWORK` and `DERMIS_ZENOH_CONFIG`, by which `dermis launch` hands its keys to its processes;
//! 3. `ZENOH_SESSION_CONFIG_URI`, the session configuration of `rmw_zenoh`;
//! 4. the variables of ROS 2: `ROS_LOCALHOST_ONLY`, `ROS_AUTOMATIC_DISCOVERY_RANGE`, `ROS_STATIC_PEERS`. They mean what they
//!    mean to rcl: `ROS_LOCALHOST_ONLY=1` wins over both others, and static peers do not count with `OFF`;
//! 5. the loopback. Here dermis differs from ROS 2 up to Kilted, which takes `SUBNET` where nothing is set.
//!
//! [`NetworkChoice::resolve`] reads the environment. What the result means for zenoh is in `network/zenoh_config.rs`.

use std::fmt;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::NodeError;

#[cfg(feature = "hiroz")]
mod sockets;
#[cfg(feature = "hiroz")]
pub(crate) mod zenoh_config;

#[cfg(feature = "hiroz")]
pub use zenoh_config::SessionOptions;

/// How far a program reaches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reach {
    /// Nobody, not even another program on this machine.
    Off,
    /// Programs on this machine.
    #[default]
    Loopback,
    /// Programs on this machine, and hosts that reach this address of it.
    Address(IpAddr),
    /// Every host that reaches any address of this machine.
    Lan,
}

/// A text that is no [`Reach`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no network: give loopback, lan, off, or an IP address of this machine, e.g. 192.168.1.5")]
pub struct ReachError(String);

impl FromStr for Reach {
    type Err = ReachError;

    fn from_str(text: &str) -> Result<Self, ReachError> {
        match text.trim() {
            "off" => Ok(Self::Off),
            "loopback" => Ok(Self::Loopback),
            "lan" => Ok(Self::Lan),
            other => match other.parse::<IpAddr>() {
                Ok(address) if address.is_loopback() => Ok(Self::Loopback),
                Ok(address) if address.is_unspecified() => Ok(Self::Lan),
                Ok(address) if !address.is_multicast() => Ok(Self::Address(address)),
                _ => Err(ReachError(text.to_owned())),
            },
        }
    }
}

impl fmt::Display for Reach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::Loopback => f.write_str("loopback"),
            Self::Address(address) => address.fmt(f),
            Self::Lan => f.write_str("lan"),
        }
    }
}

impl Serialize for Reach {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Reach {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

/// What was requested explicitly; nothing where the environment is to decide.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NetworkChoice {
    /// How far to reach.
    pub network: Option<Reach>,
    /// A zenoh configuration file (JSON5) that says everything instead.
    pub zenoh_config: Option<PathBuf>,
}

/// How far a program reaches, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Network {
    /// How far; with a configuration file this is what the ROS variables have, because the file decides.
    pub reach: Reach,
    /// Hosts to connect to beyond that: `192.168.1.5`, `robot.local`, with or without `:PORT`, or a zenoh endpoint.
    pub static_peers: Vec<String>,
    /// A zenoh configuration file (JSON5) that says everything instead.
    pub zenoh_config: Option<PathBuf>,
    /// What decided, for people.
    pub decided_by: String,
}

impl Default for Network {
    /// The loopback, whatever the environment says.
    fn default() -> Self {
        Self {
            reach: Reach::Loopback,
            static_peers: Vec::new(),
            zenoh_config: None,
            decided_by: "the default".to_owned(),
        }
    }
}

/// Hands a launch file's key `network` to its processes.
pub const NETWORK_VARIABLE: &str = "DERMIS_NETWORK";
/// Hands a launch file's key `zenoh_config` to its processes.
pub const ZENOH_CONFIG_VARIABLE: &str = "DERMIS_ZENOH_CONFIG";

const RANGE: &str = "ROS_AUTOMATIC_DISCOVERY_RANGE";
const LOCALHOST_ONLY: &str = "ROS_LOCALHOST_ONLY";
const STATIC_PEERS: &str = "ROS_STATIC_PEERS";
const SESSION_CONFIG: &str = "ZENOH_SESSION_CONFIG_URI";

impl NetworkChoice {
    /// What this and the environment of the process come to.
    ///
    /// # Errors
    ///
    /// Where both fields are given, or a variable cannot be read.
    pub fn resolve(&self) -> Result<Network, NodeError> {
        self.resolve_in(&|name| std::env::var(name).ok())
    }

    /// The same with another environment.
    pub(crate) fn resolve_in(&self, variable: &dyn Fn(&str) -> Option<String>) -> Result<Network, NodeError> {
        let variable = |name: &str| variable(name).filter(|value| !value.trim().is_empty());
        if let Some(requested) = chosen(
            self.network,
            self.zenoh_config.as_deref(),
            &|reach| format!("`network` {reach}"),
            "give `network` or `zenoh_config`, not both: the file says all of it",
        )? {
            return Ok(requested);
        }
        let reach = match variable(NETWORK_VARIABLE) {
            Some(value) => Some(value.parse::<Reach>().map_err(|_| NodeError::Environment {
                variable: NETWORK_VARIABLE,
                value,
                reason: "it must be loopback, lan, off, or an IP address of this machine",
            })?),
            None => None,
        };
        let file = variable(ZENOH_CONFIG_VARIABLE).map(PathBuf::from);
        if let Some(handed) = chosen(
            reach,
            file.as_deref(),
            &|reach| format!("{NETWORK_VARIABLE}={reach}"),
            "DERMIS_NETWORK and DERMIS_ZENOH_CONFIG are both set; unset one: the file says all of it",
        )? {
            return Ok(handed);
        }
        let mut network = of_ros(&variable)?;
        if let Some(file) = variable(SESSION_CONFIG) {
            network.decided_by = format!("{SESSION_CONFIG}={file}");
            network.zenoh_config = Some(PathBuf::from(file));
        }
        Ok(network)
    }
}

fn chosen(
    reach: Option<Reach>,
    file: Option<&Path>,
    by: &dyn Fn(Reach) -> String,
    both: &'static str,
) -> Result<Option<Network>, NodeError> {
    match (reach, file) {
        (Some(_), Some(_)) => Err(NodeError::Network { reason: both.to_owned() }),
        (Some(reach), None) => Ok(Some(Network { reach, decided_by: by(reach), ..Network::default() })),
        (None, Some(file)) => Ok(Some(Network {
            zenoh_config: Some(file.to_owned()),
            decided_by: file.display().to_string(),
            ..Network::default()
        })),
        (None, None) => Ok(None),
    }
}

/// What the variables of ROS 2 say, as rcl reads them (`rcl_init`, `discovery_options.c`).
fn of_ros(variable: &dyn Fn(&str) -> Option<String>) -> Result<Network, NodeError> {
    if variable(LOCALHOST_ONLY).is_some_and(|value| value.trim() == "1") {
        return Ok(Network { decided_by: format!("{LOCALHOST_ONLY}=1"), ..Network::default() });
    }
    let range = variable(RANGE);
    let reach = match range.as_deref().map(str::trim) {
        None | Some("LOCALHOST") => Reach::Loopback,
        Some("OFF") => Reach::Off,
        // SYSTEM_DEFAULT leaves the middleware as it is, and zenoh as it is listens on every interface.
        Some("SUBNET" | "SYSTEM_DEFAULT") => Reach::Lan,
        Some(text) => {
            return Err(NodeError::Environment {
                variable: RANGE,
                value: text.to_owned(),
                reason: "it must be SUBNET, LOCALHOST, OFF or SYSTEM_DEFAULT",
            });
        }
    };
    let static_peers = match (reach, variable(STATIC_PEERS)) {
        (Reach::Off, _) | (_, None) => Vec::new(),
        (_, Some(peers)) => {
            peers.split(';').map(|peer| peer.trim().to_owned()).filter(|peer| !peer.is_empty()).collect()
        }
    };
    let mut decided_by: Vec<String> = range.map(|range| format!("{RANGE}={range}")).into_iter().collect();
    if !static_peers.is_empty() {
        decided_by.push(format!("{STATIC_PEERS}={}", static_peers.join(";")));
    }
    let decided_by =
        if decided_by.is_empty() { Network::default().decided_by } else { decided_by.join(", ") };
    Ok(Network { reach, static_peers, zenoh_config: None, decided_by })
}

/// Says `sentence` in the log, unless this process has said it already: a program of several nodes says it once.
pub(crate) fn announce(sentence: &str) {
    static SAID: std::sync::Mutex<Vec<String>> = std::sync::Mutex::new(Vec::new());
    let mut said = crate::executor::lock(&SAID);
    if !sentence.is_empty() && !said.iter().any(|other| other == sentence) {
        said.push(sentence.to_owned());
        tracing::info!("{sentence}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(choice: &NetworkChoice, variables: &[(&str, &str)]) -> Result<Network, String> {
        let find = |name: &str| variables.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned());
        choice.resolve_in(&find).map_err(|error| error.to_string())
    }

    fn of(variables: &[(&str, &str)]) -> (Reach, Vec<String>) {
        let network = resolve(&NetworkChoice::default(), variables).unwrap();
        (network.reach, network.static_peers)
    }

    #[test]
    fn a_network_reads_as_people_write_it() {
        for (text, reach) in [
            ("off", Reach::Off),
            ("loopback", Reach::Loopback),
            ("127.0.0.1", Reach::Loopback),
            ("::1", Reach::Loopback),
            ("lan", Reach::Lan),
            ("0.0.0.0", Reach::Lan),
            ("192.168.1.5", Reach::Address([192, 168, 1, 5].into())),
        ] {
            assert_eq!(text.parse(), Ok(reach), "{text}");
            assert_eq!(reach.to_string().parse(), Ok(reach));
        }
        for bad in ["", "LAN", "eth0", "224.0.0.224", "192.168.1.5:7447", "tcp/1.2.3.4:5"] {
            assert!(bad.parse::<Reach>().is_err(), "{bad}");
        }
        insta::assert_snapshot!("wan".parse::<Reach>().unwrap_err(), @"`wan` is no network: give loopback, lan, off, or an IP address of this machine, e.g. 192.168.1.5");
    }

    #[test]
    fn nothing_set_is_the_loopback() {
        assert_eq!(of(&[]), (Reach::Loopback, vec![]));
        assert_eq!(of(&[(RANGE, ""), (LOCALHOST_ONLY, ""), (STATIC_PEERS, " ")]), (Reach::Loopback, vec![]));
    }

    #[test]
    fn the_variables_of_ros_mean_what_they_mean_to_rcl() {
        assert_eq!(of(&[(RANGE, "LOCALHOST")]).0, Reach::Loopback);
        assert_eq!(of(&[(RANGE, "SUBNET")]).0, Reach::Lan);
        assert_eq!(of(&[(RANGE, "SYSTEM_DEFAULT")]).0, Reach::Lan);
        assert_eq!(of(&[(RANGE, "OFF")]).0, Reach::Off);
        let peers = (STATIC_PEERS, "192.168.1.7; robot.local;;");
        let hosts = vec!["192.168.1.7".to_owned(), "robot.local".to_owned()];
        assert_eq!(of(&[peers]), (Reach::Loopback, hosts.clone()));
        assert_eq!(of(&[(RANGE, "SUBNET"), peers]), (Reach::Lan, hosts));
        assert_eq!(of(&[(RANGE, "OFF"), peers]), (Reach::Off, vec![]), "static peers do not count with OFF");
        // `rcl_init`: “'localhost_only' is enabled, 'automatic_discovery_range' and 'static_peers' will be ignored”.
        assert_eq!(of(&[(RANGE, "SUBNET"), (LOCALHOST_ONLY, "1"), peers]), (Reach::Loopback, vec![]));
        assert_eq!(of(&[(RANGE, "SUBNET"), (LOCALHOST_ONLY, "0")]).0, Reach::Lan);
        insta::assert_snapshot!(resolve(&NetworkChoice::default(), &[(RANGE, "localhost")]).unwrap_err(), @"environment variable ROS_AUTOMATIC_DISCOVERY_RANGE=`localhost` is not valid: it must be SUBNET, LOCALHOST, OFF or SYSTEM_DEFAULT");
    }

    #[test]
    fn an_explicit_choice_wins_over_the_environment() {
        let everything = [
            (NETWORK_VARIABLE, "192.168.1.5"),
            (SESSION_CONFIG, "/a.json5"),
            (RANGE, "SUBNET"),
            (STATIC_PEERS, "10.0.0.1"),
        ];
        let requested = NetworkChoice { network: Some(Reach::Loopback), zenoh_config: None };
        let network = resolve(&requested, &everything).unwrap();
        assert_eq!(
            (network.reach, network.static_peers, network.zenoh_config),
            (Reach::Loopback, vec![], None)
        );
        let nothing = NetworkChoice::default();
        let network = resolve(&nothing, &everything).unwrap();
        assert_eq!(network.reach, Reach::Address([192, 168, 1, 5].into()), "the launch file's key");
        let network = resolve(&nothing, &everything[1..]).unwrap();
        assert_eq!(network.zenoh_config.as_deref(), Some(Path::new("/a.json5")));
        let file = NetworkChoice { network: None, zenoh_config: Some("b.json5".into()) };
        let network = resolve(&file, &everything).unwrap();
        assert_eq!(network.zenoh_config.as_deref(), Some(Path::new("b.json5")));
        insta::assert_snapshot!(resolve(&NetworkChoice { network: Some(Reach::Lan), ..file }, &[]).unwrap_err(), @"network: give `network` or `zenoh_config`, not both: the file says all of it");
        assert!(
            resolve(&nothing, &[(NETWORK_VARIABLE, "everywhere")]).unwrap_err().contains("DERMIS_NETWORK")
        );
    }
}
