//! Lines of numbers.

use super::sequence::{SequenceTracker, Verdict};
use super::{DecodedFrame, DecoderStats, FrameDecoder, MAX_CHANNELS, Rejection};

/// What the columns of a line are, in this order: sequence, device time, values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct AsciiOptions {
    /// Values on a line; `None` takes any number, and then cannot tell a line that lost its end.
    pub channels: Option<usize>,
    /// The first column is a sequence number (unsigned, 32 bits, wraps).
    pub sequence: bool,
    /// The next column is the device time \[µs\].
    pub device_time: bool,
    /// Values are whole numbers between these: counts of a converter. A line with any other is damaged.
    pub counts: Option<[u32; 2]>,
}

impl AsciiOptions {
    /// Lines of so many values and nothing else.
    #[must_use]
    pub fn channels(channels: usize) -> Self {
        Self { channels: Some(channels), ..Self::default() }
    }

    /// The first column is a sequence number.
    #[must_use]
    pub fn with_sequence(mut self) -> Self {
        self.sequence = true;
        self
    }

    /// The column before the values is the device time \[µs\].
    #[must_use]
    pub fn with_device_time(mut self) -> Self {
        self.device_time = true;
        self
    }

    /// Values are whole numbers between these.
    #[must_use]
    pub fn with_counts(mut self, counts: [u32; 2]) -> Self {
        self.counts = Some(counts);
        self
    }
}

/// Reads lines of numbers, separated by commas, semicolons, blanks or tabs and ended by LF, CR or both.
///
/// `nan` is an invalid channel. Empty lines and lines that begin with `#` are skipped, and one separator at the
/// end of a line does no harm. Text has no checksum: a line whose damage still reads as the right number of numbers
/// is taken unless it leaves the range of [`AsciiOptions::counts`], and so the native wire is the better choice where the
/// firmware is yours. The first line after
/// [`FrameDecoder::gap`] is dropped, for it may be the second half of one.
#[derive(Debug, Clone)]
pub struct AsciiDecoder {
    options: AsciiOptions,
    limit: usize,
    line: Vec<u8>,
    state: Hunt,
    sequence: SequenceTracker,
    counted: u64,
    stats: DecoderStats,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Hunt {
    Start,
    Line,
    Skip,
}

/// \[bytes\] that one number may take on a line.
const FIELD_LEN: usize = 32;

impl AsciiDecoder {
    /// A decoder for lines of these columns.
    #[must_use]
    pub fn new(options: AsciiOptions) -> Self {
        let columns = options.channels.unwrap_or(MAX_CHANNELS).min(MAX_CHANNELS) + 2;
        let typical = options.channels.unwrap_or(64).min(MAX_CHANNELS) * 12;
        Self {
            options,
            limit: columns * FIELD_LEN,
            line: Vec::new(),
            state: Hunt::Start,
            sequence: SequenceTracker::default(),
            counted: 0,
            stats: DecoderStats::new(typical),
        }
    }

    fn collect(&mut self, bytes: &[u8]) {
        if self.state != Hunt::Line {
            return;
        }
        if self.line.len() + bytes.len() > self.limit {
            let limit = self.limit;
            self.stats
                .reject(Rejection::Length, || format!("more than {limit} bytes without an end of line"));
            self.line.clear();
            self.state = Hunt::Skip;
            return;
        }
        self.line.extend_from_slice(bytes);
    }

    fn finish(&mut self, rest: usize, received_ns: i64, out: &mut Vec<DecodedFrame>) {
        match std::mem::replace(&mut self.state, Hunt::Line) {
            Hunt::Start => self.stats.reject(Rejection::Partial, String::new),
            Hunt::Skip => {}
            Hunt::Line => {
                let mut line = std::mem::take(&mut self.line);
                self.decode_line(&line, rest, received_ns, out);
                line.clear();
                self.line = line;
            }
        }
    }

    fn decode_line(&mut self, line: &[u8], rest: usize, received_ns: i64, out: &mut Vec<DecodedFrame>) {
        let text = match std::str::from_utf8(line) {
            Ok(text) => text.trim(),
            Err(_) => {
                self.stats.reject(Rejection::NotANumber, || "a line is not text".into());
                return;
            }
        };
        if text.is_empty() || text.starts_with('#') {
            return;
        }
        let parsed = match parse(text, &self.options) {
            Ok(parsed) => parsed,
            Err((reason, why)) => {
                self.stats.reject(reason, || why);
                return;
            }
        };
        self.stats.valid(rest);
        let sequence = match parsed.sequence {
            Some(sequence) => {
                match self.sequence.classify(sequence, parsed.device_time_us, &mut self.stats) {
                    Verdict::Accept(sequence) => sequence,
                    Verdict::Drop => return,
                }
            }
            None => self.counted,
        };
        self.counted = self.counted.wrapping_add(1);
        self.stats.frames += 1;
        out.push(DecodedFrame {
            sequence,
            device_time_us: parsed.device_time_us,
            received_ns,
            values: parsed.values,
        });
    }
}

impl FrameDecoder for AsciiDecoder {
    fn push(&mut self, bytes: &[u8], received_ns: i64, out: &mut Vec<DecodedFrame>) {
        self.stats.take_in(bytes);
        let mut rest = bytes;
        while let Some(end) = rest.iter().position(|b| matches!(b, b'\n' | b'\r')) {
            self.collect(&rest[..end]);
            rest = &rest[end + 1..];
            self.finish(rest.len(), received_ns, out);
        }
        self.collect(rest);
    }

    fn gap(&mut self) {
        self.line.clear();
        self.state = Hunt::Start;
    }

    fn stats(&self) -> &DecoderStats {
        &self.stats
    }
}

struct Line {
    sequence: Option<u32>,
    device_time_us: Option<u64>,
    values: Vec<f32>,
}

fn parse(text: &str, options: &AsciiOptions) -> Result<Line, (Rejection, String)> {
    let text = text.strip_suffix([',', ';']).unwrap_or(text);
    let mut fields: Box<dyn Iterator<Item = &str>> = if text.contains([',', ';']) {
        Box::new(text.split([',', ';']).map(str::trim))
    } else {
        Box::new(text.split_ascii_whitespace())
    };
    let mut column = 0;
    let mut next = |fields: &mut dyn Iterator<Item = &'_ str>, what: &str| match fields.next() {
        Some(field) => {
            column += 1;
            field.parse::<u64>().map_err(|_| {
                (Rejection::NotANumber, format!("column {column} is `{}`, not a {what}", shown(field)))
            })
        }
        None => Err((Rejection::Channels, format!("a line ends before its {what}"))),
    };
    let sequence = match options.sequence {
        true => Some(u32::try_from(next(&mut fields, "sequence number")? & u64::from(u32::MAX)).unwrap_or(0)),
        false => None,
    };
    let device_time_us = match options.device_time {
        true => Some(next(&mut fields, "device time in microseconds")?),
        false => None,
    };
    let expected = options.channels;
    let mut values = Vec::with_capacity(expected.unwrap_or(16).min(MAX_CHANNELS));
    for field in fields {
        column += 1;
        let value = field.parse::<f32>().ok().filter(|v| !v.is_infinite()).ok_or_else(|| {
            (Rejection::NotANumber, format!("column {column} is `{}`, not a finite number", shown(field)))
        })?;
        if let Some([low, high]) = options.counts
            && !value.is_nan()
            && !(value.fract() == 0.0 && (f64::from(low)..=f64::from(high)).contains(&f64::from(value)))
        {
            let why =
                format!("column {column} is `{}`, not a whole number from {low} to {high}", shown(field));
            return Err((Rejection::Range, why));
        }
        if values.len() == MAX_CHANNELS {
            return Err((Rejection::Channels, format!("a line has more than {MAX_CHANNELS} values")));
        }
        values.push(value);
    }
    if values.is_empty() || expected.is_some_and(|n| n != values.len()) {
        let expected = expected.map_or("at least 1".into(), |n| n.to_string());
        let why = format!("the device sends {} values on a line, expected {expected}", values.len());
        return Err((Rejection::Channels, why));
    }
    Ok(Line { sequence, device_time_us: device_time_us.filter(|t| *t != 0), values })
}

/// The beginning of a field, for a message.
fn shown(field: &str) -> String {
    let end = field.char_indices().nth(24).map_or(field.len(), |(i, _)| i);
    field[..end].escape_debug().to_string()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn decode(options: AsciiOptions, text: &[u8]) -> (Vec<DecodedFrame>, DecoderStats) {
        let mut decoder = AsciiDecoder::new(options);
        let mut out = Vec::new();
        decoder.push(b"\n", 0, &mut out);
        decoder.push(text, 1, &mut out);
        (out, decoder.stats().clone())
    }

    #[test]
    fn separators_and_line_ends_of_every_habit() {
        let text = b"1,2,3\r\n4 5\t6\n7;8;9\r10, 11 , 12,\n\n# boot\n  -1e-3 nan +.5\n";
        let (frames, stats) = decode(AsciiOptions::channels(3), text);
        let values: Vec<_> = frames.iter().map(|f| f.values.clone()).collect();
        assert_eq!(values[..4], [[1., 2., 3.], [4., 5., 6.], [7., 8., 9.], [10., 11., 12.]]);
        assert!(values[4][1].is_nan() && values[4][0] == -1e-3 && values[4][2] == 0.5);
        assert_eq!(stats.rejected.total(), 0);
        assert_eq!(frames.iter().map(|f| f.sequence).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn every_fault_is_counted_under_its_name() {
        let long = vec![b'1'; 10_000];
        let mut text = b"1,2\n1,2,3\n1,x\n1,,2\n1,inf\n\xff\xfe,1\n".to_vec();
        text.extend_from_slice(&long);
        text.extend_from_slice(b"\n3,4\n");
        let (frames, stats) = decode(AsciiOptions::channels(2), &text);
        assert_eq!(frames.iter().map(|f| f.values[0]).collect::<Vec<_>>(), [1.0, 3.0]);
        let r = stats.rejected;
        assert_eq!((r.channels, r.not_a_number, r.length), (1, 4, 1), "{stats:?}");
        assert_eq!(stats.resyncs, 1);
    }

    #[test]
    fn sequence_and_time_columns() {
        let options = AsciiOptions::channels(1).with_sequence().with_device_time();
        let (frames, stats) =
            decode(options, b"4294967295,10,1.5\n0,20,2.5\n3,50,3.5\n3,50,3.5\nx,60,1\n5,70\n");
        let first = u64::from(u32::MAX);
        assert_eq!(frames.iter().map(|f| f.sequence).collect::<Vec<_>>(), [first, first + 1, first + 4]);
        assert_eq!(frames[2].device_time_us, Some(50));
        assert_eq!((stats.lost, stats.duplicates), (2, 1));
        assert_eq!((stats.rejected.not_a_number, stats.rejected.channels), (1, 1));
        insta::assert_snapshot!(stats.last_rejection.unwrap(), @"column 1 is `x`, not a sequence number");
    }

    #[test]
    fn counts_that_no_converter_gives_are_refused() {
        let options = AsciiOptions::channels(3).with_counts([0, 4095]);
        let (frames, stats) = decode(options, b"0,2048,4095\n1,4096,3\n1,-1,3\n1,2.5,3\n7,nan,9\n");
        assert_eq!(frames.len(), 2);
        assert!(frames[1].values[1].is_nan(), "a channel without a value is no damaged line");
        assert_eq!((stats.rejected.range, stats.rejected.total()), (3, 3));
        insta::assert_snapshot!(stats.last_rejection.unwrap(), @"column 2 is `4096`, not a whole number from 0 to 4095");
    }

    #[test]
    fn half_a_line_is_never_a_frame() {
        let mut decoder = AsciiDecoder::new(AsciiOptions::channels(2));
        let mut out = Vec::new();
        decoder.push(b"325,7\n1,2\n101", 1, &mut out);
        decoder.gap();
        decoder.push(b"5,3\n5,6\n", 1, &mut out);
        let values: Vec<_> = out.iter().map(|f| f.values.clone()).collect();
        assert_eq!(values, [[1.0, 2.0], [5.0, 6.0]]);
        assert_eq!(decoder.stats().rejected.partial, 2);
    }

    proptest! {
        #[test]
        fn any_cut_gives_the_same_frames(
            lines in proptest::collection::vec(proptest::collection::vec(-1e5f32..1e5, 3..=3), 1..20),
            cut in 1usize..40,
        ) {
            let text: String = lines.iter().map(|v| format!("{},{},{}\r\n", v[0], v[1], v[2])).collect();
            let whole = decode(AsciiOptions::channels(3), text.as_bytes()).0;
            prop_assert_eq!(whole.iter().map(|f| f.values.clone()).collect::<Vec<_>>(), lines);
            let mut decoder = AsciiDecoder::new(AsciiOptions::channels(3));
            let mut out = Vec::new();
            decoder.push(b"\n", 0, &mut out);
            for piece in text.as_bytes().chunks(cut) {
                decoder.push(piece, 1, &mut out);
            }
            prop_assert_eq!(out, whole);
        }

        #[test]
        fn no_bytes_panic_or_grow(bytes in proptest::collection::vec(any::<u8>(), 0..2000), n in proptest::option::of(0usize..9)) {
            let mut decoder = AsciiDecoder::new(AsciiOptions { channels: n, sequence: true, device_time: true, counts: None });
            let mut out = Vec::new();
            decoder.push(&bytes, 0, &mut out);
            prop_assert!(decoder.line.len() <= decoder.limit);
            prop_assert_eq!(decoder.stats().bytes, bytes.len() as u64);
        }
    }
}
