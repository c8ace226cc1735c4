//! What a [`Network`] means for a zenoh session, and what a configuration of zenoh means for people.
//!
//! | reach | listens on | looks for peers | learns peers by gossip |
//! |---|---|---|---|
//! | off | nothing | nowhere | no |
//! | loopback | 127.0.0.1 | on the loopback | no |
//! | address | 127.0.0.1 and the address | on the loopback and the interface of the address | no |
//! | lan | every interface | on every multicast interface | yes |
//!
//! A zenoh peer serves the zenoh *clients* of other hosts that connect to it, with everything that its own peers offer. So a
//! program on the loopback must not have a peer that is open: they look for each other at different ports
//! ([`LOOPBACK_SCOUTING_PORT`], [`SCOUTING_PORT`]), and never meet.
//!
//! Gossip (a peer names the peers that it knows, and one connects to them) would lead out of the loopback as soon as one
//! program of this machine knows another host. So it is off but for `lan`. Routers are not looked for outside of `lan`
//! either, because they pass on what other hosts say; only the one that `rmw_zenoh` uses, port 7447 of this machine, is
//! joined where it runs, and the sentence of [`describe`] says so.
//!
//! `ROS_STATIC_PEERS` are addresses without a port, but zenoh peers take any free port. So a program that is open takes the
//! first free one of [`WELL_KNOWN`], and a static peer is tried at all of them, and at the router's.

use std::hash::{BuildHasher as _, Hasher as _};
use std::net::{IpAddr, TcpListener};
use std::ops::RangeInclusive;

use serde_json::{Value, json};
use zenoh::Wait;

use crate::network::{Network, Reach};

/// Where a router of `rmw_zenoh` listens.
const ROUTER: &str = "tcp/127.0.0.1:7447";
const ROUTER_PORT: u16 = 7447;
/// Multicast group in which zenoh peers look for each other.
const SCOUTING_GROUP: &str = "224.0.0.224";
const SCOUTING_PORT: u16 = 7446;
/// Port at which programs that stay on the loopback look for each other.
pub(super) const LOOPBACK_SCOUTING_PORT: u16 = 7445;
/// Ports of programs that are open to other hosts.
const WELL_KNOWN: RangeInclusive<u16> = 7450..=7481;
/// Entries of the configuration, `key=value;key=value`, that win over everything; as `rmw_zenoh` reads it.
const OVERRIDES: &str = "ZENOH_CONFIG_OVERRIDE";

/// What one session wants beside what its [`Network`] says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SessionOptions {
    /// `peer`, or `client`: talks through the endpoints of `connect` only.
    pub mode: String,
    /// Endpoints to connect to, `tcp/192.168.1.5:7447`.
    pub connect: Vec<String>,
    /// Endpoints to listen on instead of what the network says.
    pub listen: Vec<String>,
    /// Whether to join the router of `rmw_zenoh` on this machine.
    pub local_router: bool,
    /// Whether to find peers by multicast.
    pub multicast: bool,
    /// Port of the multicast group, where it is not to be the usual one: networks with different ports do not see each other.
    pub scouting_port: Option<u16>,
}

impl Default for SessionOptions {
    fn default() -> Self {
        Self {
            mode: "peer".to_owned(),
            connect: Vec::new(),
            listen: Vec::new(),
            local_router: true,
            multicast: true,
            scouting_port: None,
        }
    }
}

impl Network {
    /// The configuration of a zenoh session that reaches as far as this says. `ZENOH_CONFIG_OVERRIDE` wins over all of it.
    ///
    /// # Errors
    ///
    /// A sentence where the configuration file or an entry cannot be used.
    pub fn session(&self, options: &SessionOptions) -> Result<zenoh::Config, String> {
        let mut config = self.build(options)?;
        overrides(&mut config)?;
        Ok(config)
    }

    fn build(&self, options: &SessionOptions) -> Result<zenoh::Config, String> {
        if let Some(path) = &self.zenoh_config {
            return zenoh::Config::from_file(path)
                .map_err(|error| format!("zenoh configuration file {}: {error}", path.display()));
        }
        let off = self.reach == Reach::Off;
        let client = options.mode == "client";
        let mut config = zenoh::Config::default();
        let mut set = |key: &str, value: Value| insert(&mut config, key, &value.to_string());
        let mut connect = options.connect.clone();
        if !client {
            if options.local_router && !off {
                connect.push(ROUTER.to_owned());
            }
            connect.extend(self.static_peers.iter().flat_map(|peer| endpoints_of(peer)));
        }
        set("mode", json!(options.mode))?;
        set("connect/endpoints", json!(connect))?;
        if !client {
            // What is not there is tried again in the background.
            set("connect/timeout_ms", json!(-1))?;
            set("connect/exit_on_failure", json!(false))?;
        }
        let listen =
            if options.listen.is_empty() && !client { self.listen() } else { options.listen.clone() };
        set("listen/endpoints", json!(listen))?;
        set("scouting/multicast/enabled", json!(options.multicast && !off))?;
        let usual = if self.reach == Reach::Loopback { LOOPBACK_SCOUTING_PORT } else { SCOUTING_PORT };
        let port = options.scouting_port.unwrap_or(usual);
        set("scouting/multicast/address", json!(format!("{SCOUTING_GROUP}:{port}")))?;
        let interfaces = match self.reach {
            Reach::Lan => "auto".to_owned(),
            // The group is one of IPv4.
            Reach::Address(IpAddr::V4(address)) => format!("127.0.0.1,{address}"),
            Reach::Off | Reach::Loopback | Reach::Address(_) => "127.0.0.1".to_owned(),
        };
        set("scouting/multicast/interface", json!(interfaces))?;
        if matches!(self.reach, Reach::Off | Reach::Loopback) {
            set("scouting/multicast/ttl", json!(0))?;
        }
        if self.reach != Reach::Lan {
            let peers = json!({ "router": [], "peer": ["peer"], "client": ["peer"] });
            set("scouting/multicast/autoconnect", peers)?;
            set("scouting/gossip/autoconnect", json!({ "router": [], "peer": [], "client": [] }))?;
            // Nodes of `rmw_zenoh`, which are named to us by their router, connect to whom has a lesser identifier than theirs.
            // Identifiers are compared from their last bytes on: those are random in theirs, and zero in ours.
            set("id", json!(format!("{:x}", u128::from(random().max(1)) << 32)))?;
        }
        Ok(config)
    }

    fn listen(&self) -> Vec<String> {
        let loopback = "tcp/127.0.0.1:0".to_owned();
        match self.reach {
            Reach::Off => vec![],
            Reach::Loopback => vec![loopback],
            Reach::Address(address) => vec![loopback, open_endpoint(address)],
            Reach::Lan => vec![open_endpoint([0, 0, 0, 0].into())],
        }
    }

    /// To be called once the session is open: keeps it to this network where zenoh does not by itself, and says what it is
    /// open to, in one sentence.
    #[must_use]
    pub fn opened(&self, session: &zenoh::Session, config: &zenoh::Config) -> String {
        if self.zenoh_config.is_none()
            && matches!(self.reach, Reach::Loopback | Reach::Address(_))
            && let Err(error) = super::sockets::keep_on_loopback()
        {
            tracing::warn!(
                "network: answers to the search for peers are taken from other hosts too, because a socket cannot be bound to the loopback: {error}"
            );
        }
        let router = session.info().routers_zid().wait().next().is_some();
        describe(config, self, router)
    }
}

/// A random number: the standard library draws one to key its hash tables with.
fn random() -> u64 {
    std::collections::hash_map::RandomState::new().build_hasher().finish()
}

/// Applies `ZENOH_CONFIG_OVERRIDE`.
fn overrides(config: &mut zenoh::Config) -> Result<(), String> {
    let Ok(text) = std::env::var(OVERRIDES) else { return Ok(()) };
    for entry in text.split(';').map(str::trim).filter(|entry| !entry.is_empty()) {
        let (key, value) = entry.split_once('=').ok_or_else(|| {
            format!("environment variable {OVERRIDES}: `{entry}` is not of the form key=value")
        })?;
        insert(config, key.trim(), value.trim())?;
    }
    Ok(())
}

pub(crate) fn insert(config: &mut zenoh::Config, key: &str, value: &str) -> Result<(), String> {
    config.insert_json5(key, value).map_err(|error| format!("zenoh configuration {key}={value}: {error}"))
}

fn endpoint(address: IpAddr, port: u16) -> String {
    format!("tcp/{}", std::net::SocketAddr::new(address, port))
}

/// Where a program that is open listens: at the first free well-known port, or at any.
fn open_endpoint(address: IpAddr) -> String {
    let free = WELL_KNOWN.into_iter().find(|port| TcpListener::bind((address, *port)).is_ok());
    endpoint(address, free.unwrap_or(0))
}

/// Where a static peer may listen.
fn endpoints_of(peer: &str) -> Vec<String> {
    if peer.contains('/') {
        return vec![peer.to_owned()];
    }
    if let Ok(address) = peer.parse::<IpAddr>() {
        return std::iter::once(ROUTER_PORT).chain(WELL_KNOWN).map(|port| endpoint(address, port)).collect();
    }
    if peer.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok()) {
        return vec![format!("tcp/{peer}")];
    }
    std::iter::once(ROUTER_PORT).chain(WELL_KNOWN).map(|port| format!("tcp/{peer}:{port}")).collect()
}

/// What a session with this configuration is open to, in one sentence. `router` is whether it has joined one.
fn describe(config: &zenoh::Config, network: &Network, router: bool) -> String {
    let listen = addresses(config, "listen/endpoints");
    let connect = addresses(config, "connect/endpoints");
    let mut sentence = format!("network: open to {}", who(&listen, config));
    let elsewhere: Vec<&str> = {
        let hosts = connect.iter().filter(|endpoint| !is_local(endpoint)).map(|endpoint| host(endpoint));
        let mut hosts: Vec<&str> = hosts.collect();
        hosts.dedup();
        hosts
    };
    if !elsewhere.is_empty() {
        sentence += &format!(
            "; connects to {}, and is open to them and to whoever they let in",
            elsewhere.join(", ")
        );
    }
    let local_routers: Vec<&str> = connect
        .iter()
        .filter(|endpoint| is_local(endpoint) && !endpoint.starts_with("unixsock"))
        .map(String::as_str)
        .collect();
    if router {
        sentence += "; has joined a router, so that it is open to whoever that router lets in, too";
    } else if !local_routers.is_empty() {
        sentence += &format!(
            "; joins a router at {} where one runs, and is open to whoever that router lets in then",
            local_routers.join(", ")
        );
    }
    format!("{sentence} (by {})", network.decided_by)
}

/// Who can connect.
fn who(listen: &[String], config: &zenoh::Config) -> String {
    let open: Vec<&String> = listen.iter().filter(|endpoint| !is_local(endpoint)).collect();
    if open.is_empty() {
        return if listen.is_empty() {
            "nobody, because it does not listen".to_owned()
        } else {
            "programs on this machine only".to_owned()
        };
    }
    let encrypted = |endpoint: &&String| endpoint.starts_with("tls/") || endpoint.starts_with("quic/");
    let mutual = is_set(config, "transport/link/tls/enable_mtls");
    let guarded = match (open.iter().all(encrypted), mutual) {
        (true, true) => " and shows a certificate (mutual TLS)",
        (true, false) => ", encrypted, but without asking who it is",
        (false, _) => ", without asking who it is",
    };
    let acl =
        if is_set(config, "access_control/enabled") { "; access control decides what it may do" } else { "" };
    let any = open.iter().any(|endpoint| is_unspecified(endpoint));
    let place = if any {
        "any address of this machine".to_owned()
    } else {
        open.iter().map(|endpoint| host(endpoint)).collect::<Vec<_>>().join(" or ")
    };
    format!("every host that reaches {place}{guarded}{acl}")
}

/// Endpoints of the session's mode.
fn addresses(config: &zenoh::Config, key: &str) -> Vec<String> {
    let read =
        |key: &str| config.get_json(key).ok().and_then(|text| serde_json::from_str::<Value>(&text).ok());
    let mode =
        read("mode").and_then(|mode| mode.as_str().map(str::to_owned)).unwrap_or_else(|| "peer".to_owned());
    let value = match read(key) {
        Some(Value::Object(by_mode)) => by_mode.get(&mode).cloned().unwrap_or(Value::Null),
        Some(value) => value,
        None => Value::Null,
    };
    let mut all = Vec::new();
    collect(&value, &mut all);
    all
}

/// An endpoint is a text, or a table of several under `locators`.
fn collect(value: &Value, all: &mut Vec<String>) {
    match value {
        Value::String(endpoint) => all.push(endpoint.clone()),
        Value::Array(items) => items.iter().for_each(|item| collect(item, all)),
        Value::Object(table) => table.get("locators").into_iter().for_each(|item| collect(item, all)),
        _ => {}
    }
}

fn is_set(config: &zenoh::Config, key: &str) -> bool {
    config.get_json(key).is_ok_and(|text| text == "true")
}

/// `192.168.1.5` of `tcp/192.168.1.5:7447#iface=eth0`.
fn host(endpoint: &str) -> &str {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, address)| address);
    let address = address.split(['?', '#']).next().unwrap_or(address);
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    host.trim_start_matches('[').trim_end_matches(']')
}

fn is_local(endpoint: &str) -> bool {
    endpoint.starts_with("unixsock")
        || host(endpoint) == "localhost"
        || host(endpoint).parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

fn is_unspecified(endpoint: &str) -> bool {
    host(endpoint).parse::<IpAddr>().is_ok_and(|address| address.is_unspecified())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(reach: Reach) -> Network {
        Network { reach, ..Network::default() }
    }

    fn get(network: &Network, key: &str) -> String {
        network.build(&SessionOptions::default()).unwrap().get_json(key).unwrap()
    }

    fn said(network: &Network, options: &SessionOptions) -> String {
        describe(&network.build(options).unwrap(), network, false)
    }

    #[test]
    fn the_loopback_stays_on_the_loopback() {
        let loopback = Network::default();
        assert_eq!(get(&loopback, "listen/endpoints"), r#"["tcp/127.0.0.1:0"]"#);
        assert_eq!(get(&loopback, "connect/endpoints"), r#"["tcp/127.0.0.1:7447"]"#);
        assert_eq!(get(&loopback, "scouting/multicast/interface"), r#""127.0.0.1""#);
        assert_eq!(get(&loopback, "scouting/multicast/ttl"), "0");
        assert_eq!(get(&loopback, "scouting/multicast/address"), r#""224.0.0.224:7445""#);
        assert_eq!(get(&network(Reach::Lan), "scouting/multicast/address"), r#""224.0.0.224:7446""#);
        for kind in ["multicast", "gossip"] {
            let peers = get(&loopback, &format!("scouting/{kind}/autoconnect"));
            assert!(!peers.contains("router\"]") && !peers.contains("router|"), "{peers}");
        }
        assert!(get(&loopback, "scouting/gossip/autoconnect").contains(r#""peer":[]"#));
    }

    #[test]
    fn the_file_for_clients_is_of_the_same_network() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../launch/loopback.json5");
        let client = zenoh::Config::from_file(file).unwrap();
        for key in [
            "listen/endpoints",
            "scouting/multicast/address",
            "scouting/multicast/interface",
            "scouting/multicast/ttl",
        ] {
            assert_eq!(client.get_json(key).unwrap(), get(&Network::default(), key), "{key}");
        }
    }

    #[test]
    fn off_neither_listens_nor_looks() {
        let off = network(Reach::Off);
        assert_eq!(get(&off, "listen/endpoints"), "[]");
        assert_eq!(get(&off, "connect/endpoints"), "[]");
        assert_eq!(get(&off, "scouting/multicast/enabled"), "false");
    }

    #[test]
    fn what_is_open_has_a_port_that_static_peers_try() {
        let listen = get(&network(Reach::Lan), "listen/endpoints");
        let port: u16 = listen.trim_matches(['[', ']', '"']).rsplit(':').next().unwrap().parse().unwrap();
        assert!(WELL_KNOWN.contains(&port), "{listen}");
        let peers =
            Network { static_peers: vec!["10.0.0.9".into(), "robot:7000".into()], ..Network::default() };
        let connect = get(&peers, "connect/endpoints");
        assert!(connect.contains(&format!("\"tcp/10.0.0.9:{port}\"")), "{connect}");
        assert!(
            connect.contains("\"tcp/10.0.0.9:7447\"") && connect.contains("\"tcp/robot:7000\""),
            "{connect}"
        );
    }

    #[test]
    fn the_sentence_says_what_is_open_to_whom() {
        let plain = SessionOptions::default();
        insta::assert_snapshot!(said(&Network::default(), &plain), @"network: open to programs on this machine only; joins a router at tcp/127.0.0.1:7447 where one runs, and is open to whoever that router lets in then (by the default)");
        insta::assert_snapshot!(said(&network(Reach::Lan), &SessionOptions { local_router: false, ..plain.clone() }), @"network: open to every host that reaches any address of this machine, without asking who it is (by the default)");
        insta::assert_snapshot!(said(&network(Reach::Off), &plain), @"network: open to nobody, because it does not listen (by the default)");
        let address = network(Reach::Address([127, 0, 0, 9].into()));
        assert!(said(&address, &plain).contains("programs on this machine only"), "127.0.0.9 is one too");
        let peers = Network { static_peers: vec!["10.0.0.9".into()], ..Network::default() };
        assert!(said(&peers, &plain).contains("this machine only; connects to 10.0.0.9, and is open to them and to whoever they let in; joins a router"));
        let client =
            SessionOptions { mode: "client".into(), connect: vec!["tcp/10.0.0.9:7447".into()], ..plain };
        insta::assert_snapshot!(said(&Network::default(), &client), @"network: open to nobody, because it does not listen; connects to 10.0.0.9, and is open to them and to whoever they let in (by the default)");
        insta::assert_snapshot!(describe(&Network::default().build(&SessionOptions::default()).unwrap(), &Network::default(), true), @"network: open to programs on this machine only; has joined a router, so that it is open to whoever that router lets in, too (by the default)");
    }

    #[test]
    fn the_examples_that_ship_are_read_and_said_to_ask_for_certificates() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../launch/security");
        let file = |name: &str| Network {
            zenoh_config: Some(format!("{folder}/{name}").into()),
            decided_by: name.to_owned(),
            ..Network::default()
        };
        insta::assert_snapshot!(said(&file("robot.json5"), &SessionOptions::default()), @"network: open to every host that reaches any address of this machine and shows a certificate (mutual TLS); access control decides what it may do (by robot.json5)");
        assert!(said(&file("reader.json5"), &SessionOptions::default()).contains("mutual TLS"));
        let missing = file("none.json5").build(&SessionOptions::default()).unwrap_err();
        assert!(missing.contains("none.json5"), "{missing}");
    }

    #[test]
    fn hosts_of_endpoints_are_found() {
        for (endpoint, name) in [
            ("tcp/192.168.1.5:7447#iface=eth0", "192.168.1.5"),
            ("tls/[::1]:7460?rel=1", "::1"),
            ("udp/robot.local:7", "robot.local"),
        ] {
            assert_eq!(host(endpoint), name);
        }
        assert!(is_local("tcp/[::1]:1") && is_local("tcp/localhost:1") && is_local("tcp/127.0.0.1:1"));
        assert!(is_unspecified("tcp/[::]:0") && is_unspecified("tls/0.0.0.0:7460"));
    }
}
