//! The behaviour suite over the embedded backend, and what only it must show.
#![expect(clippy::unwrap_used, reason = "helpers of tests are not seen as tests")]

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use dermis_msgs::std_msgs::msg::{Int32, String as Text};
use dermis_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use dermis_msgs::{Message, Service, TypeSupport};
use dermis_node::backend::EndpointKind;
use dermis_node::network::SessionOptions;
use dermis_node::suite::{Bench, WAIT, domain, expect_next, report_waits, until};
use dermis_node::{Backend, HirozBackend, HirozConfig, Node, ProblemKind, Publisher, Qos};
use zenoh::Wait;

/// Networks of different tests do not see each other.
fn scouting_port() -> u16 {
    20_000 + u16::try_from(std::process::id() % 10_000).unwrap()
}

fn config() -> HirozConfig {
    with(SessionOptions::default())
}

/// The same with what a session wants of its own.
fn with(session: SessionOptions) -> HirozConfig {
    let session = SessionOptions { local_router: false, scouting_port: Some(scouting_port()), ..session };
    HirozConfig { session, ..HirozConfig::default() }
}

fn backend() -> Arc<dyn Backend> {
    Arc::new(HirozBackend::new(config()))
}

dermis_node::behaviour_suite!(backend());

/// Nodes that share a session behave as those that do not.
mod one_session {
    use super::{Arc, Backend, HirozBackend, config};

    fn backend() -> Arc<dyn Backend> {
        Arc::new(HirozBackend::new(config()).one_session())
    }

    dermis_node::behaviour_suite!(backend());
}

#[test]
fn nodes_that_share_a_session_are_one_peer_until_the_last_is_closed() {
    let backend = HirozBackend::new(config()).one_session();
    let bench = Bench::new(&backend);
    let (first, second) = (bench.node("first"), bench.node("second"));
    let plain = plain_session();
    let peers = || plain.info().peers_zid().wait().count();
    until("they are seen", || peers() > 0);
    assert_eq!(peers(), 1);
    // Each knows its own endpoints from those of the other.
    let _publisher = first.publisher::<Int32>("shared", Qos::reliable(1)).unwrap();
    let own = |node: &Node| -> Vec<bool> {
        node.endpoints("shared", EndpointKind::Publisher).unwrap().iter().map(|e| e.own).collect()
    };
    until("both see the publisher", || own(&first) == [true] && own(&second) == [false]);
    first.shutdown();
    until("only the second is left", || {
        second.node_names().unwrap().iter().filter(|name| name.ends_with("/first")).count() == 0
    });
    assert_eq!(peers(), 1);
    second.shutdown();
    until("the session is closed", || peers() == 0);
    let _third = bench.node("third");
    until("a new one is opened", || peers() == 1);
}

/// A zenoh client that knows nothing of ROS.
fn plain_session() -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]".to_owned()),
        ("scouting/multicast/address", format!("\"224.0.0.224:{}\"", scouting_port())),
        ("scouting/multicast/interface", "\"127.0.0.1\"".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

/// Liveliness tokens by which entities of this domain announce themselves to the graph.
fn graph_tokens(session: &zenoh::Session) -> Vec<String> {
    let tokens = session.liveliness().get(format!("@ros2_lv/{}/**", domain())).wait().unwrap();
    std::iter::from_fn(|| tokens.recv().ok())
        .filter_map(|reply| reply.into_result().ok().map(|sample| sample.key_expr().to_string()))
        .collect()
}

#[test]
fn the_wire_is_that_of_rmw_zenoh() {
    let backend = backend();
    let bench = Bench::new(&*backend);
    let node = bench.node("a");
    let session = plain_session();
    let (tx, rx) = channel();
    let _all = session
        .declare_subscriber(format!("{}/**", domain()))
        .callback(move |sample| {
            let attachment = sample.attachment().map(|bytes| bytes.to_bytes().into_owned());
            let payload = sample.payload().to_bytes().into_owned();
            let _ = tx.send((sample.key_expr().to_string(), payload, attachment));
        })
        .wait()
        .unwrap();
    let publisher = node.publisher::<Text>("words", Qos::reliable(10)).unwrap();
    until("the plain subscriber counts as one", || publisher.subscriber_count() == 1);
    let before = dermis_now();
    publisher.publish(&Text { data: "hello".to_owned() }).unwrap();
    publisher.publish(&Text { data: "again".to_owned() }).unwrap();
    let mut samples = Vec::new();
    while samples.len() < 2 {
        let sample = expect_next(&rx, "a sample");
        if sample.0.contains("/words/") {
            samples.push(sample);
        }
    }
    let (key, payload, attachment) = &samples[0];
    let hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
    let topic = publisher.topic().trim_start_matches('/');
    assert_eq!(*key, format!("{}/{topic}/std_msgs::msg::dds_::String_/{hash}", domain()));
    assert_eq!(payload[..], [0, 1, 0, 0, 6, 0, 0, 0, b'h', b'e', b'l', b'l', b'o', 0][..]);
    let attachment = attachment.as_ref().unwrap();
    assert_eq!(attachment.len(), 33);
    let long = |at: usize| i64::from_le_bytes(attachment[at..at + 8].try_into().unwrap());
    assert_eq!(long(0), 0, "the sequence starts at 0");
    assert!((before..=dermis_now()).contains(&long(8)), "the time of publishing");
    assert_eq!(attachment[16], 16, "the length of the gid");
    let second = samples[1].2.as_ref().unwrap();
    assert_eq!(second[0], 1, "the next of the sequence");
    assert_eq!(second[16..], attachment[16..], "one publisher, one gid");

    let tokens = graph_tokens(&session);
    let publisher_token = tokens
        .iter()
        .find(|token| token.contains("/MP/") && token.contains("%words/"))
        .unwrap_or_else(|| panic!("no token of the publisher in {tokens:#?}"));
    let parts: Vec<&str> = publisher_token.split('/').collect();
    assert_eq!(parts[1], domain().to_string());
    assert!(parts[2].parse::<zenoh::session::ZenohId>().is_ok(), "{publisher_token}");
    assert_eq!(parts[8], "a");
    assert_eq!(parts[10], "std_msgs::msg::dds_::String_");
    assert_eq!(parts[11], hash);
}

/// The graph may show a server before queries reach it.
#[test]
fn a_call_waits_until_queries_reach_the_server() {
    let backend = backend();
    let bench = Bench::new(&*backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let serve = || a.serve::<Trigger>("~/tare", |_| TriggerResponse::default()).unwrap();
    let server = serve();
    let name = server.name().to_owned();
    let client = b.client::<Trigger>(&name).unwrap();
    until("the server is seen", || client.available());
    let session = plain_session();
    let of_server = |token: &String| token.contains("/SS/") && token.contains("%tare/");
    let mut token = None;
    until("another session sees the server", || {
        token = graph_tokens(&session).into_iter().find(of_server);
        token.is_some()
    });
    drop(server);
    let servers = || b.endpoints(&name, EndpointKind::Service).unwrap().len();
    until("the server is gone", || servers() == 0 && !client.available());
    let _token = session.liveliness().declare_token(token.unwrap()).wait().unwrap();
    until("the graph shows a server", || servers() == 1);
    assert!(!client.available());
    std::thread::scope(|scope| {
        let answer = scope.spawn(|| client.call_blocking(&<Trigger as Service>::Request::default(), WAIT));
        std::thread::sleep(Duration::from_millis(100));
        let _server = serve();
        assert_eq!(answer.join().unwrap().unwrap(), TriggerResponse::default());
    });
}

/// What is sent around hiroz looks like what is sent through it: same key, count from 0, one gid; and the graph says reliable.
#[test]
fn a_stream_is_a_reliable_publisher_to_others() {
    let backend = backend();
    let bench = Bench::new(&*backend);
    let (node, other) = (bench.node("a"), bench.node("b"));
    let session = plain_session();
    let (tx, rx) = channel();
    let _all = session
        .declare_subscriber(format!("{}/**/words/**", domain()))
        .callback(move |sample| {
            let attachment = sample.attachment().map(|bytes| bytes.to_bytes().into_owned());
            let _ = tx.send((sample.key_expr().to_string(), attachment.unwrap_or_default()));
        })
        .wait()
        .unwrap();
    let (to_ros, from_ros) = channel();
    let _sub = other
        .subscribe("words", Qos::reliable(10), move |text: Text, info| {
            let _ = to_ros.send((text.data, info.source_ns));
        })
        .unwrap();
    let stream = node.stream_publisher::<Text>("words", 7).unwrap();
    until("both subscribers are there", || {
        stream.subscriber_count() == 1 && {
            stream.publish(&Text { data: "early".to_owned() }).unwrap();
            rx.try_recv().is_ok()
        }
    });
    // Waiting took one sample; two more follow each other.
    stream.publish(&Text { data: "early".to_owned() }).unwrap();
    stream.publish(&Text { data: "late".to_owned() }).unwrap();
    loop {
        let (data, sent) = expect_next(&from_ros, "the last word");
        assert!(sent.is_some(), "the time of publishing is reported");
        if data == "late" {
            break;
        }
    }
    let (key, first) = expect_next(&rx, "a sample");
    let (_, second) = expect_next(&rx, "the next");
    assert!(key.contains("/words/std_msgs::msg::dds_::String_/RIHS01_"), "{key}");
    let number = |attachment: &[u8]| i64::from_le_bytes(attachment[..8].try_into().unwrap());
    assert_eq!((first.len(), number(&second)), (33, number(&first) + 1));
    assert_eq!(first[16..], second[16..], "one publisher, one gid");
    let offers = other.endpoints(stream.topic(), EndpointKind::Publisher).unwrap();
    assert_eq!(offers.iter().map(|o| o.qos).collect::<Vec<_>>(), [Some(Qos::reliable(7))]);
}

fn dermis_now() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    i64::try_from(since.as_nanos()).unwrap()
}

#[test]
fn a_plain_zenoh_client_publishes_and_calls() {
    let backend = backend();
    let bench = Bench::new(&*backend);
    let node = bench.node("a");
    let (tx, rx) = channel();
    let sub = node
        .subscribe("words", Qos::sensor_data(), move |text: Text, info| {
            let _ = tx.send((text.data, info.source_ns));
        })
        .unwrap();
    let server = node
        .serve::<Trigger>("~/tare", |_| TriggerResponse { success: true, message: "tared".to_owned() })
        .unwrap();
    let session = plain_session();
    let key = |name: &str, kind: &str, hash: &str| format!("{}/{}/{kind}/{hash}", domain(), &name[1..]);
    let publisher = session
        .declare_publisher(key(sub.topic(), "std_msgs::msg::dds_::String_", Text::TYPE_HASH))
        .wait()
        .unwrap();
    until("matched", || publisher.matching_status().wait().unwrap().matching());
    // Without an attachment: the bytes count, and the time of sending is not known.
    publisher.put(Text { data: "plain".to_owned() }.to_cdr()).wait().unwrap();
    assert_eq!(expect_next(&rx, "the word"), ("plain".to_owned(), None));

    let replies = session
        .get(key(server.name(), "std_srvs::srv::dds_::Trigger_", Trigger::TYPE_HASH))
        .payload(<Trigger as Service>::Request::default().to_cdr())
        .timeout(WAIT)
        .wait()
        .unwrap();
    let reply = replies.recv().unwrap().into_result().unwrap();
    let response = TriggerResponse::from_cdr(&reply.payload().to_bytes()).unwrap();
    assert_eq!(response, TriggerResponse { success: true, message: "tared".to_owned() });
}

/// A publisher whose numbers skip, come late, come twice, begin again, or are missing: only what is missing counts.
#[test]
fn what_the_bus_lost_is_counted_by_publisher() {
    use hiroz::attachment::Attachment;
    let backend = backend();
    let bench = Bench::new(&*backend);
    let node = bench.node("a");
    let (tx, rx) = channel();
    let sub = node
        .subscribe("numbers", Qos::reliable(100), move |_: Int32, info| {
            let _ = tx.send(info.publication);
        })
        .unwrap();
    let session = plain_session();
    let key = format!("{}/{}/std_msgs::msg::dds_::Int32_/{}", domain(), &sub.topic()[1..], Int32::TYPE_HASH);
    let publisher = session.declare_publisher(key).wait().unwrap();
    until("matched", || publisher.matching_status().wait().unwrap().matching());
    assert_eq!(sub.losses().known(), None, "nothing came yet that would tell");
    let send = |gid: u8, number: i64, second: i64| {
        let mut attachment = Attachment::new(number, [gid; 16]);
        attachment.source_timestamp = second * 1_000_000_000;
        publisher.put(Int32::default().to_cdr()).attachment(attachment).wait().unwrap();
        let got = expect_next(&rx, "the number").unwrap();
        assert_eq!((got.publisher, got.number), ([gid; 16], u64::try_from(number).unwrap()));
        sub.losses().known().unwrap()
    };
    // A late joiner, with history that comes after the first live message.
    assert_eq!([send(1, 57, 57), send(1, 55, 55), send(1, 56, 56), send(1, 58, 58)], [0; 4]);
    // Three are missing; one of them is only late; another comes twice.
    assert_eq!([send(1, 62, 62), send(1, 60, 60), send(1, 60, 60)], [3, 2, 2]);
    // Started again: another id, or the same one that counts from the start.
    assert_eq!([send(2, 0, 63), send(2, 1, 64), send(1, 0, 65), send(1, 1, 66)], [2; 4]);
    assert_eq!(send(2, 10, 70), 10);
    assert_eq!((sub.losses().numbered, sub.losses().unnumbered, sub.dropped()), (12, 0, 0));
    let loss_status = |status: Vec<(String, dermis_node::Status)>| {
        status.into_iter().find(|(name, _)| name == "subscriptions").unwrap().1
    };
    // The node asks once a second, too.
    let status = loss_status(node.diagnostics().collect());
    let value = (format!("{}: lost on the way", sub.topic()), "10".to_owned());
    assert!(status.values.contains(&value), "{status:?}");
    until("the next report is clean", || {
        loss_status(node.diagnostics().collect()).message == "nothing was lost since the last report"
    });
    publisher.put(Int32::default().to_cdr()).wait().unwrap();
    assert_eq!(expect_next(&rx, "one without a number"), None);
    assert_eq!(sub.losses().unnumbered, 1);
}

#[test]
fn another_version_of_a_type_is_reported() {
    static CHANGED: TypeSupport = TypeSupport {
        name: "std_msgs/msg/Int32",
        hash: "RIHS01_00000000000000000000000000000000000000000000000000000000000000ff",
        definition: "int32 data\nint32 more\n",
        cdr_to_json: |bytes| (TypeSupport::of::<Int32>().cdr_to_json)(bytes),
        json_to_cdr: |value| (TypeSupport::of::<Int32>().json_to_cdr)(value),
    };
    let backend = backend();
    let bench = Bench::new(&*backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let (tx, rx) = channel();
    b.on_problem(move |problem| {
        let _ = tx.send(problem.clone());
    });
    let _sub = b.subscribe("numbers", Qos::reliable(5), |_: Int32, _| {}).unwrap();
    let publisher = a.publisher_raw("numbers", &CHANGED, Qos::reliable(5)).unwrap();
    let problem = expect_next(&rx, "the report");
    assert_eq!(problem.kind, ProblemKind::TypeMismatch);
    assert!(problem.sentence.contains("another version of std_msgs/msg/Int32"), "{}", problem.sentence);
    assert_eq!(publisher.subscriber_count(), 0, "what is of another version does not count");
}

#[test]
fn explicit_endpoints_do_without_multicast() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let listener =
        with(SessionOptions { multicast: false, listen: vec![endpoint.clone()], ..Default::default() });
    let caller = with(SessionOptions { multicast: false, connect: vec![endpoint], ..Default::default() });
    let (listener, caller) = (HirozBackend::new(listener), HirozBackend::new(caller));
    let bench = Bench::new(&listener);
    let a = bench.node("a");
    let b = Node::open(bench.options("b"), &caller).unwrap();
    let (tx, rx) = channel();
    let _sub = b
        .subscribe("words", Qos::reliable(10), move |text: Text, _| {
            let _ = tx.send(text.data);
        })
        .unwrap();
    let publisher = a.publisher::<Text>("words", Qos::reliable(10)).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    publisher.publish(&Text { data: "direct".to_owned() }).unwrap();
    assert_eq!(expect_next(&rx, "the word"), "direct");
}

#[test]
fn domains_do_not_hear_each_other() {
    let backend = backend();
    let bench = Bench::new(&*backend);
    let a = bench.node("a");
    let other = bench.open(bench.options("b").domain_id(domain() + 100));
    let same = bench.node("c");
    let (tx, rx) = channel();
    let also = tx.clone();
    let _elsewhere = other
        .subscribe("words", Qos::reliable(10), move |_: Text, _| {
            let _ = also.send("elsewhere");
        })
        .unwrap();
    let _here = same
        .subscribe("words", Qos::reliable(10), move |_: Text, _| {
            let _ = tx.send("here");
        })
        .unwrap();
    let publisher = a.publisher::<Text>("words", Qos::reliable(10)).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    for _ in 0..3 {
        publisher.publish(&Text::default()).unwrap();
        assert_eq!(expect_next(&rx, "the word"), "here");
    }
    assert!(!a.node_names().unwrap().contains(&other.full_name()));
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Passes bytes between two peers until it shall stop reading.
struct Proxy {
    port: u16,
    stopped: Arc<AtomicBool>,
    passed: Arc<AtomicU64>,
}

impl Proxy {
    fn to(target: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let stopped = Arc::new(AtomicBool::new(false));
        let passed = Arc::new(AtomicU64::new(0));
        let proxy = Self { port, stopped: Arc::clone(&stopped), passed: Arc::clone(&passed) };
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let Ok(server) = TcpStream::connect(("127.0.0.1", target)) else { return };
                for (from, to) in [
                    (client.try_clone().unwrap(), server.try_clone().unwrap()),
                    (server.try_clone().unwrap(), client.try_clone().unwrap()),
                ] {
                    let (stopped, passed) = (Arc::clone(&stopped), Arc::clone(&passed));
                    std::thread::spawn(move || pass(from, to, &stopped, &passed));
                }
            }
        });
        proxy
    }
}

fn pass(mut from: TcpStream, mut to: TcpStream, stopped: &AtomicBool, passed: &AtomicU64) {
    let mut buffer = [0; 65_536];
    while !stopped.load(Ordering::SeqCst) {
        match from.read(&mut buffer) {
            Ok(0) | Err(_) => {
                let _ = to.shutdown(Shutdown::Both);
                return;
            }
            Ok(n) => {
                passed.fetch_add(n as u64, Ordering::SeqCst);
                if to.write_all(&buffer[..n]).is_err() {
                    return;
                }
            }
        }
    }
    // Holds both ends open without reading: a peer that hangs.
    std::thread::sleep(WAIT);
}

#[test]
fn a_hanging_peer_never_holds_a_best_effort_publisher_up() {
    let waits = beside_a_hanging_peer(Qos::sensor_data(), |node| {
        node.publisher("frames", Qos::sensor_data()).unwrap()
    });
    never_long("embedded, best effort", waits);
}

/// Planners subscribe reliably, and one of them may hang.
#[test]
fn a_hanging_peer_never_holds_a_stream_up() {
    let waits = beside_a_hanging_peer(Qos::reliable(10), |node| node.stream_publisher("frames", 10).unwrap());
    never_long("embedded", waits);
}

/// A blocked publisher would wait for seconds; a busy machine may take the processor for less.
fn never_long(case: &str, waits: Vec<Duration>) {
    let (_, worst) = report_waits(case, waits);
    assert!(worst < Duration::from_millis(500), "one publish took {worst:?}");
}

/// A peer that stops reading fills the buffers of the network. A publisher that does not wait drops then and
/// goes on at its rate; 5 s long here. Returns how long each publish took.
fn beside_a_hanging_peer(requested: Qos, publish: impl Fn(&Node) -> Publisher<Text>) -> Vec<Duration> {
    let port = free_port();
    let listen = format!("tcp/127.0.0.1:{port}");
    let talker = with(SessionOptions { multicast: false, listen: vec![listen], ..Default::default() });
    let proxy = Proxy::to(port);
    let connect = format!("tcp/127.0.0.1:{}", proxy.port);
    // Gossip would tell the peer the way around the proxy.
    let reader = HirozConfig {
        overrides: vec![("scouting/gossip/enabled".to_owned(), "false".to_owned())],
        ..with(SessionOptions { multicast: false, connect: vec![connect], ..Default::default() })
    };
    let (talker, reader) = (HirozBackend::new(talker), HirozBackend::new(reader));
    let bench = Bench::new(&talker);
    let a = bench.node("a");
    let b = Node::open(bench.options("b"), &reader).unwrap();
    let (tx, rx) = channel();
    let _sub = b
        .subscribe("frames", requested, move |_: Text, _| {
            let _ = tx.send(());
        })
        .unwrap();
    let publisher = publish(&a);
    until("matched", || publisher.subscriber_count() == 1);
    let frame = Text { data: "x".repeat(100_000) }.to_cdr();
    until("a frame passes", || {
        publisher.publish_cdr(&frame).unwrap();
        rx.try_recv().is_ok()
    });
    proxy.stopped.store(true, Ordering::SeqCst);
    let started = Instant::now();
    let mut waits = Vec::new();
    while started.elapsed() < Duration::from_secs(5) {
        let before = Instant::now();
        publisher.publish_cdr(&frame).unwrap();
        waits.push(before.elapsed());
        std::thread::sleep(Duration::from_millis(5));
    }
    let offered = (waits.len() * frame.len()) as u64;
    assert!(offered > 10_000_000, "{offered} bytes are more than the buffers of two sockets hold");
    assert!(proxy.passed.load(Ordering::SeqCst) < offered, "the peer did hang");
    waits
}

#[test]
fn python_clients_understand_the_wire() {
    let Some(python) = std::env::var_os("DERMIS_CLIENT_PYTHON") else {
        println!("skipped: DERMIS_CLIENT_PYTHON names no python with the clients");
        return;
    };
    let port = free_port();
    let listen = format!("tcp/127.0.0.1:{port}");
    let backend =
        HirozBackend::new(with(SessionOptions { listen: vec![listen.clone()], ..Default::default() }));
    let bench = Bench::new(&backend);
    let node = bench.node("palm");
    let (tx, rx) = channel();
    let _sub = node
        .subscribe("from_python", Qos::reliable(10), move |text: Text, _| {
            let _ = tx.send(text.data);
        })
        .unwrap();
    let _tare = node
        .serve::<Trigger>("~/tare", |_| TriggerResponse { success: true, message: "tared".to_owned() })
        .unwrap();
    let publisher = node.publisher::<Text>("to_python", Qos::reliable(10)).unwrap();
    let _talk = node.timer(Duration::from_millis(100), move || {
        publisher.publish(&Text { data: "hello python".to_owned() }).unwrap();
    });
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/python/wire_client.py");
    let output = std::process::Command::new(python)
        .arg(script)
        .args([&listen, &domain().to_string(), &node.full_name()])
        .output()
        .unwrap();
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "the client failed\n{out}\n{err}");
    println!("{out}");
    assert_eq!(expect_next(&rx, "the word of python"), "hello rust");
}
