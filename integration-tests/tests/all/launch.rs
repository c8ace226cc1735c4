//! `dermis launch`: order, readiness, restarts, stopping, logs, and what is left when the launch itself is killed.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dermis_integration_tests::launch::{Launch, PATIENCE, kill, runs, until};
use dermis_integration_tests::{
    Peer, backend, client_python, domain, finish, json, program, root, ros_python,
};
use dermis_msgs::diagnostic_msgs::msg::DiagnosticArray;
use dermis_node::{Node, NodeOptions, Qos};
use serde_json::Value;

#[test]
fn starts_in_order_waits_for_readiness_and_stops_in_reverse() {
    let mut launch = Launch::start(
        r#"
processes:
  - name: slow
    program: [sh, -c, 'sleep 0.3; echo up; touch "${tmp}/here"; exec sleep 1000']
    ready: {file: "${tmp}/here"}
  - name: talker
    program: [sh, -c, 'echo "[WARN] [1.0] [talker]: hello"; exec sleep 1000']
    ready: {line: hello}
  - name: after
    program: [sh, -c, 'test -e "${tmp}/here" && echo it is there; exec sleep 1000']
    after: [slow, talker]
"#,
    );
    launch.started("slow");
    launch.started("talker");
    launch.wait_for("slow is ready");
    launch.started("after");
    launch.wait("after", "it is there");
    let warning = launch.records.iter().find(|r| r["process"] == "talker").unwrap();
    assert_eq!(warning["level"], "WARN");
    launch.peer.interrupt();
    for name in ["after", "talker", "slow"] {
        assert_eq!(launch.wait_for("was ended"), format!("{name} was ended by signal 2 (SIGINT)"));
    }
    assert!(launch.peer.end(PATIENCE).success(), "stopped as requested is no failure");
}

#[test]
fn what_waits_for_something_that_fails_says_so() {
    let mut launch = Launch::start(
        "
processes:
  - {name: broken, program: 'false', ready: {line: up}}
  - {name: mute, program: sleep 1000, ready: {line: up, within: 0.2}, stop: {interrupt: 1}}
  - {name: after, program: sleep 1000, after: [broken]}
  - {name: later, program: sleep 1000, after: [mute]}
",
    );
    launch.ever("broken ended with exit code 1 after");
    launch.ever("after is not started: broken, which it waits for, was never ready");
    launch.ever("mute was not ready in time, and was ended by signal 2 (SIGINT)");
    launch.ever("later is not started: mute");
    assert_eq!(launch.peer.end(PATIENCE).code(), Some(1));
}

#[test]
fn a_killed_process_comes_back_ever_later_until_it_is_given_up() {
    let mut launch = Launch::start(
        "
processes:
  - name: worker
    program: sleep 1000
    restart: on-failure
    backoff: {first: 0.05, most: 0.15, limit: 4, stable: 1000}
",
    );
    for (i, when) in ["at once", "in 0.05 s", "in 0.10 s", "in 0.15 s"].into_iter().enumerate() {
        let id = launch.started("worker");
        kill(id, "-KILL");
        let message = launch.wait_for("worker was ended by signal 9 (SIGKILL) after");
        let expected = format!("starting it again {when} (restart {} of at most 4)", i + 1);
        assert!(message.ends_with(&expected), "{message}");
    }
    let id = launch.started("worker");
    kill(id, "-KILL");
    launch.wait_for("given up after 4 restarts in a row");
    assert_eq!(launch.peer.end(PATIENCE).code(), Some(1));
}

#[test]
fn a_success_is_not_repeated_and_always_is_always() {
    let mut launch = Launch::start(
        r#"
processes:
  - {name: once, program: "true", restart: on-failure}
  - {name: ever, program: "true", restart: always, backoff: {first: 0, limit: 1000}}
"#,
    );
    launch.started("ever");
    launch.started("ever");
    launch.started("ever");
    launch.peer.interrupt();
    assert!(launch.peer.end(PATIENCE).success());
    let starts =
        launch.records.iter().filter(|r| r["message"].as_str().unwrap().starts_with("once started")).count();
    assert_eq!(starts, 1);
}

#[test]
fn the_end_of_a_required_process_ends_all() {
    let mut launch = Launch::start(
        "
processes:
  - {name: other, program: sleep 1000}
  - {name: main, program: [sh, -c, sleep 0.2; exit 3], required: true}
",
    );
    let other = launch.started("other");
    launch.wait_for("main ended with exit code 3");
    launch.wait_for("main is required: stopping the others");
    launch.wait_for("other was ended by signal 2 (SIGINT)");
    assert_eq!(launch.peer.end(PATIENCE).code(), Some(1));
    assert!(!runs(other));
}

const STUBBORN: &str = r#"[sh, -c, 'trap "" INT TERM; echo up; while :; do sleep 0.1; done']"#;

#[test]
fn who_ignores_every_signal_is_killed() {
    let mut launch = Launch::start(&format!(
        "
processes:
  - {{name: stubborn, program: {STUBBORN}, ready: {{line: up}}, stop: {{interrupt: 0.2, terminate: 0.2}}}}
"
    ));
    let id = launch.started("stubborn");
    launch.wait_for("stubborn is ready");
    launch.peer.interrupt();
    launch.wait_for("stubborn ignores the interrupt for 0.2 s: SIGTERM");
    launch.wait_for("stubborn ignores SIGTERM too: SIGKILL");
    launch.wait_for("stubborn was ended by signal 9 (SIGKILL)");
    assert!(launch.peer.end(PATIENCE).success());
    assert!(!runs(id));
}

#[test]
fn a_second_interrupt_hurries() {
    let mut launch = Launch::start(&format!(
        "
processes:
  - {{name: a, program: {STUBBORN}, ready: {{line: up}}, stop: {{interrupt: 1000, terminate: 1000}}}}
  - {{name: b, program: {STUBBORN}, ready: {{line: up}}, stop: {{interrupt: 1000, terminate: 1000}}}}
"
    ));
    launch.wait_for(" is ready");
    launch.wait_for(" is ready");
    launch.peer.interrupt();
    launch.wait_for("Ctrl-C: stopping; once more to hurry");
    let first = Instant::now();
    // One that comes at once is taken for the same.
    until("half a second has passed", || first.elapsed() > Duration::from_millis(500));
    launch.peer.interrupt();
    launch.wait_for("not waiting any longer");
    assert!(launch.peer.end(PATIENCE).success());
}

#[test]
fn nothing_is_left_where_the_launch_itself_is_killed() {
    let skin = root().join("launch/skins/baro-grid.toml");
    let mut launch = Launch::start(&format!(
        r#"
processes:
  - name: parent
    program: [sh, -c, 'trap "" INT TERM; sleep 1000 & echo child $!; wait; sleep 1000']
  - name: device
    dermis: device simulate {} --link ${{tmp}}/device
    ready: {{file: "${{tmp}}/device"}}
"#,
        skin.display()
    ));
    let parent = launch.started("parent");
    let record = launch.wait("parent", "child ");
    let child = record["message"].as_str().unwrap().rsplit(' ').next().unwrap().parse().unwrap();
    let device = match launch.records.iter().find_map(|r| {
        r["message"].as_str().unwrap().strip_prefix("device started, process ").map(str::to_owned)
    }) {
        Some(id) => id.parse().unwrap(),
        None => launch.started("device"),
    };
    assert!([parent, child, device].into_iter().all(runs));
    launch.peer.kill();
    for id in [parent, child, device] {
        until("it is gone", || !runs(id));
    }
}

#[test]
fn what_a_process_started_ends_with_it() {
    let mut launch =
        Launch::start("processes: [{name: parent, program: [sh, -c, sleep 1000 & echo child $!]}]");
    let record = launch.wait("parent", "child ");
    let child: i32 = record["message"].as_str().unwrap().rsplit(' ').next().unwrap().parse().unwrap();
    launch.wait_for("parent ended after");
    assert!(launch.peer.end(PATIENCE).success());
    assert!(!runs(child));
}

#[test]
fn a_flood_holds_nobody_up_and_takes_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flood.launch.yaml");
    std::fs::write(
        &file,
        r#"
processes:
  - {name: flood, program: "yes"}
  - {name: calm, program: [sh, -c, 'while :; do echo tick; sleep 0.02; done']}
"#,
    )
    .unwrap();
    let logs = folder.path().join("logs");
    let mut peer =
        Peer::start(Command::new(program("dermis")).arg("launch").arg(&file).arg("--log-dir").arg(&logs));
    let launched = i32::try_from(peer.id()).unwrap();
    let memory = || {
        let status = std::fs::read_to_string(format!("/proc/{launched}/status")).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or("0 kB").to_owned();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap()
    };
    let ticks = || {
        let text = std::fs::read_to_string(logs.join("calm.log")).unwrap_or_default();
        text.lines().filter(|line| line.ends_with("tick")).count()
    };
    until("ten ticks", || ticks() >= 10);
    let before = memory();
    until("fifty more ticks", || ticks() >= 60);
    let after = memory();
    assert!(after < before + 16 * 1024, "{before} kB became {after} kB");
    peer.interrupt();
    assert!(peer.end(PATIENCE).success());
    let flood = std::fs::read_to_string(logs.join("flood.log")).unwrap();
    assert!(flood.contains("lines left out here: "), "{}", flood.len());
}

#[test]
fn output_that_nobody_reads_holds_nobody_up() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("unread.launch.yaml");
    let done = folder.path().join("done");
    std::fs::write(
        &file,
        format!(
            "processes: [{{name: a, program: [sh, -c, 'yes | head -n 500000; touch {}']}}]",
            done.display()
        ),
    )
    .unwrap();
    let mut child = Command::new(program("dermis"))
        .arg("launch")
        .arg(&file)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    until("it has printed everything", || done.exists());
    until("the launch has ended", || child.try_wait().unwrap().is_some());
}

#[test]
fn the_demo_runs_from_anywhere_and_keeps_levels() {
    let file = root().join("launch/demo.launch.yaml");
    let mut launch =
        Launch::open(tempfile::tempdir().unwrap(), &file, &["robot:=launched", "namespace:=left"]);
    let connected = launch.wait("left/baro_grid", "connected to ");
    assert_eq!(connected["level"], "INFO");
    assert!(connected["target"].as_str().unwrap().starts_with("dermis_perception::node"), "{connected}");
    let seen = contacts_from("/left/contacts");
    until("contacts arrive", || *seen.1.lock().unwrap() > 10);
    launch.peer.interrupt();
    launch.wait_for("bridge ended");
    launch.wait_for("device ended");
    assert!(launch.peer.end(PATIENCE).success());
    assert_eq!(
        std::fs::read_dir(launch.folder.path()).unwrap().count(),
        0,
        "it leaves nothing in the folder"
    );
}

fn contacts_from(topic: &str) -> (Node, Arc<Mutex<u32>>) {
    let node = Node::open(here("launch_test_contacts"), &backend()).unwrap();
    let count = Arc::new(Mutex::new(0));
    let sink = Arc::clone(&count);
    let subscription = node
        .subscribe::<dermis_msgs::msg::ContactArray>(topic, Qos::sensor_data(), move |_, _| {
            *sink.lock().unwrap() += 1;
        })
        .unwrap();
    std::mem::forget(subscription);
    (node, count)
}

fn here(name: &str) -> NodeOptions {
    NodeOptions::new(name).domain_id(domain()).localhost_only(true)
}

#[test]
fn two_nodes_of_one_name_are_reported_once_and_diagnosed() {
    let skin = root().join("launch/skins/baro-grid.toml");
    let text = format!(
        "
processes:
  - {{name: twin, node: barodome, config: {{skin: {}, source: 'serial:///dev/surely-not-there'}}}}
",
        skin.display()
    );
    let watcher = Node::open(here("launch_test_diagnostics"), &backend()).unwrap();
    let reports = Arc::new(Mutex::new(0));
    let sink = Arc::clone(&reports);
    let _subscription = watcher
        .subscribe::<DiagnosticArray>("/diagnostics", Qos::reliable(10), move |array, _| {
            for status in array.status {
                if status.name == "twin: ROS graph" && status.message.starts_with("2 nodes are named /twin") {
                    *sink.lock().unwrap() += 1;
                }
            }
        })
        .unwrap();
    let mut both = [Launch::start(&text), Launch::start(&text)];
    for launch in &mut both {
        let warning = launch.wait("twin", "2 nodes are named /twin");
        assert_eq!(warning["level"], "WARN");
        let sentence = warning["message"].as_str().unwrap();
        assert!(sentence.contains("start it under another name or namespace"), "{sentence}");
    }
    // Seconds later, both still say it in their diagnostics, and the log has not repeated it.
    until("diagnostics say it", || *reports.lock().unwrap() >= 6);
    for launch in &mut both {
        launch.peer.interrupt();
        launch.wait_for("twin ended");
        let count = launch
            .records
            .iter()
            .filter(|r| r["message"].as_str().unwrap().starts_with("2 nodes are named"))
            .count();
        assert_eq!(count, 1);
    }
}

fn check(file: &Path) -> Result<String, String> {
    let out = Command::new(program("dermis")).args(["launch", "--check"]).arg(file).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    if out.status.success() { Ok(text(&out.stdout)) } else { Err(text(&out.stderr)) }
}

#[test]
fn every_launch_file_that_ships_can_be_started() {
    let mut files: Vec<PathBuf> = std::fs::read_dir(root().join("launch"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_string_lossy().ends_with(".launch.yaml"))
        .collect();
    files.sort();
    assert!(files.len() >= 4, "{files:?}");
    for file in files {
        check(&file).unwrap_or_else(|error| panic!("{error}"));
    }
}

/// The fusion refuses skins of other names and frames than those of its robot file, and misses those that nobody starts.
#[test]
fn the_demo_robot_has_a_device_and_a_node_for_each_of_its_skins() {
    let launch = root().join("launch");
    let mut command = Command::new(program("dermis"));
    command.args(["launch", "--check", "--json"]).arg(launch.join("humanoid.launch.yaml"));
    let plan = json(&finish(&mut command));
    let processes = plan["processes"].as_array().unwrap();
    let robot = dermis_body::Robot::load(launch.join("robots/humanoid.toml")).unwrap();
    let mut families = std::collections::BTreeSet::new();
    for skin in &robot.skins {
        let node = processes.iter().find(|p| p["config"]["instance"] == skin.name.as_str());
        let node = node.unwrap_or_else(|| panic!("no node reads `{}`", skin.name));
        let config = &node["config"];
        assert_eq!(config["namespace"], skin.namespace.as_str(), "{}", skin.name);
        assert_eq!(config["frame_id"], skin.frame_id.as_str(), "{}", skin.name);
        let of_node = launch.join(config["skin"].as_str().unwrap()).canonicalize().unwrap();
        assert_eq!(of_node, skin.skin.as_ref().unwrap().canonicalize().unwrap(), "{}", skin.name);
        families.insert(node["arguments"][0].as_str().unwrap().to_owned());
        let truth = format!("--ground-truth={}/ground_truth", skin.namespace);
        let said = processes.iter().flat_map(|p| p["arguments"].as_array().unwrap()).any(|w| *w == truth);
        assert!(said, "nobody presses `{}`", skin.name);
    }
    assert_eq!(families.into_iter().collect::<Vec<_>>(), ["barodome", "ert", "hapdef", "insight"]);
}

#[test]
fn mistakes_are_named_before_anything_starts() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bad.launch.yaml");
    let skin = root().join("launch/skins/baro-grid.toml");
    let node = |rest: &str| {
        format!(
            "processes: [{{name: pad, node: barodome, config: {{skin: {}, source: 'serial:///dev/x'}}, {rest}}}]",
            skin.display()
        )
    };
    for (text, expected) in [
        (node("parameters: {contact_treshold: 3}"), "field `processes[0].parameters.contact_treshold`: "),
        (node("parameters: {contact_threshold: -3}"), "field `processes[0].parameters.contact_threshold`: "),
        (
            node("parameters: {contact_threshold: much}"),
            "field `processes[0].parameters.contact_threshold`: ",
        ),
        (node("flags: [--bakend, ros2]"), "field `processes[0].flags`: "),
        (
            "processes: [{name: pad, node: barodome, config: {skin: pad.toml, soruce: x}}]".to_owned(),
            "field `processes[0].config.soruce`: ",
        ),
        (
            "processes: [{name: pad, node: barodome, config: {skin: pad.toml, source: 'serial:///dev/x'}}]"
                .to_owned(),
            "field `processes[0].config.skin`: ",
        ),
        (
            format!(
                "processes: [{{name: pad, node: barodome, config: {{skin: {}, source: 'seral:///dev/x'}}}}]",
                skin.display()
            ),
            "field `processes[0].config.source`: ",
        ),
        ("processes: [{name: pad, node: barodrome}]".to_owned(), "field `processes[0].node`: "),
        ("processes: [{name: a, dermis: brigde}]".to_owned(), "field `processes[0].dermis`: "),
        (
            "processes: [{name: a, dermis: bridge}, {name: a, dermis: bridge}]".to_owned(),
            "field `processes[1].name`: `a` is the name of processes[0]",
        ),
    ] {
        std::fs::write(&file, &text).unwrap();
        let error = check(&file).expect_err(&text);
        let expected = format!("dermis: launch file {}: {expected}", file.display());
        assert!(error.starts_with(&expected), "{text}\n{error}");
        assert_eq!(error.lines().count(), 1, "{error}");
    }
}

/// What a ROS 2 launch file would run, by the real package `launch` where Python has it, otherwise by a stand-in of its
/// API: no package index that tests can reach has that package.
fn described(file: &str, arguments: &[&str]) -> Result<Vec<Vec<String>>, String> {
    let python = ros_python().or_else(client_python).unwrap_or_else(|| "python3".into());
    let out = Command::new(python)
        .arg(root().join("integration-tests/python/launch/describe.py"))
        .arg(root().join("launch").join(file))
        .args(arguments)
        .env_remove("DERMIS")
        .output()
        .unwrap();
    if !out.status.success() {
        return Err(String::from_utf8_lossy(&out.stderr).into_owned());
    }
    let text = String::from_utf8(out.stdout).unwrap();
    println!("evaluated by: {}", text.lines().next().unwrap());
    Ok(text.lines().skip(1).map(|line| serde_json::from_str(line).unwrap()).collect())
}

#[test]
fn launch_files_of_ros_make_commands_that_the_program_takes() {
    let skin = root().join("launch/skins/baro-grid.toml").display().to_string();
    let commands = described(
        "barodome.launch.py",
        &[
            &format!("skin:={skin}"),
            "source:=serial:///dev/surely-not-there",
            "model:=a b",
            "name:=palm",
            "ros_namespace:=/robot",
            "namespace:=left",
            "remap:=contacts:=/all",
        ],
    )
    .unwrap();
    let expected = format!(
        "dermis barodome --backend ros2 --skin {skin} --source serial:///dev/surely-not-there --model a --model b \
         --name palm --namespace /robot/left --remap contacts:=/all"
    );
    assert_eq!(commands.iter().map(|words| words.join(" ")).collect::<Vec<_>>(), [expected]);
    let limb = described("barodome.launch.py", &["sensor:=hapdef", "skin:=s", "source:=t"]).unwrap();
    assert_eq!(limb[0].join(" "), "dermis hapdef --backend ros2 --skin s --source t");
    let demo = root().join("launch/demo.launch.yaml").display().to_string();
    let through =
        described("dermis.launch.py", &[&format!("file:={demo}"), "arguments:=seed:=2 robot:=x"]).unwrap();
    assert_eq!(through, [["dermis", "launch", &demo, "seed:=2", "robot:=x"]]);

    // The program itself says whether it takes them: as commands of a launch file, which are checked.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("both.launch.yaml");
    let processes: Vec<Value> = [("node", &commands[0]), ("all", &through[0])]
        .into_iter()
        .map(|(name, words)| serde_json::json!({"name": name, "dermis": words[1..]}))
        .collect();
    std::fs::write(&file, serde_json::json!({ "processes": processes }).to_string()).unwrap();
    check(&file).unwrap();

    let error = described("barodome.launch.py", &["skin:=a.toml"]).unwrap_err();
    assert!(error.contains("give skin:=… and source:=…, or config:=…"), "{error}");
}
