//! What goes wrong with a skin in the field, across processes: the device is behind a pseudo-terminal, the node is the
//! program, and its diagnostics, contacts and log are what an operator has. Each fault says so in one sentence, and the node
//! lives on.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use dermis_integration_tests::{Peer, backend, domain, program, root};
use dermis_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use dermis_msgs::msg::{ContactArray, TaxelFrame};
use dermis_msgs::rosgraph_msgs::msg::Clock;
use dermis_node::{Node, NodeOptions, Qos, Subscription};
use dermis_skin::SkinDescription;
use dermis_transport::Pty;
use dermis_transport::framing::{NativeEncoder, NativeFormat};

const SOON: Duration = Duration::from_secs(40);
const CHANNELS: usize = 25;

fn skin() -> PathBuf {
    root().join("launch/skins/baro-grid.toml")
}

fn model() -> PathBuf {
    root().join("models/baro-grid")
}

/// Noise of 20 Pa as a barometer has it: from -1 to 1, three times summed.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f32 {
        let mut uniform = || {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 40) as f32 / (1_u32 << 23) as f32 - 1.0
        };
        20.0 * (uniform() + uniform() + uniform())
    }

    fn frame(&mut self) -> [f32; CHANNELS] {
        std::array::from_fn(|_| self.next())
    }
}

/// What a device sends every period; it is given the number of the frame.
type Habit = Box<dyn FnMut(u32) -> Vec<u8> + Send>;

/// A device on a pseudo-terminal; dropping it unplugs it.
struct Device {
    habit: Arc<Mutex<Habit>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Device {
    fn plug(link: &Path, habit: Habit) -> Self {
        Self::plug_with(link, habit, Duration::from_millis(10))
    }

    fn plug_with(link: &Path, habit: Habit, period: Duration) -> Self {
        let mut pty = Pty::open().unwrap();
        pty.link(link).unwrap();
        let habit = Arc::new(Mutex::new(habit));
        let stop = Arc::new(AtomicBool::new(false));
        let (sends, ends) = (Arc::clone(&habit), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            let begun = Instant::now();
            for k in 0_u32.. {
                if ends.load(Ordering::Acquire) {
                    return;
                }
                let bytes = (sends.lock().unwrap())(k);
                // What nobody reads is lost, as on a wire.
                let _ = pty.write_lossy(&bytes);
                let next = begun + period * (k + 1);
                std::thread::sleep(next.saturating_duration_since(Instant::now()));
            }
        });
        Self { habit, stop, thread: Some(thread) }
    }

    fn becomes(&self, habit: Habit) {
        *self.habit.lock().unwrap() = habit;
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Frames with noise on every channel, changed by `change`.
fn frames(mut change: impl FnMut(u32, &mut [f32; CHANNELS]) + Send + 'static) -> Habit {
    let mut noise = Noise(1);
    let mut encoder = NativeEncoder::new(NativeFormat::F32);
    Box::new(move |k| {
        let mut values = noise.frame();
        change(k, &mut values);
        encoder.encode(k, 1_000 + u64::from(k) * 10_000, &values).unwrap().to_vec()
    })
}

fn healthy() -> Habit {
    frames(|_, _| ())
}

/// The program, its log, and a node that hears what an operator hears.
struct Bench {
    folder: tempfile::TempDir,
    node: Node,
    _subscriptions: Vec<Subscription>,
    contacts: Receiver<ContactArray>,
    diagnostics: Receiver<DiagnosticStatus>,
}

impl Bench {
    fn new() -> Self {
        let node =
            Node::open(NodeOptions::new("operator").domain_id(domain()).localhost_only(true), &backend())
                .unwrap();
        let (send, contacts) = channel();
        let (say, diagnostics) = channel();
        let subscriptions = vec![
            node.subscribe::<ContactArray>("contacts", Qos::sensor_data(), move |array, _| {
                let _ = send.send(array);
            })
            .unwrap(),
            node.subscribe::<DiagnosticArray>("/diagnostics", Qos::reliable(10), move |array, _| {
                for status in array.status {
                    let _ = say.send(status);
                }
            })
            .unwrap(),
        ];
        Self {
            folder: tempfile::tempdir().unwrap(),
            node,
            _subscriptions: subscriptions,
            contacts,
            diagnostics,
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn tty(&self) -> PathBuf {
        self.path("tty")
    }

    /// Starts the node; its log goes to the file of this name.
    fn start(&self, log: &str, arguments: &[&str]) -> Peer {
        let mut command = Command::new(program("dermis"));
        command.current_dir(root()).args(["barodome", "--source"]);
        command.arg(format!("serial://{}?baud=921600", self.tty().display()));
        if !arguments.contains(&"--skin") {
            command.arg("--skin").arg(skin());
        }
        Peer::start(command.args(arguments).stderr(File::create(self.path(log)).unwrap()))
    }

    fn with_model(&self) -> Peer {
        self.start("log", &["--model", &model().display().to_string()])
    }

    fn log(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    /// The next diagnostics of the skin that `fits`.
    fn skin_says(&self, what: &str, fits: impl Fn(&DiagnosticStatus) -> bool) -> DiagnosticStatus {
        let deadline = Instant::now() + SOON;
        let mut last = None;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.diagnostics.recv_timeout(left) {
                Ok(status) if status.name.ends_with(": skin") && fits(&status) => return status,
                Ok(status) => last = Some(status),
                Err(_) => {
                    panic!("the skin never said {what}; its last words: {last:#?}\n{}", self.log("log"))
                }
            }
        }
    }

    fn contacts_say(&self, what: &str, fits: impl Fn(&ContactArray) -> bool) -> ContactArray {
        let deadline = Instant::now() + SOON;
        let mut last = None;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.contacts.recv_timeout(left) {
                Ok(array) if fits(&array) => return array,
                Ok(array) => last = Some(array),
                Err(_) => panic!("contacts never were {what}; the last: {last:#?}\n{}", self.log("log")),
            }
        }
    }

    fn recovers(&self) {
        self.contacts_say("known again", |a| a.status == ContactArray::STATUS_OK);
        self.skin_says("that all is well", |s| s.level == DiagnosticStatus::OK);
    }

    /// The log holds the sentence, once; a panic it never holds.
    fn logged_once(&self, name: &str, sentence: &str) {
        let deadline = Instant::now() + SOON;
        while !self.log(name).contains(sentence) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(50));
        }
        let log = self.log(name);
        assert_eq!(log.matches(sentence).count(), 1, "`{sentence}` in:\n{log}");
        assert!(!log.contains("panicked"), "{log}");
    }

    /// Nothing decodes: contacts are a fault, diagnostics an error, and the log says it once, all with this sentence.
    fn is_foreign(&self, sentence: &str) {
        let array = self.contacts_say("a fault", |a| a.status == ContactArray::STATUS_FAULT);
        assert!(array.status_text.contains(sentence), "{}", array.status_text);
        assert!(array.contacts.is_empty());
        let status = self.skin_says("an error", |s| s.level == DiagnosticStatus::ERROR);
        assert!(status.message.contains(sentence), "{}", status.message);
        self.logged_once("log", sentence);
    }
}

fn value<'a>(status: &'a DiagnosticStatus, key: &str) -> &'a str {
    status.values.iter().find(|v| v.key == key).map_or("", |v| v.value.as_str())
}

#[test]
fn a_wrong_baud_rate_is_named_and_forgotten_when_it_is_right() {
    let bench = Bench::new();
    let mut random = Noise(5);
    // What another rate makes of a signal: bytes of any kind.
    let device = Device::plug(
        &bench.tty(),
        Box::new(move |_| {
            (0..100)
                .map(|_| {
                    random.next();
                    (random.0 >> 33) as u8
                })
                .collect()
        }),
    );
    let _node = bench.with_model();
    bench.is_foreign("wrong baud rate (921600 set)");
    device.becomes(healthy());
    bench.recovers();
}

#[test]
fn a_skin_of_another_size_is_named() {
    let bench = Bench::new();
    let mut encoder = NativeEncoder::new(NativeFormat::U16);
    let _device =
        Device::plug(&bench.tty(), Box::new(move |k| encoder.encode(k, 1, &[7.0; 64]).unwrap().to_vec()));
    let _node = bench.with_model();
    bench.is_foreign("the device sends 64 channels, and the skin description has 25");
}

#[test]
fn a_receiver_of_satellites_is_no_skin() {
    let bench = Bench::new();
    let nmea = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n";
    let _device = Device::plug(&bench.tty(), Box::new(move |_| nmea.to_vec()));
    let _node = bench.with_model();
    bench.is_foreign("the device sends text, not our binary wire");
}

#[test]
fn text_that_is_no_readings_is_named_where_lines_are_expected() {
    let bench = Bench::new();
    let lines = bench.path("lines.toml");
    let text = std::fs::read_to_string(skin()).unwrap();
    std::fs::write(&lines, text.replace("surface = {", "wire = { protocol = \"ascii\" }\nsurface = {"))
        .unwrap();
    let device = Device::plug(&bench.tty(), Box::new(|_| b"[INFO] boot: heap 12345 ok\r\n".repeat(4)));
    let _node = bench.start("log", &["--skin", &lines.display().to_string()]);
    bench.is_foreign("the device sends text that is not lines of numbers");
    // A logger of accelerations.
    device.becomes(Box::new(|_| b"0.01,0.02,9.81\r\n".repeat(4)));
    let array = bench.contacts_say("refused", |a| a.status_text.contains("3 values on a line"));
    assert_eq!(array.status, ContactArray::STATUS_FAULT, "{}", array.status_text);
}

#[test]
fn a_model_that_cannot_be_used_is_named_and_readings_go_on() {
    let bench = Bench::new();
    let _device = Device::plug(&bench.tty(), healthy());
    let [cut, other, missing] = ["cut", "other", "missing"].map(|n| bench.path(n));
    for folder in [&cut, &other] {
        std::fs::create_dir(folder).unwrap();
        for file in ["bundle.toml", "card.json", "model.onnx"] {
            std::fs::copy(model().join(file), folder.join(file)).unwrap();
        }
    }
    let graph = std::fs::read(cut.join("model.onnx")).unwrap();
    std::fs::write(cut.join("model.onnx"), &graph[..graph.len() / 2]).unwrap();
    // The bundle of a skin with the same channels that are placed elsewhere.
    let text = std::fs::read_to_string(other.join("bundle.toml")).unwrap();
    let hash =
        text.lines().find_map(|line| line.strip_prefix("hash = ")).unwrap().trim_matches('"').to_owned();
    let described = SkinDescription::load(skin()).unwrap();
    assert!(described.is_type(&hash, &described.name), "the bundle is that of this skin");
    std::fs::write(other.join("bundle.toml"), text.replace(&hash, &format!("sha256:{}", "0".repeat(64))))
        .unwrap();

    for (folder, sentence) in [(&missing, "missing"), (&cut, "bytes"), (&other, "skin")] {
        let folder = folder.display().to_string();
        let node = bench.start("log", &["--model", &folder]);
        let array = bench.contacts_say("without a model", |a| {
            a.status == ContactArray::STATUS_UNCALIBRATED && a.status_text.contains(&folder)
        });
        assert!(array.status_text.contains(sentence), "{}", array.status_text);
        let status = bench.skin_says("that it has no model", |s| s.message.contains(&folder));
        assert_eq!(status.level, DiagnosticStatus::WARN, "{}", status.message);
        assert_eq!(value(&status, "models"), "none");
        bench.logged_once("log", &folder);
        drop(node);
        // Who cannot do without ends with the same sentence.
        let mut strict = bench.start("strict", &["--strict", "--model", &folder]);
        assert!(!strict.end(SOON).success());
        bench.logged_once("strict", &folder);
    }
}

#[test]
fn channels_without_a_value_and_channels_that_stand_still_are_named() {
    let bench = Bench::new();
    let mode = Arc::new(AtomicU8::new(0));
    let now = Arc::clone(&mode);
    let _device = Device::plug(
        &bench.tty(),
        frames(move |_, values| match now.load(Ordering::Acquire) {
            0 => {}
            1 => (values[3], values[7]) = (f32::NAN, f32::INFINITY),
            2 => values[12] = 17.0,
            _ => *values = [f32::NAN; CHANNELS],
        }),
    );
    let _node = bench.with_model();
    bench.recovers();

    mode.store(1, Ordering::Release);
    let status = bench.skin_says("which are not finite", |s| value(s, "not finite channels") == "b03, b07");
    assert_eq!(status.level, DiagnosticStatus::WARN);
    assert!(status.message.contains("2 of 25 channels are impaired: b03"), "{}", status.message);
    let array = bench.contacts_say("impaired", |a| a.status_text.contains("b07"));
    assert!(array.contacts.iter().all(|c| c.position.x.is_finite() && c.force.z.is_finite()));

    mode.store(2, Ordering::Release);
    let status = bench.skin_says("which stands still", |s| value(s, "stuck channels") == "b12");
    assert_eq!(status.level, DiagnosticStatus::WARN);
    assert!(status.message.contains("1 of 25 channels are impaired: b12"), "{}", status.message);

    mode.store(3, Ordering::Release);
    let array = bench.contacts_say("a fault", |a| a.status == ContactArray::STATUS_FAULT);
    assert!(array.status_text.contains("25 of 25 channels are unusable"), "{}", array.status_text);
    assert!(array.contacts.is_empty());
    bench.skin_says("a fault", |s| {
        s.level == DiagnosticStatus::ERROR && s.message.contains("check the sensor")
    });

    mode.store(0, Ordering::Release);
    bench.recovers();
    assert!(!bench.log("log").contains("panicked"));
}

#[test]
fn a_device_that_falls_silent_or_is_unplugged_comes_back() {
    let bench = Bench::new();
    let device = Device::plug(&bench.tty(), healthy());
    let _node = bench.with_model();
    bench.recovers();
    // Silent: the line is there.
    device.becomes(Box::new(|_| Vec::new()));
    let array = bench.contacts_say("stale", |a| a.status == ContactArray::STATUS_STALE);
    assert!(
        array.status_text.contains("is connected and silent; check that the device is on"),
        "{}",
        array.status_text
    );
    bench.skin_says("that it is stale", |s| s.level == DiagnosticStatus::STALE);
    device.becomes(healthy());
    bench.recovers();
    // Unplugged.
    drop(device);
    bench.contacts_say("stale", |a| {
        a.status == ContactArray::STATUS_STALE && !a.status_text.contains("silent")
    });
    let _device = Device::plug(&bench.tty(), healthy());
    bench.recovers();
    let status = bench.skin_says("how often it connected", |s| value(s, "reconnects") != "0");
    assert_ne!(value(&status, "disconnects"), "0");
    assert!(!bench.log("log").contains("panicked"));
}

#[test]
fn two_nodes_of_one_name_are_reported_once() {
    let bench = Bench::new();
    let _device = Device::plug(&bench.tty(), healthy());
    let _first = bench.with_model();
    bench.recovers();
    let _second = bench.start("second", &[]);
    let sentence = "2 nodes are named /baro_grid";
    let deadline = Instant::now() + SOON;
    loop {
        let status =
            bench.diagnostics.recv_timeout(deadline.saturating_duration_since(Instant::now())).unwrap();
        if status.message.contains(sentence) {
            assert_eq!(status.level, DiagnosticStatus::WARN);
            break;
        }
    }
    bench.logged_once("second", sentence);
    bench.logged_once("log", sentence);
}

#[test]
fn a_clock_that_jumps_is_warned_of_and_followed() {
    let bench = Bench::new();
    let offset = Arc::new(Mutex::new((0_u32, 0_i64)));
    let now = Arc::clone(&offset);
    let mut noise = Noise(1);
    let mut encoder = NativeEncoder::new(NativeFormat::F32);
    let _device = Device::plug(
        &bench.tty(),
        Box::new(move |k| {
            let (first, shift) = *now.lock().unwrap();
            if first == u32::MAX {
                // The device starts again: sequence and time from the beginning.
                *now.lock().unwrap() = (k, -10_000 * i64::from(k));
            }
            let (first, shift) = if first == u32::MAX { (k, -10_000 * i64::from(k)) } else { (first, shift) };
            let time = 60_000_000 + i64::from(k) * 10_000 + shift;
            encoder.encode(k - first, time.unsigned_abs(), &noise.frame()).unwrap().to_vec()
        }),
    );
    let _node = bench.with_model();
    bench.recovers();
    let mut jumps = 0;
    for change in [(0, 3_600_000_000), (0, -30_000_000), (u32::MAX, 0)] {
        *offset.lock().unwrap() = change;
        let status = bench.skin_says("that a clock jumped", |s| {
            value(s, "clock jumps").parse::<u64>().is_ok_and(|n| n > jumps)
        });
        jumps = value(&status, "clock jumps").parse().unwrap();
        // Stamps stay those of this machine.
        let array = bench.contacts_say("known", |a| a.status == ContactArray::STATUS_OK);
        let age = bench.node.clock().now() - array.header.stamp.as_nanos();
        assert!((-1_000_000_000..5_000_000_000).contains(&age), "a stamp is {age} ns old");
    }
    let status = bench.skin_says("that the device started again", |s| value(s, "device restarts") != "0");
    assert_eq!(value(&status, "frames lost"), "0", "a restart is no loss");
    // However often: such a device must not fill the disk.
    bench.logged_once("log", "the device started again, or one of the clocks was set");
}

#[test]
fn simulated_time_that_starts_over_is_followed() {
    let bench = Bench::new();
    let _device = Device::plug(&bench.tty(), healthy());
    let config = bench.path("node.toml");
    std::fs::write(
        &config,
        format!(
            "skin = {:?}\nsource = \"pty://{}\"\nmodels = [{:?}]\nuse_sim_time = true\n",
            skin(),
            bench.tty().display(),
            model()
        ),
    )
    .unwrap();
    let clock = bench.node.publisher::<Clock>("/clock", Qos::reliable(1)).unwrap();
    let (ends, ended) = channel::<()>();
    let restart = Arc::new(AtomicBool::new(false));
    let again = Arc::clone(&restart);
    let ticking = std::thread::spawn(move || {
        let mut time = 1_000_000_000_000_i64;
        while ended
            .recv_timeout(Duration::from_millis(5))
            .is_err_and(|e| e == std::sync::mpsc::RecvTimeoutError::Timeout)
        {
            time = if again.swap(false, Ordering::AcqRel) { 5_000_000_000 } else { time + 5_000_000 };
            let clock_time = dermis_msgs::builtin_interfaces::msg::Time::from_nanos(time);
            clock.publish(&Clock { clock: clock_time }).unwrap();
        }
    });
    let mut command = Command::new(program("dermis"));
    command.current_dir(root()).arg("barodome").arg("--config").arg(&config);
    let _node = Peer::start(command.stderr(File::create(bench.path("log")).unwrap()));
    let known = |a: &ContactArray| a.status == ContactArray::STATUS_OK;
    let before = bench.contacts_say("known in simulated time", |a| known(a) && a.header.stamp.sec >= 1000);
    restart.store(true, Ordering::Release);
    let after =
        bench.contacts_say("known again from the beginning", |a| known(a) && a.header.stamp.sec < 900);
    assert!(after.header.stamp.sec < before.header.stamp.sec);
    bench.logged_once("log", "the clock jumped back by");
    drop(ends);
    ticking.join().unwrap();
}

/// What a listener got since the last call: messages, the longest time between two \[s\], and the 99th percentile of their
/// age on arrival \[s\].
#[derive(Debug, Clone, Copy)]
struct Reception {
    rate: f64,
    pause: f64,
    age: f64,
}

#[derive(Default)]
struct Ear {
    ages: Vec<f64>,
    arrived: Option<Instant>,
    pause: Duration,
    since: Option<Instant>,
}

impl Ear {
    fn hear(&mut self, age_ns: i64) {
        let now = Instant::now();
        if let Some(before) = self.arrived.replace(now) {
            self.pause = self.pause.max(now - before);
        }
        self.ages.push(age_ns as f64 * 1e-9);
    }

    fn take(&mut self) -> Reception {
        let now = Instant::now();
        let passed = self.since.replace(now).map_or(f64::INFINITY, |since| (now - since).as_secs_f64());
        let mut ages = std::mem::take(&mut self.ages);
        ages.sort_by(f64::total_cmp);
        let age = ages.get(ages.len() * 99 / 100).copied().unwrap_or(f64::NAN);
        let pause = std::mem::take(&mut self.pause).as_secs_f64();
        Reception { rate: ages.len() as f64 / passed, pause, age }
    }
}

/// The other listener of [`a_listener_that_stops_reading_holds_nobody_up`], a process of its own.
#[test]
#[ignore = "run by another test"]
fn listener() {
    let node = Node::open(NodeOptions::new("listener").localhost_only(true), &backend()).unwrap();
    let (send, frames) = channel();
    let _taxels = node.subscribe::<TaxelFrame>("taxels", Qos::sensor_data(), move |frame, _| {
        let _ = send.send(frame.sequence);
    });
    let _contacts = node.subscribe::<ContactArray>("contacts", Qos::sensor_data(), |_, _| ()).unwrap();
    let mut said = Instant::now();
    for sequence in frames {
        if said.elapsed() >= Duration::from_millis(200) {
            said = Instant::now();
            println!("\nheard {sequence}");
        }
    }
}

/// A process is stopped with full queues for half a minute; it looks to the node like a peer whose machine hangs.
#[test]
#[expect(clippy::too_many_lines, reason = "one story, in its order")]
fn a_listener_that_stops_reading_holds_nobody_up() {
    const STOPPED: Duration = Duration::from_secs(30);
    let bench = Bench::new();
    let fast = bench.path("fast.toml");
    let taxels: String = (0..64)
        .map(|k| format!("[[taxels]]\nname = \"channel-{k}\"\nposition = [0.0{k:02}, 0.0, 0.0]\n"))
        .collect();
    std::fs::write(
        &fast,
        format!(
            "schema = \"dermis-skin/1\"\nname = \"fast\"\nsensor = \"barodome\"\nframe_id = \"pad\"\nunit = \"Pa\"\n\
             rate = 1000.0\nnoise = 20.0\nsurface = {{ type = \"rectangle\", size = [0.2, 0.2], spacing = 0.02 }}\n{taxels}"
        ),
    )
    .unwrap();
    let mut noise = Noise(1);
    let mut encoder = NativeEncoder::new(NativeFormat::F32);
    let _device = Device::plug_with(
        &bench.tty(),
        Box::new(move |k| {
            let values: [f32; 64] = std::array::from_fn(|_| noise.next());
            encoder.encode(k, 1_000 + u64::from(k) * 1_000, &values).unwrap().to_vec()
        }),
        Duration::from_millis(1),
    );
    let ear = Arc::new(Mutex::new(Ear::default()));
    let hears = Arc::clone(&ear);
    let clock = bench.node.clock().clone();
    let _taxels =
        bench.node.subscribe::<TaxelFrame>("taxels", Qos::sensor_data().with_depth(1000), move |frame, _| {
            hears.lock().unwrap().hear(clock.now() - frame.header.stamp.as_nanos());
        });
    let node = bench.start("log", &["--skin", &fast.display().to_string()]);
    let mut other = Peer::start(Command::new(std::env::current_exe().unwrap()).args([
        "--ignored",
        "--exact",
        "faults::listener",
        "--nocapture",
    ]));
    other.expect("heard", SOON);
    // All are there; a while for what starts slowly.
    let settled = Instant::now() + Duration::from_secs(3);
    while Instant::now() < settled {
        other.expect("heard", SOON);
    }
    ear.lock().unwrap().take();
    let watched = Instant::now() + Duration::from_secs(6);
    while Instant::now() < watched {
        other.expect("heard", SOON);
    }
    let before = ear.lock().unwrap().take();

    other.signal("STOP");
    let stopped = Instant::now();
    let mut memory = None;
    let mut during = Vec::new();
    while stopped.elapsed() < STOPPED {
        std::thread::sleep(Duration::from_secs(2));
        during.push(ear.lock().unwrap().take());
        // Until then its queues fill.
        if stopped.elapsed() > STOPPED / 3 {
            memory.get_or_insert_with(|| node.memory());
        }
    }
    let (first, last) = (memory.unwrap(), node.memory());
    other.signal("CONT");
    println!("before {before:?}\nwhile a listener was stopped {during:#?}\nmemory {first} {last} bytes");

    // It hears what is new, not only what was on its way.
    let resumed = Instant::now();
    let newest = bench.skin_says("what it read", |_| true);
    let frames: u64 = value(&newest, "frames").parse().unwrap();
    loop {
        let line = other.expect("heard", SOON);
        if line.trim_start_matches("heard ").parse::<u64>().unwrap() > frames {
            break;
        }
        assert!(resumed.elapsed() < SOON, "the stopped listener never caught up");
    }
    assert!(before.rate > 300.0, "{before:?}: this machine is too slow to tell anything");
    let mean = during.iter().map(|h| h.rate).sum::<f64>() / during.len() as f64;
    assert!(mean > 0.9 * before.rate, "{mean} messages a second, {} before", before.rate);
    // A publisher that blocks does so for seconds; a busy machine pauses for less.
    let pause = during.iter().map(|h| h.pause).fold(0.0, f64::max);
    assert!(pause < 0.5 + 2.0 * before.pause, "a pause of {pause} s, {} s before", before.pause);
    let mut ages: Vec<f64> = during.iter().map(|h| h.age).collect();
    ages.sort_by(f64::total_cmp);
    let age = ages[ages.len() / 2];
    assert!(age < 0.01 + 2.0 * before.age, "messages are {age} s old, {} s before", before.age);
    assert!(last <= first + first / 20, "memory grew from {first} to {last} bytes");
}
