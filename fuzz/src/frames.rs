//! Bytes of a stream that become frames.

use std::sync::OnceLock;

use dermis_sensor::{Decoder, FrameReader};
use dermis_skin::{Frame, SkinDescription};
use dermis_transport::framing::{
    AsciiDecoder, AsciiOptions, CRC_16, DecodedFrame, FrameDecoder, NativeDecoder, NativeEncoder,
    NativeFormat,
};

use super::ARRIVAL;

/// A reader of one of the wires that every family knows.
fn plain_reader(skin: &SkinDescription) -> FrameReader {
    FrameReader::new(skin).expect("a wire that every family knows")
}

/// The way from bytes to frames: three bytes of choices, then a stream.
///
/// The first byte: 0x80 seals pieces of the stream as native frames, which gets them past the checksum; 0x40 reads lines with
/// sequence and time; the rest chooses wire and channels. The second cuts the stream, the third is the pace in milliseconds.
pub fn frames(data: &[u8]) {
    let Some((&[kind, cut, pace], stream)) = data.split_first_chunk() else { return };
    let sealed;
    let stream = if kind & 0x80 == 0 {
        stream
    } else {
        sealed = seal(stream);
        &sealed
    };
    let channels = 1 + usize::from(kind >> 1) % 8;
    let ascii = kind & 1 == 1;
    let decoder = || -> Box<dyn FrameDecoder> {
        let options = AsciiOptions::channels(channels);
        match (ascii, kind & 0x40 != 0) {
            (true, true) => Box::new(AsciiDecoder::new(options.with_sequence().with_device_time())),
            (true, false) => Box::new(AsciiDecoder::new(options)),
            (false, any) => Box::new(NativeDecoder::new((!any).then_some(channels))),
        }
    };
    let size = 1 + usize::from(cut);
    let whole = cuts_change_nothing(stream, size, &decoder);
    if !ascii && whole.first().is_some_and(|f| !f.values.is_empty()) {
        comes_back(&whole);
    }
    let skin = &skins()[usize::from(ascii) * 8 + channels - 1];
    becomes_frames(skin, stream, size, i64::from(pace) * 1_000_000);
}

/// However the bytes are cut up, the same comes out: what that is.
fn cuts_change_nothing(
    stream: &[u8],
    size: usize,
    decoder: &dyn Fn() -> Box<dyn FrameDecoder>,
) -> Vec<DecodedFrame> {
    let (mut whole, mut pieces) = (Vec::new(), Vec::new());
    let (mut first, mut second) = (decoder(), decoder());
    first.push(stream, ARRIVAL, &mut whole);
    for piece in stream.chunks(size) {
        second.push(piece, ARRIVAL, &mut pieces);
    }
    assert_eq!(whole.len(), pieces.len(), "cuts change how many frames there are");
    assert!(whole.iter().zip(&pieces).all(|(a, b)| same(a, b)), "cuts change a frame");
    assert_eq!(first.stats().bytes, stream.len() as u64);
    assert_eq!(first.stats().frames, whole.len() as u64);
    assert!(whole.windows(2).all(|w| w[0].sequence < w[1].sequence), "sequence numbers only grow");
    // Rejections carry a sentence, and so does a line on which nothing is ever valid.
    let stats = second.stats();
    assert_eq!(stats.rejected.total() > 0, stats.last_rejection.is_some());
    if let Some(text) = stats.diagnosis(None) {
        assert!(!text.contains(['\n', '\r']), "a diagnosis is one line: {text}");
    }
    whole
}

/// What came out can be sent again.
fn comes_back(whole: &[DecodedFrame]) {
    let mut encoder = NativeEncoder::new(NativeFormat::F32);
    let mut again = NativeDecoder::new(None);
    let mut out = Vec::new();
    for frame in whole {
        let time = frame.device_time_us.unwrap_or(0);
        match encoder.encode(frame.sequence as u32, time, &frame.values) {
            Ok(bytes) => again.push(bytes, ARRIVAL, &mut out),
            Err(error) => panic!("what was decoded cannot be encoded: {error}"),
        }
        let sent = out.pop().map(|out| DecodedFrame { sequence: frame.sequence, ..out });
        assert!(sent.is_some_and(|sent| same(&sent, frame)), "a frame changes on its way");
        again = NativeDecoder::new(None);
    }
}

/// The whole way, with \[ns\] of time that pass at each piece, gaps, and stamps.
fn becomes_frames(skin: &SkinDescription, stream: &[u8], size: usize, pace: i64) {
    let channels = skin.channels().len();
    for mut reader in [plain_reader(skin), plain_reader(skin).with_device_time()] {
        let mut out: Vec<Frame> = Vec::new();
        let mut received = ARRIVAL;
        for (i, piece) in stream.chunks(size).enumerate() {
            let from = out.len();
            reader.push(piece, received, &mut out);
            assert!(out[from..].iter().all(|f| f.values.len() == channels && f.flags.len() == channels));
            received += pace;
            if i % 16 == 15 {
                reader.gap();
            }
        }
        assert!(out.windows(2).all(|w| w[0].sequence < w[1].sequence));
    }
    let mut reader = plain_reader(skin);
    let mut out: Vec<Frame> = Vec::new();
    let mut received = ARRIVAL;
    for piece in stream.chunks(size) {
        let from = out.len();
        reader.push(piece, received, &mut out);
        assert!(out[from..].iter().all(|f| f.stamp <= received), "measured after it was received");
        received += pace;
    }
    assert!(
        out.windows(2).all(|w| w[0].stamp <= w[1].stamp),
        "stamps run back while the host's clock does not"
    );
}

/// Makes sound frames of pieces: a byte of length, and so many bytes.
fn seal(mut stream: &[u8]) -> Vec<u8> {
    let mut sealed = Vec::new();
    while let Some((length, rest)) = stream.split_first() {
        let (piece, rest) = rest.split_at(usize::from(*length).min(rest.len()));
        let mut raw = piece.to_vec();
        raw.extend_from_slice(&CRC_16.checksum(piece).to_le_bytes());
        sealed.extend_from_slice(&cobs::encode_vec(&raw));
        sealed.push(0);
        stream = rest;
    }
    sealed
}

/// Equal, where NaN equals itself.
fn same(a: &DecodedFrame, b: &DecodedFrame) -> bool {
    let bits = |frame: &DecodedFrame| frame.values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    a.sequence == b.sequence
        && a.device_time_us == b.device_time_us
        && a.received_ns == b.received_ns
        && bits(a) == bits(b)
}

/// Skins of 1 to 8 channels, native and then as lines.
fn skins() -> &'static [SkinDescription] {
    static SKINS: OnceLock<Vec<SkinDescription>> = OnceLock::new();
    SKINS.get_or_init(|| {
        let all = (0..16).map(|i| {
            let protocol = if i < 8 { "native" } else { "ascii" };
            let taxels: String = (0..=i % 8)
                .map(|k| format!("[[taxels]]\nname = \"t{k}\"\nposition = [0.0{k}, 0.0, 0.0]\n"))
                .collect();
            SkinDescription::from_toml(
                &format!(
                    "schema = \"dermis-skin/1\"\nname = \"pad\"\nsensor = \"barodome\"\nframe_id = \"pad\"\nunit = \"Pa\"\n\
                     rate = 100.0\nnoise = 20.0\nwire = {{ protocol = \"{protocol}\", scale = 0.5, offset = 3.0 }}\n\
                     surface = {{ type = \"rectangle\", size = [0.2, 0.2], spacing = 0.02 }}\n{taxels}"
                ),
                "pad.toml",
            )
        });
        all.collect::<Result<_, _>>().unwrap_or_else(|error| panic!("{error}"))
    })
}
