//! Nodes that share a process: two skins, the node that merges them, reflexes, a recorder and the bridge, heard from another process.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use dermis_integration_tests::launch::{Launch, PATIENCE, children, kill, until};
use dermis_integration_tests::{Peer, backend, domain, finish, isolate, json, program, root};
use dermis_msgs::msg::BodyContacts;
use dermis_msgs::std_msgs::msg::Bool;
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

#[test]
fn skins_fusion_reflexes_recorder_and_bridge_share_a_process() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().to_owned();
    let file = launch_file(&at);
    let node =
        Node::open(NodeOptions::new("outside").domain_id(domain()).localhost_only(true), &backend()).unwrap();
    let touched: Arc<Mutex<[u32; 2]>> = Arc::default();
    let sink = Arc::clone(&touched);
    let _body = node
        .subscribe::<BodyContacts>(
            "/two/body_contacts",
            Qos::sensor_data().with_depth(100),
            move |body, _| {
                for contact in &body.contacts {
                    sink.lock().unwrap()[usize::from(contact.skins == ["back"])] += 1;
                }
            },
        )
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
    until("the body feels both skins again", body_feels_both);
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
        // As many as both skins were felt for.
        assert!(messages > 10, "{messages} of {topic} in {}: {info:#}", last.display());
    }
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
