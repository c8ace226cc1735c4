//! The mesh on the half section of a dome, and which displacements of its nodes are unknown in each harmonic.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;

use super::element::{NODES, quadratic};
use super::shape::DomeShape;
use crate::Base;

/// Most elements across the elastomer, along the hemisphere, along the cylinder.
const ELEMENTS_MAX: [f64; 3] = [16.0, 64.0, 96.0];

/// What becomes of one combination of a node's displacements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Role {
    /// An unknown, by number.
    Free(usize),
    /// Its value is given, by number.
    Given(usize),
    /// There is none.
    None,
}

/// Combinations of a node's displacements (radial, around, along the axis) and what becomes of each.
pub(super) type Frame = [(Vector3<f64>, Role); 3];

/// The elastomer's half section.
pub(super) struct Meridian {
    pub(super) shape: DomeShape,
    /// Elements across, and along the whole arc.
    pub(super) across: usize,
    pub(super) along: usize,
    /// Arc of each line of nodes.
    pub(super) arcs: Vec<f64>,
    /// Distance from the axis and height; from the core to the outside, line after line.
    pub(super) nodes: Vec<[f64; 2]>,
}

/// An edge of an element on the boundary: its nodes, and which way is out.
pub(super) struct Edge {
    pub(super) nodes: [usize; 3],
    pub(super) outward: f64,
}

impl Meridian {
    /// Elements of about `size` \[m\].
    pub(super) fn new(shape: DomeShape, size: f64) -> Self {
        let count = |length: f64, most: f64| (length / size).ceil().clamp(2.0, most) as usize;
        let across = count(shape.thickness, ELEMENTS_MAX[0]);
        let (over, down) =
            (count(FRAC_PI_2 * shape.radius, ELEMENTS_MAX[1]), count(shape.cylinder, ELEMENTS_MAX[2]));
        let arcs: Vec<f64> = (0..=2 * over)
            .map(|i| FRAC_PI_2 * shape.radius * i as f64 / (2 * over) as f64)
            .chain(
                (1..=2 * down)
                    .map(|i| FRAC_PI_2 * shape.radius + shape.cylinder * i as f64 / (2 * down) as f64),
            )
            .collect();
        let nodes = arcs
            .iter()
            .flat_map(|&arc| {
                (0..=2 * across).map(move |k| {
                    let r = shape.radius - shape.thickness * (1.0 - k as f64 / (2 * across) as f64);
                    let (r, z) = shape.meridian(arc, r);
                    // The tip's sine is exact, the foot's height is not.
                    [r, if arc == shape.length() { 0.0 } else { z }]
                })
            })
            .collect();
        Self { shape, across, along: over + down, arcs, nodes }
    }

    /// Nodes of a line.
    pub(super) fn line(&self) -> usize {
        2 * self.across + 1
    }

    fn element(&self, along: usize, across: usize) -> [usize; NODES] {
        std::array::from_fn(|n| (2 * along + n / 3) * self.line() + 2 * across + n % 3)
    }

    pub(super) fn elements(&self) -> impl Iterator<Item = [usize; NODES]> + '_ {
        (0..self.along).flat_map(move |i| (0..self.across).map(move |k| self.element(i, k)))
    }

    /// Edges on which stress is given: the outside, the foot, and the core where the elastomer slips on it.
    pub(super) fn edges(&self, base: Base) -> Vec<Edge> {
        let line = self.line();
        let arc = |i: usize, k: usize| [2 * i, 2 * i + 1, 2 * i + 2].map(|j| j * line + k);
        let mut edges: Vec<Edge> =
            (0..self.along).map(|i| Edge { nodes: arc(i, line - 1), outward: 1.0 }).collect();
        let foot = 2 * self.along * line;
        edges.extend(
            (0..self.across).map(|k| Edge { nodes: [0, 1, 2].map(|j| foot + 2 * k + j), outward: -1.0 }),
        );
        if base == Base::Slip {
            edges.extend((0..self.along).map(|i| Edge { nodes: arc(i, 0), outward: -1.0 }));
        }
        edges
    }

    /// Unknowns of a harmonic, how many of them, and how many displacements are given.
    pub(super) fn frames(&self, harmonic: usize, base: Base) -> (Vec<Frame>, usize, usize) {
        let [r, t, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
        let (mut free, mut given) = (0, 0);
        let frames = self
            .nodes
            .iter()
            .enumerate()
            .map(|(n, place)| {
                let on_axis = n < self.line();
                let on_core = n % self.line() == 0;
                let mut next = |role: Role| match role {
                    Role::Free(_) => {
                        free += 1;
                        Role::Free(free - 1)
                    }
                    Role::Given(_) => {
                        given += 1;
                        Role::Given(given - 1)
                    }
                    Role::None => Role::None,
                };
                let (yes, value, no) = (Role::Free(0), Role::Given(0), Role::None);
                // The mean turns nothing: without it, nothing would hold a core on which all slips.
                let around = if harmonic == 0 { no } else { yes };
                let roles = match (on_axis, on_core.then_some(base)) {
                    (_, Some(Base::Bonded)) => {
                        [(r, value), (t, if harmonic == 0 { no } else { value }), (z, value)]
                    }
                    // What is regular on the axis: along it the mean, across it the first harmonic.
                    (true, _) => match harmonic {
                        0 => [(r, no), (t, no), (z, if on_core { value } else { yes })],
                        1 => [(r - t, yes), (t, no), (z, no)],
                        _ => [(r, no), (t, no), (z, no)],
                    },
                    (false, Some(Base::Slip)) => {
                        let normal = self.outward(place);
                        [(normal, value), (t, around), (t.cross(&normal), yes)]
                    }
                    (false, None) => [(r, yes), (t, around), (z, yes)],
                };
                roles.map(|(vector, role)| (vector, next(role)))
            })
            .collect();
        (frames, free, given)
    }

    /// Away from the core, across its surface.
    fn outward(&self, place: &[f64; 2]) -> Vector3<f64> {
        Vector3::new(place[0], 0.0, (place[1] - self.shape.cylinder).max(0.0)).normalize()
    }

    /// First of the three outer nodes around an arc (the next ones follow a line later), and their weights.
    pub(super) fn on_outside(&self, arc: f64) -> (usize, [f64; 3]) {
        let element =
            self.arcs.iter().step_by(2).skip(1).position(|&end| arc <= end).unwrap_or(self.along - 1);
        let (low, high) = (self.arcs[2 * element], self.arcs[2 * element + 2]);
        let xi = 2.0 * (arc - low) / (high - low) - 1.0;
        (2 * element * self.line() + self.line() - 1, quadratic(xi).map(|(value, _)| value))
    }
}
