//! Serial lines, and what stands for them.

use std::io::Write;
use std::path::Path;
use std::time::Duration;

use dermis_transport::framing::{AsciiDecoder, AsciiOptions};
use dermis_transport::{Event, Pty, Source, SourceUrl};

use super::{Consumer, PATIENCE, frame, link_in, open, quick, wait_for};

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
    let status = unsafe { nix::libc::ioctl(opened.as_raw_fd(), nix::libc::TIOCGEXCL, &raw mut exclusive) };
    assert_eq!((status, exclusive), (0, 0));
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
