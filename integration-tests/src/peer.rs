//! Programs on the other side that say what happens as one JSON object a line.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use serde_json::Value;

/// Longest wait for a peer: discovery, Python's imports and a machine at full load.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// A child process with a line protocol. Dropping it kills it.
///
/// All of its methods panic where the peer does not do what the test needs, and show what it said instead.
#[derive(Debug)]
pub struct Peer {
    name: String,
    child: Child,
    commands: Option<ChildStdin>,
    lines: Receiver<String>,
    said: Vec<String>,
}

impl Peer {
    /// Starts a program. Its standard error goes where the test's goes.
    ///
    /// # Panics
    ///
    /// When it does not start.
    #[must_use]
    pub fn start(name: &str, command: &mut Command) -> Self {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|e| panic!("{name} does not start ({command:?}): {e}"));
        let commands = child.stdin.take();
        let out = child.stdout.take().expect("its standard output is a pipe");
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Self { name: name.to_owned(), child, commands, lines, said: Vec::new() }
    }

    /// Starts `python/ros/peer.py` as the node `name` and waits until it is there; `None`, with a printed line,
    /// where no ROS 2 is set up for tests.
    ///
    /// # Panics
    ///
    /// When it does not get ready.
    #[must_use]
    pub fn rclpy(name: &str, domain: u16) -> Option<Self> {
        let python = ros_python()?;
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/ros/peer.py");
        let mut command = Command::new(python);
        command
            .arg(script)
            .arg(name)
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
        let mut peer = Self::start(&format!("rclpy node {name}"), &mut command);
        peer.event("ready", |_| true);
        Some(peer)
    }

    /// Sends a command.
    ///
    /// # Panics
    ///
    /// When the peer has ended.
    pub fn tell(&mut self, command: &Value) {
        let pipe = self.commands.as_mut().expect("its standard input is a pipe");
        writeln!(pipe, "{command}")
            .and_then(|()| pipe.flush())
            .unwrap_or_else(|e| panic!("{} does not listen: {e}\n{}", self.name, self.said.join("\n")));
    }

    /// Waits until it says something for which `found` has a value.
    ///
    /// # Panics
    ///
    /// When it does not within [`PATIENCE`].
    pub fn wait<T>(&mut self, what: &str, mut found: impl FnMut(&Value) -> Option<T>) -> T {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let Ok(line) = self.lines.recv_timeout(left) else {
                let state = self.child.try_wait();
                panic!("{} did not say {what} ({state:?}); it said:\n{}", self.name, self.said.join("\n"));
            };
            let value = serde_json::from_str(&line).unwrap_or(Value::Null);
            self.said.push(line);
            if let Some(value) = found(&value) {
                return value;
            }
        }
    }

    /// Waits for an object with this `event` which `wanted` accepts.
    ///
    /// # Panics
    ///
    /// When none comes within [`PATIENCE`].
    pub fn event(&mut self, event: &str, mut wanted: impl FnMut(&Value) -> bool) -> Value {
        self.wait(event, |said| (said["event"] == event && wanted(said)).then(|| said.clone()))
    }

    /// Everything it has said until now.
    pub fn said(&mut self) -> &[String] {
        self.said.extend(self.lines.try_iter());
        &self.said
    }

    /// Process id.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Kills it, with no chance to say goodbye, and waits until it is gone.
    ///
    /// # Panics
    ///
    /// When the system refuses.
    pub fn kill(mut self) {
        self.child.kill().and_then(|()| self.child.wait()).expect("a child can be killed");
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // Nothing can be done where it does not die.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The Python that has rclpy and dermis_msgs; `None`, with a printed line, where none is set up.
#[must_use]
pub fn ros_python() -> Option<PathBuf> {
    let python = std::env::var_os("DERMIS_ROS_PYTHON").filter(|p| !p.is_empty()).map(PathBuf::from);
    if python.is_none() {
        println!("skipped: DERMIS_ROS_PYTHON is not set; `cargo xtask test` sets ROS 2 up");
    }
    python
}

/// A ROS domain that no other test of this run is likely to be in.
#[must_use]
pub fn domain() -> u16 {
    1 + u16::try_from(std::process::id() % 100).expect("below 100")
}

/// Waits until `holds`.
///
/// # Panics
///
/// When it does not within [`PATIENCE`].
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !holds() {
        assert!(Instant::now() < deadline, "{what}: not within {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(10));
    }
}
