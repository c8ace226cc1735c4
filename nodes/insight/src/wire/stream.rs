//! Pictures one after another, as a camera's web server streams them (MJPEG over HTTP), a file of them holds them, or a program pipes them.
//!
//! A picture ends where its own markers say so (ITU-T T.81, annex B): segments have lengths, and compressed data end at the first marker
//! in them that is none of a restart. What lies between two pictures, the heads of a multipart stream for one, is skipped. So nothing
//! depends on what servers write there, which differs.
//!
//! Cost: each byte is inspected once, and compressed data for the byte 255 only.

use std::ops::ControlFlow;
use std::sync::Arc;

use dermis_sensor::Decoder;
use dermis_skin::Frame;
use dermis_transport::ClockState;
use dermis_transport::framing::{DecoderStats, Rejection};
use memchr::{memchr, memmem};

use super::{BEGINS, Pictures};
use crate::jpeg::marker;
use crate::optics::Observer;

/// As skin files name it.
pub const NAME: &str = "mjpeg";

/// \[bytes\] between two pictures that are taken for the head of the next one; more are no stream of pictures.
const BETWEEN: usize = 4096;

/// How far into a picture its markers have been followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Progress {
    /// A marker is due at this byte.
    Marker(usize),
    /// Compressed data go on at this byte.
    Data(usize),
}

/// Reads a stream of pictures.
#[derive(Debug)]
pub struct StreamReader {
    pictures: Pictures,
    buffer: Vec<u8>,
    /// Where the buffer begins with a picture.
    progress: Option<Progress>,
    /// Bytes skipped since the last picture.
    between: usize,
}

impl StreamReader {
    /// For pictures that `observer` makes a frame's numbers of.
    #[must_use]
    pub fn new(observer: Arc<Observer>) -> Self {
        Self { pictures: Pictures::new(observer), buffer: Vec::new(), progress: None, between: 0 }
    }

    /// Passes over what is before the next picture; breaks where that has not come yet.
    fn seek(&mut self) -> ControlFlow<()> {
        let found = memmem::find(&self.buffer, &BEGINS);
        // The last two bytes may be the beginning of a beginning.
        let skip = found.unwrap_or(self.buffer.len().saturating_sub(BEGINS.len() - 1));
        self.buffer.drain(..skip);
        self.between += skip;
        if self.between > BETWEEN {
            let passed = std::mem::take(&mut self.between);
            self.pictures.stats.reject(Rejection::Length, || {
                format!("{passed} bytes hold no JPEG; is this the address of a stream of pictures?")
            });
        }
        if found.is_none() {
            return ControlFlow::Break(());
        }
        self.between = 0;
        self.progress = Some(Progress::Marker(2));
        ControlFlow::Continue(())
    }

    /// Follows the markers of the picture that the buffer begins with: its length, or `None` where its end has not come yet.
    fn follow(&mut self, from: Progress) -> Result<Option<usize>, &'static str> {
        let mut now = from;
        loop {
            self.progress = Some(now);
            now = match now {
                Progress::Marker(at) => {
                    let Some([begin, kind]) = self.buffer.get(at..).and_then(|rest| rest.first_chunk())
                    else {
                        return Ok(None);
                    };
                    match (*begin, *kind) {
                        (0xff, marker::FILL) => Progress::Marker(at + 1),
                        (0xff, marker::END) => return Ok(Some(at + 2)),
                        (0xff, marker::BEGIN) => return Err("begins again before it has ended"),
                        (0xff, kind) if marker::RESTARTS.contains(&kind) => Progress::Marker(at + 2),
                        (0xff, kind) => {
                            let Some(length) = self.buffer.get(at + 2..).and_then(|rest| rest.first_chunk())
                            else {
                                return Ok(None);
                            };
                            let next = at + 2 + usize::from(u16::from_be_bytes(*length));
                            if next < at + 4 {
                                return Err("has a segment that is shorter than its own length");
                            }
                            if kind == marker::SCAN { Progress::Data(next) } else { Progress::Marker(next) }
                        }
                        _ => return Err("has something else where a marker is due"),
                    }
                }
                Progress::Data(at) => {
                    let Some(found) = self.buffer.get(at..).and_then(|rest| memchr(0xff, rest)) else {
                        // A scan's head may reach beyond what has come.
                        self.progress = Some(Progress::Data(at.max(self.buffer.len())));
                        return Ok(None);
                    };
                    match self.buffer.get(at + found + 1) {
                        None => {
                            self.progress = Some(Progress::Data(at + found));
                            return Ok(None);
                        }
                        Some(&marker::STUFFED) => Progress::Data(at + found + 2),
                        Some(kind) if marker::RESTARTS.contains(kind) => Progress::Data(at + found + 2),
                        Some(_) => Progress::Marker(at + found),
                    }
                }
            };
        }
    }

    /// Gives up the picture that the buffer begins with.
    fn give_up(&mut self, reason: &str) {
        self.pictures.stats.reject(Rejection::Format, || format!("a picture {reason}"));
        self.buffer.drain(..2);
        self.progress = None;
    }
}

impl Decoder for StreamReader {
    fn push(&mut self, bytes: &[u8], received_ns: i64, out: &mut Vec<Frame>) {
        self.pictures.stats.take_in(bytes);
        self.buffer.extend_from_slice(bytes);
        loop {
            let Some(progress) = self.progress else {
                match self.seek() {
                    ControlFlow::Continue(()) => continue,
                    ControlFlow::Break(()) => return,
                }
            };
            let most = self.pictures.most();
            match self.follow(progress) {
                Ok(Some(end)) if end <= most => {
                    let jpeg: Vec<u8> = self.buffer.drain(..end).collect();
                    self.progress = None;
                    out.extend(self.pictures.frame(&jpeg, received_ns, self.buffer.len()));
                }
                Ok(None) if self.buffer.len() <= most => return,
                Ok(_) => self.give_up("has more bytes than its pixels"),
                Err(reason) => self.give_up(reason),
            }
        }
    }

    fn gap(&mut self) {
        self.buffer.clear();
        self.progress = None;
        self.between = 0;
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::tests::{SIZE, answer, observer, pixels};
    use super::super::{HEAD, most_bytes};
    use super::*;

    fn jpeg(shade: u8) -> Vec<u8> {
        answer(pixels(SIZE, shade)).split_off(HEAD)
    }

    fn part(shade: u8) -> Vec<u8> {
        let jpeg = jpeg(shade);
        let head =
            format!("\r\n--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", jpeg.len());
        [head.into_bytes(), jpeg].concat()
    }

    #[test]
    fn parts_of_a_web_stream_and_plain_pictures_are_read() {
        for stream in
            [[part(20), part(60), b"\r\n--frame\r\n".to_vec()].concat(), [jpeg(20), jpeg(60)].concat()]
        {
            let (mut reader, mut frames) = (StreamReader::new(observer()), Vec::new());
            reader.push(&stream, 5, &mut frames);
            assert_eq!((frames.len(), reader.stats().rejected.total()), (2, 0));
            for (frame, shade) in frames.iter().zip([20, 60]) {
                let wanted = pixels(SIZE, shade);
                let image = frame.image.as_ref().unwrap();
                let off = image.data().iter().zip(wanted.data()).map(|(a, b)| a.abs_diff(*b)).max();
                assert!(off <= Some(6), "{off:?}");
            }
        }
    }

    /// A camera's thumbnail is a JPEG within a segment of the picture.
    #[test]
    fn a_picture_within_a_picture_is_part_of_it() {
        let (outer, inner) = (jpeg(20), jpeg(60));
        let length = u16::try_from(inner.len() + 2).unwrap().to_be_bytes();
        let nested = [&outer[..2], &[0xff, 0xe1], &length, &inner, &outer[2..]].concat();
        let (mut reader, mut frames) = (StreamReader::new(observer()), Vec::new());
        reader.push(&nested, 5, &mut frames);
        let first = frames[0].image.as_ref().unwrap().data()[0];
        assert!(frames.len() == 1 && first.abs_diff(20) <= 6, "{first}");
    }

    #[test]
    fn a_page_is_no_stream() {
        let (mut reader, mut frames) = (StreamReader::new(observer()), Vec::new());
        reader.push(&b"<html>nothing here</html>\n".repeat(400), 5, &mut frames);
        let said = reader.stats().last_rejection.clone().unwrap();
        assert!(frames.is_empty() && said.contains("no JPEG"), "{said}");
    }

    #[test]
    fn what_is_broken_costs_one_picture() {
        for broken in [
            jpeg(20)[..200].to_vec(),
            [&BEGINS[..], &[0xe0, 0, 1]].concat(),
            [&BEGINS[..], &vec![7; most_bytes(SIZE)]].concat(),
        ] {
            let (mut reader, mut frames) = (StreamReader::new(observer()), Vec::new());
            for piece in [&broken, &part(20), &part(60), &part(90)] {
                reader.push(piece, 5, &mut frames);
            }
            assert!(frames.len() >= 2, "{} of 3", frames.len());
            assert!(reader.stats().rejected.total() >= 1);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn streams_are_read_however_they_are_cut(cuts in proptest::collection::vec(1..200usize, 1..40)) {
            let stream = [part(0), part(40), part(80)].concat();
            let (mut reader, mut frames) = (StreamReader::new(observer()), Vec::new());
            let mut rest = &stream[..];
            for cut in cuts.iter().cycle() {
                let (piece, left) = rest.split_at((*cut).min(rest.len()));
                reader.push(piece, 5, &mut frames);
                rest = left;
                if rest.is_empty() { break }
            }
            prop_assert_eq!((frames.len(), reader.stats().rejected.total()), (3, 0));
        }

        #[test]
        fn nothing_makes_it_panic_or_keep_more_than_one_picture(
            bytes in proptest::collection::vec(any::<u8>(), 0..2000),
            flip in proptest::collection::vec((0..2000usize, any::<u8>()), 0..8),
        ) {
            let mut damaged = part(20);
            for (at, value) in flip {
                if let Some(byte) = damaged.get_mut(at) { *byte = value }
            }
            let (mut reader, mut frames) = (StreamReader::new(observer()), Vec::new());
            for piece in [&bytes[..], &damaged, &bytes] {
                reader.push(piece, 5, &mut frames);
                prop_assert!(reader.buffer.len() <= most_bytes(SIZE));
            }
        }
    }
}
