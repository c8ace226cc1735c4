use std::collections::BTreeSet;

use proptest::prelude::*;

use super::*;
use crate::framing::{
    CRC_16, DecodedFrame, FrameDecoder, MAX_CHANNELS, MIN_DATAGRAM, NativeDecoder, NativeEncoder,
    NativeFormat,
};

/// Values of a frame that no other frame has.
fn values(sequence: u32, channels: usize) -> Vec<f32> {
    (0..channels).map(|channel| f32::from((sequence * 97 + channel as u32) as u16 % 4096)).collect()
}

fn datagrams(format: NativeFormat, sequence: u32, channels: usize, most: usize) -> Vec<Vec<u8>> {
    let mut sent = Vec::new();
    let time = 1000 + 10 * u64::from(sequence);
    NativeEncoder::new(format)
        .encode_parts(sequence, time, &values(sequence, channels), most, |bytes| sent.push(bytes.to_vec()))
        .unwrap();
    sent
}

fn decode(channels: usize, datagrams: &[Vec<u8>]) -> (Vec<DecodedFrame>, DecoderStats) {
    let mut decoder = NativeDecoder::new(Some(channels));
    let mut out = Vec::new();
    for (at, bytes) in (0..).zip(datagrams) {
        decoder.push(bytes, at, &mut out);
    }
    (out, decoder.stats().clone())
}

#[test]
fn a_frame_longer_than_a_datagram_comes_whole() {
    let sent = datagrams(NativeFormat::F32, 7, 784, 1472);
    assert_eq!(sent.len(), 3);
    let (out, stats) = decode(784, &sent);
    assert_eq!(out.len(), 1);
    assert_eq!((out[0].sequence, out[0].device_time_us, out[0].received_ns), (7, Some(1070), 2));
    assert_eq!(out[0].values, values(7, 784));
    assert_eq!((stats.frames, stats.lost, stats.incomplete, stats.rejected.total()), (1, 0, 0, 0));
    // One that fits is an ordinary frame.
    let whole = datagrams(NativeFormat::U12, 7, 784, 1472);
    let mut encoder = NativeEncoder::new(NativeFormat::U12);
    assert_eq!(whole, [encoder.encode(7, 1070, &values(7, 784)).unwrap().to_vec()]);
}

#[test]
fn lost_parts_are_counted_and_said() {
    let mut sent = Vec::new();
    for sequence in 0..20 {
        let mut parts = datagrams(NativeFormat::U16, sequence, 784, 600);
        if sequence % 2 == 1 {
            parts.remove(1);
        }
        sent.extend(parts);
    }
    let (out, stats) = decode(784, &sent);
    assert_eq!(out.iter().map(|f| f.sequence).collect::<Vec<_>>(), [0, 2, 4, 6, 8, 10, 12, 14, 16, 18]);
    // The last one may still come.
    assert_eq!((stats.lost, stats.incomplete, stats.lost_parts, stats.spare_parts), (9, 9, 9, 0));
    assert_eq!(stats.diagnosis(None), None);

    let mut decoder = NativeDecoder::new(Some(784));
    let mut out = Vec::new();
    for sequence in 0..20 {
        datagrams(NativeFormat::U16, sequence, 784, 600)[1..]
            .iter()
            .for_each(|p| decoder.push(p, 0, &mut out));
    }
    insta::assert_snapshot!(
        decoder.stats().diagnosis(None).unwrap(),
        @"the last 16 frames lacked 16 of their 48 parts, and none was whole: the network loses datagrams, or the device does not send every part"
    );
    datagrams(NativeFormat::U16, 20, 784, 600).iter().for_each(|p| decoder.push(p, 0, &mut out));
    assert_eq!((out.len(), decoder.stats().diagnosis(None)), (1, None));
}

#[test]
fn a_part_that_comes_late_or_twice_makes_no_frame() {
    let (first, second) =
        (datagrams(NativeFormat::U16, 1, 100, 128), datagrams(NativeFormat::U16, 2, 100, 128));
    assert_eq!(first.len(), 2);
    let order = [&first[0], &second[1], &second[0], &first[1], &second[1], &second[0]].map(Clone::clone);
    let (out, stats) = decode(100, &order);
    assert_eq!(out.iter().map(|f| f.sequence).collect::<Vec<_>>(), [2]);
    assert_eq!((stats.incomplete, stats.lost_parts, stats.spare_parts, stats.restarts), (1, 1, 3, 0));
}

#[test]
fn parts_of_two_devices_are_not_put_together() {
    let parts = |value: f32| {
        let mut sent = Vec::new();
        let mut encoder = NativeEncoder::new(NativeFormat::U16);
        encoder.encode_parts(4, 0, &[value; 100], 128, |bytes| sent.push(bytes.to_vec())).unwrap();
        sent
    };
    let (one, other) = (parts(1.0), parts(2.0));
    let mut decoder = NativeDecoder::new(Some(100));
    let mut out = Vec::new();
    decoder.push(&one[0], 0, &mut out);
    // Another device takes over, which has no clock either and is at the same number.
    decoder.gap();
    other.iter().rev().for_each(|part| decoder.push(part, 0, &mut out));
    assert_eq!(out.len(), 1);
    assert_eq!(out[0].values, [2.0; 100]);
    assert_eq!((decoder.stats().incomplete, decoder.stats().lost_parts), (1, 1));
}

/// A part from its fields, with a CRC that fits.
fn forged(channels: u16, first: u16, part: u8, parts: u8, values: &[u16]) -> Vec<u8> {
    let mut raw = vec![1, 0x80 | NativeFormat::U16 as u8];
    raw.extend_from_slice(&channels.to_le_bytes());
    raw.extend_from_slice(&[9, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]);
    raw.extend_from_slice(&first.to_le_bytes());
    raw.extend_from_slice(&[part, parts]);
    values.iter().for_each(|v| raw.extend_from_slice(&v.to_le_bytes()));
    raw.extend_from_slice(&CRC_16.checksum(&raw).to_le_bytes());
    let mut stuffed = cobs::encode_vec(&raw);
    stuffed.push(0);
    stuffed
}

#[test]
fn parts_that_fit_nowhere_are_refused() {
    let refused = |sent: &[Vec<u8>]| {
        // After a delimiter: what comes first may be the rest of a frame.
        let (out, stats) = decode(6, &[&[vec![0]], sent].concat());
        assert_eq!((out.len(), stats.rejected.length, stats.rejected.total()), (0, 1, 1));
        stats.last_rejection.unwrap()
    };
    insta::assert_snapshot!(refused(&[forged(6, 0, 2, 2, &[1])]), @"part 2 of 2 has 1 values from channel 0 on, which is no part of 6 channels: parts count from 0, and begin at an even channel");
    insta::assert_snapshot!(refused(&[forged(6, 4, 1, 2, &[1, 2, 3])]), @"part 1 of 2 has 3 values from channel 4 on, which is no part of 6 channels: parts count from 0, and begin at an even channel");
    refused(&[forged(6, 1, 0, 2, &[1])]);
    refused(&[forged(6, 0, 0, 2, &[])]);
    let disagree = "the parts of frame 9 do not fit each other";
    // Another number of parts, a channel twice, and a channel that no part has.
    assert!(refused(&[forged(6, 0, 0, 2, &[1, 2]), forged(6, 2, 1, 3, &[1, 2])]).starts_with(disagree));
    assert!(refused(&[forged(6, 0, 0, 2, &[1, 2, 3]), forged(6, 2, 1, 2, &[1, 2])]).starts_with(disagree));
    assert!(refused(&[forged(6, 0, 0, 2, &[1, 2]), forged(6, 4, 1, 2, &[1, 2])]).starts_with(disagree));
    assert_eq!(decode(6, &[forged(6, 0, 0, 2, &[1, 2]), forged(6, 2, 1, 2, &[3, 4, 5, 6])]).0.len(), 1);
}

#[test]
fn datagrams_that_are_too_short_are_refused() {
    let mut encoder = NativeEncoder::new(NativeFormat::F32);
    let mut refused = |channels: usize, most| {
        let error = encoder.encode_parts(0, 1, &vec![0.0; channels], most, |_| panic!("nothing is sent"));
        error.unwrap_err().to_string()
    };
    insta::assert_snapshot!(refused(10, 63), @"cannot send a frame of 10 channels in datagrams of 63 bytes: they must have at least 64, and a frame has at most 255 parts");
    assert!(refused(MAX_CHANNELS, MIN_DATAGRAM).contains("at most 255 parts"));
    assert!(refused(0, 1472).contains("a frame has 1 to 4096"));
}

#[test]
fn memory_is_bounded_whatever_comes() {
    let mut assembler = Assembler::default();
    let mut stats = DecoderStats::new(64);
    for sequence in 0..1000 {
        let frame = WireFrame { sequence, device_time_us: None, values: vec![0.0] };
        let part = Part { frame, format: 0x80, channels: MAX_CHANNELS, first: 0, part: 0, parts: 255 };
        assembler.add(&part, &mut stats).unwrap();
        assert!(assembler.open.len() <= OPEN && assembler.closed.len() <= CLOSED);
    }
    assert_eq!((stats.incomplete, stats.lost_parts), (996, 996 * 254));
}

fn formats() -> impl Strategy<Value = NativeFormat> {
    proptest::sample::select(NativeFormat::ALL.to_vec())
}

proptest! {
    #[test]
    fn every_datagram_fits_and_the_frame_is_what_was_sent(
        format in formats(), channels in 1_usize..900, most in MIN_DATAGRAM..2000, turn in any::<prop::sample::Index>(),
    ) {
        let mut sent = Vec::new();
        let values = values(3, channels);
        let split = NativeEncoder::new(format).encode_parts(3, 5, &values, most, |bytes| sent.push(bytes.to_vec()));
        prop_assume!(split.is_ok());
        prop_assert!(sent.iter().all(|bytes| bytes.len() <= most));
        // Whichever comes first.
        let at = turn.index(sent.len());
        sent.rotate_left(at);
        let (out, stats) = decode(channels, &sent);
        prop_assert_eq!(out.len(), 1);
        prop_assert_eq!(&out[0].values, &values);
        prop_assert_eq!(stats.rejected.total() + stats.incomplete + stats.spare_parts, 0);
    }

    /// Datagrams are lost, come twice, and overtake each other within two frames: what comes out was sent, in order, and everything is
    /// accounted for.
    #[test]
    fn what_comes_out_was_sent(
        fates in proptest::collection::vec((0_u8..10, 0_usize..5), 60..160), start in any::<u32>(),
    ) {
        const CHANNELS: usize = 50;
        let mut fates = fates.into_iter();
        let (mut line, mut sent, mut copies) = (Vec::new(), 0_u64, 0_u64);
        'frames: for frame in 0.. {
            for part in datagrams_from(start, frame, CHANNELS) {
                let Some((fate, delay)) = fates.next() else { break 'frames };
                sent += 1;
                let times = match fate { 0 => 0, 1 => 2, _ => 1 };
                copies += times;
                for copy in 0..times {
                    line.push((line.len() + delay * usize::from(copy == 0 && fate > 5), part.clone()));
                }
            }
        }
        line.sort_by_key(|(at, _)| *at);
        let line: Vec<Vec<u8>> = line.into_iter().map(|(_, bytes)| bytes).collect();
        let (out, stats) = decode(CHANNELS, &line);
        prop_assert_eq!(stats.restarts, 0);
        prop_assert!(out.windows(2).all(|w| w[0].sequence < w[1].sequence));
        for frame in &out {
            let number = (frame.sequence as u32).wrapping_sub(start);
            prop_assert_eq!(&frame.values, &values(number, CHANNELS));
        }
        // Each part that came is in a frame that was put together, or spare, or of a frame that was given up or is still open.
        let together = stats.frames + stats.late + stats.duplicates;
        let in_given_up = stats.incomplete * 3 - stats.lost_parts;
        let accounted = together * 3 + stats.spare_parts + in_given_up;
        prop_assert!(accounted <= copies && copies <= accounted + 3 * OPEN as u64, "{accounted} of {copies}, sent {sent}: {stats:?}");
        let numbers: BTreeSet<u64> = out.iter().map(|f| f.sequence).collect();
        prop_assert_eq!(numbers.len() as u64, stats.frames);
    }
}

/// Three parts of the frame that is so many after `start`.
fn datagrams_from(start: u32, frame: u32, channels: usize) -> Vec<Vec<u8>> {
    let mut sent = Vec::new();
    let time = 1000 + 10 * u64::from(frame);
    NativeEncoder::new(NativeFormat::U16)
        .encode_parts(start.wrapping_add(frame), time, &values(frame, channels), 64, |bytes| {
            sent.push(bytes.to_vec());
        })
        .unwrap();
    assert_eq!(sent.len(), 3);
    sent
}
