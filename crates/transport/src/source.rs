//! A byte source that runs by itself: a thread reads, reconnects and reports through a bounded queue. A consumer that waits and is
//! quick reads the link itself ([`handover`]).

mod handover;
mod link;
mod outbox;
mod queue;
mod replay;
mod senders;
mod serial;

use std::io::{PipeReader, PipeWriter};
use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use bytes::Bytes;
use nix::poll::{PollFd, PollFlags, PollTimeout, ppoll};
use nix::sys::time::TimeSpec;
use serde::Serialize;

use crate::SourceUrl;
#[cfg(test)]
use handover::MAX_UNREAD;
use handover::{Handover, OpenLink, Returned};
use link::{Opener, ReadOutcome};
use outbox::{Outbox, Wake};
use queue::{Next, Queue};

/// What a source tells its consumer, in the order in which it happened.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// The next bytes.
    Bytes {
        /// The bytes; one datagram where the source is one of datagrams, else cut anywhere.
        data: Bytes,
        /// \[ns since the Unix epoch\] when they were read.
        received_ns: i64,
    },
    /// Bytes are missing here, because the consumer was too slow: call
    /// [`FrameDecoder::gap`](crate::framing::FrameDecoder::gap).
    Overflow {
        /// \[bytes\] dropped, the oldest first.
        dropped_bytes: u64,
    },
    /// Waiting for a device to connect to this address.
    Listening {
        /// `ADDRESS:PORT` with the port that is really bound.
        endpoint: String,
    },
    /// The link is up.
    Connected {
        /// What it is connected to, for people.
        description: String,
    },
    /// The link is down, or could not be made: call [`FrameDecoder::gap`](crate::framing::FrameDecoder::gap).
    Disconnected {
        /// What happened and what to do, for people.
        reason: String,
        /// The next attempt starts after this time.
        retry_in: Duration,
    },
    /// Another device sends to the same port, or wants to connect.
    OtherSender {
        /// Who it is, what becomes of it and what to do, for people. Comes at most once in a few seconds.
        notice: String,
        /// Whether it is read from now on: call [`FrameDecoder::gap`](crate::framing::FrameDecoder::gap).
        taken_over: bool,
    },
    /// Nothing will come any more: a recording is at its end or cannot be read, or the source was stopped. Every
    /// later event is this one again.
    Ended,
}

/// How a source behaves.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SourceOptions {
    /// \[bytes\] most that wait for the consumer; the oldest are dropped beyond. One datagram may be longer.
    pub queue_bytes: usize,
    /// Most pieces (reads, datagrams) that wait for the consumer.
    pub queue_chunks: usize,
    /// Time before the first attempt to reconnect; each further one waits twice as long, give or take a fifth.
    pub backoff_initial: Duration,
    /// Longest time between two attempts, before the give and take.
    pub backoff_max: Duration,
    /// Longest time that connecting to a server may take.
    pub connect_timeout: Duration,
}

impl Default for SourceOptions {
    /// 1 MiB and 4096 pieces; attempts after 0.05 s, 0.1 s, … 1 s; 3 s to connect.
    fn default() -> Self {
        Self {
            queue_bytes: 1 << 20,
            queue_chunks: 4096,
            // A skin that is plugged in again is to be detected again within a second.
            backoff_initial: Duration::from_millis(50),
            backoff_max: Duration::from_secs(1),
            connect_timeout: Duration::from_secs(3),
        }
    }
}

impl SourceOptions {
    /// Sets the bounds of the queue: \[bytes\] and pieces, at least one piece.
    #[must_use]
    pub fn with_queue(mut self, bytes: usize, chunks: usize) -> Self {
        self.queue_bytes = bytes;
        self.queue_chunks = chunks.max(1);
        self
    }

    /// Sets the first and the longest time between two attempts.
    #[must_use]
    pub fn with_backoff(mut self, initial: Duration, max: Duration) -> Self {
        self.backoff_initial = initial;
        self.backoff_max = max;
        self
    }
}

/// What a source did so far.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct SourceStats {
    /// \[bytes\] read.
    pub bytes: u64,
    /// Pieces (reads, datagrams) read.
    pub chunks: u64,
    /// Times that the link came up.
    pub connects: u64,
    /// Times that an established link went down.
    pub disconnects: u64,
    /// Attempts to connect that failed.
    pub failed_attempts: u64,
    /// \[bytes\] dropped because the consumer was too slow.
    pub dropped_bytes: u64,
    /// Pieces dropped because the consumer was too slow.
    pub dropped_chunks: u64,
    /// \[bytes\] waiting for the consumer.
    pub queued_bytes: usize,
    /// Whether the link is up.
    pub connected: bool,
    /// \[ns since the Unix epoch\] when the last bytes were read, 0 before the first.
    pub last_received_ns: i64,
    /// Why the link is or was down the last time.
    pub last_reason: Option<String>,
    /// The device that is read, where it has an address.
    pub peer: Option<SocketAddr>,
    /// Datagrams of other senders that were left out.
    pub refused_datagrams: u64,
    /// Clients that were refused because another one is connected and sends.
    pub refused_connections: u64,
    /// The latest addresses that something was left out of, a few.
    pub others: Vec<SocketAddr>,
    /// What others connect to or write to: bound address, or the far end of a pseudo-terminal of ours.
    pub endpoint: Option<String>,
}

/// A byte source; dropping it stops its thread and releases the device.
///
/// ```no_run
/// # async fn run() -> Result<(), dermis_transport::TransportError> {
/// use dermis_transport::{Event, Source, SourceOptions, SourceUrl};
/// let source = Source::open(SourceUrl::parse("udp://0.0.0.0:7400")?, SourceOptions::default());
/// loop {
///     match source.next().await {
///         Event::Bytes { data, received_ns } => println!("{} bytes at {received_ns}", data.len()),
///         Event::Disconnected { reason, .. } => eprintln!("{reason}"),
///         Event::Ended => break,
///         _ => {}
///     }
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Source {
    url: SourceUrl,
    queue: Arc<Queue>,
    /// `None` where its thread could not be started.
    reader: Option<Arc<Reader>>,
    stop: Option<PipeWriter>,
    thread: Option<JoinHandle<()>>,
}

impl Source {
    /// Starts to read `url` on a thread of its own. Whatever goes wrong comes as [`Event::Disconnected`], and
    /// is tried again.
    #[must_use]
    pub fn open(url: SourceUrl, options: SourceOptions) -> Self {
        let queue = Arc::new(Queue::new(options.queue_bytes, options.queue_chunks.max(1)));
        let mut source =
            Self { url: url.clone(), queue: queue.clone(), reader: None, stop: None, thread: None };
        let spawned = std::io::pipe().and_then(|(stopped, stop)| {
            let (outbox, wake) = Outbox::new()?;
            let reader = Arc::new(Reader {
                url,
                options,
                queue: queue.clone(),
                outbox,
                wake,
                stop: Stop(stopped),
                busy: AtomicBool::new(false),
                handover: Handover::default(),
            });
            let running = Arc::clone(&reader);
            let thread =
                std::thread::Builder::new().name("dermis-source".into()).spawn(move || running.run())?;
            Ok((stop, reader, thread))
        });
        match spawned {
            Ok((stop, reader, thread)) => {
                source.stop = Some(stop);
                source.reader = Some(reader);
                source.thread = Some(thread);
            }
            Err(e) => {
                let reason = format!("cannot start the reader of {}: {e}", source.url);
                queue.disconnected(reason, Duration::ZERO, false);
                queue.end();
            }
        }
        source
    }

    /// The next event; waits for it. Dropping the future loses nothing.
    pub async fn next(&self) -> Event {
        self.queue.next().await
    }

    /// The next event, or `None` after `timeout`; blocks the thread. A caller who always comes back within a millisecond reads the
    /// line itself while it waits.
    pub fn next_timeout(&self, timeout: Duration) -> Option<Event> {
        let until = Instant::now() + timeout;
        let link = || {
            let reader = self.reader.as_ref()?;
            Some((reader, reader.handover.take()?))
        };
        loop {
            match self.queue.next_until(until, link) {
                Next::Event(event) => return Some(event),
                Next::Nothing => return None,
                Next::Instead((reader, link)) => reader.read_for_consumer(link, until),
            }
        }
    }

    /// Writes to the device, for one that answers requests. The bytes are sent by the source's own thread as soon as the line
    /// takes them; over UDP to the sender that is read. `false` where they do not fit behind what waits already (64 KiB), the link
    /// is down, or the source is a recording: a request that was not sent is made again.
    pub fn send(&self, bytes: &[u8]) -> bool {
        self.reader.as_ref().is_some_and(|reader| reader.outbox.put(bytes))
    }

    /// What was read, dropped and reconnected so far.
    #[must_use]
    pub fn stats(&self) -> SourceStats {
        self.queue.stats()
    }

    /// A handle to [`stats`](Self::stats) for others than the consumer.
    #[must_use]
    pub fn watch(&self) -> SourceWatch {
        SourceWatch(Arc::clone(&self.queue))
    }

    /// Where the bytes come from.
    #[must_use]
    pub fn url(&self) -> &SourceUrl {
        &self.url
    }
}

/// What a source did so far; it outlives the source.
#[derive(Debug, Clone)]
pub struct SourceWatch(Arc<Queue>);

impl SourceWatch {
    /// See [`Source::stats`].
    #[must_use]
    pub fn stats(&self) -> SourceStats {
        self.0.stats()
    }
}

impl Drop for Source {
    fn drop(&mut self) {
        self.queue.close();
        self.stop = None;
        let Some(reader) = &self.reader else { return };
        reader.handover.close();
        // Joined so that the device is free again once the source is gone; but nobody waits for a slow name server.
        if let Some(thread) = self.thread.take()
            && !reader.busy.load(Ordering::Acquire)
        {
            let _ = thread.join();
        }
    }
}

/// The end of a pipe that hangs up when the source is dropped.
#[derive(Debug)]
struct Stop(PipeReader);

impl Stop {
    /// Waits, or says early that it is time to stop.
    fn stopped_within(&self, time: Duration) -> bool {
        let began = Instant::now();
        loop {
            let left = time.saturating_sub(began.elapsed());
            let mut fds = [PollFd::new(self.0.as_fd(), PollFlags::POLLIN)];
            // To the nanosecond: recordings are replayed by it.
            match ppoll(&mut fds, Some(TimeSpec::from_duration(left)), None) {
                Ok(n) if n > 0 => return true,
                Ok(_) if left.is_zero() => return false,
                Ok(_) | Err(nix::Error::EINTR) => {}
                Err(_) => return true,
            }
        }
    }
}

/// Rounded up, so that a wait never spins through the last fraction of a millisecond.
fn poll_timeout(time: Option<Duration>) -> PollTimeout {
    match time {
        Some(time) => {
            let ms = time.as_nanos().div_ceil(1_000_000);
            PollTimeout::from(u16::try_from(ms).unwrap_or(u16::MAX))
        }
        None => PollTimeout::NONE,
    }
}

#[derive(Debug)]
struct Reader {
    url: SourceUrl,
    options: SourceOptions,
    queue: Arc<Queue>,
    outbox: Outbox,
    wake: Wake,
    stop: Stop,
    /// The thread is in a system call that the stop pipe cannot interrupt (connecting, resolving).
    busy: AtomicBool,
    handover: Handover,
}

impl Reader {
    /// Does what the stop pipe cannot interrupt.
    fn while_busy<T>(&self, work: impl FnOnce() -> T) -> T {
        self.busy.store(true, Ordering::Release);
        let done = work();
        self.busy.store(false, Ordering::Release);
        done
    }

    fn run(&self) {
        let _end = EndOnDrop(&self.queue);
        if let SourceUrl::Replay { path, speed, topic, skin, repeat } = &self.url {
            let (topic, skin) = (topic.as_deref(), skin.as_deref());
            let plan = replay::Plan { path, speed: *speed, topic, skin, repeat: *repeat };
            if let Err(reason) = replay::run(&plan, &self.queue, &self.stop) {
                self.queue.disconnected(reason, Duration::ZERO, false);
            }
        } else {
            self.stay_connected();
        }
    }

    fn stay_connected(&self) {
        let mut opener = Opener::new(&self.url);
        let mut backoff = Backoff::new(&self.options);
        loop {
            let opened = opener.open(self);
            if self.stop.stopped_within(Duration::ZERO) {
                return;
            }
            let (reason, was_up) = match opened {
                Ok(Some(link)) => {
                    self.outbox.open();
                    self.queue.connected(link.description());
                    let open = OpenLink { link, opener, buffer: vec![0; self.buffer_size()] };
                    let ended = self.read_until_down(Box::new(open), &mut backoff);
                    self.outbox.close();
                    let Some((opener_again, reason)) = ended else { return };
                    opener = opener_again;
                    (reason, true)
                }
                Ok(None) => return,
                Err(reason) => (reason, false),
            };
            let retry_in = backoff.next();
            self.queue.disconnected(reason, retry_in, was_up);
            if self.stop.stopped_within(retry_in) {
                return;
            }
        }
    }

    /// \[bytes\] A datagram is read whole or its end is lost; a stream can be cut to what the queue takes.
    fn buffer_size(&self) -> usize {
        match &self.url {
            SourceUrl::Udp { .. } => 1 << 16,
            _ => (1 << 14).min(self.options.queue_bytes).max(1),
        }
    }

    /// Reads until the link is down, and says why, or `None` when it is time to stop.
    fn read_until_down(&self, mut open: Box<OpenLink>, backoff: &mut Backoff) -> Option<(Opener, String)> {
        loop {
            let OpenLink { link, opener, buffer } = &mut *open;
            match link.read(buffer, self, opener, None) {
                ReadOutcome::Bytes(n) => {
                    backoff.reset();
                    let quick = self.queue.quick_consumer();
                    self.queue.push(Bytes::copy_from_slice(&buffer[..n]), crate::now_ns());
                    if quick {
                        self.handover.offer(open);
                        // One that waits already looks again.
                        self.queue.nudge();
                        open = match self.handover.returned() {
                            Returned::Unread(open) => open,
                            Returned::Down(opener, reason) => return Some((opener, reason?)),
                            Returned::Closed => return None,
                        };
                    }
                }
                ReadOutcome::Nothing => {}
                ReadOutcome::Down(reason) => return Some((open.opener, reason)),
                ReadOutcome::Stopped => return None,
            }
        }
    }

    /// Reads in the consumer's thread, once.
    fn read_for_consumer(&self, mut open: Box<OpenLink>, until: Instant) {
        let OpenLink { link, opener, buffer } = &mut *open;
        match link.read(buffer, self, opener, Some(until)) {
            ReadOutcome::Bytes(n) => {
                self.queue.push(Bytes::copy_from_slice(&buffer[..n]), crate::now_ns());
                self.handover.offer(open);
            }
            ReadOutcome::Nothing => self.handover.offer(open),
            ReadOutcome::Down(reason) => self.handover.down(open.opener, Some(reason)),
            ReadOutcome::Stopped => self.handover.down(open.opener, None),
        }
    }
}

/// Tells the consumer that nothing will come any more, even where the reader ends by a panic.
struct EndOnDrop<'a>(&'a Queue);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let reason =
                "the reader of this source panicked; the message is on its standard error".to_owned();
            self.0.disconnected(reason, Duration::ZERO, false);
        }
        self.0.end();
    }
}

/// Exponential backoff with jitter, so that many skins on one hub do not all knock at once.
struct Backoff {
    initial: Duration,
    max: Duration,
    current: Duration,
}

impl Backoff {
    fn new(options: &SourceOptions) -> Self {
        let initial = options.backoff_initial.max(Duration::from_millis(1));
        Self { initial, max: options.backoff_max.max(initial), current: initial }
    }

    fn reset(&mut self) {
        self.current = self.initial;
    }

    fn next(&mut self) -> Duration {
        let now = self.current;
        self.current = (now * 2).min(self.max);
        now.mul_f64(0.8 + 0.4 * random_fraction())
    }
}

/// A number from 0 to 1 that differs from process to process, which is all that jitter needs.
fn random_fraction() -> f64 {
    use std::hash::{BuildHasher, RandomState};
    f64::from((RandomState::new().hash_one(0u8) >> 32) as u32) / f64::from(u32::MAX)
}

#[cfg(test)]
mod tests;
