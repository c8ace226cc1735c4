//! Nodes of `rmw_zenoh` beside ours, without ROS: zenoh sessions with the settings that `rmw_zenoh` ships, listening to the
//! keys that it listens to, and a router with those of `rmw_zenohd`.
//!
//! `rmw_zenoh` looks for a router on port 7447 of its machine and for nobody else. Without one, its nodes find neither each
//! other nor ours. `docs/ros2.md` tells so and names both ways out, which are tried here. The fixed port is another one here:
//! tests run beside each other, and maybe beside a robot.
#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::net::TcpListener;
use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use dermis_integration_tests::{Peer, domain, program, scouting_port};
use dermis_msgs::Message;
use dermis_msgs::msg::ContactArray;
use zenoh::Wait;

const SOON: Duration = Duration::from_secs(60);

/// How long a node may hear nothing before it is started again, and how often it is started at most.
const PATIENT: Duration = Duration::from_secs(20);
const STARTS: usize = 3;

/// Identifiers of zenoh sessions of `rmw_zenoh`. They are random, and compared from their last bytes on: one of four thousand
/// million is less than the first.
const LEAST: &str = "\"ffffffffffffffffffffffff00000001\"";
const GREATEST: &str = "\"ffffffffffffffffffffffffffffffff\"";

/// What both sides get besides, because tests run beside builds, which starve a process for as long as zenoh waits by itself: 10 s
/// for a handshake, and for a sign of life of a peer. A peer that a router names is connected to once. Nobody tries again where
/// that fails (zenoh 1.10.2, `Gossip::link_states`: a router names a peer when it learns its address, and not again), nor where the
/// connection ends (`Runtime::closed_session` goes back to endpoints of the configuration only). Of the two, only the one with the
/// greater identifier tries. Our nodes do not: on the loopback they connect to nobody that others name.
const PATIENCE: [(&str, &str); 3] = [
    ("transport/unicast/open_timeout", "60000"),
    ("transport/unicast/accept_timeout", "60000"),
    ("transport/link/tx/lease", "60000"),
];

/// An endpoint that nobody listens on.
fn endpoint() -> String {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    format!("tcp/127.0.0.1:{port}")
}

fn open(settings: &[(&str, &str)]) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in settings {
        config.insert_json5(key, value).unwrap_or_else(|e| panic!("{key}: {e}"));
    }
    zenoh::open(config).wait().unwrap()
}

/// Settings of a node of `rmw_zenoh` (Kilted) that differ from those of zenoh, with its router at `router`.
fn node_settings(router: &str) -> Vec<(&'static str, String)> {
    vec![
        ("mode", "\"peer\"".to_owned()),
        ("connect/endpoints", format!("[\"{router}\"]")),
        ("connect/timeout_ms", "{ router: -1, peer: -1, client: 0 }".to_owned()),
        ("connect/exit_on_failure", "{ router: false, peer: false, client: true }".to_owned()),
        ("listen/endpoints", "[\"tcp/localhost:0\"]".to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/target", "{ router: [\"router\", \"peer\"], peer: [\"router\"] }".to_owned()),
        (
            "scouting/gossip/autoconnect_strategy",
            "{ peer: { to_router: \"always\", to_peer: \"greater-zid\" } }".to_owned(),
        ),
        ("timestamping/enabled", "{ router: true, peer: true, client: true }".to_owned()),
    ]
}

/// A node of `rmw_zenoh` that listens to contacts; `overrides` are those of its `ZENOH_CONFIG_OVERRIDE`.
struct RmwNode {
    session: zenoh::Session,
    contacts: Receiver<ContactArray>,
}

impl RmwNode {
    fn start(router: &str, overrides: &[(&'static str, &str)]) -> Self {
        let settings = node_settings(router);
        let mut all: Vec<(&str, &str)> = settings.iter().map(|(key, value)| (*key, value.as_str())).collect();
        all.extend_from_slice(&PATIENCE);
        all.extend_from_slice(overrides);
        let session = open(&all);
        let key = format!(
            "{}/contacts/dermis_msgs::msg::dds_::ContactArray_/{}",
            domain(),
            ContactArray::TYPE_HASH
        );
        let (heard, contacts) = channel();
        session
            .declare_subscriber(key)
            .callback(move |sample| {
                if let Ok(array) = ContactArray::from_cdr(&sample.payload().to_bytes()) {
                    // A test that got what it wanted hangs up.
                    let _ = heard.send(array);
                }
            })
            .background()
            .wait()
            .unwrap();
        Self { session, contacts }
    }

    fn expect(&self, what: &str) -> ContactArray {
        self.contacts.recv_timeout(SOON).unwrap_or_else(|_| panic!("{what}: nothing within {SOON:?}"))
    }

    /// The first contacts. A node that hears nothing is started again, as `docs/ros2.md` advises: it has tried to connect once, and a
    /// busy machine may have let that fail.
    fn expect_or_restart(&mut self, what: &str, start: impl Fn() -> Self) -> ContactArray {
        for _ in 0..STARTS - 1 {
            match self.contacts.recv_timeout(PATIENT) {
                Ok(array) => return array,
                Err(_) => println!("{what}: nothing within {PATIENT:?}; the node is started again"),
            }
            // Two sessions of one identifier are refused by the router.
            self.session.close().wait().unwrap();
            *self = start();
        }
        self.expect(what)
    }
}

/// A router with the settings of `rmw_zenohd`, but for its address. It does not pass data on between peers of its machine: it
/// tells them where the other is.
fn router(endpoint: &str) -> zenoh::Session {
    let listen = format!("[\"{endpoint}\"]");
    let mut settings = vec![
        ("mode", "\"router\""),
        ("listen/endpoints", listen.as_str()),
        ("connect/endpoints", "[]"),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/target", "{ router: [\"router\", \"peer\"], peer: [\"router\"] }"),
        ("routing/router/peers_failover_brokering", "false"),
        ("timestamping/enabled", "{ router: true, peer: true, client: true }"),
    ];
    settings.extend(PATIENCE);
    open(&settings)
}

fn demo(router: &str) -> Peer {
    let patience = PATIENCE.map(|(key, value)| format!(";{key}={value}")).concat();
    Peer::start(
        Command::new(program("dermis"))
            .args(["demo", "--duration", "240s", "--json", "--no-bridge"])
            .env("ZENOH_CONFIG_OVERRIDE", format!("connect/endpoints=[\"{router}\"]{patience}")),
    )
}

#[test]
fn rmw_zenoh_hears_a_node_as_soon_as_its_router_runs() {
    let address = endpoint();
    let _demo = demo(&address);
    // Of two peers that hear of each other through a router, the one with the greater identifier connects, say the settings of
    // `rmw_zenoh`; identifiers are random. So both cases are tried: who has nearly the least, and who has the greatest of all.
    let mut as_shipped = [LEAST, GREATEST].map(|id| RmwNode::start(&address, &[("id", id)]));
    // As documented for robots without a router; tests stay on the loopback.
    let multicast = RmwNode::start(
        &address,
        &[
            ("scouting/multicast/enabled", "true"),
            ("scouting/multicast/interface", "\"127.0.0.1\""),
            ("scouting/multicast/address", &format!("\"224.0.0.224:{}\"", scouting_port())),
        ],
    );
    let array = multicast.expect("contacts, found by multicast");
    assert_eq!(array.skin, "baro-grid");
    for _ in 0..200 {
        multicast.expect("more of them");
    }
    for node in &as_shipped {
        assert!(node.contacts.try_recv().is_err(), "no router, nothing to be heard");
    }

    let begun = Instant::now();
    let _router = router(&address);
    for (node, id) in as_shipped.iter_mut().zip([LEAST, GREATEST]) {
        let again = || RmwNode::start(&address, &[("id", id)]);
        let array = node.expect_or_restart("contacts, found through the router", again);
        println!("{:.1} s from the start of the router to contacts at {id}", begun.elapsed().as_secs_f64());
        assert_eq!((array.skin.as_str(), array.header.frame_id.as_str()), ("baro-grid", "baro_grid_link"));
        let mut sequence = array.sequence;
        for _ in 0..100 {
            let next = node.expect("more of them").sequence;
            assert!(next > sequence, "{next} after {sequence}");
            sequence = next;
        }
    }
}
