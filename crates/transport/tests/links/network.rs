//! TCP, UDP and a web stream.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use dermis_transport::framing::{DecodedFrame, NativeDecoder, NativeEncoder, NativeFormat};

use super::{Consumer, PATIENCE, frame, open, wait_for};

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
fn a_web_stream_is_read_behind_its_head_and_requested_again() {
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
            assert!(matches!(second.read(&mut [0; 1]), Ok(0) | Err(_)), "its end shows it");
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
fn a_dropped_source_stops_at_once_and_frees_its_port() {
    let source = open("udp://127.0.0.1:0");
    let address = wait_for("bound", || source.stats().endpoint);
    let began = Instant::now();
    drop(source);
    assert!(began.elapsed() < Duration::from_secs(2));
    UdpSocket::bind(address).unwrap();
}
