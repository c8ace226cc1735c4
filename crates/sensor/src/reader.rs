//! From bytes to frames in the unit of the skin, with the time at which they were acquired.

use dermis_skin::{Frame, SkinDescription, WireProtocol, WireSamples};
use dermis_transport::framing::{
    AsciiDecoder, AsciiOptions, DecodedFrame, DecoderStats, FrameDecoder, NativeDecoder,
};
use dermis_transport::{ClockState, DeviceClock};

use crate::Decoder;
use crate::writer::native_format;

/// Frames of the other wire in a row, each with as many numbers, that are no accident.
const MISTAKEN: u32 = 3;

/// Finds frames in a stream of bytes, scales them to the unit of the skin and stamps them.
pub struct FrameReader {
    decoder: Box<dyn FrameDecoder>,
    protocol: WireProtocol,
    channels: usize,
    /// Reads the other wire, until a frame of the one that the skin names comes.
    other: Option<Box<dyn FrameDecoder>>,
    /// What it reads.
    foreign: Vec<DecodedFrame>,
    /// Numbers in each of its frames, and how many of those there were in a row.
    mistaken: (usize, u32),
    scale: f64,
    offset: f64,
    clock: DeviceClock,
    /// Stamp and device time of the first frame, where stamps follow the device's clock as it is.
    device_epoch: Option<Option<(i64, u64)>>,
    decoded: Vec<DecodedFrame>,
}

impl FrameReader {
    /// A reader of the wire that the skin description names; `None` where that is one of its family's own.
    #[must_use]
    pub fn new(skin: &SkinDescription) -> Option<Self> {
        let channels = skin.channels().len();
        let native = |channels, samples: Option<WireSamples>| -> Box<dyn FrameDecoder> {
            let decoder = NativeDecoder::new(channels);
            Box::new(match samples {
                Some(samples) => decoder.only(native_format(samples)),
                None => decoder,
            })
        };
        let lines = |options| -> Box<dyn FrameDecoder> { Box::new(AsciiDecoder::new(options)) };
        let (decoder, other) = match skin.wire.protocol {
            WireProtocol::Native => {
                (native(Some(channels), skin.wire.samples), lines(AsciiOptions::default()))
            }
            WireProtocol::Ascii => {
                let mut options = AsciiOptions::channels(channels);
                options.counts = skin.wire.counts;
                (lines(options), native(None, None))
            }
            WireProtocol::Family(_) => return None,
        };
        Some(Self {
            decoder,
            protocol: skin.wire.protocol.clone(),
            channels,
            other: Some(other),
            foreign: Vec::new(),
            mistaken: (0, 0),
            scale: skin.wire.scale,
            offset: skin.wire.offset,
            clock: DeviceClock::new(),
            device_epoch: None,
            decoded: Vec::new(),
        })
    }

    /// Has stamps follow the device's clock as it is, from the first frame on: for recordings that are played at another
    /// pace than they were made at. A device without a clock is stamped on arrival all the same.
    #[must_use]
    pub fn with_device_time(mut self) -> Self {
        self.device_epoch = Some(None);
        self
    }

    fn stamp(&mut self, device_time_us: Option<u64>, received_ns: i64) -> i64 {
        if let (Some(epoch), Some(device)) = (&mut self.device_epoch, device_time_us) {
            let (stamp, first) = *epoch.get_or_insert((received_ns, device));
            let elapsed = i128::from(device) - i128::from(first);
            return i64::try_from(i128::from(stamp) + elapsed * 1000).unwrap_or(received_ns);
        }
        self.clock.stamp(device_time_us, received_ns)
    }

    fn look_for_the_other_wire(&mut self, bytes: &[u8], received_ns: i64) {
        let Some(other) = &mut self.other else { return };
        other.push(bytes, received_ns, &mut self.foreign);
        for frame in self.foreign.drain(..) {
            let (numbers, row) = &mut self.mistaken;
            *row = if *numbers == frame.values.len() { row.saturating_add(1) } else { 1 };
            *numbers = frame.values.len();
        }
    }
}

impl Decoder for FrameReader {
    fn push(&mut self, bytes: &[u8], received_ns: i64, out: &mut Vec<Frame>) {
        self.decoder.push(bytes, received_ns, &mut self.decoded);
        let mut arrived = std::mem::take(&mut self.decoded);
        if arrived.is_empty() {
            self.look_for_the_other_wire(bytes, received_ns);
        } else {
            (self.other, self.mistaken) = (None, (0, 0));
        }
        for decoded in arrived.drain(..) {
            let stamp = self.stamp(decoded.device_time_us, decoded.received_ns);
            let values = decoded
                .values
                .iter()
                .map(|raw| (f64::from(*raw) * self.scale + self.offset) as f32)
                .collect();
            let mut frame = Frame::new(stamp, decoded.sequence, values);
            frame.device_time_us = decoded.device_time_us.unwrap_or(0);
            out.push(frame);
        }
        self.decoded = arrived;
    }

    fn other_wire(&self) -> Option<String> {
        let (numbers, row) = self.mistaken;
        // Lines have no checksum: noise that holds a number is none of them.
        let rejected = self.other.as_ref()?.stats().rejected.total();
        if row < MISTAKEN || rejected > u64::from(row) {
            return None;
        }
        let channels = if numbers == self.channels {
            String::new()
        } else {
            format!("; they have {numbers} numbers each where the skin has {} channels", self.channels)
        };
        Some(match self.protocol {
            WireProtocol::Native => format!(
                "the device sends lines of text, and the skin file expects the binary wire: write `[wire]` and below it \
                 `protocol = \"ascii\"` into the skin file{channels}"
            ),
            _ => format!(
                "the device sends frames of the binary wire, and the skin file expects lines of text: write `protocol = \
                 \"native\"` into its table `[wire]`{channels}"
            ),
        })
    }

    fn gap(&mut self) {
        self.decoder.gap();
        if let Some(other) = &mut self.other {
            other.gap();
        }
    }

    fn stats(&self) -> &DecoderStats {
        self.decoder.stats()
    }

    fn clock_jumps(&self) -> u64 {
        // A device that starts again mostly does both.
        self.clock.resets().max(self.stats().restarts)
    }

    fn clock(&self) -> ClockState {
        self.clock.state()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_fixtures::SkinFile;
    use dermis_transport::framing::{NativeEncoder, NativeFormat};

    /// [`SkinFile::four_barometers`], of which lines of `extra` replace or add top-level keys.
    fn skin_with(extra: &str) -> SkinDescription {
        SkinFile::four_barometers().lines(extra).read()
    }

    #[test]
    fn raw_counts_become_units_and_keep_the_device_time() {
        let skin = skin_with("wire = { scale = 0.25, offset = 100000.0 }");
        let mut reader = FrameReader::new(&skin).unwrap();
        let mut encoder = NativeEncoder::new(NativeFormat::U16);
        let mut frames = Vec::new();
        for k in 0..3_u32 {
            let bytes = encoder.encode(k, u64::from(k) * 10_000 + 1, &[0.0, 4.0, 5300.0, 65535.0]).unwrap();
            // Each frame 2 ms later on its way than the one before.
            reader.push(bytes, 1_000_000_000 + i64::from(k) * 12_000_000, &mut frames);
        }
        let last = frames.last().unwrap();
        assert_eq!(last.values, [100_000.0, 100_001.0, 101_325.0, 116_383.75]);
        assert_eq!((last.sequence, last.device_time_us), (2, 20_001));
        assert_eq!(last.stamp, 1_020_000_000, "stamped when measured, not when received");
    }

    #[test]
    fn device_time_keeps_the_recorded_pace() {
        let skin = skin_with("");
        let mut reader = FrameReader::new(&skin).unwrap().with_device_time();
        let mut encoder = NativeEncoder::new(NativeFormat::F32);
        let mut frames = Vec::new();
        for k in 0..3_u32 {
            // Recorded 4 s apart, played 1 ms apart.
            let bytes = encoder.encode(k, 7 + u64::from(k) * 4_000_000, &[0.0; 4]).unwrap();
            reader.push(bytes, 1_000_000_000 + i64::from(k) * 1_000_000, &mut frames);
        }
        let stamps: Vec<i64> = frames.iter().map(|f| f.stamp).collect();
        assert_eq!(stamps, [1_000_000_000, 5_000_000_000, 9_000_000_000]);
    }

    #[test]
    fn counts_beyond_the_converter_are_refused_with_the_line() {
        let skin = skin_with(
            "wire = { protocol = \"ascii\", scale = 2e-6, offset = -0.004096, counts = [0, 4095] }\nrange = [-0.004096, 0.004094]",
        );
        let mut reader = FrameReader::new(&skin).unwrap();
        let mut frames = Vec::new();
        reader.push(b"\n2048,2049,0,4095\n2048,2049,0,4096\n2048,-1,0,1\n", 5, &mut frames);
        let [frame] = frames.as_slice() else { panic!("{frames:?}") };
        let expected = [0.0, 2e-6, -0.004096, 0.004094];
        assert!(
            frame.values.iter().zip(expected).all(|(v, e)| (f64::from(*v) - e).abs() < 1e-9),
            "{frame:?}"
        );
        assert_eq!(reader.stats().rejected.range, 2);
    }

    #[test]
    fn a_device_on_the_other_wire_receives_the_key() {
        let mut frames = Vec::new();
        let mut binary = FrameReader::new(&skin_with("")).unwrap();
        binary.push(b"325,7\n1,2,3,4\n5,6,7,8\n", 1, &mut frames);
        assert_eq!(binary.other_wire(), None, "two lines may be an accident");
        binary.push(b"9,10,11,12\n", 1, &mut frames);
        insta::assert_snapshot!(binary.other_wire().unwrap(), @r#"the device sends lines of text, and the skin file expects the binary wire: write `[wire]` and below it `protocol = "ascii"` into the skin file"#);
        binary.push(b"1,2\n1,2\n1,2\n", 1, &mut frames);
        assert!(binary.other_wire().unwrap().ends_with("2 numbers each where the skin has 4 channels"));

        let mut lines = FrameReader::new(&skin_with("wire = { protocol = \"ascii\" }")).unwrap();
        let mut encoder = NativeEncoder::new(NativeFormat::F32);
        for k in 0..4 {
            lines.push(encoder.encode(k, 1, &[0.5; 4]).unwrap(), 1, &mut frames);
        }
        insta::assert_snapshot!(lines.other_wire().unwrap(), @r#"the device sends frames of the binary wire, and the skin file expects lines of text: write `protocol = "native"` into its table `[wire]`"#);
        assert!(frames.is_empty());
        // Once the right one comes, all is well.
        lines.push(b"\n1,2,3,4\n", 1, &mut frames);
        assert!(frames.len() == 1 && lines.other_wire().is_none());

        // Noise has a line that is a number now and then.
        let mut noisy = FrameReader::new(&skin_with("")).unwrap();
        noisy.push(b"\xf8\n1\n\xc7\x3f\n\xfe\n1\n\xf0\n\xf1\n1\n", 1, &mut frames);
        assert_eq!(noisy.other_wire(), None);
    }

    #[test]
    fn lines_of_text_are_read_where_the_skin_says_so() {
        let skin = skin_with("wire = { protocol = \"ascii\" }");
        let mut reader = FrameReader::new(&skin).unwrap();
        let mut frames = Vec::new();
        reader.push(b"# hello\n1,2,3,nan\n1,2,3\n4,5,6,7\n", 5, &mut frames);
        assert_eq!(frames.last().map(|f| f.values.clone()), Some(vec![4.0, 5.0, 6.0, 7.0]));
        assert!(frames.iter().all(|f| f.values.len() == 4 && f.stamp == 5 && f.device_time_us == 0));
        assert_eq!(reader.stats().rejected.channels, 1);
    }

    /// A frame of [`SkinFile::four_barometers`] as a device of that skin sends it, and what a node reads of it.
    fn sent_and_read(device: &str, node: &str) -> (Vec<u8>, Vec<Frame>, FrameReader) {
        let mut writer = crate::FrameWriter::new(&skin_with(device)).unwrap();
        let frame = Frame::new(0, 7, vec![0.0, 0.25, 1.0, 1023.75]);
        let sent = crate::Encoder::encode(&mut writer, &frame, 5).unwrap().to_vec();
        let mut reader = FrameReader::new(&skin_with(node)).unwrap();
        let mut frames = Vec::new();
        reader.push(&[0], 1, &mut frames);
        reader.push(&sent, 1, &mut frames);
        (sent, frames, reader)
    }

    #[test]
    fn device_and_node_agree_on_samples() {
        let wire = |samples: &str| format!("wire = {{ scale = 0.25, counts = [0, 4095]{samples} }}");
        let (plain, packed) = (wire(""), wire(", samples = \"u12\""));
        let parts = wire(", samples = \"u12\", datagram = 64");
        let (long, read, _) = sent_and_read(&plain, &plain);
        assert_eq!(read[0].values, [0.0, 0.25, 1.0, 1023.75]);
        // Four values of 12 bits where there were four of 32; a short frame needs no parts.
        for device in [&packed, &parts] {
            for node in [&packed, &plain, &parts] {
                let (short, read, _) = sent_and_read(device, node);
                assert_eq!(read[0].values, [0.0, 0.25, 1.0, 1023.75], "{device} {node}");
                assert_eq!(long.len() - short.len(), 10);
            }
        }
        let (_, read, reader) = sent_and_read(&plain, &packed);
        assert!(read.is_empty());
        assert_eq!(reader.stats().rejected.format, 1);
        insta::assert_snapshot!(reader.stats().last_rejection.as_ref().unwrap(), @"the device sends f32 values, and the skin file says u12: correct `wire.samples`, or leave it out to read every kind");
    }
}
