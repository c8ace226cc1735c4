//! Skins that lie over each other, and skins on two sides of a joint.

use std::slice::from_ref;

use super::*;
use crate::messages;

/// A contact of the chest as skin `b` reports it.
fn seen_by_b(on_chest: &Contact) -> Contact {
    let b_from_chest = chest_from_b().inverse();
    let mut same = on_chest.clone();
    same.position = b_from_chest * on_chest.position;
    same.normal = b_from_chest.rotation * on_chest.normal;
    same.force = b_from_chest.rotation * on_chest.force;
    same
}

/// Frames of `a` and `b`, where they send any, and of the arm, which nothing touches; what the body feels at the last.
fn frames(fuser: &mut Fuser, numbers: std::ops::Range<u64>, pads: [Option<&[Contact]>; 2]) -> BodyState {
    let mut now = BEGIN;
    for k in numbers {
        now = BEGIN + k as i64 * 10 * MS;
        fuser.take_joints(now, &["shoulder".to_owned()], &[0.0]).unwrap();
        assert!(fuser.take(2, &report("c", k, now, &[]), None, now));
        for (skin, contacts) in pads.iter().enumerate() {
            if let Some(contacts) = contacts {
                assert!(fuser.take(skin, &report(["a", "b"][skin], k, now, contacts), None, now));
            }
        }
    }
    fuser.state(now)
}

/// Whether list, cloud, wrenches of links and net wrench hold each of these pushes on the chest once.
fn holds_once(robot: &Robot, state: &BodyState, pushes: &[&Contact]) {
    let (mut force, mut torque) = (Vector3::<f64>::zeros(), Vector3::<f64>::zeros());
    for push in pushes {
        force += push.force;
        // The chest is 0.3 m above the base.
        torque += (push.position.coords + Vector3::new(0.0, 0.0, 0.3)).cross(&push.force);
    }
    assert!((state.net.force - force).norm() < 1e-6, "{:?}, not {force}", state.net);
    assert!((state.net.torque - torque).norm() < 1e-6, "{:?}, not {torque}", state.net);
    let on_links: Vector3<f64> = state.links.iter().map(|load| load.body_wrench.force).sum();
    assert!((on_links - force).norm() < 1e-6, "{:?}", state.links);
    let message = messages::body_contacts(robot, state, 1);
    assert_eq!(message.contacts.len(), pushes.len(), "{:?}", message.contacts);
    assert!((message.net_wrench.force.z - force.z).abs() < 1e-6);
    let cloud = messages::points(robot, state).unwrap();
    assert_eq!(cloud.width as usize, pushes.len());
}

/// The contact at the place of a push: its identity, and the skins that feel it.
fn felt_by(state: &BodyState, push: &Contact) -> (u32, Vec<usize>) {
    let near = |touch: &&BodyTouch| (on_chest(touch) - push.position.coords).norm() < 1e-6;
    let touch = state.contacts.iter().find(near).unwrap();
    let mut skins: Vec<usize> = touch.skins.iter().map(|(skin, _)| *skin).collect();
    skins.sort_unstable();
    (touch.contact.track_id, skins)
}

/// One push where two pads lie over each other, beside one that the first pad alone covers, while both pads are there, without the second,
/// with it again, and without the first.
#[test]
fn a_push_on_an_overlap_counts_once() {
    let mut fuser = fuser(Settings::default());
    let robot = fuser.robot().clone();
    let mut shared = contact(1, 0.1, 0.02, 0.0);
    shared.force = Vector3::new(1.0, -2.0, -5.0);
    let alone = contact(2, 0.0, -0.05, 3.0);
    let (on_a, on_b) = ([shared.clone(), alone.clone()], [seen_by_b(&shared)]);
    let stale =
        |state: &BodyState, skin: usize| state.skins[skin].health.status == ContactArray::STATUS_STALE;

    let state = frames(&mut fuser, 1..20, [Some(&on_a[..]), Some(&on_b[..])]);
    assert_eq!(state.status, ContactArray::STATUS_OK, "{}", state.text);
    holds_once(&robot, &state, &[&shared, &alone]);
    let (id, skins) = felt_by(&state, &shared);
    assert_eq!((skins, felt_by(&state, &alone).1), (vec![0, 1], vec![0]));
    assert!(messages::net_wrench(&robot, &state).is_some());

    let state = frames(&mut fuser, 20..60, [Some(&on_a[..]), None]);
    assert!(stale(&state, 1) && !stale(&state, 0), "{}", state.text);
    holds_once(&robot, &state, &[&shared, &alone]);
    assert_eq!(felt_by(&state, &shared), (id, vec![0]));

    let state = frames(&mut fuser, 60..80, [Some(&on_a[..]), Some(&on_b[..])]);
    holds_once(&robot, &state, &[&shared, &alone]);
    assert_eq!(felt_by(&state, &shared), (id, vec![0, 1]));

    let state = frames(&mut fuser, 80..120, [None, Some(&on_b[..])]);
    assert!(stale(&state, 0) && !stale(&state, 1), "{}", state.text);
    holds_once(&robot, &state, &[&shared]);
    assert_eq!(felt_by(&state, &shared), (id, vec![1]));
}

#[test]
fn pads_that_disagree_about_one_push_are_averaged_and_not_added() {
    let mut fuser = fuser(Settings::default());
    let (less, more) = (contact(1, 0.1, 0.02, 4.0), seen_by_b(&contact(1, 0.1, 0.02, 6.0)));
    let state = frames(&mut fuser, 1..20, [Some(from_ref(&less)), Some(from_ref(&more))]);
    assert_eq!(state.contacts.len(), 1);
    assert!((4.0..=6.0).contains(&-state.net.force.z), "{:?}", state.net);
}

/// The arm turns past a place of the chest that is touched, too, so that at one instant both contacts are in one place of the body, with one
/// normal. They stay two, each placed by the joint position of the answer's instant, which lies between joint states and before the newest.
#[test]
fn contacts_on_two_sides_of_a_joint_stay_two_while_it_moves() {
    let mut chest = contact(1, 0.35, 0.0, 0.0);
    chest.position.z = 0.2;
    chest.force = Vector3::new(0.0, 3.0, -4.0);
    let mut arm = contact(1, 0.05, 0.0, 0.0);
    arm.force = Vector3::new(0.0, 2.0, -10.0);
    let angle = |stamp: Stamp| (stamp - BEGIN) as f64 * 1e-9 - 0.5;
    let mut moving = fuser(Settings::default());
    let (mut nearest, mut ids) = (f64::INFINITY, None);
    for ms in 1..1000_i64 {
        let now = BEGIN + ms * MS;
        if ms % 20 == 0 {
            moving.take_joints(now, &["shoulder".to_owned()], &[angle(now)]).unwrap();
        }
        if ms % 10 == 3 {
            assert!(moving.take(0, &report("a", ms as u64, now - 25 * MS, from_ref(&chest)), None, now));
        }
        if ms % 14 == 5 {
            assert!(moving.take(2, &report("c", ms as u64, now - 30 * MS, from_ref(&arm)), None, now));
        }
        if ms < 100 || ms % 5 != 0 {
            continue;
        }
        let state = moving.state(now);
        let [first, second] = state.contacts.as_slice() else { panic!("at {ms} ms: {:?}", state.contacts) };
        assert_eq!(first.skins, [(0, 1)], "at {ms} ms");
        assert_eq!(second.skins, [(2, 1)], "at {ms} ms");
        let now_ids = (first.contact.track_id, second.contact.track_id);
        assert_eq!(*ids.get_or_insert(now_ids), now_ids, "at {ms} ms");

        let (sin, cos) = angle(state.stamp).sin_cos();
        let truth = [Vector3::new(0.35, 0.0, 0.5), Vector3::new(0.35 * cos, 0.35 * sin, 0.5)];
        for (touch, truth) in [first, second].into_iter().zip(truth) {
            let found = touch.body_from_contact.translation.vector;
            assert!((found - truth).norm() < 1e-6, "at {ms} ms: {found}, not {truth}");
        }
        nearest = nearest.min((truth[0] - truth[1]).norm());
        let turned = Vector3::new(-2.0 * sin, 2.0 * cos, -10.0);
        assert!((state.net.force - chest.force - turned).norm() < 1e-6, "at {ms} ms: {:?}", state.net);
        let torque = truth[0].cross(&chest.force) + truth[1].cross(&turned);
        assert!((state.net.torque - torque).norm() < 1e-6, "at {ms} ms: {:?}", state.net);
        // 2 N at 0.35 m turn the joint; those on the chest do not.
        assert!((state.torques[0] - 0.7).abs() < 1e-6, "at {ms} ms: {:?}", state.torques);
    }
    assert!(nearest < 2e-3, "they were never in one place: {nearest} m");

    // As far apart on one rigid part, two such contacts of two skins are one.
    let mut rigid = fuser(Settings::default());
    let mut beside = chest.clone();
    beside.position.y += nearest;
    let beside = seen_by_b(&beside);
    let state = frames(&mut rigid, 1..20, [Some(from_ref(&chest)), Some(from_ref(&beside))]);
    assert_eq!(state.contacts.len(), 1, "{:?}", state.contacts);
}
