//! Who can reach a program over the network, tried from another host: two network namespaces that are joined by a cable
//! (veth). Where they cannot be made, each test says so and passes.
//!
//! The programs of this file that run inside of a namespace are this test binary itself, as ignored tests.
#![expect(clippy::unwrap_used, reason = "helpers of tests are not seen as tests")]

use std::collections::BTreeSet;
use std::net::{TcpListener, UdpSocket};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use dermis_integration_tests::{Peer, json, program};
use dermis_msgs::lifecycle_msgs::srv::{ChangeState, ChangeStateRequest};
use dermis_msgs::msg::ContactArray;
use dermis_msgs::srv::{LoadModel, LoadModelRequest};
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolRequest};
use dermis_node::{HirozBackend, Node, NodeOptions, Qos};
use serde_json::{Value, json};

const SOON: Duration = Duration::from_secs(40);
const ROBOT: &str = "10.231.7.1";
const STRANGER: &str = "10.231.7.2";
/// Every variable that says something of the network.
const VARIABLES: [&str; 9] = [
    "ROS_DOMAIN_ID",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "ZENOH_CONFIG_OVERRIDE",
    "ZENOH_SESSION_CONFIG_URI",
    "DERMIS_NETWORK",
    "DERMIS_ZENOH_CONFIG",
    "RUST_LOG",
];

/// A network namespace that lives as long as a sleeping process of ours: nothing is left behind, however the test ends.
struct Host(Child);

impl Host {
    fn new() -> Result<Self, String> {
        let child = Command::new("unshare")
            .args(["--net", "sleep", "300"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|e| format!("unshare does not start: {e}"))?;
        let mut host = Self(child);
        let own = std::fs::read_link("/proc/self/ns/net").map_err(|e| e.to_string())?;
        let deadline = Instant::now() + Duration::from_secs(5);
        while Instant::now() < deadline {
            if let Ok(Some(_)) = host.0.try_wait() {
                return Err("a network namespace cannot be made here (no CAP_NET_ADMIN)".to_owned());
            }
            let other = std::fs::read_link(format!("/proc/{}/ns/net", host.0.id()));
            if other.is_ok_and(|other| other != own) {
                return Ok(host);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Err("a network namespace is not made in time".to_owned())
    }

    /// A program on this host, with nothing said of the network.
    fn command(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let mut command = Command::new("nsenter");
        command.args(["--net", "--target", &self.0.id().to_string(), "--"]).arg(program);
        for variable in VARIABLES {
            command.env_remove(variable);
        }
        command.env("PYTHONUNBUFFERED", "1").stdin(Stdio::null());
        command
    }

    /// One of the ignored tests of this file, on this host.
    fn inside(&self, role: &str) -> Command {
        let mut command = self.command(std::env::current_exe().unwrap());
        let name = format!("network::{role}");
        command.args([&name, "--exact", "--ignored", "--nocapture"]).env("DERMIS_TEST_ROLE", role);
        command
    }

    /// Local addresses of sockets, `127.0.0.1:7447`: TCP that listens, or UDP.
    fn sockets(&self, kind: &str) -> BTreeSet<(String, u16)> {
        let mut all = BTreeSet::new();
        for (table, length) in [(kind.to_owned(), 8), (format!("{kind}6"), 32)] {
            let text =
                std::fs::read_to_string(format!("/proc/{}/net/{table}", self.0.id())).unwrap_or_default();
            for line in text.lines().skip(1) {
                let fields: Vec<&str> = line.split_whitespace().collect();
                let (address, port) = fields[1].split_once(':').unwrap();
                assert_eq!(address.len(), length);
                if kind == "tcp" && fields[3] != "0A" {
                    continue;
                }
                let address = match address {
                    "0100007F" => "127.0.0.1".to_owned(),
                    "00000000" => "0.0.0.0".to_owned(),
                    "0107E70A" => ROBOT.to_owned(),
                    other => other.to_owned(),
                };
                all.insert((address, u16::from_str_radix(port, 16).unwrap()));
            }
        }
        all
    }

    fn listens_at(&self) -> BTreeSet<String> {
        self.sockets("tcp").into_iter().map(|(address, _)| address).collect()
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        // Its namespace goes with the last process in it.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The robot and a stranger's machine on one network; `None`, with a printed line, where they cannot be made.
fn hosts() -> Option<(Host, Host)> {
    let make = || -> Result<(Host, Host), String> {
        let (robot, stranger) = (Host::new()?, Host::new()?);
        let ip = |host: Option<&Host>, line: &str| {
            let mut command = host.map_or_else(|| Command::new("ip"), |host| host.command("ip"));
            let out =
                command.args(line.split(' ')).output().map_err(|e| format!("ip does not start: {e}"))?;
            let error = String::from_utf8_lossy(&out.stderr).into_owned();
            out.status.success().then_some(()).ok_or(format!("ip {line}: {error}"))
        };
        let (a, b) = (robot.0.id(), stranger.0.id());
        ip(None, &format!("link add eth0 netns {a} type veth peer name eth0 netns {b}"))?;
        for (host, address) in [(&robot, ROBOT), (&stranger, STRANGER)] {
            ip(Some(host), "link set lo up")?;
            ip(Some(host), &format!("addr add {address}/24 dev eth0"))?;
            ip(Some(host), "link set eth0 up")?;
        }
        Ok((robot, stranger))
    };
    match make() {
        Ok(hosts) => Some(hosts),
        Err(reason) => {
            println!("skipped: two network namespaces cannot be made: {reason}");
            None
        }
    }
}

/// Everything that a stranger can try, and what came of it.
fn assault(robot: &Host, stranger: &Host, variables: &[(&str, &str)]) -> Value {
    let ports: Vec<String> = robot.sockets("udp").iter().map(|(_, port)| port.to_string()).collect();
    let mut command = stranger.inside("a_stranger");
    command
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        .env("ROS_STATIC_PEERS", ROBOT)
        .env("DERMIS_TEST_UDP_PORTS", ports.join(","))
        .envs(variables.iter().copied());
    let mut peer = Peer::start_as_it_is(&mut command);
    let line = peer.expect("FINDINGS ", SOON);
    json(line.trim_start_matches("FINDINGS "))
}

/// Runs as a stranger on the other host.
#[test]
#[ignore = "runs inside of a network namespace"]
fn a_stranger() {
    if std::env::var("DERMIS_TEST_ROLE").as_deref() != Ok("a_stranger") {
        return;
    }
    let node = Node::open(NodeOptions::new("stranger").diagnostics(false), &HirozBackend::default()).unwrap();
    let heard = Arc::new(AtomicU64::new(0));
    let count = Arc::clone(&heard);
    let _contacts = node
        .subscribe("/contacts", Qos::sensor_data(), move |array: ContactArray, _| {
            count.fetch_add(u64::from(array.skin == "baro-grid"), Ordering::SeqCst);
        })
        .unwrap();
    let forger = node.publisher::<ContactArray>("/contacts", Qos::sensor_data()).unwrap();
    let deadline = Instant::now() + Duration::from_secs(4);
    let sees_robot = || node.node_names().unwrap().iter().any(|name| name == "/baro_grid");
    while Instant::now() < deadline && !(sees_robot() && heard.load(Ordering::SeqCst) > 0) {
        std::thread::sleep(Duration::from_millis(20));
    }
    for _ in 0..20 {
        forger.publish(&ContactArray { skin: "forged".to_owned(), ..Default::default() }).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
    let soon = Duration::from_secs(2);
    let enable = node.client::<SetBool>("/baro_grid/set_enabled").unwrap();
    let enabled = enable.call_blocking(&SetBoolRequest { data: true }, soon).is_ok();
    let load = node.client::<LoadModel>("/baro_grid/load_model").unwrap();
    let loaded = load.call_blocking(&LoadModelRequest { bundle: "../../etc".to_owned() }, soon).is_ok();
    let listed = sees_robot();
    let heard = heard.load(Ordering::SeqCst);
    let lured = lure();
    let change = node.client::<ChangeState>("/baro_grid/change_state").unwrap();
    let mut request = ChangeStateRequest::default();
    request.transition.id = 7; // TRANSITION_ACTIVE_SHUTDOWN
    let stopped = change.call_blocking(&request, soon).is_ok_and(|response| response.success);
    let findings = json!({
        "listed": listed, "heard": heard > 0, "enabled": enabled, "loaded": loaded, "lured": lured, "stopped": stopped,
    });
    println!("\nFINDINGS {findings}");
}

/// Answers as if the robot had requested peers (a `Hello` of zenoh, at every UDP port), and tells whether it connects.
fn lure() -> bool {
    let trap = TcpListener::bind((STRANGER, 0)).unwrap();
    trap.set_nonblocking(true).unwrap();
    let locator = format!("tcp/{}", trap.local_addr().unwrap());
    // Header with locators, version, length of the id and role of a peer, id, locators.
    let mut hello = vec![0x22, 0x09, 0xf1];
    hello.extend([0x5a; 16]);
    hello.extend([1, u8::try_from(locator.len()).unwrap()]);
    hello.extend(locator.as_bytes());
    let socket = UdpSocket::bind((STRANGER, 0)).unwrap();
    let ports = std::env::var("DERMIS_TEST_UDP_PORTS").unwrap_or_default();
    for _ in 0..20 {
        for port in ports.split(',').filter_map(|port| port.parse::<u16>().ok()) {
            // A closed port is said to be so at the next call.
            let _ = socket.send_to(&hello, (ROBOT, port));
        }
        std::thread::sleep(Duration::from_millis(50));
        if trap.accept().is_ok() {
            return true;
        }
    }
    false
}

/// Runs as a subscriber on the robot, and says what it gets.
#[test]
#[ignore = "runs inside of a network namespace"]
fn a_subscriber() {
    if std::env::var("DERMIS_TEST_ROLE").as_deref() != Ok("a_subscriber") {
        return;
    }
    let node =
        Node::open(NodeOptions::new("subscriber").diagnostics(false), &HirozBackend::default()).unwrap();
    let (real, forged) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let counts = (Arc::clone(&real), Arc::clone(&forged));
    let _contacts = node
        .subscribe("/contacts", Qos::sensor_data(), move |array: ContactArray, _| {
            let count = if array.skin == "forged" { &counts.1 } else { &counts.0 };
            count.fetch_add(1, Ordering::SeqCst);
        })
        .unwrap();
    println!("\nREADY {}", node.open_to());
    let deadline = Instant::now() + Duration::from_secs(120);
    while Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(200));
        println!("SEEN {} {}", real.load(Ordering::SeqCst), forged.load(Ordering::SeqCst));
    }
}

/// Real and forged messages, as the next line says.
fn seen(subscriber: &mut Peer) -> (u64, u64) {
    subscriber.drain();
    let line = subscriber.expect("SEEN ", SOON);
    let mut numbers = line.split(' ').skip(1).map(|n| n.parse().unwrap());
    (numbers.next().unwrap(), numbers.next().unwrap())
}

fn hears_contacts(subscriber: &mut Peer) {
    let deadline = Instant::now() + SOON;
    while seen(subscriber).0 == 0 {
        assert!(Instant::now() < deadline, "a subscriber on the robot hears no contacts");
    }
}

fn demo(robot: &Host, arguments: &[&str]) -> (Peer, Vec<String>) {
    let mut command = robot.command(program("dermis"));
    command.args(["demo", "--duration", "120s", "--json"]).args(arguments).stderr(Stdio::piped());
    let mut demo = Peer::start_as_it_is(&mut command);
    let said = [demo.expect_error("network: ", SOON), demo.expect_error("bridge ", SOON)];
    (demo, said.to_vec())
}

fn everything(value: bool) -> Value {
    let all = ["listed", "heard", "enabled", "loaded", "lured", "stopped"];
    all.into_iter().map(|name| (name.to_owned(), json!(value))).collect::<serde_json::Map<_, _>>().into()
}

#[test]
fn by_default_no_other_host_hears_or_commands_anything() {
    let Some((robot, stranger)) = hosts() else { return };
    let (_demo, said) = demo(&robot, &[]);
    for line in &said {
        assert!(line.contains("open to programs on this machine only"), "{line}");
    }
    assert!(said[0].contains("joins a router at tcp/127.0.0.1:7447 where one runs"), "{}", said[0]);
    let mut subscriber = Peer::start_as_it_is(&mut robot.inside("a_subscriber"));
    hears_contacts(&mut subscriber);
    assert_eq!(robot.listens_at(), BTreeSet::from(["127.0.0.1".to_owned()]));
    assert_eq!(assault(&robot, &stranger, &[]), everything(false));
    assert_eq!(seen(&mut subscriber).1, 0, "forged contacts came through");

    // A program of the robot that is open itself would tell its peers of the stranger, and serve clients of other hosts.
    let mut open = robot.inside("a_subscriber");
    let mut open = Peer::start_as_it_is(open.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"));
    open.expect("READY ", SOON);
    let client = format!("mode=\"client\";listen/endpoints=[];connect/endpoints=[\"tcp/{ROBOT}:7450\"]");
    for variables in [vec![], vec![("ZENOH_CONFIG_OVERRIDE", client.as_str())]] {
        let mut found = assault(&robot, &stranger, &variables);
        // The open program obeys commands from outside; the demo does not.
        found["lured"] = json!(false);
        assert_eq!(found, everything(false), "an open program passed things on: {variables:?}");
    }
    let (real, forged) = seen(&mut subscriber);
    assert_eq!(forged, 0, "forged contacts came through, beside {real} real ones");
    let (real, forged) = seen(&mut open);
    assert_eq!(real, 0, "what is open does not meet what stays on the loopback");
    assert!(forged > 0, "the stranger did reach the open program");
}

#[test]
fn with_network_lan_an_honest_client_works_and_a_stranger_too() {
    let Some((robot, stranger)) = hosts() else { return };
    let (_demo, said) = demo(&robot, &["--network", "lan"]);
    for line in &said {
        assert!(
            line.contains("open to every host that reaches any address of this machine, without asking"),
            "{line}"
        );
    }
    let mut subscriber = Peer::start_as_it_is(robot.inside("a_subscriber").env("DERMIS_NETWORK", "lan"));
    hears_contacts(&mut subscriber);
    assert_eq!(assault(&robot, &stranger, &[]), everything(true), "what the other test refuses is possible");
    assert!(seen(&mut subscriber).1 > 0, "and so is forging");
}

#[test]
fn an_address_and_the_variables_of_ros_open_what_they_say() {
    let Some((robot, _stranger)) = hosts() else { return };
    let listens = |arguments: &[&str], variables: &[(&str, &str)]| {
        let mut command = robot.command(program("dermis"));
        command.arg("bridge").args(arguments).envs(variables.iter().copied()).stderr(Stdio::piped());
        let mut bridge = Peer::start_as_it_is(&mut command);
        bridge.expect_error("network: ", SOON);
        bridge.expect_error("bridge ", SOON);
        let found: Vec<String> = robot.listens_at().into_iter().collect();
        bridge.kill();
        found
    };
    let range = "ROS_AUTOMATIC_DISCOVERY_RANGE";
    assert_eq!(listens(&[], &[]), ["127.0.0.1"]);
    assert_eq!(listens(&["--network", ROBOT], &[]), [ROBOT, "127.0.0.1"]);
    assert_eq!(listens(&[], &[(range, "SUBNET")]), ["0.0.0.0"]);
    assert_eq!(listens(&["--network", "loopback"], &[(range, "SUBNET")]), ["127.0.0.1"]);
    assert_eq!(listens(&[], &[(range, "SUBNET"), ("ROS_LOCALHOST_ONLY", "1")]), ["127.0.0.1"]);
    assert_eq!(listens(&[], &[(range, "OFF")]), [""; 0]);
}
