//! An arm of seven joints: its files, and what its weight and pushes put on its joints. The latter are written out from the arm's lengths, so that
//! they tell where `dermis-body` or this crate is wrong.

use std::path::{Path, PathBuf};

use dermis_body::Robot;
use nalgebra::{Point3, Rotation3, Vector3};

/// Axes and lengths \[m\] of the links, and their masses \[kg\], as of a light arm.
const LINKS: [([i32; 3], f64, f64); 7] = [
    ([0, 0, 1], 0.16, 3.5),
    ([0, 1, 0], 0.20, 3.5),
    ([0, 0, 1], 0.20, 2.5),
    ([0, -1, 0], 0.20, 2.5),
    ([0, 0, 1], 0.20, 1.5),
    ([0, 1, 0], 0.10, 1.5),
    ([0, 0, 1], 0.12, 0.6),
];
/// \[N m\] limits of the joints.
pub(crate) const LIMITS: [f64; 7] = [100.0, 100.0, 60.0, 60.0, 30.0, 20.0, 10.0];
/// \[rad\] away from the straight arm, where the wrench on the hand is not determined.
pub(crate) const BENT: [f64; 7] = [0.44, 1.03, 0.1, 0.77, -0.44, 0.87, 0.41];
/// Skin `a` on the fourth link, for [`arm`].
pub(crate) const ONE_SKIN: &str = "[[skins]]\nname = 'a'\n\
    mount = { parent = 'l4', translation = [0.0, 0.05, 0.1], rpy = [-1.5707963267948966, 0.0, 0.0] }\n";

/// Links `l0` to `l7` on joints `j1` to `j7`.
pub(crate) fn urdf() -> String {
    let mut text = "<robot name='seven'><link name='l0'/>".to_owned();
    for (i, ([x, y, z], length, mass)) in LINKS.iter().enumerate() {
        let before = if i == 0 { 0.1 } else { LINKS[i - 1].1 };
        let (half, across, along) = (length / 2.0, mass * length * length / 10.0, mass * 0.04 * 0.04);
        text += &format!(
            "<link name='l{n}'><inertial><origin xyz='0 0.01 {half}'/><mass value='{mass}'/>\
             <inertia ixx='{across}' ixy='0' ixz='0' iyy='{across}' iyz='0' izz='{along}'/></inertial></link>\
             <joint name='j{n}' type='revolute'><parent link='l{i}'/><child link='l{n}'/><origin xyz='0 0 {before}'/>\
             <axis xyz='{x} {y} {z}'/><limit lower='-3' upper='3' velocity='4' effort='{limit}'/></joint>",
            n = i + 1,
            limit = LIMITS[i],
        );
    }
    text + "</robot>"
}

/// Names of the joints, in the order of the coordinates.
pub(crate) fn joints() -> Vec<String> {
    (1..=7).map(|i| format!("j{i}")).collect()
}

/// Writes the files of the arm with these `[[skins]]` into a folder; the path of the robot file.
pub(crate) fn write_arm(folder: &Path, urdf: &str, skins: &str) -> PathBuf {
    std::fs::write(folder.join("arm.urdf"), urdf).unwrap();
    let file = folder.join("arm.toml");
    let text = format!("schema = 'dermis-robot/1'\nname = 'arm'\nurdf = 'arm.urdf'\n{skins}");
    std::fs::write(&file, text).unwrap();
    file
}

/// The arm with these `[[skins]]`.
pub(crate) fn arm(urdf: &str, skins: &str) -> Robot {
    let folder = tempfile::tempdir().unwrap();
    Robot::load(write_arm(folder.path(), urdf, skins)).unwrap()
}

/// A point of link `l1` to `l7` in the frame of the root: for each joint between, one turn and one step along z.
pub(crate) fn in_root(q: &[f64; 7], link: usize, point: Point3<f64>) -> Point3<f64> {
    let mut at = point;
    for i in (0..link).rev() {
        let axis = Vector3::from(LINKS[i].0.map(f64::from));
        let before = if i == 0 { 0.1 } else { LINKS[i - 1].1 };
        at = Rotation3::new(axis * q[i]) * at + Vector3::new(0.0, 0.0, before);
    }
    at
}

/// A vector of a link in the frame of the root.
pub(crate) fn turned_to_root(q: &[f64; 7], link: usize, vector: Vector3<f64>) -> Vector3<f64> {
    in_root(q, link, Point3::from(vector)) - in_root(q, link, Point3::origin())
}

/// Derivative by each joint position, by central differences.
fn gradient(q: &[f64; 7], of: impl Fn(&[f64; 7]) -> f64) -> [f64; 7] {
    const STEP: f64 = 1e-6;
    std::array::from_fn(|i| {
        let at = |step: f64| {
            let mut moved = *q;
            moved[i] += step;
            of(&moved)
        };
        (at(STEP) - at(-STEP)) / (2.0 * STEP)
    })
}

/// \[N m\] that a push puts on each joint: the derivative of its work F · p(q). Place and force are in the frame of the link; the force keeps
/// the direction that it has at `q`.
pub(crate) fn push_torques(q: &[f64; 7], link: usize, at: Point3<f64>, force: Vector3<f64>) -> [f64; 7] {
    let force = turned_to_root(q, link, force);
    gradient(q, |q| force.dot(&in_root(q, link, at).coords))
}

/// \[N m\] with which the drives hold the arm's weight: the derivative of its potential energy.
pub(crate) fn holding_torques(q: &[f64; 7]) -> [f64; 7] {
    gradient(q, |q| {
        let each = LINKS.iter().zip(1..).map(|((_, length, mass), link)| {
            mass * 9.80665 * in_root(q, link, Point3::new(0.0, 0.01, length / 2.0)).z
        });
        each.sum()
    })
}
