//! A robot that is not there: its joints swing, and what really touches its skins is said in the body frame.
//!
//! The devices of its skins press themselves ([`device`](crate::device)) and say what is true in the frame of their skin. This moves the links
//! that carry them, and takes each truth to the body by the joint positions at its own instant, which are known here without interpolation.

use std::f64::consts::TAU;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Args;
use dermis_body::{Body, Joint, Robot};
use dermis_msgs::geometry_msgs::msg::{Pose, Vector3 as VectorMsg};
use dermis_msgs::msg::Indentation;
use dermis_msgs::sensor_msgs::msg::JointState;
use dermis_msgs::std_msgs::msg::Header;
use dermis_node::{Backend, Node, NodeOptions, Qos};
use dermis_perception::cli::NetworkArguments;
use dermis_skin::convert;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use tokio::time::MissedTickBehavior;

use crate::OperateError;

/// A robot whose joints swing.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Simulation {
    /// Robot file, as the fusion reads it.
    pub robot: PathBuf,
    /// ROS namespace of `body_truth`.
    #[arg(long, default_value = "")]
    pub namespace: String,
    /// \[Hz\] of joint states.
    #[arg(long, default_value_t = Simulation::default().rate)]
    pub rate: f64,
    /// Share of its range that each joint swings through, 0 to 1; 0 stands still.
    #[arg(long, default_value_t = Simulation::default().swing)]
    pub swing: f64,
    /// Topic on which the device of each skin says what is true, in the namespace of the skin.
    #[arg(long, value_name = "TOPIC", default_value_t = Simulation::default().ground_truth)]
    pub ground_truth: String,
    /// How far the network reaches.
    #[command(flatten)]
    pub network: NetworkArguments,
}

impl Default for Simulation {
    fn default() -> Self {
        Self {
            robot: PathBuf::new(),
            namespace: String::new(),
            rate: 100.0,
            swing: 0.2,
            ground_truth: "ground_truth".into(),
            network: NetworkArguments::default(),
        }
    }
}

/// \[Hz\] of joint states.
const RATES: std::ops::RangeInclusive<f64> = 1.0..=1000.0;
/// \[s\] that the first joint takes to and fro; each further one takes longer by [`LONGER`], so that no two move as one.
const PERIOD: f64 = 5.0;
/// Factor of the period from one joint to the next,
const LONGER: f64 = 1.13;
/// and how many different ones there are.
const PERIODS: usize = 8;
/// \[rad\] or \[m\] that a joint without limits swings through.
const RANGE: f64 = 1.0;
/// Share of a joint's fastest speed that it comes to at the most.
const FASTEST: f64 = 0.5;
/// Truths that may wait.
const WAITING: usize = 64;
/// Messages that are sent again to a subscriber who asks for reliable delivery and lost them.
const KEPT: usize = 10;

/// A sine of time.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Swing {
    middle: f64,
    amplitude: f64,
    /// \[s\]
    period: f64,
}

impl Swing {
    fn of(joint: &Joint, index: usize, share: f64) -> Self {
        let mut period = PERIOD * LONGER.powi((index % PERIODS) as i32);
        let (lower, upper) = joint.limits.map_or((-RANGE / 2.0, RANGE / 2.0), |l| (l.lower, l.upper));
        let amplitude = share * (upper - lower) / 2.0;
        if let Some(limits) = joint.limits.filter(|limits| limits.velocity > 0.0) {
            period = period.max(TAU * amplitude / (FASTEST * limits.velocity));
        }
        // Joints that may stand at 0 swing about it, as far as their range goes.
        // Not `clamp`: of the whole range both ends are its middle, which rounding may exchange.
        let middle = 0.0_f64.max(lower + amplitude).min(upper - amplitude);
        Self { middle, amplitude, period }
    }

    /// Position and speed at an instant \[ns since the epoch\].
    fn at(&self, stamp: i64) -> (f64, f64) {
        // The share of a period first: seconds since 1970 leave no room for parts of one.
        let period = (self.period * 1e9) as i64;
        let angle = TAU * stamp.rem_euclid(period) as f64 / period as f64;
        (
            self.middle + self.amplitude * angle.sin(),
            self.amplitude * TAU / (period as f64 * 1e-9) * angle.cos(),
        )
    }
}

/// Joints of a body that swing.
#[derive(Debug, Clone)]
struct Motion(Vec<Swing>);

impl Motion {
    fn new(body: &Body, share: f64) -> Self {
        Self(body.coordinates().enumerate().map(|(i, joint)| Swing::of(joint, i, share)).collect())
    }

    fn positions(&self, stamp: i64) -> Vec<f64> {
        self.0.iter().map(|swing| swing.at(stamp).0).collect()
    }

    fn state(&self, body: &Body, stamp: i64) -> JointState {
        let (position, velocity) = self.0.iter().map(|swing| swing.at(stamp)).unzip();
        JointState {
            header: Header::new(stamp, ""),
            name: body.coordinates().map(|joint| joint.name.clone()).collect(),
            position,
            velocity,
            ..JointState::default()
        }
    }
}

/// What touches a skin, in the body frame.
fn on_body(robot: &Robot, motion: &Motion, skin: usize, mut truth: Indentation) -> Indentation {
    let skin = &robot.skins[skin];
    let positions = motion.positions(truth.header.stamp.as_nanos());
    let body_from_skin = robot.body.poses(&positions).between(robot.base, skin.link) * skin.pose;
    truth.header.frame_id.clone_from(&robot.body.links()[robot.base]);
    truth.skin.clone_from(&skin.name);
    turn(&body_from_skin, &mut truth.gravity);
    for contact in &mut truth.contacts {
        let p = &contact.position;
        let position = body_from_skin * Point3::new(p.x, p.y, p.z);
        contact.position = convert::point(&position);
        turn(&body_from_skin, &mut contact.normal);
        turn(&body_from_skin, &mut contact.force);
        contact.tip_pose = moved(&body_from_skin, &contact.tip_pose);
    }
    truth
}

fn turn(by: &Isometry3<f64>, vector: &mut VectorMsg) {
    *vector = convert::vector(&(by.rotation * Vector3::new(vector.x, vector.y, vector.z)));
}

fn moved(by: &Isometry3<f64>, pose: &Pose) -> Pose {
    let (p, q) = (&pose.position, &pose.orientation);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z));
    convert::pose(&(by * Isometry3::from_parts(Translation3::new(p.x, p.y, p.z), rotation)))
}

/// Publishes `/joint_states`, and `body_truth` (`dermis_msgs/msg/Indentation` in the body frame, one for each truth of each skin), until
/// `stop` is set.
///
/// # Errors
///
/// Where the robot file cannot be used, a number cannot be, or the network or the ROS installation refuses.
pub async fn simulate(
    request: &Simulation,
    backend: &dyn Backend,
    stop: &AtomicBool,
) -> Result<(), OperateError> {
    let Simulation { rate, swing, .. } = *request;
    if !RATES.contains(&rate) {
        return Err(OperateError::JointRate(rate));
    }
    if !(0.0..=1.0).contains(&swing) {
        return Err(OperateError::Swing(swing));
    }
    let robot = Arc::new(Robot::load(&request.robot)?);
    let motion = Arc::new(Motion::new(&robot.body, swing));
    let options = NodeOptions::new("dermis_robot")
        .namespace(request.namespace.clone())
        .network(request.network.choice());
    let node = Node::open(options, backend)?;
    let states = node.stream_publisher::<JointState>("/joint_states", KEPT)?;
    let truths = node.stream_publisher::<Indentation>("body_truth", KEPT)?;
    let mut subscriptions = Vec::new();
    for (index, skin) in robot.skins.iter().enumerate() {
        let topic = format!("{}/{}", skin.namespace, request.ground_truth);
        let (robot, motion, truths) = (Arc::clone(&robot), Arc::clone(&motion), truths.clone());
        let qos = Qos::sensor_data().with_depth(WAITING);
        subscriptions.push(node.subscribe(&topic, qos, move |truth: Indentation, _| {
            truths.offer(|| Some(on_body(&robot, &motion, index, truth)));
        })?);
    }
    let mut ticks = tokio::time::interval(Duration::from_secs_f64(1.0 / rate));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    while !stop.load(Ordering::Acquire) && !node.is_shut_down() {
        ticks.tick().await;
        states.publish(&motion.state(&robot.body, node.clock().now()))?;
    }
    node.shutdown();
    Ok(())
}

#[cfg(test)]
mod tests {
    use dermis_body::Limits;

    use super::*;

    const URDF: &str = r#"<robot name="two"><link name="base"/><link name="arm"/><link name="hand"/>
        <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
          <limit lower="0.5" upper="1.5" velocity="0.1" effort="1"/></joint>
        <joint name="wrist" type="continuous"><parent link="arm"/><child link="hand"/><origin xyz="0.3 0 0"/><axis xyz="1 0 0"/></joint></robot>"#;
    const ROBOT: &str = "schema = 'dermis-robot/1'\nname = 'two'\nurdf = 'two.urdf'\n\
        [[skins]]\nname = 'palm'\nnamespace = '/palm'\nmount = { parent = 'hand', translation = [0.1, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }\n";

    fn robot() -> Robot {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("two.urdf"), URDF).unwrap();
        std::fs::write(folder.path().join("two.toml"), ROBOT).unwrap();
        Robot::load(folder.path().join("two.toml")).unwrap()
    }

    #[test]
    fn joints_stay_within_their_range_and_speed() {
        let robot = robot();
        for share in [0.0, 0.2, 1.0] {
            let motion = Motion::new(&robot.body, share);
            let (mut last, mut reached) = (None, [f64::INFINITY, f64::NEG_INFINITY]);
            for k in 0..20_000 {
                let stamp = 1_790_000_000_000_000_000 + k * 10_000_000;
                let state = motion.state(&robot.body, stamp);
                assert_eq!(state.name, ["shoulder", "wrist"]);
                let [shoulder, wrist] = state.position.as_slice() else { panic!("{state:?}") };
                assert!((0.5..=1.5).contains(shoulder) && wrist.abs() <= 0.5 + 1e-12, "{state:?}");
                assert!(state.velocity[0].abs() <= 0.05 + 1e-12, "{state:?}");
                if let Some((position, velocity)) = last.replace((*shoulder, state.velocity[0])) {
                    let by = 0.01 * (velocity + state.velocity[0]) / 2.0;
                    assert!((shoulder - position - by).abs() < 1e-6, "{k}: {shoulder} {position}");
                }
                reached = [reached[0].min(*shoulder), reached[1].max(*shoulder)];
            }
            assert!((reached[1] - reached[0] - share).abs() < 1e-3, "{share}: {reached:?}");
        }
    }

    #[test]
    fn any_range_can_be_swung_through() {
        let body = robot().body;
        let mut joint = body.coordinates().next().unwrap().clone();
        for k in 0..1000 {
            let (lower, upper) = (-0.001 * f64::from(k) / 3.0, 0.7 + 0.01 * f64::from(k) / 7.0);
            joint.limits = Some(Limits { lower, upper, velocity: 1.0, effort: 1.0 });
            let swing = Swing::of(&joint, 0, 1.0);
            assert!((swing.middle - (lower + upper) / 2.0).abs() < 1e-12, "{swing:?} of {lower} to {upper}");
        }
    }

    #[test]
    fn a_truth_is_taken_to_the_body_by_the_joints_of_its_own_instant() {
        let robot = robot();
        let motion = Motion::new(&robot.body, 0.5);
        let stamp = 1_790_000_000_123_456_789;
        let contact = dermis_msgs::msg::IndentationContact {
            position: convert::point(&Point3::new(0.01, 0.02, 0.03)),
            normal: convert::vector(&Vector3::z()),
            force: convert::vector(&Vector3::new(0.5, 0.0, -2.0)),
            tip_pose: convert::pose(&Isometry3::translation(0.01, 0.02, 0.03)),
            ..Default::default()
        };
        let truth = Indentation {
            header: Header::new(stamp, "palm_skin"),
            contacts: vec![contact],
            ..Indentation::default()
        };
        let found = on_body(&robot, &motion, 0, truth);
        assert_eq!((found.header.frame_id.as_str(), found.skin.as_str()), ("base", "palm"));
        assert_eq!(found.header.stamp.as_nanos(), stamp);
        let [shoulder, wrist] = motion.positions(stamp)[..] else { panic!("two joints") };
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), shoulder);
        let twist = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), wrist);
        let expected = Vector3::new(0.0, 0.0, 0.4)
            + turn * (Vector3::new(0.3, 0.0, 0.0) + twist * Vector3::new(0.11, 0.02, 0.03));
        let [contact] = found.contacts.as_slice() else { panic!("one contact") };
        let (p, f, q) = (&contact.position, &contact.force, &contact.tip_pose);
        assert!((Vector3::new(p.x, p.y, p.z) - expected).norm() < 1e-12);
        assert!((Vector3::new(q.position.x, q.position.y, q.position.z) - expected).norm() < 1e-12);
        let force = turn * twist * Vector3::new(0.5, 0.0, -2.0);
        assert!((Vector3::new(f.x, f.y, f.z) - force).norm() < 1e-12);
        let orientation = turn * twist;
        assert!(
            (q.orientation.w - orientation.w).abs() < 1e-12
                && (q.orientation.z - orientation.k).abs() < 1e-12
        );
    }
}
