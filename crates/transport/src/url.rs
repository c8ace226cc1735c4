//! Where bytes come from, written as a URL.

use std::fmt::{self, Display, Write as _};
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use crate::TransportError;
use query::{Query, escape, http};

mod query;

/// Parity bit of a serial line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Parity {
    /// No parity bit, as nearly every device has it.
    #[default]
    None,
    /// Even parity.
    Even,
    /// Odd parity.
    Odd,
}

/// Which datagrams are those of one device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sender {
    /// Those from one address and port.
    #[default]
    One,
    /// Those from one address, whatever the port: a device that opens a new socket for every datagram.
    Host,
    /// All: several machines send the frames of one device in turn.
    Any,
}

/// What becomes of a client that connects while another one is connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Newcomer {
    /// It waits whether the other one still sends, and is refused if it does.
    #[default]
    Refuse,
    /// It is the device from then on.
    Replace,
}

/// A place that bytes come from.
///
/// | URL | meaning |
/// |---|---|
/// | `serial:///dev/ttyACM0?baud=921600&parity=none&stop=1&idle=2` | a serial line, opened exclusively, raw, 8 bits |
/// | `udp://0.0.0.0:7400?from=192.168.1.20&sender=one&hold=1` | datagrams that arrive at this address; a multicast address is joined |
/// | `tcp://192.168.1.20:7400?idle=10` | connect to a server |
/// | `http://192.168.1.20:8080/?action=stream` | get a stream from a web server: its body, without its head |
/// | `tcp-listen://0.0.0.0:7400?newcomer=refuse&hold=1`, `tcp://0.0.0.0:7400?listen` | serve, one client is the device |
/// | `v4l2:///dev/video0?size=1640x1232&rate=40&idle=10` | a camera of this machine (Video4Linux 2): its pictures as it compresses them (MJPEG) |
/// | `pty:///dev/pts/3` | an existing terminal, no line settings and no lock |
/// | `pty://`, `pty://?link=/tmp/skin` | make a pseudo-terminal and read what is written to its far end |
/// | `replay:///data/bag?speed=1&topic=/skin/taxels&skin=left_palm&loop=false` | the `TaxelFrame`s of a rosbag2 (folder or `.mcap`) as native wire |
///
/// `idle=SECONDS` reconnects when a link is silent for so long, `idle=0` never. `tcp://` does so after 10 s if nothing
/// else is said, because a server that lost power never says goodbye, and so does `v4l2://`, whose camera may hang; for the others silence is no
/// reason to. `http://` does so after 10 s, too: what follows its `?` is the server's.
///
/// A port has one device. The one that sends keeps it; what another one sends or wants is left out, counted and named,
/// until the first has been silent for `hold=SECONDS` (1). `sender=host` takes all ports of a sender's address for one
/// device, `sender=any` everything; with `newcomer=replace` the newest client is the device.
/// Paths may hold `%XX` escapes; `?`, `&` and `%` in a path must be written so.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum SourceUrl {
    /// A serial line.
    Serial {
        /// Device file, such as `/dev/ttyACM0` or a link under `/dev/serial/by-id`.
        path: PathBuf,
        /// \[baud\] line rate; USB devices of class CDC-ACM ignore it.
        baud: u32,
        /// Parity bit.
        parity: Parity,
        /// Stop bits, 1 or 2.
        stop_bits: u8,
        /// Reconnect after so long without a byte.
        idle: Option<Duration>,
    },
    /// Datagrams.
    Udp {
        /// Local address to bind, or a multicast group to join.
        bind: SocketAddr,
        /// Take datagrams of this sender only.
        from: Option<IpAddr>,
        /// Which datagrams are those of one device.
        sender: Sender,
        /// Silence after which another sender is read.
        hold: Duration,
        /// Bind again after so long without a datagram.
        idle: Option<Duration>,
    },
    /// Connect to a server.
    Tcp {
        /// `HOST:PORT`, the host a name or an address.
        address: String,
        /// Reconnect after so long without a byte; `None` never.
        idle: Option<Duration>,
    },
    /// Get a stream from a web server.
    Http {
        /// `HOST:PORT`, the host a name or an address.
        address: String,
        /// What is requested, from the `/` on, as it goes over the line.
        path: String,
    },
    /// Wait for the device to connect.
    TcpListen {
        /// Local address; port 0 takes a free one.
        bind: SocketAddr,
        /// What becomes of a second client.
        newcomer: Newcomer,
        /// Silence after which a second client takes the place of the first.
        hold: Duration,
        /// Drop the client after so long without a byte.
        idle: Option<Duration>,
    },
    /// A camera of this machine.
    Camera {
        /// Device file, such as `/dev/video0` or a link under `/dev/v4l/by-id`.
        path: PathBuf,
        /// \[pixels\] width and height of its pictures; as the camera is set where absent.
        size: Option<[u32; 2]>,
        /// \[Hz\] of its pictures; as the camera is set where absent.
        rate: Option<u32>,
        /// Open it again after so long without a picture; `None` never.
        idle: Option<Duration>,
    },
    /// A pseudo-terminal.
    Pty {
        /// An existing terminal, or `None` to make a pair and read its master end.
        path: Option<PathBuf>,
        /// Symbolic link to make to the slave end of a new pair.
        link: Option<PathBuf>,
    },
    /// Recorded frames.
    Replay {
        /// A rosbag2 folder or an `.mcap` file.
        path: PathBuf,
        /// Factor on the recorded pace; 0 is as fast as the consumer takes them.
        speed: f64,
        /// Topic to replay; without it every topic of type `TaxelFrame` must be the same one.
        topic: Option<String>,
        /// Name of the skin whose frames are replayed; without it the topic must carry those of one only.
        skin: Option<String>,
        /// Start again at the end.
        repeat: bool,
    },
}

const SCHEMES: &[&str] = &["serial", "udp", "tcp", "tcp-listen", "http", "v4l2", "pty", "replay"];

/// \[baud\] rate of a serial URL that names none.
const DEFAULT_BAUD: u32 = 115_200;

/// Silence after which a port is no longer a device's own. Longer than a device pauses, shorter than one takes to start.
const HOLD: Duration = Duration::from_secs(1);

/// Silence after which a server, or a camera, is taken to be gone.
pub(crate) const IDLE: Duration = Duration::from_secs(10);

impl SourceUrl {
    /// Reads a URL.
    ///
    /// # Errors
    /// Every variant of [`TransportError`] about URLs; each names the part at fault and what is valid there.
    pub fn parse(text: &str) -> Result<Self, TransportError> {
        let url = text.trim();
        let Some((scheme, rest)) = url.split_once("://") else {
            return Err(TransportError::NotAUrl { url: url.into(), valid: SCHEMES.join(", ") });
        };
        let (target, query) = rest.split_once('?').unwrap_or((rest, ""));
        let parser = |scheme, valid: &[&str]| Query::parse(url, scheme, target, query, valid);
        match scheme.to_ascii_lowercase().as_str() {
            "serial" => Self::serial(&mut parser("serial", &["baud", "parity", "stop", "idle"])?),
            "udp" => Self::udp(&mut parser("udp", &["from", "sender", "hold", "idle"])?),
            "tcp" => Self::tcp(parser("tcp", &["listen", "newcomer", "hold", "idle"])?),
            "tcp-listen" => parser("tcp-listen", &["newcomer", "hold", "idle"])?.tcp_listen(),
            "http" => http(url, rest),
            "v4l2" => Self::camera(&mut parser("v4l2", &["size", "rate", "idle"])?),
            "pty" => Self::pty(&mut parser("pty", &["link"])?),
            "replay" => Self::replay(&mut parser("replay", &["speed", "topic", "skin", "loop"])?),
            _ => Err(TransportError::UnknownScheme {
                url: url.into(),
                scheme: scheme.into(),
                valid: SCHEMES.join(", "),
            }),
        }
    }

    /// A serial line.
    fn serial(q: &mut Query<'_>) -> Result<Self, TransportError> {
        let path = q.path("a device file, as in serial:///dev/ttyACM0?baud=115200")?;
        let baud = q.take_with("baud", "a rate from 50 to 12000000", |v| {
            v.parse::<u32>().ok().filter(|b| (50..=12_000_000).contains(b))
        })?;
        let parity = q.take_with("parity", "none, even or odd", |v| match v {
            "none" => Some(Parity::None),
            "even" => Some(Parity::Even),
            "odd" => Some(Parity::Odd),
            _ => None,
        })?;
        let stop_bits = q.take_with("stop", "1 or 2", |v| match v {
            "1" => Some(1),
            "2" => Some(2),
            _ => None,
        })?;
        Ok(Self::Serial {
            path,
            baud: baud.unwrap_or(DEFAULT_BAUD),
            parity: parity.unwrap_or_default(),
            stop_bits: stop_bits.unwrap_or(1),
            idle: q.idle()?,
        })
    }

    /// Datagrams.
    fn udp(q: &mut Query<'_>) -> Result<Self, TransportError> {
        let bind = q.socket_addr()?;
        let from = q.take_with("from", "an IP address", |v| v.parse().ok())?;
        let sender = q.take_with("sender", "one, host or any", |v| match v {
            "one" => Some(Sender::One),
            "host" => Some(Sender::Host),
            "any" => Some(Sender::Any),
            _ => None,
        })?;
        Ok(Self::Udp { bind, from, sender: sender.unwrap_or_default(), hold: q.hold()?, idle: q.idle()? })
    }

    /// A server, or a port that the device connects to.
    fn tcp(mut q: Query<'_>) -> Result<Self, TransportError> {
        if q.flag("listen")? {
            return q.tcp_listen();
        }
        for key in ["newcomer", "hold"] {
            if let Some(value) = q.keys.get(key) {
                return Err(q.invalid(key, value, "left out without listen: here no client connects"));
            }
        }
        Ok(Self::Tcp { address: q.host_port()?, idle: q.idle_or(Some(IDLE))? })
    }

    /// A camera of this machine.
    fn camera(q: &mut Query<'_>) -> Result<Self, TransportError> {
        let path = q.path("a device file, as in v4l2:///dev/video0?size=1640x1232&rate=40")?;
        let size = q.take_with("size", "WIDTHxHEIGHT in pixels, as in 1640x1232", |v| {
            let (width, height) = v.split_once('x')?;
            let side = |text: &str| text.parse::<u32>().ok().filter(|side| (1..=65_535).contains(side));
            Some([side(width)?, side(height)?])
        })?;
        let rate = q.take_with("rate", "pictures a second from 1 to 1000", |v| {
            v.parse::<u32>().ok().filter(|rate| (1..=1000).contains(rate))
        })?;
        Ok(Self::Camera { path, size, rate, idle: q.idle_or(Some(IDLE))? })
    }

    /// A pseudo-terminal.
    fn pty(q: &mut Query<'_>) -> Result<Self, TransportError> {
        let link = q.take_with("link", "a path", |v| (!v.is_empty()).then(|| PathBuf::from(v)))?;
        if q.target.is_empty() {
            return Ok(Self::Pty { path: None, link });
        }
        let path = q.path("a terminal, as in pty:///dev/pts/3, or nothing to make one")?;
        if let Some(link) = link {
            return Err(q.invalid("link", &link.display().to_string(), "left out where a path is given"));
        }
        Ok(Self::Pty { path: Some(path), link: None })
    }

    /// Recorded frames.
    fn replay(q: &mut Query<'_>) -> Result<Self, TransportError> {
        let path = q.path("a rosbag2 folder or .mcap file, as in replay:///data/bag")?;
        let speed = q.take_with("speed", "0 (as fast as possible) or a positive factor", |v| {
            v.parse::<f64>().ok().filter(|s| s.is_finite() && *s >= 0.0)
        })?;
        let topic = q.take_with("topic", "a topic name", |v| (!v.is_empty()).then(|| v.to_owned()))?;
        let skin = q.take_with("skin", "the name of a skin", |v| (!v.is_empty()).then(|| v.to_owned()))?;
        Ok(Self::Replay { path, speed: speed.unwrap_or(1.0), topic, skin, repeat: q.flag("loop")? })
    }
}

impl std::str::FromStr for SourceUrl {
    type Err = TransportError;

    fn from_str(text: &str) -> Result<Self, TransportError> {
        Self::parse(text)
    }
}

/// Writes the URL such that [`SourceUrl::parse`] reads the same value back.
impl Display for SourceUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let hold_key = |hold: Duration| (hold != HOLD).then(|| format!("hold={}", hold.as_secs_f64()));
        let idle_key = |idle: &Option<Duration>| idle.map(|d| format!("idle={}", d.as_secs_f64()));
        let (base, keys): (String, Vec<Option<String>>) = match self {
            Self::Serial { path, baud, parity, stop_bits, idle } => (
                format!("serial://{}", escape(&path.to_string_lossy())),
                vec![
                    Some(format!("baud={baud}")),
                    match parity {
                        Parity::None => None,
                        Parity::Even => Some("parity=even".into()),
                        Parity::Odd => Some("parity=odd".into()),
                    },
                    (*stop_bits == 2).then(|| "stop=2".into()),
                    idle_key(idle),
                ],
            ),
            Self::Udp { bind, from, sender, hold, idle } => (
                format!("udp://{bind}"),
                vec![
                    from.map(|a| format!("from={a}")),
                    match sender {
                        Sender::One => None,
                        Sender::Host => Some("sender=host".into()),
                        Sender::Any => Some("sender=any".into()),
                    },
                    hold_key(*hold),
                    idle_key(idle),
                ],
            ),
            Self::Tcp { address, idle } => {
                (format!("tcp://{address}"), vec![idle_key(&Some(idle.unwrap_or_default()))])
            }
            Self::Http { address, path } => (format!("http://{address}{path}"), Vec::new()),
            Self::TcpListen { bind, newcomer, hold, idle } => (
                format!("tcp-listen://{bind}"),
                vec![
                    (*newcomer == Newcomer::Replace).then(|| "newcomer=replace".into()),
                    hold_key(*hold),
                    idle_key(idle),
                ],
            ),
            Self::Camera { path, size, rate, idle } => (
                format!("v4l2://{}", escape(&path.to_string_lossy())),
                vec![
                    size.map(|[width, height]| format!("size={width}x{height}")),
                    rate.map(|rate| format!("rate={rate}")),
                    idle_key(&Some(idle.unwrap_or_default())),
                ],
            ),
            Self::Pty { path, link } => (
                format!("pty://{}", path.as_ref().map_or(String::new(), |p| escape(&p.to_string_lossy()))),
                vec![link.as_ref().map(|l| format!("link={}", escape(&l.to_string_lossy())))],
            ),
            Self::Replay { path, speed, topic, skin, repeat } => (
                format!("replay://{}", escape(&path.to_string_lossy())),
                vec![
                    (*speed != 1.0).then(|| format!("speed={speed}")),
                    topic.as_ref().map(|t| format!("topic={}", escape(t))),
                    skin.as_ref().map(|s| format!("skin={}", escape(s))),
                    repeat.then(|| "loop=true".into()),
                ],
            ),
        };
        f.write_str(&base)?;
        for (i, key) in keys.into_iter().flatten().enumerate() {
            f.write_char(if i == 0 { '?' } else { '&' })?;
            f.write_str(&key)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
