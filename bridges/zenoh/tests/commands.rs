//! Commands against nodes that offer some of them, or are not there.
#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::time::{Duration, Instant};

use dermis_bridge_zenoh::commands::{Command, Commander, node_of};
use dermis_msgs::msg::ContactArray;
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolResponse};
use dermis_node::network::SessionOptions;
use dermis_node::{HirozBackend, HirozConfig, Node, NodeOptions};

const SOON: Duration = Duration::from_secs(60);

fn open(name: &str) -> Node {
    // Networks of different tests do not see each other.
    let scouting_port = Some(20_000 + u16::try_from(std::process::id() % 10_000).unwrap());
    let session = SessionOptions { local_router: false, scouting_port, ..SessionOptions::default() };
    let backend = HirozBackend::new(HirozConfig { session, ..HirozConfig::default() });
    Node::open(NodeOptions::new(name).domain_id(7).localhost_only(true), &backend).unwrap()
}

/// As a node that obeys some groups of commands only: what it does not offer is refused with a sentence, and at once.
#[test]
fn a_command_that_a_node_does_not_offer_is_refused_with_a_sentence() {
    let skin = open("palm");
    let _contacts = skin.stream_publisher::<ContactArray>("contacts", 10).unwrap();
    let _enable = skin
        .serve::<SetBool>("~/set_enabled", |request| SetBoolResponse {
            success: request.data,
            message: format!("received {}", request.data),
        })
        .unwrap();
    let node = open("bridge");
    let begun = Instant::now();
    while node_of(&node, "/contacts", "palm").as_deref() != Ok("/palm") {
        assert!(begun.elapsed() < SOON, "{:?}", node_of(&node, "/contacts", "palm"));
        std::thread::sleep(Duration::from_millis(20));
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let commander = Commander::new(&node);
    let tell = |topic: &str, command: Command| runtime.block_on(commander.tell(topic, "palm", &command));

    let obeyed = tell("/contacts", Command::SetEnabled(true));
    assert_eq!((obeyed.success, obeyed.message.as_str()), (true, "received true"));
    let unwilling = tell("/contacts", Command::SetEnabled(false));
    assert_eq!((unwilling.success, unwilling.message.as_str()), (false, "received false"));

    let begun = Instant::now();
    let absent = tell("/contacts", Command::Tare);
    assert!(!absent.success && absent.message.contains("/palm/tare is not offered"), "{}", absent.message);
    assert!(begun.elapsed() < Duration::from_secs(30), "after {:?}", begun.elapsed());
    let gone = tell("/left/contacts", Command::Tare);
    assert_eq!(gone.message, "no node publishes /left/contacts any more");
}
