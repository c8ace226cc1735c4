//! Request and answer: the host writes one byte, the device answers with a picture.
//!
//! An answer is `TCAM`, sequence (u32), clock of the device \[µs\] (u64), 320 × 240 × 3 bytes, and CRC-32 over all of it but
//! the first four; numbers are little-endian.

use crc::{CRC_32_ISO_HDLC, Crc};
use dermis_sensor::{Decoder, Encoder};
use dermis_skin::{Frame, Image, PixelFormat};
use dermis_transport::framing::{DecoderStats, Rejection};
use dermis_transport::{ClockState, DeviceClock};

use super::{BLOCKS, COLOURS, SIZE, means};

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
const MAGIC: &[u8; 4] = b"TCAM";
const REQUEST: u8 = b'S';
const HEAD: usize = 16;
const PIXELS: usize = SIZE[0] as usize * SIZE[1] as usize * COLOURS;
const WHOLE: usize = HEAD + PIXELS + 4;
/// \[ns\] after which a request that was not answered is made again.
const OVERDUE: i64 = 500_000_000;

/// Asks for pictures and reads them.
pub struct PictureReader {
    buffer: Vec<u8>,
    stats: DecoderStats,
    clock: DeviceClock,
    /// When the request was made that is not answered yet.
    requested: Option<i64>,
    last: Option<u32>,
}

impl PictureReader {
    pub fn new() -> Self {
        Self {
            buffer: Vec::new(),
            stats: DecoderStats::new(WHOLE),
            clock: DeviceClock::new(),
            requested: None,
            last: None,
        }
    }

    fn take(&mut self, received_ns: i64) -> Option<Frame> {
        let body = &self.buffer[4..WHOLE - 4];
        let sum = u32::from_le_bytes(self.buffer[WHOLE - 4..WHOLE].try_into().ok()?);
        if CRC.checksum(body) != sum {
            self.stats.reject(Rejection::Crc, || "the checksum of a picture does not fit".to_owned());
            return None;
        }
        let sequence = u32::from_le_bytes(body[..4].try_into().ok()?);
        let clock = u64::from_le_bytes(body[4..12].try_into().ok()?);
        let image = Image::new(SIZE[0], SIZE[1], PixelFormat::Rgb8, &body[12..])?;
        if let Some(last) = self.last.replace(sequence) {
            self.stats.lost += u64::from(sequence.wrapping_sub(last).saturating_sub(1));
        }
        self.stats.frames += 1;
        let mut values = vec![0.0; BLOCKS[0] * BLOCKS[1] * COLOURS];
        means(&image, &mut values);
        let stamp = self.clock.stamp(Some(clock), received_ns);
        let mut frame = Frame::new(stamp, sequence.into(), values.iter().map(|v| *v as f32).collect());
        frame.device_time_us = clock;
        frame.image = Some(image);
        Some(frame)
    }
}

impl Decoder for PictureReader {
    fn push(&mut self, bytes: &[u8], received_ns: i64, out: &mut Vec<Frame>) {
        self.stats.take_in(bytes);
        self.buffer.extend_from_slice(bytes);
        loop {
            let start = self.buffer.windows(MAGIC.len()).position(|w| w == MAGIC);
            // What comes before is of no picture; the end of it may be the beginning of the next.
            let skip = start.unwrap_or_else(|| self.buffer.len().saturating_sub(MAGIC.len() - 1));
            if skip > 0 {
                self.stats.reject(Rejection::Partial, String::new);
                self.buffer.drain(..skip);
            }
            if start.is_none() || self.buffer.len() < WHOLE {
                return;
            }
            let frame = self.take(received_ns);
            // Where the sum does not fit, the next picture may begin inside of this one.
            let done = if frame.is_some() { WHOLE } else { MAGIC.len() };
            self.buffer.drain(..done);
            if let Some(frame) = frame {
                self.stats.valid(self.buffer.len());
                self.requested = None;
                out.push(frame);
            }
        }
    }

    fn request(&mut self, now_ns: i64) -> Option<Vec<u8>> {
        if self.requested.is_some_and(|at| now_ns - at < OVERDUE) {
            return None;
        }
        self.requested = Some(now_ns);
        Some(vec![REQUEST])
    }

    fn gap(&mut self) {
        self.buffer.clear();
        self.requested = None;
    }

    fn stats(&self) -> &DecoderStats {
        &self.stats
    }

    fn clock(&self) -> ClockState {
        self.clock.state()
    }

    fn clock_jumps(&self) -> u64 {
        self.clock.resets()
    }
}

/// Answers requests with pictures.
#[derive(Debug, Default)]
pub struct PictureWriter {
    bytes: Vec<u8>,
}

impl Encoder for PictureWriter {
    fn encode(&mut self, frame: &Frame, device_time_us: u64) -> Result<&[u8], String> {
        let image = frame.image.as_ref().ok_or("sends pictures, and there is none")?;
        if [image.width(), image.height()] != SIZE || image.format() != PixelFormat::Rgb8 {
            return Err(format!("sends {} x {} pixels of three colours, not {image:?}", SIZE[0], SIZE[1]));
        }
        self.bytes.clear();
        self.bytes.extend_from_slice(MAGIC);
        self.bytes.extend_from_slice(&(frame.sequence as u32).to_le_bytes());
        self.bytes.extend_from_slice(&device_time_us.to_le_bytes());
        self.bytes.extend_from_slice(image.data());
        let sum = CRC.checksum(&self.bytes[MAGIC.len()..]);
        self.bytes.extend_from_slice(&sum.to_le_bytes());
        Ok(&self.bytes)
    }

    fn on_request(&self) -> bool {
        true
    }

    fn requested_frames(&mut self, bytes: &[u8]) -> usize {
        bytes.iter().filter(|byte| **byte == REQUEST).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(sequence: u64) -> Vec<u8> {
        let pixels: Vec<u8> = (0..PIXELS).map(|i| (i * 7 % 251) as u8).collect();
        let mut frame = Frame::new(0, sequence, Vec::new());
        frame.image = Image::new(SIZE[0], SIZE[1], PixelFormat::Rgb8, pixels);
        PictureWriter::default().encode(&frame, 1_000 * sequence).unwrap().to_vec()
    }

    #[test]
    fn pictures_are_read_however_they_are_cut() {
        let mut reader = PictureReader::new();
        let mut stream = b"noise TCA".to_vec();
        stream.extend(picture(1));
        stream.extend(picture(4));
        let mut frames = Vec::new();
        for piece in stream.chunks(1000) {
            reader.push(piece, 5, &mut frames);
        }
        assert_eq!(frames.iter().map(|f| f.sequence).collect::<Vec<_>>(), [1, 4]);
        assert_eq!((reader.stats().frames, reader.stats().lost), (2, 2));
        assert_eq!(frames[0].values.len(), 576);
        assert!(frames[0].image.is_some());
    }

    #[test]
    fn a_damaged_picture_is_rejected_and_the_next_one_read() {
        let mut damaged = picture(1);
        damaged[5000] ^= 1;
        let mut reader = PictureReader::new();
        let mut frames = Vec::new();
        reader.push(&damaged, 5, &mut frames);
        reader.push(&picture(2), 5, &mut frames);
        assert_eq!(frames.len(), 1);
        assert_eq!(reader.stats().rejected.crc, 1);
    }

    #[test]
    fn a_request_is_made_again_where_no_answer_comes() {
        let mut reader = PictureReader::new();
        assert_eq!(reader.request(0), Some(vec![REQUEST]));
        assert_eq!(reader.request(1_000_000), None);
        assert_eq!(reader.request(OVERDUE), Some(vec![REQUEST]));
        reader.push(&picture(1), 5, &mut Vec::new());
        assert_eq!(reader.request(OVERDUE + 1), Some(vec![REQUEST]));
    }
}
