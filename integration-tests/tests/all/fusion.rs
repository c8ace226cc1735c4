//! A simulated skin on a moving hand, its node, and the node that merges skins: what the body feels is where the device is pressed.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dermis_integration_tests::{Peer, backend, domain, isolate, program, root};
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::msg::{BodyContacts, ContactArray, Indentation};
use dermis_msgs::sensor_msgs::msg::JointState;
use dermis_msgs::std_msgs::msg::Header;
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_node::{Node, NodeOptions, Qos};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

/// Longest wait for anything, on a machine at full load.
const PATIENCE: Duration = Duration::from_secs(60);
/// \[m\] between where the device is pressed and where the body feels it, at the median: the bundle of the pad is good to 0.03 mm while a
/// press holds, the joint state that stands for 10 ms adds 0.4 mm, and a machine at full load delays joint states by more.
const TOLERANCE: f64 = 0.003;
/// Pressed again and again, with what a tare takes in between.
const PLAN: &str = "schema = 'dermis-plan/1'\nname = 'pressed'\nseed = 1\ndiameter = 0.004\nmargin = 0.006\n\
                    [timing]\napproach = [0.05, 0.1]\nload = [0.1, 0.1]\nhold = [0.5, 0.5]\nunload = [0.1, 0.1]\n\
                    gap = [1.0, 1.0]\n[[steps]]\nkind = 'idle'\nduration = 2.0\n\
                    [[steps]]\nkind = 'presses'\ncount = 200\nforce = [0.8, 1.2]\n";
const URDF: &str = r#"<robot name="one"><link name="base"/><link name="hand"/>
    <joint name="wrist" type="revolute"><parent link="base"/><child link="hand"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
      <limit lower="-3" upper="3" velocity="1" effort="1"/></joint></robot>"#;
const ROBOT: &str = "schema = 'dermis-robot/1'\nname = 'one'\nurdf = 'one.urdf'\n\
    [[skins]]\nname = 'palm'\nnamespace = '/one/palm'\ntimeout = 0.5\n\
    mount = { parent = 'hand', translation = [0.1, 0.0, 0.02], rpy = [0.0, 1.5707963267948966, 0.0] }\n\
    [[skins]]\nname = 'back'\nnamespace = '/one/back'\n\
    mount = { parent = 'hand', translation = [0.0, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }\n";

/// \[rad\] of the wrist at an instant.
fn angle(stamp: i64) -> f64 {
    let seconds = (stamp % 1_000_000_000_000) as f64 * 1e-9;
    0.8 * (0.5 * seconds).sin()
}

/// Where a point of the skin is in the body frame at an instant.
fn on_body(stamp: i64, point: Point3<f64>) -> Point3<f64> {
    let wrist = Isometry3::from_parts(
        Translation3::new(0.0, 0.0, 0.4),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle(stamp)),
    );
    let skin = Isometry3::from_parts(
        Translation3::new(0.1, 0.0, 0.02),
        UnitQuaternion::from_euler_angles(0.0, std::f64::consts::FRAC_PI_2, 0.0),
    );
    wrist * (skin * point)
}

fn launch_file(folder: &Path) -> std::path::PathBuf {
    std::fs::write(folder.join("one.urdf"), URDF).unwrap();
    std::fs::write(folder.join("one.toml"), ROBOT).unwrap();
    std::fs::write(folder.join("plan.toml"), PLAN).unwrap();
    let (launch, models) = (root().join("launch"), root().join("models"));
    let text = format!(
        "processes:
  - name: device
    dermis: device simulate {skin} --plan {plan} --link ${{tmp}}/palm --ground-truth ground_truth --namespace one --instance palm --frame-id palm_skin
    ready: {{file: '${{tmp}}/palm'}}
  - name: skin
    namespace: one/palm
    node: barodome
    config: {{skin: {skin}, models: [{model}], source: 'serial://${{tmp}}/palm', instance: palm, frame_id: palm_skin}}
    after: [device]
  - name: fusion
    dermis: fusion --robot {robot} --namespace /one
",
        skin = launch.join("skins/baro-grid.toml").display(),
        plan = folder.join("plan.toml").display(),
        model = models.join("baro-grid").display(),
        robot = folder.join("one.toml").display(),
    );
    let file = folder.join("one.launch.yaml");
    std::fs::write(&file, text).unwrap();
    file
}

/// What was heard of one type.
type Heard<T> = Arc<Mutex<Vec<T>>>;

fn listen<T: dermis_msgs::Message>(
    node: &Node,
    topic: &str,
    qos: Qos,
) -> (dermis_node::Subscription, Heard<T>) {
    let heard: Heard<T> = Arc::default();
    let sink = Arc::clone(&heard);
    let subscription = node.subscribe::<T>(topic, qos, move |m, _| sink.lock().unwrap().push(m)).unwrap();
    (subscription, heard)
}

/// Distances \[m\] between contacts of the body and the truth of the frame that they rest on, while the device holds still.
fn distances(body: &[BodyContacts], truth: &[Indentation]) -> Vec<f64> {
    let mut all = Vec::new();
    for message in body {
        let [touch] = message.contacts.as_slice() else { continue };
        let seen = touch.stamp.as_nanos();
        let near = truth.iter().min_by_key(|t| (t.header.stamp.as_nanos() - seen).abs());
        let Some(truth) = near.filter(|t| (t.header.stamp.as_nanos() - seen).abs() < 15_000_000) else {
            continue;
        };
        let ([pressed], Indentation::PHASE_HOLD) = (truth.contacts.as_slice(), truth.phase) else { continue };
        let (p, b) = (&pressed.position, &touch.body_from_contact.position);
        let expected = on_body(message.header.stamp.as_nanos(), Point3::new(p.x, p.y, p.z));
        all.push((Point3::new(b.x, b.y, b.z) - expected).norm());
    }
    all
}

#[test]
fn a_press_on_a_moving_hand_is_felt_where_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let file = launch_file(folder.path());
    let options = NodeOptions::new("fusion_test").domain_id(domain()).localhost_only(true);
    let node = Node::open(options, &backend()).unwrap();
    let sensor = Qos::sensor_data().with_depth(1000);
    let (_truth, truth) = listen::<Indentation>(&node, "/one/ground_truth", sensor);
    let (_body, body) = listen::<BodyContacts>(&node, "/one/body_contacts", sensor);
    let (_fixed, fixed) = listen::<TFMessage>(&node, "/tf_static", Qos::latched().with_depth(10));
    let states = node.stream_publisher::<JointState>("/joint_states", 10).unwrap();
    let clock = node.clock().clone();
    let _wrist = node.timer(Duration::from_millis(10), move || {
        let stamp = clock.now();
        let message = JointState {
            header: Header { stamp: Time::from_nanos(stamp), frame_id: String::new() },
            name: vec!["wrist".into()],
            position: vec![angle(stamp)],
            ..JointState::default()
        };
        // The test ends while the timer runs.
        let _ = states.publish(&message);
    });
    let mut command = Command::new(program("dermis"));
    isolate(command.current_dir(root()));
    let launch = Peer::start(command.arg("launch").arg(&file));

    let deadline = Instant::now() + PATIENCE;
    let mut found = loop {
        let found = distances(&body.lock().unwrap(), &truth.lock().unwrap());
        // Several presses, which are at several places.
        if found.len() >= 100 {
            break found;
        }
        assert!(Instant::now() < deadline, "{} frames of a press within {PATIENCE:?}", found.len());
        std::thread::sleep(Duration::from_millis(100));
    };
    found.sort_by(f64::total_cmp);
    let median = found[found.len() / 2];
    assert!(median < TOLERANCE, "{median} m");

    let body = body.lock().unwrap().clone();
    let touched = body.iter().rev().find(|m| !m.contacts.is_empty()).unwrap();
    assert_eq!(touched.contacts[0].skins, ["palm"]);
    assert!(touched.joints == ["wrist"] && touched.joint_torques.len() == 1);
    // A skin that never came is named in each message.
    for message in &body {
        let back = message.skins.iter().find(|s| s.skin == "back").unwrap();
        assert_eq!((back.status, back.stamp.as_nanos()), (ContactArray::STATUS_STALE, 0));
        assert_ne!(message.status, ContactArray::STATUS_OK);
    }
    let frames = fixed.lock().unwrap();
    let palm = frames.iter().flat_map(|m| &m.transforms).find(|t| t.child_frame_id == "palm_skin").unwrap();
    assert_eq!(palm.header.frame_id, "hand");
    drop(launch);
}
