//! A dome under pushes at its tip, on its hemisphere and on its cylinder.

use std::ops::Range;

use nalgebra::{Point3, Vector3};

use super::quadratic::{Quadratic, Share};
use super::{CalculixError, Load, Model, SOURCE};
use crate::fem::{Dome, DomeShape, HexMesh, Probe};
use crate::{Base, Case};

const SHAPE: DomeShape = DomeShape { radius: 0.010, cylinder: 0.016, thickness: 0.0072 };
const YOUNG: f64 = 70e3;
const POISSON: f64 = 0.49;
/// Quads around the equator, by four.
const AROUND: usize = 10;
/// Cells across the elastomer: an odd number, so that one is halfway, where sensors are.
const LAYERS: usize = 5;
/// \[m\] width of the pushes: wide enough for the elements, and about what a fingertip makes.
const WIDTH: f64 = 0.003;

/// A push of 1 N, spread like a bell curve.
struct Push {
    /// From the tip \[m\].
    arc: f64,
    /// About the axis \[rad\].
    angle: f64,
    /// Parts of the force: into the surface, down along it, around the axis.
    force: [f64; 3],
}

const fn push(arc: f64, angle: f64, force: [f64; 3]) -> Push {
    Push { arc, angle, force }
}

/// Pushes at once, on tip, hemisphere and cylinder. Those along the surface lie beside the sensors, as the force points:
/// there their signal is largest, while straight below their field changes its sign and says more of meshes than of domes. The
/// numbers are tolerances, of the largest stress, for CalculiX's mesh: with 12 quads by four around the equator and 7 layers,
/// which takes minutes, it differs by 0.12 % where it is pushed in, and by 0.13 % in all but one sensor (0.7 %) else.
const LOADS: [(&str, f64, [Push; 3]); 2] = [
    (
        "normal",
        0.005,
        [
            push(0.0, 0.0, [1.0, 0.0, 0.0]),
            push(0.007_854, 0.4, [1.0, 0.0, 0.0]),
            push(0.023_708, 0.4, [1.0, 0.0, 0.0]),
        ],
    ),
    (
        "shear",
        0.02,
        [
            push(0.003, 1.5, [0.0, 0.8, -0.6]),
            push(0.006, 2.2, [0.0, 0.8, 0.6]),
            push(0.021, 0.1, [0.0, 0.6, 0.8]),
        ],
    ),
];

/// Mean stress halfway through the elastomer of a dome, bonded to its core, at several locations under pushes into and along its surface.
///
/// # Errors
///
/// [`CalculixError`] where there is no CalculiX, or it fails.
pub fn dome_cases() -> Result<Vec<Case>, CalculixError> {
    let mesh = HexMesh::dome(SHAPE.radius, SHAPE.cylinder, SHAPE.thickness, AROUND, LAYERS)?;
    let per_layer = mesh.cells.len() / LAYERS;
    let quadratic = curved(&mesh);
    let on_core = |p: &Point3<f64>| (SHAPE.depth(p) - SHAPE.thickness).abs() < 1e-7;
    let held = (0..quadratic.nodes.len())
        .filter(|&n| on_core(&quadratic.nodes[n]))
        .map(|n| (n, [true; 3]))
        .collect();
    let last_layer = per_layer * (LAYERS - 1)..mesh.cells.len();
    let (loads, shares): (Vec<Load>, Vec<Vec<Share>>) =
        LOADS.iter().map(|(.., pushes)| pushed(&quadratic, &last_layer, pushes)).unzip();
    let sensors = sensors(&quadratic, per_layer * (LAYERS / 2)..per_layer * (LAYERS / 2 + 1));
    let probes: Vec<Probe> = sensors.iter().map(|(cell, _)| probe(&quadratic, *cell)).collect();
    let model = Model {
        nodes: quadratic.nodes,
        element: "C3D20R",
        elements: quadratic.cells,
        young_modulus: YOUNG,
        poisson_ratio: POISSON,
        held,
        large: false,
        sensors: sensors.iter().map(|s| s.0).collect(),
        loads,
    };
    let answers = model.solve()?;

    let dome = Dome::new(SHAPE, POISSON, Base::Bonded, &probes)?;
    let mut cases = Vec::new();
    for (((name, tolerance, _), answer), points) in LOADS.iter().zip(&answers).zip(&shares) {
        let stress = stresses(&dome, points, sensors.len());
        let peak = stress.iter().fold(0.0f64, |peak, s| peak.max(s.abs()));
        for (k, ((_, p), &got)) in sensors.iter().zip(&stress).enumerate() {
            cases.push(Case::new(
                format!("dome-ccx-{name}-{k}"),
                format!(
                    "mean stress in a dome at ({:.1}, {:.1}, {:.1}) mm under {name} pushes",
                    p.x * 1e3,
                    p.y * 1e3,
                    p.z * 1e3
                ),
                SOURCE,
                "Pa",
                [got, answer.sensed[k]],
                (*tolerance, peak),
            ));
        }
    }
    Ok(cases)
}

/// The mesh with a node in the middle of each edge, on the shell that the edge's ends lie on, or between both.
fn curved(mesh: &HexMesh) -> Quadratic {
    let core = SHAPE.radius - SHAPE.thickness;
    let layer_of = |p: &Point3<f64>| (SHAPE.radius - SHAPE.depth(p) - core) / SHAPE.thickness * LAYERS as f64;
    Quadratic::new(mesh, |middle| {
        let half_layers = (2.0 * layer_of(&middle)).round() / 2.0;
        let radius = core + SHAPE.thickness * half_layers / LAYERS as f64;
        let axis = Vector3::new(0.0, 0.0, middle.z.min(SHAPE.cylinder));
        Point3::from(axis + (middle.coords - axis).normalize() * radius)
    })
}

/// The load of pushes at once, and what of it acts at which point of the outside.
fn pushed(quadratic: &Quadratic, outside: &Range<usize>, pushes: &[Push]) -> (Load, Vec<Share>) {
    let (mut forces, mut points) = (Vec::new(), Vec::new());
    for push in pushes {
        let centre = SHAPE.point([push.arc, push.angle]);
        let force: Vector3<f64> = frame(&centre).iter().zip(push.force).map(|(v, f)| v * f).sum();
        let (nodal, spread) = quadratic.push(outside.clone(), (centre, force), WIDTH);
        forces.extend(nodal);
        points.extend(spread);
    }
    (Load { forces, ..Load::default() }, points)
}

/// A sensor in a cell: what the points of integration say is taken as it is, because what is made of it at nodes is a guess.
fn probe(quadratic: &Quadratic, cell: usize) -> Probe {
    let points = quadratic.integration_points(cell);
    let share = 1.0 / points.len() as f64;
    points.into_iter().map(|p| (p, share)).collect()
}

/// The cells halfway that are nearest to locations of interest, and their middles.
fn sensors(quadratic: &Quadratic, halfway: Range<usize>) -> Vec<(usize, Point3<f64>)> {
    let wanted = [[0.0, 0.0], [0.007_854, 0.4], [0.0157, 0.4], [0.023_708, 0.4], [0.007_854, 2.0]];
    let middles: Vec<(usize, Point3<f64>)> = halfway
        .map(|cell| {
            let points = probe(quadratic, cell);
            (cell, Point3::from(points.iter().map(|(p, w)| p.coords * *w).sum::<Vector3<f64>>()))
        })
        .collect();
    let mut sensors = Vec::new();
    for place in wanted.map(|at| SHAPE.point(at)) {
        let far = |p: &Point3<f64>| (place + frame(&place)[0] * (SHAPE.thickness / 2.0) - p).norm();
        sensors.extend(middles.iter().min_by(|a, b| far(&a.1).total_cmp(&far(&b.1))).copied());
    }
    sensors
}

/// What this crate says of so many sensors under forces at points.
fn stresses(dome: &Dome, points: &[Share], sensors: usize) -> Vec<f64> {
    let mut stress = vec![0.0; sensors];
    let mut influence = vec![0.0; 3 * sensors];
    for (point, force) in points {
        let [arc, angle] = SHAPE.chart(point);
        influence.fill(0.0);
        dome.influence().add(arc, angle, 1.0, &mut influence);
        for (s, a) in stress.iter_mut().zip(influence.chunks_exact(3)) {
            *s += Vector3::new(a[0], a[1], a[2]).dot(force);
        }
    }
    stress
}

/// Into the surface, down along it, and around the axis.
fn frame(at: &Point3<f64>) -> [Vector3<f64>; 3] {
    let axis = Vector3::new(0.0, 0.0, at.z.min(SHAPE.cylinder));
    let out = (at.coords - axis).normalize();
    let around = Vector3::z().cross(&out).try_normalize(1e-9).unwrap_or_else(Vector3::y);
    [-out, around.cross(&out), around]
}
