//! Hexahedra of 20 nodes made from those of 8.

use std::collections::HashMap;

use nalgebra::{Point3, Vector3};

use crate::fem::HexMesh;
use crate::quadrature::gauss_legendre;

/// Edges of a cell by its corners, in CalculiX's order.
pub(super) const EDGES: [[usize; 2]; 12] =
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
/// Nodes of a cell's first side (its corners 1 to 4 and the edges between), around it.
pub(super) const FIRST_SIDE: [usize; 8] = [0, 1, 2, 3, 8, 9, 10, 11];
/// Nodes of a cell's last side (corners 5 to 8 and the edges between), around it.
pub(super) const LAST_SIDE: [usize; 8] = [4, 5, 6, 7, 12, 13, 14, 15];

/// A point and the force \[N\] that stands for what acts around it.
pub(super) type Share = (Point3<f64>, Vector3<f64>);

/// A mesh of 20-node hexahedra.
pub(super) struct Quadratic {
    /// \[m\]; those of the mesh that it was made from come first.
    pub nodes: Vec<Point3<f64>>,
    /// Nodes of each cell in CalculiX's order.
    pub cells: Vec<Vec<usize>>,
}

impl Quadratic {
    /// Adds a node to each edge of `mesh`, in its middle, moved to where `place` wants it.
    pub fn new(mesh: &HexMesh, place: impl Fn(Point3<f64>) -> Point3<f64>) -> Self {
        let mut nodes = mesh.nodes.clone();
        let mut middles: HashMap<[u32; 2], usize> = HashMap::new();
        let cells = mesh
            .cells
            .iter()
            .map(|cell| {
                let mut all: Vec<usize> = cell.iter().map(|&n| n as usize).collect();
                for [a, b] in EDGES.map(|e| e.map(|c| cell[c])) {
                    let middle = *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                        let (p, q) = (mesh.nodes[a as usize], mesh.nodes[b as usize]);
                        nodes.push(place(nalgebra::center(&p, &q)));
                        nodes.len() - 1
                    });
                    all.push(middle);
                }
                all
            })
            .collect();
        Self { nodes, cells }
    }

    /// The eight points of integration of a cell with reduced integration.
    pub fn integration_points(&self, cell: usize) -> Vec<Point3<f64>> {
        (0..8)
            .map(|k| {
                let x = corner(k).map(|c| c / 3f64.sqrt());
                let mut point = Vector3::zeros();
                for (node, n) in self.cells[cell].iter().enumerate() {
                    let place: [f64; 3] = match node {
                        0..8 => corner(node),
                        _ => {
                            let [a, b] = EDGES[node - 8].map(corner);
                            std::array::from_fn(|k| (a[k] + b[k]) / 2.0)
                        }
                    };
                    let factors: [f64; 3] = std::array::from_fn(|k| {
                        if place[k] == 0.0 { 1.0 - x[k] * x[k] } else { (1.0 + place[k] * x[k]) / 2.0 }
                    });
                    let mut value: f64 = factors.iter().product();
                    if node < 8 {
                        value *= (0..3).map(|k| place[k] * x[k]).sum::<f64>() - 2.0;
                    }
                    point += self.nodes[*n].coords * value;
                }
                Point3::from(point)
            })
            .collect()
    }

    /// Spreads a force per area over the last sides of `cells`: nodal forces that do the same work on every displacement
    /// that the elements know, and the points of integration with their share \[N\].
    pub fn spread(
        &self,
        cells: impl Iterator<Item = usize>,
        traction: impl Fn(&Point3<f64>) -> Vector3<f64>,
    ) -> (Vec<(usize, Vector3<f64>)>, Vec<Share>) {
        self.spread_over(LAST_SIDE, cells, traction)
    }

    /// The same of a push of exactly 1 N, which falls off as a Gaussian of this width \[m\] about its middle.
    pub fn push(
        &self,
        cells: impl Iterator<Item = usize>,
        (centre, force): (Point3<f64>, Vector3<f64>),
        width: f64,
    ) -> (Vec<(usize, Vector3<f64>)>, Vec<Share>) {
        let (forces, points) =
            self.spread(cells, |p| force * (-(p - centre).norm_squared() / (2.0 * width * width)).exp());
        let total: f64 = points.iter().map(|(_, f)| f.norm()).sum();
        let nodal = forces.into_iter().map(|(n, f)| (n, f / total)).collect();
        (nodal, points.into_iter().map(|(p, f)| (p, f / total)).collect())
    }

    /// The same as [`spread`](Self::spread) over another side, by its nodes: corners, then edges, around it.
    pub fn spread_over(
        &self,
        side: [usize; 8],
        cells: impl Iterator<Item = usize>,
        traction: impl Fn(&Point3<f64>) -> Vector3<f64>,
    ) -> (Vec<(usize, Vector3<f64>)>, Vec<Share>) {
        let rule: Vec<(f64, f64)> = gauss_legendre(4).iter().map(|(x, w)| (2.0 * x - 1.0, 2.0 * w)).collect();
        let mut nodal: HashMap<usize, Vector3<f64>> = HashMap::new();
        let mut points = Vec::new();
        for cell in cells {
            let side = side.map(|n| self.cells[cell][n]);
            for (x, wx) in &rule {
                for (y, wy) in &rule {
                    let shapes = serendipity(*x, *y);
                    let (mut at, mut a, mut b) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
                    for (n, [value, dx, dy]) in side.iter().zip(shapes) {
                        let p = self.nodes[*n].coords;
                        at += p * value;
                        a += p * dx;
                        b += p * dy;
                    }
                    let at = Point3::from(at);
                    let force = traction(&at) * (a.cross(&b).norm() * wx * wy);
                    for (n, [value, ..]) in side.iter().zip(shapes) {
                        *nodal.entry(*n).or_default() += force * value;
                    }
                    points.push((at, force));
                }
            }
        }
        let mut nodal: Vec<_> = nodal.into_iter().collect();
        nodal.sort_by_key(|(n, _)| *n);
        (nodal, points)
    }
}

/// Where a corner of a cell lies in the reference cell.
fn corner(k: usize) -> [f64; 3] {
    let side = |high: bool| if high { 1.0 } else { -1.0 };
    [side(matches!(k % 4, 1 | 2)), side(k % 4 > 1), side(k > 3)]
}

/// Values and slopes of the eight shape functions of a side.
pub(super) fn serendipity(x: f64, y: f64) -> [[f64; 3]; 8] {
    const NODES_AT: [[f64; 2]; 8] = [
        [-1.0, -1.0],
        [1.0, -1.0],
        [1.0, 1.0],
        [-1.0, 1.0],
        [0.0, -1.0],
        [1.0, 0.0],
        [0.0, 1.0],
        [-1.0, 0.0],
    ];
    NODES_AT.map(|[a, b]| {
        if a == 0.0 {
            let (f, g) = (1.0 - x * x, 1.0 + b * y);
            [f * g / 2.0, -x * g, f * b / 2.0]
        } else if b == 0.0 {
            let (f, g) = (1.0 + a * x, 1.0 - y * y);
            [f * g / 2.0, a * g / 2.0, -y * f]
        } else {
            let (f, g) = (1.0 + a * x, 1.0 + b * y);
            let h = a * x + b * y;
            [
                f * g * (h - 1.0) / 4.0,
                a * g * (2.0 * a * x + b * y) / 4.0,
                b * f * (a * x + 2.0 * b * y) / 4.0,
            ]
        }
    })
}
