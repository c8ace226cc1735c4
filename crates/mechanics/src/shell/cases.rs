//! Shells whose answers are known: plates, the roof, the pinched cylinder and hemisphere, a strip with a gauge, a disc that is bent
//! as far as it is thick, a short beam that shears, a narrow one that twists.
//!
//! Lengths of H2 to H4 have no unit in their sources; they are taken as metres.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use nalgebra::{Point3, Vector3};

use super::{
    Action, Corotational, Deformation, Face, Gauge, PlateTheory, Quads, Section, Shell, ShellMesh, Support,
};
use crate::{Case, MechanicsError};

/// Freedoms that are none in a plane of symmetry: normal to x, y and z.
const MIRROR_X: [bool; 6] = [true, false, false, false, true, true];
const MIRROR_Y: [bool; 6] = [false, true, false, true, false, true];
const MIRROR_Z: [bool; 6] = [false, false, true, true, true, false];
/// A rigid wall normal to x that lets the shell slide and turn through it.
const DIAPHRAGM: [bool; 6] = [false, true, true, false, false, false];

/// H1 to H8, in that order.
///
/// # Errors
///
/// [`MechanicsError`] where a case cannot be computed at all.
pub fn shell_cases() -> Result<Vec<Case>, MechanicsError> {
    let mut cases = plate(32)?;
    cases.push(roof(32)?);
    cases.extend(pinched_cylinder()?);
    cases.push(hemisphere(32)?);
    cases.extend(strip()?);
    cases.extend(disc()?);
    cases.push(short_beam()?);
    cases.push(twisted_beam()?);
    Ok(cases)
}

/// Holds nodes by where they are.
fn supports(mesh: &ShellMesh, held: impl Fn(&Point3<f64>) -> [bool; 6]) -> Vec<Support> {
    mesh.points.iter().enumerate().map(|(n, p)| Support::held(n, held(p))).collect()
}

fn any(masks: &[(bool, [bool; 6])]) -> [bool; 6] {
    std::array::from_fn(|k| masks.iter().any(|(holds, mask)| *holds && mask[k]))
}

/// The node at a place.
///
/// # Errors
///
/// Where there is none within a micrometre.
fn node_at(mesh: &ShellMesh, place: Point3<f64>) -> Result<usize, MechanicsError> {
    mesh.points.iter().position(|p| (p - place).norm() < 1e-6).ok_or(MechanicsError::NoMaterial {
        x: place.x,
        y: place.y,
        z: place.z,
    })
}

/// A force per area \[N/m²\] on every node.
fn everywhere(mesh: &ShellMesh, force: Vector3<f64>) -> Action {
    let parts: Vec<Action> =
        mesh.areas().iter().enumerate().map(|(n, area)| Action::force(n, force * *area)).collect();
    Action::sum(parts.iter().map(|part| (1.0, part)))
}

/// H1: a square plate on simple supports; a quarter of it, `cells` a side.
fn plate(cells: usize) -> Result<Vec<Case>, MechanicsError> {
    let (side, young, poisson, thickness) = (1.0, 1e7, 0.3, 0.01);
    let half = side / 2.0;
    let mesh = Quads::grid(cells, cells, |x, y| Point3::new(half * x, half * y, 0.0)).split();
    let on = |a: f64, b: f64| (a - b).abs() < 1e-9;
    // Nothing happens in the plane.
    let flat = [true, true, false, false, false, true];
    let supports = supports(&mesh, |p| {
        any(&[
            (true, flat),
            (on(p.x, 0.0), MIRROR_X),
            (on(p.y, 0.0), MIRROR_Y),
            (on(p.x, half), [false, false, true, true, false, false]),
            (on(p.y, half), [false, false, true, false, true, false]),
        ])
    });
    let centre = node_at(&mesh, Point3::origin())?;
    let uniform = everywhere(&mesh, Vector3::z());
    let shell = Shell::new(mesh, &[Section::isotropic(young, poisson, thickness)], &supports)?;
    let answers = shell.solve(&[Action::force(centre, Vector3::z() / 4.0), uniform])?;
    let rigidity = young * thickness.powi(3) / (12.0 * (1.0 - poisson * poisson));
    let cases = [
        ("H1 force", "1 N on the centre", 0.011_600_8 * side * side / rigidity),
        ("H1 uniform", "1 Pa everywhere", 0.004_062_35 * side.powi(4) / rigidity),
    ];
    Ok(cases
        .into_iter()
        .zip(&answers)
        .map(|((id, load, exact), answer)| {
            Case::relative(
                id,
                format!("simply supported square plate, {load}: displacement of the centre"),
                "Navier's series (S. Timoshenko, S. Woinowsky-Krieger, Theory of Plates and Shells, §§ 30, 34)",
                "m",
                [answer.displacement(centre).z, exact],
                0.002,
            )
        })
        .collect())
}

/// A piece of a cylinder around the x axis, from x = 0 to `length` and from the top to `angle` \[rad\].
fn arch(cells: usize, radius: f64, length: f64, angle: f64) -> ShellMesh {
    Quads::grid(cells, cells, |x, y| {
        let (s, c) = (angle * y).sin_cos();
        Point3::new(length * x, radius * s, radius * c)
    })
    .split()
}

/// H2: the roof of Scordelis and Lo under its weight.
fn roof(cells: usize) -> Result<Case, MechanicsError> {
    Ok(Case::relative(
        "H2",
        "Scordelis-Lo roof: displacement of the free edge's middle",
        "R. H. MacNeal, R. L. Harder 1985, 0.3024; deep-shell series 0.3006; CalculiX C3D20R 0.3014",
        "m",
        [roof_displacement(cells)?, 0.3024],
        0.01,
    ))
}

/// \[m\] downwards of the free edge's middle; a quarter of the roof, `cells` a side.
pub(crate) fn roof_displacement(cells: usize) -> Result<f64, MechanicsError> {
    let (radius, length, angle) = (25.0, 50.0, 40f64.to_radians());
    let mesh = arch(cells, radius, length / 2.0, angle);
    let supports = supports(&mesh, |p| {
        any(&[(p.x < 1e-9, MIRROR_X), (p.y < 1e-9, MIRROR_Y), (p.x > length / 2.0 - 1e-9, DIAPHRAGM)])
    });
    let free = node_at(&mesh, Point3::new(0.0, radius * angle.sin(), radius * angle.cos()))?;
    let weight = everywhere(&mesh, -90.0 * Vector3::z());
    let shell = Shell::new(mesh, &[Section::isotropic(4.32e8, 0.0, 0.25)], &supports)?;
    Ok(-shell.solve(&[weight])?[0].displacement(free).z)
}

/// H3: a cylinder with rigid ends, pinched between two forces; an eighth of it.
fn pinched_cylinder() -> Result<Vec<Case>, MechanicsError> {
    [(16, 0.025), (32, 0.005)]
        .into_iter()
        .map(|(cells, tolerance)| {
            Ok(Case::relative(
                format!("H3 {cells}"),
                format!("pinched cylinder, {cells} by {cells} cells: displacement under the force"),
                "series (G. M. Lindberg, M. D. Olson, G. R. Cowper 1969), 1.8248e-5",
                "m",
                [pinched(cells)?, 1.8248e-5],
                tolerance,
            ))
        })
        .collect()
}

fn pinched(cells: usize) -> Result<f64, MechanicsError> {
    let (radius, half) = (300.0, 300.0);
    let mesh = arch(cells, radius, half, FRAC_PI_2);
    let supports = supports(&mesh, |p| {
        any(&[
            (p.x < 1e-6, MIRROR_X),
            (p.y < 1e-6, MIRROR_Y),
            (p.z < 1e-6, MIRROR_Z),
            (p.x > half - 1e-6, DIAPHRAGM),
        ])
    });
    let top = node_at(&mesh, Point3::new(0.0, 0.0, radius))?;
    let shell = Shell::new(mesh, &[Section::isotropic(3e6, 0.3, 3.0)], &supports)?;
    Ok(-shell.solve(&[Action::force(top, -Vector3::z() / 4.0)])?[0].displacement(top).z)
}

/// H4: a hemisphere with a hole of 18° at its pole, pulled and pushed at its equator; a quarter of it.
fn hemisphere(cells: usize) -> Result<Case, MechanicsError> {
    Ok(Case::relative(
        "H4",
        format!("hemisphere with a hole, {cells} by {cells} cells: displacement under the force"),
        "R. H. MacNeal, R. L. Harder 1985, 0.0940",
        "m",
        [pulled(cells)?, 0.0940],
        0.02,
    ))
}

fn pulled(cells: usize) -> Result<f64, MechanicsError> {
    let radius = 10.0;
    let mesh = Quads::grid(cells, cells, |x, y| {
        let ((sa, ca), (se, ce)) = ((FRAC_PI_2 * x).sin_cos(), (72f64.to_radians() * y).sin_cos());
        Point3::new(radius * ce * ca, radius * ce * sa, radius * se)
    })
    .split();
    let pulled = node_at(&mesh, Point3::new(radius, 0.0, 0.0))?;
    let pushed = node_at(&mesh, Point3::new(0.0, radius, 0.0))?;
    let mut supports = supports(&mesh, |p| any(&[(p.x < 1e-9, MIRROR_X), (p.y < 1e-9, MIRROR_Y)]));
    supports.push(Support::held(pulled, [false, false, true, false, false, false]));
    let load = [Action::force(pulled, Vector3::x()), Action::force(pushed, -Vector3::y())];
    let load = Action::sum(load.iter().map(|part| (1.0, part)));
    let shell = Shell::new(mesh, &[Section::isotropic(6.825e7, 0.3, 0.04)], &supports)?;
    Ok(shell.solve(&[load])?[0].displacement(pulled).x)
}

/// H5: a strip with a gauge on its inner face.
fn strip() -> Result<Vec<Case>, MechanicsError> {
    let (length, width, thickness, young, force) = (0.100, 0.010, 0.002, 1.8e9, 1.0);
    let mesh = Quads::grid(40, 6, |x, y| Point3::new(length * x, width * (y - 0.5), 0.0)).split();
    let clamped: Vec<Support> =
        (0..mesh.points.len()).filter(|&n| mesh.points[n].x < 1e-9).map(Support::clamped).collect();
    let tip = node_at(&mesh, Point3::new(length, 0.0, 0.0))?;
    let shell = Shell::new(mesh, &[Section::isotropic(young, 0.38, thickness)], &clamped)?;
    let at = 0.040;
    let gauge = Gauge {
        centre: Point3::new(at, 0.0, 0.0),
        along: Vector3::x(),
        length: 0.008,
        width: 0.005,
        face: Face::Inner,
    };
    let reading = shell.gauge(&gauge)?;
    // Down, on the outer face: the inner face of a cantilever is pressed together.
    let direct = shell.solve(&[Action::force(tip, -force * Vector3::z())])?.remove(0).dot(&reading.row);
    let influence = shell.solve(std::slice::from_ref(&reading.row))?.remove(0);
    let exact = -6.0 * force * (length - at) / (young * width * thickness * thickness);
    let adjoint = influence.dot(&Action::force(tip, -force * Vector3::z()));

    // A turn and a shift of all nodes, against the same of every second node only.
    let (shift, turn) = (Vector3::new(1e-3, -2e-3, 3e-3), Vector3::new(0.02, 0.03, -0.01));
    let rigid = |part: usize| {
        let values = shell.mesh().points.iter().enumerate().flat_map(|(n, p)| {
            let on = if n % part == 0 { 1.0 } else { 0.0 };
            let moved = (shift + turn.cross(&p.coords)) * on;
            let turned = turn * on;
            [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z]
        });
        Deformation(values.collect())
    };
    Ok(vec![
        Case::relative(
            "H5 strain",
            "cantilever, 1 N at its tip: strain of a gauge on its inner face",
            "beam theory, 6F(L−x)/(Ebh²)",
            "",
            [direct, exact],
            0.01,
        ),
        Case::relative(
            "H5 adjoint",
            "the same by the gauge's influence",
            "the load's own solution: reciprocity is exact",
            "",
            [adjoint, direct],
            1e-9,
        ),
        Case::new(
            "H5 rigid",
            "energy of a rigid motion over that of every second node moved so",
            "exact",
            "",
            [shell.energy(&rigid(1)) / shell.energy(&rigid(2)), 0.0],
            (1e-9, 1.0),
        ),
    ])
}

/// H6: a clamped disc under a force on its centre, as far as 1.4 times its thickness; a quarter of it.
fn disc() -> Result<Vec<Case>, MechanicsError> {
    let (radius, thickness, cells) = (0.050, 0.001, 16);
    let mesh = Quads::grid(cells, cells, |x, y| {
        // P. Shirley, K. Chiu, A low distortion map between disk and square, 1997.
        let (r, angle) = if x >= y {
            (x, if x > 0.0 { FRAC_PI_4 * y / x } else { 0.0 })
        } else {
            (y, FRAC_PI_2 - FRAC_PI_4 * x / y)
        };
        let (s, c) = angle.sin_cos();
        Point3::new(radius * r * c, radius * r * s, 0.0)
    })
    .split();
    let supports = supports(&mesh, |p| {
        any(&[(p.x < 1e-9, MIRROR_X), (p.y < 1e-9, MIRROR_Y), (p.coords.norm() > radius - 1e-9, [true; 6])])
    });
    let centre = node_at(&mesh, Point3::origin())?;
    let shell = Corotational::new(mesh, &[Section::isotropic(1e9, 0.3, thickness)], &supports)?;
    let forces = [0.5, 1.5, 2.66, 5.0];
    let shares = forces.map(|force| force / 5.0);
    let bent = shell.equilibria(&Action::force(centre, Vector3::z() * (5.0 / 4.0)), &shares)?;
    // CalculiX' figures: Timoshenko's one-term solution is good to about 2 %.
    let references = [0.2634e-3, 0.6775e-3, 1.0061e-3, 1.4504e-3];
    Ok(bent
        .iter()
        .zip(forces)
        .zip(references)
        .map(|((bent, force), reference)| {
            Case::relative(
                format!("H6 {force} N"),
                format!("clamped disc of 1 mm, {force} N on its centre: displacement, co-rotational"),
                "CalculiX NLGEOM; Timoshenko's w/t + 0.443 (w/t)³ = 0.217 Pa²/(Et⁴) within 1.7 %",
                "m",
                [bent.deformation.displacement(centre).z, reference],
                0.015,
            )
        })
        .collect())
}

/// H7: a cantilever three times as long as thick, which Kirchhoff's theory has 6 % too stiff.
fn short_beam() -> Result<Case, MechanicsError> {
    let (length, width, thickness, young) = (0.006, 0.010, 0.002, 1.8e9);
    let mesh = Quads::grid(12, 20, |x, y| Point3::new(length * x, width * y, 0.0)).split();
    let clamped: Vec<Support> =
        (0..mesh.points.len()).filter(|&n| mesh.points[n].x < 1e-9).map(Support::clamped).collect();
    let load = along_end(&mesh, length, |n| Action::force(n, Vector3::z()));
    let section = Section::isotropic(young, 0.0, thickness).by(PlateTheory::ReissnerMindlin);
    let corner = node_at(&mesh, Point3::new(length, 0.0, 0.0))?;
    let got = Shell::new(mesh, &[section], &clamped)?.solve(&[load])?[0].displacement(corner).z;
    let area = width * thickness;
    let exact = 4.0 * length.powi(3) / (young * width * thickness.powi(3))
        + length / (5.0 / 6.0 * young / 2.0 * area);
    Ok(Case::relative(
        "H7",
        "cantilever of 6 mm by 2 mm, 1 N at its end: displacement, by Reissner and Mindlin",
        "S. Timoshenko's beam, FL³/(3EI) + FL/(κGA), κ = 5/6",
        "m",
        [got, exact],
        0.002,
    ))
}

/// H8: a strip four times as wide as thick, twisted; by Kirchhoff's theory it would be 19 % stiffer.
fn twisted_beam() -> Result<Case, MechanicsError> {
    let (length, width, thickness, young, poisson) = (0.048, 0.008, 0.002, 1.7e9, 0.394);
    let mesh = Quads::grid(96, 16, |x, y| Point3::new(length * x, width * (y - 0.5), 0.0)).split();
    let mesh = mesh.graded(|p| p).mesh;
    let clamped: Vec<Support> =
        (0..mesh.points.len()).filter(|&n| mesh.points[n].x < 1e-9).map(Support::clamped).collect();
    let load = along_end(&mesh, length, |n| Action::moment(n, Vector3::x()));
    // Away from both ends, where the section may not warp or is pushed.
    let locations = [length / 3.0, length * (2.0 / 3.0)];
    let [first, last] = locations.map(|x| node_at(&mesh, Point3::new(x, 0.0, 0.0)));
    let (first, last) = (first?, last?);
    let section = Section::isotropic(young, poisson, thickness).by(PlateTheory::ReissnerMindlin);
    let moved = Shell::new(mesh, &[section], &clamped)?.solve(&[load])?.remove(0);
    let twist = (moved.rotation(last).x - moved.rotation(first).x) / (locations[1] - locations[0]);
    let shear_modulus = young / (2.0 * (1.0 + poisson));
    Ok(Case::relative(
        "H8",
        "strip of 8 mm by 2 mm under 1 N·m about its length: twist of its middle third, by Reissner and Mindlin",
        "Saint-Venant, T/(0.2808 G b h³) (S. Timoshenko, J. N. Goodier, Theory of Elasticity, § 109)",
        "1/m",
        [twist, 1.0 / (0.2808 * shear_modulus * width * thickness.powi(3))],
        0.01,
    ))
}

/// One of what `each` makes, shared out evenly over the end at x = `length`.
fn along_end(mesh: &ShellMesh, length: f64, each: impl Fn(usize) -> Action) -> Action {
    let mut end: Vec<usize> = (0..mesh.points.len()).filter(|&n| mesh.points[n].x > length - 1e-9).collect();
    end.sort_by(|&a, &b| mesh.points[a].y.total_cmp(&mesh.points[b].y));
    let y = |k: usize| mesh.points[end[k]].y;
    let last = end.len() - 1;
    let parts: Vec<(f64, Action)> = end
        .iter()
        .enumerate()
        .map(|(k, &n)| ((y((k + 1).min(last)) - y(k.saturating_sub(1))) / 2.0 / (y(last) - y(0)), each(n)))
        .collect();
    Action::sum(parts.iter().map(|(share, part)| (*share, part)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_passes() {
        let cases = shell_cases().unwrap();
        for case in &cases {
            println!(
                "{:<12} {:>12.6e} for {:>12.6e} ({:+.3} %)",
                case.id,
                case.got,
                case.reference,
                100.0 * (case.got / case.reference - 1.0)
            );
        }
        let failed: Vec<&Case> = cases.iter().filter(|c| !c.pass).collect();
        assert!(failed.is_empty(), "{failed:#?}");
    }

    #[test]
    fn finer_meshes_come_nearer() {
        for (got, reference) in [
            ([8, 16, 32].map(|n| pinched(n).unwrap()), 1.8248e-5),
            ([8, 16, 32].map(|n| pulled(n).unwrap()), 0.0940),
        ] {
            let errors = got.map(|got| (got / reference - 1.0f64).abs());
            assert!(errors[0] > errors[1] && errors[1] > errors[2], "{errors:?}");
        }
    }
}
