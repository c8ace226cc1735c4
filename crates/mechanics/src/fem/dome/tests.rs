use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3};

use super::*;
use crate::fem::{HexMesh, Solid};

const SHAPE: DomeShape = DomeShape { radius: 0.010, cylinder: 0.016, thickness: 0.0072 };
const NU: f64 = 0.49;

fn ring(angle_from_tip: f64, turn: f64) -> Probe {
    let r = 0.0064;
    vec![(
        Point3::new(
            r * angle_from_tip.sin() * turn.cos(),
            r * angle_from_tip.sin() * turn.sin(),
            0.016 + r * angle_from_tip.cos(),
        ),
        1.0,
    )]
}

fn probes() -> Vec<Probe> {
    let low = vec![(Point3::new(0.0, 0.0064, 0.008), 1.0)];
    vec![ring(0.0, 0.0), ring(1.0, 0.3), ring(1.0, 1.5), low]
}

fn at(dome: &Dome, arc: f64, angle: f64) -> Vec<f64> {
    let mut out = vec![0.0; dome.influence().width()];
    dome.influence().add(arc, angle, 1.0, &mut out);
    out
}

/// Largest difference between two domes' influences over the outside, relative to the peak, of each component.
fn difference(a: &Dome, b: &Dome) -> f64 {
    let width = a.influence().width();
    let (mut worst, mut peak) = (vec![0.0f64; width], vec![0.0f64; width]);
    for i in 0..63 {
        for j in 0..63 {
            let (arc, angle) = (SHAPE.length() * f64::from(i) / 62.0, TAU * f64::from(j) / 62.0);
            for (k, (a, b)) in at(a, arc, angle).iter().zip(at(b, arc, angle)).enumerate() {
                worst[k] = worst[k].max((a - b).abs());
                peak[k] = peak[k].max(b.abs());
            }
        }
    }
    worst.iter().zip(&peak).map(|(w, p)| w / p).fold(0.0, f64::max)
}

#[test]
fn finer_elements_change_little() {
    for base in [Base::Bonded, Base::Slip] {
        let dome = Dome::new(SHAPE, NU, base, &probes()).unwrap();
        let fine = Resolution { elements: 8.0, points: 12.0, left: 1e-6 };
        let fine = Dome::resolved(SHAPE, NU, base, &probes(), &fine).unwrap();
        let difference = difference(&dome, &fine);
        assert!(difference < 0.003, "{base:?}: {difference}");
    }
}

#[test]
fn an_almost_incompressible_dome_does_not_lock() {
    let at = |poisson| Dome::new(SHAPE, poisson, Base::Bonded, &probes()).unwrap();
    let difference = difference(&at(0.499), &at(0.4999));
    assert!(difference < 0.01, "{difference}");
}

/// Hexahedra know nothing of harmonics, of sources, or of charts.
#[test]
fn hexahedra_agree() {
    let (around, layers) = (12, 6);
    let mesh = HexMesh::dome(SHAPE.radius, SHAPE.cylinder, SHAPE.thickness, around, layers).unwrap();
    let surface = mesh.nodes.len() / (layers + 1);
    let middle = |cell: usize| {
        let corners = mesh.corners(&mesh.cells[cell]);
        Point3::from(corners.iter().map(|c| c.coords).sum::<Vector3<f64>>() / 8.0)
    };
    // The cells around a node halfway: over the tip, on the hemisphere, on the cylinder.
    let sensors: Vec<Vec<(usize, f64)>> = [[0.0, 0.0], [0.008, 0.5], [0.023, 2.0]]
        .iter()
        .map(|&place| {
            let outside = SHAPE.point(place);
            let inside = outside - SHAPE.normal(&outside) * (SHAPE.thickness / 2.0);
            let mut near: Vec<usize> = (0..mesh.cells.len()).collect();
            near.sort_by(|a, b| (middle(*a) - inside).norm().total_cmp(&(middle(*b) - inside).norm()));
            near.truncate(8);
            near.into_iter().map(|cell| (cell, 0.125)).collect()
        })
        .collect();
    let probes: Vec<Probe> =
        sensors.iter().map(|s| s.iter().map(|&(cell, weight)| (middle(cell), weight)).collect()).collect();
    let outer = mesh.nodes.len() - surface..mesh.nodes.len();
    // Pushes as wide as a fingertip, into the surface and along it.
    let loads: Vec<Vec<(usize, Vector3<f64>)>> = [
        ([0.0, 0.0], [0.0, 0.0, -1.0]),
        ([0.009, 0.6], [-0.5, -0.3, -0.8]),
        ([0.021, 2.2], [0.6, -0.6, 0.5]),
    ]
    .into_iter()
    .map(|(place, force)| {
        let centre = SHAPE.point(place);
        let weight = |n: usize| (-(mesh.nodes[n] - centre).norm_squared() / (2.0 * 0.003f64.powi(2))).exp();
        let total: f64 = outer.clone().map(weight).sum();
        outer.clone().map(|n| (n, Vector3::from(force) * (weight(n) / total))).collect()
    })
    .collect();
    let solid = Solid::new(mesh.clone(), 1.0, NU, |n, _| [n < surface; 3]).unwrap();
    let moved = solid.displacements(&loads);
    let dome = Dome::new(SHAPE, NU, Base::Bonded, &probes).unwrap();
    for (load, moved) in loads.iter().zip(&moved) {
        let mut ours = [0.0; 9];
        for (n, force) in load {
            let [arc, angle] = SHAPE.chart(&mesh.nodes[*n]);
            for (k, a) in at(&dome, arc, angle).iter().enumerate() {
                ours[k] += a * force[k % 3];
            }
        }
        let ours: Vec<f64> = ours.chunks(3).map(|c| c.iter().sum()).collect();
        let theirs: Vec<f64> = sensors
            .iter()
            .map(|s| s.iter().map(|&(cell, weight)| weight * solid.pressure(cell, moved)).sum())
            .collect();
        let peak = ours.iter().fold(0.0f64, |p, v| p.max(v.abs()));
        for (a, b) in ours.iter().zip(&theirs) {
            assert!((a - b).abs() < 0.03 * peak, "{ours:?} {theirs:?}");
        }
    }
}

#[test]
fn chart_and_point_agree() {
    for place in [[0.001, 0.1], [0.015, 3.0], [0.0157, 6.2], [0.02, 4.0], [0.0317, 0.0]] {
        let [arc, angle] = SHAPE.chart(&SHAPE.point(place));
        assert!((arc - place[0]).abs() < 1e-12 && (angle - place[1]).abs() < 1e-12);
        assert!(SHAPE.depth(&SHAPE.point(place)).abs() < 1e-12);
    }
}

#[test]
fn impossible_domes_are_refused() {
    let refused = |shape, z| {
        Dome::new(shape, NU, Base::Bonded, &[vec![(Point3::new(0.0, 0.0, z), 1.0)]]).unwrap_err().to_string()
    };
    insta::assert_snapshot!(refused(SHAPE, 0.0184), @"distance of a sensor from the nearest side of the elastomer [m] is -0.00040000000000000105 and must be at least a twentieth of its thickness");
    insta::assert_snapshot!(refused(DomeShape { thickness: 0.01, ..SHAPE }, 0.02), @"thickness [m] is 0.01 and must be smaller than the radius of the dome");
    insta::assert_snapshot!(refused(DomeShape { cylinder: -1.0, ..SHAPE }, 0.02), @"height of the cylinder [m] is -1 and must be a positive number");
}
