//! What decoders count, and what the counts say.

use std::fmt::Write as _;

use serde::Serialize;

use crate::SourceUrl;

/// Why bytes were not handed out as a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Rejection {
    /// The checksum does not fit.
    Crc,
    /// The bytes between two delimiters are not COBS.
    Cobs,
    /// Too short or too long for any frame, or not as long as its header says.
    Length,
    /// A sound frame of a wire version that this build does not read.
    Version,
    /// A sound frame with an unknown value format.
    Format,
    /// A sound frame with another number of channels than the skin has.
    Channels,
    /// A field of a text line that is not a number.
    NotANumber,
    /// A number on a text line that the device's converter cannot have given.
    Range,
    /// The rest of a frame whose beginning was not received: after connecting, and after a gap.
    Partial,
}

/// Counts of rejected frames by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct Rejections {
    /// See [`Rejection::Crc`].
    pub crc: u64,
    /// See [`Rejection::Cobs`].
    pub cobs: u64,
    /// See [`Rejection::Length`].
    pub length: u64,
    /// See [`Rejection::Version`].
    pub version: u64,
    /// See [`Rejection::Format`].
    pub format: u64,
    /// See [`Rejection::Channels`].
    pub channels: u64,
    /// See [`Rejection::NotANumber`].
    pub not_a_number: u64,
    /// See [`Rejection::Range`].
    pub range: u64,
    /// See [`Rejection::Partial`]; no fault of the device, and not in [`Rejections::total`].
    pub partial: u64,
}

impl Rejections {
    /// Rejected frames that hint at a fault: all but the partial ones.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.crc
            + self.cobs
            + self.length
            + self.version
            + self.format
            + self.channels
            + self.not_a_number
            + self.range
    }
}

/// \[bytes\] of the stream kept to show when nothing can be decoded.
const SAMPLE_LEN: usize = 48;
/// \[bytes\] without a valid frame before [`DecoderStats::diagnosis`] says anything.
const DIAGNOSIS_AFTER: u64 = 4096;
/// Frames in a row that lacked a part before [`DecoderStats::diagnosis`] says so.
const INCOMPLETE_ROW: u64 = 16;

/// What a decoder decoded, rejected and lost.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct DecoderStats {
    /// \[bytes\] taken in.
    pub bytes: u64,
    /// Frames handed out.
    pub frames: u64,
    /// Frames that the device sent and that never came, by the gaps in the sequence.
    pub lost: u64,
    /// Frames that came twice and were handed out once.
    pub duplicates: u64,
    /// Frames that came after a later one (datagrams overtake each other) and were dropped.
    pub late: u64,
    /// Frames sent in parts that were given up because a part did not come; a later frame counts them in `lost`.
    pub incomplete: u64,
    /// Parts that these frames lacked.
    pub lost_parts: u64,
    /// Parts that came twice, or after their frame was handed out or given up.
    pub spare_parts: u64,
    /// Times that the device started its sequence again.
    pub restarts: u64,
    /// Times that a valid frame was found again after rejections.
    pub resyncs: u64,
    /// Frames rejected, by reason.
    pub rejected: Rejections,
    /// One sentence on the latest rejection.
    pub last_rejection: Option<String>,
    /// \[bytes\] since the end of the latest valid frame.
    pub bytes_since_valid: u64,
    /// Incomplete frames since the latest frame that was put together, and the parts that they had and lacked.
    #[serde(skip)]
    incomplete_in_a_row: [u64; 3],
    #[serde(skip)]
    sample: Vec<u8>,
    #[serde(skip)]
    unsynced: bool,
    #[serde(skip)]
    diagnosis_after: u64,
}

impl DecoderStats {
    /// Nothing yet; `frame_bytes` is the longest frame that is expected \[bytes\].
    #[must_use]
    pub fn new(frame_bytes: usize) -> Self {
        // Less than a few frames of silence says nothing.
        Self { diagnosis_after: DIAGNOSIS_AFTER.max(3 * frame_bytes as u64), ..Self::default() }
    }

    /// These bytes came.
    pub fn take_in(&mut self, bytes: &[u8]) {
        self.bytes += bytes.len() as u64;
        self.bytes_since_valid += bytes.len() as u64;
        let room = SAMPLE_LEN.saturating_sub(self.sample.len());
        self.sample.extend_from_slice(&bytes[..room.min(bytes.len())]);
    }

    /// A valid frame ended `rest` bytes before the end of what was taken in.
    pub fn valid(&mut self, rest: usize) {
        self.bytes_since_valid = rest as u64;
        self.sample.clear();
        if self.unsynced {
            self.unsynced = false;
            self.resyncs += 1;
        }
    }

    /// A frame was put together from its parts.
    pub(super) fn put_together(&mut self) {
        self.incomplete_in_a_row = [0; 3];
    }

    /// A frame was given up, of which so many parts came and did not come.
    pub(super) fn gave_up(&mut self, came: u64, lacked: u64) {
        self.incomplete += 1;
        self.lost_parts += lacked;
        for (sum, count) in self.incomplete_in_a_row.iter_mut().zip([1, came, lacked]) {
            *sum += count;
        }
    }

    /// Something was rejected; `why` makes the sentence that says so, where somebody reads it.
    pub fn reject(&mut self, reason: Rejection, why: impl FnOnce() -> String) {
        let r = &mut self.rejected;
        let counter = match reason {
            Rejection::Crc => &mut r.crc,
            Rejection::Cobs => &mut r.cobs,
            Rejection::Length => &mut r.length,
            Rejection::Version => &mut r.version,
            Rejection::Format => &mut r.format,
            Rejection::Channels => &mut r.channels,
            Rejection::NotANumber => &mut r.not_a_number,
            Rejection::Range => &mut r.range,
            Rejection::Partial => &mut r.partial,
        };
        *counter += 1;
        if reason != Rejection::Partial {
            // The sentence costs an allocation: at the rate of noise it is made for one rejection in 64.
            if !self.unsynced || self.rejected.total() % 64 == 1 {
                self.last_rejection = Some(why());
            }
            self.unsynced = true;
        }
    }

    /// Says in one sentence why nothing comes out although bytes come in, or `None` while there is no reason to.
    ///
    /// `source` is where the bytes come from, so that the sentence can name the baud rate that was set.
    #[must_use]
    pub fn diagnosis(&self, source: Option<&SourceUrl>) -> Option<String> {
        let [frames, came, lacked] = self.incomplete_in_a_row;
        if frames >= INCOMPLETE_ROW {
            return Some(format!(
                "the last {frames} frames lacked {lacked} of their {} parts, and none was whole: the network loses datagrams, or the \
                 device does not send every part",
                came + lacked
            ));
        }
        if self.bytes_since_valid < self.diagnosis_after.max(1) {
            return None;
        }
        let mut text = if self.frames == 0 {
            format!("{} bytes and not one valid frame: ", self.bytes_since_valid)
        } else {
            format!(
                "no valid frame in the last {} bytes, after {} good ones: ",
                self.bytes_since_valid, self.frames
            )
        };
        let r = &self.rejected;
        let latest = self.last_rejection.as_deref().unwrap_or("none was complete");
        let settings = r.version + r.format + r.channels + r.range;
        if settings > 0 && settings * 2 >= r.total() {
            text.push_str(latest);
            return Some(text);
        }
        let baud = match source {
            Some(SourceUrl::Serial { baud, .. }) => Some(*baud),
            _ => None,
        };
        let printable =
            self.sample.iter().filter(|b| matches!(b, b' '..=b'~' | b'\r' | b'\n' | b'\t')).count();
        if printable == self.sample.len() && r.not_a_number == 0 {
            text.push_str(
                "the device sends text, not our binary wire; where its lines are numbers, write `[wire]` and below it \
                 `protocol = \"ascii\"` into the skin file, otherwise plug in the skin",
            );
        } else if printable == self.sample.len() {
            text.push_str(
                "the device sends text that is not lines of numbers, it is probably another device",
            );
        } else if let Some(baud) = baud {
            let _ = write!(text, "wrong baud rate ({baud} set) or a device that speaks another protocol");
        } else {
            text.push_str("a device that speaks another protocol");
        }
        if printable == self.sample.len() {
            let shown: String = self.sample.iter().map(|b| char::from(*b)).collect();
            let _ = write!(text, "; it begins with {shown:?}");
        } else {
            text.push_str("; first bytes:");
            for b in self.sample.iter().take(16) {
                let _ = write!(text, " {b:02x}");
            }
        }
        Some(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::framing::{
        AsciiDecoder, AsciiOptions, FrameDecoder, NativeDecoder, NativeEncoder, NativeFormat,
    };

    fn serial() -> SourceUrl {
        SourceUrl::parse("serial:///dev/ttyACM0?baud=921600").unwrap()
    }

    fn diagnose(mut decoder: impl FrameDecoder, bytes: &[u8], source: &SourceUrl) -> Option<String> {
        let mut out = Vec::new();
        decoder.push(bytes, 0, &mut out);
        decoder.stats().diagnosis(Some(source))
    }

    #[test]
    fn silence_and_a_few_bytes_say_nothing() {
        assert_eq!(diagnose(NativeDecoder::new(Some(4)), &[], &serial()), None);
        assert_eq!(diagnose(NativeDecoder::new(Some(4)), &[0x3f; 4095], &serial()), None);
    }

    #[test]
    fn a_wrong_baud_rate_is_named_with_what_came() {
        let bytes: Vec<u8> = [0x3f, 0x00, 0xf8, 0xc7].into_iter().cycle().take(4096).collect();
        let text = diagnose(NativeDecoder::new(Some(4)), &bytes, &serial()).unwrap();
        insta::assert_snapshot!(text, @"4096 bytes and not one valid frame: wrong baud rate (921600 set) or a device that speaks another protocol; first bytes: 3f 00 f8 c7 3f 00 f8 c7 3f 00 f8 c7 3f 00 f8 c7");
        let udp = SourceUrl::parse("udp://0.0.0.0:7400").unwrap();
        let text = diagnose(NativeDecoder::new(Some(4)), &bytes, &udp).unwrap();
        insta::assert_snapshot!(text, @"4096 bytes and not one valid frame: a device that speaks another protocol; first bytes: 3f 00 f8 c7 3f 00 f8 c7 3f 00 f8 c7 3f 00 f8 c7");
    }

    #[test]
    fn a_device_that_sends_text_is_named() {
        let nmea: Vec<u8> =
            b"$GPGGA,123519,4807.038,N,01131.000,E,1,08\r\n".iter().copied().cycle().take(5000).collect();
        let text = diagnose(NativeDecoder::new(Some(4)), &nmea, &serial()).unwrap();
        insta::assert_snapshot!(text, @r#"5000 bytes and not one valid frame: the device sends text, not our binary wire; where its lines are numbers, write `[wire]` and below it `protocol = "ascii"` into the skin file, otherwise plug in the skin; it begins with "$GPGGA,123519,4807.038,N,01131.000,E,1,08\r\n$GPGG""#);
        let text = diagnose(AsciiDecoder::new(AsciiOptions::channels(4)), &nmea, &serial()).unwrap();
        insta::assert_snapshot!(text, @r#"5000 bytes and not one valid frame: the device sends text that is not lines of numbers, it is probably another device; it begins with "$GPGGA,123519,4807.038,N,01131.000,E,1,08\r\n$GPGG""#);
    }

    #[test]
    fn a_skin_with_other_channels_is_named() {
        let mut encoder = NativeEncoder::new(NativeFormat::F32);
        let bytes: Vec<u8> =
            (0..100).flat_map(|i| encoder.encode(i, 1, &[1.0; 12]).unwrap().to_vec()).collect();
        let text = diagnose(NativeDecoder::new(Some(16)), &bytes, &serial()).unwrap();
        insta::assert_snapshot!(text, @"6800 bytes and not one valid frame: the device sends 12 channels, and the skin description has 16");
    }

    #[test]
    fn a_line_that_turns_bad_is_named_and_forgotten_when_it_is_good_again() {
        let mut encoder = NativeEncoder::new(NativeFormat::F32);
        let mut good = |i| encoder.encode(i, u64::from(i), &[1.0; 4]).unwrap().to_vec();
        let mut decoder = NativeDecoder::new(Some(4));
        let mut out = Vec::new();
        decoder.push(&good(1), 0, &mut out);
        decoder.push(&[0xf0; 4096], 0, &mut out);
        let text = decoder.stats().diagnosis(Some(&serial())).unwrap();
        assert!(
            text.starts_with("no valid frame in the last 4096 bytes, after 1 good ones: wrong baud"),
            "{text}"
        );
        decoder.push(&[0], 0, &mut out);
        decoder.push(&good(2), 0, &mut out);
        assert_eq!(decoder.stats().diagnosis(Some(&serial())), None);
    }
}
