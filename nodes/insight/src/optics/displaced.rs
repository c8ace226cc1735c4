//! A displaced inside as the camera sees it: normals of its grid, and what each ray meets.

use nalgebra::{Point3, Vector3};

use super::casting::{Corner, Met, Sparse};
use crate::elastic::basis::{Field, Grid};

/// A corner of the displaced grid, and what its normal follows from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Turned {
    pub corner: Corner,
    /// Inwards.
    pub normal: Vector3<f64>,
    /// Of the grid itself.
    pub flat: Flat,
    /// Of the normal before it is made a unit.
    pub length: f64,
}

/// The grid at a node.
#[derive(Debug, Clone, Copy)]
pub(super) struct Flat {
    /// \[m\] between neighbours that are opposite each other.
    pub edges: [Vector3<f64>; 2],
    /// Inwards.
    pub normal: Vector3<f64>,
    /// \[m²\] of the edges' product, negative where that points outwards; 0 where they are in one line.
    pub area: f64,
}

/// What a ray meets of a displaced inside.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    pub met: Met,
    /// \[rad\] by which the ridges that it sees are others than where nothing touches.
    pub phases: [f64; 2],
    /// What is left of a wave of ridges where these change from ray to ray.
    pub left: [f64; 2],
}

/// A displaced inside. Memory that is kept from one to the next.
#[derive(Debug, Clone, Default)]
pub struct Displaced {
    /// Nodes that move by more than slightly, or have a neighbour that does.
    pub(super) near: Vec<bool>,
    /// By node.
    pub(super) corners: Sparse<Turned>,
    /// Triangles that have one of these, by their corners.
    pub(super) triangles: Vec<[usize; 3]>,
    /// By ray, of those that see another part of the inside than before.
    pub(super) hits: Sparse<Hit>,
    /// Rays beside an edge that hides something, and how much of them (0 to 1) is as their parts see it.
    pub(super) edges: Sparse<f64>,
    /// What those parts of them meet that see another part of the inside than before.
    pub(super) parts: Sparse<Met>,
}

impl Displaced {
    /// Whether a ray sees what it saw before, however that has moved.
    pub(super) fn sees_own(&self, ray: usize) -> bool {
        !self.hits.has(ray) && !self.edges.has(ray)
    }
}

/// \[m\] of a node.
pub(super) fn displacement(field: &Field, node: usize) -> Vector3<f64> {
    let u = &field.values[3 * node..3 * node + 3];
    Vector3::new(f64::from(u[0]), f64::from(u[1]), f64::from(u[2]))
}

/// Nodes above, below, left and right; at the tip, those around it.
pub(super) fn neighbours(grid: &Grid, node: usize) -> [usize; 4] {
    let Grid { rows, columns, .. } = *grid;
    let (row, column) = (node / columns, node % columns);
    if row == 0 {
        return [0, 1, 2, 3].map(|k| columns + (column + k * columns / 4) % columns);
    }
    let [left, right] = [columns - 1, 1].map(|by| row * columns + (column + by) % columns);
    [node - columns, if row + 1 < rows { node + columns } else { node }, left, right]
}

/// The neighbours of a node that are opposite each other, in pairs.
pub(super) fn across(grid: &Grid, node: usize) -> [[usize; 2]; 2] {
    let [a, b, c, d] = neighbours(grid, node);
    if node < grid.columns { [[c, a], [d, b]] } else { [[a, b], [c, d]] }
}

/// The grid at a node whose points are at `place`. The edges' product points inwards for `turn` 1 and outwards for −1; where they are in one
/// line, the normal is `like`.
pub(super) fn flat(
    grid: &Grid,
    node: usize,
    place: impl Fn(usize) -> Point3<f64>,
    (turn, like): (f64, &Vector3<f64>),
) -> Flat {
    let edges = across(grid, node).map(|[one, other]| place(other) - place(one));
    let product = edges[0].cross(&edges[1]);
    let area = product.norm() * turn;
    match area.abs() > 1e-15 {
        true => Flat { edges, normal: product / area, area },
        false => Flat { edges, normal: *like, area: 0.0 },
    }
}

/// Marks every node that moves or has a neighbour that does.
pub(super) fn moving(grid: &Grid, field: &Field, out: &mut Vec<bool>) {
    beside(grid, field, |node| field.values[3 * node..3 * node + 3] != [0.0; 3], out);
}

/// Marks every node for which `of` is true of itself or a neighbour; `of` is asked of the rows of a field only.
pub(super) fn beside(grid: &Grid, field: &Field, of: impl Fn(usize) -> bool, out: &mut Vec<bool>) {
    out.clear();
    out.resize(grid.count(), false);
    let Grid { rows, columns, .. } = *grid;
    let [first, end] = field.rows;
    let own: Vec<bool> = (first * columns..end.max(first) * columns).map(of).collect();
    let is = |node: usize| node.checked_sub(first * columns).and_then(|i| own.get(i)).is_some_and(|is| *is);
    let from = first.saturating_sub(1).min(rows) * columns;
    let to = ((end + 1).min(rows) * columns).max(from);
    for (beside, node) in out[from..to].iter_mut().zip(from..) {
        *beside = is(node) || neighbours(grid, node).into_iter().any(is);
    }
}
