//! The worked example of docs/security.md, as it ships: mutual TLS, and access control that lets one party listen and not
//! command.
#![expect(clippy::unwrap_used, reason = "helpers of tests are not seen as tests")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use dermis_integration_tests::{Peer, backend, domain, finish, program, root, scouting_port};
use dermis_msgs::msg::ContactArray;
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolRequest, Trigger, TriggerRequest};
use dermis_node::{NetworkChoice, Node, NodeOptions, Qos, Reach, Subscription};
use zenoh::Wait;

const SOON: Duration = Duration::from_secs(40);

fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + SOON;
    while !condition() {
        assert!(Instant::now() < deadline, "waited {SOON:?} in vain: {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Certificates and configurations of the example, moved to this test's folder, network and loopback.
struct Example(tempfile::TempDir);

impl Example {
    /// `None`, with a printed line, where there is no openssl.
    fn new() -> Option<Self> {
        if Command::new("openssl").arg("version").output().is_err() {
            println!("skipped: there is no program `openssl`");
            return None;
        }
        let example = Self(tempfile::tempdir().unwrap());
        let make = |folder: &str, names: &[&str]| {
            let script = root().join("launch/security/certificates.sh");
            finish(Command::new("sh").arg(script).arg(example.0.path().join(folder)).args(names));
        };
        make("certificates", &["robot", "operator", "reader"]);
        // Somebody else's authority, whose certificates have our names.
        make("foreign", &["robot"]);
        Some(example)
    }

    fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    /// A file that ships, with `changes`; each must change something.
    fn config(&self, name: &str, ships: &str, changes: &[(&str, &str)]) -> PathBuf {
        let mut text = std::fs::read_to_string(root().join("launch/security").join(ships)).unwrap();
        let certificates = self.0.path().join("certificates").display().to_string();
        let scouting = format!("224.0.0.224:{}\", interface: \"127.0.0.1", scouting_port());
        let moved = [
            ("/etc/dermis/certificates", certificates.as_str()),
            ("tls/0.0.0.0:0", "tls/127.0.0.1:0"),
            ("224.0.0.224:7446", scouting.as_str()),
        ];
        for (from, to) in moved.iter().chain(changes) {
            assert!(text.contains(from), "{ships} has no `{from}`");
            text = text.replace(from, to);
        }
        self.file(name, &text)
    }
}

/// A party of the example, and what it hears.
struct Party {
    node: Node,
    heard: Arc<AtomicU64>,
    forged: Arc<AtomicU64>,
    _contacts: Subscription,
}

impl Party {
    fn new(name: &str, config: &Path) -> Self {
        Self::open(name, NetworkChoice { network: None, zenoh_config: Some(config.to_owned()) })
    }

    fn open(name: &str, network: NetworkChoice) -> Self {
        let options = NodeOptions::new(name).domain_id(domain()).network(network).diagnostics(false);
        let node = Node::open(options, &backend()).unwrap();
        let (heard, forged) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let counts = (Arc::clone(&heard), Arc::clone(&forged));
        let contacts = node
            .subscribe("/contacts", Qos::sensor_data(), move |array: ContactArray, _| {
                let count = if array.skin == "forged" { &counts.1 } else { &counts.0 };
                count.fetch_add(1, Ordering::SeqCst);
            })
            .unwrap();
        Self { node, heard, forged, _contacts: contacts }
    }

    fn hears(&self) -> bool {
        self.heard.load(Ordering::SeqCst) > 0
    }

    fn sees_the_skin(&self) -> bool {
        self.node.node_names().unwrap().iter().any(|name| name == "/baro_grid")
    }

    fn enable(&self, within: Duration) -> bool {
        let client = self.node.client::<SetBool>("/baro_grid/set_enabled").unwrap();
        client.call_blocking(&SetBoolRequest { data: true }, within).is_ok()
    }

    fn tare(&self, within: Duration) -> bool {
        let client = self.node.client::<Trigger>("/baro_grid/tare").unwrap();
        client.call_blocking(&TriggerRequest::default(), within).is_ok()
    }

    fn forge(&self) {
        let publisher = self.node.publisher::<ContactArray>("/contacts", Qos::sensor_data()).unwrap();
        for _ in 0..20 {
            publisher.publish(&ContactArray { skin: "forged".to_owned(), ..Default::default() }).unwrap();
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

#[test]
fn a_stranger_stays_out_and_a_reader_reads_only() {
    let Some(example) = Example::new() else { return };
    let robot = example.config("robot.json5", "robot.json5", &[]);
    let operator = example.config(
        "operator.json5",
        "robot.json5",
        &[("robot.key", "operator.key"), ("robot.pem", "operator.pem")],
    );
    let reader = example.config("reader.json5", "reader.json5", &[]);
    let mut command = Command::new(program("dermis"));
    command.args(["demo", "--duration", "120s", "--json", "--zenoh-config"]).arg(&robot);
    let mut demo = Peer::start(command.stderr(std::process::Stdio::piped()));
    let said = demo.expect_error("network: ", SOON);
    assert!(said.contains("access control") || said.contains("programs on this machine only"), "{said}");

    let operator = Party::new("operator", &operator);
    let reading = Party::new("reader", &reader);
    until("the operator hears contacts", || operator.hears());
    until("the reader hears contacts", || reading.hears());
    until("the reader sees the skin", || reading.sees_the_skin());
    let soon = Duration::from_secs(10);
    assert!(operator.enable(soon) && operator.tare(soon), "the operator may command");
    let short = Duration::from_secs(1);
    assert!(!reading.enable(short) && !reading.tare(short), "the reader may not");
    // Its messages end at the robot's and the operator's door.
    let before = operator.forged.load(Ordering::SeqCst);
    reading.forge();
    assert_eq!(operator.forged.load(Ordering::SeqCst), before);
    operator.forge();
    until("the reader hears what the operator says", || reading.forged.load(Ordering::SeqCst) > 0);

    the_reader_gets_json(&reader);
    strangers_hear_nothing(&example);
}

/// The bridge's JSON passes, as stream and as latest value; its commands do not.
fn the_reader_gets_json(config: &Path) {
    let session = zenoh::open(zenoh::Config::from_file(config).unwrap()).wait().unwrap();
    let contacts = session.declare_subscriber("dermis/*/*/contacts").wait().unwrap();
    contacts.recv_timeout(SOON).unwrap().expect("a stream of contacts");
    until("the latest value", || {
        let replies = session.get("dermis/*/*/skin_geometry").timeout(Duration::from_secs(2)).wait().unwrap();
        replies.iter().any(|reply| reply.into_result().is_ok())
    });
    for command in ["tare", "set_enabled"] {
        let query = session.get(format!("dermis/*/*/{command}")).payload("true");
        let replies = query.timeout(Duration::from_secs(1)).wait().unwrap();
        assert!(!replies.iter().any(|reply| reply.into_result().is_ok()), "{command} is a command");
    }
}

/// Without a certificate, with one of another authority, and without TLS.
fn strangers_hear_nothing(example: &Example) {
    let none = [
        ("connect_private_key: ", "// "),
        ("connect_certificate: ", "// "),
        ("listen_private_key: ", "// "),
        ("listen_certificate: ", "// "),
        ("[\"tls/127.0.0.1:0\"]", "[]"),
        ("enable_mtls: true", "enable_mtls: false"),
    ];
    let without = example.config("without.json5", "reader.json5", &none);
    let foreign = example.0.path().join("foreign").display().to_string();
    let wrong =
        example.config("wrong.json5", "reader.json5", &[("reader.key", "KEY"), ("reader.pem", "PEM")]);
    let text = std::fs::read_to_string(&wrong).unwrap();
    let own = example.0.path().join("certificates").display().to_string();
    let text = text.replace(&format!("{own}/KEY"), &format!("{foreign}/robot.key"));
    let wrong =
        example.file("wrong.json5", &text.replace(&format!("{own}/PEM"), &format!("{foreign}/robot.pem")));
    let strangers = [
        ("without a certificate", Party::new("stranger_without", &without)),
        ("with a foreign certificate", Party::new("stranger_foreign", &wrong)),
        (
            "without TLS",
            Party::open(
                "stranger_plain",
                NetworkChoice { network: Some(Reach::Loopback), zenoh_config: None },
            ),
        ),
    ];
    // Three times as long as those with a certificate need.
    std::thread::sleep(Duration::from_secs(2));
    for (name, stranger) in &strangers {
        assert!(!stranger.sees_the_skin() && !stranger.hears(), "{name}");
        assert!(!stranger.enable(Duration::from_millis(300)), "{name}");
    }
}
