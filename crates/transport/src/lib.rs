//! Byte sources by URL, framing and reconnection: everything between a sensor's plug and a decoded frame.
//!
//! The way of a frame through this crate:
//!
//! 1. [`SourceUrl`] says where the bytes come from (`serial:///dev/ttyACM0?baud=921600`, `udp://0.0.0.0:7400`, …).
//! 2. [`Source`] reads them on a thread of its own, reconnects by itself, and hands out [`Event`]s through a
//!    bounded queue: a slow consumer loses the oldest bytes, counted, and never holds up the device or eats memory.
//! 3. A [`FrameDecoder`](framing::FrameDecoder) finds frames in those bytes, however they are cut up, and counts
//!    everything that it rejects by reason. [`framing::NativeDecoder`] reads our own wire (`WIRE.md` in this
//!    crate), [`framing::AsciiDecoder`] lines of numbers.
//! 4. [`DeviceClock`] turns device time into host time, so that messages carry the time of acquisition.
//!
//! ```
//! use dermis_transport::framing::{DecodedFrame, FrameDecoder, NativeDecoder, NativeEncoder, NativeFormat};
//! use dermis_transport::{DeviceClock, SourceUrl};
//!
//! let url = SourceUrl::parse("serial:///dev/ttyACM0?baud=921600")?;
//! let mut encoder = NativeEncoder::new(NativeFormat::F32);
//! let bytes = encoder.encode(7, 1_000_000, &[101_325.0, 101_330.0])?.to_vec();
//!
//! let mut decoder = NativeDecoder::new(Some(2));
//! let mut clock = DeviceClock::new();
//! let mut frames: Vec<DecodedFrame> = Vec::new();
//! decoder.push(&bytes, 1_700_000_000_000_000_000, &mut frames);
//! assert_eq!(frames[0].values, [101_325.0, 101_330.0]);
//! let stamp_ns = clock.stamp(frames[0].device_time_us, frames[0].received_ns);
//! assert!(stamp_ns <= frames[0].received_ns);
//! assert_eq!(decoder.stats().diagnosis(Some(&url)), None);
//! # Ok::<(), dermis_transport::TransportError>(())
//! ```

mod clock;
mod error;
pub mod framing;
mod pty;
mod source;
mod url;

pub use clock::{ClockState, DeviceClock};
pub use error::TransportError;
pub use pty::Pty;
pub use source::{Event, Source, SourceOptions, SourceStats, SourceWatch};
pub use url::{Newcomer, Parity, Sender, SourceUrl};

/// Host time now \[ns since the Unix epoch\], the clock that every `received_ns` of this crate is on.
#[must_use]
pub fn now_ns() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
}
