//! The faces of a shell that is a thin solid: what presses on the outer one, and what a gauge on one of them reads.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector3};

use super::CalculixError;
use super::quadratic::{FIRST_SIDE, LAST_SIDE, Quadratic, Share, serendipity};
use crate::MechanicsError;
use crate::shell::{Face, Foot, Footprint, Gauge, ShellMesh};

/// Points along each direction of a side at which its strain is taken for a gauge.
const FINE: u32 = 16;

/// Nodal forces, and the points that they stand for.
pub(super) type Pressed = (Vec<(usize, Vector3<f64>)>, Vec<Share>);

/// Nodal forces on the outer face, and the points that they stand for: `force` \[N\] in all, spread as (1 − r²/R²)² about
/// `centre` \[m\] with a radius R of `patch` \[m\]. Where a part of the patch hangs over an edge, what is left is weighed so that
/// its mean place stays the centre: the moment of the whole is that of the force.
pub(super) fn press(
    solid: &Quadratic,
    mesh: &ShellMesh,
    normals: &[Vector3<f64>],
    (centre, patch): (&Point3<f64>, f64),
    force: impl Fn(&Vector3<f64>) -> Vector3<f64>,
) -> Result<Pressed, CalculixError> {
    let Some(foot) = Foot::new(mesh, normals, centre) else {
        return Err(CalculixError::Results("node"));
    };
    let force = force(&foot.normal);
    let [first, second] = dermis_model::tangents(&foot.normal);
    // 1, and the place along the surface as a share of the radius.
    let place = |p: &Point3<f64>| {
        let way = (p - foot.point) / patch;
        Vector3::new(1.0, way.dot(&first), way.dot(&second))
    };
    let share = |p: &Point3<f64>| (1.0 - place(p).yz().norm_squared()).max(0.0).powi(2);
    let near =
        |cell: &usize| solid.cells[*cell].iter().any(|n| (solid.nodes[*n] - foot.point).norm() < 3.0 * patch);
    let spread = |weight: &dyn Fn(&Point3<f64>) -> f64| {
        solid.spread((0..solid.cells.len()).filter(near), |p| force * (share(p) * weight(p)))
    };
    let length = force.norm();
    let moments = spread(&|_| 1.0).1.iter().fold(Matrix3::zeros(), |sum: Matrix3<f64>, (p, f)| {
        sum + place(p) * place(p).transpose() * (f.norm() / length)
    });
    let Some(weights) = moments.try_inverse().map(|inverse| inverse * Vector3::x()) else {
        return Err(MechanicsError::NoMaterial { x: centre.x, y: centre.y, z: centre.z }.into());
    };
    let (forces, points) = spread(&|p| place(p).dot(&weights));
    let on = |f: &Vector3<f64>| f.norm() > 0.0;
    Ok((
        forces.into_iter().filter(|(_, f)| on(f)).collect(),
        points.into_iter().filter(|(_, f)| on(f)).collect(),
    ))
}

/// Mean strain of a solid's face along a gauge, over what of its rectangle lies on material, as a linear function of how the
/// nodes move: node and \[1/m\].
pub(super) fn side_strain(
    solid: &Quadratic,
    mesh: &ShellMesh,
    normals: &[Vector3<f64>],
    gauge: &Gauge,
) -> Result<Vec<(usize, Vector3<f64>)>, CalculixError> {
    let Footprint { foot, along, across, normal } = Footprint::new(mesh, normals, gauge)?;
    let side = match gauge.face {
        Face::Outer => LAST_SIDE,
        Face::Inner | Face::Middle => FIRST_SIDE,
    };
    let reach = gauge.length.hypot(gauge.width);
    let (mut row, mut area) = (BTreeMap::<usize, Vector3<f64>>::new(), 0.0);
    for cell in &solid.cells {
        let nodes = side.map(|n| cell[n]);
        if (solid.nodes[nodes[0]] - foot).norm() > 4.0 * reach {
            continue;
        }
        for i in 0..FINE {
            for j in 0..FINE {
                let [x, y] = [i, j].map(|k| (2.0 * f64::from(k) + 1.0) / f64::from(FINE) - 1.0);
                let shapes = serendipity(x, y);
                let (mut at, mut a, mut b) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
                for (n, [value, dx, dy]) in nodes.iter().zip(shapes) {
                    let p = solid.nodes[*n].coords;
                    at += p * value;
                    a += p * dx;
                    b += p * dy;
                }
                let from = Point3::from(at) - foot;
                let outward = a.cross(&b);
                if from.dot(&along).abs() > gauge.length / 2.0
                    || from.dot(&across).abs() > gauge.width / 2.0
                    || from.norm() > 2.0 * reach
                    || outward.dot(&normal) <= 0.0
                {
                    continue;
                }
                // The gauge's direction in this side's plane, and how the displacement changes along it.
                let unit = outward.normalize();
                let t = (along - unit * along.dot(&unit)).normalize();
                let share =
                    |p: &Vector3<f64>, q: &Vector3<f64>| t.cross(q).dot(&unit) / p.cross(q).dot(&unit);
                let (along_a, along_b) = (share(&a, &b), share(&b, &a));
                for (n, [_, dx, dy]) in nodes.iter().zip(shapes) {
                    *row.entry(*n).or_default() += t * ((dx * along_a + dy * along_b) * outward.norm());
                }
                area += outward.norm();
            }
        }
    }
    if area > 0.0 {
        Ok(row.into_iter().map(|(n, weight)| (n, weight / area)).collect())
    } else {
        let p = gauge.centre;
        Err(MechanicsError::NoMaterial { x: p.x, y: p.y, z: p.z }.into())
    }
}

/// What `weights` make of how nodes moved: a reading, or the work of forces.
pub(super) fn weighed(weights: &[(usize, Vector3<f64>)], moved: &[Vector3<f64>]) -> f64 {
    weights.iter().map(|(n, weight)| weight.dot(&moved[*n])).sum()
}
