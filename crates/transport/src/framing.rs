//! From bytes to frames: our native wire and lines of text.
//!
//! Decoders take bytes however they are cut up, never panic, hold a bounded amount of memory, and account for
//! every byte: it is part of a frame that was handed out, or of something that [`DecoderStats`] counts.

mod ascii;
mod native;
mod parts;
mod sequence;
mod stats;

pub use ascii::{AsciiDecoder, AsciiOptions};
pub use native::{
    CRC_16, HEADER_LEN, MAX_CHANNELS, MIN_DATAGRAM, NativeDecoder, NativeEncoder, NativeFormat, WIRE_VERSION,
};
pub use stats::{DecoderStats, Rejection, Rejections};

/// One frame as the device sent it: values in the order and unit of the device.
#[derive(Debug, Clone, PartialEq)]
pub struct DecodedFrame {
    /// Sequence number, unwrapped to 64 bits: it only ever grows, by more than 1 where frames were lost.
    pub sequence: u64,
    /// \[µs\] device clock when the frame was measured; `None` where the device has no clock.
    pub device_time_us: Option<u64>,
    /// \[ns since the Unix epoch\] host clock when the last byte of the frame was read.
    pub received_ns: i64,
    /// One value per channel; NaN where the device says that it has none. Raw integers are passed as they are
    /// (exact up to 2^24).
    pub values: Vec<f32>,
}

/// Finds frames in a stream of bytes.
pub trait FrameDecoder: Send {
    /// Takes the next bytes of the stream and appends the frames that end in them to `out`.
    ///
    /// `received_ns` is when these bytes were read \[ns since the Unix epoch\].
    fn push(&mut self, bytes: &[u8], received_ns: i64, out: &mut Vec<DecodedFrame>);

    /// Forgets a half-read frame: bytes are missing here (the link was lost, or the queue overflowed).
    ///
    /// Sequence numbers go on, so that what was lost in between is counted.
    fn gap(&mut self);

    /// What was decoded, rejected and lost so far.
    fn stats(&self) -> &DecoderStats;
}
