//! The node over a backend that carries messages within the process.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, channel};
use std::time::Instant;

use dermis_msgs::action_msgs::srv::{CancelGoal, CancelGoalResponse};
use dermis_msgs::geometry_msgs::msg::{TwistStamped, Vector3};
use dermis_msgs::msg::Contact;
use dermis_msgs::std_msgs::msg::{Bool, Float64, Header};
use dermis_msgs::std_srvs::srv::TriggerRequest;
use dermis_node::memory::Memory;
use dermis_node::{Level, NodeOptions, Publisher, Transition};

use super::*;

const WAIT: Duration = Duration::from_secs(20);

const RULES: &str = r#"
schema = "dermis-reflex/1"
name = "test-reflex"
start = "clear"
[inputs.palm]
kind = "skin"
topic = "contacts"
timeout = 0.5
[actions.stop]
kind = "bool"
topic = "stop"
heartbeat = 0.05
[actions.slow]
kind = "speed_scale"
topic = "scale"
scale = 0.25
[actions.twist]
kind = "twist"
topic = "cmd_vel"
stamped = "base"
[actions.power]
kind = "trigger"
service = "power_off"
[actions.goals]
kind = "cancel"
action = "follow"
repeat = 0.05
[[rules]]
name = "touch"
force = { above = 5.0 }
quiet = 0.05
actions = ["stop", "slow", "twist", "power", "goals"]
"#;

struct Bench {
    _folder: tempfile::TempDir,
    rules: PathBuf,
    backend: Memory,
}

impl Bench {
    fn new(rules: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rules.toml");
        std::fs::write(&path, rules).unwrap();
        Self { _folder: folder, rules: path, backend: Memory::default() }
    }

    fn start(&self) -> ReflexNode {
        ReflexNode::start(&Config::new(&self.rules), &self.backend).unwrap()
    }

    fn observer(&self) -> Node {
        Node::open(NodeOptions::new("observer"), &self.backend).unwrap()
    }
}

fn listen_to<T: Message>(node: &Node, topic: &str) -> (Subscription, Receiver<T>) {
    let (tx, rx) = channel();
    let subscription = node
        .subscribe::<T>(topic, Qos::reliable(50), move |message, _| {
            // A test that got what it wanted hangs up.
            let _ = tx.send(message);
        })
        .unwrap();
    (subscription, rx)
}

fn expect<T: std::fmt::Debug>(rx: &Receiver<T>, what: &str, fits: impl Fn(&T) -> bool) -> T {
    let deadline = Instant::now() + WAIT;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        match rx.recv_timeout(left) {
            Ok(message) if fits(&message) => return message,
            Ok(_) => {}
            Err(_) => panic!("waited {WAIT:?} in vain: {what}"),
        }
    }
}

/// A skin that publishes by itself, until it is dropped.
struct Skin {
    force: Arc<std::sync::Mutex<f64>>,
    _timer: dermis_node::Timer,
}

impl Skin {
    fn start(node: &Node) -> Self {
        let publisher: Publisher<ContactArray> = node.publisher("contacts", Qos::sensor_data()).unwrap();
        let force = Arc::new(std::sync::Mutex::new(0.0));
        let (pressed, clock, mut sequence) = (Arc::clone(&force), node.clock().clone(), 0);
        let timer = node.timer(Duration::from_millis(5), move || {
            sequence += 1;
            let force = *pressed.lock().unwrap();
            let contact = Contact {
                track_id: 1,
                force: Vector3 { x: 0.0, y: 0.0, z: -force },
                force_components: Contact::FORCE_NORMAL,
                ..Contact::default()
            };
            let message = ContactArray {
                header: Header::new(clock.now(), "palm"),
                skin: "palm".into(),
                sequence,
                contacts: if force > 0.0 { vec![contact] } else { vec![] },
                ..ContactArray::default()
            };
            publisher.publish(&message).unwrap();
        });
        Self { force, _timer: timer }
    }

    fn press(&self, force: f64) {
        *self.force.lock().unwrap() = force;
    }
}

#[test]
fn a_touch_does_all_that_the_rule_says_until_it_is_released() {
    let bench = Bench::new(RULES);
    let observer = bench.observer();
    let (_stop, stop) = listen_to::<Bool>(&observer, "stop");
    let (_scale, scale) = listen_to::<Float64>(&observer, "scale");
    let (_twist, twist) = listen_to::<TwistStamped>(&observer, "cmd_vel");
    let (powered, power) = channel();
    let mut refusals = 1;
    let _power = observer
        .serve::<Trigger>("power_off", move |_| {
            let _ = powered.send(());
            refusals -= 1;
            TriggerResponse { success: refusals < 0, message: "not yet".into() }
        })
        .unwrap();
    let (cancelled, goals) = channel();
    let _goals = observer
        .serve::<CancelGoal>("follow/_action/cancel_goal", move |request| {
            let _ = cancelled.send(request.goal_info);
            CancelGoalResponse::default()
        })
        .unwrap();
    let skin = Skin::start(&observer);
    let reflex = bench.start();
    // Nothing has come at first, and no loss latches before all was there.
    expect(&stop, "it is clear once the skin is heard", |stop| !stop.data);

    skin.press(6.0);
    expect(&stop, "stop", |stop| stop.data);
    expect(&scale, "slow", |scale| scale.data == 0.25);
    let zero = expect(&twist, "zero twist", |_| true);
    assert_eq!((zero.header.frame_id.as_str(), zero.twist.linear.x), ("base", 0.0));
    assert!(zero.header.stamp.as_nanos() > 0);
    for call in ["the first is refused", "the second obeyed"] {
        power.recv_timeout(WAIT).unwrap_or_else(|_| panic!("{call}"));
    }
    for _ in 0..3 {
        let goal = goals.recv_timeout(WAIT).unwrap();
        assert_eq!((goal.goal_id.uuid, goal.stamp.as_nanos()), ([0; 16], 0), "all goals");
    }
    let status = reflex.diagnosis();
    assert_eq!(status.level, Level::Warn);
    assert!(status.message.contains("acts until it is released: a force of 6 N"), "{}", status.message);

    let release = observer.client::<Trigger>("/test_reflex/release").unwrap();
    let answer = release.call_blocking(&TriggerRequest::default(), WAIT).unwrap();
    assert!(
        !answer.success && answer.message.contains("a force of 6 N on skin `palm`"),
        "{}",
        answer.message
    );
    skin.press(0.0);
    let deadline = Instant::now() + WAIT;
    loop {
        let answer = release.call_blocking(&TriggerRequest::default(), WAIT).unwrap();
        if answer.success {
            assert_eq!(answer.message, "1 rule is released");
            break;
        }
        assert!(Instant::now() < deadline, "{}", answer.message);
    }
    expect(&stop, "it is released", |stop| !stop.data);
    expect(&scale, "full speed", |scale| scale.data == 1.0);
    assert!(power.try_recv().is_err(), "what was obeyed is not called again");
    assert_eq!(reflex.diagnosis().level, Level::Ok, "{:?}", reflex.diagnosis());
    reflex.stop();
    expect(&stop, "its end is a stop", |stop| stop.data);
}

#[test]
fn a_skin_that_falls_silent_stops() {
    let bench = Bench::new(RULES);
    let observer = bench.observer();
    let (_stop, stop) = listen_to::<Bool>(&observer, "stop");
    let skin = Skin::start(&observer);
    let reflex = bench.start();
    expect(&stop, "it is clear once the skin is heard", |stop| !stop.data);
    drop(skin);
    expect(&stop, "stop", |stop| stop.data);
    let status = reflex.diagnosis();
    assert_eq!(status.level, Level::Error);
    assert!(status.message.contains("input `palm` has brought nothing new"), "{}", status.message);
}

#[test]
fn a_node_that_is_not_active_says_so_and_goes_on_where_it_was() {
    let bench = Bench::new(RULES);
    let observer = bench.observer();
    let (_stop, stop) = listen_to::<Bool>(&observer, "stop");
    let skin = Skin::start(&observer);
    let reflex = bench.start();
    expect(&stop, "it is clear once the skin is heard", |stop| !stop.data);
    skin.press(6.0);
    expect(&stop, "stop", |stop| stop.data);
    skin.press(0.0);
    let life = reflex.node().lifecycle().unwrap();
    life.take(Transition::Deactivate).unwrap();
    assert!(reflex.diagnosis().message.contains("guards nothing"));
    let release = observer.client::<Trigger>("/test_reflex/release").unwrap();
    let answer = release.call_blocking(&TriggerRequest::default(), WAIT).unwrap();
    assert!(!answer.success && answer.message.contains("not active"), "{}", answer.message);
    life.take(Transition::Activate).unwrap();
    assert!(
        reflex.diagnosis().message.contains("acts until it is released"),
        "a transition releases nothing"
    );
    let deadline = Instant::now() + WAIT;
    while !release.call_blocking(&TriggerRequest::default(), WAIT).unwrap().success {
        assert!(Instant::now() < deadline, "{:?}", reflex.diagnosis());
    }
    // A node that goes on takes back what it said when it stopped.
    life.take(Transition::Deactivate).unwrap();
    while stop.try_recv().is_ok() {}
    life.take(Transition::Activate).unwrap();
    expect(&stop, "it may move", |stop| !stop.data);
}

#[test]
fn rules_that_cannot_be_used_are_refused_before_ros_is_used() {
    let bench = Bench::new("schema = 'dermis-reflex/1'\nname = 'x'\n");
    let refused = ReflexNode::start(&Config::new(&bench.rules), &bench.backend).err().unwrap().to_string();
    assert!(refused.starts_with("rule file ") && refused.contains("missing field"), "{refused}");
    let refused = crate::check(&Config::new("nowhere.toml")).unwrap_err().to_string();
    assert!(refused.contains("nowhere.toml: cannot be read"), "{refused}");
    let bench = Bench::new(RULES);
    let said = crate::check(&Config::new(&bench.rules)).unwrap();
    assert!(said.ends_with("rules.toml: 1 rule on 1 input, with 5 actions"), "{said}");
}
