//! Sources over real pseudo-terminals and sockets: what a day in the life of a plug does to them.

#![expect(clippy::unwrap_used, reason = "a panic in a test is its failure report")]

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::path::Path;
use std::time::{Duration, Instant};

use dermis_transport::framing::{
    AsciiDecoder, AsciiOptions, DecodedFrame, FrameDecoder, NativeDecoder, NativeEncoder, NativeFormat,
};
use dermis_transport::{Event, Pty, Source, SourceOptions, SourceUrl};

const PATIENCE: Duration = Duration::from_secs(20);
const CHANNELS: usize = 16;

fn quick() -> SourceOptions {
    SourceOptions::default().with_backoff(Duration::from_millis(5), Duration::from_millis(50))
}

fn open(url: &str) -> Source {
    Source::open(SourceUrl::parse(url).unwrap(), quick())
}

fn values(sequence: u32) -> Vec<f32> {
    (0..CHANNELS).map(|i| sequence as f32 + i as f32 / 16.0).collect()
}

fn frame(sequence: u32) -> Vec<u8> {
    let mut encoder = NativeEncoder::new(NativeFormat::F32);
    encoder.encode(sequence, 1 + u64::from(sequence) * 1000, &values(sequence)).unwrap().to_vec()
}

/// A consumer: decodes what a source yields, and keeps what it says about the link.
struct Consumer {
    source: Source,
    decoder: Box<dyn FrameDecoder>,
    frames: Vec<DecodedFrame>,
    connected: u32,
    reasons: Vec<String>,
    notices: Vec<(String, bool)>,
    overflows: u64,
    ended: bool,
}

impl Consumer {
    fn new(source: Source) -> Self {
        Self::with(source, NativeDecoder::new(Some(CHANNELS)))
    }

    fn with(source: Source, decoder: impl FrameDecoder + 'static) -> Self {
        Self {
            source,
            decoder: Box::new(decoder),
            frames: Vec::new(),
            connected: 0,
            reasons: Vec::new(),
            notices: Vec::new(),
            overflows: 0,
            ended: false,
        }
    }

    fn step(&mut self, timeout: Duration) -> bool {
        match self.source.next_timeout(timeout) {
            Some(Event::Bytes { data, received_ns }) => {
                self.decoder.push(&data, received_ns, &mut self.frames);
            }
            Some(Event::Overflow { .. }) => {
                self.overflows += 1;
                self.decoder.gap();
            }
            Some(Event::Connected { .. }) => self.connected += 1,
            Some(Event::Disconnected { reason, .. }) => {
                self.decoder.gap();
                self.reasons.push(reason);
            }
            Some(Event::OtherSender { notice, taken_over }) => {
                if taken_over {
                    self.decoder.gap();
                }
                self.notices.push((notice, taken_over));
            }
            Some(Event::Ended) => self.ended = true,
            Some(_) => {}
            None => return false,
        }
        true
    }

    /// Takes events until `done`, and fails where that does not come.
    #[track_caller]
    fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let deadline = Instant::now() + PATIENCE;
        while !done(self) {
            assert!(
                Instant::now() < deadline && !self.ended,
                "never came: {what}; {} frames, reasons {:?}, {:?}, {:?}",
                self.frames.len(),
                self.reasons,
                self.source.stats(),
                self.decoder.stats(),
            );
            self.step(Duration::from_millis(50));
        }
    }

    /// All values are those that were sent with their number.
    #[track_caller]
    fn assert_true(&self) {
        for frame in &self.frames {
            let sent = frame.values[0] as u32;
            assert_eq!(frame.values, values(sent), "frame {}", frame.sequence);
        }
    }
}

/// Waits for a condition that no event announces.
#[track_caller]
fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "never came: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn link_in(folder: &Path) -> String {
    folder.join("skin").display().to_string()
}

#[test]
fn unplugged_in_the_middle_of_a_frame_and_plugged_in_again() {
    for scheme in ["serial", "pty"] {
        let folder = tempfile::tempdir().unwrap();
        let link = link_in(folder.path());
        let plug = || {
            let mut pty = Pty::open().unwrap();
            pty.link(&link).unwrap();
            pty
        };
        let mut device = plug();
        let mut consumer = Consumer::new(open(&format!("{scheme}://{link}")));
        consumer.until("connected", |c| c.connected == 1);
        for i in 0..5 {
            device.write_all(&frame(i)).unwrap();
        }
        device.write_all(&frame(5)[..40]).unwrap();
        consumer.until("5 frames", |c| c.frames.len() == 5);
        drop(device);
        consumer.until("the loss is noticed", |c| !c.reasons.is_empty());
        assert_eq!(consumer.reasons[0], format!("{link} went away: it was unplugged, or lost power"));
        consumer.until("a failed attempt", |c| c.reasons.len() > 1);
        assert!(consumer.reasons[1].starts_with(&format!("no such device {link}")), "{:?}", consumer.reasons);

        // The device comes back as another pseudo-terminal, in the middle of a frame, and having started again.
        let mut device = plug();
        consumer.until("connected again", |c| c.connected == 2);
        device.write_all(&frame(900)[33..]).unwrap();
        for i in 0..5 {
            device.write_all(&frame(i)).unwrap();
        }
        consumer.until("5 more frames", |c| c.frames.len() == 10);
        consumer.assert_true();
        let numbers: Vec<u64> = consumer.frames.iter().map(|f| f.sequence).collect();
        assert_eq!(numbers, (0..10).collect::<Vec<_>>(), "numbers go on over a restart");
        let stats = consumer.decoder.stats();
        assert_eq!((stats.restarts, stats.rejected.partial, stats.rejected.total()), (1, 1, 0));
        let stats = consumer.source.stats();
        assert_eq!((stats.connects, stats.disconnects), (2, 1));
        assert!(stats.failed_attempts >= 1 && stats.connected);
    }
}

#[test]
fn a_line_that_a_quick_consumer_reads_itself_is_emptied_while_it_is_away() {
    let mut device = Pty::open().unwrap();
    let mut consumer = Consumer::new(open(&format!("serial://{}", device.slave_path().display())));
    consumer.until("the link", |c| c.connected == 1);
    let mut sent = 0;
    for round in 1..=3 {
        // One at a time: the consumer waits for each, and reads it in its own thread.
        for _ in 0..50 {
            device.write_all(&frame(sent)).unwrap();
            sent += 1;
            let all = sent as usize;
            consumer.until("a frame", |c| c.frames.len() == all);
        }
        // More than a terminal holds, while nobody waits: the writer would hang.
        let away = sent + 200;
        for sequence in sent..away {
            device.write_all(&frame(sequence)).unwrap();
        }
        sent = away;
        let bytes = (0..sent).map(|i| frame(i).len() as u64).sum::<u64>();
        wait_for("the bytes", || (consumer.source.stats().bytes == bytes).then_some(()));
        let all = sent as usize;
        consumer.until("the frames from before", |c| c.frames.len() == all);
        assert_eq!(consumer.overflows, 0, "round {round}");
    }
    consumer.assert_true();
    drop(device);
    consumer.until("the end of the line, though no thread reads it", |c| c.reasons.len() == 1);
}

#[test]
fn a_device_that_is_not_there_yet_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let link = link_in(folder.path());
    let mut consumer = Consumer::new(open(&format!("serial://{link}?baud=921600")));
    consumer.until("three attempts", |c| c.reasons.len() >= 3);
    let mut device = Pty::open().unwrap();
    device.link(&link).unwrap();
    consumer.until("connected", |c| c.connected == 1);
    device.write_all(&frame(1)).unwrap();
    consumer.until("a frame", |c| c.frames.len() == 1);
}

#[test]
fn a_device_in_use_is_named_and_taken_once_free() {
    let device = Pty::open().unwrap();
    let url = format!("serial://{}", device.slave_path().display());
    let mut first = Consumer::new(open(&url));
    first.until("connected", |c| c.connected == 1);
    let mut second = Consumer::new(open(&url));
    second.until("refused", |c| !c.reasons.is_empty());
    assert!(second.reasons[0].contains("is in use by another program"), "{:?}", second.reasons);
    drop(first);
    second.until("connected", |c| c.connected == 1);
}

#[test]
fn noise_on_the_line_costs_the_frames_it_hits_and_no_others() {
    let mut device = Pty::open().unwrap();
    let mut consumer = Consumer::new(open(&format!("serial://{}", device.slave_path().display())));
    consumer.until("connected", |c| c.connected == 1);
    let mut random = 1u32;
    let mut next = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        random >> 8
    };
    let mut hit = 0;
    for i in 0..1000 {
        let mut bytes = frame(i);
        if i % 10 == 3 {
            // A burst of up to 20 wrong bytes, never over the end of the frame.
            let from = next() as usize % (bytes.len() - 21);
            for byte in &mut bytes[from..from + 1 + next() as usize % 20] {
                *byte ^= 1 + (next() % 255) as u8;
            }
            hit += 1;
        }
        device.write_all(&bytes).unwrap();
        while consumer.step(Duration::ZERO) {}
    }
    consumer.until("the last frame", |c| c.frames.last().is_some_and(|f| f.sequence == 999));
    consumer.assert_true();
    let stats = consumer.decoder.stats();
    assert_eq!(stats.frames, 1000 - hit);
    assert_eq!(stats.lost, hit);
    assert!(stats.rejected.total() >= hit, "{stats:?}");
    assert_eq!(stats.resyncs, hit);
}

#[test]
fn ten_times_overspeed_loses_the_oldest_counted_and_never_grows() {
    let mut device = Pty::open().unwrap();
    let url = SourceUrl::parse(&format!("pty://{}", device.slave_path().display())).unwrap();
    let limit = 16 << 10;
    let source = Source::open(url, quick().with_queue(limit, 64));
    let mut consumer = Consumer::new(source);
    consumer.until("connected", |c| c.connected == 1);
    // The device sends ten bytes for every one that the consumer takes.
    let total = 5000u32;
    let mut sent = 0u64;
    for i in 0..total {
        let bytes = frame(i);
        device.write_all(&bytes).unwrap();
        sent += bytes.len() as u64;
        if consumer.decoder.stats().bytes < sent / 10 {
            consumer.step(Duration::ZERO);
        }
        assert!(consumer.source.stats().queued_bytes <= limit);
    }
    wait_for("everything is read", || (consumer.source.stats().bytes == sent).then_some(()));
    while consumer.step(Duration::ZERO) {}
    let stats = consumer.source.stats();
    assert!(stats.dropped_bytes > 0 && stats.dropped_chunks > 0 && consumer.overflows > 0, "{stats:?}");
    assert_eq!(consumer.decoder.stats().bytes + stats.dropped_bytes, sent, "every byte is accounted for");
    // The newest survive, and what is missing is counted as lost, never handed out damaged.
    assert_eq!(consumer.frames.last().unwrap().sequence, u64::from(total) - 1);
    consumer.assert_true();
    let frames = consumer.decoder.stats();
    assert_eq!(
        frames.frames + frames.lost,
        consumer.frames.last().unwrap().sequence - consumer.frames[0].sequence + 1
    );
    assert_eq!(frames.rejected.total(), 0, "cut frames at a known hole are no fault of the device");
}

/// What a receiver sees that samples a 460800 baud line at 921600: every bit twice, cut into bytes anew.
fn at_twice_the_rate(bytes: &[u8]) -> Vec<u8> {
    let mut bits = Vec::new();
    for byte in bytes {
        bits.push(false);
        bits.extend((0..8).map(|i| byte >> i & 1 == 1));
        bits.push(true);
    }
    let sampled: Vec<bool> = bits.iter().flat_map(|b| [*b, *b]).collect();
    let mut out = Vec::new();
    let mut at = 0;
    while at + 10 <= sampled.len() {
        if sampled[at] {
            at += 1; // the line rests
            continue;
        }
        out.push((0..8u8).fold(0, |byte, i| byte | u8::from(sampled[at + 1 + usize::from(i)]) << i));
        at += 10;
    }
    out
}

#[test]
fn a_wrong_baud_rate_is_diagnosed() {
    let mut device = Pty::open().unwrap();
    let url = format!("serial://{}?baud=921600", device.slave_path().display());
    let mut consumer = Consumer::new(open(&url));
    consumer.until("connected", |c| c.connected == 1);
    let mut i = 0;
    let diagnosis = wait_for("a diagnosis", || {
        device.write_all(&at_twice_the_rate(&frame(i))).unwrap();
        i += 1;
        while consumer.step(Duration::from_millis(1)) {}
        consumer.decoder.stats().diagnosis(Some(consumer.source.url()))
    });
    assert!(consumer.frames.is_empty());
    assert!(
        diagnosis
            .contains("wrong baud rate (921600 set) or a device that speaks another protocol; first bytes: "),
        "{diagnosis}"
    );
}

#[test]
fn a_foreign_device_is_diagnosed() {
    let mut device = Pty::open().unwrap();
    let url = format!("serial://{}", device.slave_path().display());
    let mut consumer = Consumer::with(open(&url), AsciiDecoder::new(AsciiOptions::channels(4)));
    consumer.until("connected", |c| c.connected == 1);
    let diagnosis = wait_for("a diagnosis", || {
        device
            .write_all(b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n")
            .unwrap();
        while consumer.step(Duration::from_millis(1)) {}
        consumer.decoder.stats().diagnosis(Some(consumer.source.url()))
    });
    assert!(consumer.frames.is_empty());
    assert!(diagnosis.contains("it is probably another device; it begins with \"$GPRMC"), "{diagnosis}");
}

#[test]
fn lines_of_numbers_over_a_serial_line_in_pieces() {
    let mut device = Pty::open().unwrap();
    let url = format!("serial://{}?baud=115200", device.slave_path().display());
    let options = AsciiOptions::channels(3).with_sequence();
    let mut consumer = Consumer::with(open(&url), AsciiDecoder::new(options));
    consumer.until("connected", |c| c.connected == 1);
    // The first line is half, the rest comes in pieces that end anywhere.
    let mut text = String::from("5,1013.2,1013.1\r\n");
    for i in 7..107 {
        text.push_str(&format!("{i},{}.5,-2e-1,3\r\n", 1000 + i));
    }
    for piece in text.as_bytes().chunks(7) {
        device.write_all(piece).unwrap();
    }
    consumer.until("100 lines", |c| c.frames.len() == 100);
    for (i, frame) in (7u16..).zip(&consumer.frames) {
        assert_eq!(frame.sequence, u64::from(i));
        assert_eq!(frame.values, [f32::from(1000 + i) + 0.5, -0.2, 3.0]);
    }
    assert_eq!(consumer.decoder.stats().rejected.total(), 0);
}

#[test]
fn a_tcp_server_that_restarts_is_found_again() {
    let server = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = server.local_addr().unwrap();
    let mut consumer = Consumer::new(open(&format!("tcp://{address}")));
    let (mut device, _) = server.accept().unwrap();
    device.write_all(&frame(0)).unwrap();
    device.write_all(&frame(1)[..20]).unwrap();
    consumer.until("a frame", |c| c.frames.len() == 1);
    drop((device, server));
    consumer.until("the loss", |c| !c.reasons.is_empty());
    assert!(consumer.reasons[0].contains(&address.to_string()), "{:?}", consumer.reasons);
    consumer.until("refused", |c| c.reasons.iter().any(|r| r.contains("nothing listens on that port")));

    let server = wait_for("the port is free", || TcpListener::bind(address).ok());
    let (mut device, _) = server.accept().unwrap();
    device.write_all(&frame(9)).unwrap();
    consumer.until("a frame", |c| c.frames.len() == 2);
    consumer.assert_true();
    assert_eq!(consumer.frames[1].sequence, 9);
}

#[test]
fn a_web_stream_is_read_behind_its_head_and_asked_for_again() {
    let server = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = server.local_addr().unwrap();
    let mut consumer = Consumer::new(open(&format!("http://{address}/?action=stream")));
    // The head and half a frame in one piece, the rest in pieces that end anywhere.
    let answer = |pieces: &[&[u8]]| {
        let (mut device, _) = server.accept().unwrap();
        let mut request = Vec::new();
        while !request.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            device.read_exact(&mut byte).unwrap();
            request.push(byte[0]);
        }
        pieces.iter().for_each(|piece| device.write_all(piece).unwrap());
        (device, String::from_utf8(request).unwrap())
    };
    let first = frame(0);
    let head = b"HTTP/1.0 200 OK\r\nContent-Type: application/octet-stream\r\n\r\n";
    let (device, request) =
        answer(&[&[&head[..], &first[..10]].concat(), &first[10..], &frame(1), &frame(2)[..7]]);
    assert!(request.starts_with("GET /?action=stream HTTP/1.0\r\n"), "{request}");
    assert!(request.contains(&format!("Host: {address}\r\n")), "{request}");
    consumer.until("two frames", |c| c.frames.len() == 2);
    drop(device);
    consumer.until("the loss", |c| !c.reasons.is_empty());
    assert!(consumer.reasons[0].ends_with("closed the connection"), "{:?}", consumer.reasons);

    // Its path is gone for a while.
    drop(answer(&[b"HTTP/1.1 503 Service Unavailable\r\n\r\n"]));
    consumer.until("refused", |c| c.reasons.iter().any(|r| r.contains("answers 503 Service Unavailable")));
    let (_device, _) = answer(&[&head[..], &frame(9)]);
    consumer.until("a frame", |c| c.frames.len() == 3);
    consumer.assert_true();
}

#[test]
fn a_silent_tcp_server_is_left_after_the_idle_time() {
    let server = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = server.local_addr().unwrap();
    let mut consumer = Consumer::new(open(&format!("tcp://{address}?idle=0.05")));
    let (_silent, _) = server.accept().unwrap();
    consumer.until("silence is noticed", |c| !c.reasons.is_empty());
    assert_eq!(consumer.reasons[0], format!("TCP {address} is silent for 50ms"));
    let (mut device, _) = server.accept().unwrap();
    device.write_all(&frame(3)).unwrap();
    consumer.until("a frame", |c| c.frames.len() == 1);
}

#[test]
fn tcp_clients_come_and_go_and_one_that_lost_power_is_replaced() {
    let mut consumer = Consumer::new(open("tcp-listen://127.0.0.1:0?hold=0.2"));
    let address = wait_for("listening", || consumer.source.stats().endpoint);
    let mut first = TcpStream::connect(&address).unwrap();
    first.write_all(&frame(0)).unwrap();
    consumer.until("a frame", |c| c.frames.len() == 1);
    drop(first);
    consumer.until("the loss", |c| c.reasons.len() == 1);
    assert!(consumer.reasons[0].ends_with("closed the connection"), "{:?}", consumer.reasons);

    // This one loses power: its connection stays open and silent, and the device calls again.
    let mut dead = TcpStream::connect(&address).unwrap();
    dead.write_all(&frame(1)[..50]).unwrap();
    consumer.until("connected", |c| c.connected == 2);
    let mut device = TcpStream::connect(&address).unwrap();
    device.write_all(&frame(2)).unwrap();
    consumer.until("a frame", |c| c.frames.len() == 2);
    assert!(consumer.reasons[1].contains("was replaced by a new connection from"), "{:?}", consumer.reasons);
    consumer.assert_true();
    // The dead one is let go.
    dead.set_read_timeout(Some(PATIENCE)).unwrap();
    assert!(matches!(dead.read(&mut [0; 1]), Ok(0) | Err(_)));
}

/// A device that sends a frame every 2 ms, counting from `first`, until it is dropped or its line is closed.
struct Sending {
    stop: std::sync::Arc<std::sync::atomic::AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Sending {
    fn start(first: u32, mut send: impl FnMut(&[u8]) -> bool + Send + 'static) -> Self {
        let stop = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
        let stopped = std::sync::Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            for i in first.. {
                if stopped.load(std::sync::atomic::Ordering::Acquire) || !send(&frame(i)) {
                    return;
                }
                std::thread::sleep(Duration::from_millis(2));
            }
        });
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        self.stop.store(true, std::sync::atomic::Ordering::Release);
        self.thread.take().unwrap().join().unwrap();
    }
}

/// Whether frames came from the first device (numbers below a million) and from the second.
fn heard_from(frames: &[DecodedFrame]) -> [bool; 2] {
    let second = |f: &DecodedFrame| f.values[0] >= 1e6;
    [frames.iter().any(|f| !second(f)), frames.iter().any(second)]
}

#[test]
fn a_client_that_sends_is_not_thrown_out_by_a_new_one() {
    for (option, stays) in [("", true), ("&newcomer=replace", false)] {
        // Longer than a loaded machine may keep a sender from sending.
        let mut consumer = Consumer::new(open(&format!("tcp-listen://127.0.0.1:0?hold=3{option}")));
        let address = wait_for("listening", || consumer.source.stats().endpoint);
        let mut first = TcpStream::connect(&address).unwrap();
        let _first = Sending::start(0, move |bytes| first.write_all(bytes).is_ok());
        consumer.until("frames", |c| c.frames.len() > 10);
        let mut second = TcpStream::connect(&address).unwrap();
        let caller = second.local_addr().unwrap();
        if stays {
            consumer.until("refusal", |c| !c.notices.is_empty());
            let (notice, taken_over) = &consumer.notices[0];
            assert!(
                notice.starts_with(&format!("the connection from {caller} is refused, because TCP client ")),
                "{notice}"
            );
            assert!(!taken_over && consumer.reasons.is_empty(), "{:?}", consumer.reasons);
            second.set_read_timeout(Some(PATIENCE)).unwrap();
            assert!(matches!(second.read(&mut [0; 1]), Ok(0) | Err(_)), "it is told by its end");
            let before = consumer.frames.len();
            consumer.until("the first goes on", |c| c.frames.len() > before + 10);
            let stats = consumer.source.stats();
            assert_eq!((stats.refused_connections, stats.others), (1, vec![caller]));
        } else {
            consumer.until("the change", |c| c.connected == 2);
            assert!(
                consumer.reasons[0].contains(&format!("was replaced by a new connection from {caller}")),
                "{:?}",
                consumer.reasons
            );
            second.write_all(&frame(1_000_000)).unwrap();
            consumer.until("the second is heard", |c| heard_from(&c.frames)[1]);
        }
        consumer.assert_true();
    }
}

#[test]
fn two_senders_on_one_port_are_named_and_not_mixed() {
    let mut consumer = Consumer::new(open("udp://127.0.0.1:0?hold=1"));
    consumer.until("bound", |c| c.connected == 1);
    let address = consumer.source.stats().endpoint.unwrap();
    let sender = |first: u32| {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let (own, to) = (socket.local_addr().unwrap(), address.clone());
        (own, Sending::start(first, move |bytes| socket.send_to(bytes, &to).is_ok()))
    };
    let (one, first) = sender(0);
    consumer.until("frames", |c| c.frames.len() > 10);
    let (two, _second) = sender(1_000_000);
    consumer.until("it is noticed", |c| !c.notices.is_empty());
    let (notice, taken_over) = &consumer.notices[0];
    assert!(
        notice.contains(&format!("datagrams of {two} are left out, because {one} sends to the same port")),
        "{notice}"
    );
    assert!(!taken_over);
    let more = consumer.frames.len() + 50;
    consumer.until("the first goes on", |c| c.frames.len() > more);
    let stats = consumer.source.stats();
    assert!(stats.refused_datagrams > 0, "{stats:?}");
    assert_eq!((stats.peer, stats.others), (Some(one), vec![two]));
    assert_eq!(heard_from(&consumer.frames), [true, false]);

    drop(first);
    consumer.until("the second takes over", |c| heard_from(&c.frames)[1]);
    let (notice, taken_over) = consumer.notices.last().unwrap();
    assert!(
        notice.contains(&format!("{two} is read from now on: {one}, which was read, is silent for 1.")),
        "{notice}"
    );
    assert!(taken_over);
    consumer.assert_true();
    let first_of_second = consumer.frames.iter().position(|f| f.values[0] >= 1e6).unwrap();
    assert!(
        consumer.frames[first_of_second..].iter().all(|f| f.values[0] >= 1e6),
        "not one frame in between"
    );
    assert_eq!(consumer.decoder.stats().rejected.total(), 0);
}

#[test]
fn a_device_with_a_new_port_for_every_datagram_can_be_read() {
    let mut consumer = Consumer::new(open("udp://127.0.0.1:0?sender=host"));
    consumer.until("bound", |c| c.connected == 1);
    let address = consumer.source.stats().endpoint.unwrap();
    for i in 0..20 {
        UdpSocket::bind("127.0.0.1:0").unwrap().send_to(&frame(i), &address).unwrap();
    }
    consumer.until("all frames", |c| c.frames.len() == 20);
    assert_eq!(consumer.source.stats().refused_datagrams, 0);
}

#[test]
fn a_killed_reader_does_not_lock_the_next_one_out_of_a_pseudo_terminal() {
    // The mark that keeps others from opening a line stays on a pseudo-terminal that its device holds open: nobody takes
    // it off where the reader is killed. That it does no harm shows to users without privileges only.
    use std::os::fd::AsRawFd as _;
    let device = Pty::open().unwrap();
    let source = open(&format!("serial://{}", device.slave_path().display()));
    wait_for("connected", || source.stats().connected.then_some(()));
    let opened = std::fs::File::open(device.slave_path()).unwrap();
    let mut exclusive: i32 = 1;
    // SAFETY: the descriptor is open, and the pointer is to a live number.
    let asked = unsafe { nix::libc::ioctl(opened.as_raw_fd(), nix::libc::TIOCGEXCL, &raw mut exclusive) };
    assert_eq!((asked, exclusive), (0, 0));
}

#[test]
fn lost_and_overtaking_datagrams_are_counted() {
    let mut consumer = Consumer::new(open("udp://127.0.0.1:0"));
    consumer.until("bound", |c| c.connected == 1);
    let address = consumer.source.stats().endpoint.unwrap();
    let device = UdpSocket::bind("127.0.0.1:0").unwrap();
    for i in (0..100).filter(|i| i % 7 != 3) {
        // 50 and 51 change places.
        let i = match i {
            50 => 51,
            51 => 50,
            i => i,
        };
        device.send_to(&frame(i), &address).unwrap();
        while consumer.step(Duration::ZERO) {}
    }
    consumer.until("the last frame", |c| c.frames.last().is_some_and(|f| f.sequence == 99));
    consumer.assert_true();
    let stats = consumer.decoder.stats();
    let dropped = (0..100).filter(|i| i % 7 == 3).count() as u64;
    assert_eq!(stats.late, 1);
    assert_eq!((stats.lost, stats.frames), (dropped + 1, 100 - dropped - 1));
    assert_eq!((stats.rejected.total(), stats.restarts), (0, 0));
}

#[test]
fn frames_longer_than_a_datagram_come_over_udp() {
    const LONG: usize = 784;
    let mut consumer = Consumer::with(open("udp://127.0.0.1:0"), NativeDecoder::new(Some(LONG)));
    consumer.until("bound", |c| c.connected == 1);
    let to = consumer.source.stats().endpoint.unwrap();
    let device = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut encoder = NativeEncoder::new(NativeFormat::F32);
    for sequence in 0..20_u32 {
        let values: Vec<f32> = (0..LONG).map(|i| (sequence * 1000) as f32 + i as f32).collect();
        let mut part = 0;
        encoder
            .encode_parts(sequence, 1 + u64::from(sequence) * 1000, &values, 1472, |bytes| {
                // The second part of frame 7 is lost.
                if (sequence, part) != (7, 1) {
                    device.send_to(bytes, &to).unwrap();
                }
                part += 1;
            })
            .unwrap();
        assert_eq!(part, 3);
        while consumer.step(Duration::ZERO) {}
    }
    consumer.until("all frames but one", |c| c.frames.len() == 19);
    for frame in &consumer.frames {
        assert_eq!(
            (frame.values.len(), frame.values[LONG - 1]),
            (LONG, (frame.sequence * 1000 + 783) as f32)
        );
    }
    let stats = consumer.decoder.stats();
    assert_eq!((stats.lost, stats.incomplete, stats.lost_parts, stats.rejected.total()), (1, 1, 1, 0));
}

#[test]
fn datagrams_of_others_are_not_taken() {
    let mut consumer = Consumer::new(open("udp://127.0.0.1:0?from=127.0.0.2"));
    consumer.until("bound", |c| c.connected == 1);
    let address = consumer.source.stats().endpoint.unwrap();
    UdpSocket::bind("127.0.0.1:0").unwrap().send_to(&frame(1), &address).unwrap();
    UdpSocket::bind("127.0.0.2:0").unwrap().send_to(&frame(2), &address).unwrap();
    consumer.until("a frame", |c| !c.frames.is_empty());
    assert_eq!(consumer.frames[0].sequence, 2);
}

#[test]
fn a_port_in_use_is_named() {
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let mut consumer = Consumer::new(open(&format!("udp://127.0.0.1:{port}")));
    consumer.until("refused", |c| !c.reasons.is_empty());
    assert_eq!(
        consumer.reasons[0],
        format!("UDP port {port} is in use by another program (ss -lnp names it)")
    );
    drop(taken);
    consumer.until("bound", |c| c.connected == 1);
}

#[test]
fn a_pseudo_terminal_of_ours_is_read_from_its_far_end() {
    let folder = tempfile::tempdir().unwrap();
    let link = link_in(folder.path());
    let mut consumer = Consumer::new(open(&format!("pty://?link={link}")));
    consumer.until("made", |c| c.connected == 1);
    assert_eq!(consumer.source.stats().endpoint.as_deref(), Some(link.as_str()));
    let mut far = std::fs::OpenOptions::new().write(true).open(&link).unwrap();
    far.write_all(&frame(0)).unwrap();
    consumer.until("a frame", |c| c.frames.len() == 1);
    drop(consumer);
    assert!(!Path::new(&link).exists(), "the link goes with the source");
}

#[test]
fn a_dropped_source_stops_at_once_and_frees_its_port() {
    let source = open("udp://127.0.0.1:0");
    let address = wait_for("bound", || source.stats().endpoint);
    let began = Instant::now();
    drop(source);
    assert!(began.elapsed() < Duration::from_secs(2));
    UdpSocket::bind(address).unwrap();
}

#[tokio::test]
async fn events_can_be_awaited_and_waiting_can_be_given_up() {
    let mut device = Pty::open().unwrap();
    let source = open(&format!("pty://{}", device.slave_path().display()));
    assert!(matches!(source.next().await, Event::Connected { .. }));
    let nothing = tokio::time::timeout(Duration::from_millis(20), source.next()).await;
    assert!(nothing.is_err());
    device.write_all(b"1,2\n").unwrap();
    let event = tokio::time::timeout(PATIENCE, source.next()).await.unwrap();
    assert!(matches!(&event, Event::Bytes { data, .. } if &data[..] == b"1,2\n"), "{event:?}");
}
