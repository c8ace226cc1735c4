//! The native wire, `WIRE.md` in this crate: COBS-delimited frames with CRC-16, whole or in parts.

mod format;

use crc::{CRC_16_IBM_3740, Crc, Table};

use super::parts::{Assembler, PART_LEN, Part};
use super::sequence::{SequenceTracker, Verdict};
use super::{DecodedFrame, DecoderStats, FrameDecoder, Rejection};
use crate::TransportError;
pub use format::NativeFormat;

/// Version of the wire that this crate writes and reads.
pub const WIRE_VERSION: u8 = 1;
/// \[bytes\] from the start of an unstuffed frame to its first value.
pub const HEADER_LEN: usize = 16;
/// Most channels of a frame.
pub const MAX_CHANNELS: usize = 4096;
/// The checksum of the wire: CRC-16/IBM-3740 (also known as CRC-16/CCITT-FALSE): polynomial 0x1021, start 0xFFFF,
/// not reflected, no final XOR; the check value of `123456789` is 0x29B1.
pub const CRC_16: Crc<u16, Table<1>> = Crc::<u16>::new(&CRC_16_IBM_3740);

/// Shortest datagram \[bytes\] that [`NativeEncoder::encode_parts`] splits for.
pub const MIN_DATAGRAM: usize = 64;

const CRC_LEN: usize = 2;
/// Set in the format of a part.
const PART: u8 = 0x80;
const DELIMITER: u8 = 0;

/// \[bytes\] of an unstuffed frame.
fn raw_len(channels: usize, format: NativeFormat) -> usize {
    HEADER_LEN + format.payload_len(channels) + CRC_LEN
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
        let channels = channel_count(values)?;
        self.begin(self.format as u8, channels, sequence, device_time_us);
        self.format.write(values, &mut self.raw);
        Ok(self.seal())
    }

    /// One frame in datagrams of at most `most` bytes, each handed to `send`: as [`encode`](Self::encode) makes it where it fits, and
    /// in parts where it does not.
    ///
    /// # Errors
    /// [`TransportError::ChannelCount`] as [`encode`](Self::encode), and [`TransportError::DatagramLength`] where `most` is less than
    /// [`MIN_DATAGRAM`] or the frame would have more than 255 parts. Nothing was sent then.
    pub fn encode_parts(
        &mut self,
        sequence: u32,
        device_time_us: u64,
        values: &[f32],
        most: usize,
        mut send: impl FnMut(&[u8]),
    ) -> Result<(), TransportError> {
        let channels = channel_count(values)?;
        if most >= MIN_DATAGRAM && stuffed_len(raw_len(values.len(), self.format)) < most {
            send(self.encode(sequence, device_time_us, values)?);
            return Ok(());
        }
        let each = values_in_datagram(most, self.format);
        let parts = u8::try_from(values.len().div_ceil(each.max(1)))
            .ok()
            .filter(|_| most >= MIN_DATAGRAM && each > 0);
        let Some(parts) = parts else {
            return Err(TransportError::DatagramLength { most, channels: values.len(), least: MIN_DATAGRAM });
        };
        for (part, values) in (0..parts).zip(values.chunks(each)) {
            self.begin(self.format as u8 | PART, channels, sequence, device_time_us);
            // At most MAX_CHANNELS.
            let first = (usize::from(part) * each) as u16;
            self.raw.extend_from_slice(&first.to_le_bytes());
            self.raw.extend_from_slice(&[part, parts]);
            self.format.write(values, &mut self.raw);
            send(self.seal());
        }
        Ok(())
    }

    fn begin(&mut self, format: u8, channels: u16, sequence: u32, device_time_us: u64) {
        self.raw.clear();
        self.raw.extend_from_slice(&[WIRE_VERSION, format]);
        self.raw.extend_from_slice(&channels.to_le_bytes());
        self.raw.extend_from_slice(&sequence.to_le_bytes());
        self.raw.extend_from_slice(&device_time_us.to_le_bytes());
    }

    /// Adds the checksum, stuffs, and ends it.
    fn seal(&mut self) -> &[u8] {
        let crc = CRC_16.checksum(&self.raw);
        self.raw.extend_from_slice(&crc.to_le_bytes());
        self.stuffed.resize(cobs::max_encoding_length(self.raw.len()) + 1, 0);
        let n = cobs::encode(&self.raw, &mut self.stuffed);
        self.stuffed[n] = DELIMITER;
        &self.stuffed[..=n]
    }
}

fn channel_count(values: &[f32]) -> Result<u16, TransportError> {
    let count = u16::try_from(values.len()).ok().filter(|n| (1..=MAX_CHANNELS).contains(&usize::from(*n)));
    count.ok_or(TransportError::ChannelCount { channels: values.len(), max: MAX_CHANNELS })
}

/// Values that a part takes in a datagram of at most `most` bytes: an even number, so that every part begins at a byte.
fn values_in_datagram(most: usize, format: NativeFormat) -> usize {
    // One byte of stuffing for each 254, one more, and the delimiter.
    let raw = most.saturating_sub(2) * 254 / 255;
    raw.saturating_sub(HEADER_LEN + PART_LEN + CRC_LEN) * 8 / format.bits() / 2 * 2
}

/// Reads frames of the native wire.
#[derive(Debug, Clone)]
pub struct NativeDecoder {
    channels: Option<usize>,
    /// The only format that is taken.
    format: Option<NativeFormat>,
    /// \[bytes\] longest stuffed frame that is taken.
    limit: usize,
    buffer: Vec<u8>,
    state: Hunt,
    sequence: SequenceTracker,
    parts: Assembler,
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
            format: None,
            limit,
            buffer: Vec::with_capacity(expected + 1),
            state: Hunt::Start,
            sequence: SequenceTracker::default(),
            parts: Assembler::default(),
            stats: DecoderStats::new(expected),
        }
    }

    /// Takes values of this format only, whole or in parts.
    #[must_use]
    pub fn only(mut self, format: NativeFormat) -> Self {
        self.format = Some(format);
        self
    }

    /// Judges what lies between two delimiters; `rest` bytes were taken in after it.
    fn finish(&mut self, rest: usize, received_ns: i64, out: &mut Vec<DecodedFrame>) {
        let state = std::mem::replace(&mut self.state, Hunt::Frame);
        if state == Hunt::Skip || self.buffer.is_empty() {
            self.buffer.clear();
            return;
        }
        let mut buffer = std::mem::take(&mut self.buffer);
        match read(&mut buffer, self.channels, self.format) {
            Ok(Read::Frame(frame)) => {
                self.stats.valid(rest);
                self.hand_out(frame, received_ns, out);
            }
            Ok(Read::Part(part)) => {
                self.stats.valid(rest);
                match self.parts.add(&part, &mut self.stats) {
                    Ok(Some(frame)) => self.hand_out(frame, received_ns, out),
                    Ok(None) => {}
                    Err(disagreement) => self.stats.reject(Rejection::Length, || disagreement.to_string()),
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

    fn hand_out(&mut self, frame: WireFrame, received_ns: i64, out: &mut Vec<DecodedFrame>) {
        let WireFrame { sequence, device_time_us, values } = frame;
        if let Verdict::Accept(sequence) = self.sequence.classify(sequence, device_time_us, &mut self.stats) {
            self.stats.frames += 1;
            out.push(DecodedFrame { sequence, device_time_us, received_ns, values });
        }
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
        self.parts.gap(&mut self.stats);
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

/// A whole frame, as it was sent or put together.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WireFrame {
    pub(super) sequence: u32,
    pub(super) device_time_us: Option<u64>,
    pub(super) values: Vec<f32>,
}

/// What lies between two delimiters.
enum Read {
    Frame(WireFrame),
    Part(Part),
}

/// Why a frame was rejected, as numbers: the text is made only where somebody reads it.
enum Why {
    Cobs(usize),
    TooShort(usize),
    Crc { stated: u16, computed: u16 },
    Version(u8),
    Format(u8),
    OtherFormat { sent: NativeFormat, expected: NativeFormat },
    Length { channels: usize, len: usize },
    Channels(usize),
    Part { part: u8, parts: u8, first: usize, count: usize, channels: usize },
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
            Self::Format(f) => format!(
                "the device sends value format {f}, and the known ones are 0 to 4, and 128 to 132 for parts"
            ),
            Self::OtherFormat { sent, expected } => format!(
                "the device sends {} values, and the skin file says {}: correct `wire.samples`, or leave it out to read every kind",
                sent.name(),
                expected.name()
            ),
            Self::Length { channels, len } => {
                format!("a frame of {len} bytes says that it has {channels} channels, which does not fit")
            }
            Self::Channels(n) => match expected {
                Some(expected) => {
                    format!("the device sends {n} channels, and the skin description has {expected}")
                }
                None => format!("the device sends {n} channels, and a frame has 1 to {MAX_CHANNELS}"),
            },
            Self::Part { part, parts, first, count, channels } => format!(
                "part {part} of {parts} has {count} values from channel {first} on, which is no part of {channels} channels: parts \
                 count from 0, and begin at an even channel"
            ),
        }
    }
}

/// Unstuffs and reads one frame in place.
fn read(
    stuffed: &mut [u8],
    expected: Option<usize>,
    only: Option<NativeFormat>,
) -> Result<Read, (Rejection, Why)> {
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
    let Some(value_format) = NativeFormat::from_wire(format & !PART) else {
        return Err((Rejection::Format, Why::Format(format)));
    };
    if let Some(expected) = only.filter(|expected| *expected != value_format) {
        return Err((Rejection::Format, Why::OtherFormat { sent: value_format, expected }));
    }
    let channels = usize::from(u16::from_le_bytes([c0, c1]));
    let sequence = u32::from_le_bytes([s0, s1, s2, s3]);
    let device_time_us = Some(u64::from_le_bytes(time)).filter(|t| *t != 0);
    let is_part = format & PART != 0;
    if !is_part && payload.len() != value_format.payload_len(channels) {
        return Err((Rejection::Length, Why::Length { channels, len }));
    }
    if !(1..=MAX_CHANNELS).contains(&channels) || expected.is_some_and(|n| n != channels) {
        return Err((Rejection::Channels, Why::Channels(channels)));
    }
    if !is_part {
        let values = value_format.read(payload);
        return Ok(Read::Frame(WireFrame { sequence, device_time_us, values }));
    }
    let Some(([f0, f1, part, parts], payload)) = payload.split_first_chunk::<PART_LEN>() else {
        return Err((Rejection::Length, Why::Length { channels, len }));
    };
    let first = usize::from(u16::from_le_bytes([*f0, *f1]));
    let count = value_format.values_in(payload.len()).unwrap_or(0);
    if part >= parts || count == 0 || !first.is_multiple_of(2) || first + count > channels {
        return Err((Rejection::Length, Why::Part { part: *part, parts: *parts, first, count, channels }));
    }
    let values = value_format.read(payload);
    let frame = WireFrame { sequence, device_time_us, values };
    Ok(Read::Part(Part { frame, format, channels, first, part: *part, parts: *parts }))
}

#[cfg(test)]
mod tests;
