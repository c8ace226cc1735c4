//! The camera's own wire: over TCP, the host writes a request of up to 256 bytes, and the device answers with the length of a JPEG picture
//! (u32, little-endian) and the picture.
//!
//! Nothing in it marks a beginning. Where a length cannot be, or no JPEG follows, bytes are skipped until a length and the beginning of a
//! JPEG come again. Lengths and sizes are bounded before anything is decoded: a picture has at most as many bytes as its pixels, and must be
//! of the skin's size, or a whole multiple of it up to eight, which is reduced to means.
//!
//! There is no clock and no number in an answer: frames are stamped on arrival and counted here.

pub mod stream;

use std::sync::Arc;

use dermis_sensor::{Decoder, Encoder};
use dermis_skin::Frame;
use dermis_transport::framing::{DecoderStats, Rejection};
use dermis_transport::{ClockState, DeviceClock};

use crate::jpeg::{compress, decode, most_bytes};
use crate::optics::Observer;

/// As skin files name it.
pub const NAME: &str = "insight-jpeg";

/// What the host asks with; the device takes up to [`REQUEST_MAX`] bytes for one request, whatever they are.
const REQUEST: &[u8] = b"picture\n";
/// \[bytes\] of a request at most.
const REQUEST_MAX: usize = 256;
/// \[bytes\] of the length before a picture.
const HEAD: usize = 4;
/// How a JPEG begins.
const BEGINS: [u8; 3] = [0xff, 0xd8, 0xff];
/// \[bytes\] of the shortest JPEG that can be, nearly: its tables alone take more.
const LEAST: usize = 100;
/// \[ns\] after which a request that was not answered is made again.
const OVERDUE: i64 = 1_000_000_000;

/// Pictures as frames: stamped on arrival, and counted.
#[derive(Debug)]
struct Pictures {
    observer: Arc<Observer>,
    stats: DecoderStats,
    clock: DeviceClock,
    sequence: u64,
}

impl Pictures {
    fn new(observer: Arc<Observer>) -> Self {
        Self {
            stats: DecoderStats::new(most_bytes(observer.size())),
            observer,
            clock: DeviceClock::new(),
            sequence: 0,
        }
    }

    /// \[bytes\] that a picture has at most.
    fn most(&self) -> usize {
        most_bytes(self.observer.size())
    }

    /// The frame of a picture that has come whole; `waiting` bytes have come after it. `None` where it cannot be read.
    fn frame(&mut self, jpeg: &[u8], received_ns: i64, waiting: usize) -> Option<Frame> {
        let image = match decode(jpeg, self.observer.size()) {
            Ok(image) => image.with_jpeg(jpeg),
            Err(reason) => {
                self.stats.reject(Rejection::Format, || reason);
                return None;
            }
        };
        let mut values = vec![0.0; self.observer.numbers()];
        self.observer.observe(image.data(), &mut values);
        self.stats.frames += 1;
        self.stats.valid(waiting);
        let stamp = self.clock.stamp(None, received_ns);
        let mut frame = Frame::new(stamp, self.sequence, values.iter().map(|v| *v as f32).collect());
        self.sequence += 1;
        frame.image = Some(image);
        Some(frame)
    }
}

/// Asks for pictures and reads them.
#[derive(Debug)]
pub struct PictureReader {
    pictures: Pictures,
    buffer: Vec<u8>,
    /// When the request was made that is not answered yet.
    requested: Option<i64>,
}

impl PictureReader {
    /// For pictures that `observer` makes a frame's numbers of.
    #[must_use]
    pub fn new(observer: Arc<Observer>) -> Self {
        Self { pictures: Pictures::new(observer), buffer: Vec::new(), requested: None }
    }

    /// Bytes to skip until an answer may begin, and its picture's length where that is known.
    fn next(&self) -> (usize, Option<usize>) {
        let most = self.pictures.most();
        let begins = |at: usize| {
            let head = &self.buffer[at..];
            let known = head.len().min(HEAD + BEGINS.len());
            let length = head.first_chunk().map(|bytes| u32::from_le_bytes(*bytes) as usize);
            // What has not come yet may be right.
            let fits = length.is_none_or(|length| (LEAST..=most).contains(&length));
            fits && head.get(HEAD..known).is_none_or(|begin| BEGINS.starts_with(begin))
        };
        let at = (0..self.buffer.len()).find(|at| begins(*at)).unwrap_or(self.buffer.len());
        let head = &self.buffer[at..];
        let whole = head.len() >= HEAD + BEGINS.len();
        (at, head.first_chunk().filter(|_| whole).map(|bytes| u32::from_le_bytes(*bytes) as usize))
    }
}

impl Decoder for PictureReader {
    fn push(&mut self, bytes: &[u8], received_ns: i64, out: &mut Vec<Frame>) {
        self.pictures.stats.take_in(bytes);
        self.buffer.extend_from_slice(bytes);
        loop {
            let (skip, length) = self.next();
            if skip > 0 {
                self.pictures.stats.reject(Rejection::Length, || {
                    format!("{skip} bytes are no length of a picture with a JPEG behind it; is this another device?")
                });
                self.buffer.drain(..skip);
            }
            let Some(end) = length.map(|length| HEAD + length).filter(|end| *end <= self.buffer.len()) else {
                return;
            };
            let jpeg: Vec<u8> = self.buffer.drain(..end).skip(HEAD).collect();
            self.requested = None;
            out.extend(self.pictures.frame(&jpeg, received_ns, self.buffer.len()));
        }
    }

    fn request(&mut self, now_ns: i64) -> Option<Vec<u8>> {
        if self.requested.is_some_and(|at| now_ns - at < OVERDUE) {
            return None;
        }
        self.requested = Some(now_ns);
        Some(REQUEST.to_vec())
    }

    fn gap(&mut self) {
        self.buffer.clear();
        self.requested = None;
    }

    fn stats(&self) -> &DecoderStats {
        &self.pictures.stats
    }

    fn clock(&self) -> ClockState {
        self.pictures.clock.state()
    }

    fn clock_jumps(&self) -> u64 {
        self.pictures.clock.resets()
    }
}

/// Answers requests with pictures.
#[derive(Debug, Default)]
pub struct PictureWriter {
    bytes: Vec<u8>,
}

impl Encoder for PictureWriter {
    fn encode(&mut self, frame: &Frame, _: u64) -> Result<&[u8], String> {
        let image = frame.image.as_ref().ok_or("sends pictures, and there is none")?;
        self.bytes.clear();
        self.bytes.extend_from_slice(&[0; HEAD]);
        match image.jpeg() {
            Some(jpeg) => self.bytes.extend_from_slice(jpeg),
            None => compress(image, &mut self.bytes)?,
        }
        let length = u32::try_from(self.bytes.len() - HEAD).map_err(|_| "a picture is too large")?;
        self.bytes[..HEAD].copy_from_slice(&length.to_le_bytes());
        Ok(&self.bytes)
    }

    fn on_request(&self) -> bool {
        true
    }

    /// Each line is a request; so is whatever comes without an end of line, up to 256 bytes, as the original device takes it.
    fn requested_frames(&mut self, bytes: &[u8]) -> usize {
        let lines = bytes.iter().filter(|byte| **byte == b'\n').count();
        if lines > 0 { lines } else { bytes.len().div_ceil(REQUEST_MAX) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jpeg::MULTIPLE;
    use dermis_skin::{Image, PixelFormat};
    use proptest::prelude::*;

    pub(super) const SIZE: [u32; 2] = [40, 24];
    const BLOCKS: [u32; 2] = [4, 3];

    pub(super) fn pixels([width, height]: [u32; 2], shade: u8) -> Image {
        let value = |i: u32| {
            let (x, y) = (i / 3 % width, i / 3 / width);
            (u32::from(shade) + 100 * x / width + 60 * y / height) as u8
        };
        let data: Vec<u8> = (0..width * height * 3).map(value).collect();
        Image::new(width, height, PixelFormat::Rgb8, data).unwrap()
    }

    pub(super) fn observer() -> Arc<Observer> {
        Arc::new(Observer::of_means(SIZE, BLOCKS))
    }

    fn reader() -> PictureReader {
        PictureReader::new(observer())
    }

    pub(super) fn answer(image: Image) -> Vec<u8> {
        let mut frame = Frame::new(0, 0, Vec::new());
        frame.image = Some(image);
        PictureWriter::default().encode(&frame, 0).unwrap().to_vec()
    }

    fn read(pieces: &[&[u8]]) -> (Vec<Frame>, DecoderStats) {
        let mut reader = reader();
        let mut frames = Vec::new();
        pieces.iter().for_each(|piece| reader.push(piece, 5, &mut frames));
        (frames, reader.stats().clone())
    }

    #[test]
    fn a_picture_and_its_means_come_through() {
        let (frames, stats) = read(&[&answer(pixels(SIZE, 20)), &answer(pixels(SIZE, 60))]);
        assert_eq!((frames.len(), stats.frames, stats.rejected.total()), (2, 2, 0));
        assert_eq!(frames.iter().map(|f| f.sequence).collect::<Vec<_>>(), [0, 1]);
        for (frame, shade) in frames.iter().zip([20, 60]) {
            let wanted = pixels(SIZE, shade);
            let image = frame.image.as_ref().unwrap();
            assert_eq!(image.jpeg(), Some(&answer(pixels(SIZE, shade))[HEAD..]));
            let off = image.data().iter().zip(wanted.data()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(off <= Some(6), "{off:?}");
            let mut means_of = vec![0.0; 36];
            observer().observe(wanted.data(), &mut means_of);
            assert!(frame.values.iter().zip(&means_of).all(|(a, b)| (f64::from(*a) - b).abs() < 0.01));
        }
    }

    #[test]
    fn a_larger_camera_is_reduced_and_another_refused() {
        for times in 1..=MULTIPLE {
            let (frames, stats) = read(&[&answer(pixels(SIZE.map(|side| side * times), 20))]);
            assert_eq!(frames.len(), 1, "{times}: {:?}", stats.last_rejection);
            let image = frames[0].image.as_ref().unwrap();
            let off = image.data().iter().zip(pixels(SIZE, 20).data()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!([image.width(), image.height()] == SIZE && off <= Some(6), "{times}: {off:?}");
        }
        for other in [[20, 12], [80, 96], [400, 240], [41, 24]] {
            let (frames, stats) = read(&[&answer(pixels(other, 20)), &answer(pixels(SIZE, 20))]);
            assert_eq!((frames.len(), stats.rejected.format), (1, 1), "{other:?}");
        }
    }

    /// A header of 65,535 x 65,535 pixels would take 12 GB: it is refused before that.
    #[test]
    fn a_decompression_bomb_is_refused_by_its_header() {
        let mut bomb = answer(pixels(SIZE, 20));
        let at = bomb.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
        bomb[at + 5..at + 9].fill(0xff);
        let (frames, stats) = read(&[&bomb, &answer(pixels(SIZE, 20))]);
        assert_eq!((frames.len(), stats.rejected.format), (1, 1));
        let said = stats.last_rejection.unwrap();
        assert!(said.contains("65535 x 65535") || said.contains("no JPEG"), "{said}");
    }

    #[test]
    fn a_length_that_cannot_be_is_skipped() {
        let good = answer(pixels(SIZE, 20));
        for length in [0_u32, 3, u32::MAX, 1 << 27] {
            let mut bad = good.clone();
            bad[..HEAD].copy_from_slice(&length.to_le_bytes());
            let (frames, stats) = read(&[&bad, &good]);
            assert_eq!(frames.len(), 1, "{length}");
            assert!(stats.rejected.length >= 1);
        }
    }

    #[test]
    fn a_request_is_made_again_where_no_answer_comes() {
        let mut reader = reader();
        assert_eq!(reader.request(0).as_deref(), Some(REQUEST));
        assert_eq!(reader.request(1_000_000), None);
        assert_eq!(reader.request(OVERDUE).as_deref(), Some(REQUEST));
        reader.push(&answer(pixels(SIZE, 20)), 5, &mut Vec::new());
        assert!(reader.request(OVERDUE + 1).is_some());
        let mut writer = PictureWriter::default();
        assert_eq!(
            [
                writer.requested_frames(REQUEST),
                writer.requested_frames(b"x"),
                writer.requested_frames(b""),
                writer.requested_frames(&[7; 300])
            ],
            [1, 1, 0, 2]
        );
        assert!(writer.on_request() && writer.encode(&Frame::new(0, 0, vec![]), 0).is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn pictures_are_read_however_they_are_cut(
            cuts in proptest::collection::vec(1..200usize, 1..40),
            noise in proptest::collection::vec(any::<u8>(), 0..20),
        ) {
            let mut stream = noise.clone();
            // Noise may look like a length; a zero after it ends that.
            stream.extend([0; 8]);
            (0..3).for_each(|i| stream.extend(answer(pixels(SIZE, 20 * i))));
            let (mut reader, mut frames) = (reader(), Vec::new());
            let mut rest = &stream[..];
            for cut in cuts.iter().cycle() {
                let (piece, left) = rest.split_at((*cut).min(rest.len()));
                reader.push(piece, 5, &mut frames);
                rest = left;
                if rest.is_empty() { break }
            }
            prop_assert_eq!(frames.len(), 3);
        }

        #[test]
        fn nothing_makes_it_panic_or_keep_more_than_one_picture(
            bytes in proptest::collection::vec(any::<u8>(), 0..2000),
            flip in proptest::collection::vec((0..2000usize, any::<u8>()), 0..8),
        ) {
            let mut damaged = answer(pixels(SIZE, 20));
            for (at, value) in flip {
                if let Some(byte) = damaged.get_mut(at) { *byte = value }
            }
            let (mut reader, mut frames) = (reader(), Vec::new());
            for piece in [&bytes[..], &damaged, &bytes] {
                reader.push(piece, 5, &mut frames);
                prop_assert!(reader.buffer.len() <= HEAD + most_bytes(SIZE));
            }
        }
    }
}
