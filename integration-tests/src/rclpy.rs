//! A real `rclpy` node on the other side, driven with one JSON object a line: `python/ros/peer.py`.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::{domain, root, ros_python};

/// Longest wait for it: discovery, Python's imports and a machine at full load.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// A process with one `rclpy` node. Dropping it kills it.
///
/// All of its methods panic where the node does not do what the test needs, and show what it said instead.
#[derive(Debug)]
pub struct Rclpy {
    name: String,
    child: Child,
    commands: Option<ChildStdin>,
    lines: Receiver<String>,
    said: Vec<String>,
}

impl Rclpy {
    /// Starts a node and waits until it is there; `None`, with a printed line, where no ROS 2 is set up for tests.
    ///
    /// # Panics
    ///
    /// When it does not get ready.
    #[must_use]
    pub fn start(name: &str) -> Option<Self> {
        let mut child = Command::new(ros_python()?)
            .arg(root().join("integration-tests/python/ros/peer.py"))
            .arg(name)
            .env("ROS_DOMAIN_ID", domain().to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|e| panic!("Python does not start: {e}"));
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
        let mut peer = Self { name: name.to_owned(), child, commands, lines, said: Vec::new() };
        peer.event("ready", |_| true);
        Some(peer)
    }

    /// Sends it a signal by its name, e.g. `STOP`.
    ///
    /// # Panics
    ///
    /// Where it cannot be signalled.
    pub fn signal(&self, name: &str) {
        crate::signal(self.child.id(), name);
    }

    /// Sends a command.
    ///
    /// # Panics
    ///
    /// When the node has ended.
    pub fn tell(&mut self, command: &Value) {
        let pipe = self.commands.as_mut().expect("its standard input is a pipe");
        writeln!(pipe, "{command}").and_then(|()| pipe.flush()).unwrap_or_else(|e| {
            panic!("rclpy node {} does not listen: {e}\n{}", self.name, self.said.join("\n"))
        });
    }

    /// Waits until it says something for which `found` has a value.
    ///
    /// # Panics
    ///
    /// When it does not within [`PATIENCE`].
    pub fn wait<T>(&mut self, what: &str, mut found: impl FnMut(&Value) -> Option<T>) -> T {
        self.wait_and(what, |_, said| found(said))
    }

    /// [`Rclpy::wait`], with the node at hand to tell it more.
    ///
    /// # Panics
    ///
    /// When it does not within [`PATIENCE`].
    pub fn wait_and<T>(&mut self, what: &str, mut found: impl FnMut(&mut Self, &Value) -> Option<T>) -> T {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let Ok(line) = self.lines.recv_timeout(left) else {
                let state = self.child.try_wait();
                panic!(
                    "rclpy node {} did not say {what} ({state:?}); it said:\n{}",
                    self.name,
                    self.said.join("\n")
                );
            };
            let value = serde_json::from_str(&line).unwrap_or(Value::Null);
            self.said.push(line);
            if let Some(value) = found(self, &value) {
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

    /// Closes its standard input, which ends it, and waits until it is gone.
    ///
    /// # Panics
    ///
    /// When the system refuses.
    pub fn close(mut self) {
        self.commands = None;
        self.child.wait().expect("a child can be waited for");
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

impl Drop for Rclpy {
    fn drop(&mut self) {
        // Nothing can be done where it does not die.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
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
