//! Recording and playing across processes, and bags in the hands of libraries that others wrote.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use dermis_bag::{BagQos, BagReader, BagWriter};
use dermis_integration_tests::{Peer, backend, client_python, domain, isolate, program, root};
use dermis_msgs::geometry_msgs::msg::WrenchStamped;
use dermis_msgs::msg::{SkinGeometry, TaxelFrame};
use dermis_msgs::sensor_msgs::msg::PointCloud2;
use dermis_msgs::std_msgs::msg::Header;
use dermis_msgs::{Message, TypeSupport, type_support};
use dermis_node::{Node, NodeOptions, Qos};

const SOON: Duration = Duration::from_secs(60);
const START: i64 = 1_742_155_052_516_165_123;

fn dermis() -> Command {
    let mut command = Command::new(program("dermis"));
    isolate(&mut command);
    command
}

fn run(command: &mut Command) -> Output {
    command.stdin(Stdio::null()).output().unwrap_or_else(|e| panic!("{command:?} does not start: {e}"))
}

fn succeed(command: &mut Command) -> String {
    let output = run(command);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{command:?}\n{said}\n{}", String::from_utf8_lossy(&output.stderr));
    said
}

fn until<T>(what: &str, mut test: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + SOON;
    loop {
        if let Some(found) = test() {
            return found;
        }
        assert!(Instant::now() < deadline, "not within {SOON:?}: {what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    i64::try_from(since.as_nanos()).unwrap()
}

fn frame(sequence: u64) -> TaxelFrame {
    TaxelFrame {
        header: Header { frame_id: "pad".into(), ..Header::default() },
        skin: "pad".into(),
        sequence,
        values: (0..25).map(|i| i as f32 + sequence as f32).collect(),
        flags: vec![0; 25],
        temperature: f32::NAN,
        ..TaxelFrame::default()
    }
}

/// Bytes that do not compress (a linear congruential generator).
fn noise(count: usize, seed: u64) -> Vec<u8> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    (0..count).map(|_| next()).collect()
}

fn cloud(seed: u64, bytes: usize) -> PointCloud2 {
    PointCloud2 {
        height: 1,
        width: u32::try_from(bytes).unwrap(),
        point_step: 1,
        data: noise(bytes, seed),
        ..PointCloud2::default()
    }
}

/// Frames at 200 Hz, a latched geometry, and now and then something large.
fn make(bag: &Path, seconds: u64) -> u64 {
    let mut writer = BagWriter::create(bag).unwrap();
    let latched = BagQos::latched();
    writer.add_topic("/left/skin_geometry", TypeSupport::of::<SkinGeometry>(), latched).unwrap();
    writer.add_topic("/left/taxels", TypeSupport::of::<TaxelFrame>(), BagQos::reliable(100)).unwrap();
    writer.add_topic("/left/wrench", TypeSupport::of::<WrenchStamped>(), BagQos::reliable(100)).unwrap();
    writer.add_topic("/cloud", TypeSupport::of::<PointCloud2>(), BagQos::reliable(100)).unwrap();
    writer.write("/left/skin_geometry", &SkinGeometry::default(), START).unwrap();
    for index in 0..200 * seconds {
        let time = START + i64::try_from(index).unwrap() * 5_000_000;
        writer.write("/left/taxels", &frame(index), time).unwrap();
        if index % 10 == 0 {
            writer.write("/left/wrench", &WrenchStamped::default(), time).unwrap();
            writer.write("/cloud", &cloud(index, 20_000), time + 1).unwrap();
        }
    }
    writer.finish().unwrap().messages
}

/// The bytes on each topic, in order.
fn bytes(bag: &Path) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut topics: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    for message in BagReader::open(bag).unwrap().messages() {
        let message = message.unwrap();
        topics.entry(message.topic.to_string()).or_default().push(message.data);
    }
    topics
}

fn record(out: &Path, arguments: &[&str]) -> Peer {
    Peer::start(dermis().arg("record").arg("--out").arg(out).args(["--json"]).args(arguments))
}

/// Plays once every topic of the bag has a subscriber.
fn play(bag: &Path, arguments: &[&str]) -> serde_json::Value {
    let mut command = dermis();
    command.arg("play").arg(bag).args(["--json", "--wait-for-subscribers", "1"]).args(arguments);
    serde_json::from_str(&succeed(&mut command)).unwrap()
}

/// How many messages a recording holds by now.
fn so_far(bag: &Path) -> u64 {
    BagReader::recover(bag).map_or(0, |reader| reader.info().messages)
}

#[test]
fn what_is_played_is_recorded_byte_for_byte_and_again() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let count = make(&path("a"), 2);
    for (from, to, arguments) in
        [("a", "b", &["--split-size", "300kB"][..]), ("b", "c", &["--compression", "none"][..])]
    {
        let mut recorder = record(&path(to), &[&["--regex", "^/left|^/cloud"], arguments].concat());
        assert_eq!(play(&path(from), &["--rate", "2"])["messages"], count);
        until("all messages are recorded", || (so_far(&path(to)) == count).then_some(()));
        recorder.interrupt();
        let line = recorder.expect("{", SOON);
        let said: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert!(recorder.end(SOON).success());
        assert_eq!((&said["messages"], &said["dropped"]), (&count.into(), &0.into()), "{line}");
        assert!(bytes(&path("a")) == bytes(&path(to)), "the bytes of {to} are those of the source");
        succeed(dermis().args(["bag", "check"]).arg(path(to)));
    }
    let (first, split) = (BagReader::open(path("a")).unwrap(), BagReader::open(path("b")).unwrap());
    assert!(split.info().files >= 2, "{}", split.info());
    for topic in first.topics() {
        let again = split.topic(&topic.name).unwrap();
        assert_eq!((&again.type_hash, &again.definition), (&topic.type_hash, &topic.definition));
        assert_eq!(again.qos, topic.qos, "{}", topic.name);
    }
}

#[test]
fn topics_are_chosen_and_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    make(&path("a"), 1);
    let mut recorder = record(
        &path("b"),
        &["taxels", "--namespace", "left", "--type", "sensor_msgs/msg/PointCloud2", "--exclude", "wrench"],
    );
    play(&path("a"), &["--topics", "taxels", "cloud", "--remap", "/cloud:=/right/cloud"]);
    until("all messages are recorded", || (so_far(&path("b")) == 220).then_some(()));
    recorder.interrupt();
    assert!(recorder.end(SOON).success());
    let recorded = bytes(&path("b"));
    assert_eq!(recorded.keys().collect::<Vec<_>>(), ["/left/taxels", "/right/cloud"]);
}

#[test]
fn a_kill_loses_at_most_the_last_second() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    make(&path("a"), 4);
    let mut recorder = record(&path("b"), &["--regex", "^/left|^/cloud"]);
    let player =
        Peer::start(dermis().arg("play").arg(path("a")).args(["--loop", "--wait-for-subscribers", "1"]));
    until("recording goes on", || (so_far(&path("b")) > 300).then_some(()));
    let killed = now();
    recorder.kill();
    drop(player);

    let check = run(dermis().args(["bag", "check"]).arg(path("b")));
    let said = String::from_utf8_lossy(&check.stdout);
    assert!(!check.status.success() && said.contains("metadata.yaml: is missing"), "{said}");
    let info = run(dermis().args(["bag", "info"]).arg(path("b")));
    assert!(!info.status.success() && String::from_utf8_lossy(&info.stderr).contains("interrupted"));
    assert!(succeed(dermis().args(["bag", "info", "--recover"]).arg(path("b"))).contains("INTERRUPTED"));

    let whole = BagReader::recover(path("b")).unwrap();
    let messages: Vec<_> = whole.messages().map(Result::unwrap).collect();
    succeed(dermis().args(["bag", "check", "--repair"]).arg(path("b")));
    let repaired = BagReader::open(path("b")).unwrap();
    assert!(repaired.info().complete);
    let last = repaired.span().unwrap().1;
    assert!(killed - last < 1_000_000_000, "{} ms are lost", (killed - last) / 1_000_000);
    let again: Vec<_> = repaired.messages().map(Result::unwrap).collect();
    assert_eq!(messages.len(), again.len());
    assert!(messages.iter().zip(&again).all(|(a, b)| (a.log_time, &a.data) == (b.log_time, &b.data)));
    succeed(dermis().args(["bag", "check"]).arg(path("b")));
    assert!(path("b.damaged").is_dir(), "the original is kept");
}

#[test]
fn a_full_disk_ends_a_recording_with_one_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    make(&path("a"), 4);
    // No file may grow beyond 256 KiB (bash counts in blocks of 1024 bytes).
    let mut recorder = Command::new("bash");
    recorder
        .args(["-c", "ulimit -f 256; exec \"$@\"", "bash"])
        .arg(program("dermis"))
        .args(["record", "--regex", "^/left|^/cloud", "--out"])
        .arg(path("b"))
        .stderr(File::create(path("said")).unwrap());
    let mut recorder = Peer::start(&mut recorder);
    let player =
        Peer::start(dermis().arg("play").arg(path("a")).args(["--loop", "--wait-for-subscribers", "1"]));
    let status = recorder.end(SOON);
    drop(player);
    let said = std::fs::read_to_string(path("said")).unwrap();
    assert_eq!(status.code(), Some(1), "{said}");
    let warnings: Vec<&str> = said.lines().filter(|line| line.starts_with("dermis: ")).collect();
    assert!(
        warnings.len() == 1 && warnings[0].contains("b_0.mcap: the file has reached the largest size"),
        "{said}"
    );
    assert!(!said.contains("panicked"), "{said}");
    let kept = so_far(&path("b"));
    assert!(kept > 100, "{kept} messages stay readable");
    succeed(dermis().args(["bag", "check", "--repair"]).arg(path("b")));
    assert_eq!(BagReader::open(path("b")).unwrap().info().messages, kept);
}

#[test]
fn a_type_that_is_not_built_in_is_recorded_and_played_by_its_definition() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let msg = path("prefix/share/my_pkg/msg");
    std::fs::create_dir_all(&msg).unwrap();
    std::fs::write(msg.join("Known.msg"), "std_msgs/Header header\nfloat64 x\n").unwrap();
    // The hashes are those of nothing: peers only compare them.
    let support = |name: &str| -> &'static TypeSupport {
        let hash = format!("RIHS01_{}", "ab".repeat(32));
        Box::leak(Box::new(TypeSupport {
            name: name.to_owned().leak(),
            hash: hash.leak(),
            definition: "",
            ..*TypeSupport::of::<Header>()
        }))
    };
    let options = NodeOptions::new("foreign").domain_id(domain()).localhost_only(true);
    let node = Node::open(options, &backend()).unwrap();
    let known = node.publisher_raw("/known", support("my_pkg/msg/Known"), Qos::reliable(10)).unwrap();
    let _unknown = node.publisher_raw("/unknown", support("my_pkg/msg/Unknown"), Qos::reliable(10)).unwrap();
    let mut recorder = Peer::start(
        dermis()
            .args(["record", "/known", "/unknown", "--out"])
            .arg(path("b"))
            .env("AMENT_PREFIX_PATH", path("prefix"))
            .stderr(File::create(path("said")).unwrap()),
    );
    let sent = Header::new(5, "x").to_cdr();
    until("it is recorded", || {
        known.publish_cdr(&sent).unwrap();
        (so_far(&path("b")) > 0).then_some(())
    });
    recorder.interrupt();
    assert_eq!(recorder.end(SOON).code(), Some(1), "a topic that was requested by name is not there");
    let said = std::fs::read_to_string(path("said")).unwrap();
    let about: Vec<&str> = said.lines().filter(|line| line.starts_with("/unknown")).collect();
    assert_eq!(
        about,
        [
            "/unknown is not recorded: /foreign publishes my_pkg/msg/Unknown, which is not known here: no definition of my_pkg/msg/Unknown below AMENT_PREFIX_PATH: source the workspace that has its package"
        ]
    );
    let reader = BagReader::open(path("b")).unwrap();
    let topic = reader.topic("/known").unwrap();
    assert!(topic.definition.contains("MSG: std_msgs/Header\n"), "{}", topic.definition);
    assert!(reader.messages().all(|message| message.unwrap().data == sent));

    // And back, without that definition.
    let (tx, rx) = channel();
    let _back = node
        .subscribe_raw("/back", support("my_pkg/msg/Known"), Qos::reliable(10), move |data, _| {
            tx.send(data.to_vec()).unwrap_or_default();
        })
        .unwrap();
    play(&path("b"), &["--remap", "/known:=/back"]);
    assert_eq!(rx.recv_timeout(SOON).unwrap(), sent);
}

/// A script that reads and writes bags with `rosbags` and `mcap-ros2-support`.
fn clients(python: &Path, command: &str, bag: &Path, lines: &Path) -> String {
    let script = root().join("crates/bag/tests/clients.py");
    succeed(Command::new(python).arg(script).arg(command).arg(bag).arg(lines))
}

fn json_lines(path: PathBuf, lines: &[serde_json::Value]) -> PathBuf {
    std::fs::write(&path, lines.iter().map(|line| format!("{line}\n")).collect::<String>()).unwrap();
    path
}

#[test]
fn a_bag_of_rosbags_plays_here() {
    let Some(python) = client_python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let lines: Vec<_> = (0..50)
        .map(|index| {
            let message = (TypeSupport::of::<TaxelFrame>().cdr_to_json)(&frame(index).to_cdr()).unwrap();
            let time = START + i64::try_from(index).unwrap() * 10_000_000;
            serde_json::json!({
                "topic": "/taxels", "type": TaxelFrame::TYPE_NAME, "log_time": time,
                "message": message, "definition": TaxelFrame::DEFINITION,
            })
        })
        .collect();
    let bag = dir.path().join("theirs");
    clients(&python, "write", &bag, &json_lines(dir.path().join("lines.json"), &lines));

    let options = NodeOptions::new("listener").domain_id(domain()).localhost_only(true);
    let node = Node::open(options, &backend()).unwrap();
    let (tx, rx) = channel();
    let _frames = node
        .subscribe("/taxels", Qos::reliable(100), move |frame: TaxelFrame, _| {
            tx.send(frame).unwrap_or_default();
        })
        .unwrap();
    assert_eq!(play(&bag, &[])["messages"], 50);
    for index in 0..50 {
        assert_eq!(rx.recv_timeout(SOON).unwrap().to_cdr(), frame(index).to_cdr());
    }
}

#[test]
fn a_recording_of_the_demo_reads_elsewhere() {
    let Some(python) = client_python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("demo");
    let _demo = Peer::start(dermis().args(["demo", "--duration", "90s", "--json", "--no-bridge"]));
    let mut recorder = record(&bag, &["--split-time", "1s", "--exclude", "rosout|parameter_events"]);
    until("three files are there", || bag.join("demo_2.mcap").exists().then_some(()));
    recorder.interrupt();
    assert!(recorder.end(SOON).success());

    let reader = BagReader::open(&bag).unwrap();
    assert!(reader.info().files >= 3);
    let lines: Vec<_> = reader
        .messages()
        .map(|message| {
            let message = message.unwrap();
            let value = (type_support(&message.type_name).unwrap().cdr_to_json)(&message.data).unwrap();
            serde_json::json!({
                "topic": &*message.topic, "type": &*message.type_name, "log_time": message.log_time,
                "message": value,
            })
        })
        .collect();
    assert!(lines.len() > 200, "{} messages", lines.len());
    let said = clients(&python, "check", &bag, &json_lines(dir.path().join("lines.json"), &lines));
    for library in ["rosbags", "mcap-ros2-support"] {
        assert!(said.contains(&format!("{library}: {} messages equal", lines.len())), "{said}");
    }
}

#[test]
fn a_sliced_bag_holds_what_was_requested() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    make(&path("a"), 2);
    succeed(
        dermis()
            .args([
                "bag",
                "slice",
                "--topics",
                "taxels",
                "--from",
                "0.5",
                "--to",
                "1.5",
                "--split-time",
                "250ms",
            ])
            .arg(path("a"))
            .arg("--out")
            .arg(path("b")),
    );
    let reader = BagReader::open(path("b")).unwrap();
    assert_eq!((reader.info().messages, reader.info().files, reader.topics().len()), (200, 4, 1));
    assert_eq!(reader.span().unwrap().0, START + 500_000_000);
    succeed(dermis().args(["bag", "check"]).arg(path("b")));
}

/// What the program of before said of its bag, this one says too: of the bag itself, and of the same one in today's definitions.
#[test]
fn a_bag_of_before_is_evaluated_played_and_converted() {
    let dir = tempfile::tempdir().unwrap();
    let old = root().join("crates/bag/tests/v0/before");
    let new = dir.path().join("new");
    let report = succeed(dermis().args(["bag", "convert", "--json"]).arg(&old).arg(&new));
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!((&report["messages"], &report["complete"]), (&259.into(), &true.into()), "{report}");
    succeed(dermis().args(["bag", "check"]).arg(&old));
    succeed(dermis().args(["bag", "check"]).arg(&new));

    let expected = std::fs::read_to_string(root().join("crates/bag/tests/v0/evaluate.json")).unwrap();
    let expected: serde_json::Value = serde_json::from_str(&expected).unwrap();
    for bag in [&old, &new] {
        let evaluate =
            ["evaluate", "--json", "--skin", "launch/skins/baro-line.toml", "--model", "models/baro-line"];
        let said = succeed(dermis().args(evaluate).arg(bag).current_dir(root()));
        let said: serde_json::Value = serde_json::from_str(&said).unwrap();
        for key in ["frames", "missed", "false_contacts", "tares"] {
            assert_eq!(said[key], expected[key], "{key} of {}", bag.display());
        }
        let figures = expected["figures"].as_object().unwrap();
        assert!(figures.len() > 20);
        for (key, value) in figures {
            let (said, value) = (said["figures"][key].as_f64().unwrap(), value.as_f64().unwrap());
            assert!((said - value).abs() <= 1e-3 * value.abs() + 1e-9, "{key}: {said} and {value}");
        }
    }

    // Who plays it sends what is understood today.
    let node = Node::open(NodeOptions::new("listener").domain_id(domain()).localhost_only(true), &backend())
        .unwrap();
    let (sender, frames) = channel();
    let _frames = node
        .subscribe::<TaxelFrame>("/taxels", Qos::reliable(100), move |frame, _| {
            let _ = sender.send(frame);
        })
        .unwrap();
    let _player = Peer::start(dermis().args(["play", "--loop"]).arg(&old));
    let frame = frames.recv_timeout(SOON).unwrap();
    assert_eq!((frame.skin.as_str(), frame.values.len()), ("baro-line", 6));
    let skin = dermis_skin::SkinDescription::load(root().join("launch/skins/baro-line.toml")).unwrap();
    assert_eq!(frame.layout_id, skin.layout_id());
}
