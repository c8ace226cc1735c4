//! A simulated arm of seven joints with one skin, whose efforts are those of its motion, of friction, of noise and of what touches it.

use dermis_body::HistoryLimits;
use dermis_skin::Contact;
use nalgebra::Point3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::fuser::{BodyState, Fuser};
use crate::settings::Settings;
use crate::testing::arm::{LIMITS, ONE_SKIN, arm, joints, push_torques, urdf};
use crate::testing::{BEGIN, MS, contact, normal, report};

/// \[s\] between joint states.
const STEP: f64 = 0.002;

fn robot(urdf: &str) -> Robot {
    arm(urdf, ONE_SKIN)
}

/// A push on the arm.
#[derive(Debug, Clone, Copy)]
struct Push {
    link: usize,
    /// In the frame of the link \[m\], \[N\].
    at: Point3<f64>,
    force: Vector3<f64>,
    /// \[s\]
    from: f64,
    to: f64,
    /// Whether the skin feels it.
    detected: bool,
}

struct Simulation {
    fuser: Fuser,
    rng: ChaCha8Rng,
    /// \[N m\] that stays.
    friction: Vec<f64>,
    /// Friction that depends on the motion, as a share of the limits: Coulomb, and viscous at 1 rad/s.
    moving: [f64; 2],
    pushes: Vec<Push>,
    /// \[1\] of the motion.
    speed: f64,
}

impl Simulation {
    fn new(seed: u64, pushes: &[Push]) -> Self {
        let mut simulation = Self::knowing(seed, &TorqueSettings::default(), &urdf());
        simulation.pushes = pushes.to_vec();
        simulation
    }

    /// With settings and a description of its own.
    fn knowing(seed: u64, s: &TorqueSettings, urdf: &str) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let friction = LIMITS.iter().map(|limit| limit * s.deviation_share * normal(&mut rng)).collect();
        let settings = Settings::default();
        let mut fuser = Fuser::new(robot(urdf), settings, HistoryLimits::default(), &[], &[]).unwrap();
        fuser.report_unknown(s).unwrap();
        Self { fuser, rng, friction, moving: [0.0; 2], pushes: Vec::new(), speed: 1.0 }
    }

    /// Positions, velocities and accelerations at an instant.
    fn motion(&self, t: f64) -> [Vec<f64>; 3] {
        let each = |f: fn(f64, f64, f64) -> f64| -> Vec<f64> {
            (0..7)
                .map(|i| {
                    f(
                        0.5,
                        self.speed * (1.0 + 0.3 * f64::from(i)),
                        0.7 * f64::from(i) + self.speed * (1.0 + 0.3 * f64::from(i)) * t,
                    )
                })
                .collect()
        };
        let mut all = [
            each(|a, _, phase| a * phase.sin()),
            each(|a, w, phase| a * w * phase.cos()),
            each(|a, w, phase| -a * w * w * phase.sin()),
        ];
        // Away from the straight arm, where the wrench on the hand is not determined.
        all[0][1] += 0.6;
        all[0][3] += 1.2;
        all[0][5] += 0.9;
        all
    }

    /// Runs for `duration` \[s\]; every answer is shown.
    fn run(&mut self, duration: f64, mut look: impl FnMut(f64, &BodyState)) {
        let gravity = Vector3::from(TorqueSettings::default().gravity);
        let names = joints();
        let body = self.fuser.robot().body.clone();
        let skin = self.fuser.robot().skins[0].clone();
        for k in 1..(duration / STEP) as u64 {
            let t = k as f64 * STEP;
            let stamp = BEGIN + (t * 1e9).round() as i64;
            let [q, v, a] = self.motion(t);
            let poses = body.poses(&q);
            let mut efforts = poses.inverse_dynamics(&v, &a, &gravity);
            let mut detected: Vec<Contact> = Vec::new();
            for push in self.pushes.iter().filter(|p| (p.from..p.to).contains(&t)) {
                let wrench = Wrench::of_force(push.force, push.at).seen_from(poses.root_from(push.link));
                let of_push = poses.torques(push.link, &wrench);
                efforts.iter_mut().zip(of_push).for_each(|(e, t)| *e -= t);
                if push.detected {
                    let mut on_skin = contact(1, 0.0, 0.0, 0.0);
                    on_skin.position = skin.pose.inverse() * push.at;
                    on_skin.force = skin.pose.rotation.inverse() * push.force;
                    detected.push(on_skin);
                }
            }
            for (i, effort) in efforts.iter_mut().enumerate() {
                let moving = self.moving[0] * v[i].signum() + self.moving[1] * v[i];
                *effort += self.friction[i] + LIMITS[i] * moving + 0.002 * LIMITS[i] * normal(&mut self.rng);
            }
            let v: Vec<f64> = v.iter().map(|v| v + 1e-3 * normal(&mut self.rng)).collect();
            let values = JointValues { names: &names, positions: &q, velocities: &v, efforts: &efforts };
            self.fuser.take_joint_values(stamp, &values).unwrap();
            // The skin reports at 100 Hz, 10 ms late.
            if k % 5 == 0 {
                let then = stamp - 10 * MS;
                self.fuser.take(0, &report("a", k, then, &detected), None, stamp);
                look(t, &self.fuser.state(stamp));
            }
        }
    }
}

fn on_hand() -> Push {
    Push {
        link: 7,
        at: Point3::new(0.08, 0.05, 0.1),
        force: Vector3::new(-14.0, 9.0, -20.0),
        from: 0.5,
        to: 1.3,
        detected: false,
    }
}

fn unknown(state: &BodyState) -> Vec<&BodyTouch> {
    state.contacts.iter().filter(|c| c.skins.is_empty()).collect()
}

/// On 30 arms with frictions of their own: the push is found on its link and on no other, its force is within its covariance, and it ends.
#[test]
fn a_push_where_no_skin_is_is_found() {
    let (mut squares, mut torque_squares, mut n) = (0.0, 0.0, 0.0);
    for seed in 0..30 {
        let mut simulation = Simulation::new(seed, &[on_hand()]);
        let (mut first, mut last) = (f64::INFINITY, 0.0);
        let mut latest = None;
        simulation.run(1.8, |t, state| {
            let found = unknown(state);
            assert!(found.len() <= 1, "seed {seed} at {t} s: {found:?}");
            let Some(touch) = found.first() else { return };
            (first, last) = (t.min(first), t);
            if (1.1..1.11).contains(&t) {
                latest = Some(((*touch).clone(), state.unexplained.clone().unwrap()));
            }
        });
        assert!((0.55..0.9).contains(&first), "seed {seed}: found at {first} s");
        assert!((1.3..1.75).contains(&last), "seed {seed}: ended at {last} s");
        let (touch, torques) = latest.expect("it is there");
        assert_eq!((touch.link, touch.other_links.len(), touch.contact.track_id), (7, 0, 1), "seed {seed}");
        assert!(touch.contact.position.x.is_nan() && touch.contact.confidence > 0.99);
        let error = touch.contact.force - on_hand().force;
        squares += error.dot(&(touch.contact.force_covariance.try_inverse().unwrap() * error));
        let body = &simulation.fuser.robot().body;
        let poses = body.poses(&simulation.motion(1.098)[0]);
        let truth =
            poses.torques(7, &Wrench::of_force(on_hand().force, on_hand().at).seen_from(poses.root_from(7)));
        for ((found, variance), truth) in torques.values.iter().zip(&torques.variances).zip(truth) {
            torque_squares += (found - truth).powi(2) / variance;
        }
        n += 1.0;
    }
    // Means of χ² with 90 and 210 degrees of freedom, within which 99.9 % of such runs are.
    let (force, torque) = (squares / (3.0 * n), torque_squares / (7.0 * n));
    println!("normalised squared error: force {force:.2}, torques {torque:.2}");
    assert!((0.58..1.56).contains(&force), "{force}");
    assert!((0.71..1.35).contains(&torque), "{torque}");
}

/// A link with four joints above: the torques say how hard, but not the force.
#[test]
fn a_push_with_few_joints_above_is_a_contact_without_a_force() {
    let push =
        Push { link: 4, at: Point3::new(0.05, 0.0, 0.15), force: Vector3::new(-80.0, 5.0, 0.0), ..on_hand() };
    let mut simulation = Simulation::new(3, &[push]);
    let mut latest = None;
    simulation.run(1.2, |_, state| latest = unknown(state).first().map(|t| (*t).clone()).or(latest.take()));
    let touch = latest.unwrap();
    assert_eq!((touch.link, touch.contact.force_components), (4, ForceComponents::None));
    // Links beyond the wrist stay possible but for those whose joint turned meanwhile.
    assert!(!touch.other_links.contains(&4) && touch.other_links.len() <= 3, "{touch:?}");
}

/// What the skin feels leaves nothing, as it begins, while it lasts and as it ends.
#[test]
fn what_skins_explain_is_no_alarm() {
    let push = Push {
        link: 4,
        at: Point3::new(0.01, 0.05, 0.12),
        force: Vector3::new(5.0, -40.0, 8.0),
        detected: true,
        ..on_hand()
    };
    for seed in 0..20 {
        let mut simulation = Simulation::new(200 + seed, &[push]);
        let mut detected = 0;
        simulation.run(1.8, |t, state| {
            assert!(unknown(state).is_empty(), "seed {seed} at {t} s: {state:?}");
            detected += usize::from(!state.contacts.is_empty());
        });
        assert!(detected > 60, "{detected} answers with the contact");
    }
    // The same push, where the skin is silent of it, is one.
    let mut simulation = Simulation::new(200, &[Push { detected: false, ..push }]);
    let mut found = 0;
    simulation.run(1.8, |_, state| found += unknown(state).len());
    assert!(found > 40, "{found}");
}

/// One push on the skin and one on the hand behind it, at once, on arms with frictions of their own: the skin's torques are those of the first, and
/// what is left to the joints, and its contact, are the second. Truths are the work of each force along the arm's own geometry.
#[test]
fn of_two_pushes_on_one_chain_joints_feel_what_the_skin_does_not() {
    let on_skin = Push {
        link: 4,
        at: Point3::new(0.01, 0.05, 0.12),
        force: Vector3::new(5.0, -40.0, 8.0),
        detected: true,
        ..on_hand()
    };
    let (mut squares, mut torque_squares, mut n) = (0.0, 0.0, 0.0);
    for seed in 300..310 {
        let mut simulation = Simulation::new(seed, &[on_skin, on_hand()]);
        let mut latest = None;
        simulation.run(1.12, |t, state| {
            assert!(unknown(state).len() <= 1, "seed {seed} at {t} s: {state:?}");
            if (1.1..1.11).contains(&t) {
                latest = Some(state.clone());
            }
        });
        let state = latest.unwrap();
        // The skin's newest reading is 10 ms old.
        let [q, ..] = simulation.motion(1.09);
        let q: [f64; 7] = q.try_into().unwrap();
        for (found, truth) in state.torques.iter().zip(push_torques(&q, 4, on_skin.at, on_skin.force)) {
            assert!((found - truth).abs() < 1e-6, "seed {seed}: {found} N m, not {truth}");
        }
        let found = unknown(&state);
        let [touch] = found.as_slice() else { panic!("seed {seed}: {found:?}") };
        assert_eq!((touch.link, touch.other_links.len()), (7, 0), "seed {seed}");
        let error = touch.contact.force - on_hand().force;
        squares += error.dot(&(touch.contact.force_covariance.try_inverse().unwrap() * error));
        let left = state.unexplained.as_ref().unwrap();
        let truth = push_torques(&q, 7, on_hand().at, on_hand().force);
        for ((found, variance), truth) in left.values.iter().zip(&left.variances).zip(truth) {
            torque_squares += (found - truth).powi(2) / variance;
        }
        n += 1.0;
    }
    // Means of χ² with 30 and 70 degrees of freedom that one such run in a thousand is above.
    let (force, torque) = (squares / (3.0 * n), torque_squares / (7.0 * n));
    println!("normalised squared error: force {force:.2}, torques {torque:.2}");
    assert!(force < 1.99, "{force}");
    assert!(torque < 1.60, "{torque}");
}

/// Fast motion, without a touch.
#[test]
fn motion_is_no_touch() {
    let mut simulation = Simulation::new(9, &[]);
    simulation.speed = 3.0;
    let mut answers = 0;
    simulation.run(4.0, |t, state| {
        assert!(unknown(state).is_empty(), "at {t} s");
        answers += usize::from(state.unexplained.is_some());
    });
    assert!(answers > 350);
}

/// Friction of 10 % of the limits, five times what the variance allows for.
#[test]
fn friction_that_is_known_is_no_touch_and_hides_none() {
    let moving = [0.1, 0.05];
    let alarms = |s: &TorqueSettings, urdf: &str, pushes: &[Push]| {
        let mut simulation = Simulation::knowing(11, s, urdf);
        (simulation.moving, simulation.pushes) = (moving, pushes.to_vec());
        let mut at = Vec::new();
        simulation.run(2.0, |t, state| at.extend(unknown(state).first().map(|_| t)));
        at
    };
    let s = TorqueSettings::default();
    assert!(!alarms(&s, &urdf(), &[]).is_empty(), "the friction is too little to be taken for a touch");
    let mut stated = urdf();
    for limit in LIMITS {
        let (coulomb, viscous) = (moving[0] * limit, moving[1] * limit);
        let dynamics =
            format!("effort='{limit}'/><dynamics friction='{coulomb}' damping='{viscous}'/></joint>");
        stated = stated.replace(&format!("effort='{limit}'/></joint>"), &dynamics);
    }
    assert_eq!(alarms(&s, &stated, &[]), [0.0; 0]);
    let measured = |i: usize| JointFriction {
        coulomb: moving[0] * LIMITS[i],
        viscous: moving[1] * LIMITS[i],
        offset: 0.0,
    };
    let friction = (0..7).map(|i| (format!("j{}", i + 1), measured(i))).collect();
    let s = TorqueSettings { friction, ..s };
    assert_eq!(alarms(&s, &urdf(), &[]), [0.0; 0]);
    let found = alarms(&s, &urdf(), &[on_hand()]);
    assert!(found.iter().all(|t| (0.55..1.75).contains(t)) && found.len() > 20, "{found:?}");
}

#[test]
fn at_rest_the_direction_of_friction_is_not_known() {
    let friction = JointFriction { coulomb: 3.0, viscous: 2.0, offset: 0.5 };
    assert_eq!((friction.effort(0.0, 0.01), friction.variance(0.0, 0.01)), (0.5, 9.0));
    let (effort, variance) = (friction.effort(-1.0, 0.01), friction.variance(-1.0, 0.01));
    assert!((effort + 4.5).abs() < 1e-9 && variance < 1e-9, "{effort}, {variance}");
}

#[test]
fn without_efforts_or_inertias_one_sentence_says_so() {
    let names = |n: usize| -> Vec<String> { (1..=n).map(|i| format!("j{i}")).collect() };
    let ask = |urdf: &str, efforts: &[f64]| {
        let limits = HistoryLimits::default();
        let mut fuser = Fuser::new(robot(urdf), Settings::default(), limits, &[], &[]).unwrap();
        for k in 0..400 {
            let stamp = BEGIN + k * 2 * MS;
            let (names, zeros) = (names(7), [0.0; 7]);
            let values = JointValues { names: &names, positions: &zeros, velocities: &[], efforts };
            fuser.take_joint_values(stamp, &values).unwrap();
        }
        let state = fuser.state(BEGIN + 800 * MS);
        (fuser.torque_sentence(), state.unexplained)
    };
    let (text, torques) = ask(&urdf(), &[]);
    insta::assert_snapshot!(text.unwrap(), @"no external torques of j1, j2, j3, j4, j5 and 2 more: /joint_states brings no efforts of them; publish them where the robot measures torques");
    assert_eq!(torques, None);
    let (text, _) = ask(&urdf(), &[0.0; 3]);
    insta::assert_snapshot!(text.unwrap(), @"a joint state has 7 names, 0 velocities and 3 efforts; the publisher must give one of each a name, or none");
    let light = urdf().replace("<mass value='0.6'/>", "");
    let (text, torques) = ask(&light, &[0.0; 7]);
    insta::assert_snapshot!(text.unwrap(), @"no external torques of j7: the URDF gives no masses of what they move; add `inertial`");
    let torques = torques.unwrap();
    assert!(torques.values[6].is_nan() && torques.values[..6].iter().all(|t| t.is_finite()));
    let (text, torques) = ask(&urdf().replace(" effort='10'", ""), &[0.0; 7]);
    insta::assert_snapshot!(text.unwrap(), @"the variance of external torques of j7 is not known: the URDF gives no effort limit; add `torques.deviations`");
    let torques = torques.unwrap();
    assert!(torques.values[6].is_finite() && torques.variances[6].is_nan());
    let flat = urdf().replacen("izz='", "izz='9", 1);
    let (text, torques) = ask(&flat, &[0.0; 7]);
    insta::assert_snapshot!(text.unwrap(), @r#"no external torques: no body has the inertia of link "l1" in the URDF; correct its `inertial`"#);
    assert_eq!(torques, None);
}

#[test]
fn settings_that_cannot_be_are_named() {
    let robot = robot(&urdf());
    let wrong = |s: TorqueSettings| Observer::new(&robot, s).unwrap_err().to_string();
    let usual = TorqueSettings::default;
    insta::assert_snapshot!(wrong(TorqueSettings { gain: 0.0, ..usual() }), @"torques: `gain` is 0 and must be from 0.1 to 10000");
    insta::assert_snapshot!(wrong(TorqueSettings { joints: vec!["elbow".into()], ..usual() }), @r#"torques: `joints`: "elbow" is no joint of the robot that moves by itself; correct the name"#);
    let none = |joint: &str, coulomb| {
        let friction = JointFriction { coulomb, ..JointFriction::default() };
        TorqueSettings { friction: [(joint.to_owned(), friction)].into(), ..usual() }
    };
    insta::assert_snapshot!(wrong(none("elbow", 1.0)), @r#"torques: `friction`: "elbow" is no joint of the robot that moves by itself; correct the name"#);
    insta::assert_snapshot!(wrong(none("j1", -1.0)), @"torques: `friction.coulomb` is -1 and must be from 0 to 1000000");
    insta::assert_snapshot!(wrong(TorqueSettings { gravity: [0.0, f64::NAN, 0.0], ..usual() }), @"torques: `gravity` is NaN and must be from -100 to 100");
}

/// Noise is measured, whatever else changes.
#[test]
fn noise_is_what_scatters() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut noise = Noise::default();
    for k in 0..4000 {
        noise.take(5.0 * (f64::from(k) * STEP).sin() + 0.3 * normal(&mut rng), STEP);
    }
    let found = noise.variance().unwrap().sqrt();
    assert!((0.26..0.34).contains(&found), "{found}");
}
