//! The estimator on messages in memory.

mod chain;
mod neighbours;
mod overlap;
mod scenarios;

use dermis_skin::ForceComponents;
use nalgebra::Matrix3;

use super::*;
use crate::testing::{BEGIN, MS, contact, fuser, report, stated};

/// Place of a contact in the frame of the chest, which is 0.3 m above the base.
fn on_chest(touch: &BodyTouch) -> Vector3<f64> {
    touch.body_from_contact.translation.vector - Vector3::new(0.0, 0.0, 0.3)
}

/// Pose of skin `b` in the frame of the chest, as the text of the robot has it: that of the plate, and that of the skin on the plate.
fn chest_from_b() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.1, 0.0, 0.0), Vector3::new(0.0, 0.0, 0.5))
        * Isometry3::new(Vector3::new(0.0, 0.02, 0.0), Vector3::new(0.0, 0.0, 0.3))
}

/// Any order of arrival within the bound gives the same answer.
#[test]
fn reports_that_overtake_each_other_change_nothing() {
    let frames: Vec<(usize, i64)> = (0..60).map(|k| ((k % 2) as usize, 7 * k)).collect();
    let message = |skin: usize, ms: i64| {
        let x = 1e-5 * ms as f64 * if skin == 0 { 1.0 } else { 1.2 };
        let name = ["a", "b"][skin];
        // The second skin is turned and moved; its readings only have to be the same in both runs.
        let at = if skin == 0 { contact(1, x + 0.088, 0.018, 2.0) } else { contact(4, x, 0.0, 3.0) };
        report(name, ms as u64 / 7 + 1, BEGIN + ms * MS, &[at])
    };
    let run = |order: &[(usize, i64)]| {
        let mut fuser = fuser(Settings::default());
        let now = BEGIN + 500 * MS;
        // Both are known before.
        for skin in [0, 1] {
            assert!(fuser.take(skin, &report(["a", "b"][skin], 0, BEGIN - MS, &[]), None, now));
        }
        for (k, (skin, ms)) in order.iter().enumerate() {
            assert!(fuser.take(*skin, &message(*skin, *ms), None, now), "{skin} {ms}");
            // Called in between, so that identities are given early.
            if k % 5 == 0 {
                fuser.state(now);
            }
        }
        fuser.state(now)
    };
    let straight = run(&frames);
    assert_eq!(straight.contacts.len(), 1);
    assert_eq!(straight.contacts[0].skins.len(), 2);
    // The second skin's frames come three periods late.
    let mut late: Vec<(i64, (usize, i64))> =
        frames.iter().map(|(skin, ms)| (ms + if *skin == 1 { 42 } else { 0 }, (*skin, *ms))).collect();
    late.sort_unstable();
    let late: Vec<(usize, i64)> = late.into_iter().map(|(_, frame)| frame).collect();
    assert_ne!(late, frames);
    assert_eq!(run(&late).contacts, straight.contacts);
}

#[test]
fn what_comes_after_its_neighbours_have_gone_on_is_refused() {
    let mut fuser = fuser(Settings::default());
    let now = BEGIN + 500 * MS;
    assert!(fuser.take(1, &report("b", 1, BEGIN, &[]), None, now));
    for k in 1..30 {
        assert!(fuser.take(0, &report("a", k, BEGIN + k as i64 * 10 * MS, &[]), None, now));
    }
    assert!(!fuser.take(1, &report("b", 2, BEGIN + 100 * MS, &[]), None, now + 300 * MS));
    let state = fuser.state(now + 300 * MS);
    assert_eq!(state.skins[1].health.status, ContactArray::STATUS_STALE);
    insta::assert_snapshot!(state.skins[1].health.text, @"skin `b`: its frames come more than 50 ms after those of its neighbours; find what delays them, synchronise its clock, or raise `reorder`");
    assert!(fuser.take(1, &report("b", 3, BEGIN + 280 * MS, &[]), None, now + 310 * MS));
    assert!(fuser.state(now + 310 * MS).skins[1].health.feels());
}

/// The arm turns by 1 rad/s with a touch on it, and joint states come between frames.
#[test]
fn a_moving_arm_does_not_move_its_contacts() {
    let mut fuser = fuser(Settings::default());
    let names = ["shoulder".to_owned()];
    let mut seen = 0;
    for k in 1..200_i64 {
        let stamp = BEGIN + 10 * k * MS;
        // Joint states 4 ms before the frames, and 6 ms after.
        let joint = stamp - 4 * MS;
        fuser.take_joints(joint, &names, &[(joint - BEGIN) as f64 * 1e-9]).unwrap();
        fuser.take(2, &report("c", k as u64, stamp - 10 * MS, &[contact(1, 0.05, 0.0, 10.0)]), None, stamp);
        let state = fuser.state(stamp);
        let Some(touch) = state.contacts.first() else { continue };
        seen += 1;
        let angle = (state.stamp - BEGIN) as f64 * 1e-9;
        let truth = Vector3::new(0.35 * angle.cos(), 0.35 * angle.sin(), 0.5);
        // Interpolated, not the latest: 10 ms are 3.5 mm here.
        assert!((touch.body_from_contact.translation.vector - truth).norm() < 1e-6, "{touch:?}");
        assert!(touch.velocity.norm() < 1e-6, "{}", touch.velocity);
        assert!((touch.contact.position.x - 0.35).abs() < 1e-9, "in the frame of the arm");
        // 10 N down at 0.35 m, about a vertical axis: no torque. The moment about the base is r × F.
        assert!(state.torques[0].abs() < 1e-9);
        assert!(
            (state.net.torque - truth.cross(&Vector3::new(0.0, 0.0, -10.0))).norm() < 1e-4,
            "{:?}",
            state.net
        );
    }
    assert!(seen > 190);
}

#[test]
fn a_push_turns_the_joint() {
    let mut fuser = fuser(Settings::default());
    fuser.take_joints(BEGIN, &["shoulder".to_owned()], &[0.7]).unwrap();
    let mut push = contact(1, 0.05, 0.0, 0.0);
    (push.force, push.normal) = (Vector3::new(0.0, 2.0, 0.0), -Vector3::y());
    for k in 1..5 {
        fuser.take(
            2,
            &report("c", k, BEGIN + k as i64 * MS, std::slice::from_ref(&push)),
            None,
            BEGIN + k as i64 * MS,
        );
    }
    let state = fuser.state(BEGIN + 4 * MS);
    assert!((state.torques[0] - 0.7).abs() < 1e-6, "2 N at 0.35 m: {:?}", state.torques);
    let load = state.links.iter().find(|l| l.link == 3).unwrap();
    assert!((load.wrench.torque.z - 0.7).abs() < 1e-6 && (load.wrench.force.y - 2.0).abs() < 1e-6);
}

#[test]
fn without_joint_states_contacts_are_known_on_their_link_only() {
    let mut fuser = fuser(Settings::default());
    for k in 1..4 {
        let stamp = BEGIN + k as i64 * 10 * MS;
        fuser.take(0, &report("a", k, stamp, &[contact(1, 0.1, 0.0, 1.0)]), None, stamp);
        fuser.take(1, &report("b", k, stamp, &[]), None, stamp);
        fuser.take(2, &report("c", k, stamp, &[contact(1, 0.05, 0.0, 10.0)]), None, stamp);
    }
    let state = fuser.state(BEGIN + 30 * MS);
    assert_eq!(state.status, ContactArray::STATUS_DEGRADED);
    insta::assert_snapshot!(state.text, @"the position of shoulder is not known: its state has not come; start what publishes joint states, or check its rate and clock");
    let [chest, arm] = state.contacts.as_slice() else { panic!("two contacts") };
    assert!((on_chest(chest) - Vector3::new(0.1, 0.0, 0.0)).norm() < 1e-9);
    assert!((arm.contact.position.x - 0.35).abs() < 1e-9);
    assert!(arm.body_from_contact.translation.vector.iter().all(|v| v.is_nan()));
    assert!(state.torques.is_empty());
    let of = |link: usize| state.links.iter().find(|l| l.link == link).unwrap();
    assert!(of(1).body_wrench.force.z < -0.9 && of(3).body_wrench.force.z.is_nan());
    assert!((of(3).wrench.force.z + 10.0).abs() < 1e-6);
    // As soon as they come, all is known.
    fuser.take_joints(BEGIN + 30 * MS, &["shoulder".to_owned()], &[0.0]).unwrap();
    let state = fuser.state(BEGIN + 30 * MS);
    assert_eq!((state.status, state.text.as_str()), (ContactArray::STATUS_OK, ""));
    assert!(
        (state.contacts[1].body_from_contact.translation.vector - Vector3::new(0.35, 0.0, 0.5)).norm() < 1e-9
    );
}

#[test]
fn joints_that_nobody_tells_of_can_be_taken_for_resting() {
    let mut fuser = fuser(Settings::default());
    fuser.assume_rest();
    let mut ask = |k: u64| {
        let stamp = BEGIN + k as i64 * 10 * MS;
        fuser.take(2, &report("c", k, stamp, &[contact(1, 0.05, 0.0, 10.0)]), None, stamp);
        if k == 3 {
            fuser.take_joints(stamp, &["shoulder".to_owned()], &[std::f64::consts::FRAC_PI_2]).unwrap();
        }
        fuser.state(stamp)
    };
    ask(1);
    let state = ask(2);
    let place = |state: &BodyState| state.contacts[0].body_from_contact.translation.vector;
    assert!((place(&state) - Vector3::new(0.35, 0.0, 0.5)).norm() < 1e-9);
    assert!(!state.text.contains("shoulder") && state.torques.len() == 1, "{}", state.text);
    assert!((place(&ask(3)) - Vector3::new(0.0, 0.35, 0.5)).norm() < 1e-9, "what comes counts");
    // Once it has come, its silence is a fault.
    assert!(ask(40).text.contains("shoulder"));
}

/// A silent robot is no untouched robot.
#[test]
fn what_no_skin_feels_is_not_untouched() {
    let mut fuser = fuser(Settings::default());
    let state = fuser.state(BEGIN);
    assert!(state.contacts.is_empty());
    assert_eq!(state.status, ContactArray::STATUS_STALE);
    assert_eq!(state.skins.len(), 3);
    assert!(state.skins.iter().all(|s| s.health.status == ContactArray::STATUS_STALE && s.health.stamp == 0));
    assert!(
        state.text.starts_with("skin `a`: nothing has come on /a/contacts; start its node"),
        "{}",
        state.text
    );
}

#[test]
fn a_flicker_is_no_contact_and_no_end() {
    let mut fuser = fuser(Settings::default());
    let mut touched = Vec::new();
    let mut frame = |fuser: &mut Fuser, k: u64, on: bool| {
        let stamp = BEGIN + k as i64 * 10 * MS;
        let contacts = if on { vec![contact(1, 0.0, 0.0, 1.0)] } else { vec![] };
        fuser.take(0, &report("a", k, stamp, &contacts), None, stamp);
        let state = fuser.state(stamp);
        touched.push(state.contacts.first().map(|c| c.contact.track_id));
    };
    // One frame; a contact with gaps of three frames; its end.
    let pattern = [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0];
    for (k, on) in pattern.into_iter().enumerate() {
        frame(&mut fuser, k as u64 + 1, on == 1);
    }
    assert!(touched[..11].iter().all(Option::is_none), "{touched:?}");
    assert!(touched[11..27].iter().all(|id| *id == Some(1)), "{touched:?}");
    assert!(touched[27..].iter().all(Option::is_none), "{touched:?}");
}

#[test]
fn skins_without_locations_and_forces_are_heard() {
    let mut fuser = fuser(Settings::default());
    let mut nowhere = contact(3, f64::NAN, 0.0, 2.0);
    nowhere.force_components = ForceComponents::Normal;
    let mut weightless = contact(4, 0.05, 0.0, f64::NAN);
    (weightless.force_components, weightless.force_covariance) =
        (ForceComponents::None, Matrix3::repeat(f64::NAN));
    weightless.position_covariance = Matrix3::repeat(f64::NAN);
    for k in 1..5 {
        let stamp = BEGIN + k as i64 * 10 * MS;
        fuser.take(0, &report("a", k, stamp, &[nowhere.clone(), weightless.clone()]), None, stamp);
    }
    let state = fuser.state(BEGIN + 40 * MS);
    let [first, second] = state.contacts.as_slice() else { panic!("{:?}", state.contacts) };
    assert!(first.contact.position.iter().all(|v| v.is_nan()) && first.velocity.iter().all(|v| v.is_nan()));
    assert_eq!(first.contact.force_components, ForceComponents::Normal);
    assert!((first.contact.force.z + 2.0).abs() < 1e-6 && first.contact.force.x == 0.0);
    assert_eq!(second.contact.force_components, ForceComponents::None);
    assert!(second.contact.force.iter().all(|v| v.is_nan()));
    // Half of the square of 5 mm stays, and the mount's millimetre.
    let variance = second.contact.position_covariance[(0, 0)];
    assert!((1.35e-5..2.6e-5).contains(&variance), "{variance}");
    assert!(state.links[0].wrench.force.z.is_nan(), "what is not measured is not zero");
}

#[test]
fn a_skin_of_one_axis_and_one_of_three_make_three() {
    let mut fuser = fuser(Settings::default());
    let poses = fuser.robot().body.poses(&[0.0]);
    let skin_from_chest = (poses.between(1, 2) * fuser.robot().skins[1].pose).inverse();
    drop(poses);
    let mut axis = contact(1, 0.1, 0.02, 5.0);
    axis.force_components = ForceComponents::Normal;
    let mut full = contact(1, 0.0, 0.0, 5.0);
    full.position = skin_from_chest * axis.position;
    full.force = skin_from_chest.rotation * Vector3::new(1.0, -2.0, -5.0);
    for k in 1..40 {
        let stamp = BEGIN + k as i64 * 10 * MS;
        fuser.take(0, &report("a", k, stamp, std::slice::from_ref(&axis)), None, stamp);
        if k > 20 {
            fuser.take(1, &report("b", k, stamp + MS, std::slice::from_ref(&full)), None, stamp + MS);
        }
        let state = fuser.state(stamp + MS);
        let Some(touch) = state.contacts.first() else { continue };
        assert_eq!(state.contacts.len(), 1, "{k}");
        if k < 20 {
            assert_eq!(touch.contact.force_components, ForceComponents::Normal);
            assert!((touch.contact.force - Vector3::new(0.0, 0.0, -5.0)).norm() < 1e-6);
            assert_eq!(touch.contact.force_covariance[(0, 0)], 0.0);
        } else if k > 25 {
            assert_eq!(touch.contact.force_components, ForceComponents::Full);
            assert!((state.net.force - Vector3::new(1.0, -2.0, -5.0)).norm() < 1e-3, "{:?}", state.net);
        }
    }
}

#[test]
fn an_expected_contact_does_not_count() {
    let expected = Expected {
        name: "backpack".into(),
        link: "chest".into(),
        position: [0.0, 0.0, 0.0],
        radius: 0.02,
        force: Some([0.0, 0.0, -20.0]),
        tolerance: 2.0,
    };
    let mut fuser =
        Fuser::new(crate::testing::robot(), Settings::default(), HistoryLimits::default(), &[expected], &[])
            .unwrap();
    let mut ask = |k: u64, force: f64| {
        for k in 3 * k..3 * k + 3 {
            let stamp = BEGIN + k as i64 * 100 * MS;
            let contacts = [contact(1, 0.0, 0.0, force), contact(2, 0.1, 0.0, 1.0)];
            fuser.take(0, &report("a", k + 1, stamp, &contacts), None, stamp);
        }
        fuser.state(BEGIN + (3 * k as i64 + 2) * 100 * MS)
    };
    let state = ask(0, 20.5);
    assert_eq!(
        state.contacts.iter().map(|c| c.cause).collect::<Vec<_>>(),
        [Cause::Expected, Cause::Environment]
    );
    assert!((state.net.force.z + 1.0).abs() < 1e-6, "{:?}", state.net);
    let state = ask(1, 30.0);
    assert_eq!(state.contacts[0].cause, Cause::Environment);
    assert!((state.net.force.z + 11.0).abs() < 0.5, "{:?}", state.net);
}
