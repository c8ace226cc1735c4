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
