//! The node with messages in memory.

mod efforts;
mod force_points;

use std::sync::mpsc::{Receiver, channel};

use dermis_node::memory::Memory;
use dermis_node::{Level, ParameterValue, State, Transition};

use super::*;
use crate::testing::{contact, report, write_robot};

const WAIT: Duration = Duration::from_secs(20);

/// A node that merges, and one that stands for skins, joints and readers.
struct Bench {
    _folder: tempfile::TempDir,
    fusion: FusionNode,
    other: Node,
    sequence: u64,
}

impl Bench {
    fn config() -> (tempfile::TempDir, Config) {
        let folder = tempfile::tempdir().unwrap();
        let config = Config::new(write_robot(folder.path()));
        (folder, config)
    }

    fn start(change: impl FnOnce(&mut Config)) -> Self {
        let (folder, mut config) = Self::config();
        change(&mut config);
        let backend = Memory::default();
        let other = Node::open(NodeOptions::new("other"), &backend).unwrap();
        let fusion = FusionNode::start(&config, &backend).unwrap();
        Self { _folder: folder, fusion, other, sequence: 0 }
    }

    fn listen<T: dermis_msgs::Message>(&self, topic: &str) -> (Subscription, Receiver<T>) {
        let (tx, rx) = channel();
        let subscription = self
            .other
            .subscribe::<T>(topic, Qos::sensor_data().with_depth(1000), move |message, _| {
                // A test that got what it wanted hangs up.
                let _ = tx.send(message);
            })
            .unwrap();
        (subscription, rx)
    }

    /// A frame of skin `a` with a contact of 3 N, acquired now; its stamp.
    fn press(&mut self, skin: &Publisher<ContactArray>) -> i64 {
        self.sequence += 1;
        let stamp = self.other.clock().now();
        skin.publish(&report("a", self.sequence, stamp, &[contact(1, 0.01, 0.02, 3.0)])).unwrap();
        stamp
    }
}

fn expect<T: std::fmt::Debug>(rx: &Receiver<T>, mut fits: impl FnMut(&T) -> bool) -> T {
    let deadline = Instant::now() + WAIT;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let message = rx.recv_timeout(left).expect("nothing that fits came in time");
        if fits(&message) {
            return message;
        }
    }
}

#[test]
fn a_press_is_on_every_topic() {
    let mut bench = Bench::start(|c| c.assume_rest = true);
    let (_b, body) = bench.listen::<BodyContacts>("/body_contacts");
    let (_l, link) = bench.listen::<WrenchStamped>("/links/chest/wrench");
    let (_n, net) = bench.listen::<WrenchStamped>("/net_wrench");
    let (_t, torques) = bench.listen::<JointState>("/joint_torques");
    let (_p, points) = bench.listen::<PointCloud2>("/contact_points");
    let (_m, markers) = bench.listen::<MarkerArray>("/contact_markers");
    let (_f, fixed) = bench.listen::<TFMessage>("/tf_static");
    // Nothing has come, and it says so.
    let silent = expect(&body, |_| true);
    assert!(silent.contacts.is_empty() && silent.status == ContactArray::STATUS_STALE);
    assert_eq!(silent.skins.iter().map(|s| s.skin.as_str()).collect::<Vec<_>>(), ["a", "b", "c"]);
    let again = expect(&body, |_| true);
    assert!(again.sequence > silent.sequence, "a heartbeat");

    // Sums and clouds have no status: while skins are silent, so are they.
    assert!(link.try_recv().is_err() && net.try_recv().is_err() && points.try_recv().is_err());

    let skin = bench.other.stream_publisher::<ContactArray>("/a/contacts", 10).unwrap();
    let others = ["b", "c"].map(|name| {
        (name, bench.other.stream_publisher::<ContactArray>(&format!("/{name}/contacts"), 10).unwrap())
    });
    for _ in 0..10 {
        let stamp = bench.press(&skin);
        for (name, other) in &others {
            other.publish(&report(name, bench.sequence, stamp, &[])).unwrap();
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let touched = expect(&body, |m| !m.contacts.is_empty());
    assert_eq!(touched.contacts[0].skins, ["a"]);
    assert_eq!(touched.contacts[0].link, "chest");
    let at = &touched.contacts[0].body_from_contact.position;
    assert!((at.x - 0.01).abs() < 1e-9 && (at.z - 0.3).abs() < 1e-9);
    let wrench = expect(&link, |m| m.wrench.force.z < -2.9);
    assert_eq!(wrench.header.frame_id, "chest");
    expect(&net, |m| m.header.frame_id == "base" && m.wrench.force.z < -2.9);
    assert_eq!(expect(&torques, |_| true).name, ["shoulder"]);
    assert_eq!(expect(&points, |m| m.width == 1).header.frame_id, "base");
    expect(&markers, |m| m.markers.first().is_some_and(|m| m.action == 0));
    assert_eq!(expect(&fixed, |_| true).transforms.len(), 3);
    // The skin falls silent: its contact ends, its arrow goes, and it is stale.
    expect(&markers, |m| m.markers.first().is_some_and(|m| m.action == 3));
    let ended = expect(&body, |m| m.contacts.is_empty());
    assert_eq!(ended.skins[0].status, ContactArray::STATUS_STALE);
    let (_, status) =
        bench.fusion.node().diagnostics().collect().into_iter().find(|(n, _)| n == "fusion").unwrap();
    assert_eq!(status.level, Level::Error);
    assert!(status.message.contains("skin `a`: nothing has come for"), "{}", status.message);
    assert!(status.values.iter().any(|(key, _)| key == "a: lost frames"));
}

#[test]
fn links_move_with_the_joints() {
    let bench = Bench::start(|c| c.transforms = Transforms::Robot);
    let (_m, moving) = bench.listen::<TFMessage>("/tf");
    let states = bench.other.stream_publisher::<JointState>("/joint_states", 10).unwrap();
    let state = |position: f64| JointState {
        header: dermis_msgs::std_msgs::msg::Header::new(bench.other.clock().now(), ""),
        name: vec!["shoulder".into()],
        position: vec![position],
        ..JointState::default()
    };
    states.publish(&state(std::f64::consts::PI)).unwrap();
    let message = expect(&moving, |_| true);
    assert_eq!(message.transforms.len(), 1);
    assert_eq!(message.transforms[0].child_frame_id, "arm");
    assert!((message.transforms[0].transform.rotation.z.abs() - 1.0).abs() < 1e-9);
    // A state that cannot be is named, and changes nothing.
    states.publish(&state(f64::NAN)).unwrap();
    let deadline = Instant::now() + WAIT;
    loop {
        let all = bench.fusion.node().diagnostics().collect();
        let named = |(key, text): &(String, String)| {
            key == "refused joint state" && text.starts_with("the joint state of \"shoulder\" is NaN")
        };
        if all.iter().any(|(_, status)| status.values.iter().any(named)) {
            break;
        }
        assert!(Instant::now() < deadline, "{all:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn it_follows_its_lifecycle_and_its_parameters() {
    let mut bench = Bench::start(|c| {
        c.autostart = false;
        c.rate = 50.0;
        c.parameters.insert("hold".into(), ParameterValue::Double(0.2));
    });
    let (_b, body) = bench.listen::<BodyContacts>("/body_contacts");
    let skin = bench.other.stream_publisher::<ContactArray>("/a/contacts", 10).unwrap();
    bench.press(&skin);
    assert!(body.recv_timeout(Duration::from_millis(300)).is_err(), "it is not active");
    let life = bench.fusion.node().lifecycle().unwrap();
    life.take(Transition::Configure).unwrap();
    life.take(Transition::Activate).unwrap();
    for _ in 0..4 {
        bench.press(&skin);
        std::thread::sleep(Duration::from_millis(10));
    }
    expect(&body, |m| m.contacts.len() == 1);
    assert_eq!(bench.fusion.shared.lock().fuser.settings().hold, 0.2);
    bench.fusion.node().parameters().set("births", 5_i64).unwrap();
    bench.fusion.node().parameters().set("hold", 0.1).unwrap();
    let settings = *bench.fusion.shared.lock().fuser.settings();
    assert_eq!((settings.births, settings.hold), (5, 0.1));
    assert!(bench.fusion.node().parameters().set("hold", -1.0).is_err());
    life.take(Transition::Deactivate).unwrap();
    assert_eq!(life.state(), State::Inactive);
    while body.try_recv().is_ok() {}
    std::thread::sleep(Duration::from_millis(100));
    while body.try_recv().is_ok() {}
    assert!(body.recv_timeout(Duration::from_millis(200)).is_err());
}

#[test]
fn reports_are_answered_at_the_most_rate_and_the_last_one_always() {
    let mut bench = Bench::start(|c| c.max_rate = 20.0);
    let (_b, body) = bench.listen::<BodyContacts>("/body_contacts");
    let skin = bench.other.stream_publisher::<ContactArray>("/a/contacts", 10).unwrap();
    let begun = Instant::now();
    for _ in 0..60 {
        bench.press(&skin);
        std::thread::sleep(Duration::from_millis(5));
    }
    let last = bench.press(&skin);
    let mut answers = 0;
    expect(&body, |m| {
        answers += 1;
        m.header.stamp.as_nanos() == last
    });
    let most = begun.elapsed().as_secs_f64() * 20.0 + 2.0;
    assert!(f64::from(answers) <= most, "{answers} answers, {most} at most");
    assert!(answers >= 3, "{answers}");
}

#[test]
fn what_cannot_be_is_refused_in_one_sentence() {
    let (folder, good) = Bench::config();
    let refused = |change: &dyn Fn(&mut Config)| {
        let mut config = good.clone();
        change(&mut config);
        let error = FusionNode::start(&config, &Memory::default()).err().unwrap().to_string();
        error.replace(&folder.path().display().to_string(), "DIR")
    };
    insta::assert_snapshot!(refused(&|c| c.rate = -1.0), @"`rate`: is -1 Hz and must be from 0 to 1000");
    insta::assert_snapshot!(refused(&|c| c.max_rate = 0.0), @"`max_rate`: is 0 Hz and must be from 10 to 10000");
    insta::assert_snapshot!(refused(&|c| c.settings.gate = 0.0), @"settings: `gate` is 0 and must be from 1 to 1000");
    insta::assert_snapshot!(refused(&|c| { c.parameters.insert("gait".into(), 1.0.into()); }), @"parameter `gait` is none of this node; its parameters are ahead, births, force_change, gain_deviation, gate, hold, max_rate, most_reports, mount_deviation, oldest, rate, reorder, robot, slide_speed, slide_time, systematic_share, unknown_force_deviation, unknown_position_deviation, use_sim_time");
    let missing = refused(&|c| c.robot = folder.path().join("none.toml"));
    assert!(missing.starts_with("robot file DIR/none.toml: cannot be read"), "{missing}");
    let bare = folder.path().join("bare.toml");
    std::fs::write(&bare, "schema = 'dermis-robot/1'\nname = 'r'\nurdf = 'r.urdf'").unwrap();
    insta::assert_snapshot!(refused(&|c| c.robot = bare.clone()), @"robot file DIR/bare.toml: it has no skins, so that there is nothing to merge; add `[[skins]]`");
}

#[test]
fn links_have_topics_whatever_they_are_called() {
    assert_eq!(topic_part("left-hand.1"), "left_hand_1");
    assert_eq!(topic_part("2nd"), "_2nd");
}
