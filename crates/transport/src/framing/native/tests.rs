use proptest::prelude::*;

use super::*;

fn encode(sequence: u32, values: &[f32]) -> Vec<u8> {
    let mut encoder = NativeEncoder::new(NativeFormat::F32);
    encoder.encode(sequence, 1000 + u64::from(sequence), values).unwrap().to_vec()
}

/// A frame from its unstuffed bytes, with a CRC that fits them.
fn sound(mut raw: Vec<u8>) -> Vec<u8> {
    raw.extend_from_slice(&CRC_16.checksum(&raw).to_le_bytes());
    let mut stuffed = cobs::encode_vec(&raw);
    stuffed.push(DELIMITER);
    stuffed
}

fn raw_header(version: u8, format: u8, channels: u16) -> Vec<u8> {
    let mut raw = vec![version, format];
    raw.extend_from_slice(&channels.to_le_bytes());
    raw.extend_from_slice(&[0; 12]);
    raw
}

fn decode(channels: Option<usize>, bytes: &[u8]) -> (Vec<DecodedFrame>, DecoderStats) {
    let mut decoder = NativeDecoder::new(channels);
    let mut out = Vec::new();
    decoder.push(bytes, 1, &mut out);
    (out, decoder.stats().clone())
}

#[test]
fn every_fault_is_counted_under_its_name() {
    let good = encode(0, &[1.0, 2.0]);
    let mut damaged = encode(1, &[1.0, 2.0]);
    let value = damaged.iter().position(|b| *b == 0x3f).unwrap();
    damaged[value] ^= 0x40;
    let mut bad_version = raw_header(9, 0, 2);
    bad_version.extend_from_slice(&[1; 8]);
    let mut bad_format = raw_header(1, 77, 2);
    bad_format.extend_from_slice(&[1; 8]);
    let mut bad_length = raw_header(1, 0, 3);
    bad_length.extend_from_slice(&[1; 8]);
    let mut bytes = good;
    for frame in [damaged, sound(bad_version), sound(bad_format), sound(bad_length), encode(2, &[1.0; 5])] {
        bytes.extend_from_slice(&frame);
    }
    bytes.extend_from_slice(&[9, 1, 0, 3, 1, 1, 0]);
    bytes.extend_from_slice(&vec![7; 20_000]);
    bytes.push(DELIMITER);
    bytes.extend_from_slice(&encode(3, &[1.0, 2.0]));

    let (frames, stats) = decode(Some(2), &bytes);
    assert_eq!(frames.len(), 2);
    let r = stats.rejected;
    assert_eq!((r.crc, r.version, r.format, r.channels, r.cobs, r.partial), (1, 1, 1, 1, 1, 0));
    // A wrong length, a frame of two bytes, and one that never ends.
    assert_eq!(r.length, 3);
    assert_eq!((stats.resyncs, stats.lost), (1, 2));
    assert_eq!(stats.bytes, bytes.len() as u64);
}

#[test]
fn half_a_frame_at_the_start_is_no_fault() {
    let mut bytes = encode(4, &[1.0, 2.0]).split_off(9);
    bytes.extend_from_slice(&encode(5, &[1.0, 2.0]));
    let (frames, stats) = decode(Some(2), &bytes);
    assert_eq!(frames.len(), 1);
    assert_eq!((stats.rejected.partial, stats.rejected.total(), stats.lost), (1, 0, 0));
}

#[test]
fn a_gap_drops_the_half_before_it_and_counts_the_loss() {
    let mut decoder = NativeDecoder::new(Some(2));
    let mut out = Vec::new();
    decoder.push(&encode(0, &[1.0, 2.0]), 1, &mut out);
    decoder.push(&encode(1, &[1.0, 2.0])[..11], 2, &mut out);
    decoder.gap();
    decoder.push(&encode(3, &[1.0, 2.0])[5..], 3, &mut out);
    decoder.push(&encode(4, &[1.0, 2.0]), 4, &mut out);
    assert_eq!(out.iter().map(|f| f.sequence).collect::<Vec<_>>(), [0, 4]);
    assert_eq!((decoder.stats().lost, decoder.stats().rejected.partial), (3, 1));
}

#[test]
fn integers_saturate_and_say_nan_as_the_lowest_count() {
    let values = [f32::NAN, 1e9, -1e9, 2.5, -0.4];
    let decoded = |format| {
        let mut encoder = NativeEncoder::new(format);
        decode(None, encoder.encode(0, 0, &values).unwrap()).0.remove(0)
    };
    assert_eq!(decoded(NativeFormat::I16).values, [-32768.0, 32767.0, -32768.0, 3.0, 0.0]);
    assert_eq!(decoded(NativeFormat::U16).values, [0.0, 65535.0, 0.0, 3.0, 0.0]);
    assert_eq!(decoded(NativeFormat::I32).values, [-2_147_483_648.0, 1e9, -1e9, 3.0, 0.0]);
    assert_eq!(decoded(NativeFormat::U12).values, [0.0, 4095.0, 0.0, 3.0, 0.0]);
    assert_eq!(decoded(NativeFormat::I16).device_time_us, None);
}

#[test]
fn too_many_channels_are_refused() {
    let mut encoder = NativeEncoder::new(NativeFormat::U16);
    let none = encoder.encode(0, 0, &[]).unwrap_err().to_string();
    assert_eq!(none, "cannot encode a frame of 0 channels: a frame has 1 to 4096");
    assert!(encoder.encode(0, 0, &[0.0; MAX_CHANNELS + 1]).is_err());
    encoder.encode(0, 0, &[0.0; MAX_CHANNELS]).unwrap();
}

/// Every byte of a frame changed to every other value: 2^-16 of the changes that survive the other checks may
/// pass the CRC, and of those that do not move a block boundary none does.
#[test]
fn no_changed_byte_goes_unnoticed() {
    let values: Vec<f32> = (0..16u8).map(|i| 101_325.0 + f32::from(i) * 3.7).collect();
    let before = encode(9, &values);
    let frame = encode(10, &values);
    let after = encode(11, &values);
    let truth = decode(Some(16), &[before.clone(), frame.clone(), after.clone()].concat()).0;
    let mut tried = 0u32;
    for at in 0..frame.len() {
        for change in 1..=255u8 {
            let mut damaged = frame.clone();
            damaged[at] ^= change;
            let (out, _) = decode(Some(16), &[before.clone(), damaged, after.clone()].concat());
            for found in &out {
                assert!(truth.contains(found), "byte {at} ^ {change:02x} gave {found:?}");
            }
            // Only a changed delimiter takes the frame behind it along.
            let last = truth.last().unwrap();
            assert_eq!(out.iter().any(|f| f == last), at + 1 < frame.len(), "resync after byte {at}");
            tried += 1;
        }
    }
    assert_eq!(tried, 255 * frame.len() as u32);
}

#[test]
fn memory_is_bounded_whatever_comes() {
    let mut decoder = NativeDecoder::new(Some(4));
    let mut out = Vec::new();
    for i in 0..2000u32 {
        decoder.push(&[(i % 255) as u8 + 1; 1000], 0, &mut out);
        assert!(decoder.buffer.capacity() <= 2 * decoder.limit + 1000);
    }
    assert!(out.is_empty());
    assert_eq!(decoder.stats().rejected.length, 1);
}

fn frames() -> impl Strategy<Value = Vec<Vec<f32>>> {
    (1usize..40)
        .prop_flat_map(|n| proptest::collection::vec(proptest::collection::vec(-1e6f32..1e6, n..=n), 1..12))
}

/// 784 voltages of 12 bits, 100 times a second, fit a line of 2 Mbaud, and one datagram.
#[test]
fn a_panel_of_28_electrodes_fits_a_serial_line() {
    let values: Vec<f32> = (0..784_u16).map(|i| f32::from(i * 5)).collect();
    let mut encoder = NativeEncoder::new(NativeFormat::U12);
    let frame = encoder.encode(0, 1, &values).unwrap();
    // 16 + 1176 + 2 bytes, one more for each 254, one more, and the delimiter.
    assert!(frame.len() <= 1194 + 4 + 2, "{}", frame.len());
    assert!(frame.len() * 10 * 100 < 2_000_000);
    assert_eq!(decode(Some(784), frame).0[0].values, values);
}

proptest! {
    #[test]
    fn packed_counts_come_out_as_they_went_in(counts in proptest::collection::vec(0_u16..4096, 1..60)) {
        let values: Vec<f32> = counts.iter().map(|c| f32::from(*c)).collect();
        let mut encoder = NativeEncoder::new(NativeFormat::U12);
        let (frames, stats) = decode(Some(values.len()), encoder.encode(1, 2, &values).unwrap());
        prop_assert_eq!(&frames[0].values, &values);
        prop_assert_eq!(stats.rejected.total(), 0);
    }

    #[test]
    fn any_cut_gives_the_same_frames(frames in frames(), cuts in proptest::collection::vec(1usize..60, 1..80)) {
        let bytes: Vec<u8> =
            (0..).zip(&frames).flat_map(|(i, values)| encode(i, values)).collect();
        let whole = decode(Some(frames[0].len()), &bytes).0;
        prop_assert_eq!(whole.len(), frames.len());
        for (frame, values) in whole.iter().zip(&frames) {
            prop_assert_eq!(&frame.values, values);
        }
        let mut decoder = NativeDecoder::new(Some(frames[0].len()));
        let mut out = Vec::new();
        let mut rest = &bytes[..];
        for cut in cuts.iter().cycle() {
            let (piece, left) = rest.split_at((*cut).min(rest.len()));
            decoder.push(piece, 1, &mut out);
            rest = left;
            if rest.is_empty() { break; }
        }
        prop_assert_eq!(out, whole);
        prop_assert_eq!(decoder.stats().rejected.total(), 0);
    }

    #[test]
    fn no_bytes_panic_or_grow(mut bytes: Vec<u8>, zeroes in 0u8..60) {
        // Random bytes hold few delimiters.
        bytes.iter_mut().filter(|b| **b <= zeroes).for_each(|b| *b = 0);
        let (_, stats) = decode(None, &bytes);
        prop_assert_eq!(stats.bytes, bytes.len() as u64);
    }

    #[test]
    fn no_sound_frame_with_a_senseless_header_panics(
        version in 0u8..3, format in 0u8..6, channels in 0u16..12, body in proptest::collection::vec(any::<u8>(), 0..60),
    ) {
        let mut raw = vec![version, format];
        raw.extend_from_slice(&channels.to_le_bytes());
        raw.extend_from_slice(&body);
        let (out, stats) = decode(None, &sound(raw));
        prop_assert_eq!(out.len() as u64 + stats.rejected.total() + stats.rejected.partial, 1);
        let payload = NativeFormat::from_wire(format).map(|f| f.payload_len(usize::from(channels)));
        let whole = version == 1 && channels > 0 && payload.is_some_and(|payload| body.len() == 12 + payload);
        prop_assert_eq!(out.len() == 1, whole);
    }

    #[test]
    fn noise_between_frames_costs_one_frame_at_most(
        noise in proptest::collection::vec(any::<u8>(), 0..200),
        values in proptest::collection::vec(-1e6f32..1e6, 8..=8),
    ) {
        let mut bytes = encode(1, &values);
        bytes.extend_from_slice(&noise);
        bytes.extend_from_slice(&encode(2, &values));
        bytes.extend_from_slice(&encode(3, &values));
        let (out, _) = decode(Some(8), &bytes);
        let numbers: Vec<u64> = out.iter().map(|f| f.sequence).collect();
        prop_assert!(numbers == [1, 2, 3] || numbers == [1, 3], "{numbers:?}");
        prop_assert!(out.iter().all(|f| f.values == values));
    }
}
