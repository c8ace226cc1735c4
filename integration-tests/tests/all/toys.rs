//! A fifth sensor is a folder: a family that nothing under `crates/` knows goes all the way through the program.
//!
//! The foam has 784 channels that follow from 28 electrodes, a shape of its own, memory, and contacts that do not add up. The
//! camera sends images on request, over a wire of its own; a convolutional network makes a force map of them.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dermis_bag::{BagReader, Filter};
use dermis_integration_tests::launch::until;
use dermis_integration_tests::{Peer, finish, isolate, json, open_node, program, refused, root};
use dermis_msgs::TypeSupport;
use dermis_msgs::msg::{ContactArray, ForceMap, TaxelFrame};
use dermis_msgs::sensor_msgs::msg::Image;
use dermis_node::{Node, Qos, Subscription};

const FOAM: &str = "integration-tests/toys/skins/toy-foam.toml";
const CAMERA: &str = "integration-tests/toys/skins/toy-camera.toml";
/// Longest wait for anything, on a machine at full load.
const PATIENCE: Duration = Duration::from_secs(60);
/// Messages after which a recording of a node ends.
const ENOUGH: u64 = 60;

/// `dermis` with the families of the test.
fn toys(arguments: &[&str]) -> Command {
    let mut command = Command::new(program("dermis-toys"));
    isolate(command.current_dir(root()).stdin(Stdio::null()).args(arguments));
    command
}

fn plan(folder: &Path, name: &str, presses: u32, seed: u32) -> PathBuf {
    let path = folder.join(format!("{name}.toml"));
    let text = format!(
        "schema = 'dermis-plan/1'\nname = '{name}'\nseed = {seed}\ndiameter = 0.02\nmargin = 0.01\n\
         [timing]\napproach = [0.1, 0.2]\nload = [0.1, 0.2]\nhold = [0.6, 0.8]\nunload = [0.1, 0.2]\ngap = [0.5, 0.8]\n\
         [[steps]]\nkind = 'idle'\nduration = 2.0\n\
         [[steps]]\nkind = 'presses'\ncount = {presses}\nforce = [3.0, 30.0]\n"
    );
    std::fs::write(&path, text).unwrap();
    path
}

/// Short presses on a pad of 32 x 24 mm.
fn pad_plan(folder: &Path, name: &str, presses: u32, seed: u32) -> PathBuf {
    let path = folder.join(format!("{name}.toml"));
    let text = format!(
        "schema = 'dermis-plan/1'\nname = '{name}'\nseed = {seed}\ndiameter = 0.012\nmargin = 0.003\n\
         [timing]\napproach = [0.05, 0.06]\nload = [0.05, 0.1]\nhold = [0.1, 0.15]\nunload = [0.05, 0.06]\ngap = [0.1, 0.2]\n\
         [[steps]]\nkind = 'idle'\nduration = 2.0\n\
         [[steps]]\nkind = 'presses'\ncount = {presses}\nforce = [0.5, 4.0]\n"
    );
    std::fs::write(&path, text).unwrap();
    path
}

fn collect(folder: &Path, name: &str, presses: u32, seed: u32, effects: &[&str]) -> PathBuf {
    collect_by(FOAM, &plan(folder, name, presses, seed), effects)
}

/// Records a plan beside its file.
fn collect_by(skin: &str, plan: &Path, effects: &[&str]) -> PathBuf {
    let bag = plan.with_extension("");
    let mut command = toys(&["collect", skin, "--plan"]);
    command.arg(plan).arg("--out").arg(&bag);
    effects.iter().for_each(|effect| {
        command.args(["--effect", effect]);
    });
    finish(&mut command);
    bag
}

/// A model of the foam from a minute of presses.
fn model(folder: &Path) -> PathBuf {
    let bag = collect(folder, "train", 80, 1, &[]);
    let config = folder.join("train.cfg.toml");
    let text = "targets = [\"position.x\", \"position.y\", \"position.z\", \"force.normal\"]\nbaseline = \"tared\"\n\
                [network]\nhidden = [64, 32]\n[training]\nepochs = 40\nbatch = 64\nlearning_rate = 3e-3\n\
                [split]\nkind = \"location\"\nfraction = 0.2\n";
    std::fs::write(&config, text).unwrap();
    let out = folder.join("model");
    let mut train = toys(&["train", "--skin", FOAM, "--config"]);
    finish(train.arg(config).arg("--out").arg(&out).arg(bag));
    out
}

#[test]
fn a_file_of_a_few_numbers_becomes_a_skin_of_784_channels() {
    let skin = json(&finish(&mut toys(&["skin", FOAM, "--json"])));
    assert_eq!((skin["taxels"].as_u64(), skin["channels"].as_u64()), (Some(28), Some(784)));
    assert_eq!(skin["forward_model"], "yes");
    let effects = json(&finish(&mut toys(&["effects", "toy-foam", "--json"])));
    assert_eq!(effects["families"][0]["effects"][0]["name"], "stiff-foam");
    // The program that ships knows neither family nor shape, and says so.
    let mut other = Command::new(program("dermis"));
    let said = refused(other.current_dir(root()).args(["skin", FOAM]));
    assert!(said.contains("\"saddle\"") && said.contains("toy-foam"), "{said}");
}

#[test]
fn it_is_learned_measured_and_bounded() {
    let folder = tempfile::tempdir().unwrap();
    let model = model(folder.path());
    let bag = collect(folder.path(), "test", 40, 2, &[]);
    let mut evaluate = toys(&["evaluate", "--json", "--skin", FOAM, "--model"]);
    let found = json(&finish(evaluate.arg(&model).arg(&bag)));
    let median = found["figures"]["position_median"].as_f64().unwrap();
    println!("position: median error {:.1} mm on a skin of 200 mm", median * 1e3);
    // Chance is about 80 mm.
    assert!(median < 0.025, "{}", found["figures"]);
    let mut bounds = toys(&["bounds", FOAM, "--json", "--force", "10", "--diameter", "0.02"]);
    let bound = json(&finish(&mut bounds));
    assert_eq!((bound["channels"].as_u64(), bound["diameter_m"].as_f64()), (Some(784), Some(0.02)));
    // The voltages of the foam fall where it is pressed: isolines hold for them, too.
    let least = bound["surface"]["minimum_force_n"]["median"].as_f64();
    assert!(least.is_some_and(|force| (1e-3..1.0).contains(&force)), "{}", bound["surface"]);
}

#[test]
fn its_gap_has_a_name() {
    let folder = tempfile::tempdir().unwrap();
    let bag = collect(folder.path(), "stiff", 60, 3, &["stiff-foam=1"]);
    let mut diagnose = toys(&["gap", "diagnose", "--json", "--resamples", "4", "--skin", FOAM, "--real"]);
    let cache = folder.path().join("kept");
    let report = json(&finish(
        diagnose.arg(&bag).arg("--cache").arg(cache).arg("--out").arg(folder.path().join("out")),
    ));
    println!("{}", report["sentence"]);
    assert_eq!(report["verdict"], "named", "{}", report["sentence"]);
    assert_eq!(report["effects"][0]["label"], "stiff-foam", "{}", report["sentence"]);
}

#[test]
fn its_node_finds_contacts_on_the_wire() {
    let folder = tempfile::tempdir().unwrap();
    let model = model(folder.path());
    let link = folder.path().join("foam");
    let mut simulate = toys(&["device", "simulate", FOAM, "--link"]);
    let _device = Peer::start(simulate.arg(&link).arg("--plan").arg(plan(folder.path(), "pressed", 500, 4)));
    let node = open_node("listener");
    let (_contacts, contacts) =
        dermis_integration_tests::listen::<ContactArray>(&node, "contacts", Qos::sensor_data());
    let (read, frames) = channel();
    let _frames = node
        .subscribe::<TaxelFrame>("taxels", Qos::sensor_data(), move |frame, _| {
            let _ = read.send(frame.values.len());
        })
        .unwrap();
    let mut run = toys(&["run", FOAM, "--source"]);
    let _node = Peer::start(run.arg(format!("pty://{}", link.display())).arg("--model").arg(&model));
    assert_eq!(frames.recv_timeout(PATIENCE).unwrap(), 784);
    let deadline = Instant::now() + PATIENCE;
    loop {
        let array = contacts.recv_timeout(PATIENCE).unwrap();
        let pressed = |c: &dermis_msgs::msg::Contact| -c.force.z > 2.0 && c.position.x.abs() <= 0.1;
        if array.status == ContactArray::STATUS_OK && array.contacts.iter().any(pressed) {
            break;
        }
        assert!(Instant::now() < deadline, "no contact was found; it last said {:?}", array.status_text);
    }
}

/// Messages of one topic as they came, encoded.
type Messages = Arc<Mutex<Vec<Vec<u8>>>>;

/// Keeps what comes on a topic.
fn listen(node: &Node, topic: &str, support: &'static TypeSupport) -> (Subscription, Messages) {
    let messages = Messages::default();
    let sink = Arc::clone(&messages);
    let subscription = node
        .subscribe_raw(topic, support, Qos::sensor_data().with_depth(100), move |data, _| {
            sink.lock().unwrap().push(data.to_vec());
        })
        .unwrap();
    (subscription, messages)
}

/// What a bag holds of a topic by now, encoded.
fn recorded(bag: &Path, topic: &str) -> Vec<Vec<u8>> {
    let Ok(reader) = BagReader::recover(bag) else { return Vec::new() };
    let messages = reader.messages_where(Filter::default().topics([topic]));
    messages.map_while(Result::ok).map(|message| message.data).collect()
}

/// Records topics of the running node of a skin with the program that ships, which knows neither family. From its first message to its last
/// one, the bag holds of each topic what a listener got, byte for byte, and no frame is missing.
fn record_node(skin: &str, plan: &Path, topics: &[(&str, &'static TypeSupport)]) -> BagReader {
    let [link, bag] = ["device", "recorded"].map(|name| plan.with_file_name(name));
    let node = open_node("listener");
    let heard: Vec<_> = topics.iter().map(|&(topic, support)| listen(&node, topic, support)).collect();
    let mut simulate = toys(&["device", "simulate", skin, "--link"]);
    let mut device = Peer::start(simulate.arg(&link).arg("--plan").arg(plan));
    let mut run = toys(&["run", skin, "--source"]);
    let _node = Peer::start(run.arg(format!("pty://{}", link.display())));
    // From its first message on the listener gets all: whatever a recorder gets that starts later, it has too.
    until("the node publishes", || heard.iter().all(|(_, messages)| !messages.lock().unwrap().is_empty()));
    let mut record = Command::new(program("dermis"));
    record.args(["record", "--json", "--compression", "none", "--out"]).arg(&bag);
    let mut recorder = Peer::start(record.args(topics.iter().map(|(topic, _)| topic)));
    until("enough is recorded", || {
        BagReader::recover(&bag).is_ok_and(|reader| reader.info().messages >= ENOUGH)
    });
    // The device ends and the node stays, so that what it sent last still arrives.
    device.interrupt();
    assert!(device.end(PATIENCE).success());
    until("the last message is recorded", || {
        heard.iter().zip(topics).all(|((_, messages), (topic, _))| {
            messages.lock().unwrap().last() == recorded(&bag, topic).last()
        })
    });
    recorder.interrupt();
    let said = json(&recorder.expect("{", PATIENCE));
    assert!(recorder.end(PATIENCE).success(), "{said}");
    assert_eq!((&said["lost"], &said["dropped"]), (&0.into(), &0.into()), "{said}");
    for ((_, messages), (topic, _)) in heard.iter().zip(topics) {
        let (sent, kept) = (messages.lock().unwrap(), recorded(&bag, topic));
        let at = |end: Option<&Vec<u8>>| sent.iter().position(|message| Some(message) == end).unwrap();
        let sent = &sent[at(kept.first())..=at(kept.last())];
        assert!(sent == kept, "{topic}: {} messages were sent and {} recorded", sent.len(), kept.len());
        let said_of = said["topics"].as_array().unwrap().iter().find(|said| said["name"] == *topic).unwrap();
        assert_eq!(said_of["recorded"], kept.len(), "{said}");
    }
    let reader = BagReader::open(&bag).unwrap();
    let frames = reader.read::<TaxelFrame>("/taxels").unwrap();
    let numbers: Vec<u64> = frames.map(|frame| frame.unwrap().message.sequence).collect();
    assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "{numbers:?}");
    reader
}

#[test]
fn what_its_node_publishes_is_in_the_bag() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), "pressed", 50, 4);
    let bag = record_node(FOAM, &plan, &[("/taxels", TypeSupport::of::<TaxelFrame>())]);
    for frame in bag.read::<TaxelFrame>("/taxels").unwrap() {
        let frame = frame.unwrap().message;
        assert_eq!((frame.skin.as_str(), frame.values.len()), ("toy-foam", 784));
    }
}

/// A convolutional network from images to a force map, learned from a bag.
fn seeing_model(folder: &Path) -> PathBuf {
    let bag = collect_by(CAMERA, &pad_plan(folder, "seen", 80, 1), &[]);
    let config = folder.join("train.cfg.toml");
    let text = "targets = [\"position.x\", \"position.y\", \"force.normal\", \"map.normal\"]\nbaseline = \"tared\"\n\
                position_full_force = 1.0\n\
                [features]\nscaling = \"common\"\nimage = { planes = 3, rows = 24, columns = 32 }\n\
                [network.conv]\ngrid = [3, 24, 32]\nencoder = [8, 16, 16]\nhidden = 64\nsurface = [13, 17]\n\
                [training]\nepochs = 25\nbatch = 8\nlearning_rate = 1e-2\n\
                [split]\nkind = \"location\"\nfraction = 0.2\n";
    std::fs::write(&config, text).unwrap();
    let out = folder.join("model");
    let mut train = toys(&["train", "--skin", CAMERA, "--config"]);
    finish(train.arg(config).arg("--out").arg(&out).arg(bag));
    out
}

#[test]
fn a_cameras_images_are_learned_from_bounded_and_a_node_publishes_the_force_map() {
    let folder = tempfile::tempdir().unwrap();
    // Once: learning takes most of the time.
    let model = seeing_model(folder.path());
    images_are_recorded_learned_from_and_bounded(folder.path(), &model);
    the_node_publishes_images_and_the_force_map(folder.path(), &model);
}

fn images_are_recorded_learned_from_and_bounded(folder: &Path, model: &Path) {
    let manifest = std::fs::read_to_string(model.join("bundle.toml")).unwrap();
    assert!(manifest.contains("[input.image]") && manifest.contains("map.normal"), "{manifest}");
    let bag = collect_by(CAMERA, &pad_plan(folder, "test", 20, 2), &[]);
    let info = json(&finish(toys(&["bag", "info", "--json"]).arg(&bag)));
    let topics = info["topics"].as_array().unwrap();
    let count = |name: &str| topics.iter().find(|t| t["name"] == name).unwrap()["messages"].as_u64().unwrap();
    assert!(count("/image") > 200 && count("/image") == count("/taxels"), "{info}");
    let found =
        json(&finish(toys(&["evaluate", "--json", "--skin", CAMERA, "--model"]).arg(model).arg(&bag)));
    let median = found["figures"]["position_median"].as_f64().unwrap();
    println!("position: median error {:.2} mm on a pad of 32 x 24 mm", median * 1e3);
    // Chance is about 10 mm; a map that says nothing has 1.
    assert!(median < 0.003, "{}", found["figures"]);
    assert!(found["figures"]["map_normal_relative"].as_f64().unwrap() < 0.95, "{}", found["figures"]);
    let mut bounds = toys(&["bounds", CAMERA, "--json", "--force", "1", "--diameter", "0.004"]);
    let bound = json(&finish(&mut bounds));
    assert_eq!((bound["channels"].as_u64(), bound["diameter_m"].as_f64()), (Some(576), Some(0.004)));
}

#[test]
fn a_cameras_gap_has_a_name() {
    let folder = tempfile::tempdir().unwrap();
    let bag = collect_by(CAMERA, &pad_plan(folder.path(), "soft", 40, 3), &["soft-pad=1"]);
    let mut diagnose = toys(&["gap", "diagnose", "--json", "--resamples", "4", "--skin", CAMERA, "--real"]);
    let cache = folder.path().join("kept");
    let report = json(&finish(
        diagnose.arg(&bag).arg("--cache").arg(cache).arg("--out").arg(folder.path().join("out")),
    ));
    println!("{}", report["sentence"]);
    assert_eq!(report["verdict"], "named", "{}", report["sentence"]);
    assert_eq!(report["effects"][0]["label"], "soft-pad", "{}", report["sentence"]);
}

#[test]
fn a_cameras_images_and_frames_are_in_the_bag() {
    let folder = tempfile::tempdir().unwrap();
    let topics = [("/taxels", TypeSupport::of::<TaxelFrame>()), ("/image", TypeSupport::of::<Image>())];
    let bag = record_node(CAMERA, &pad_plan(folder.path(), "pressed", 50, 4), &topics);
    let frames = bag.read::<TaxelFrame>("/taxels").unwrap();
    let frames: Vec<i64> = frames.map(|frame| frame.unwrap().message.header.stamp.as_nanos()).collect();
    let images = bag.read::<Image>("/image").unwrap();
    let images: Vec<i64> = images.map(|image| image.unwrap().message.header.stamp.as_nanos()).collect();
    // The recorder may subscribe to one of them earlier than to the other.
    let begin = frames[0].max(images[0]);
    let since =
        |stamps: &[i64]| -> Vec<i64> { stamps.iter().copied().filter(|stamp| *stamp >= begin).collect() };
    assert_eq!(since(&frames), since(&images), "each frame has its image");
    assert!(since(&images).len() > 10, "{images:?}");
}

#[test]
fn an_effect_on_channels_is_refused_where_a_camera_makes_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = toys(&["collect", CAMERA, "--effect", "interference=1", "--plan"]);
    command.arg(pad_plan(folder.path(), "mains", 2, 5)).arg("--out").arg(folder.path().join("bag"));
    let said = refused(&mut command);
    assert!(said.contains("`interference` acts on channels"), "{said}");
}

fn the_node_publishes_images_and_the_force_map(folder: &Path, model: &Path) {
    let link = folder.join("pad");
    let mut simulate = toys(&["device", "simulate", CAMERA, "--link"]);
    let _device = Peer::start(simulate.arg(&link).arg("--plan").arg(pad_plan(folder, "pressed", 500, 4)));
    let node = open_node("listener");
    let (seen, images) = channel();
    let _images = node
        .subscribe::<Image>("image", Qos::sensor_data(), move |image, _| {
            let _ = seen.send((image.width, image.height, image.encoding, image.data.len()));
        })
        .unwrap();
    let (_maps, maps) = dermis_integration_tests::listen::<ForceMap>(&node, "force_map", Qos::sensor_data());
    let (_contacts, contacts) =
        dermis_integration_tests::listen::<ContactArray>(&node, "contacts", Qos::sensor_data());
    let mut run = toys(&["run", CAMERA, "--source"]);
    let _node = Peer::start(run.arg(format!("pty://{}", link.display())).arg("--model").arg(model));
    assert_eq!(images.recv_timeout(PATIENCE).unwrap(), (320, 240, "rgb8".to_owned(), 320 * 240 * 3));
    let deadline = Instant::now() + PATIENCE;
    loop {
        assert!(Instant::now() < deadline, "no force map of a press came");
        let map = maps.recv_timeout(PATIENCE).unwrap();
        assert_eq!((map.kind, map.forces.len()), (ForceMap::KIND_NORMAL, 13 * 17));
        // What presses is somewhere, and not everywhere.
        let total: f32 = map.forces.iter().sum();
        let largest = map.forces.iter().fold(0.0_f32, |m, f| m.max(*f));
        if total > 1.0 && largest > 4.0 * total / map.forces.len() as f32 {
            break;
        }
    }
    let pressed = |c: &dermis_msgs::msg::Contact| -c.force.z > 0.3 && c.position.x.abs() <= 0.016;
    let any = |array: ContactArray| array.contacts.iter().any(pressed);
    assert!(std::iter::repeat_with(|| contacts.recv_timeout(PATIENCE).unwrap()).take(200).any(any));
}
