//! Links: what is read once a source is connected, and how each kind is opened.

mod camera;
mod http;

use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, ToSocketAddrs, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::path::Path;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::queue::{Queue, Refused};
use super::senders::{Notices, Senders, Verdict};
use super::serial::{self, Line, Terminal};
use super::{Reader, poll_timeout};
use crate::url::IDLE;
use crate::{Newcomer, Pty, SourceUrl};

/// How a read ended.
pub(super) enum ReadOutcome {
    /// So many bytes are in the buffer, at least one.
    Bytes(usize),
    /// The link is down, for this reason.
    Down(String),
    /// It is time to stop.
    Stopped,
    /// No bytes came in the one wait that was requested.
    Nothing,
}

enum Wire {
    Terminal(Terminal),
    Pty(Pty),
    Udp { socket: UdpSocket, senders: Senders },
    Tcp(TcpStream),
    Http(http::Body),
    Camera(camera::Camera),
}

impl Wire {
    fn fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Terminal(terminal) => terminal.file().as_fd(),
            Self::Pty(pty) => pty.as_fd(),
            Self::Udp { socket, .. } => socket.as_fd(),
            Self::Tcp(stream) => stream.as_fd(),
            Self::Http(body) => body.as_fd(),
            Self::Camera(camera) => camera.as_fd(),
        }
    }

    /// Reads what is there; `None` when that was nothing of interest.
    fn read(&mut self, buffer: &mut [u8], queue: &Queue, name: &str) -> io::Result<Option<usize>> {
        match self {
            Self::Terminal(terminal) => terminal.file().read(buffer).map(Some),
            Self::Pty(pty) => pty.try_read(buffer).map(Some),
            Self::Tcp(stream) => stream.read(buffer).map(Some),
            Self::Http(body) => body.read(buffer).map(Some),
            Self::Camera(camera) => camera.read(buffer),
            Self::Udp { socket, senders } => {
                let (n, sender) = socket.recv_from(buffer)?;
                if n == 0 {
                    return Ok(None);
                }
                let prefixed = |text: String| format!("{name}: {text}");
                match senders.classify(sender, Instant::now()) {
                    Verdict::Read(None) => return Ok(Some(n)),
                    Verdict::Read(Some(first)) => queue.reads(first, None),
                    Verdict::ReadInstead(other, why) => queue.reads(other, Some(prefixed(why))),
                    Verdict::LeaveOut(notice) => {
                        queue.left_out(Refused::Datagram(sender), notice.map(prefixed));
                        return Ok(None);
                    }
                    Verdict::Unrequested => {
                        queue.left_out(Refused::Datagram(sender), None);
                        return Ok(None);
                    }
                }
                Ok(Some(n))
            }
        }
    }

    /// Sends what the line takes now. A socket of datagrams sends to the sender that is read, and nothing before there is one.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Terminal(terminal) => terminal.file().write(bytes),
            Self::Pty(pty) => pty.write_lossy(bytes),
            Self::Tcp(stream) => stream.write(bytes),
            // The request to a web server was sent already, and a camera takes none.
            Self::Http(_) | Self::Camera(_) => Ok(bytes.len()),
            Self::Udp { socket, senders } => match senders.read() {
                Some(peer) => socket.send_to(bytes, peer),
                None => Ok(bytes.len()),
            },
        }
    }

    /// Whether bytes are there that no wait for the line would tell of.
    fn holds(&self) -> bool {
        match self {
            Self::Http(body) => body.holds(),
            Self::Camera(camera) => camera.holds(),
            _ => false,
        }
    }

    /// What the end of the stream, or this error, means to people.
    fn down(&self, name: &str, error: Option<&io::Error>) -> String {
        match (self, error) {
            (Self::Terminal(_) | Self::Pty(_), None) => {
                format!("{name} went away: it was unplugged, or lost power")
            }
            (Self::Terminal(_) | Self::Pty(_) | Self::Camera(_), Some(e))
                if matches!(
                    e.raw_os_error().map(nix::errno::Errno::from_raw),
                    Some(nix::errno::Errno::EIO | nix::errno::Errno::ENXIO | nix::errno::Errno::ENODEV)
                ) =>
            {
                format!("{name} went away: it was unplugged, or lost power")
            }
            (Self::Tcp(_) | Self::Http(_), None) => format!("{name} closed the connection"),
            (_, None) => format!("{name} ended"),
            (_, Some(e)) => format!("cannot read {name}: {e}"),
        }
    }
}

/// An open link.
pub(super) struct Link {
    wire: Wire,
    /// The other end, for messages.
    name: String,
    description: String,
    idle: Option<Duration>,
    last: Instant,
}

impl Link {
    fn new(wire: Wire, name: String, description: String, idle: Option<Duration>) -> Self {
        Self { wire, name, description, idle, last: Instant::now() }
    }

    pub(super) fn description(&self) -> &str {
        &self.description
    }

    /// How long to wait for the line at most; why the link is down, where it is.
    fn patience(
        &self,
        reader: &Reader,
        opener: &mut Opener,
        until: Option<Instant>,
    ) -> Result<Option<Duration>, String> {
        let mut left = self.idle.map(|idle| idle.saturating_sub(self.last.elapsed()));
        if let (Some(idle), Some(Duration::ZERO)) = (self.idle, left) {
            return Err(format!("{} is silent for {idle:?}", self.name));
        }
        match opener.newcomer(self.last, &self.name, &reader.queue) {
            Decision::Nothing => {}
            Decision::In(time) => left = Some(left.map_or(time, |left| left.min(time))),
            Decision::Replace(reason) => return Err(reason),
        }
        if let Some(until) = until {
            let wait = until.saturating_duration_since(Instant::now());
            left = Some(left.map_or(wait, |left| left.min(wait)));
        }
        Ok(if self.wire.holds() { Some(Duration::ZERO) } else { left })
    }

    /// Waits for bytes and reads them. Where a time is named, it waits once and not beyond it: what the wait brought may be an event
    /// that is in the queue now.
    pub(super) fn read(
        &mut self,
        buffer: &mut [u8],
        reader: &Reader,
        opener: &mut Opener,
        until: Option<Instant>,
    ) -> ReadOutcome {
        let mut waited = false;
        loop {
            if waited && until.is_some() {
                return ReadOutcome::Nothing;
            }
            waited = true;
            let left = match self.patience(reader, opener, until) {
                Ok(left) => left,
                Err(reason) => return ReadOutcome::Down(reason),
            };
            let (readable, writable, caller) = {
                let writing = if reader.outbox.is_empty() { PollFlags::empty() } else { PollFlags::POLLOUT };
                let mut fds = vec![
                    PollFd::new(self.wire.fd(), PollFlags::POLLIN | writing),
                    PollFd::new(reader.stop.0.as_fd(), PollFlags::POLLIN),
                    PollFd::new(reader.wake.as_fd(), PollFlags::POLLIN),
                ];
                if let Some(listener) = &opener.listener {
                    fds.push(PollFd::new(listener.as_fd(), PollFlags::POLLIN));
                }
                match poll(&mut fds, poll_timeout(left)) {
                    Ok(_) => {}
                    Err(nix::Error::EINTR) => continue,
                    Err(e) => return ReadOutcome::Down(format!("cannot wait for {}: {e}", self.name)),
                }
                let any = |i: usize| fds.get(i).is_some_and(|fd| fd.any().unwrap_or(true));
                if any(1) {
                    return ReadOutcome::Stopped;
                }
                if any(2) {
                    reader.wake.answer();
                }
                let line = fds.first().and_then(PollFd::revents).unwrap_or(PollFlags::POLLERR);
                (
                    line.intersects(!PollFlags::POLLOUT) || self.wire.holds(),
                    line.contains(PollFlags::POLLOUT),
                    any(3),
                )
            };
            if writable
                && let Err(e) = reader.outbox.send(|bytes| self.wire.write(bytes))
                && !matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
            {
                return ReadOutcome::Down(format!("cannot write to {}: {e}", self.name));
            }
            if caller {
                opener.accept_now(Some(&self.name), &reader.queue);
            }
            if readable {
                match self.wire.read(buffer, &reader.queue, &self.name) {
                    Ok(Some(0)) => return ReadOutcome::Down(self.wire.down(&self.name, None)),
                    Ok(Some(n)) => {
                        self.last = Instant::now();
                        return ReadOutcome::Bytes(n);
                    }
                    Ok(None) => {}
                    Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                    Err(e) => return ReadOutcome::Down(self.wire.down(&self.name, Some(&e))),
                }
            }
        }
    }
}

/// A client that connected while another one is connected.
struct Waiting {
    stream: TcpStream,
    peer: SocketAddr,
    since: Instant,
}

/// What becomes of it.
enum Decision {
    /// There is none.
    Nothing,
    /// That is known after this time.
    In(Duration),
    /// It takes the place of the other one, for this reason.
    Replace(String),
}

/// Opens the link of a URL, again and again; keeps what outlives a link (a bound port).
pub(super) struct Opener {
    url: SourceUrl,
    listener: Option<TcpListener>,
    waiting: Option<Waiting>,
    notices: Notices,
}

impl Opener {
    pub(super) fn new(url: &SourceUrl) -> Self {
        Self { url: url.clone(), listener: None, waiting: None, notices: Notices::default() }
    }

    /// A link, the reason why there is none, or `Ok(None)` when it is time to stop.
    pub(super) fn open(&mut self, reader: &Reader) -> Result<Option<Link>, String> {
        match &self.url {
            SourceUrl::Serial { path, baud, parity, stop_bits, idle } => {
                let line = Line { baud: *baud, parity: *parity, stop_bits: *stop_bits };
                let terminal = serial::open_serial(path, &line)?;
                let description = format!("{} at {baud} baud", path.display());
                Ok(Some(Link::new(Wire::Terminal(terminal), path.display().to_string(), description, *idle)))
            }
            SourceUrl::Pty { path: Some(path), .. } => {
                let terminal = serial::open_plain(path)?;
                let name = path.display().to_string();
                Ok(Some(Link::new(Wire::Terminal(terminal), name.clone(), name, None)))
            }
            SourceUrl::Pty { path: None, link } => {
                let (pty, name) = make_pty(link.as_deref())?;
                reader.queue.set_endpoint(name.clone());
                let description = format!("pseudo-terminal, write to {name}");
                Ok(Some(Link::new(Wire::Pty(pty), name, description, None)))
            }
            SourceUrl::Udp { bind, from, sender, hold, idle } => {
                let socket = bind_udp(*bind).map_err(|e| explain_bind("UDP", *bind, &e))?;
                let local = socket.local_addr().unwrap_or(*bind);
                reader.queue.set_endpoint(local.to_string());
                let description = match from {
                    Some(from) => format!("UDP {local}, from {from}"),
                    None => format!("UDP {local}"),
                };
                let wire = Wire::Udp { socket, senders: Senders::new(*sender, *hold, *from) };
                Ok(Some(Link::new(wire, format!("UDP {local}"), description, *idle)))
            }
            SourceUrl::Tcp { address, idle } => {
                let stream = reader.while_busy(|| connect(address, reader.options.connect_timeout))?;
                let name = format!("TCP {address}");
                Ok(Some(Link::new(Wire::Tcp(stream), name.clone(), name, *idle)))
            }
            SourceUrl::Http { address, path } => {
                let timeout = reader.options.connect_timeout;
                let body = reader
                    .while_busy(|| http::Body::of(connect(address, timeout)?, address, path, timeout))?;
                let name = self.url.to_string();
                Ok(Some(Link::new(Wire::Http(body), name.clone(), name, Some(IDLE))))
            }
            SourceUrl::TcpListen { bind, idle, .. } => {
                let (bind, idle) = (*bind, *idle);
                self.accept(bind, idle, reader)
            }
            SourceUrl::Camera { path, size, rate, idle } => {
                let timeout = reader.options.connect_timeout;
                let (camera, description) =
                    reader.while_busy(|| camera::Camera::open(path, *size, *rate, timeout))?;
                Ok(Some(Link::new(Wire::Camera(camera), path.display().to_string(), description, *idle)))
            }
            SourceUrl::Replay { .. } => Err("a recording is not a link".into()),
        }
    }

    fn accept(
        &mut self,
        bind: SocketAddr,
        idle: Option<Duration>,
        reader: &Reader,
    ) -> Result<Option<Link>, String> {
        if self.listener.is_none() {
            let listen = || {
                let listener = TcpListener::bind(bind)?;
                listener.set_nonblocking(true)?;
                Ok((listener.local_addr()?, listener))
            };
            let (local, listener) = listen().map_err(|e| explain_bind("TCP", bind, &e))?;
            reader.queue.listening(local.to_string());
            self.listener = Some(listener);
        }
        loop {
            self.accept_now(None, &reader.queue);
            if let Some(Waiting { stream, peer, .. }) = self.waiting.take() {
                reader.queue.reads(peer, None);
                let name = format!("TCP client {peer}");
                return Ok(Some(Link::new(Wire::Tcp(stream), name.clone(), name, idle)));
            }
            let Some(listener) = &self.listener else { return Ok(None) };
            let mut fds = [
                PollFd::new(listener.as_fd(), PollFlags::POLLIN),
                PollFd::new(reader.stop.0.as_fd(), PollFlags::POLLIN),
            ];
            match poll(&mut fds, poll_timeout(None)) {
                Ok(_) if fds[1].any().unwrap_or(true) => return Ok(None),
                Ok(_) | Err(nix::Error::EINTR) => {}
                Err(e) => return Err(format!("cannot wait for a client at {bind}: {e}")),
            }
        }
    }

    /// Takes the clients that have called: the newest one waits, and those before it are refused. `other` is connected.
    fn accept_now(&mut self, other: Option<&str>, queue: &Queue) {
        while let Some(Ok((stream, peer))) = self.listener.as_ref().map(TcpListener::accept) {
            if stream.set_nonblocking(true).is_err() {
                continue;
            }
            let newest = Waiting { stream, peer, since: Instant::now() };
            if let Some(before) = self.waiting.replace(newest) {
                self.refuse(&before, other.unwrap_or("a newer one"), queue);
            }
        }
    }

    fn refuse(&mut self, waiting: &Waiting, other: &str, queue: &Queue) {
        let notice = self.notices.count(Instant::now()).map(|more| {
            format!(
                "the connection from {} is refused, because {other} is connected and sends: give each device a port of \
                 its own, or let the newest be the device with newcomer=replace{more}",
                waiting.peer
            )
        });
        queue.left_out(Refused::Client(waiting.peer), notice);
    }

    /// Decides on a client that waits, where the one that is connected sent at `last` for the last time.
    ///
    /// A device that lost power never says goodbye to its old connection, and calls again: its old connection is silent
    /// from then on. A second device, and one that only looks what is there, calls while the first one sends.
    fn newcomer(&mut self, last: Instant, other: &str, queue: &Queue) -> Decision {
        let (Some(waiting), SourceUrl::TcpListen { newcomer, hold, .. }) = (&self.waiting, &self.url) else {
            return Decision::Nothing;
        };
        let replaced = || format!("{other} was replaced by a new connection from {}", waiting.peer);
        if *newcomer == Newcomer::Replace {
            return Decision::Replace(replaced());
        }
        let silent = last.elapsed();
        if silent >= *hold {
            return Decision::Replace(format!(
                "{}: it is silent for {:.1} s",
                replaced(),
                silent.as_secs_f64()
            ));
        }
        // What had arrived before it called may be read after.
        if last > waiting.since + *hold / 10 {
            if let Some(waiting) = self.waiting.take() {
                self.refuse(&waiting, other, queue);
            }
            return Decision::Nothing;
        }
        Decision::In(*hold - silent)
    }
}

fn make_pty(link: Option<&Path>) -> Result<(Pty, String), String> {
    let mut pty = Pty::open().map_err(|e| e.to_string())?;
    let mut name = pty.slave_path().display().to_string();
    if let Some(link) = link {
        pty.link(link).map_err(|e| e.to_string())?;
        name = link.display().to_string();
    }
    Ok((pty, name))
}

fn bind_udp(address: SocketAddr) -> io::Result<UdpSocket> {
    let group = address.ip();
    let local = match group {
        IpAddr::V4(ip) if ip.is_multicast() => SocketAddr::from((Ipv4Addr::UNSPECIFIED, address.port())),
        IpAddr::V6(ip) if ip.is_multicast() => SocketAddr::from((Ipv6Addr::UNSPECIFIED, address.port())),
        _ => address,
    };
    let socket = UdpSocket::bind(local)?;
    match group {
        IpAddr::V4(ip) if ip.is_multicast() => socket.join_multicast_v4(&ip, &Ipv4Addr::UNSPECIFIED)?,
        IpAddr::V6(ip) if ip.is_multicast() => socket.join_multicast_v6(&ip, 0)?,
        _ => {}
    }
    socket.set_nonblocking(true)?;
    Ok(socket)
}

fn connect(address: &str, timeout: Duration) -> Result<TcpStream, String> {
    let resolved: Vec<SocketAddr> =
        address.to_socket_addrs().map_err(|e| format!("cannot resolve {address}: {e}"))?.collect();
    let mut last = format!("cannot resolve {address}: the name has no address");
    for candidate in resolved {
        match TcpStream::connect_timeout(&candidate, timeout.max(Duration::from_millis(1))) {
            Ok(stream) => match stream.set_nonblocking(true) {
                Ok(()) => return Ok(stream),
                Err(e) => last = format!("cannot use the connection to {candidate}: {e}"),
            },
            Err(e) => {
                last = match e.kind() {
                    ErrorKind::ConnectionRefused => {
                        format!("{address} refuses the connection: nothing listens on that port")
                    }
                    ErrorKind::TimedOut => format!(
                        "{address} does not answer within {timeout:?}: check its power, its cable and the address"
                    ),
                    ErrorKind::HostUnreachable | ErrorKind::NetworkUnreachable => {
                        format!("{address} cannot be reached from this network: {e}")
                    }
                    _ => format!("cannot connect to {address}: {e}"),
                };
            }
        }
    }
    Err(last)
}

fn explain_bind(protocol: &str, address: SocketAddr, error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::AddrInUse => {
            format!("{protocol} port {} is in use by another program (ss -lnp names it)", address.port())
        }
        ErrorKind::AddrNotAvailable => {
            format!("{} is no address of this machine; use 0.0.0.0 for all of them", address.ip())
        }
        ErrorKind::PermissionDenied => {
            format!("{protocol} port {} needs privileges; use one from 1024 up", address.port())
        }
        _ => format!("cannot bind {protocol} {address}: {error}"),
    }
}
