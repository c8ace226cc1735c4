use nalgebra::{DMatrix, DVector};
use proptest::array::uniform4;
use proptest::prelude::*;

use super::*;

const G: f64 = 9.81;

fn down() -> Vector3<f64> {
    Vector3::new(0.0, 0.0, -G)
}

/// Two links of which each is a point mass and a moment of inertia, about y in the plane of x and z: lengths 0.4 m and 0.3 m, masses 3 kg
/// and 2 kg at 0.25 m and 0.2 m, moments 0.05 kg m² and 0.03 kg m².
const ARM: &str = r#"<robot name="arm"><link name="base"/>
  <link name="upper"><inertial><origin xyz="0.25 0 0"/><mass value="3"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.2 0 0"/><mass value="2"/><inertia ixx="0.005" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 -1 0"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0"/><axis xyz="0 -1 0"/></joint>
</robot>"#;

/// Turning, sliding, fixed and following joints, with a branch, and masses all over.
const ROBOT: &str = r#"<robot name="r">
  <link name="base"/>
  <link name="a"><inertial><origin xyz="0.1 -0.02 0.1" rpy="0.3 0.1 -0.4"/><mass value="2"/><inertia ixx="0.03" ixy="0.002" ixz="0.001" iyy="0.04" iyz="-0.003" izz="0.02"/></inertial></link>
  <link name="b"/>
  <link name="c"><inertial><origin xyz="0 0.1 0.05"/><mass value="1.5"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.015"/></inertial></link>
  <link name="d"><inertial><origin xyz="0.05 0 0.02"/><mass value="0.7"/><inertia ixx="0.002" ixy="0" ixz="0" iyy="0.003" iyz="0" izz="0.004"/></inertial></link>
  <link name="e"><inertial><origin xyz="0.1 0 0"/><mass value="0.4"/><inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial></link>
  <link name="side"><inertial><origin xyz="0 0.2 0.1"/><mass value="1"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.02"/></inertial></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0.1 0.2 0.3" rpy="0.1 -0.4 0.9"/><axis xyz="0 1 1"/></joint>
  <joint name="j2" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.3 0 -0.1" rpy="1 0.2 0"/><axis xyz="1 2 -1"/></joint>
  <joint name="f" type="fixed"><parent link="b"/><child link="c"/><origin xyz="0 0.2 0" rpy="0 0 2"/></joint>
  <joint name="j3" type="continuous"><parent link="c"/><child link="d"/><origin xyz="0 0 0.25"/><axis xyz="0 0 1"/></joint>
  <joint name="m" type="revolute"><parent link="d"/><child link="e"/><origin xyz="0.2 0 0"/><axis xyz="0 1 0"/><mimic joint="j1" multiplier="-0.7" offset="0.2"/></joint>
  <joint name="j4" type="revolute"><parent link="a"/><child link="side"/><origin xyz="0 0.4 0"/><axis xyz="1 0 0"/></joint>
</robot>"#;

fn read(text: &str) -> Body {
    Body::from_urdf(text, "r").unwrap()
}

proptest! {
    /// Against the equations of motion of a planar arm as textbooks have them (Siciliano et al. 2009, §7.3.2).
    #[test]
    fn a_planar_arm_is_as_in_the_textbook(q in uniform4(-3.0..3.0f64), v in uniform4(-4.0..4.0f64), a in uniform4(-20.0..20.0f64)) {
        let body = read(ARM);
        let [q1, q2, ..] = q;
        let [v1, v2, ..] = v;
        let [a1, a2, ..] = a;
        let (l, m1, c1, i1, m2, c2, i2) = (0.4, 3.0, 0.25, 0.05, 2.0, 0.2, 0.03);
        let m22 = i2 + m2 * c2 * c2;
        let m12 = m22 + m2 * l * c2 * q2.cos();
        let m11 = i1 + m1 * c1 * c1 + i2 + m2 * (l * l + c2 * c2 + 2.0 * l * c2 * q2.cos());
        let h = -m2 * l * c2 * q2.sin();
        // About −y from x to z: a positive angle lifts the arm.
        let g2 = m2 * c2 * G * (q1 + q2).cos();
        let g1 = (m1 * c1 + m2 * l) * G * q1.cos() + g2;
        let expected = [
            m11 * a1 + m12 * a2 + h * v2 * (2.0 * v1 + v2) + g1,
            m12 * a1 + m22 * a2 - h * v1 * v1 + g2,
        ];
        let poses = body.poses(&q[..2]);
        let torques = poses.inverse_dynamics(&v[..2], &a[..2], &down());
        let momentum = poses.momentum(&v[..2], &down());
        let p = [m11 * v1 + m12 * v2, m12 * v1 + m22 * v2];
        // T = ½ (M11 v1² + 2 M12 v1 v2 + M22 v2²), in which only the elbow's angle is.
        let kinetic = [0.0, h * v1 * v1 + h * v1 * v2];
        for i in 0..2 {
            prop_assert!((torques[i] - expected[i]).abs() < 1e-9, "{torques:?} {expected:?}");
            prop_assert!((momentum.generalized[i] - p[i]).abs() < 1e-12);
            prop_assert!((momentum.kinetic[i] - kinetic[i]).abs() < 1e-12, "{momentum:?} {kinetic:?}");
            prop_assert!((momentum.weight[i] + [g1, g2][i]).abs() < 1e-12);
        }
        prop_assert!((momentum.energy - 0.5 * (p[0] * v1 + p[1] * v2)).abs() < 1e-12);
    }

    /// d/dt p = τ + ∂T/∂q + g along any motion, for every kind of joint.
    #[test]
    fn momentum_changes_by_torques(q in uniform4(-1.5..1.5f64), v in uniform4(-3.0..3.0f64), a in uniform4(-9.0..9.0f64)) {
        const STEP: f64 = 1e-5;
        let body = read(ROBOT);
        let gravity = Vector3::new(3.0, -1.0, -9.0);
        let at = |t: f64| {
            let q: Vec<f64> = (0..4).map(|i| q[i] + v[i] * t + 0.5 * a[i] * t * t).collect();
            let v: Vec<f64> = (0..4).map(|i| v[i] + a[i] * t).collect();
            body.poses(&q).momentum(&v, &gravity)
        };
        let (ahead, behind, now) = (at(STEP), at(-STEP), at(0.0));
        let torques = body.poses(&q).inverse_dynamics(&v, &a, &gravity);
        for (i, torque) in torques.iter().enumerate() {
            let change = (ahead.generalized[i] - behind.generalized[i]) / (2.0 * STEP);
            let expected = torque + now.kinetic[i] + now.weight[i];
            prop_assert!((change - expected).abs() < 1e-6, "{i}: {change} {expected}");
        }
    }

    /// A force on a link takes the torques Jᵀ f from the drives.
    #[test]
    fn weight_is_what_the_jacobian_says(q in uniform4(-1.5..1.5f64)) {
        let body = read(ROBOT);
        let poses = body.poses(&q);
        let mut expected = [0.0; 4];
        for link in 0..body.links().len() {
            let Some(inertia) = body.inertia(link) else { continue };
            let weight = Wrench::of_force(down() * inertia.mass, poses.root_from(link) * inertia.center);
            expected.iter_mut().zip(poses.torques(link, &weight)).for_each(|(sum, t)| *sum += t);
        }
        for (weight, expected) in poses.momentum(&[], &down()).weight.iter().zip(expected) {
            prop_assert!((weight - expected).abs() < 1e-10);
        }
    }
}

/// Accelerations under given torques, by the mass matrix of unit accelerations.
fn accelerations(body: &Body, q: &[f64], v: &[f64], torques: &[f64]) -> Vec<f64> {
    let n = q.len();
    let poses = body.poses(q);
    let rest = poses.inverse_dynamics(v, &[], &down());
    let mut mass = DMatrix::zeros(n, n);
    for j in 0..n {
        let unit: Vec<f64> = (0..n).map(|i| f64::from(u8::from(i == j))).collect();
        let column = poses.inverse_dynamics(&[], &unit, &Vector3::zeros());
        mass.set_column(j, &DVector::from_vec(column));
    }
    assert!((&mass - mass.transpose()).amax() < 1e-12, "{mass}");
    let right = DVector::from_iterator(n, torques.iter().zip(&rest).map(|(t, r)| t - r));
    mass.cholesky().unwrap().solve(&right).as_slice().to_vec()
}

/// Height of the masses in gravity.
fn potential(body: &Body, q: &[f64]) -> f64 {
    let poses = body.poses(q);
    let of =
        |link: usize| body.inertia(link).map_or(0.0, |i| i.mass * G * (poses.root_from(link) * i.center).z);
    (0..body.links().len()).map(of).sum()
}

/// A body that falls by itself keeps its energy.
#[test]
fn energy_is_conserved() {
    let body = read(ROBOT);
    let (mut q, mut v) = (vec![0.3, 0.1, -0.8, 0.5], vec![0.4, -0.2, 1.0, -0.6]);
    let energy = |q: &[f64], v: &[f64]| body.poses(q).momentum(v, &down()).energy + potential(&body, q);
    let begin = energy(&q, &v);
    let mut most = 0.0_f64;
    let step = 1e-3;
    // Runge and Kutta's fourth order.
    for _ in 0..700 {
        let slope = |q: &[f64], v: &[f64]| (v.to_vec(), accelerations(&body, q, v, &[0.0; 4]));
        let shift = |x: &[f64], by: &[f64], h: f64| -> Vec<f64> {
            x.iter().zip(by).map(|(x, by)| x + h * by).collect()
        };
        let (q1, v1) = slope(&q, &v);
        let (q2, v2) = slope(&shift(&q, &q1, step / 2.0), &shift(&v, &v1, step / 2.0));
        let (q3, v3) = slope(&shift(&q, &q2, step / 2.0), &shift(&v, &v2, step / 2.0));
        let (q4, v4) = slope(&shift(&q, &q3, step), &shift(&v, &v3, step));
        for i in 0..4 {
            q[i] += step / 6.0 * (q1[i] + 2.0 * q2[i] + 2.0 * q3[i] + q4[i]);
            v[i] += step / 6.0 * (v1[i] + 2.0 * v2[i] + 2.0 * v3[i] + v4[i]);
        }
        most = most.max(body.poses(&q).momentum(&v, &down()).energy);
    }
    assert!(most > 1.0, "it moves: {most} J");
    let drift = (energy(&q, &v) - begin).abs();
    assert!(drift < 1e-6 * most, "{drift} J of {most} J");
}

#[test]
fn what_has_no_mass_is_known() {
    let body = read(ROBOT);
    assert_eq!(body.carries_mass(), [true; 4]);
    assert_eq!(body.impossible_inertia(), None);
    let light = read(&ARM.replace("<mass value=\"2\"/>", "<mass value=\"0\"/>"));
    assert_eq!(light.carries_mass(), [true, false]);
    let flat = read(&ARM.replace("iyy=\"0.03\"", "iyy=\"0.3\""));
    assert_eq!(flat.impossible_inertia(), Some("fore"), "a moment above the sum of the others");
}

/// The demo robot's masses are those of an adult of 60 kg, and every joint carries some.
#[test]
fn the_demo_robot_has_masses() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let body = Body::load(folder.join("../../launch/robots/humanoid.urdf")).unwrap();
    let mass: f64 = (0..body.links().len()).filter_map(|link| body.inertia(link)).map(|i| i.mass).sum();
    assert!((mass - 60.0).abs() < 0.5, "{mass} kg");
    assert!(body.carries_mass().iter().all(|carries| *carries));
    assert_eq!(body.impossible_inertia(), None);
}
