//! Where bytes come from, written as a URL.

use std::collections::BTreeMap;
use std::fmt::{self, Display, Write as _};
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use crate::TransportError;

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
/// | `pty:///dev/pts/3` | an existing terminal, no line settings and no lock |
/// | `pty://`, `pty://?link=/tmp/skin` | make a pseudo-terminal and read what is written to its far end |
/// | `replay:///data/bag?speed=1&topic=/skin/taxels&skin=left_palm&loop=false` | the `TaxelFrame`s of a rosbag2 (folder or `.mcap`) as native wire |
///
/// `idle=SECONDS` reconnects when a link is silent for so long, `idle=0` never. `tcp://` does so after 10 s if nothing
/// else is said, because a server that lost power never says goodbye; for the others silence is no reason to. `http://`
/// does so after 10 s, too: what follows its `?` is the server's.
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

const SCHEMES: &[&str] = &["serial", "udp", "tcp", "tcp-listen", "http", "pty", "replay"];

/// \[baud\] rate of a serial URL that names none.
const DEFAULT_BAUD: u32 = 115_200;

/// Silence after which a port is no longer a device's own. Longer than a device pauses, shorter than one takes to start.
const HOLD: Duration = Duration::from_secs(1);

/// Silence after which a TCP server is taken to be gone.
pub(crate) const TCP_IDLE: Duration = Duration::from_secs(10);

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
            "serial" => {
                let mut q = parser("serial", &["baud", "parity", "stop", "idle"])?;
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
            "udp" => {
                let mut q = parser("udp", &["from", "sender", "hold", "idle"])?;
                let bind = q.socket_addr()?;
                let from = q.take_with("from", "an IP address", |v| v.parse().ok())?;
                let sender = q.take_with("sender", "one, host or any", |v| match v {
                    "one" => Some(Sender::One),
                    "host" => Some(Sender::Host),
                    "any" => Some(Sender::Any),
                    _ => None,
                })?;
                Ok(Self::Udp {
                    bind,
                    from,
                    sender: sender.unwrap_or_default(),
                    hold: q.hold()?,
                    idle: q.idle()?,
                })
            }
            "tcp" => {
                let mut q = parser("tcp", &["listen", "newcomer", "hold", "idle"])?;
                if q.flag("listen")? {
                    return q.tcp_listen();
                }
                for key in ["newcomer", "hold"] {
                    if let Some(value) = q.keys.get(key) {
                        return Err(q.invalid(
                            key,
                            value,
                            "left out without listen: here no client connects",
                        ));
                    }
                }
                Ok(Self::Tcp { address: q.host_port()?, idle: q.idle_or(Some(TCP_IDLE))? })
            }
            "tcp-listen" => parser("tcp-listen", &["newcomer", "hold", "idle"])?.tcp_listen(),
            "http" => http(url, rest),
            "pty" => {
                let mut q = parser("pty", &["link"])?;
                let link = q.take_with("link", "a path", |v| (!v.is_empty()).then(|| PathBuf::from(v)))?;
                if target.is_empty() {
                    return Ok(Self::Pty { path: None, link });
                }
                let path = q.path("a terminal, as in pty:///dev/pts/3, or nothing to make one")?;
                if let Some(link) = link {
                    return Err(q.invalid(
                        "link",
                        &link.display().to_string(),
                        "left out where a path is given",
                    ));
                }
                Ok(Self::Pty { path: Some(path), link: None })
            }
            "replay" => {
                let mut q = parser("replay", &["speed", "topic", "skin", "loop"])?;
                let path = q.path("a rosbag2 folder or .mcap file, as in replay:///data/bag")?;
                let speed = q.take_with("speed", "0 (as fast as possible) or a positive factor", |v| {
                    v.parse::<f64>().ok().filter(|s| s.is_finite() && *s >= 0.0)
                })?;
                let topic =
                    q.take_with("topic", "a topic name", |v| (!v.is_empty()).then(|| v.to_owned()))?;
                let skin =
                    q.take_with("skin", "the name of a skin", |v| (!v.is_empty()).then(|| v.to_owned()))?;
                Ok(Self::Replay { path, speed: speed.unwrap_or(1.0), topic, skin, repeat: q.flag("loop")? })
            }
            _ => Err(TransportError::UnknownScheme {
                url: url.into(),
                scheme: scheme.into(),
                valid: SCHEMES.join(", "),
            }),
        }
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

struct Query<'a> {
    url: &'a str,
    target: &'a str,
    keys: BTreeMap<String, String>,
}

impl<'a> Query<'a> {
    fn parse(
        url: &'a str,
        scheme: &'static str,
        target: &'a str,
        query: &str,
        valid: &[&str],
    ) -> Result<Self, TransportError> {
        let mut keys = BTreeMap::new();
        for pair in query.split('&').filter(|p| !p.is_empty()) {
            let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
            if !valid.contains(&key) {
                return Err(TransportError::UnknownKey {
                    url: url.into(),
                    scheme,
                    key: key.into(),
                    valid: valid.join(", "),
                });
            }
            let Some(value) = unescape(value) else {
                return Err(TransportError::InvalidValue {
                    url: url.into(),
                    key: key.into(),
                    value: value.into(),
                    expected: "UTF-8 text with % only in %XX escapes".into(),
                });
            };
            if keys.insert(key.to_owned(), value).is_some() {
                return Err(TransportError::DuplicateKey { url: url.into(), key: key.into() });
            }
        }
        Ok(Self { url, target, keys })
    }

    fn invalid(&self, key: &str, value: &str, expected: &str) -> TransportError {
        TransportError::InvalidValue {
            url: self.url.into(),
            key: key.into(),
            value: value.into(),
            expected: expected.into(),
        }
    }

    fn take_with<T>(
        &mut self,
        key: &str,
        expected: &str,
        read: impl FnOnce(&str) -> Option<T>,
    ) -> Result<Option<T>, TransportError> {
        let Some(value) = self.keys.remove(key) else { return Ok(None) };
        read(&value).map(Some).ok_or_else(|| self.invalid(key, &value, expected))
    }

    fn flag(&mut self, key: &str) -> Result<bool, TransportError> {
        let value = self.take_with(key, "true or false", |v| match v {
            "" | "true" | "1" => Some(true),
            "false" | "0" => Some(false),
            _ => None,
        })?;
        Ok(value.unwrap_or(false))
    }

    fn idle(&mut self) -> Result<Option<Duration>, TransportError> {
        self.idle_or(None)
    }

    fn idle_or(&mut self, default: Option<Duration>) -> Result<Option<Duration>, TransportError> {
        let given = self.take_with("idle", "seconds, 0 (never) or 0.001 to 86400", |v| {
            let seconds = v.parse::<f64>().ok().filter(|s| *s == 0.0 || (0.001..=86_400.0).contains(s))?;
            Duration::try_from_secs_f64(seconds).ok()
        })?;
        Ok(given.map_or(default, |idle| Some(idle).filter(|idle| !idle.is_zero())))
    }

    fn hold(&mut self) -> Result<Duration, TransportError> {
        let given = self.take_with("hold", "seconds, 0.001 to 86400", |v| {
            let seconds = v.parse::<f64>().ok().filter(|s| (0.001..=86_400.0).contains(s))?;
            Duration::try_from_secs_f64(seconds).ok()
        })?;
        Ok(given.unwrap_or(HOLD))
    }

    fn tcp_listen(mut self) -> Result<SourceUrl, TransportError> {
        let newcomer = self.take_with("newcomer", "refuse or replace", |v| match v {
            "refuse" => Some(Newcomer::Refuse),
            "replace" => Some(Newcomer::Replace),
            _ => None,
        })?;
        Ok(SourceUrl::TcpListen {
            bind: self.socket_addr()?,
            newcomer: newcomer.unwrap_or_default(),
            hold: self.hold()?,
            idle: self.idle()?,
        })
    }

    fn target_error(&self, what: &'static str, expected: &str) -> TransportError {
        TransportError::InvalidTarget { url: self.url.into(), what, expected: expected.into() }
    }

    fn path(&self, expected: &str) -> Result<PathBuf, TransportError> {
        match unescape(self.target) {
            Some(path) if !path.is_empty() && !path.contains('\0') => Ok(PathBuf::from(path)),
            _ => Err(self.target_error("path", &format!("expected {expected}"))),
        }
    }

    fn socket_addr(&self) -> Result<SocketAddr, TransportError> {
        self.target.parse().map_err(|_| {
            self.target_error(
                "address",
                "expected ADDRESS:PORT of this machine, as in 0.0.0.0:7400 or [::]:7400",
            )
        })
    }

    fn host_port(&self) -> Result<String, TransportError> {
        let valid = self.target.rsplit_once(':').is_some_and(|(host, port)| {
            !host.is_empty() && !host.contains(['/', '%']) && port.parse::<u16>().is_ok_and(|p| p != 0)
        });
        if valid {
            Ok(self.target.to_owned())
        } else {
            Err(self.target_error("address", "expected HOST:PORT, as in 192.168.1.20:7400"))
        }
    }
}

/// Reads what follows `http://`.
fn http(url: &str, rest: &str) -> Result<SourceUrl, TransportError> {
    let refused = |what, expected: &str| TransportError::InvalidTarget {
        url: url.into(),
        what,
        expected: expected.into(),
    };
    let (host, path) = rest.find(['/', '?']).map_or((rest, ""), |at| rest.split_at(at));
    let path = if path.starts_with('/') { path.to_owned() } else { format!("/{path}") };
    if !path.bytes().all(|byte| byte.is_ascii_graphic() && byte != b'#') {
        return Err(refused(
            "path",
            "write spaces and what is not ASCII as %XX, and leave out what follows `#`",
        ));
    }
    // The colons of an IPv6 address stand in brackets.
    let named = host.rsplit_once(':').filter(|(_, port)| !port.ends_with(']'));
    let (name, port) = named.unwrap_or((host, "80"));
    let valid = !name.is_empty()
        && name.bytes().all(|byte| byte.is_ascii_graphic() && !b"@%\\".contains(&byte))
        && port.parse::<u16>().is_ok_and(|port| port != 0);
    if !valid {
        return Err(refused(
            "address",
            "expected HOST or HOST:PORT without a user's name, as in http://192.168.1.20:8080/?action=stream",
        ));
    }
    Ok(SourceUrl::Http { address: format!("{name}:{port}"), path })
}

fn unescape(text: &str) -> Option<String> {
    let mut out = Vec::with_capacity(text.len());
    let mut bytes = text.bytes();
    while let Some(b) = bytes.next() {
        if b == b'%' {
            let high = char::from(bytes.next()?).to_digit(16)?;
            let low = char::from(bytes.next()?).to_digit(16)?;
            out.push(u8::try_from(high * 16 + low).ok()?);
        } else {
            out.push(b);
        }
    }
    String::from_utf8(out).ok()
}

fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if matches!(c, '%' | '?' | '&' | '=' | '#') || c.is_whitespace() || c.is_control() {
            let mut utf8 = [0; 4];
            for b in c.encode_utf8(&mut utf8).bytes() {
                let _ = write!(out, "%{b:02X}");
            }
        } else {
            out.push(c);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn error(url: &str) -> String {
        SourceUrl::parse(url).unwrap_err().to_string()
    }

    #[test]
    fn reads_every_scheme() {
        assert_eq!(
            SourceUrl::parse("serial:///dev/ttyACM0?baud=921600&parity=even&stop=2&idle=0.5").unwrap(),
            SourceUrl::Serial {
                path: "/dev/ttyACM0".into(),
                baud: 921_600,
                parity: Parity::Even,
                stop_bits: 2,
                idle: Some(Duration::from_millis(500)),
            }
        );
        assert_eq!(
            SourceUrl::parse("udp://[::]:7400?from=fe80::1").unwrap(),
            SourceUrl::Udp {
                bind: "[::]:7400".parse().unwrap(),
                from: Some("fe80::1".parse().unwrap()),
                sender: Sender::One,
                hold: HOLD,
                idle: None
            }
        );
        assert_eq!(
            SourceUrl::parse("udp://0.0.0.0:7400?sender=host&hold=0.25").unwrap(),
            SourceUrl::Udp {
                bind: "0.0.0.0:7400".parse().unwrap(),
                from: None,
                sender: Sender::Host,
                hold: Duration::from_millis(250),
                idle: None
            }
        );
        assert_eq!(
            SourceUrl::parse("tcp://skin.local:7400").unwrap(),
            SourceUrl::Tcp { address: "skin.local:7400".into(), idle: Some(TCP_IDLE) }
        );
        let listen = SourceUrl::TcpListen {
            bind: "0.0.0.0:7400".parse().unwrap(),
            newcomer: Newcomer::Refuse,
            hold: HOLD,
            idle: None,
        };
        assert_eq!(SourceUrl::parse("tcp-listen://0.0.0.0:7400").unwrap(), listen);
        assert_eq!(SourceUrl::parse("tcp://0.0.0.0:7400?listen").unwrap(), listen);
        for (text, address, path) in [
            ("http://cam.local", "cam.local:80", "/"),
            ("http://10.0.0.2:8080/?action=stream&n=1", "10.0.0.2:8080", "/?action=stream&n=1"),
            ("http://[fe80::1]?x", "[fe80::1]:80", "/?x"),
            ("http://[fe80::1]:81/a%20b", "[fe80::1]:81", "/a%20b"),
        ] {
            let url = SourceUrl::Http { address: address.into(), path: path.into() };
            assert_eq!(SourceUrl::parse(text).unwrap(), url);
            assert_eq!(SourceUrl::parse(&url.to_string()).unwrap(), url);
        }
        for wrong in [
            "http://",
            "http:///x",
            "http://me:secret@cam/",
            "http://cam:0/",
            "http://cam/a b",
            "http://cam/#x",
        ] {
            assert!(SourceUrl::parse(wrong).is_err(), "{wrong}");
        }
        assert_eq!(SourceUrl::parse("pty://").unwrap(), SourceUrl::Pty { path: None, link: None });
        assert_eq!(
            SourceUrl::parse("replay:///data/my%20bag?speed=0&topic=/skin/taxels&skin=palm&loop=true")
                .unwrap(),
            SourceUrl::Replay {
                path: "/data/my bag".into(),
                speed: 0.0,
                topic: Some("/skin/taxels".into()),
                skin: Some("palm".into()),
                repeat: true
            }
        );
        assert_eq!(
            SourceUrl::parse("replay://bags/first").unwrap(),
            SourceUrl::Replay {
                path: "bags/first".into(),
                speed: 1.0,
                topic: None,
                skin: None,
                repeat: false
            }
        );
    }

    #[test]
    fn errors_name_the_part_and_what_is_valid() {
        insta::assert_snapshot!(error("/dev/ttyACM0"), @"source `/dev/ttyACM0` is not a URL: write it as SCHEME://…, where SCHEME is one of serial, udp, tcp, tcp-listen, http, pty, replay");
        insta::assert_snapshot!(error("usb:///dev/ttyACM0"), @"source `usb:///dev/ttyACM0` has the unknown scheme `usb`; valid schemes are serial, udp, tcp, tcp-listen, http, pty, replay");
        insta::assert_snapshot!(error("serial:///dev/ttyACM0?baudrate=9600"), @"source `serial:///dev/ttyACM0?baudrate=9600` has the unknown key `baudrate`; valid keys of serial:// are baud, parity, stop, idle");
        insta::assert_snapshot!(error("serial:///dev/ttyACM0?baud=fast"), @"source `serial:///dev/ttyACM0?baud=fast` has baud=fast, but baud must be a rate from 50 to 12000000");
        insta::assert_snapshot!(error("serial://?baud=9600"), @"source `serial://?baud=9600` has no usable path: expected a device file, as in serial:///dev/ttyACM0?baud=115200");
        insta::assert_snapshot!(error("udp://localhost"), @"source `udp://localhost` has no usable address: expected ADDRESS:PORT of this machine, as in 0.0.0.0:7400 or [::]:7400");
        insta::assert_snapshot!(error("tcp://host"), @"source `tcp://host` has no usable address: expected HOST:PORT, as in 192.168.1.20:7400");
        insta::assert_snapshot!(error("udp://0.0.0.0:7400?sender=two"), @"source `udp://0.0.0.0:7400?sender=two` has sender=two, but sender must be one, host or any");
        insta::assert_snapshot!(error("tcp://host:7400?newcomer=replace"), @"source `tcp://host:7400?newcomer=replace` has newcomer=replace, but newcomer must be left out without listen: here no client connects");
        insta::assert_snapshot!(error("tcp-listen://0.0.0.0:1?hold=0"), @"source `tcp-listen://0.0.0.0:1?hold=0` has hold=0, but hold must be seconds, 0.001 to 86400");
        insta::assert_snapshot!(error("replay://b?speed=-1"), @"source `replay://b?speed=-1` has speed=-1, but speed must be 0 (as fast as possible) or a positive factor");
        insta::assert_snapshot!(error("replay://b?speed=1&speed=2"), @"source `replay://b?speed=1&speed=2` gives the key `speed` twice");
    }

    fn any_url() -> impl Strategy<Value = SourceUrl> {
        let idle = || proptest::option::of((1u64..86_400_000).prop_map(Duration::from_millis));
        let hold = || (1u64..86_400_000).prop_map(Duration::from_millis);
        let path = || "/[a-z %?&=é]{1,12}".prop_map(PathBuf::from);
        let addr = || (any::<[u8; 4]>(), any::<u16>()).prop_map(|(ip, port)| SocketAddr::from((ip, port)));
        prop_oneof![
            (path(), 50u32..=12_000_000, 0u8..3, 1u8..=2, idle()).prop_map(
                |(path, baud, p, stop_bits, idle)| {
                    let parity = [Parity::None, Parity::Even, Parity::Odd][usize::from(p)];
                    SourceUrl::Serial { path, baud, parity, stop_bits, idle }
                }
            ),
            (addr(), proptest::option::of(any::<[u8; 4]>()), 0u8..3, hold(), idle()).prop_map(
                |(bind, from, sender, hold, idle)| {
                    let sender = [Sender::One, Sender::Host, Sender::Any][usize::from(sender)];
                    SourceUrl::Udp { bind, from: from.map(IpAddr::from), sender, hold, idle }
                }
            ),
            ("[a-z]{1,8}", 1u16.., idle())
                .prop_map(|(host, port, idle)| SourceUrl::Tcp { address: format!("{host}:{port}"), idle }),
            (addr(), any::<bool>(), hold(), idle()).prop_map(|(bind, replace, hold, idle)| {
                let newcomer = if replace { Newcomer::Replace } else { Newcomer::Refuse };
                SourceUrl::TcpListen { bind, newcomer, hold, idle }
            }),
            proptest::option::of(path()).prop_map(|path| SourceUrl::Pty { path, link: None }),
            path().prop_map(|link| SourceUrl::Pty { path: None, link: Some(link) }),
            (
                path(),
                0.0..100.0,
                proptest::option::of("/[a-z/]{1,9}"),
                proptest::option::of("[a-z_]{1,9}"),
                any::<bool>()
            )
                .prop_map(|(path, speed, topic, skin, repeat)| SourceUrl::Replay {
                    path,
                    speed,
                    topic,
                    skin,
                    repeat
                }),
        ]
    }

    proptest! {
        #[test]
        fn display_reads_back(url in any_url()) {
            prop_assert_eq!(SourceUrl::parse(&url.to_string()).unwrap(), url);
        }

        #[test]
        fn never_panics(text in "(serial|udp|tcp|pty|replay)?(://)?.{0,40}") {
            let _ = SourceUrl::parse(&text);
        }
    }
}
