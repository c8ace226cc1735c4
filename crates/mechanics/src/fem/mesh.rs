//! Meshes of 8-node hexahedra.

use std::f64::consts::FRAC_PI_4;

use nalgebra::{Point3, Vector3};

use crate::MechanicsError;
use crate::error::positive;

/// Points and the hexahedra between them.
#[derive(Debug, Clone, PartialEq)]
pub struct HexMesh {
    /// \[m\].
    pub nodes: Vec<Point3<f64>>,
    /// Corners of each cell: the four of one side counter-clockwise seen from the opposite one, then those opposite.
    pub cells: Vec<[u32; 8]>,
}

impl HexMesh {
    /// Boxes between the planes at `axes` \[m\], each ascending. Nodes follow x first, then y, then z.
    #[must_use]
    pub fn block(axes: [&[f64]; 3]) -> Self {
        let [nx, ny, nz] = axes.map(<[f64]>::len);
        let nodes = axes[2]
            .iter()
            .flat_map(|&z| {
                axes[1].iter().flat_map(move |&y| axes[0].iter().map(move |&x| Point3::new(x, y, z)))
            })
            .collect();
        let index = |i: usize, j: usize, k: usize| ((k * ny + j) * nx + i) as u32;
        let mut cells =
            Vec::with_capacity(nx.saturating_sub(1) * ny.saturating_sub(1) * nz.saturating_sub(1));
        for k in 1..nz {
            for j in 1..ny {
                for i in 1..nx {
                    let layer =
                        |k| [index(i - 1, j - 1, k), index(i, j - 1, k), index(i, j, k), index(i - 1, j, k)];
                    let ([a, b, c, d], [e, f, g, h]) = (layer(k - 1), layer(k));
                    cells.push([a, b, c, d, e, f, g, h]);
                }
            }
        }
        Self { nodes, cells }
    }

    /// An elastomer of `thickness` \[m\] that covers a core: both are a hemisphere on a cylinder about z, the outer
    /// one of `radius` \[m\]; the cylinder of height `cylinder` \[m\] stands on z = 0, the tip is up. The hemisphere is
    /// divided like a cube's upper half, into `4 around` quads at its equator, and the cylinder into rings of the same
    /// width; there are `layers` of cells from the core (the nodes' first layer) to the outside (their last).
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a length is not positive, or the elastomer leaves no room for the core.
    pub fn dome(
        radius: f64,
        cylinder: f64,
        thickness: f64,
        around: usize,
        layers: usize,
    ) -> Result<Self, MechanicsError> {
        positive("radius of the dome [m]", radius)?;
        positive("height of the cylinder [m]", cylinder)?;
        positive("thickness [m]", thickness)?;
        if thickness >= radius {
            return Err(MechanicsError::Value {
                quantity: "thickness [m]",
                value: thickness,
                expected: "smaller than the radius of the dome",
            });
        }
        // Whole halves of the cube's sides.
        let n = around.max(2).next_multiple_of(2);
        let layers = layers.max(1);
        let (mut surface, mut ring) = DomeSurface::cap(n, cylinder);
        let rim: Vec<Vector3<f64>> = ring.iter().map(|&i| surface.rays[i].0).collect();
        for row in 1..=n / 2 {
            // On a side of the cube, the height of the ray falls from that of its upper edge to none.
            let height = (FRAC_PI_4 * (1.0 - 2.0 * row as f64 / n as f64)).tan();
            ring = surface.add_ring(&ring, |k| {
                let edge = rim[k] / rim[k].z;
                (Vector3::new(edge.x, edge.y, height).normalize(), cylinder)
            });
        }
        let flat: Vec<Vector3<f64>> = rim.iter().map(|r| Vector3::new(r.x, r.y, 0.0).normalize()).collect();
        let rows = (cylinder / (std::f64::consts::TAU * radius / (4 * n) as f64)).round().max(1.0) as usize;
        for row in 1..=rows {
            let z = cylinder * (1.0 - row as f64 / rows as f64);
            ring = surface.add_ring(&ring, |k| (flat[k], z));
        }
        Ok(surface.thickened(radius, thickness, layers))
    }

    /// Nodes in an order of elimination that keeps factors sparse: the mesh is cut in halves again and again, and the nodes
    /// on a cut come after those of both sides. (A. George, Nested dissection of a regular finite element mesh, 1973.)
    pub(crate) fn dissect(&self) -> Vec<u32> {
        let middles: Vec<Vector3<f64>> = self
            .cells
            .iter()
            .map(|cell| cell.iter().map(|&n| self.nodes[n as usize].coords).sum::<Vector3<f64>>() / 8.0)
            .collect();
        let mut cells: Vec<u32> = (0..self.cells.len() as u32).collect();
        let mut order = Vec::with_capacity(self.nodes.len());
        let mut state = vec![Side::None; self.nodes.len()];
        self.halve(&middles, &mut cells, &mut state, &mut order);
        // What no cell has.
        order.extend((0..self.nodes.len() as u32).filter(|&n| state[n as usize] != Side::Ordered));
        order
    }

    fn halve(&self, middles: &[Vector3<f64>], cells: &mut [u32], state: &mut [Side], order: &mut Vec<u32>) {
        const SMALL: usize = 8;
        if cells.len() <= SMALL {
            for &cell in cells.iter() {
                for &n in &self.cells[cell as usize] {
                    if !matches!(state[n as usize], Side::Ordered | Side::Cut) {
                        state[n as usize] = Side::Ordered;
                        order.push(n);
                    }
                }
            }
            return;
        }
        let extents: [f64; 3] = std::array::from_fn(|axis| {
            let along = cells.iter().map(|&c| middles[c as usize][axis]);
            along.clone().fold(f64::MIN, f64::max) - along.fold(f64::MAX, f64::min)
        });
        let axis = (0..3).max_by(|&a, &b| extents[a].total_cmp(&extents[b])).unwrap_or(0);
        cells.sort_unstable_by(|&a, &b| {
            let (a, b) = (&middles[a as usize], &middles[b as usize]);
            (a[axis], a[(axis + 1) % 3], a[(axis + 2) % 3])
                .partial_cmp(&(b[axis], b[(axis + 1) % 3], b[(axis + 2) % 3]))
                .unwrap_or(std::cmp::Ordering::Equal)
        });
        // Where the halves' middles lie in one plane of cells, to its side: a cut through it would be two.
        let mut at = cells.len() / 2;
        let tolerance = 1e-6 * extents[axis];
        while at < cells.len()
            && middles[cells[at] as usize][axis] - middles[cells[at - 1] as usize][axis] < tolerance
        {
            at += 1;
        }
        if at == cells.len() {
            at = cells.len() / 2;
        }
        let (left, right) = cells.split_at_mut(at);
        for &cell in left.iter() {
            for &n in &self.cells[cell as usize] {
                if state[n as usize] == Side::None {
                    state[n as usize] = Side::Left;
                }
            }
        }
        let mut cut = Vec::new();
        for &cell in right.iter() {
            for &n in &self.cells[cell as usize] {
                if state[n as usize] == Side::Left {
                    state[n as usize] = Side::Cut;
                    cut.push(n);
                }
            }
        }
        for &cell in left.iter() {
            for &n in &self.cells[cell as usize] {
                if state[n as usize] == Side::Left {
                    state[n as usize] = Side::None;
                }
            }
        }
        self.halve(middles, left, state, order);
        self.halve(middles, right, state, order);
        for &n in &cut {
            state[n as usize] = Side::Ordered;
        }
        order.extend(cut);
    }

    /// Corners of a cell.
    pub(crate) fn corners(&self, cell: &[u32; 8]) -> [Point3<f64>; 8] {
        cell.map(|i| self.nodes[i as usize])
    }
}

/// The surface of a dome, which its elastomer repeats layer by layer.
struct DomeSurface {
    /// Directions of the surface's points, and how far down the cylinder they lie.
    rays: Vec<(Vector3<f64>, f64)>,
    quads: Vec<[usize; 4]>,
}

impl DomeSurface {
    /// The upper side of the cube, of `n` quads each way, and its rim, counter-clockwise from above.
    fn cap(n: usize, cylinder: f64) -> (Self, Vec<usize>) {
        let angle = |i: usize| ((i as f64 / n as f64) * 2.0 - 1.0) * FRAC_PI_4;
        let side = n + 1;
        let (mut rays, mut quads) = (Vec::new(), Vec::new());
        for j in 0..=n {
            for i in 0..=n {
                rays.push((Vector3::new(angle(i).tan(), angle(j).tan(), 1.0).normalize(), cylinder));
            }
        }
        for j in 0..n {
            for i in 0..n {
                let a = j * side + i;
                quads.push([a, a + 1, a + side + 1, a + side]);
            }
        }
        let mut rim: Vec<usize> = (0..n).collect();
        rim.extend((0..n).map(|j| j * side + n));
        rim.extend((0..n).map(|i| n * side + n - i));
        rim.extend((0..n).map(|j| (n - j) * side));
        (Self { rays, quads }, rim)
    }

    /// Adds a ring of quads below a ring of points; their lower points, which lie on these rays.
    fn add_ring(&mut self, above: &[usize], ray: impl Fn(usize) -> (Vector3<f64>, f64)) -> Vec<usize> {
        let count = above.len();
        let begin = self.rays.len();
        self.rays.extend((0..count).map(ray));
        let below: Vec<usize> = (begin..begin + count).collect();
        for k in 0..count {
            let next = (k + 1) % count;
            self.quads.push([above[k], below[k], below[next], above[next]]);
        }
        below
    }

    /// The mesh of `layers` of cells, the outermost nodes of which lie at `radius` \[m\] along the rays.
    fn thickened(&self, radius: f64, thickness: f64, layers: usize) -> HexMesh {
        let count = self.rays.len();
        let mut nodes = Vec::with_capacity(count * (layers + 1));
        for layer in 0..=layers {
            let r = radius - thickness * (1.0 - layer as f64 / layers as f64);
            nodes.extend(self.rays.iter().map(|(ray, z)| Point3::new(0.0, 0.0, *z) + ray * r));
        }
        let mut cells = Vec::with_capacity(self.quads.len() * layers);
        for layer in 0..layers {
            for quad in &self.quads {
                let [a, b, c, d] = quad.map(|i| (i + layer * count) as u32);
                let up = count as u32;
                cells.push([a, b, c, d, a + up, b + up, c + up, d + up]);
            }
        }
        HexMesh { nodes, cells }
    }
}

/// What is known of a node while a mesh is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    None,
    /// Of the cut in progress.
    Left,
    /// On a cut whose sides are not done.
    Cut,
    Ordered,
}

/// Corners of the reference cell, as [`HexMesh`] orders them.
pub(crate) const CORNERS: [[f64; 3]; 8] = [
    [-1.0, -1.0, -1.0],
    [1.0, -1.0, -1.0],
    [1.0, 1.0, -1.0],
    [-1.0, 1.0, -1.0],
    [-1.0, -1.0, 1.0],
    [1.0, -1.0, 1.0],
    [1.0, 1.0, 1.0],
    [-1.0, 1.0, 1.0],
];
