//! Nodes that share a process: two skins, the node that merges them, reflexes, a recorder and the bridge, heard from another process.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dermis_bag::BagReader;
use dermis_integration_tests::launch::{Launch, PATIENCE, children, kill, until};
use dermis_integration_tests::{Peer, backend, domain, finish, isolate, json, program, root};
use dermis_msgs::msg::BodyContacts;
use dermis_msgs::std_msgs::msg::Bool;
use dermis_msgs::{Message, TypeSupport};
use dermis_node::{Node, NodeOptions, Qos};

const PLAN: &str = "schema = 'dermis-plan/1'\nname = 'pressed'\nseed = 1\ndiameter = 0.004\nmargin = 0.006\n\
                    [timing]\napproach = [0.05, 0.1]\nload = [0.1, 0.1]\nhold = [0.5, 0.5]\nunload = [0.1, 0.1]\n\
                    gap = [0.5, 0.5]\n[[steps]]\nkind = 'idle'\nduration = 2.0\n\
                    [[steps]]\nkind = 'presses'\ncount = 200\nforce = [0.8, 1.2]\n";
const URDF: &str = "<robot name='two'><link name='hand'/></robot>";
const ROBOT: &str = "schema = 'dermis-robot/1'\nname = 'two'\nurdf = 'two.urdf'\n\
    [[skins]]\nname = 'palm'\nnamespace = '/two/palm'\nmount = { parent = 'hand', translation = [0.1, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }\n\
    [[skins]]\nname = 'back'\nnamespace = '/two/back'\nmount = { parent = 'hand', translation = [-0.1, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }\n";
const RULES: &str = "schema = 'dermis-reflex/1'\nname = 'guard'\nstart = 'clear'\n\
    [inputs.body]\nkind = 'body'\ntopic = '/two/body_contacts'\ntimeout = 1.0\n\
    [regions.hand]\nskins = ['palm', 'back']\n\
    [actions.stop]\nkind = 'bool'\ntopic = '/stop'\nheartbeat = 0.1\n\
    [[rules]]\nname = 'touch'\nregion = 'hand'\nforce = { above = 0.4 }\nlatch = false\nquiet = 0.05\ncounts_as_touched = []\nactions = ['stop']\n";
/// What the container holds; the recorder has the number of its process in its name.
const NODES: [&str; 6] =
    ["/two/palm/palm", "/two/back/back", "/two/fusion", "/guard", "/dermis_record_", "/dermis_bridge"];

/// The robot, its rules, and a launch file with all nodes in the container `body`; what is recorded goes to `bag`.
fn launch_file(folder: &Path) -> PathBuf {
    for (name, text) in [("two.urdf", URDF), ("two.toml", ROBOT), ("rules.toml", RULES), ("plan.toml", PLAN)]
    {
        std::fs::write(folder.join(name), text).unwrap();
    }
    let skin = root().join("launch/skins/baro-grid.toml");
    let side = |name: &str, seed: u32| {
        format!(
            "  - {{name: {name}_device, dermis: device simulate {skin} --plan plan.toml --seed {seed} --link {name}, ready: {{file: {name}}}}}
  - name: {name}
    namespace: two/{name}
    node: barodome
    config: {{skin: {skin}, models: [{model}], source: 'serial://{link}', instance: {name}, frame_id: {name}_skin}}
    after: [{name}_device]
    restart: on-failure
",
            skin = skin.display(),
            model = root().join("models/baro-grid").display(),
            link = folder.join(name).display(),
        )
    };
    let text = format!(
        "container: body
processes:
{}{}  - {{name: fusion, dermis: fusion --robot two.toml --namespace /two}}
  - {{name: guard, dermis: reflex rules.toml}}
  - {{name: recorder, dermis: record --resume -o bag /two/palm/contacts /two/back/contacts /two/body_contacts}}
  - {{name: bridge, dermis: bridge --robot two}}
",
        side("palm", 1),
        side("back", 2)
    );
    let file = folder.join("two.launch.yaml");
    std::fs::write(&file, text).unwrap();
    file
}

/// Fused messages as they came, by their stamps and numbers: a process that was started again counts anew.
type Wire = HashMap<(i64, u64), Vec<u8>>;

/// Where a fused message is in [`Wire`].
fn key(body: &BodyContacts) -> (i64, u64) {
    (body.header.stamp.as_nanos(), body.sequence)
}

/// Fused messages that another process got and that are in a bag: how many, each with the same bytes in both.
fn same_bytes(bag: &Path, wire: &Wire) -> usize {
    let recorded = BagReader::open(bag).unwrap().messages().map(Result::unwrap);
    let fused = recorded.filter(|message| &*message.topic == "/two/body_contacts");
    let both = fused.filter(|message| {
        let body = BodyContacts::from_cdr(&message.data).unwrap();
        let sent = wire.get(&key(&body));
        assert!(sent.is_none_or(|sent| *sent == message.data), "message {} differs", body.sequence);
        sent.is_some()
    });
    both.count()
}

#[test]
fn skins_fusion_reflexes_recorder_and_bridge_share_a_process() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().to_owned();
    let file = launch_file(&at);
    let node =
        Node::open(NodeOptions::new("outside").domain_id(domain()).localhost_only(true), &backend()).unwrap();
    let touched: Arc<Mutex<[u32; 2]>> = Arc::default();
    let wire: Arc<Mutex<Wire>> = Arc::default();
    let (sink, kept) = (Arc::clone(&touched), Arc::clone(&wire));
    let (fused, qos) = (TypeSupport::of::<BodyContacts>(), Qos::sensor_data().with_depth(100));
    let _body = node
        .subscribe_raw("/two/body_contacts", fused, qos, move |bytes, _| {
            let body = BodyContacts::from_cdr(bytes).unwrap();
            for contact in &body.contacts {
                sink.lock().unwrap()[usize::from(contact.skins == ["back"])] += 1;
            }
            kept.lock().unwrap().insert(key(&body), bytes.to_vec());
        })
        .unwrap();
    let stopped = Arc::new(Mutex::new(0));
    let sink = Arc::clone(&stopped);
    let _stop = node
        .subscribe::<Bool>("/stop", Qos::reliable(10), move |stop, _| {
            *sink.lock().unwrap() += u32::from(stop.data);
        })
        .unwrap();
    let mut launch = Launch::open(folder, &file, &[]);
    let first = launch.started("body");
    let body_feels_both = || touched.lock().unwrap().iter().all(|count| *count > 10);
    until("the body feels both skins", body_feels_both);
    until("the reflexes act", || *stopped.lock().unwrap() > 0);
    let names = node.node_names().unwrap();
    for expected in NODES {
        assert_eq!(
            names.iter().filter(|name| name.starts_with(expected)).count(),
            1,
            "{expected} among {names:?}"
        );
    }
    let started = children(i32::try_from(launch.peer.id()).unwrap());
    let of = |word: &str| started.iter().filter(|(_, line)| line.contains(word)).count();
    assert_eq!((of(" container "), of(" device simulate "), started.len()), (1, 2, 4), "{started:?}");

    kill(first, "-KILL");
    assert_ne!(launch.started("body"), first);
    *touched.lock().unwrap() = [0; 2];
    wire.lock().unwrap().clear();
    until("the body feels both skins again", body_feels_both);
    // A hundred frames of each skin for the recorder, however soon both are felt.
    std::thread::sleep(Duration::from_secs(1));
    launch.peer.interrupt();
    launch.wait_for("body ended");
    assert!(launch.peer.end(PATIENCE).success());

    // The bag of the process that was asked to end is whole, and what its siblings published is in it.
    let bags = std::fs::read_dir(&at).unwrap().map(|entry| entry.unwrap().path());
    let mut bags: Vec<PathBuf> = bags.filter(|path| path.join("metadata.yaml").exists()).collect();
    bags.sort_by_key(|path| std::fs::metadata(path).unwrap().modified().unwrap());
    let last = bags.pop().unwrap();
    let mut info = Command::new(program("dermis"));
    let info = json(&finish(info.args(["bag", "info", "--json"]).arg(&last)));
    for topic in ["/two/palm/contacts", "/two/back/contacts", "/two/body_contacts"] {
        let of_topic = info["topics"].as_array().unwrap().iter().find(|t| t["name"] == topic);
        let messages = of_topic.and_then(|t| t["messages"].as_u64()).unwrap_or_default();
        assert!(messages > 50, "{messages} of {topic} in {}: {info:#}", last.display());
    }
    let both = same_bytes(&last, &wire.lock().unwrap());
    assert!(both > 20, "{both} fused messages are in the bag and came over the wire");
}

#[test]
fn a_node_that_fails_ends_its_process_and_says_which() {
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()));
    command.args(["container", "bridge", "--", "reflex", "surely-not-there.toml", "--", "barodome"]);
    command.args(["--skin", "launch/skins/baro-grid.toml", "--source", "serial:///dev/surely-not-there"]);
    let mut peer = Peer::start(command.stderr(std::process::Stdio::piped()));
    let begun = Instant::now();
    let sentence = peer.expect_error("dermis: `dermis reflex surely-not-there.toml` failed", PATIENCE);
    assert!(sentence.starts_with("dermis:"), "{sentence}");
    assert_eq!(peer.end(PATIENCE).code(), Some(1));
    assert!(begun.elapsed() < PATIENCE);
}
