//! What is fuzzed: each function takes any bytes, and panics where what it promises does not hold for them.
//!
//! The targets beside this file hand it the bytes of libFuzzer; a test of `integration-tests`, which includes this file,
//! the committed corpus.

mod frames;
pub mod messages;

use std::fmt::{Debug, Display};
use std::path::Path;
use std::sync::Arc;

use dermis_bag::{BagError, BagReader};
use dermis_body::{Body, Robot};
use dermis_inference::Manifest;
use dermis_insight::optics::Observer;
use dermis_insight::wire::PictureReader;
use dermis_insight::wire::stream::StreamReader;
use dermis_launch::{Host, NodeRequest, Refusal};
use dermis_learn::LabelMap;
use dermis_perception::Config;
use dermis_reflex::Rules;
use dermis_sensor::Decoder;
use dermis_skin::{SkinDescription, TriangleMesh};
use dermis_testbed::Plan;
use dermis_transport::{SourceUrl, TransportError};
use tempfile::TempDir;

pub use frames::frames;

/// A function that takes any bytes.
pub type Target = fn(&[u8]);

/// Every target by its name, which is also that of its folder in `corpus/`.
pub const TARGETS: [(&str, Target); 16] = [
    ("bundle", bundle),
    ("labels", labels),
    ("launch", launch),
    ("mesh", mesh),
    ("plan", plan),
    ("skin", skin),
    ("urdf", urdf),
    ("srdf", srdf),
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

/// Which links of a robot may touch each other.
pub fn srdf(data: &[u8]) {
    const URDF: &str = "<robot name='arm'><link name='base'/><link name='upper'/><link name='fore'/><link name='hand'/>\
        <joint name='a' type='continuous'><parent link='base'/><child link='upper'/></joint>\
        <joint name='b' type='continuous'><parent link='upper'/><child link='fore'/></joint>\
        <joint name='c' type='continuous'><parent link='fore'/><child link='hand'/></joint></robot>";
    const ROBOT: &str = "schema = 'dermis-robot/1'\nname = 'arm'\nurdf = 'arm.urdf'\nsrdf = 'arm.srdf'\nskins = [\
        { name = 'h', frame_id = 'hand' }, { name = 'u', frame_id = 'upper' }, { name = 'f', frame_id = 'fore' }]";
    folder(|folder| {
        write(&folder.join("arm.urdf"), URDF.as_bytes());
        write(&folder.join("arm.srdf"), data);
        match Robot::from_toml(ROBOT, &folder.join("arm.toml")) {
            Ok(robot) => {
                let carried = |link: &usize| robot.skins.iter().any(|skin| skin.link == *link);
                for [a, b] in &robot.self_contact {
                    assert!(a < b && carried(a) && carried(b), "{a} and {b} are no two links with skins");
                }
                assert!(robot.self_contact.is_sorted_by(|a, b| a < b), "a pair comes twice");
            }
            Err(error) => {
                one_sentence(&error);
                assert!(error.to_string().contains("arm.srdf"), "{error}: what is given is right");
            }
        }
    });
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
