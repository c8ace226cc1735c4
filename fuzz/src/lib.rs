//! What is fuzzed: each function takes any bytes, and panics where what it promises does not hold for them.
//!
//! The targets beside this file hand it the bytes of libFuzzer; a test of `integration-tests`, which includes this file,
//! the committed corpus.

pub mod messages;

use std::fmt::{Debug, Display};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use dermis_bag::{BagError, BagReader};
use dermis_body::Body;
use dermis_inference::Manifest;
use dermis_insight::optics::Observer;
use dermis_insight::wire::PictureReader;
use dermis_insight::wire::stream::StreamReader;
use dermis_launch::{Host, NodeRequest, Refusal};
use dermis_learn::LabelMap;
use dermis_perception::Config;
use dermis_reflex::Rules;
use dermis_sensor::{Decoder, FrameReader};
use dermis_skin::{Frame, SkinDescription, TriangleMesh};
use dermis_testbed::Plan;
use dermis_transport::framing::{
    AsciiDecoder, AsciiOptions, CRC_16, DecodedFrame, FrameDecoder, NativeDecoder, NativeEncoder,
    NativeFormat,
};
use dermis_transport::{SourceUrl, TransportError};
use tempfile::TempDir;

/// A function that takes any bytes.
pub type Target = fn(&[u8]);

/// Every target by its name, which is also that of its folder in `corpus/`.
pub const TARGETS: [(&str, Target); 15] = [
    ("bundle", bundle),
    ("labels", labels),
    ("launch", launch),
    ("mesh", mesh),
    ("plan", plan),
    ("skin", skin),
    ("urdf", urdf),
    ("rules", rules),
    ("picture", picture),
    ("frames", frames),
    ("cdr", cdr),
    ("json", json),
    ("bag", bag),
    ("metadata", metadata),
    ("config", config),
];

/// \[ns since the Unix epoch\] when fuzzed bytes begin to arrive.
const ARRIVAL: i64 = 1_700_000_000_000_000_000;

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

    // However the bytes are cut up, the same comes out.
    let (mut whole, mut pieces) = (Vec::new(), Vec::new());
    let (mut first, mut second) = (decoder(), decoder());
    first.push(stream, ARRIVAL, &mut whole);
    for piece in stream.chunks(1 + usize::from(cut)) {
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

    // What came out can be sent again.
    if !ascii && whole.first().is_some_and(|f| !f.values.is_empty()) {
        let mut encoder = NativeEncoder::new(NativeFormat::F32);
        let mut again = NativeDecoder::new(None);
        let mut out = Vec::new();
        for frame in &whole {
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

    // The whole way, with time that passes, gaps, and stamps.
    let skin = &skins()[usize::from(ascii) * 8 + channels - 1];
    for mut reader in [plain_reader(skin), plain_reader(skin).with_device_time()] {
        let mut out: Vec<Frame> = Vec::new();
        let mut received = ARRIVAL;
        for (i, piece) in stream.chunks(1 + usize::from(cut)).enumerate() {
            let from = out.len();
            reader.push(piece, received, &mut out);
            assert!(out[from..].iter().all(|f| f.values.len() == channels && f.flags.len() == channels));
            received += i64::from(pace) * 1_000_000;
            if i % 16 == 15 {
                reader.gap();
            }
        }
        assert!(out.windows(2).all(|w| w[0].sequence < w[1].sequence));
    }
    let mut reader = plain_reader(skin);
    let mut out: Vec<Frame> = Vec::new();
    let mut received = ARRIVAL;
    for piece in stream.chunks(1 + usize::from(cut)) {
        let from = out.len();
        reader.push(piece, received, &mut out);
        assert!(out[from..].iter().all(|f| f.stamp <= received), "measured after it was received");
        received += i64::from(pace) * 1_000_000;
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

/// Messages from CDR: two bytes of type, then what came over the bus.
pub fn cdr(data: &[u8]) {
    let Some((kind, bytes)) = messages::select(data) else { return };
    (kind.round_trip)(bytes);
    if let Ok(json) = (kind.support.cdr_to_json)(bytes) {
        there_and_back(kind, &json);
    }
}

/// Messages from JSON: two bytes of type, then text.
pub fn json(data: &[u8]) {
    let Some((kind, text)) = messages::select(data) else { return };
    let Ok(value) = serde_json::from_slice(text) else { return };
    let Ok(bytes) = (kind.support.json_to_cdr)(&value) else { return };
    (kind.round_trip)(&bytes);
    match (kind.support.cdr_to_json)(&bytes) {
        Ok(full) => there_and_back(kind, &full),
        // Bounds of the message are checked when bytes are read.
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// JSON that names every field gives bytes that give the same JSON.
fn there_and_back(kind: &messages::Kind, full: &serde_json::Value) {
    let name = kind.support.name;
    match (kind.support.json_to_cdr)(full).and_then(|bytes| (kind.support.cdr_to_json)(&bytes)) {
        Ok(again) => assert_eq!(&again, full, "{name} changes on its way"),
        Err(error) => panic!("{name} does not come back: {error}"),
    }
}

/// A folder for files that are read from disk, one for each thread.
fn folder<T>(with: impl FnOnce(&Path) -> T) -> T {
    thread_local! {
        static FOLDER: TempDir = TempDir::new().unwrap_or_else(|e| panic!("no folder for temporary files: {e}"));
    }
    FOLDER.with(|folder| with(folder.path()))
}

fn write(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).unwrap_or_else(|e| panic!("{} cannot be written: {e}", path.display()));
}

/// A bag of one MCAP file, whole or damaged.
pub fn bag(data: &[u8]) {
    folder(|folder| {
        let path = folder.join("any.mcap");
        write(&path, data);
        let whole = read_bag(BagReader::open(&path));
        // What reads without a complaint reads the same when damage is expected.
        let recovered = read_bag(BagReader::recover(&path));
        if let Some(whole) = whole {
            assert_eq!(recovered, Some(whole));
        }
    });
}

/// Reads everything of a bag; how many messages it holds, where it is sound.
fn read_bag(opened: Result<BagReader, BagError>) -> Option<usize> {
    let reader = match opened {
        Ok(reader) => reader,
        Err(error) => {
            one_sentence(&error);
            return None;
        }
    };
    let _ = reader.info().to_string();
    for topic in reader.topics() {
        if let Some(support) = dermis_msgs::type_support(&topic.type_name)
            && let Err(error) = reader.check_type(topic, support)
        {
            one_sentence(&error);
        }
    }
    let mut count = 0;
    for message in reader.messages() {
        match message {
            Ok(message) => {
                count += 1;
                if let Some(support) = dermis_msgs::type_support(&message.type_name) {
                    let _ = (support.cdr_to_json)(&message.data);
                }
            }
            Err(error) => {
                one_sentence(&error);
                return None;
            }
        }
    }
    Some(count)
}

/// `metadata.yaml` of a bag that is not there.
pub fn metadata(data: &[u8]) {
    folder(|folder| {
        write(&folder.join("metadata.yaml"), data);
        for opened in [BagReader::open(folder), BagReader::recover(folder)] {
            if let Err(error) = opened {
                one_sentence(&error);
            }
        }
    });
}

/// A skin description, and what is computed of it at once: surface and hash.
pub fn skin(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    reads_back(text, |t| SkinDescription::from_toml(t, "skin.toml"), toml::to_string);
    if let Ok(skin) = SkinDescription::from_toml(text, "skin.toml") {
        let surface = skin.surface();
        assert!(surface.points.iter().all(|p| p.iter().all(|v| v.is_finite())), "a point is not finite");
        assert!(skin.hash().starts_with("sha256:"));
    }
}

/// A plan of what is done to a skin.
pub fn plan(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    reads_back(text, |t| Plan::from_toml(t, "plan.toml"), toml::to_string);
}

/// A robot's body, and where its links are.
pub fn urdf(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    match Body::from_urdf(text, "robot.urdf") {
        Ok(body) => {
            let poses = body.poses(&vec![0.0; body.coordinates().len()]);
            for link in 0..body.links().len() {
                let (top, _) = body.rigid_top(link);
                assert_eq!(body.rigid_top(top).0, top, "the top of a link has a top of its own");
                let columns = poses.jacobian(link, &poses.root_from(link).translation.vector.into()).ncols();
                assert_eq!(columns, body.coordinates().len());
            }
        }
        Err(error) => one_sentence(&error),
    }
}

/// The rules of the reflexes.
pub fn rules(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    match Rules::from_toml(text, "rules.toml") {
        Ok(rules) => {
            for rule in &rules.rules {
                assert!(rule.inputs.iter().all(|i| *i < rules.inputs.len()), "an input that is not there");
                assert!(rule.actions.iter().all(|a| *a < rules.actions.len()), "an action that is not there");
            }
        }
        Err(error) => one_sentence(&error),
    }
}

/// A thumb's answers, and pictures of a web stream: a byte that cuts the stream, then pictures as they come.
pub fn picture(data: &[u8]) {
    const SIZE: [u32; 2] = [32, 24];
    const BLOCKS: [u32; 2] = [8, 6];
    let Some((cut, stream)) = data.split_first() else { return };
    let observer = Arc::new(Observer::of_means(SIZE, BLOCKS));
    let readers: [&dyn Fn() -> Box<dyn Decoder>; 2] =
        [&|| Box::new(PictureReader::new(Arc::clone(&observer))), &|| {
            Box::new(StreamReader::new(Arc::clone(&observer)))
        }];
    for reader in readers {
        pictures(reader, usize::from(*cut), stream, (BLOCKS[0] * BLOCKS[1] * 3) as usize);
    }
}

/// Reads a stream whole and in pieces; each picture has so many numbers.
fn pictures(reader: &dyn Fn() -> Box<dyn Decoder>, cut: usize, stream: &[u8], numbers: usize) {
    let read = |size: usize| {
        let (mut reader, mut out) = (reader(), Vec::new());
        for (i, piece) in stream.chunks(size).enumerate() {
            reader.push(piece, ARRIVAL + i as i64, &mut out);
        }
        assert_eq!(reader.stats().bytes, stream.len() as u64);
        assert_eq!(reader.stats().frames, out.len() as u64);
        assert_eq!(reader.stats().rejected.total() > 0, reader.stats().last_rejection.is_some());
        out
    };
    let (whole, pieces) = (read(stream.len().max(1)), read(1 + cut));
    assert_eq!(whole.len(), pieces.len(), "cuts change how many pictures there are");
    for (a, b) in whole.iter().zip(&pieces) {
        assert_eq!(a.values, b.values, "cuts change a picture");
        assert_eq!(a.values.len(), numbers);
        assert!(a.values.iter().all(|v| v.is_finite()) && a.image.is_some());
    }
}

/// The manifest of a model bundle.
pub fn bundle(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    reads_back(text, |t| Manifest::from_toml(t, "bundle.toml"), toml::to_string);
}

/// A map from a rig's topics to ground truth.
pub fn labels(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    reads_back(text, |t| LabelMap::from_toml(t, "labels.toml"), toml::to_string);
}

/// A triangulated surface: one character that chooses, then the file. `s` STL, `o` OBJ.
pub fn mesh(data: &[u8]) {
    let Some((kind, file)) = data.split_first() else { return };
    folder(|folder| {
        let path = folder.join(if *kind == b'o' { "skin.obj" } else { "skin.stl" });
        write(&path, file);
        if let Err(error) = TriangleMesh::load(&path, 1e-3, 1) {
            one_sentence(&error);
        }
    });
}

/// A launch file: one character that chooses, then text. `t` TOML, else YAML. It may include itself by the name `launch.yaml`.
pub fn launch(data: &[u8]) {
    let Some((kind, text)) = data.split_first() else { return };
    folder(|folder| {
        let path = folder.join(if *kind == b't' { "launch.toml" } else { "launch.yaml" });
        write(&path, text);
        if let Err(errors) = dermis_launch::load(&path, &[], folder, &Anything) {
            assert!(!errors.0.is_empty(), "refused without a mistake");
            errors.0.iter().for_each(one_sentence);
        }
    });
}

/// A program that takes whatever a launch file asks of it.
struct Anything;

impl Host for Anything {
    fn program(&self) -> &Path {
        Path::new("/bin/true")
    }

    fn check(&self, _: &[String]) -> Result<(), String> {
        Ok(())
    }

    fn network(&self, _: &str) -> Result<(), String> {
        Ok(())
    }

    fn node(&self, request: &NodeRequest<'_>) -> Result<serde_json::Value, Vec<Refusal>> {
        Ok(request.config.clone())
    }
}

/// Files that people write: one character that chooses, then text.
///
/// `s` a skin description, `p` a plan, `b` the manifest of a model bundle, `t` and `y` the configuration of a node as TOML and
/// YAML, `u` the URL of a source.
pub fn config(data: &[u8]) {
    let Some((&kind, text)) = data.split_first() else { return };
    let Ok(text) = std::str::from_utf8(text) else { return };
    match kind {
        b's' => reads_back(text, |t| SkinDescription::from_toml(t, "skin.toml"), toml::to_string),
        b'p' => reads_back(text, |t| Plan::from_toml(t, "plan.toml"), toml::to_string),
        b'b' => reads_back(text, |t| Manifest::from_toml(t, "bundle.toml"), toml::to_string),
        b'u' => reads_back(text, SourceUrl::parse, |url| Ok::<_, TransportError>(url.to_string())),
        b't' | b'y' => folder(|folder| {
            let path = folder.join(if kind == b't' { "node.toml" } else { "node.yaml" });
            write(&path, text.as_bytes());
            if let Err(error) = Config::load(&path) {
                one_sentence(&error);
            }
        }),
        _ => {}
    }
}

/// What parses can be written, and reads back as the same.
fn reads_back<T: PartialEq + Debug, E: Display, W: Display>(
    text: &str,
    parse: impl Fn(&str) -> Result<T, E>,
    write: impl Fn(&T) -> Result<String, W>,
) {
    let value = match parse(text) {
        Ok(value) => value,
        Err(error) => return one_sentence(&error),
    };
    let written = write(&value).unwrap_or_else(|error| panic!("{value:?} cannot be written: {error}"));
    match parse(&written) {
        Ok(again) => assert_eq!(again, value, "changes on its way: {written}"),
        Err(error) => panic!("what was written is refused: {error}\n{written}"),
    }
}

/// An error is text, and never the whole of a hostile input.
fn one_sentence(error: &impl Display) {
    let text = error.to_string();
    assert!(!text.trim().is_empty(), "an error that says nothing");
}
