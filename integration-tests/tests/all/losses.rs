//! What a recorder misses, and that it says so: stopped processes, topics that nobody publishes, crashes, full disks.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dermis_bag::{BagReader, RecordedLosses};
use dermis_integration_tests::{Peer, backend, domain, program};
use dermis_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use dermis_msgs::msg::TaxelFrame;
use dermis_msgs::sensor_msgs::msg::CompressedImage;
use dermis_msgs::std_msgs::msg::Int32;
use dermis_node::{Node, NodeOptions, Publisher, Qos};

const SOON: Duration = Duration::from_secs(60);

fn dermis() -> Command {
    let mut command = Command::new(program("dermis"));
    command.env("ROS_DOMAIN_ID", domain().to_string()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    command
}

fn run(command: &mut Command) -> Output {
    command.stdin(Stdio::null()).output().unwrap_or_else(|e| panic!("{command:?} does not start: {e}"))
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn succeed(command: &mut Command) -> String {
    let output = run(command);
    assert!(output.status.success(), "{command:?}\n{}\n{}", text(&output.stdout), text(&output.stderr));
    text(&output.stdout)
}

fn until<T>(what: &str, mut test: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + SOON;
    loop {
        if let Some(found) = test() {
            return found;
        }
        assert!(Instant::now() < deadline, "not within {SOON:?}: {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn node() -> Node {
    let options = NodeOptions::new("source").domain_id(domain()).localhost_only(true);
    Node::open(options, &backend()).unwrap()
}

/// The numbers of the frames that a bag holds by now.
fn frames(bag: &Path) -> Vec<u64> {
    let Ok(reader) = BagReader::recover(bag) else { return Vec::new() };
    let Ok(frames) = reader.read::<TaxelFrame>("/load/taxels") else { return Vec::new() };
    frames.map_while(Result::ok).map(|frame| frame.message.sequence).collect()
}

/// Publishes large frames, numbered from 0 on.
struct Source {
    publisher: Publisher<TaxelFrame>,
    frame: TaxelFrame,
}

impl Source {
    fn new(node: &Node) -> Self {
        let publisher = node.publisher("/load/taxels", Qos::sensor_data()).unwrap();
        let frame = TaxelFrame { skin: "pad".into(), values: vec![1.5; 4096], ..TaxelFrame::default() };
        Self { publisher, frame }
    }

    /// Publishes the next one; returns how many have been published.
    fn publish(&mut self) -> u64 {
        self.publisher.publish(&self.frame).unwrap();
        self.frame.sequence += 1;
        self.frame.sequence
    }

    /// Publishes at 1 kHz until so many were.
    fn stream(&mut self, count: u64) {
        let began = Instant::now();
        for index in 0..count {
            self.publish();
            let due = began + Duration::from_millis(index + 1);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
    }

    /// Publishes one after the other until the bag holds the newest: nothing is on its way any more.
    fn settle(&mut self, bag: &Path) -> u64 {
        until("the newest is recorded", || {
            let newest = self.publish() - 1;
            let deadline = Instant::now() + Duration::from_secs(3);
            while Instant::now() < deadline {
                if frames(bag).last() == Some(&newest) {
                    return Some(newest);
                }
                std::thread::sleep(Duration::from_millis(50));
            }
            None
        })
    }
}

/// The recorder's own diagnostics, as they come.
fn diagnostics(node: &Node) -> (dermis_node::Subscription, Arc<Mutex<Option<DiagnosticStatus>>>) {
    let last: Arc<Mutex<Option<DiagnosticStatus>>> = Arc::default();
    let kept = Arc::clone(&last);
    let subscription = node
        .subscribe("/diagnostics", Qos::reliable(100), move |array: DiagnosticArray, _| {
            let own = array.status.into_iter().find(|status| status.name.ends_with(": recorder"));
            if let Some(status) = own {
                *kept.lock().unwrap() = Some(status);
            }
        })
        .unwrap();
    (subscription, last)
}

/// A recorder that was stopped for a while under 1 kHz tells exactly what it missed: at its end, in the bag, in a check, and
/// in its diagnostics while it goes on.
#[test]
fn what_a_stopped_recorder_missed_is_counted_exactly() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let node = node();
    let mut source = Source::new(&node);
    let (_subscription, status) = diagnostics(&node);
    let mut recorder = Peer::start(
        dermis()
            .args(["record", "/load/taxels", "--json", "--compression", "none", "--buffer", "1MiB", "--out"])
            .arg(&bag)
            .stderr(File::create(dir.path().join("said")).unwrap()),
    );
    // What is published before somebody listens is not lost.
    until("recording goes on", || {
        source.stream(50);
        (frames(&bag).len() > 200).then_some(())
    });
    source.settle(&bag);
    recorder.signal("STOP");
    // 40 MB: more than sockets and queues hold.
    source.stream(2500);
    recorder.signal("CONT");
    source.stream(200);
    let newest = source.settle(&bag);
    let recorded = frames(&bag);
    let missed = newest + 1 - recorded[0] - recorded.len() as u64;
    assert!(missed > 100, "{missed} frames were missed: the test tests nothing");
    let counted = |key: &str| {
        let status = status.lock().unwrap();
        let value = status.as_ref()?.values.iter().find(|value| value.key == key)?;
        value.value.parse::<u64>().ok()
    };
    until("diagnostics tell it", || {
        (counted("lost on the way")? + counted("dropped")? == missed).then_some(())
    });

    recorder.interrupt();
    let line = recorder.expect("{", SOON);
    assert!(recorder.end(SOON).success(), "a bag that lacks something is complete all the same");
    let said: serde_json::Value = serde_json::from_str(&line).unwrap();
    let count = |name: &str| said[name].as_u64().unwrap();
    assert_eq!(
        (count("messages"), count("lost") + count("dropped")),
        (recorded.len() as u64, missed),
        "{line}"
    );
    assert!(count("lost") > 0, "{line}");
    assert_eq!(said["topics"][0]["missing_frames"], missed, "{line}");
    let errors = std::fs::read_to_string(dir.path().join("said")).unwrap();
    let sentence = format!(
        "/load/taxels: {} of {} messages were lost on the way",
        count("lost"),
        newest + 1 - recorded[0]
    );
    assert!(errors.contains(&sentence), "{errors}");

    let reader = BagReader::open(&bag).unwrap();
    assert_eq!(RecordedLosses::of(reader.custom()).unwrap().messages(), missed);
    let clause = format!("{missed} messages were lost while recording: /load/taxels {missed}");
    assert!(succeed(dermis().args(["bag", "info"]).arg(&bag)).contains(&clause));
    let check = succeed(dermis().args(["bag", "check"]).arg(&bag));
    assert!(
        check.contains(&format!("sound, but {clause}; taxel frames are missing: /load/taxels {missed} in ")),
        "{check}"
    );
    let strict = run(dermis().args(["bag", "check", "--complete"]).arg(&bag));
    assert_eq!(strict.status.code(), Some(3), "{}", text(&strict.stderr));
    assert!(
        text(&strict.stderr).starts_with("dermis: the recording is not complete: "),
        "{}",
        text(&strict.stderr)
    );
}

/// A camera of 40 pictures a second as a node publishes them: none is lost between node and bag, although the node waits for nobody.
#[test]
fn pictures_of_a_camera_are_recorded_whole() {
    const PICTURES: u32 = 200;
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let node = node();
    let publisher = node.stream_publisher::<CompressedImage>("/thumb/image/compressed", 2).unwrap();
    let mut recorder = Peer::start(
        dermis()
            .args(["record", "/thumb/image/compressed", "--json", "--compression", "none", "--out"])
            .arg(&bag),
    );
    // The graph shows a subscriber before the way to it is open: what is published in between reaches nobody.
    until("the recorder hears it", || {
        publisher.publish(&CompressedImage::default()).unwrap();
        let reader = BagReader::recover(&bag).ok()?;
        reader.read::<CompressedImage>("/thumb/image/compressed").ok()?.next()?.ok()
    });
    // As large as those of the thumb, and as little alike.
    let mut noise = 1_u32;
    let mut message =
        CompressedImage { format: "jpeg".into(), data: vec![0; 270_000], ..CompressedImage::default() };
    let began = Instant::now();
    for index in 0..PICTURES {
        message.header.stamp.nanosec = index;
        for bytes in message.data.as_chunks_mut::<4>().0 {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *bytes = noise.to_le_bytes();
        }
        publisher.publish(&message).unwrap();
        let due = began + Duration::from_millis(25) * (index + 1);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    recorder.interrupt();
    let line = recorder.expect("{", SOON);
    assert!(recorder.end(SOON).success(), "{line}");
    let reader = BagReader::open(&bag).unwrap();
    let recorded: Vec<u32> = reader
        .read::<CompressedImage>("/thumb/image/compressed")
        .unwrap()
        .map(|message| message.unwrap().message)
        .filter(|image| !image.data.is_empty())
        .inspect(|image| assert_eq!(image.data.len(), 270_000))
        .map(|image| image.header.stamp.nanosec)
        .collect();
    assert_eq!(recorded, (0..PICTURES).collect::<Vec<_>>(), "{line}");
}

/// A publisher that is started again, and what is latched for late joiners, are no losses.
#[test]
fn a_publisher_that_comes_back_and_history_are_no_losses() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let node = node();
    let latched = node.publisher::<Int32>("/latched", Qos::latched().with_depth(3)).unwrap();
    for data in 0..10 {
        latched.publish(&Int32 { data }).unwrap();
    }
    let mut recorder = Peer::start(
        dermis().args(["record", "/latched", "/numbers", "--complete", "--json", "--out"]).arg(&bag),
    );
    let so_far = |topic: &str| {
        let reader = BagReader::recover(&bag).ok()?;
        let numbers = reader.read::<Int32>(topic).ok()?;
        Some(numbers.map_while(Result::ok).map(|message| message.message.data).collect::<Vec<_>>())
    };
    until("the history is recorded", || (so_far("/latched")? == [7, 8, 9]).then_some(()));
    for life in 1..=3 {
        let publisher = node.publisher::<Int32>("/numbers", Qos::reliable(1000)).unwrap();
        // Each life begins with a number that only it has, and counts from 0 on the wire.
        until("the recorder hears this life", || {
            publisher.publish(&Int32 { data: life }).unwrap();
            so_far("/numbers")?.contains(&life).then_some(())
        });
    }
    latched.publish(&Int32 { data: 10 }).unwrap();
    until("the last is recorded", || (so_far("/latched")?.last() == Some(&10)).then_some(()));
    recorder.interrupt();
    let line = recorder.expect("{", SOON);
    assert!(recorder.end(SOON).success(), "--complete: nothing is missing");
    let said: serde_json::Value = serde_json::from_str(&line).unwrap();
    assert_eq!((&said["lost"], &said["dropped"]), (&0.into(), &0.into()), "{line}");
    succeed(dermis().args(["bag", "check", "--complete"]).arg(&bag));
}

/// Who asks for a topic by name hears that nobody publishes it, when somebody does, and at the end that nothing came.
#[test]
fn a_topic_that_nobody_publishes_is_said_and_fails() {
    let dir = tempfile::tempdir().unwrap();
    let (bag, said) = (dir.path().join("run"), dir.path().join("said"));
    let node = node();
    let _mute = node.publisher::<Int32>("/mute", Qos::reliable(10)).unwrap();
    let mut recorder = Peer::start(
        dermis()
            .args(["record", "/late", "/mute", "/nobody", "--json", "--out"])
            .arg(&bag)
            .stderr(File::create(&said).unwrap()),
    );
    let lines = || std::fs::read_to_string(&said).unwrap();
    until("it says what is missing", || {
        ["/late", "/nobody"]
            .iter()
            .all(|topic| {
                lines().contains(&format!("nobody publishes {topic} yet: it is recorded once somebody does"))
            })
            .then_some(())
    });
    let late = node.publisher::<Int32>("/late", Qos::reliable(10)).unwrap();
    until("it says that one is there", || lines().contains("/late is published now").then_some(()));
    until("it is recorded", || {
        late.publish(&Int32 { data: 1 }).unwrap();
        BagReader::recover(&bag).is_ok_and(|reader| reader.info().messages > 0).then_some(())
    });
    recorder.interrupt();
    let line = recorder.expect("{", SOON);
    assert_eq!(recorder.end(SOON).code(), Some(1));
    let last = "dermis: nothing was recorded of what was requested by name: /mute (it was published, but no message came), /nobody (nobody published it)";
    assert!(lines().lines().any(|line| line == last), "{}", lines());
    let report: serde_json::Value = serde_json::from_str(&line).unwrap();
    assert_eq!(report["silent"]["/nobody"], "nobody published it");
    // What came is a whole bag.
    succeed(dermis().args(["bag", "check"]).arg(&bag));
}

/// A launch, and what it logs.
struct Launch {
    peer: Peer,
    dir: PathBuf,
}

impl Launch {
    /// A recorder that is started again where it fails.
    fn start(dir: &Path, out: &Path) -> Self {
        let file = dir.join("record.launch.yaml");
        let arguments = "record /load/taxels --compression none --resume --out";
        std::fs::write(
            &file,
            format!(
                "processes:\n  - name: recorder\n    dermis: {arguments} {}\n    restart: on-failure\n    backoff: {{first: 0.05}}\n",
                out.display()
            ),
        )
        .unwrap();
        let peer = Peer::start(
            dermis()
                .args(["launch", "--log-format", "json"])
                .arg(file)
                .current_dir(dir)
                .stderr(Stdio::null()),
        );
        Self { peer, dir: dir.to_path_buf() }
    }

    /// The message of the next line of the log with this text.
    fn wait_for(&mut self, wanted: &str) -> String {
        let deadline = Instant::now() + SOON;
        loop {
            let line = self.peer.expect("{", deadline.saturating_duration_since(Instant::now()));
            let record: serde_json::Value = serde_json::from_str(&line).unwrap();
            let message = record["message"].as_str().unwrap();
            if message.contains(wanted) {
                return message.to_owned();
            }
        }
    }
}

/// A recorder that is killed is started again by the launch and goes on in a new bag; both parts can be used.
#[test]
fn a_killed_recorder_goes_on_under_launch() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let node = node();
    let mut source = Source::new(&node);
    let mut launch = Launch::start(dir.path(), &path("run"));
    let mut process = 0;
    for part in ["run", "run-2", "run-3"] {
        if process != 0 {
            let killed = Command::new("kill").args(["-KILL", &process.to_string()]).status().unwrap();
            assert!(killed.success());
        }
        let started = launch.wait_for("recorder started, process ");
        process = started.rsplit(' ').next().unwrap().parse().unwrap();
        until("this part is recorded", || {
            source.stream(20);
            (frames(&path(part)).len() > 50).then_some(())
        });
    }
    launch.peer.interrupt();
    assert!(launch.peer.end(SOON).success());
    assert!(launch.dir.join("run-3").join("metadata.yaml").exists());
    for (part, before) in [("run", None), ("run-2", Some("run")), ("run-3", Some("run-2"))] {
        if part != "run-3" {
            let check = run(dermis().args(["bag", "check"]).arg(path(part)));
            assert!(text(&check.stdout).contains("metadata.yaml: is missing"), "{}", text(&check.stdout));
            succeed(dermis().args(["bag", "check", "--repair"]).arg(path(part)));
        }
        succeed(dermis().args(["bag", "check"]).arg(path(part)));
        let numbers = frames(&path(part));
        assert!(numbers.is_sorted() && numbers.len() > 50, "{part}: {} frames", numbers.len());
        // What a part that was killed went on from is in the log only.
        if part == "run-3" {
            let reader = BagReader::open(path(part)).unwrap();
            assert_eq!(reader.custom().get("goes on from").map(String::as_str), before);
            assert!(reader.custom().contains_key("not recorded before (s)"));
        }
    }
}

/// A file system in memory of so many KiB; nothing where only root may mount one.
struct Disk(tempfile::TempDir);

impl Disk {
    fn mount(kib: u64) -> Option<Self> {
        let dir = tempfile::tempdir().unwrap();
        let mount = ["-t", "tmpfs", "-o", &format!("size={kib}k"), "tmpfs"];
        if Command::new("mount").args(mount).arg(dir.path()).output().is_ok_and(|out| out.status.success()) {
            return Some(Self(dir));
        }
        eprintln!("skipped: a file system of one's own cannot be mounted here");
        None
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.0.path()).status();
    }
}

/// On a full disk a recorder waits, says so, and goes on by itself in a new file once there is room.
#[test]
fn a_full_disk_is_waited_for() {
    let Some(disk) = Disk::mount(16 * 1024) else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = disk.0.path().join("run");
    let filler = disk.0.path().join("filler");
    let node = node();
    let mut source = Source::new(&node);
    let mut launch = Launch::start(dir.path(), &bag);
    launch.wait_for("recorder started, process ");
    until("recording goes on", || {
        source.stream(20);
        (frames(&bag).len() > 50).then_some(())
    });
    source.settle(&bag);
    let block = vec![0; 4096];
    let mut file = File::create(&filler).unwrap();
    while std::io::Write::write_all(&mut file, &block).is_ok() {}
    drop(file);
    // Some more, which waits in memory.
    source.stream(100);
    launch.wait_for("the disk is full: recording waits for room");
    std::fs::remove_file(&filler).unwrap();
    launch.wait_for("there is room again");
    source.settle(&bag);
    launch.peer.interrupt();
    assert!(launch.peer.end(SOON).success());
    // A bag that is still written to cannot be read in the moment in which one of its files takes the place of another.
    let recorded = frames(&bag);
    let reader = BagReader::open(&bag).unwrap();
    assert!(reader.info().files >= 2, "{}", reader.info());
    let losses = RecordedLosses::of(reader.custom()).unwrap().messages();
    let (first, last) = (recorded[0], recorded[recorded.len() - 1]);
    assert_eq!(losses, last + 1 - first - recorded.len() as u64, "{}", reader.info());
    succeed(dermis().args(["bag", "check"]).arg(&bag));
}
