//! What tests across processes share: finding our programs and other people's, and talking to them by lines.
//!
//! `cargo xtask test` sets the variables that are read here; a test whose other side is missing says so and passes.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use dermis_msgs::Message;
use dermis_node::network::SessionOptions;
use dermis_node::{HirozBackend, HirozConfig, Node, NodeOptions, Qos, Subscription};

pub mod hand;
pub mod launch;
pub mod rclpy;

pub use rclpy::Rclpy;

/// The repository.
#[must_use]
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().map_or_else(PathBuf::new, Path::to_owned)
}

/// One of our programs, e.g. `dermis`: in `$DERMIS_BIN`, or beside the folder of the running test.
#[must_use]
pub fn program(name: &str) -> PathBuf {
    if let Some(dir) = std::env::var_os("DERMIS_BIN") {
        return PathBuf::from(dir).join(name);
    }
    let test = std::env::current_exe().unwrap_or_default();
    test.ancestors().nth(2).unwrap_or(Path::new(".")).join(name)
}

/// Python with the clients of others (`$DERMIS_CLIENT_PYTHON`); prints why where there is none.
#[must_use]
pub fn client_python() -> Option<PathBuf> {
    or_skip("DERMIS_CLIENT_PYTHON", "a Python with eclipse-zenoh, rosbags, mcap-ros2-support, onnx")
}

/// Python with rclpy and our messages (`$DERMIS_ROS_PYTHON`); prints why where there is none.
#[must_use]
pub fn ros_python() -> Option<PathBuf> {
    or_skip("DERMIS_ROS_PYTHON", "a Python with rclpy and dermis_msgs")
}

/// A folder of other people's recordings; prints why where it is missing.
#[must_use]
pub fn recordings(name: &str) -> Option<PathBuf> {
    let base = std::env::var_os("DERMIS_DATA").map_or_else(|| root().join("../shared/data"), PathBuf::from);
    let path = base.join(name);
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("skipped: {} is missing (DERMIS_DATA)", path.display());
    None
}

fn or_skip(variable: &str, what: &str) -> Option<PathBuf> {
    let found = std::env::var_os(variable).map(PathBuf::from);
    if found.is_none() {
        eprintln!("skipped: {variable} names no {what}; `cargo xtask test` sets it up");
    }
    found
}

/// What a command printed; it must succeed.
///
/// # Panics
///
/// Where it does not start, or fails: with what it said.
pub fn finish(command: &mut Command) -> String {
    let out = command.output().unwrap_or_else(|e| panic!("{command:?} does not start: {e}"));
    let [stdout, stderr] = [out.stdout, out.stderr].map(|b| String::from_utf8_lossy(&b).into_owned());
    assert!(out.status.success(), "{command:?}\n{stdout}\n{stderr}");
    stdout
}

/// What a command complained of; it must fail.
///
/// # Panics
///
/// Where it does not start, or succeeds.
pub fn refused(command: &mut Command) -> String {
    let out = command.output().unwrap_or_else(|e| panic!("{command:?} does not start: {e}"));
    assert!(!out.status.success(), "{command:?} succeeded");
    String::from_utf8_lossy(&out.stderr).into_owned()
}

/// A text as JSON.
///
/// # Panics
///
/// Where it is none: with the text.
pub fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// A ROS domain that no other running test is in, the same for all of this process.
///
/// # Panics
///
/// Where the folder for temporary files cannot be written to, or all domains are taken.
#[must_use]
pub fn domain() -> u16 {
    // The lock on the file ends with the process, however it ends. Domains above 101 reach into the ports that
    // systems give out themselves.
    static TAKEN: OnceLock<(u16, File)> = OnceLock::new();
    let take = || {
        let dir = std::env::temp_dir().join("dermis-test-domains");
        std::fs::create_dir_all(&dir).unwrap_or_else(|e| panic!("{} cannot be made: {e}", dir.display()));
        let first = std::process::id() % 100;
        for id in (0..100).map(|i| 1 + (first + i) % 100) {
            let path = dir.join(id.to_string());
            let file =
                File::create(&path).unwrap_or_else(|e| panic!("{} cannot be made: {e}", path.display()));
            if file.try_lock().is_ok() {
                return (u16::try_from(id).unwrap_or(1), file);
            }
        }
        panic!("a hundred tests run at once: every lock in {} is taken", dir.display());
    };
    TAKEN.get_or_init(take).0
}

/// The UDP port at which zenoh programs of this test look for each other, and no other test's.
#[must_use]
pub fn scouting_port() -> u16 {
    // Beside the ports of the tests of single crates, and below those that systems give out themselves.
    31_000 + domain()
}

/// Has a program run in this test's ROS domain, on this machine only, where it hears no program of another test: it looks
/// for zenoh peers at [`scouting_port`]. Our programs read that variable as `rmw_zenoh` does; Python's zenoh does not, so that
/// `python/isolated/sitecustomize.py` does it for it.
pub fn isolate(command: &mut Command) {
    let isolated = root().join("integration-tests/python/isolated");
    let python = match std::env::var_os("PYTHONPATH").filter(|path| !path.is_empty()) {
        Some(path) => {
            let mut all = isolated.into_os_string();
            all.push(":");
            all.push(path);
            all
        }
        None => isolated.into_os_string(),
    };
    let mut overrides = format!("scouting/multicast/address=\"224.0.0.224:{}\"", scouting_port());
    let own =
        command.get_envs().find(|(name, _)| *name == "ZENOH_CONFIG_OVERRIDE").and_then(|(_, value)| value);
    if let Some(own) = own.and_then(|value| value.to_str()) {
        overrides += &format!(";{own}");
    }
    command
        .env("ROS_DOMAIN_ID", domain().to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env("ZENOH_CONFIG_OVERRIDE", overrides)
        .env("PYTHONPATH", python);
}

/// The embedded backend for nodes of the test itself: they find programs that [`Peer::start`] started, and no other test's.
#[must_use]
pub fn backend() -> HirozBackend {
    let session = SessionOptions { scouting_port: Some(scouting_port()), ..SessionOptions::default() };
    HirozBackend::new(HirozConfig { session, ..HirozConfig::default() })
}

/// A node of the test itself, of this name and on this machine only.
///
/// # Panics
///
/// Where it cannot be opened.
#[must_use]
pub fn open_node(name: &str) -> Node {
    let options = NodeOptions::new(name).domain_id(domain()).localhost_only(true);
    Node::open(options, &backend()).unwrap_or_else(|e| panic!("node {name}: {e}"))
}

/// What comes on a topic, for as long as the subscription is kept.
///
/// # Panics
///
/// Where there is no such topic.
pub fn listen<T: Message>(node: &Node, topic: &str, qos: Qos) -> (Subscription, Receiver<T>) {
    let (send, messages) = channel();
    let subscription = node.subscribe::<T>(topic, qos, move |message, _| {
        // A test that got what it wanted hangs up.
        let _ = send.send(message);
    });
    (subscription.unwrap_or_else(|e| panic!("{topic}: {e}")), messages)
}

fn signal(process: u32, name: &str) {
    let done = Command::new("kill").args([&format!("-{name}"), &process.to_string()]).status();
    assert!(done.is_ok_and(|s| s.success()), "it cannot be sent {name}");
}

/// Another program, read line by line; killed when dropped.
#[derive(Debug)]
pub struct Peer {
    child: Child,
    lines: Receiver<String>,
    errors: Receiver<String>,
    seen: Vec<String>,
}

/// The lines of a pipe, as they come.
fn lines_of(pipe: Option<impl Read + Send + 'static>) -> Receiver<String> {
    let (send, lines) = channel();
    if let Some(pipe) = pipe {
        std::thread::spawn(move || {
            for line in BufReader::new(pipe).lines().map_while(Result::ok) {
                if send.send(line).is_err() {
                    return;
                }
            }
        });
    }
    lines
}

impl Peer {
    /// Starts it in this test's ROS domain, on this machine only, where it hears no program of another test.
    ///
    /// # Panics
    ///
    /// Where it cannot be started.
    #[must_use]
    pub fn start(command: &mut Command) -> Self {
        isolate(command);
        Self::start_as_it_is(command.env("PYTHONUNBUFFERED", "1"))
    }

    /// Starts it with the environment that the command has. Where its standard error is a pipe, that is read too.
    ///
    /// # Panics
    ///
    /// Where it cannot be started.
    #[must_use]
    pub fn start_as_it_is(command: &mut Command) -> Self {
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap_or_else(|e| panic!("{command:?} does not start: {e}"));
        let lines = lines_of(child.stdout.take());
        let errors = lines_of(child.stderr.take());
        Self { child, lines, errors, seen: Vec::new() }
    }

    /// The next line of its standard error that `text` is found in.
    ///
    /// # Panics
    ///
    /// Where none comes in time, or standard error is not a pipe.
    pub fn expect_error(&mut self, text: &str, within: Duration) -> String {
        let deadline = Instant::now() + within;
        let mut said = Vec::new();
        loop {
            match self.errors.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(line) if line.contains(text) => return line,
                Ok(line) => said.push(line),
                Err(e) => panic!("no line with `{text}` ({e}); it complained of:\n{}", said.join("\n")),
            }
        }
    }

    /// Forgets the lines that have come.
    pub fn drain(&mut self) {
        self.seen.extend(self.lines.try_iter());
    }

    /// The next line that starts with `prefix`.
    ///
    /// # Panics
    ///
    /// Where none comes in time, with all that came.
    pub fn expect(&mut self, prefix: &str, within: Duration) -> String {
        let deadline = Instant::now() + within;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) => {
                    self.seen.push(line.clone());
                    if line.starts_with(prefix) {
                        return line;
                    }
                }
                Err(e) => panic!("no line `{prefix}…` ({e}); it printed:\n{}", self.seen.join("\n")),
            }
        }
    }

    /// Waits for its end; kills it where that takes too long.
    ///
    /// # Panics
    ///
    /// Where it does not end in time.
    pub fn end(&mut self, within: Duration) -> ExitStatus {
        let deadline = Instant::now() + within;
        while Instant::now() < deadline {
            match self.child.try_wait() {
                Ok(Some(status)) => return status,
                Ok(None) => std::thread::sleep(Duration::from_millis(20)),
                Err(e) => panic!("its end cannot be waited for: {e}"),
            }
        }
        panic!("it did not end within {within:?}; it printed:\n{}", self.seen.join("\n"));
    }

    /// Process id.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Asks it to end, as Ctrl-C does.
    ///
    /// # Panics
    ///
    /// Where it cannot be signalled.
    pub fn interrupt(&self) {
        self.signal("INT");
    }

    /// Sends it a signal by its name, e.g. `STOP`.
    ///
    /// # Panics
    ///
    /// Where it cannot be signalled.
    pub fn signal(&self, name: &str) {
        signal(self.child.id(), name);
    }

    /// \[bytes\] of memory that it holds.
    ///
    /// # Panics
    ///
    /// Where it has ended.
    #[must_use]
    pub fn memory(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id()))
            .unwrap_or_else(|e| panic!("it has ended: {e}"));
        let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:")).unwrap_or_default();
        let kilobytes: u64 = line.trim().trim_end_matches(" kB").parse().unwrap_or_default();
        kilobytes * 1024
    }

    /// Ends it at once, as a crash does.
    ///
    /// # Panics
    ///
    /// Where it cannot be killed.
    pub fn kill(&mut self) {
        self.child
            .kill()
            .and_then(|()| self.child.wait())
            .unwrap_or_else(|e| panic!("it cannot be killed: {e}"));
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            self.drain();
            eprintln!("process {} printed:\n{}", self.child.id(), self.seen.join("\n"));
        }
    }
}

/// A recorded skin, played at its own pace behind a pseudo-terminal, and the node that reads it with a model learned
/// from that recording: what a client of any kind can listen to.
#[derive(Debug)]
pub struct Recorded {
    _device: Peer,
    _node: Peer,
}

impl Recorded {
    /// Imports a recording of a magnetic pad into `folder`, learns from it in seconds, and starts device and node with
    /// these further arguments. `None`, with a printed line, where the recording is missing.
    ///
    /// # Panics
    ///
    /// Where one of our programs fails.
    #[must_use]
    pub fn start(folder: &Path, arguments: &[&str]) -> Option<Self> {
        let data = recordings("eflesh/spatial_resolution")?;
        let [bag, model, link] = ["bag", "model", "device"].map(|n| folder.join(n));
        let skin = root().join("launch/skins/eflesh.toml");
        let dermis = || {
            let mut command = Command::new(program("dermis"));
            command.current_dir(root());
            command
        };
        let finish = |command: &mut Command| {
            let out = command.output().unwrap_or_else(|e| panic!("{command:?} does not start: {e}"));
            assert!(out.status.success(), "{command:?}\n{}", String::from_utf8_lossy(&out.stderr));
        };
        finish(dermis().arg("import").arg(data.join("20250317_134149_probe")).arg("--out").arg(&bag));
        // A quick one: how good it is, is measured elsewhere.
        finish(
            dermis()
                .args([
                    "train",
                    "--config",
                    "launch/train/eflesh-position.toml",
                    "--candidates",
                    "network",
                    "--epochs",
                    "15",
                    "--members",
                    "1",
                ])
                .arg("--skin")
                .arg(&skin)
                .arg("--out")
                .arg(&model)
                .arg(&bag),
        );
        let mut device = Peer::start(
            dermis().args(["device", "replay", "--skin"]).arg(&skin).arg("--link").arg(&link).arg(&bag),
        );
        device.expect("", Duration::from_secs(20));
        let node = Peer::start(
            dermis()
                .arg("barodome")
                .arg("--skin")
                .arg(&skin)
                .arg("--model")
                .arg(&model)
                .arg("--source")
                .arg(format!("serial://{}", link.display()))
                .args(arguments),
        );
        Some(Self { _device: device, _node: node })
    }
}

/// A simulated pad that nobody touches, and the node that reads it.
#[derive(Debug)]
pub struct Pad {
    _device: Peer,
    _node: Peer,
}

impl Pad {
    /// Starts both; the node gets these further arguments.
    ///
    /// # Panics
    ///
    /// Where one of our programs does not start.
    #[must_use]
    pub fn start(folder: &Path, arguments: &[&str]) -> Self {
        const IDLE: &str = "schema = \"dermis-plan/1\"\nname = \"idle\"\nseed = 1\ndiameter = 0.004\nmargin = 0.004\n\
            force_distribution = \"uniform\"\n[[steps]]\nkind = \"idle\"\nduration = 600.0\n";
        static PADS: AtomicUsize = AtomicUsize::new(0);
        let number = PADS.fetch_add(1, Ordering::Relaxed);
        let [plan, link] = ["plan", "device"].map(|name| folder.join(format!("{name}{number}.toml")));
        std::fs::write(&plan, IDLE).unwrap_or_else(|e| panic!("{} cannot be written: {e}", plan.display()));
        let dermis = || {
            let mut command = Command::new(program("dermis"));
            command.current_dir(root());
            command
        };
        let skin = "launch/skins/baro-grid.toml";
        let mut device = Peer::start(
            dermis().args(["device", "simulate", skin, "--plan"]).arg(plan).arg("--link").arg(&link),
        );
        device.expect("", Duration::from_secs(60));
        let node = Peer::start(
            dermis()
                .args(["barodome", "--skin", skin, "--model", "models/baro-grid", "--source"])
                .arg(format!("serial://{}", link.display()))
                .args(arguments),
        );
        Self { _device: device, _node: node }
    }
}
