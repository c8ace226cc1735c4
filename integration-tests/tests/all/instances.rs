//! Two skins of one type on one robot: they run, are recorded, replayed and bridged, and nobody takes one for the other.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dermis_bag::BagReader;
use dermis_integration_tests::{
    Peer, backend, client_python, domain, finish, isolate, json, program, refused, root,
};
use dermis_msgs::diagnostic_msgs::msg::DiagnosticArray;
use dermis_msgs::msg::{ContactArray, TaxelFrame};
use dermis_node::{Node, NodeOptions, Qos};
use dermis_transport::framing::{FrameDecoder, NativeDecoder};
use dermis_transport::{Event, Source, SourceOptions, SourceUrl};
use serde_json::Value;

/// Longest wait for anything, on a machine at full load.
const PATIENCE: Duration = Duration::from_secs(60);
/// Nothing touches it.
const UNTOUCHED: &str = "schema = 'dermis-plan/1'\nname = 'untouched'\nseed = 1\ndiameter = 0.004\nmargin = 0.004\n\
                         [[steps]]\nkind = 'idle'\nduration = 600.0\n";
/// Pressed again and again, with what a tare takes in between: whenever the node begins, it finds its zero.
const PRESSED: &str = "schema = 'dermis-plan/1'\nname = 'pressed'\nseed = 1\ndiameter = 0.004\nmargin = 0.004\n\
                       [timing]\napproach = [0.05, 0.1]\nload = [0.1, 0.1]\nhold = [0.3, 0.3]\nunload = [0.1, 0.1]\n\
                       gap = [1.0, 1.0]\n[[steps]]\nkind = 'idle'\nduration = 2.0\n\
                       [[steps]]\nkind = 'presses'\ncount = 200\nforce = [0.8, 1.2]\n";

fn dermis() -> Command {
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()));
    command
}

fn skin() -> PathBuf {
    root().join("launch/skins/baro-grid.toml")
}

fn listener(name: &str) -> Node {
    let options = NodeOptions::new(name).domain_id(domain()).localhost_only(true);
    Node::open(options, &backend()).unwrap()
}

fn until<T>(what: &str, mut test: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = test() {
            return found;
        }
        assert!(Instant::now() < deadline, "not within {PATIENCE:?}: {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// What the bridge of a robot sends, as a Python client counts it.
struct Keys(Peer);

impl Keys {
    fn of(robot: &str) -> Option<Self> {
        let script = root().join("integration-tests/python/zenoh/keys.py");
        Some(Self(Peer::start(Command::new(client_python()?).arg(script).arg(robot))))
    }

    /// Waits until the counts are as requested.
    fn until(&mut self, what: &str, mut holds: impl FnMut(&Value) -> bool) -> Value {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let seen = json(&self.0.expect("{", PATIENCE));
            if holds(&seen) {
                return seen;
            }
            assert!(Instant::now() < deadline, "not within {PATIENCE:?}: {what}; it saw {seen:#}");
        }
    }
}

fn count(seen: &Value, key: &str, field: &str) -> u64 {
    seen[key][field].as_u64().unwrap_or(0)
}

/// Two simulated devices of one skin file, the left one pressed, and two nodes that publish contacts on one topic.
fn pair(folder: &Path, robot: &str, extra: [&str; 2]) -> PathBuf {
    let side = |name: &str, plan: &str, extra: &str| {
        let plan_file = folder.join(format!("{name}.toml"));
        std::fs::write(&plan_file, plan).unwrap();
        format!(
            "
  - name: {name}_device
    dermis: device simulate {skin} --plan {plan} --link ${{tmp}}/{name} --ground-truth ground_truth --namespace {name} --instance {name}_palm --frame-id {name}_palm_link
    ready: {{file: '${{tmp}}/{name}'}}
  - name: palm
    namespace: {name}
    node: barodome
    config:
      skin: {skin}
      models: [{model}]
      source: serial://${{tmp}}/{name}
      {extra}
    remap: ['contacts:=/contacts']
    after: [{name}_device]
",
            skin = skin().display(),
            plan = plan_file.display(),
            model = root().join("models/baro-grid").display(),
        )
    };
    let text = format!(
        "processes:\n  - {{name: bridge, dermis: bridge --robot {robot}}}{}{}",
        side("left", PRESSED, extra[0]),
        side("right", UNTOUCHED, extra[1])
    );
    let file = folder.join("pair.launch.yaml");
    std::fs::write(&file, text).unwrap();
    file
}

const NAMED: [&str; 2] = [
    "instance: left_palm\n      frame_id: left_palm_link\n      mount: {parent: wrist, translation: [0, 0.03, 0], rpy: [0, 0, 1.57]}",
    "instance: right_palm\n      frame_id: right_palm_link\n      mount: {parent: wrist, translation: [0, -0.03, 0]}",
];

#[test]
fn two_like_skins_run_record_replay_and_bridge_apart() {
    let folder = tempfile::tempdir().unwrap();
    let robot = format!("pair{}", std::process::id());
    let Some(mut keys) = Keys::of(&robot) else { return };
    let file = pair(folder.path(), &robot, NAMED);

    // What both say of themselves.
    let node = listener("instances_test");
    let heard: Arc<Mutex<Vec<ContactArray>>> = Arc::default();
    let sink = Arc::clone(&heard);
    let contacts = node
        .subscribe::<ContactArray>("/contacts", Qos::sensor_data().with_depth(100), move |array, _| {
            sink.lock().unwrap().push(array);
        })
        .unwrap();
    let hardware: Arc<Mutex<BTreeSet<(String, String)>>> = Arc::default();
    let sink = Arc::clone(&hardware);
    let _diagnostics = node
        .subscribe::<DiagnosticArray>("/diagnostics", Qos::reliable(10), move |array, _| {
            sink.lock().unwrap().extend(array.status.into_iter().map(|s| (s.name, s.hardware_id)));
        })
        .unwrap();

    let bag = folder.path().join("bag");
    let recorder = Peer::start(dermis().args(["record", "--all", "-o"]).arg(&bag));
    let launch = Peer::start(dermis().arg("launch").arg(&file));
    // The left one is pressed and the right one has been heard as long.
    let seen = keys.until("contacts of the left palm alone", |seen| {
        count(seen, "left_palm/contacts", "touched") > 20
            && count(seen, "right_palm/contacts", "n") > 100
            && count(seen, "right_palm/taxels", "n") > 100
    });
    assert_eq!(count(&seen, "right_palm/contacts", "touched"), 0, "nobody touches it: {seen:#}");
    for (key, found) in seen.as_object().unwrap() {
        let skin = key.split('/').next().unwrap();
        assert_eq!(found["skins"], serde_json::json!([skin]), "{key}");
        assert!(["left_palm", "right_palm"].contains(&skin), "{key}");
    }
    until("diagnostics name both", || {
        let hardware = hardware.lock().unwrap();
        let has = |name: &str, id: &str| hardware.contains(&(name.to_owned(), id.to_owned()));
        (has("left/palm: skin", "left_palm") && has("right/palm: skin", "right_palm")).then_some(())
    });
    for array in heard.lock().unwrap().iter() {
        assert_eq!(array.header.frame_id, format!("{}_link", array.skin));
        assert!(array.skin == "left_palm" || array.contacts.is_empty(), "{array:?}");
    }
    launch.interrupt();
    drop(launch);
    let mut recorder = recorder;
    recorder.interrupt();
    assert!(recorder.end(PATIENCE).success());
    drop(contacts);

    the_recording_knows_both(folder.path(), &bag);
    one_is_played(&bag, &node);
    one_is_replayed(folder.path(), &bag);
}

fn the_recording_knows_both(folder: &Path, bag: &Path) {
    let info = json(&finish(dermis().args(["bag", "info", "--json"]).arg(bag)));
    let skins = info["skins"].as_array().unwrap();
    assert_eq!(
        skins.iter().map(|s| s["name"].as_str().unwrap()).collect::<Vec<_>>(),
        ["left_palm", "right_palm"]
    );
    assert_eq!(skins[0]["hash"], skins[1]["hash"]);
    assert_eq!(skins[0]["frame_ids"], serde_json::json!(["left_palm_link"]));
    assert!(skins[1]["topics"]["/right/taxels"] == "dermis_msgs/msg/TaxelFrame", "{info:#}");
    let text = finish(dermis().args(["bag", "info"]).arg(bag));
    assert!(text.contains("right_palm  type sha256:") && text.contains("frame_id right_palm_link"), "{text}");

    // Learning from it: one of them, never both.
    let export = |out: &str, arguments: &[&str]| {
        let mut command = dermis();
        command.args(["bag", "export", "--format", "npz", "--json", "--skin"]).arg(skin());
        command.arg("--out").arg(folder.join(out)).args(arguments).arg(bag);
        command
    };
    let sentence = refused(&mut export("both", &[]));
    assert!(
        sentence.contains("holds frames of several skins of the type `baro-grid`: those of `left_palm` (/left/taxels), `right_palm` (/right/taxels)")
            && sentence.contains("--skin-instance"),
        "{sentence}"
    );
    finish(&mut export("left", &["--skin-instance", "left_palm"]));
    // By its topic, too; nothing pressed it, so that there is no location to hold out.
    finish(&mut export("right", &["--taxels", "/right/taxels", "--split", "time"]));
    let sentence = refused(&mut export("none", &["--skin-instance", "foot"]));
    assert!(sentence.contains("holds no frames of skin `foot`; it has those of `left_palm`"), "{sentence}");
}

fn one_is_played(bag: &Path, node: &Node) {
    let heard: Arc<Mutex<BTreeSet<String>>> = Arc::default();
    let sink = Arc::clone(&heard);
    let _contacts = node
        .subscribe::<ContactArray>("/contacts", Qos::sensor_data().with_depth(1000), move |array, _| {
            sink.lock().unwrap().insert(array.skin);
        })
        .unwrap();
    let play = |name: &str| {
        let mut command = dermis();
        command.args(["play", "--json", "--rate", "0", "--skin-instance", name]).arg(bag);
        command.args(["--topics", "/contacts", "--wait-for-subscribers", "1"]);
        command
    };
    let sent = json(&finish(&mut play("right_palm")));
    assert!(sent["messages"].as_u64().unwrap() > 100, "{sent}");
    until("what is played arrives", || heard.lock().unwrap().contains("right_palm").then_some(()));
    let sentence = refused(&mut play("foot"));
    assert!(sentence.contains("has no skin `foot`; it has left_palm, right_palm"), "{sentence}");
    assert_eq!(
        *heard.lock().unwrap(),
        BTreeSet::from(["right_palm".to_owned()]),
        "the topic carries both in the bag"
    );
}

fn one_is_replayed(folder: &Path, bag: &Path) {
    let replay = |name: &[&str], link: &Path| {
        let mut command = dermis();
        command.args(["device", "replay", "--speed", "0", "--skin"]).arg(skin());
        command.arg("--link").arg(link).args(name).arg(bag);
        command
    };
    let sentence = refused(&mut replay(&[], &folder.join("both")));
    assert!(sentence.contains("holds frames of several skins of the type `baro-grid`"), "{sentence}");

    let link = folder.join("replayed");
    let mut device = Peer::start(&mut replay(&["--skin-instance", "left_palm"], &link));
    device.expect("", PATIENCE);
    let recorded: Vec<TaxelFrame> =
        BagReader::open(bag).unwrap().read("/left/taxels").unwrap().map(|m| m.unwrap().message).collect();
    let source = format!("replay://{}?speed=0&skin=left_palm", bag.display());
    // A device that has sent all hangs up, with what is still on its line.
    let all = recorded.len();
    for (url, least) in [(format!("pty://{}", link.display()), all / 2), (source, all)] {
        let source = Source::open(SourceUrl::parse(&url).unwrap(), SourceOptions::default());
        let mut decoder = NativeDecoder::new(Some(25));
        let mut frames = Vec::new();
        until("its frames come back", || {
            while frames.len() < least
                && let Some(Event::Bytes { data, received_ns }) =
                    source.next_timeout(Duration::from_millis(50))
            {
                decoder.push(&data, received_ns, &mut frames);
            }
            (frames.len() >= least).then_some(())
        });
        assert!(frames.iter().zip(&recorded).all(|(a, b)| a.values == b.values), "{url}");
    }
}

#[test]
fn names_that_are_left_out_are_distinguished_by_namespaces() {
    let folder = tempfile::tempdir().unwrap();
    let check = |extra: [&str; 2]| {
        let mut command = dermis();
        command.args(["launch", "--check", "--json"]).arg(pair(folder.path(), "checked", extra));
        command
    };
    // Names follow from the namespaces, and frames have to be given: which link a skin is on nobody can guess.
    let sentence = refused(&mut check(["", ""]));
    assert!(
        sentence.contains("config.frame_id")
            && sentence.contains("`baro_grid_link` is the coordinate frame of `left/palm` too"),
        "{sentence}"
    );
    let plan = json(&finish(&mut check(["", "frame_id: right_link"])));
    let configs: Vec<&Value> = plan["processes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| &p["config"])
        .filter(|c| c.is_object())
        .collect();
    assert_eq!(
        configs.iter().map(|c| c["instance"].as_str().unwrap()).collect::<Vec<_>>(),
        ["left_palm", "right_palm"]
    );
    assert_eq!(configs[0]["frame_id"], "baro_grid_link");
    let sentence = refused(&mut check(["instance: palm", "instance: palm"]));
    assert!(
        sentence.contains("config.instance") && sentence.contains("`palm` is the skin of `left/palm` too"),
        "{sentence}"
    );
    let sentence = refused(&mut check(["", "mount: {parent: wrist, rpy: [0, 0, 90]}"]));
    assert!(sentence.contains("config.mount") && sentence.contains("radians"), "{sentence}");
    finish(
        dermis()
            .args(["launch", "--check", "launch/four-skins.launch.yaml"])
            .arg(format!("out:={}", folder.path().join("x").display())),
    );
}

#[test]
fn a_renamed_skin_file_loads_its_old_bundle() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(skin()).unwrap();
    let renamed = folder.path().join("right-palm.toml");
    std::fs::write(&renamed, text.replace("name = \"baro-grid\"", "name = \"right-palm\"")).unwrap();
    let launch = folder.path().join("renamed.launch.yaml");
    // A bundle whose hash covered the name: of baro-grid that was this.
    let named = "sha256:c725fa4cf5c38301732468e689a2ed1cb162a746611719bfed53b2f350b424f0";
    let model = folder.path().join("baro-grid");
    std::fs::create_dir(&model).unwrap();
    for file in ["bundle.toml", "card.json", "model.onnx"] {
        std::fs::copy(root().join("models/baro-grid").join(file), model.join(file)).unwrap();
    }
    let manifest = std::fs::read_to_string(model.join("bundle.toml")).unwrap();
    let hash = dermis_skin::SkinDescription::load(skin()).unwrap().hash();
    assert!(manifest.contains(&hash), "the bundle that ships is of another skin");
    std::fs::write(model.join("bundle.toml"), manifest.replace(&hash, named)).unwrap();
    std::fs::write(
        &launch,
        format!(
            "processes: [{{name: palm, node: barodome, config: {{skin: {}, source: 'serial:///dev/x', models: [{}], strict: true}}}}]",
            renamed.display(),
            model.display()
        ),
    )
    .unwrap();
    finish(dermis().args(["launch", "--check"]).arg(&launch));
}

#[test]
fn one_name_for_two_skins_is_distinguished_by_the_bridge() {
    let robot = format!("clash{}", std::process::id());
    let Some(mut keys) = Keys::of(&robot) else { return };
    let _bridge = Peer::start(dermis().args(["bridge", "--robot", &robot]));
    let node = listener("clash_test");
    let publishers = ["left", "right"]
        .map(|side| node.publisher::<TaxelFrame>(&format!("/{side}/taxels"), Qos::sensor_data()).unwrap());
    let mut sequence = 0;
    let mut both = |keys: &mut Keys, what: &str, which: &[usize], holds: &dyn Fn(&Value) -> bool| {
        keys.until(what, |seen| {
            for _ in 0..5 {
                sequence += 1;
                for i in which {
                    let frame = TaxelFrame { skin: "palm".into(), sequence, ..TaxelFrame::default() };
                    publishers[*i].publish(&frame).unwrap();
                }
            }
            holds(seen)
        })
    };
    both(&mut keys, "one skin has the name", &[0], &|seen| count(seen, "palm/taxels", "n") > 10);
    let seen = both(&mut keys, "two skins have two names", &[0, 1], &|seen| {
        count(seen, "left_palm/taxels", "n") > 10 && count(seen, "right_palm/taxels", "n") > 10
    });
    let alone = count(&seen, "palm/taxels", "n");
    let seen = both(&mut keys, "they go on", &[0, 1], &|now| {
        count(now, "left_palm/taxels", "n") > count(&seen, "left_palm/taxels", "n") + 10
    });
    assert_eq!(count(&seen, "palm/taxels", "n"), alone, "the bare name has no key any more");
}
