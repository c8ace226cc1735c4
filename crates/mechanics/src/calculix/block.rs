//! A pad with free sides, pushed beside its middle and near its side, and touched by spheres.

use nalgebra::{Point3, Vector3};

use super::quadratic::{Quadratic, Share};
use super::{CalculixError, Load, Model, SOURCE};
use crate::fem::{Bicubic, HexMesh, Probe, free_sides};
use crate::{Base, Case, Load as Acting, Medium, SphereContact};

/// \[m\] of the pad's sides and its height.
const SIDE: f64 = 0.034;
const THICKNESS: f64 = 0.010;
const YOUNG: f64 = 70e3;
const POISSON: f64 = 0.49;
/// Cells along a side: an odd number, so that one lies in the middle.
const ALONG: u32 = 17;
/// Cells of the height: an odd number, so that sensors halfway lie in one.
const LAYERS: u32 = 5;
/// \[m\] width of the pushes.
const WIDTH: f64 = 0.002;
/// Where pushes of 1 N are \[m\], and what they do.
const PUSHES: [(&str, [f64; 2], [f64; 3]); 2] =
    [("side", [0.014, 0.002], [0.0, 0.0, -1.0]), ("corner", [0.013, 0.013], [0.6, 0.0, -0.8])];
/// Sensors lie in the cells at these numbers from the middle one, 2 mm each.
const SENSORS: [[u32; 2]; 5] = [[6, 0], [3, 1], [0, 0], [6, 6], [6, 3]];

/// \[m\] locations in the cells of cubic sensors of [`pad_readings`].
const PAD_SENSORS: [[f64; 2]; 4] = [[0.0135, 0.0005], [0.0105, 0.0005], [0.0065, 0.0005], [0.0135, 0.0055]];

/// Mean stress halfway down a bonded pad of 34 mm by 34 mm by 10 mm with free sides, pushed beside one side and in a corner.
///
/// # Errors
///
/// [`CalculixError`] where there is no CalculiX, or it fails.
pub fn block_cases() -> Result<Vec<Case>, CalculixError> {
    let planes = |from: f64, length: f64, cells: u32| -> Vec<f64> {
        (0..=cells).map(|i| from + length * f64::from(i) / f64::from(cells)).collect()
    };
    let along = planes(-SIDE / 2.0, SIDE, ALONG);
    let mesh = HexMesh::block([&along, &along, &planes(-THICKNESS, THICKNESS, LAYERS)]);
    let quadratic = Quadratic::new(&mesh, |middle| middle);
    let per_layer = (ALONG * ALONG) as usize;
    let top = per_layer * (LAYERS as usize - 1)..mesh.cells.len();
    let pushed = PUSHES.iter().map(|(_, [x, y], force)| {
        let push = (Point3::new(*x, *y, 0.0), Vector3::from(*force));
        let (forces, points) = quadratic.push(top.clone(), push, WIDTH);
        (Load { forces, ..Load::default() }, points)
    });
    let (loads, shares): (Vec<Load>, Vec<Vec<Share>>) = pushed.unzip();
    let sensors: Vec<usize> = SENSORS
        .iter()
        .map(|[i, j]| {
            let cell = |k: u32| (ALONG / 2 + k) as usize;
            per_layer * (LAYERS / 2) as usize + cell(*j) * ALONG as usize + cell(*i)
        })
        .collect();
    let probes: Vec<Probe> = sensors
        .iter()
        .map(|&cell| {
            let points = quadratic.integration_points(cell);
            let share = 1.0 / points.len() as f64;
            points.into_iter().map(|p| (p, share)).collect()
        })
        .collect();
    let held = (0..quadratic.nodes.len())
        .filter(|&n| quadratic.nodes[n].z < -THICKNESS + 1e-9)
        .map(|n| (n, [true; 3]))
        .collect();
    let model = Model {
        nodes: quadratic.nodes,
        element: "C3D20R",
        elements: quadratic.cells,
        young_modulus: YOUNG,
        poisson_ratio: POISSON,
        held,
        large: false,
        sensors,
        loads,
    };
    let answers = model.solve()?;

    let layer = Layer::new()?;
    let sides = free_sides([SIDE; 2], THICKNESS, POISSON, 0.0, &probes)?;
    let mut cases = Vec::new();
    for (((name, ..), answer), points) in PUSHES.iter().zip(&answers).zip(&shares) {
        let stress = stresses(&layer, &sides, &probes, points);
        let peak = stress.iter().fold(0.0f64, |peak, s| peak.max(s.abs()));
        for (k, ((&[i, j], &got), &reference)) in SENSORS.iter().zip(&stress).zip(&answer.sensed).enumerate()
        {
            cases.push(Case::new(
                format!("rim-ccx-{name}-{k}"),
                format!(
                    "mean stress in a pad with free sides at ({}, {}) mm, pushed at its {name}",
                    2 * i,
                    2 * j
                ),
                SOURCE,
                "Pa",
                [got, reference],
                (0.02, peak),
            ));
        }
    }
    Ok(cases)
}

/// What this crate says of each probe under forces at points: the field of a layer without end, and what its free sides change.
fn stresses(layer: &Layer, sides: &Bicubic, probes: &[Probe], points: &[Share]) -> Vec<f64> {
    let mut stress = vec![0.0; probes.len()];
    let mut change = vec![0.0; 3 * probes.len()];
    for (point, force) in points {
        change.fill(0.0);
        sides.add(point.x, point.y, 1.0, &mut change);
        for ((s, a), probe) in stress.iter_mut().zip(change.chunks_exact(3)).zip(probes) {
            *s += Vector3::new(a[0], a[1], a[2]).dot(force);
            *s += probe.iter().map(|(at, weight)| weight * layer.pressure(at, point, force)).sum::<f64>();
        }
    }
    stress
}

/// What [`pad_readings`] finds.
#[derive(Debug, Clone, PartialEq)]
pub struct PadReadings {
    /// \[m\] where the sensors are.
    pub points: Vec<Point3<f64>>,
    /// \[Pa\] of each sensor, a list a contact.
    pub stress: Vec<Vec<f64>>,
}

/// Mean stress \[Pa\] in a bonded pad of 34 mm by 34 mm by 10 mm with free sides, of the material above, under each of `contacts`
/// whose spheres' axes go through (x, 0) of the surface.
///
/// Half of the pad, by its symmetry, in 20-node hexahedra of 1 mm where it is touched and where it senses. The spheres' pressure is that
/// of the contact, on a layer without end.
///
/// # Errors
///
/// [`CalculixError`] where there is no CalculiX, or it fails.
pub fn pad_readings(contacts: &[(f64, SphereContact)]) -> Result<PadReadings, CalculixError> {
    let half = SIDE / 2.0;
    let steps = |from: f64, runs: &[(u32, f64)]| {
        let mut planes = vec![from];
        for &(count, to) in runs {
            let start = planes[planes.len() - 1];
            planes.extend((1..=count).map(|i| start + (to - start) * f64::from(i) / f64::from(count)));
        }
        planes
    };
    let xs = steps(-half, &[(11, 0.005), (12, half)]);
    let ys = steps(0.0, &[(6, 0.006), (5, half)]);
    let zs = steps(-THICKNESS, &[(3, -0.0055), (1, -0.0045), (2, -0.0025), (3, 0.0)]);
    let mesh = HexMesh::block([&xs, &ys, &zs]);
    let quadratic = Quadratic::new(&mesh, |middle| middle);
    let counts = [xs.len() - 1, ys.len() - 1];
    let top = mesh.cells.len() - counts[0] * counts[1]..mesh.cells.len();
    let middle = |planes: &[f64], i: usize| f64::midpoint(planes[i], planes[i + 1]);
    let (sensors, points) = PAD_SENSORS
        .iter()
        .map(|[x, y]| {
            let cell = |planes: &[f64], at: f64| planes.partition_point(|p| *p <= at) - 1;
            let [i, j, k] = [cell(&xs, *x), cell(&ys, *y), cell(&zs, -THICKNESS / 2.0)];
            let point = Point3::new(middle(&xs, i), middle(&ys, j), middle(&zs, k));
            ((k * counts[1] + j) * counts[0] + i, point)
        })
        .unzip();
    let loads = contacts
        .iter()
        .map(|(x, contact)| {
            let centre = Point3::new(*x, 0.0, 0.0);
            let (forces, points) = quadratic
                .spread(top.clone(), |p| -Vector3::z() * contact.surface_pressure((p - centre).norm()));
            // To exactly half of the force: the other half acts on the other half.
            let share = contact.force() / 2.0 / points.iter().map(|(_, f)| f.norm()).sum::<f64>();
            let forces = forces.into_iter().map(|(n, f)| (n, f * share)).filter(|(_, f)| f.norm() > 0.0);
            Load { forces: forces.collect(), ..Load::default() }
        })
        .collect();
    let held = quadratic.nodes.iter().enumerate();
    let model = Model {
        held: held
            .map(|(n, p)| (n, if p.z < -THICKNESS + 1e-9 { [true; 3] } else { [false, p.y < 1e-9, false] }))
            .collect(),
        nodes: quadratic.nodes,
        element: "C3D20R",
        elements: quadratic.cells,
        young_modulus: YOUNG,
        poisson_ratio: POISSON,
        large: false,
        sensors,
        loads,
    };
    let answers = model.solve()?;
    Ok(PadReadings { points, stress: answers.into_iter().map(|answer| answer.sensed).collect() })
}

/// The field of a point load on a layer without end, tabulated over the distance at the depths of the sensors' points.
struct Layer {
    /// Depth, and the readings of a force of 1 N into and along the surface at multiples of [`STEP`].
    depths: Vec<(f64, Vec<[f64; 2]>)>,
}

/// \[m\] between distances.
const STEP: f64 = 0.0002;

impl Layer {
    fn new() -> Result<Self, CalculixError> {
        let medium = Medium::layer(YOUNG, POISSON, THICKNESS, Base::Bonded)?;
        let point = Acting::Point { force: 1.0 };
        let offset = THICKNESS / f64::from(LAYERS) / 2.0 / 3f64.sqrt();
        let mut depths = Vec::new();
        for depth in [THICKNESS / 2.0 - offset, THICKNESS / 2.0 + offset] {
            let count = (2.0f64.sqrt() * SIDE / STEP).ceil() as u32 + 2;
            let readings = (0..count)
                .map(|i| {
                    let r = f64::from(i) * STEP;
                    Ok([medium.pressure(&point, depth, r)?, medium.pressure_of_shear(&point, depth, r)?])
                })
                .collect::<Result<Vec<_>, crate::MechanicsError>>()?;
            depths.push((depth, readings));
        }
        Ok(Self { depths })
    }

    fn pressure(&self, at: &Point3<f64>, from: &Point3<f64>, force: &Vector3<f64>) -> f64 {
        let (dx, dy) = (at.x - from.x, at.y - from.y);
        let r = dx.hypot(dy);
        let near = |d: &&(f64, Vec<[f64; 2]>)| (d.0 + at.z).abs() < 1e-9;
        let Some((_, readings)) = self.depths.iter().find(near) else { return f64::NAN };
        let place = (r / STEP) as usize;
        let t = r / STEP - place as f64;
        let [normal, shear] = [0, 1].map(|k| readings[place][k] * (1.0 - t) + readings[place + 1][k] * t);
        let ahead = if r > 0.0 { (force.x * dx + force.y * dy) / r } else { 0.0 };
        -force.z * normal + ahead * shear
    }
}
