//! Pushes on two links of one arm: what skins feel of both, on every joint.

use nalgebra::Rotation3;

use super::*;
use crate::testing::arm::{BENT, arm, in_root, joints, push_torques, turned_to_root, urdf};

/// Name, link, translation \[m\] and roll, pitch, yaw \[rad\] of the skins.
const MOUNTS: [(&str, usize, [f64; 3], [f64; 3]); 2] =
    [("upper", 3, [0.0, 0.04, 0.1], [-1.5, 0.0, 0.0]), ("lower", 6, [0.03, 0.0, 0.05], [0.2, 1.3, 0.4])];

/// What a skin reports of its push.
fn reported(skin: usize) -> Contact {
    let mut push = contact(1, 0.01, -0.005, 0.0);
    push.force = [Vector3::new(3.0, -2.0, -20.0), Vector3::new(-1.0, 4.0, -9.0)][skin];
    push
}

/// Link, place and force of the same push, in the frame of the link.
fn on_link(skin: usize) -> (usize, Point3<f64>, Vector3<f64>) {
    let (_, link, translation, [roll, pitch, yaw]) = MOUNTS[skin];
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw)
        * Rotation3::from_axis_angle(&Vector3::y_axis(), pitch)
        * Rotation3::from_axis_angle(&Vector3::x_axis(), roll);
    let push = reported(skin);
    (link, turn * push.position + Vector3::from(translation), turn * push.force)
}

/// What the arm feels after some frames in which these of its skins are pushed.
fn felt(pushed: [bool; 2]) -> BodyState {
    let skins: String = MOUNTS
        .iter()
        .map(|(name, link, translation, rpy)| {
            format!("[[skins]]\nname = '{name}'\nmount = {{ parent = 'l{link}', translation = {translation:?}, rpy = {rpy:?} }}\n")
        })
        .collect();
    let (settings, limits) = (Settings::default(), HistoryLimits::default());
    let mut fuser = Fuser::new(arm(&urdf(), &skins), settings, limits, &[], &[]).unwrap();
    let mut now = BEGIN;
    for k in 1..5 {
        now += 10 * MS;
        fuser.take_joints(now, &joints(), &BENT).unwrap();
        for (skin, (name, ..)) in MOUNTS.iter().enumerate() {
            let contacts = if pushed[skin] { vec![reported(skin)] } else { Vec::new() };
            assert!(fuser.take(skin, &report(name, k, now, &contacts), None, now));
        }
    }
    fuser.state(now)
}

/// Torques, by the work of each force along the arm's own geometry, are those of each push alone and the sum of both together.
#[test]
fn two_pushes_on_one_chain_add_up() {
    let of_each: [[f64; 7]; 2] = std::array::from_fn(|skin| {
        let (link, at, force) = on_link(skin);
        push_torques(&BENT, link, at, force)
    });
    for pushed in [[true, false], [false, true], [true, true]] {
        let state = felt(pushed);
        let links: Vec<usize> = state.contacts.iter().map(|c| c.link).collect();
        let expected: Vec<usize> = (0..2).filter(|skin| pushed[*skin]).map(|skin| MOUNTS[skin].1).collect();
        assert_eq!(links, expected, "one contact a push");
        assert_eq!(state.torques.len(), 7);
        for (i, found) in state.torques.iter().enumerate() {
            let truth: f64 = (0..2).filter(|skin| pushed[*skin]).map(|skin| of_each[skin][i]).sum();
            assert!((found - truth).abs() < 1e-6, "{pushed:?}: j{} has {found} N m, not {truth}", i + 1);
        }
    }
    // Both load the first joints, and only the outer one those behind the inner link: one of them alone would not do.
    assert!(
        of_each.iter().all(|t| t[1].abs() > 0.5) && of_each[0][3].abs() < 1e-6 && of_each[1][3].abs() > 0.5
    );
}

/// The same for the net wrench, about the base.
#[test]
fn two_pushes_on_one_chain_make_one_net_wrench() {
    let state = felt([true, true]);
    let (mut force, mut torque) = (Vector3::<f64>::zeros(), Vector3::<f64>::zeros());
    for skin in 0..2 {
        let (link, at, push) = on_link(skin);
        let (at, push) = (in_root(&BENT, link, at), turned_to_root(&BENT, link, push));
        force += push;
        torque += at.coords.cross(&push);
        let load = state.links.iter().find(|l| l.link == link).unwrap();
        assert!((load.body_wrench.force - push).norm() < 1e-6, "{load:?}");
    }
    assert!((state.net.force - force).norm() < 1e-6, "{:?}, not {force}", state.net);
    assert!((state.net.torque - torque).norm() < 1e-6, "{:?}, not {torque}", state.net);
}
