//! The same fusion in Python with numpy and scipy: what it is given, and whether it makes the same of it.

use anyhow::{Context, Result};
use dermis_body::Robot;
use dermis_fusion::{BodyState, BodyTouch};
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::geometry_msgs::msg::{Point, Vector3};
use dermis_msgs::msg::{Contact, ContactArray};
use dermis_msgs::std_msgs::msg::Header;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3 as Vector};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use super::{BEGIN, CONTACTS, PERIOD, SKINS, fuser_of, report, robot_text};

/// \[1\] by which what the peer makes of a scene may differ from ours, as a share of each value and 10⁻³.
pub const DEVIATION: f64 = 1e-6;
/// Script in `benches/python`.
pub const SCRIPT: &str = "fusion_peer.py";
/// Frames of the scenes that are measured; the peer repeats them.
const FRAMES: u64 = 200;

/// A chest that turns at the waist with two skins that overlap, one of which measures the normal force only, and a hand that slides
/// out of a shoulder, with a third.
const URDF: &str = r#"<robot name="r">
    <link name="base"/><link name="chest"/><link name="plate"/><link name="arm"/><link name="hand"/>
    <joint name="waist" type="revolute"><parent link="base"/><child link="chest"/><origin xyz="0 0 0.3" rpy="0.1 0 0"/>
      <axis xyz="0 0 1"/><limit lower="-2" upper="2"/></joint>
    <joint name="screw" type="fixed"><parent link="chest"/><child link="plate"/><origin xyz="0.1 0 0" rpy="0 0 0.5"/></joint>
    <joint name="shoulder" type="continuous"><parent link="chest"/><child link="arm"/><origin xyz="0 0.2 0.2"/>
      <axis xyz="0 0.6 0.8"/></joint>
    <joint name="reach" type="prismatic"><parent link="arm"/><child link="hand"/><origin xyz="0.3 0 0" rpy="0 0.4 0"/>
      <axis xyz="1 0 0"/><limit lower="0" upper="1"/></joint></robot>"#;
const ROBOT: &str = r#"
    schema = "dermis-robot/1"
    name = "r"
    urdf = "r.urdf"
    [[skins]]
    name = "a"
    mount = { parent = "chest", translation = [0.0, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }
    [[skins]]
    name = "b"
    mount = { parent = "plate", translation = [0.0, 0.02, 0.0], rpy = [0.0, 0.0, 0.3] }
    [[skins]]
    name = "c"
    mount = { parent = "hand", translation = [0.0, 0.0, 0.01], rpy = [0.2, 0.0, 0.0] }
"#;
const MS: i64 = 1_000_000;

/// A report as the peer reads it: covariances are those of its first contact.
fn as_json(skin: usize, report: &ContactArray) -> Value {
    let contacts = report.contacts.iter().map(|c| {
        let (p, n, f) = (&c.position, &c.normal, &c.force);
        json!([c.track_id, p.x, p.y, p.z, n.x, n.y, n.z, f.x, f.y, f.z])
    });
    let first = report.contacts.first().cloned().unwrap_or_default();
    json!({
        "skin": skin, "stamp": report.header.stamp.as_nanos(), "contacts": contacts.collect::<Vec<_>>(),
        "components": first.force_components,
        "position_covariance": first.position_covariance, "force_covariance": first.force_covariance,
    })
}

/// All scenes that are measured, and the one by which both are compared.
pub fn scenes() -> Result<Value> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut scene = |skins: usize, contacts: usize| {
        let (urdf, robot) = robot_text(skins);
        let mut frame = |k: u64| -> Value {
            let stamp = BEGIN + k as i64 * PERIOD;
            (0..skins).map(|skin| as_json(skin, &report(skin, k + 1, stamp, contacts, &mut rng))).collect()
        };
        let frames: Vec<Value> = (0..FRAMES).map(&mut frame).collect();
        json!({ "contacts": contacts, "urdf": urdf, "robot": robot, "frames": frames })
    };
    let growth: Vec<Value> = CONTACTS.iter().map(|count| scene(1, *count)).collect();
    Ok(json!({ "millisecond": scene(SKINS, 2), "growth": growth, "agreement": agreement()? }))
}

/// What a skin reports of contacts in its own frame: identity, place, force.
fn says(
    skin: &str,
    stamp: i64,
    sequence: u64,
    full: bool,
    contacts: &[(u32, Point3<f64>, Vector<f64>)],
) -> ContactArray {
    let wide = [1e-6, 2e-7, 0.0, 2e-7, 2e-6, 0.0, 0.0, 0.0, 5e-7];
    let contact = |(id, place, force): &(u32, Point3<f64>, Vector<f64>)| Contact {
        track_id: *id,
        position: Point { x: place.x, y: place.y, z: place.z },
        normal: Vector3 { x: 0.0, y: 0.0, z: 1.0 },
        force: Vector3 {
            x: if full { force.x } else { 0.0 },
            y: if full { force.y } else { 0.0 },
            z: force.z,
        },
        force_components: if full { Contact::FORCE_FULL } else { Contact::FORCE_NORMAL },
        position_covariance: wide,
        force_covariance: wide.map(|v| v * 1e4),
        diameter: 0.01,
        confidence: 1.0,
        taxels: Vec::new(),
    };
    ContactArray {
        header: Header { stamp: Time::from_nanos(stamp), frame_id: format!("{skin}_skin") },
        skin: skin.to_owned(),
        sequence,
        contacts: contacts.iter().map(contact).collect(),
        ..ContactArray::default()
    }
}

/// 0.3 s of a moving robot whose skins report at 500, 333 and 1,000 Hz: one contact that two skins feel, which slides, one that each
/// of these feels alone, one that ends, and three on the hand, two of which compete for readings; and what our fusion makes of it.
pub fn agreement() -> Result<Value> {
    let mut fuser = fuser_of(URDF, ROBOT)?;
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut noisy = |x: f64, y: f64, size: f64| {
        let mut noise = |size: f64| size * (rng.random::<f64>() - 0.5);
        (
            Point3::new(x + noise(size), y + noise(size), 0.0),
            Vector::new(0.3 + noise(0.1), noise(0.1), -2.0 + noise(0.2)),
        )
    };
    let skins = fuser.robot().skins.clone();
    // From the frame of `a` to that of `b`, both of which are fixed to the chest.
    let b_from_a = (fuser.robot().body.rigid_top(skins[1].link).1 * skins[1].pose).inverse();
    let names = ["waist", "shoulder", "reach"].map(str::to_owned);
    let mut events = Vec::new();
    for k in 0..300_i64 {
        let (stamp, number, t) = (BEGIN + k * MS, k as u64 + 1, k as f64 * 1e-3);
        if k % 10 == 0 {
            // States are ahead of the reports: positions at an instant lie between two of them.
            let at = stamp + 7 * MS;
            let positions = [(3.0 * t).sin(), 3.0 + t, 0.1 + 0.2 * t];
            fuser.take_joints(at, &names, &positions)?;
            events.push(json!({ "stamp": at, "names": names, "positions": positions }));
        }
        let (slid, mut said) = (0.02 + 0.03 * t, Vec::new());
        if k % 2 == 0 {
            let (shared, alone, gone) =
                (noisy(slid, 0.0, 1e-3), noisy(-0.06, 0.03, 1e-3), noisy(0.0, -0.08, 1e-3));
            let mut contacts = vec![(1, shared.0, shared.1), (2, alone.0, alone.1)];
            contacts.extend((k < 150).then_some((3, gone.0, gone.1)));
            said.push((0, says("a", stamp, number, true, &contacts)));
        }
        if k % 3 == 1 {
            let ((place, force), alone) = (noisy(slid, 0.0, 1e-3), noisy(0.1, 0.1, 1e-3));
            let contacts = [(7, b_from_a * place, b_from_a.rotation * force), (8, alone.0, alone.1)];
            said.push((1, says("b", stamp, number, false, &contacts)));
        }
        // Two contacts close enough for the readings of each to be gated with both.
        let places = [noisy(0.0, 0.0, 1e-3), noisy(0.006, 0.0, 1e-3), noisy(0.03, 0.02 * t, 1e-3)];
        let contacts: Vec<_> = (1..).zip(places).map(|(id, (place, force))| (id, place, force)).collect();
        said.push((2, says("c", stamp, number, true, &contacts)));
        for (skin, report) in said {
            fuser.take(skin, &report, None, stamp);
            events.push(as_json(skin, &report));
        }
    }
    let now = BEGIN + 299 * MS;
    let state = fuser.state(now);
    let mut scene = expected(fuser.robot(), &state);
    scene["urdf"] = json!(URDF);
    scene["robot"] = json!(ROBOT);
    scene["events"] = json!(events);
    scene["now"] = json!(now);
    Ok(scene)
}

/// What our fusion says of contacts, links and joints.
fn expected(robot: &Robot, state: &BodyState) -> Value {
    let numbers =
        |values: &[&Vector<f64>]| -> Vec<f64> { values.iter().flat_map(|v| v.iter().copied()).collect() };
    let wrenches = state.links.iter().map(|load| {
        let (own, body) = (&load.wrench, &load.body_wrench);
        let values = numbers(&[&own.force, &own.torque, &body.force, &body.torque]);
        (robot.body.links()[load.link].clone(), json!(values))
    });
    let torques =
        robot.body.coordinates().zip(&state.torques).map(|(joint, t)| (joint.name.clone(), json!(t)));
    json!({
        "contacts": state.contacts.iter().map(contact).collect::<Vec<_>>(),
        "wrenches": wrenches.collect::<serde_json::Map<_, _>>(),
        "net": numbers(&[&state.net.force, &state.net.torque]),
        "torques": torques.collect::<serde_json::Map<_, _>>(),
    })
}

/// Place, normal, force and velocity on the link, pose on the body, and standard deviations of place, force and velocity.
fn contact(touch: &BodyTouch) -> Value {
    let c = &touch.contact;
    let Isometry3 { rotation, translation } = touch.body_from_contact;
    let turn = rotation.coords * rotation.w.signum();
    let roots = |m: &Matrix3<f64>| m.diagonal().map(f64::sqrt);
    let mut values: Vec<f64> = Vec::new();
    for part in [&c.position.coords, &c.normal, &c.force, &touch.velocity, &translation.vector] {
        values.extend(part.iter());
    }
    values.extend(turn.iter());
    for part in [&c.position_covariance, &c.force_covariance, &touch.velocity_covariance] {
        values.extend(roots(part).iter());
    }
    let mut felt = touch.skins.clone();
    felt.sort_unstable();
    json!({ "felt": felt, "values": values })
}

/// The peer's figures beside ours: how many times as long it takes, by the medians.
pub fn beside(mut peer: Value, ours: &Value, growth: &[Value]) -> Result<Value> {
    let over = |peer: &Value, ours: &Value| -> Result<f64> {
        Ok(peer.as_f64().context("the peer measured nothing")?
            / ours.as_f64().context("nothing was measured")?)
    };
    peer["over_dermis"] = json!(over(&peer["millisecond_us"]["p50"], &ours["millisecond_us"]["p50"])?);
    for (row, ours) in peer["contacts"].as_array_mut().into_iter().flatten().zip(growth) {
        row["over_dermis"] = json!(over(&row["update_us"], &ours["update_us"])?);
    }
    Ok(peer)
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::peers;

    /// Both fusions make the same of a moving robot with skins that overlap.
    #[test]
    fn numpy_makes_the_same_of_a_scene() {
        let Some(python) = std::env::var_os("DERMIS_CLIENT_PYTHON").map(PathBuf::from) else {
            println!("skipped: DERMIS_CLIENT_PYTHON names no Python with numpy and scipy");
            return;
        };
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let scene = agreement().unwrap();
        let felt: Vec<&Value> = scene["contacts"].as_array().unwrap().iter().map(|c| &c["felt"]).collect();
        assert!(felt.contains(&&json!([[0, 1], [1, 7]])) && felt.len() == 6, "{felt:?}");
        let run = peers::Run { python: &python, root, seconds: 0.0, threads: 1 };
        let peer = run.of(SCRIPT, &json!({ "agreement": scene }), DEVIATION).unwrap();
        assert_eq!(peer.len(), 1, "{peer:?}");
        // What differs is noticed.
        let mut other = scene;
        other["contacts"][0]["values"][0] = json!(1.0);
        assert!(run.of(SCRIPT, &json!({ "agreement": other }), DEVIATION).is_err());
    }
}
