//! The native wire, `WIRE.md` in this crate: COBS-delimited frames with CRC-16.

use crc::{CRC_16_IBM_3740, Crc, Table};

use super::sequence::{SequenceTracker, Verdict};
use super::{DecodedFrame, DecoderStats, FrameDecoder, Rejection};
use crate::TransportError;

/// Version of the wire that this crate writes and reads.
pub const WIRE_VERSION: u8 = 1;
/// \[bytes\] from the start of an unstuffed frame to its first value.
pub const HEADER_LEN: usize = 16;
/// Most channels of a frame.
pub const MAX_CHANNELS: usize = 4096;
/// The checksum of the wire: CRC-16/IBM-3740 (also known as CRC-16/CCITT-FALSE): polynomial 0x1021, start 0xFFFF,
/// not reflected, no final XOR; the check value of `123456789` is 0x29B1.
pub const CRC_16: Crc<u16, Table<1>> = Crc::<u16>::new(&CRC_16_IBM_3740);

const CRC_LEN: usize = 2;
const DELIMITER: u8 = 0;

/// How values lie on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
#[non_exhaustive]
pub enum NativeFormat {
    /// IEEE 754 single precision, in the unit of the skin description; NaN is an invalid channel.
    F32 = 0,
    /// Signed 16-bit raw counts.
    I16 = 1,
    /// Unsigned 16-bit raw counts.
    U16 = 2,
    /// Signed 32-bit raw counts.
    I32 = 3,
}

impl NativeFormat {
    /// Every format.
    pub const ALL: [Self; 4] = [Self::F32, Self::I16, Self::U16, Self::I32];

    /// \[bytes\] of one value.
    #[must_use]
    pub fn width(self) -> usize {
        match self {
            Self::F32 | Self::I32 => 4,
            Self::I16 | Self::U16 => 2,
        }
    }

    fn from_wire(byte: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|f| *f as u8 == byte)
    }
}

/// \[bytes\] of an unstuffed frame.
fn raw_len(channels: usize, format: NativeFormat) -> usize {
    HEADER_LEN + channels * format.width() + CRC_LEN
}

/// \[bytes\] of a stuffed frame without its delimiter.
fn stuffed_len(raw: usize) -> usize {
    raw + raw / 254 + 1
}

/// Writes frames of the native wire.
#[derive(Debug, Clone)]
pub struct NativeEncoder {
    format: NativeFormat,
    raw: Vec<u8>,
    stuffed: Vec<u8>,
}

impl NativeEncoder {
    /// An encoder that sends values in `format`.
    #[must_use]
    pub fn new(format: NativeFormat) -> Self {
        Self { format, raw: Vec::new(), stuffed: Vec::new() }
    }

    /// One frame with its delimiter, ready to be sent. `device_time_us` 0 means that the device has no clock.
    ///
    /// For integer formats values are rounded to the nearest count, and clamped to the range of the format; NaN,
    /// which an integer cannot say, is sent as the lowest count.
    ///
    /// # Errors
    /// [`TransportError::ChannelCount`] for no values or more than [`MAX_CHANNELS`].
    pub fn encode(
        &mut self,
        sequence: u32,
        device_time_us: u64,
        values: &[f32],
    ) -> Result<&[u8], TransportError> {
        let channels =
            u16::try_from(values.len()).ok().filter(|n| (1..=MAX_CHANNELS).contains(&usize::from(*n)));
        let Some(channels) = channels else {
            return Err(TransportError::ChannelCount { channels: values.len(), max: MAX_CHANNELS });
        };
        let raw = &mut self.raw;
        raw.clear();
        raw.extend_from_slice(&[WIRE_VERSION, self.format as u8]);
        raw.extend_from_slice(&channels.to_le_bytes());
        raw.extend_from_slice(&sequence.to_le_bytes());
        raw.extend_from_slice(&device_time_us.to_le_bytes());
        for value in values {
            // `as` from float to integer saturates, which is the clamp that the doc promises.
            match self.format {
                NativeFormat::F32 => raw.extend_from_slice(&value.to_le_bytes()),
                NativeFormat::I16 => {
                    let count = if value.is_nan() { i16::MIN } else { value.round() as i16 };
                    raw.extend_from_slice(&count.to_le_bytes());
                }
                NativeFormat::U16 => raw.extend_from_slice(&(value.round() as u16).to_le_bytes()),
                NativeFormat::I32 => {
                    let count = if value.is_nan() { i32::MIN } else { value.round() as i32 };
                    raw.extend_from_slice(&count.to_le_bytes());
                }
            }
        }
        let crc = CRC_16.checksum(raw);
        raw.extend_from_slice(&crc.to_le_bytes());
        self.stuffed.resize(cobs::max_encoding_length(raw.len()) + 1, 0);
        let n = cobs::encode(raw, &mut self.stuffed);
        self.stuffed[n] = DELIMITER;
        Ok(&self.stuffed[..=n])
    }
}

/// Reads frames of the native wire.
#[derive(Debug, Clone)]
pub struct NativeDecoder {
    channels: Option<usize>,
    /// \[bytes\] longest stuffed frame that is taken.
    limit: usize,
    buffer: Vec<u8>,
    state: Hunt,
    sequence: SequenceTracker,
    stats: DecoderStats,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Hunt {
    /// No delimiter yet: what comes may be the rest of a frame.
    Start,
    /// Collecting a frame.
    Frame,
    /// Too long for a frame: skipping to the next delimiter.
    Skip,
}

impl NativeDecoder {
    /// A decoder for frames of `channels` channels; `None` takes any number.
    #[must_use]
    pub fn new(channels: Option<usize>) -> Self {
        // A frame with a wrong channel count shall be named as such, so that the limit stays at the wire's.
        let limit = stuffed_len(raw_len(MAX_CHANNELS, NativeFormat::F32));
        let expected = stuffed_len(raw_len(channels.unwrap_or(64).min(MAX_CHANNELS), NativeFormat::F32));
        Self {
            channels,
            limit,
            buffer: Vec::with_capacity(expected + 1),
            state: Hunt::Start,
            sequence: SequenceTracker::default(),
            stats: DecoderStats::new(expected),
        }
    }

    /// Judges what lies between two delimiters; `rest` bytes were taken in after it.
    fn finish(&mut self, rest: usize, received_ns: i64, out: &mut Vec<DecodedFrame>) {
        let state = std::mem::replace(&mut self.state, Hunt::Frame);
        if state == Hunt::Skip || self.buffer.is_empty() {
            self.buffer.clear();
            return;
        }
        let mut buffer = std::mem::take(&mut self.buffer);
        match read(&mut buffer, self.channels) {
            Ok(frame) => {
                self.stats.valid(rest);
                if let Verdict::Accept(sequence) =
                    self.sequence.judge(frame.sequence, frame.device_time_us, &mut self.stats)
                {
                    self.stats.frames += 1;
                    out.push(DecodedFrame {
                        sequence,
                        device_time_us: frame.device_time_us,
                        received_ns,
                        values: frame.values,
                    });
                }
            }
            Err((Rejection::Crc | Rejection::Cobs | Rejection::Length, _)) if state == Hunt::Start => {
                self.stats.reject(Rejection::Partial, String::new);
            }
            Err((reason, why)) => self.stats.reject(reason, || why.into_text(self.channels)),
        }
        buffer.clear();
        self.buffer = buffer;
    }
}

impl FrameDecoder for NativeDecoder {
    fn push(&mut self, bytes: &[u8], received_ns: i64, out: &mut Vec<DecodedFrame>) {
        self.stats.take_in(bytes);
        let mut rest = bytes;
        while let Some(end) = rest.iter().position(|b| *b == DELIMITER) {
            self.collect(&rest[..end]);
            rest = &rest[end + 1..];
            self.finish(rest.len(), received_ns, out);
        }
        self.collect(rest);
    }

    fn gap(&mut self) {
        self.buffer.clear();
        self.state = Hunt::Start;
    }

    fn stats(&self) -> &DecoderStats {
        &self.stats
    }
}

impl NativeDecoder {
    fn collect(&mut self, bytes: &[u8]) {
        if self.state == Hunt::Skip {
            return;
        }
        if self.buffer.len() + bytes.len() > self.limit {
            let limit = self.limit;
            self.stats.reject(Rejection::Length, || format!("more than {limit} bytes without a delimiter"));
            self.buffer.clear();
            self.state = Hunt::Skip;
            return;
        }
        self.buffer.extend_from_slice(bytes);
    }
}

struct WireFrame {
    sequence: u32,
    device_time_us: Option<u64>,
    values: Vec<f32>,
}

/// Why a frame was rejected, as numbers: the text is made only where somebody reads it.
enum Why {
    Cobs(usize),
    TooShort(usize),
    Crc { stated: u16, computed: u16 },
    Version(u8),
    Format(u8),
    Length { channels: usize, len: usize },
    Channels(usize),
}

impl Why {
    fn into_text(self, expected: Option<usize>) -> String {
        match self {
            Self::Cobs(len) => format!("{len} bytes between two delimiters are not COBS"),
            Self::TooShort(len) => {
                format!("a frame of {len} bytes, the shortest has {}", raw_len(1, NativeFormat::I16))
            }
            Self::Crc { stated, computed } => {
                format!("a frame states the CRC {stated:04x} and its bytes have {computed:04x}")
            }
            Self::Version(v) => {
                format!("the device sends wire version {v}, and this build reads version {WIRE_VERSION}")
            }
            Self::Format(f) => format!("the device sends value format {f}, and the known ones are 0 to 3"),
            Self::Length { channels, len } => {
                format!("a frame of {len} bytes says that it has {channels} channels, which does not fit")
            }
            Self::Channels(n) => match expected {
                Some(expected) => {
                    format!("the device sends {n} channels, and the skin description has {expected}")
                }
                None => format!("the device sends {n} channels, and a frame has 1 to {MAX_CHANNELS}"),
            },
        }
    }
}

/// Unstuffs and reads one frame in place.
fn read(stuffed: &mut [u8], expected: Option<usize>) -> Result<WireFrame, (Rejection, Why)> {
    let stuffed_len = stuffed.len();
    let len = cobs::decode_in_place(stuffed).map_err(|_| (Rejection::Cobs, Why::Cobs(stuffed_len)))?;
    let raw = stuffed.get(..len).unwrap_or_default();
    let Some((body, crc)) = raw.split_last_chunk::<CRC_LEN>() else {
        return Err((Rejection::Length, Why::TooShort(len)));
    };
    let (stated, computed) = (u16::from_le_bytes(*crc), CRC_16.checksum(body));
    let Some((header, payload)) = body.split_first_chunk::<HEADER_LEN>() else {
        return Err((Rejection::Length, Why::TooShort(len)));
    };
    if stated != computed {
        return Err((Rejection::Crc, Why::Crc { stated, computed }));
    }
    let [version, format, c0, c1, s0, s1, s2, s3, time @ ..] = *header;
    if version != WIRE_VERSION {
        return Err((Rejection::Version, Why::Version(version)));
    }
    let Some(format) = NativeFormat::from_wire(format) else {
        return Err((Rejection::Format, Why::Format(format)));
    };
    let channels = usize::from(u16::from_le_bytes([c0, c1]));
    if payload.len() != channels * format.width() {
        return Err((Rejection::Length, Why::Length { channels, len }));
    }
    if !(1..=MAX_CHANNELS).contains(&channels) || expected.is_some_and(|n| n != channels) {
        return Err((Rejection::Channels, Why::Channels(channels)));
    }
    let values = match format {
        NativeFormat::F32 => chunks(payload, f32::from_le_bytes),
        NativeFormat::I16 => chunks(payload, |b| f32::from(i16::from_le_bytes(b))),
        NativeFormat::U16 => chunks(payload, |b| f32::from(u16::from_le_bytes(b))),
        NativeFormat::I32 => chunks(payload, |b| i32::from_le_bytes(b) as f32),
    };
    Ok(WireFrame {
        sequence: u32::from_le_bytes([s0, s1, s2, s3]),
        device_time_us: Some(u64::from_le_bytes(time)).filter(|t| *t != 0),
        values,
    })
}

fn chunks<const N: usize>(payload: &[u8], value: impl Fn([u8; N]) -> f32) -> Vec<f32> {
    payload.as_chunks::<N>().0.iter().map(|b| value(*b)).collect()
}

#[cfg(test)]
mod tests {
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
        for frame in [damaged, sound(bad_version), sound(bad_format), sound(bad_length), encode(2, &[1.0; 5])]
        {
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
        (1usize..40).prop_flat_map(|n| {
            proptest::collection::vec(proptest::collection::vec(-1e6f32..1e6, n..=n), 1..12)
        })
    }

    proptest! {
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
            let width = NativeFormat::from_wire(format).map_or(0, NativeFormat::width);
            let whole = version == 1 && width > 0 && channels > 0 && body.len() == 12 + usize::from(channels) * width;
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
}
