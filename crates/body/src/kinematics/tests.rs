use super::*;
use proptest::array::{uniform3, uniform4};
use proptest::prelude::*;

/// Turning, sliding, fixed and following joints, with a branch.
const ROBOT: &str = r#"<robot name="r">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/><link name="side"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0.1 0.2 0.3" rpy="0.1 -0.4 0.9"/><axis xyz="0 1 1"/></joint>
  <joint name="j2" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.3 0 -0.1" rpy="1 0.2 0"/><axis xyz="1 2 -1"/></joint>
  <joint name="f" type="fixed"><parent link="b"/><child link="c"/><origin xyz="0 0.2 0" rpy="0 0 2"/></joint>
  <joint name="j3" type="continuous"><parent link="c"/><child link="d"/><origin xyz="0 0 0.25"/><axis xyz="0 0 1"/></joint>
  <joint name="m" type="revolute"><parent link="d"/><child link="e"/><origin xyz="0.2 0 0"/><axis xyz="0 1 0"/><mimic joint="j1" multiplier="-0.7" offset="0.2"/></joint>
  <joint name="j4" type="revolute"><parent link="a"/><child link="side"/><origin xyz="0 0.4 0"/><axis xyz="1 0 0"/></joint>
</robot>"#;

fn robot() -> Body {
    Body::from_urdf(ROBOT, "r").unwrap()
}

fn velocity(
    body: &Body,
    q: [f64; 4],
    k: usize,
    link: usize,
    point: &Point3<f64>,
) -> (Vector3<f64>, Vector3<f64>) {
    const STEP: f64 = 1e-6;
    let at = |sign: f64| {
        let mut q = q;
        q[k] += sign * STEP;
        *body.poses(&q).root_from(link)
    };
    let (ahead, behind) = (at(1.0), at(-1.0));
    let local = body.poses(&q).root_from(link).inverse() * point;
    let turn = ahead.rotation * behind.rotation.inverse();
    ((ahead * local - behind * local) / (2.0 * STEP), turn.scaled_axis() / (2.0 * STEP))
}

proptest! {
    /// Columns of the Jacobian are what differences give.
    #[test]
    fn the_jacobian_is_the_derivative(q in uniform4(-1.5..1.5f64), p in uniform3(-0.5..0.5f64)) {
        let body = robot();
        let poses = body.poses(&q);
        for name in ["e", "side", "b"] {
            let link = body.link(name).unwrap();
            let point = poses.root_from(link) * Point3::from(p);
            let jacobian = poses.jacobian(link, &point);
            for k in 0..4 {
                let (linear, angular) = velocity(&body, q, k, link, &point);
                let column = jacobian.column(k);
                prop_assert!((column.fixed_rows::<3>(0) - linear).norm() < 1e-7, "{name} {k}");
                prop_assert!((column.fixed_rows::<3>(3) - angular).norm() < 1e-7, "{name} {k}");
            }
        }
    }

    /// Torques of a force at a point are the transposed Jacobian times the force.
    #[test]
    fn torques_are_the_transposed_jacobian(q in uniform4(-1.5..1.5f64), p in uniform3(-0.5..0.5f64), f in uniform3(-20.0..20.0f64)) {
        let body = robot();
        let poses = body.poses(&q);
        let link = body.link("e").unwrap();
        let (point, force) = (Point3::from(p), Vector3::from(f));
        let torques = poses.torques(link, &Wrench::of_force(force, point));
        let jacobian = poses.jacobian(link, &point);
        let expected = jacobian.fixed_rows::<3>(0).transpose() * force;
        for (torque, expected) in torques.iter().zip(expected.iter()) {
            prop_assert!((torque - expected).abs() < 1e-9);
        }
    }

    /// The pose of a link is the product along its chain, written out by hand; rotations stay unit.
    #[test]
    fn poses_compose(q in uniform4(-1.5..1.5f64)) {
        let body = robot();
        let poses = body.poses(&q);
        let joint = |name: &str, q: f64| {
            let joint = body.joints().iter().find(|j| j.name == name).unwrap();
            let motion = match joint.kind {
                JointKind::Prismatic => Isometry3::translation(joint.axis.x * q, joint.axis.y * q, joint.axis.z * q),
                _ => Isometry3::rotation(joint.axis.into_inner() * q),
            };
            joint.origin * motion
        };
        let expected = joint("j1", q[0]) * joint("j2", q[1]) * joint("f", 0.0) * joint("j3", q[2]) * joint("m", 0.2 - 0.7 * q[0]);
        let e = body.link("e").unwrap();
        let pose = poses.root_from(e);
        prop_assert!((pose.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-12);
        prop_assert!((pose.rotation.norm() - 1.0).abs() < 1e-12);
        let b = body.link("b").unwrap();
        let between = poses.between(b, e);
        prop_assert!((between.to_homogeneous() - (joint("f", 0.0) * joint("j3", q[2]) * joint("m", 0.2 - 0.7 * q[0])).to_homogeneous()).norm() < 1e-12);
    }
}

#[test]
fn what_a_missing_joint_carries_is_not_placed() {
    let body = robot();
    let poses = body.poses(&[0.1, f64::NAN, 0.3, 0.4]);
    let known: Vec<bool> = (0..body.links().len()).map(|link| poses.knows(link)).collect();
    // base, a and side stand before the joint that slides.
    assert_eq!(known, [true, true, false, false, false, false, true]);
    let poses = body.poses(&[f64::NAN]);
    assert!(poses.knows(0) && (1..7).all(|link| !poses.knows(link)));
}

#[test]
fn fixed_joints_make_one_rigid_body() {
    let body = robot();
    let (b, c) = (body.link("b").unwrap(), body.link("c").unwrap());
    let (top, top_from_link) = body.rigid_top(c);
    assert_eq!(top, b);
    assert!((top_from_link.translation.vector - Vector3::new(0.0, 0.2, 0.0)).norm() < 1e-15);
    assert_eq!(body.rigid_top(b), (b, Isometry3::identity()));
}

/// Poses of the demo robot as another program computes them. `kinematics/reference.py` makes the numbers, with yourdfpy.
#[test]
fn another_solver_finds_the_links_at_the_same_positions() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let body = Body::load(folder.join("../../launch/robots/humanoid.urdf")).unwrap();
    let cases: serde_json::Value = serde_json::from_str(include_str!("reference.json")).unwrap();
    let cases = cases.as_array().unwrap();
    assert_eq!(cases.len(), 5);
    for case in cases {
        let q: Vec<f64> =
            body.coordinates().map(|joint| case["joints"][&joint.name].as_f64().unwrap()).collect();
        let poses = body.poses(&q);
        let links = case["links"].as_object().unwrap();
        assert_eq!(links.len(), body.links().len());
        for (name, matrix) in links {
            let pose = poses.root_from(body.link(name).unwrap()).to_homogeneous();
            for row in 0..3 {
                for column in 0..4 {
                    let expected = matrix[row][column].as_f64().unwrap();
                    // Numbers were written with nine digits.
                    assert!((pose[(row, column)] - expected).abs() < 1e-8, "{name} {row} {column}");
                }
            }
        }
    }
}
