//! What a body feels, as messages.

use dermis_body::{Robot, Wrench};
use dermis_msgs::builtin_interfaces::msg::{Duration, Time};
use dermis_msgs::geometry_msgs::msg::{TransformStamped, Wrench as WrenchMsg, WrenchStamped};
use dermis_msgs::msg::{BodyContact, BodyContacts, ContactArray, LinkWrench, SkinHealth};
use dermis_msgs::sensor_msgs::msg::{JointState, PointCloud2};
use dermis_msgs::std_msgs::msg::Header;
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_msgs::visualization_msgs::msg::MarkerArray;
use dermis_perception::messages::{markers_in, points_in, transform_in};
use dermis_skin::convert::{pose, vector};
use dermis_skin::{Contact, Stamp};
use nalgebra::{Isometry3, Matrix3};

use crate::cause::Cause;
use crate::fuser::BodyState;
use crate::slip::Slip;
use crate::torque::Torques;
use crate::touch::{BodyTouch, LinkLoad};

/// Namespace of the markers among those of a viewer.
pub const MARKERS: &str = "body_contacts";

fn rows(m: &Matrix3<f64>) -> [f64; 9] {
    std::array::from_fn(|i| m[(i / 3, i % 3)])
}

fn wrench(w: &Wrench) -> WrenchMsg {
    WrenchMsg { force: vector(&w.force), torque: vector(&w.torque) }
}

/// Header of messages in the body frame.
fn header(robot: &Robot, stamp: Stamp) -> Header {
    Header::new(stamp, robot.body.links()[robot.base].as_str())
}

/// Everything that the body feels.
#[must_use]
pub fn body_contacts(robot: &Robot, state: &BodyState, sequence: u64) -> BodyContacts {
    let joints: Vec<String> = if state.torques.is_empty() {
        Vec::new()
    } else {
        robot.body.coordinates().map(|joint| joint.name.clone()).collect()
    };
    let unexplained = |of: fn(&Torques) -> &Vec<f64>| match &state.unexplained {
        Some(torques) if !joints.is_empty() => of(torques).clone(),
        _ => vec![f64::NAN; joints.len()],
    };
    BodyContacts {
        header: header(robot, state.stamp),
        sequence,
        status: state.status,
        status_text: state.text.clone(),
        skins: state
            .skins
            .iter()
            .map(|s| SkinHealth {
                skin: robot.skins[s.skin].name.clone(),
                link: robot.body.links()[robot.skins[s.skin].link].clone(),
                status: s.health.status,
                status_text: s.health.text.clone(),
                stamp: Time::from_nanos(s.health.stamp),
                rate: s.health.rate as f32,
                healthy: f32::NAN,
                lost: s.health.lost,
            })
            .collect(),
        contacts: state.contacts.iter().map(|touch| contact(robot, touch)).collect(),
        wrenches: state.links.iter().map(|load| link_wrench(robot, load)).collect(),
        net_wrench: wrench(&state.net),
        unexplained_torques: unexplained(|t| &t.values),
        unexplained_variances: unexplained(|t| &t.variances),
        joints,
        joint_torques: state.torques.clone(),
    }
}

fn contact(robot: &Robot, touch: &BodyTouch) -> BodyContact {
    BodyContact {
        contact: (&touch.contact).into(),
        link: robot.body.links()[touch.link].clone(),
        other_links: touch.other_links.iter().map(|link| robot.body.links()[*link].clone()).collect(),
        skins: touch.skins.iter().map(|(skin, _)| robot.skins[*skin].name.clone()).collect(),
        skin_tracks: touch.skins.iter().map(|(_, track)| *track).collect(),
        body_from_contact: pose(&touch.body_from_contact),
        velocity: vector(&touch.velocity),
        velocity_covariance: rows(&touch.velocity_covariance),
        stamp: Time::from_nanos(touch.seen),
        age: Duration::from_nanos(touch.seen.saturating_sub(touch.born)),
        slip: match touch.slip.0 {
            Slip::Unknown => BodyContact::SLIP_UNKNOWN,
            Slip::None => BodyContact::SLIP_NONE,
            Slip::Incipient => BodyContact::SLIP_INCIPIENT,
            Slip::Gross => BodyContact::SLIP_GROSS,
        },
        slip_confidence: touch.slip.1 as f32,
        cause: match touch.cause {
            Cause::Environment => BodyContact::CAUSE_ENVIRONMENT,
            Cause::OwnBody => BodyContact::CAUSE_SELF,
            Cause::Expected => BodyContact::CAUSE_EXPECTED,
        },
    }
}

fn link_wrench(robot: &Robot, load: &LinkLoad) -> LinkWrench {
    LinkWrench {
        link: robot.body.links()[load.link].clone(),
        wrench: wrench(&load.wrench),
        body_wrench: wrench(&load.body_wrench),
        force_covariance: rows(&load.force_covariance),
        status: load.status,
    }
}

/// The wrench on one link, about its origin, in its frame; `None` where one of its skins cannot feel.
#[must_use]
pub fn wrench_of_link(robot: &Robot, stamp: Stamp, load: &LinkLoad) -> Option<WrenchStamped> {
    let header = || Header::new(stamp, robot.body.links()[load.link].as_str());
    ContactArray::feels(load.status).then(|| WrenchStamped { header: header(), wrench: wrench(&load.wrench) })
}

/// Whether sums over the body hold what every skin feels. Messages of sums have no status, and must not say "no touch" where nobody knows.
fn is_whole(state: &BodyState) -> bool {
    ContactArray::feels(state.status)
        && state.net.force.iter().chain(state.net.torque.iter()).all(|v| v.is_finite())
}

fn is_placed(touch: &BodyTouch) -> bool {
    touch.body_from_contact.translation.vector.iter().all(|v| v.is_finite())
}

/// The sum of all forces, about the origin of the body frame; `None` where a skin cannot feel, or joints do not say where its link is.
#[must_use]
pub fn net_wrench(robot: &Robot, state: &BodyState) -> Option<WrenchStamped> {
    is_whole(state).then(|| WrenchStamped { header: header(robot, state.stamp), wrench: wrench(&state.net) })
}

/// What contacts put on each joint; `None` where no joint states come, and where [`net_wrench`] is.
#[must_use]
pub fn joint_torques(robot: &Robot, state: &BodyState) -> Option<JointState> {
    (is_whole(state) && !state.torques.is_empty()).then(|| JointState {
        header: Header::new(state.stamp, ""),
        name: robot.body.coordinates().map(|joint| joint.name.clone()).collect(),
        effort: state.torques.clone(),
        ..JointState::default()
    })
}

/// Contacts that have a place on the body, in the body frame.
fn in_body(state: &BodyState) -> Vec<Contact> {
    state
        .contacts
        .iter()
        .filter(|touch| is_placed(touch))
        .map(|touch| {
            let turn = touch.body_from_link.rotation;
            let mut contact = touch.contact.clone();
            contact.position = touch.body_from_link * contact.position;
            contact.normal = turn * contact.normal;
            contact.force = turn * contact.force;
            contact
        })
        .collect()
}

/// One point a contact that has a place on the body. `None` in place of an empty cloud where a skin cannot feel, or a contact has no
/// place on the body: an empty one says that nothing touches.
#[must_use]
pub fn points(robot: &Robot, state: &BodyState) -> Option<PointCloud2> {
    let contacts = in_body(state);
    let all = ContactArray::feels(state.status) && contacts.len() == state.contacts.len();
    (all || !contacts.is_empty()).then(|| points_in(header(robot, state.stamp), &contacts))
}

/// One arrow a contact that has a place on the body; it vanishes by itself after `lifetime` \[s\].
#[must_use]
pub fn markers(robot: &Robot, state: &BodyState, lifetime: f64) -> MarkerArray {
    let degraded = state.status != ContactArray::STATUS_OK;
    markers_in(&header(robot, state.stamp), MARKERS, &in_body(state), degraded, lifetime)
}

/// Takes away all arrows.
#[must_use]
pub fn no_markers(robot: &Robot, stamp: Stamp) -> MarkerArray {
    dermis_perception::messages::no_markers_in(header(robot, stamp), MARKERS)
}

fn transform(stamp: Stamp, parent: &str, child: &str, pose: &Isometry3<f64>) -> TransformStamped {
    let (t, q) = (&pose.translation, &pose.rotation);
    transform_in(stamp, parent, child, [t.x, t.y, t.z], [q.i, q.j, q.k, q.w])
}

/// Frames that never move: those of skins that are no links themselves and, where `links`, of links on fixed joints.
#[must_use]
pub fn static_transforms(robot: &Robot, stamp: Stamp, links: bool) -> TFMessage {
    let names = robot.body.links();
    let mut transforms: Vec<TransformStamped> = robot
        .skins
        .iter()
        .filter(|skin| skin.frame_id != names[skin.link])
        .map(|skin| transform(stamp, &names[skin.link], &skin.frame_id, &skin.pose))
        .collect();
    if links {
        let fixed = robot.body.joints().iter().filter(|joint| joint.moved_by.is_none());
        transforms.extend(
            fixed.map(|joint| transform(stamp, &names[joint.parent], &names[joint.child], &joint.origin)),
        );
    }
    TFMessage { transforms }
}

/// Frames of the links on joints that move, for these joint positions; those whose positions are not known are left out.
#[must_use]
pub fn moving_transforms(robot: &Robot, stamp: Stamp, positions: &[f64]) -> TFMessage {
    let (names, poses) = (robot.body.links(), robot.body.poses(positions));
    let moving = robot.body.joints().iter().filter(|joint| joint.moved_by.is_some());
    let transforms = moving
        .filter(|joint| poses.knows(joint.child))
        .map(|joint| {
            let pose = poses.between(joint.parent, joint.child);
            transform(stamp, &names[joint.parent], &names[joint.child], &pose)
        })
        .collect();
    TFMessage { transforms }
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::settings::Settings;
    use crate::testing::{BEGIN, MS, contact, fuser, report};

    fn touched() -> (Robot, BodyState) {
        let mut fuser = fuser(Settings::default());
        fuser.take_joints(BEGIN, &["shoulder".to_owned()], &[std::f64::consts::FRAC_PI_2]).unwrap();
        for k in 1..4 {
            let stamp = BEGIN + k as i64 * 10 * MS;
            fuser.take(0, &report("a", k, stamp, &[]), None, stamp);
            fuser.take(1, &report("b", k, stamp, &[]), None, stamp);
            fuser.take(2, &report("c", k, stamp, &[contact(9, 0.05, 0.0, 10.0)]), None, stamp);
        }
        let state = fuser.state(BEGIN + 30 * MS);
        (fuser.robot().clone(), state)
    }

    #[test]
    fn a_contact_says_where_it_is_and_who_feels_it() {
        let (robot, state) = touched();
        let message = body_contacts(&robot, &state, 5);
        assert_eq!((message.header.frame_id.as_str(), message.sequence), ("base", 5));
        assert_eq!(message.header.stamp.as_nanos(), BEGIN + 30 * MS);
        let [touch] = message.contacts.as_slice() else { panic!("one contact") };
        assert_eq!(
            (touch.link.as_str(), &touch.skins[..], &touch.skin_tracks[..]),
            ("arm", &["c".to_owned()][..], &[9][..])
        );
        assert!((touch.contact.position.x - 0.35).abs() < 1e-9 && touch.contact.track_id == 1);
        let at = &touch.body_from_contact.position;
        assert!((at.y - 0.35).abs() < 1e-9 && at.x.abs() < 1e-9 && (at.z - 0.5).abs() < 1e-9);
        assert_eq!((touch.stamp.as_nanos(), touch.age.as_nanos()), (BEGIN + 30 * MS, 20 * MS));
        assert_eq!(message.skins.len(), 3);
        assert_eq!(message.wrenches.len(), 3);
        assert_eq!(
            (message.joints.as_slice(), message.joint_torques.len()),
            (&["shoulder".to_owned()][..], 1)
        );
        assert!(message.unexplained_torques[0].is_nan());
        assert!((message.net_wrench.torque.x + 3.5).abs() < 1e-3, "y Fz = 0.35 m × −10 N");
        let torques = joint_torques(&robot, &state).unwrap();
        assert_eq!((torques.effort.len(), torques.position.len()), (1, 0));
    }

    #[test]
    fn points_and_arrows_are_in_the_body_frame() {
        let (robot, state) = touched();
        let cloud = points(&robot, &state).unwrap();
        assert_eq!((cloud.header.frame_id.as_str(), cloud.width), ("base", 1));
        let float = |i: usize| f32::from_le_bytes(cloud.data[4 * i..4 * i + 4].try_into().unwrap());
        assert!((float(1) - 0.35).abs() < 1e-6 && (float(8) + 10.0).abs() < 1e-3);
        let arrows = markers(&robot, &state, 0.2);
        assert_eq!((arrows.markers.len(), arrows.markers[0].ns.as_str()), (1, MARKERS));
        assert!(net_wrench(&robot, &state).is_some() && joint_torques(&robot, &state).is_some());
        let mut lost = state;
        lost.contacts[0].body_from_contact.translation.vector.fill(f64::NAN);
        assert_eq!(points(&robot, &lost), None, "without joint positions there is no place");
        lost.net.force.x = f64::NAN;
        assert!(net_wrench(&robot, &lost).is_none() && joint_torques(&robot, &lost).is_none());
    }

    #[test]
    fn what_has_no_status_is_silent_where_a_skin_cannot_feel() {
        let (robot, mut state) = touched();
        for (status, whole) in [
            (ContactArray::STATUS_OK, true),
            (ContactArray::STATUS_DEGRADED, true),
            (ContactArray::STATUS_STALE, false),
            (ContactArray::STATUS_UNCALIBRATED, false),
            (ContactArray::STATUS_FAULT, false),
        ] {
            state.status = status;
            assert_eq!(net_wrench(&robot, &state).is_some(), whole);
            assert_eq!(joint_torques(&robot, &state).is_some(), whole);
            // What another skin feels is an obstacle all the same.
            assert_eq!(points(&robot, &state).unwrap().width, 1);
            let untouched = BodyState { contacts: Vec::new(), ..state.clone() };
            assert_eq!(points(&robot, &untouched).map(|cloud| cloud.width), whole.then_some(0));
            let load = LinkLoad { status, ..state.links[0].clone() };
            assert_eq!(wrench_of_link(&robot, BEGIN, &load).is_some(), whole);
        }
    }

    #[test]
    fn frames_have_one_parent_each() {
        let (robot, _) = touched();
        let fixed = static_transforms(&robot, BEGIN, true);
        let moving = moving_transforms(&robot, BEGIN, &[0.5]);
        let mut children: Vec<&str> =
            fixed.transforms.iter().chain(&moving.transforms).map(|t| t.child_frame_id.as_str()).collect();
        children.sort_unstable();
        assert_eq!(children, ["a_skin", "arm", "b_skin", "c_skin", "chest", "plate"]);
        assert_eq!(static_transforms(&robot, BEGIN, false).transforms.len(), 3);
        assert!(moving_transforms(&robot, BEGIN, &[f64::NAN]).transforms.is_empty());
    }
}
