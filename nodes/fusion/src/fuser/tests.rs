//! The estimator on simulated touches, all seeded.

use std::collections::HashMap;

use dermis_skin::assign;

use super::*;
use crate::testing::{BEGIN, MS, Moment, Scenario, SimSkin, Touch, contact, fuser, report};

/// \[s\] after which a touch has to be there: births, the slowest skin's period, its delay.
const SETTLE: f64 = 0.1;

fn scenario(touches: Vec<Touch>, duration: f64) -> Scenario {
    Scenario {
        seed: 7,
        duration,
        touches,
        skins: vec![SimSkin::good(0), SimSkin::good(1)],
        settings: Settings::default(),
        moves: false,
        rate: 100.0,
    }
}

/// Place of a contact in the frame of the chest, which is 0.3 m above the base.
fn on_chest(touch: &BodyTouch) -> Vector3<f64> {
    touch.body_from_contact.translation.vector - Vector3::new(0.0, 0.0, 0.3)
}

/// Index of a touch, and the error of its contact's position with that contact.
type Error = (usize, Option<(Vector3<f64>, BodyTouch)>);

/// Error of the position of each touch, in the order of the truth; `None` where nothing is within 20 mm.
fn errors(moment: &Moment<'_>) -> Vec<Error> {
    let found = &moment.state.contacts;
    let distance = |t: usize, f: usize| (on_chest(&found[f]) - moment.truth[t].1.position).norm();
    let assigned = assign(moment.truth.len(), found.len(), distance);
    let each = moment.truth.iter().zip(assigned).enumerate().map(|(t, ((index, touch), f))| {
        let near = f.filter(|f| distance(t, *f) < 0.02);
        (*index, near.map(|f| (on_chest(&found[f]) - touch.position, found[f].clone())))
    });
    each.collect()
}

#[test]
fn two_contacts_30_mm_apart_stay_two() {
    let touches = vec![Touch::resting(0.0, 60.0, 0.0, 0.0, 3.0), Touch::resting(0.0, 60.0, 0.03, 0.0, 5.0)];
    let mut scenario = scenario(touches, 30.0);
    // Coarse skins, and each with a bias of its own.
    scenario.skins.iter_mut().for_each(|s| s.position = 3e-3);
    let mut ids: Option<Vec<u32>> = None;
    scenario.run(|moment| {
        if moment.t < SETTLE {
            return;
        }
        let found = &moment.state.contacts;
        assert_eq!(found.len(), 2, "at {} s: {found:?}", moment.t);
        assert!(found.iter().all(|c| c.skins.len() == 2), "at {} s: {found:?}", moment.t);
        let now: Vec<u32> =
            errors(moment).iter().map(|(_, e)| e.as_ref().unwrap().1.contact.track_id).collect();
        assert_eq!(*ids.get_or_insert(now.clone()), now, "at {} s", moment.t);
    });
    assert!(ids.is_some());
}

#[test]
fn one_touch_of_two_skins_is_one_contact() {
    for seed in 0..20 {
        let mut scenario = scenario(vec![Touch::resting(0.0, 9.0, 0.01, 0.02, 4.0)], 2.0);
        scenario.seed = seed;
        scenario.run(|moment| {
            if moment.t < SETTLE {
                return;
            }
            let [touch] = moment.state.contacts.as_slice() else {
                panic!("seed {seed} at {} s: {:?}", moment.t, moment.state.contacts)
            };
            assert_eq!(touch.skins.len(), 2);
            // Gains of 3 %, noise of 0.1 N.
            assert!((moment.state.net.force.z + 4.0).abs() < 0.8, "{:?}", moment.state.net);
        });
    }
}

/// Ten touches that slide, rest and end, skins that miss, invent and rename contacts.
#[test]
fn identities_switch_once_in_1000_contact_seconds_at_most() {
    let mut touches = Vec::new();
    for k in 0..10 {
        let (x, y) = (f64::from(k % 5) * 0.06 - 0.12, f64::from(k / 5) * 0.06 - 0.03);
        touches.push(Touch::resting(0.1 * f64::from(k), 101.0, x, y, 2.0 + f64::from(k)));
    }
    let mut scenario = scenario(touches, 100.0);
    for skin in &mut scenario.skins {
        (skin.miss, skin.clutter, skin.rename) = (0.02, 0.02, 0.002);
        skin.position = 1.5e-3;
    }
    scenario.rate = 50.0;
    let (mut of_touch, mut switches, mut lost, mut asked): (HashMap<usize, u32>, u32, u32, u32) =
        Default::default();
    let mut more = 0;
    scenario.run(|moment| {
        if moment.t < 1.1 + SETTLE {
            return;
        }
        for (touch, error) in errors(moment) {
            asked += 1;
            match error {
                Some((_, found)) => {
                    let id = found.contact.track_id;
                    switches += u32::from(of_touch.insert(touch, id).is_some_and(|before| before != id));
                }
                None => lost += 1,
            }
        }
        more += moment.state.contacts.len().saturating_sub(moment.truth.len());
    });
    let seconds = f64::from(asked) / scenario.rate;
    assert!(seconds > 980.0);
    assert!(f64::from(switches) <= seconds / 1000.0, "{switches} switches in {seconds} s");
    assert_eq!(lost, 0, "of {asked}");
    assert!(more as f64 <= 0.001 * f64::from(asked), "{more} contacts too many in {asked}");
}

/// Bounds of the mean of a χ² variable with `n` degrees of freedom, divided by n, that 95 % of cases are within (Wilson and Hilferty
/// 1931).
fn band(n: f64) -> (f64, f64) {
    let bound = |z: f64| (1.0 - 2.0 / (9.0 * n) + z * (2.0 / (9.0 * n)).sqrt()).powi(3);
    (bound(-1.96), bound(1.96))
}

/// Normalised squared errors of touches that move as the model says, by skins whose errors stay as they are said to.
#[test]
fn covariances_are_honest() {
    let (mut position, mut force, mut velocity, mut n) = (0.0, 0.0, 0.0, 0.0);
    for seed in 0..40 {
        let touches = (0..6)
            .map(|k| Touch::resting(0.0, 9.0, f64::from(k % 3) * 0.2, f64::from(k / 3) * 0.2, 8.0))
            .collect();
        let mut scenario = scenario(touches, 0.8);
        (scenario.seed, scenario.moves) = (100 + seed, true);
        scenario.settings.gain_deviation = 0.02;
        // The gain's error is that of the first force: forces must not change too much.
        scenario.settings.force_change = 2.0;
        scenario.rate = 20.0;
        scenario.skins[1].position = 2e-3;
        let last = (scenario.duration * scenario.rate) as usize - 1;
        scenario.run(|moment| {
            if (moment.t * 20.0).round() as usize != last {
                return;
            }
            for (touch, error) in errors(moment) {
                let (error, found) = error.unwrap();
                let truth = &moment.truth.iter().find(|(i, _)| *i == touch).unwrap().1;
                // All in the frame of the contact's link; chest and body have the same axes, the plate is turned.
                let turn = match found.link {
                    1 => nalgebra::UnitQuaternion::identity(),
                    _ => nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, -0.5),
                };
                let nees = |e: Vector3<f64>, p: Matrix3<f64>| {
                    (turn * e).dot(&(p.try_inverse().unwrap() * (turn * e)))
                };
                position += nees(error, found.contact.position_covariance);
                force +=
                    nees(turn.inverse() * found.contact.force - truth.force, found.contact.force_covariance);
                velocity += nees(turn.inverse() * found.velocity - truth.velocity, found.velocity_covariance);
                n += 3.0;
            }
        });
    }
    assert_eq!(n, 720.0);
    let (low, high) = band(n);
    for (what, sum) in [("position", position), ("force", force), ("velocity", velocity)] {
        let mean = sum / n;
        assert!((low..high).contains(&mean), "{what}: {mean} is not within {low}..{high}");
    }
}

#[test]
fn a_contact_of_five_minutes_stays() {
    let mut scenario = scenario(vec![Touch::resting(0.0, 400.0, 0.01, 0.02, 4.0)], 300.0);
    scenario.skins.iter_mut().for_each(|s| (s.rate, s.miss) = (20.0, 0.02));
    scenario.rate = 10.0;
    let mut id = None;
    scenario.run(|moment| {
        if moment.t < 0.3 {
            return;
        }
        let [touch] = moment.state.contacts.as_slice() else {
            panic!("at {} s: {:?}", moment.t, moment.state.contacts)
        };
        assert_eq!(*id.get_or_insert(touch.contact.track_id), touch.contact.track_id);
        assert!((touch.contact.force.z + 4.0).abs() < 1.0, "at {} s: {:?}", moment.t, touch.contact.force);
    });
    assert!(id.is_some());
}

/// Root mean square error of the position beside that of the mean of the last readings of both skins, and of the better skin.
#[test]
fn it_is_better_than_an_average_and_than_the_best_skin() {
    let (mut fused, mut average, mut best, mut n) = (0.0, 0.0, 0.0, 0.0);
    for seed in 0..60 {
        let mut scenario = scenario(vec![Touch::resting(0.0, 9.0, 0.01, 0.02, 4.0)], 0.6);
        (scenario.seed, scenario.moves) = (500 + seed, true);
        (scenario.skins[0].position, scenario.skins[1].position) = (2e-3, 4e-3);
        scenario.rate = 20.0;
        scenario.run(|moment| {
            if moment.t < 0.2 {
                return;
            }
            let ([(_, truth)], [a], [b]) =
                (moment.truth.as_slice(), moment.last[0].as_slice(), moment.last[1].as_slice())
            else {
                panic!("one touch")
            };
            let error = errors(moment)[0].1.as_ref().unwrap().0;
            fused += error.norm_squared();
            average += ((a + b) * 0.5 - truth.position).norm_squared();
            best += (a - truth.position).norm_squared();
            n += 1.0;
        });
    }
    let [fused, average, best] = [fused, average, best].map(|sum: f64| (sum / n).sqrt());
    assert!(fused < 0.9 * average.min(best), "fused {fused} m, average {average} m, best skin {best} m");
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
            // Asked in between, so that identities are given early.
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
fn skins_without_places_and_forces_are_heard() {
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
