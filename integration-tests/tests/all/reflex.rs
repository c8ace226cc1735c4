//! From a press on a device to a stop message, across processes: device, node of the skin, node of the reflexes, and a robot that
//! listens. Then the node of the skin is killed, and the robot is stopped again.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::process::Command;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use dermis_body::{HistoryLimits, Robot};
use dermis_fusion::{Fuser, Settings, messages};
use dermis_integration_tests::{Peer, finish, isolate, open_node, program, refused, root};
use dermis_msgs::Message;
use dermis_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use dermis_msgs::geometry_msgs::msg::{Point, Twist, Vector3};
use dermis_msgs::msg::{Contact, ContactArray};
use dermis_msgs::std_msgs::msg::Bool;
use dermis_msgs::std_msgs::msg::Header;
use dermis_msgs::std_srvs::srv::{Trigger, TriggerRequest};
use dermis_node::{Node, Qos, Subscription};
use dermis_reflex::{Reflex, Rules};

/// Longest wait for anything, on a machine at full load.
const PATIENCE: Duration = Duration::from_secs(60);
/// Pressed again and again, with what a tare takes in between: whenever the node begins, it finds its zero.
const PRESSED: &str = "schema = 'dermis-plan/1'\nname = 'pressed'\nseed = 1\ndiameter = 0.004\nmargin = 0.004\n\
                       [timing]\napproach = [0.05, 0.1]\nload = [0.1, 0.1]\nhold = [0.3, 0.3]\nunload = [0.1, 0.1]\n\
                       gap = [1.0, 1.0]\n[[steps]]\nkind = 'idle'\nduration = 2.0\n\
                       [[steps]]\nkind = 'presses'\ncount = 300\nforce = [0.8, 1.2]\n";
const RULES: &str = "schema = 'dermis-reflex/1'\nname = 'guard'\nstart = 'clear'\n\
                     [inputs.palm]\nkind = 'skin'\ntopic = 'contacts'\ntimeout = 2.0\n\
                     [actions.stop]\nkind = 'bool'\ntopic = 'stop'\nheartbeat = 0.1\n\
                     [actions.halt]\nkind = 'twist'\ntopic = 'cmd_vel'\n\
                     [[rules]]\nname = 'touch'\nforce = { above = 0.4 }\nquiet = 0.05\nactions = ['stop', 'halt']\n";
const SKIN: &str = "launch/skins/baro-grid.toml";

fn dermis() -> Command {
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()));
    command
}

fn listen<T: Message>(node: &Node, topic: &str) -> (Subscription, Receiver<T>) {
    dermis_integration_tests::listen(node, topic, Qos::reliable(100))
}

fn expect<T>(messages: &Receiver<T>, what: &str, fits: impl Fn(&T) -> bool) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let message = messages.recv_timeout(left).unwrap_or_else(|e| panic!("{what}: {e}"));
        if fits(&message) {
            return message;
        }
    }
}

/// The status of the reflexes that has this text in its sentence.
fn status(messages: &Receiver<DiagnosticArray>, text: &str) -> DiagnosticStatus {
    let of = |array: &DiagnosticArray| {
        array.status.iter().find(|s| s.name == "guard: reflex" && s.message.contains(text)).cloned()
    };
    of(&expect(messages, text, |array| of(array).is_some())).unwrap()
}

#[test]
fn a_press_stops_the_robot_and_so_does_a_node_that_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    let [plan, rules, link] = ["plan.toml", "rules.toml", "device"].map(|name| folder.path().join(name));
    std::fs::write(&plan, PRESSED).unwrap();
    std::fs::write(&rules, RULES).unwrap();
    let robot = open_node("robot");
    let (_stop, stop) = listen::<Bool>(&robot, "/stop");
    let (_twist, twist) = listen::<Twist>(&robot, "/cmd_vel");
    let (_diagnostics, diagnostics) = listen::<DiagnosticArray>(&robot, "/diagnostics");

    // Nothing has come from the skin yet: that is no freedom to move.
    let reflex = Peer::start(dermis().arg("reflex").arg(&rules));
    expect(&stop, "it stops before the skin is there", |stop| stop.data);
    status(&diagnostics, "nothing has come from input `palm`");

    let mut simulate = dermis();
    simulate.args(["device", "simulate", SKIN, "--plan"]).arg(&plan).arg("--link").arg(&link);
    let mut device = Peer::start(&mut simulate);
    device.expect("", PATIENCE);
    let source = format!("serial://{}", link.display());
    let mut skin = Peer::start(dermis().args([
        "barodome",
        "--skin",
        SKIN,
        "--model",
        "models/baro-grid",
        "--source",
        &source,
    ]));

    // It is detected, and latches.
    status(&diagnostics, "rule `touch` acts until it is released: a force of ");
    while stop.try_recv().is_ok() {}
    expect(&stop, "the stop is repeated", |stop| stop.data);
    expect(&twist, "a twist of zeros", |twist| *twist == Twist::default());

    // Between two presses it can be released, and the next one stops again.
    let release = robot.client::<Trigger>("/guard/release").unwrap();
    let released = || {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let answer = release.call_blocking(&TriggerRequest::default(), PATIENCE).unwrap();
            if answer.success {
                return;
            }
            assert!(Instant::now() < deadline, "{}", answer.message);
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    released();
    expect(&stop, "it may move", |stop| !stop.data);
    expect(&stop, "the next press", |stop| stop.data);

    released();
    skin.kill();
    expect(&stop, "it may move", |stop| !stop.data);
    expect(&stop, "the skin is gone", |stop| stop.data);
    status(&diagnostics, "input `palm` has brought nothing new for ");
    let answer = release.call_blocking(&TriggerRequest::default(), PATIENCE).unwrap();
    assert!(!answer.success && answer.message.contains("is not released"), "{}", answer.message);
    drop(reflex);
}

#[test]
fn the_end_of_the_reflexes_is_a_stop() {
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("rules.toml");
    // Nothing is required of the input, so that nothing acts until the end.
    let idle = RULES.replace("quiet = 0.05", "quiet = 0.05\ncounts_as_touched = []");
    std::fs::write(&rules, idle).unwrap();
    let robot = open_node("robot");
    let (_stop, stop) = listen::<Bool>(&robot, "/stop");
    let mut reflex = Peer::start(dermis().arg("reflex").arg(&rules));
    expect(&stop, "a heartbeat", |stop| !stop.data);
    reflex.interrupt();
    expect(&stop, "its last word", |stop| stop.data);
    assert!(reflex.end(PATIENCE).success());
}

#[test]
fn a_rule_file_is_checked_before_it_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("rules.toml");
    std::fs::write(&rules, RULES).unwrap();
    let said = finish(dermis().args(["reflex", "--check"]).arg(&rules));
    assert!(said.contains("1 rule on 1 input, with 2 actions"), "{said}");
    std::fs::write(&rules, RULES.replace("above = 0.4", "abov = 0.4")).unwrap();
    let said = refused(dermis().args(["reflex", "--check"]).arg(&rules));
    assert!(said.contains("line 17: field `rules[0].force.abov`"), "{said}");
    // What ships has placeholders, and says so.
    let said = refused(dermis().args(["reflex", "--check", "launch/reflex/humanoid.reflex.toml"]));
    assert!(said.contains("field `placeholders`") && said.contains("risk assessment"), "{said}");
}

/// One skin on one link.
fn one_skin() -> Robot {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("r.urdf"), "<robot name='r'><link name='hand'/></robot>").unwrap();
    let text = "schema = 'dermis-robot/1'\nname = 'r'\nurdf = 'r.urdf'\n[[skins]]\nname = 'palm'\n\
                mount = { parent = 'hand', translation = [0.0, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }";
    Robot::from_toml(text, &folder.path().join("r.toml")).unwrap()
}

/// A contact that rests for half a second and slides from there: the fusion tells it from the positions, and a rule on slip acts.
#[test]
fn a_slide_acts_by_a_rule_on_slip() {
    let rules = "schema = 'dermis-reflex/1'\nname = 'grip'\nstart = 'clear'\n\
                 [inputs.body]\nkind = 'body'\ntopic = 'body_contacts'\ntimeout = 1.0\n\
                 [actions.grip]\nkind = 'bool'\ntopic = 'grip'\n\
                 [[rules]]\nname = 'slip'\nslip = 'gross'\ncounts_as_touched = ['late']\nactions = ['grip']\n";
    let mut reflex = Reflex::new(Rules::from_toml(rules, "grip.toml").unwrap(), Duration::ZERO);
    let robot = one_skin();
    let limits = HistoryLimits::default();
    let mut fuser = Fuser::new(robot.clone(), Settings::default(), limits, &[], &[]).unwrap();
    let mut acted = None;
    for k in 0..200_u64 {
        let stamp = 1_700_000_000_000_000_000 + k as i64 * 10_000_000;
        // A tenth of a millimetre to and fro, so that there is a noise to measure; from frame 50 on 20 mm/s.
        let x = [1e-4, -1e-4, 0.0][k as usize % 3] + 2e-4 * k.saturating_sub(50) as f64;
        let diagonal = |v: f64| std::array::from_fn(|i| if i % 4 == 0 { v } else { 0.0 });
        let contact = Contact {
            track_id: 1,
            position: Point { x, y: 0.0, z: 0.0 },
            normal: Vector3 { x: 0.0, y: 0.0, z: 1.0 },
            force: Vector3 { x: 1.0, y: 0.0, z: -3.0 },
            force_components: Contact::FORCE_FULL,
            position_covariance: diagonal(1e-8),
            force_covariance: diagonal(1e-4),
            confidence: 1.0,
            ..Contact::default()
        };
        let report = ContactArray {
            header: Header::new(stamp, "palm_skin"),
            skin: "palm".into(),
            sequence: k + 1,
            contacts: vec![contact],
            ..ContactArray::default()
        };
        fuser.take(0, &report, None, stamp);
        let body = messages::body_contacts(&robot, &fuser.state(stamp), k + 1);
        let done = reflex.body(0, &body, Duration::from_millis(10 * k), 0);
        if acted.is_none()
            && let Some(event) = done.events.first()
        {
            acted = Some((k, event.to_string()));
        }
    }
    let (frame, text) = acted.expect("it acts");
    assert!((51..65).contains(&frame), "at frame {frame}: {text}");
    assert_eq!(text, "rule `slip` acts: a contact on link `hand` slips");
}
