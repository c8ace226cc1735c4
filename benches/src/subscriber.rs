//! The subscriber process: says of each message which frame it is of and when it was here.

use std::io::{Read, Write};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use dermis_msgs::msg::{BodyContacts, ContactArray};
use dermis_msgs::std_msgs::msg::Bool;
use dermis_node::{Backend, HirozBackend, Node, NodeOptions, Qos};
use dermis_transport::now_ns;

use crate::machine::Process;

/// ROS 2 implementation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Choice {
    /// The embedded one.
    Hiroz,
    /// The one that is sourced.
    Ros2,
}

impl Choice {
    /// As the command line of our programs calls it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Hiroz => "hiroz",
            Self::Ros2 => "ros2",
        }
    }

    /// The implementation.
    ///
    /// # Errors
    ///
    /// Where this program was built without it.
    pub fn open(self) -> Result<Arc<dyn Backend>> {
        match self {
            Self::Hiroz => Ok(Arc::new(HirozBackend::default())),
            #[cfg(feature = "ros2")]
            Self::Ros2 => Ok(Arc::new(dermis_node_r2r::R2rBackend)),
            #[cfg(not(feature = "ros2"))]
            Self::Ros2 => bail!("this program was built without the feature `ros2`"),
        }
    }
}

/// How to listen.
#[derive(Debug, Args)]
pub struct Options {
    /// ROS 2 implementation.
    #[arg(long, value_enum, required_unless_present = "socket")]
    backend: Option<Choice>,
    /// No ROS 2: answers of the chain in C as datagrams to this Unix socket.
    #[arg(long, conflicts_with = "backend")]
    socket: Option<PathBuf>,
    /// Topic of contact arrays, or of stops.
    #[arg(long, default_value = "contacts")]
    topic: String,
    /// It brings stops (`std_msgs/msg/Bool`), whose value is given as the status.
    #[arg(long, conflicts_with = "body")]
    stops: bool,
    /// It brings what a body feels (`dermis_msgs/msg/BodyContacts`): for each skin an arrival with the stamp of its latest frame
    /// \[ns\] in place of the sequence, the skin's place in the list in place of the status, and the number of the body's contacts.
    #[arg(long)]
    body: bool,
}

/// One message that arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival {
    /// Of the frame that it was computed from.
    pub sequence: u64,
    /// When it had been decoded, ns since the epoch.
    pub received_ns: i64,
    /// When its publisher sent it, ns since the epoch; 0 where that is not known.
    pub published_ns: i64,
    /// `ContactArray::STATUS_*`.
    pub status: u8,
    /// Number of contacts, at most 255.
    pub contacts: u8,
}

impl Arrival {
    const BYTES: usize = 32;

    fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.received_ns.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.published_ns.to_le_bytes());
        bytes[24] = self.status;
        bytes[25] = self.contacts;
        bytes
    }

    fn from_bytes(bytes: &[u8; Self::BYTES]) -> Self {
        let number = |at: usize| {
            let mut word = [0; 8];
            word.copy_from_slice(&bytes[at..at + 8]);
            word
        };
        Self {
            sequence: u64::from_le_bytes(number(0)),
            received_ns: i64::from_le_bytes(number(8)),
            published_ns: i64::from_le_bytes(number(16)),
            status: bytes[24],
            contacts: bytes[25],
        }
    }
}

/// Prints arrivals until its output is closed.
///
/// # Errors
///
/// Where ROS refuses.
pub fn run(options: &Options) -> Result<()> {
    if let Some(socket) = &options.socket {
        return datagrams(socket);
    }
    let backend = options.backend.context("neither a backend nor a socket is named")?.open()?;
    let node = Node::open(NodeOptions::new("bench_subscriber"), backend.as_ref())?;
    let waiting = Arc::new(Mutex::new(Vec::<u8>::new()));
    let sink = Arc::clone(&waiting);
    let qos = Qos { history: dermis_node::History::KeepLast(8192), ..Qos::sensor_data() };
    let keep = move |arrival: Arrival| {
        sink.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(&arrival.to_bytes());
    };
    let _subscription = if options.stops {
        node.subscribe::<Bool>(&options.topic, qos, move |stop, info| {
            keep(Arrival {
                sequence: 0,
                received_ns: now_ns(),
                published_ns: info.source_ns.unwrap_or(0),
                status: u8::from(stop.data),
                contacts: 0,
            });
        })?
    } else if options.body {
        node.subscribe::<BodyContacts>(&options.topic, qos, move |body, info| {
            let received_ns = now_ns();
            let published_ns = info.source_ns.unwrap_or(0);
            let contacts = u8::try_from(body.contacts.len()).unwrap_or(u8::MAX);
            for (place, skin) in (0..=u8::MAX).zip(&body.skins) {
                let sequence =
                    u64::from(skin.stamp.sec.unsigned_abs()) * 1_000_000_000 + u64::from(skin.stamp.nanosec);
                keep(Arrival { sequence, received_ns, published_ns, status: place, contacts });
            }
        })?
    } else {
        node.subscribe::<ContactArray>(&options.topic, qos, move |array, info| {
            keep(Arrival {
                sequence: array.sequence,
                received_ns: now_ns(),
                published_ns: info.source_ns.unwrap_or(0),
                status: array.status,
                contacts: u8::try_from(array.contacts.len()).unwrap_or(u8::MAX),
            });
        })?
    };
    let mut out = std::io::stdout().lock();
    loop {
        std::thread::sleep(Duration::from_micros(300));
        let bytes = std::mem::take(&mut *waiting.lock().unwrap_or_else(PoisonError::into_inner));
        if !bytes.is_empty() && out.write_all(&bytes).and_then(|()| out.flush()).is_err() {
            return Ok(());
        }
    }
}

/// The same of the datagrams of the chain in C: sequence, status, number of contacts, and what it found.
fn datagrams(path: &Path) -> Result<()> {
    let socket = UnixDatagram::bind(path).with_context(|| format!("{} cannot be opened", path.display()))?;
    let mut out = std::io::stdout().lock();
    let mut bytes = [0; 256];
    loop {
        let n = socket.recv(&mut bytes)?;
        let received_ns = now_ns();
        let Some((sequence, [status, contacts, ..])) = bytes[..n].split_first_chunk() else {
            bail!("the chain sends {n} bytes")
        };
        let sequence = u64::from_ne_bytes(*sequence);
        let arrival =
            Arrival { sequence, received_ns, published_ns: 0, status: *status, contacts: *contacts };
        if out.write_all(&arrival.to_bytes()).and_then(|()| out.flush()).is_err() {
            return Ok(());
        }
    }
}

/// Reads what such a process prints.
pub fn arrivals(mut pipe: impl Read + Send + 'static) -> Receiver<Arrival> {
    let (tx, rx) = channel();
    std::thread::spawn(move || {
        let mut bytes = [0; Arrival::BYTES];
        while pipe.read_exact(&mut bytes).is_ok() {
            if tx.send(Arrival::from_bytes(&bytes)).is_err() {
                return;
            }
        }
    });
    rx
}

/// Starts such a process.
///
/// # Errors
///
/// Where it cannot be started.
pub fn start(backend: Choice, domain: u16) -> Result<(Process, Receiver<Arrival>)> {
    start_with(domain, &["--backend", backend.name()])
}

/// The same for answers of the chain in C; it listens when this returns.
///
/// # Errors
///
/// Where it cannot be started.
pub fn start_datagrams(socket: &Path) -> Result<(Process, Receiver<Arrival>)> {
    let started = start_with(domain_of(0), &["--socket", &socket.display().to_string()])?;
    let begun = Instant::now();
    while !socket.exists() {
        if begun.elapsed() > Duration::from_secs(10) {
            bail!("the subscriber did not open {}", socket.display());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(started)
}

/// The same for stops on the topic `stop`.
///
/// # Errors
///
/// Where it cannot be started.
pub fn start_stops(backend: Choice, domain: u16) -> Result<(Process, Receiver<Arrival>)> {
    start_with(domain, &["--backend", backend.name(), "--stops", "--topic", "stop"])
}

/// The same for what a body feels, on this topic.
///
/// # Errors
///
/// Where it cannot be started.
pub fn start_body(backend: Choice, domain: u16, topic: &str) -> Result<(Process, Receiver<Arrival>)> {
    start_with(domain, &["--backend", backend.name(), "--body", "--topic", topic])
}

fn start_with(domain: u16, arguments: &[&str]) -> Result<(Process, Receiver<Arrival>)> {
    let this = std::env::current_exe().context("this program has no path")?;
    let mut child = isolated(&mut std::process::Command::new(this), domain)
        .arg("subscriber")
        .args(arguments)
        .stdout(std::process::Stdio::piped())
        .spawn()
        .context("the subscriber cannot be started")?;
    let Some(pipe) = child.stdout.take() else { bail!("the subscriber has no output") };
    Ok((Process(child), arrivals(pipe)))
}

/// Starts a command in a ROS domain of its own; what it prints is dropped.
///
/// # Errors
///
/// Where it cannot be started.
pub fn spawn(command: &mut std::process::Command, domain: u16) -> Result<Process> {
    let child = isolated(command, domain).stdout(std::process::Stdio::null()).spawn();
    Ok(Process(child.with_context(|| format!("{} cannot be started", command.get_program().display()))?))
}

/// The ROS domain of a row of a table: of this run, and not that of the row before, whose processes may still leave it.
pub fn domain_of(row: usize) -> u16 {
    60 + (std::process::id() % 20) as u16 * 2 + (row % 2) as u16
}

/// A command in a ROS domain of its own, on this machine only.
pub fn isolated(command: &mut std::process::Command, domain: u16) -> &mut std::process::Command {
    command.env("ROS_DOMAIN_ID", domain.to_string()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrivals_come_back_as_they_went() {
        let arrival =
            Arrival { sequence: u64::MAX - 3, received_ns: -7, published_ns: 9, status: 3, contacts: 255 };
        assert_eq!(Arrival::from_bytes(&arrival.to_bytes()), arrival);
        let twice = [arrival.to_bytes(), arrival.to_bytes()].concat();
        assert_eq!(arrivals(std::io::Cursor::new(twice)).iter().count(), 2);
    }
}
