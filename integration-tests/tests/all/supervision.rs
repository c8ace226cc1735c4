//! What keeps a robot's skins running, across processes: a node that is killed comes back, a launch that is killed leaves
//! nothing, logs have an end, and a node ends without a warning.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use dermis_integration_tests::launch::{Launch, PATIENCE, children, kill, runs, until};
use dermis_integration_tests::{Peer, listen, open_node, program, root};
use dermis_msgs::msg::ContactArray;
use dermis_node::Qos;

fn now_ns() -> i64 {
    i64::try_from(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos()).unwrap()
}

#[test]
fn contacts_come_back_after_a_kill() {
    let node = open_node("watch");
    let (_subscription, contacts) = listen::<ContactArray>(&node, "contacts", Qos::sensor_data());
    let mut launch = Launch::start(&format!(
        "
processes:
  - name: device
    dermis: device simulate {root}/launch/skins/baro-grid.toml --link ${{tmp}}/device
    ready: {{file: '${{tmp}}/device'}}
  - name: skin
    node: barodome
    config: {{skin: {root}/launch/skins/baro-grid.toml, source: 'serial://${{tmp}}/device', models: [{root}/models/baro-grid]}}
    after: [device]
    restart: on-failure
",
        root = root().display()
    ));
    let mut skin = launch.started("skin");
    // Twice: the first restart is not waited for, and a second one soon after it for half a second. The bound is for a
    // machine at full load; how long it really takes, `cargo xtask measure restart` measures.
    let bound = 15;
    for kills in [1, 2] {
        let since = now_ns();
        let next = |what: &str, within: Duration, after: i64| {
            let deadline = Instant::now() + within;
            loop {
                let left = deadline.saturating_duration_since(Instant::now());
                let array: ContactArray =
                    contacts.recv_timeout(left).unwrap_or_else(|_| panic!("no contacts {what}"));
                if array.header.stamp.as_nanos() > after && array.status == ContactArray::STATUS_OK {
                    return;
                }
            }
        };
        next("before the kill", PATIENCE, since);
        kill(skin, "-KILL");
        until("it is gone", || !runs(skin));
        // Stamps are from the acquisition: those after its end are of the next process.
        next(&format!("within {bound} s after kill {kills}"), Duration::from_secs(bound), now_ns());
        let message = launch.wait_for("skin was ended by signal 9 (SIGKILL) after");
        let when = ["at once", "in 0.50 s"][kills - 1];
        assert!(
            message.contains(&format!("; starting it again {when} (restart {kills} of at most 10)")),
            "{message}"
        );
        skin = launch.started("skin");
        // It is pressed now and then, and could wait long for a new zero.
        launch.wait("skin", "goes on with its zero of ");
    }
}

/// A launch of one process that ignores what can be ignored, and a child of that.
fn stubborn() -> (Launch, i32, i32, i32) {
    let mut launch = Launch::start(
        "
processes:
  - name: parent
    program: [sh, -c, 'trap \"\" HUP INT TERM; sleep 1000 & echo child $!; while :; do sleep 0.1; done']
",
    );
    let parent = launch.started("parent");
    let record = launch.wait("parent", "child ");
    let child: i32 = record["message"].as_str().unwrap().rsplit(' ').next().unwrap().parse().unwrap();
    let guard = guard_of(&launch).unwrap();
    assert!([parent, child, guard].into_iter().all(runs));
    (launch, parent, child, guard)
}

fn guard_of(launch: &Launch) -> Option<i32> {
    guard_and_folder(launch).map(|(id, _)| id)
}

/// The guard of a launch, and the folder of the launch, which it is told.
fn guard_and_folder(launch: &Launch) -> Option<(i32, PathBuf)> {
    let of = i32::try_from(launch.peer.id()).unwrap();
    let found = |(id, line): (i32, String)| Some((id, line.split_once(" launch-guard ")?.1.into()));
    children(of).into_iter().find_map(found)
}

#[test]
fn a_killed_guard_is_replaced_and_a_killed_launch_still_leaves_nothing() {
    let (mut launch, parent, child, guard) = stubborn();
    kill(guard, "-KILL");
    let message =
        launch.wait_for("the guard of the launch was ended by signal 9 (SIGKILL): started another one");
    let second: i32 = message.rsplit(' ').next().unwrap().parse().unwrap();
    // Until it has executed the program, its command line is that of its parent.
    until("the second guard runs", || guard_of(&launch) == Some(second));
    let (_, folder) = guard_and_folder(&launch).unwrap();
    assert!(folder.is_dir(), "{}", folder.display());
    launch.peer.kill();
    for (what, id) in [("the process", parent), ("its child", child), ("the guard", second)] {
        until(&format!("{what} is gone"), || !runs(id));
    }
    assert!(!folder.exists(), "{} is left", folder.display());
}

#[test]
fn launch_and_guard_killed_at_one_moment_leave_no_process_of_the_launch() {
    for guard_first in [true, false] {
        let (mut launch, parent, child, guard) = stubborn();
        let of = i32::try_from(launch.peer.id()).unwrap();
        // One command, so that next to nothing lies between the two signals.
        let both = if guard_first { [guard, of] } else { [of, guard] }.map(|id| id.to_string());
        assert!(Command::new("kill").arg("-KILL").args(&both).status().unwrap().success());
        launch.peer.kill();
        until("the process is gone", || !runs(parent));
        until("the guard is gone", || !runs(guard));
        // What it started in turn is out of the kernel's reach here; the guard may have been quicker than its end.
        let _ = Command::new("kill").args(["-KILL", &child.to_string()]).status();
    }
}

#[test]
fn a_flood_is_cut_and_its_files_are_rotated() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flood.launch.yaml");
    std::fs::write(
        &file,
        "
log_limits: {rate: 1, size: 0.02, keep: 2}
processes:
  - name: flood
    program: [sh, -c, 'for i in $(seq 20000); do echo \"ERROR frame $i is bad\"; done']
",
    )
    .unwrap();
    let logs = folder.path().join("logs");
    let run = |more: &[&str]| {
        let mut command = Command::new(program("dermis"));
        command.arg("launch").arg(&file).arg("--log-dir").arg(&logs).args(more);
        dermis_integration_tests::finish(&mut command)
    };
    let count = |text: &str| text.lines().filter(|line| line.ends_with(" is bad")).count();
    let text = run(&[]);
    let shown = count(&text);
    assert!((10..200).contains(&shown), "{shown} of 20000 lines at one a second");
    let left_out: usize = text
        .lines()
        .filter_map(|line| {
            line.split_once(" lines left out here: more than 1 a second")?
                .0
                .rsplit(' ')
                .next()?
                .parse::<usize>()
                .ok()
        })
        .sum();
    assert_eq!(shown + left_out, 20_000, "{text}");

    // All of them: some 700 kB, of which the latest 60 kB are kept.
    let all = run(&["--log-rate", "0"]);
    let unwritten: usize = all
        .lines()
        .filter_map(|line| {
            line.split_once(" lines left out here: they came faster")?
                .0
                .rsplit(' ')
                .next()?
                .parse::<usize>()
                .ok()
        })
        .sum();
    assert_eq!(count(&all) + unwritten, 20_000);
    let mut names: Vec<String> = std::fs::read_dir(&logs)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.starts_with("flood"))
        .collect();
    names.sort();
    assert_eq!(names, ["flood.log", "flood.log.1", "flood.log.2"]);
    for name in names {
        let length = std::fs::metadata(logs.join(&name)).unwrap().len();
        assert!(length <= 20_000, "{name} has {length} bytes");
    }

    let refused = dermis_integration_tests::refused(
        Command::new(program("dermis")).arg("launch").arg(&file).arg("--log-size=-3"),
    );
    assert!(refused.contains("option --log-size: -3 is no size"), "{refused}");
}

/// Starts a node without a device, with its log in this file.
fn node(log: &Path) -> Peer {
    Peer::start(
        Command::new(program("dermis"))
            .args(["barodome", "--source", "serial:///dev/surely-not-there", "--skin"])
            .arg(root().join("launch/skins/baro-grid.toml"))
            .stderr(File::create(log).unwrap()),
    )
}

#[test]
fn a_node_ends_without_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    // A race: it is looked for more than once.
    for _ in 0..4 {
        let mut peer = node(&log);
        let said = || std::fs::read_to_string(&log).unwrap();
        until("it runs", || said().contains("no such device"));
        peer.interrupt();
        assert!(peer.end(PATIENCE).success(), "{}", said());
        let warned: Vec<String> = said()
            .lines()
            .filter(|line| line.contains("WARN") && !line.contains("no such device"))
            .map(str::to_owned)
            .collect();
        assert!(
            !warned.iter().any(|line| line.contains("shutdown") || line.contains("transition")),
            "{warned:?}"
        );
    }
}
