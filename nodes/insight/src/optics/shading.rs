//! The inside in its grid: where it is, how it is lit, and how its looks change where it moves.
//!
//! A picture is a matter of rays: each node of the untouched grid stands for the ray from the camera through it. Where the inside moves,
//! the ray meets another part of it ([`casting`](super::casting)), which is lit by its own place and normal; both are interpolated over a
//! triangle of the grid (B. T. Phong, *Communications of the ACM*, 1975). The normal of a corner is that of the displaced grid.
//!
//! Where little moves, that is in proportion: a displacement u moves the ray's end by t = u·n / d·n along the ray, d its direction, so that it
//! sees the part that was at t d − u beside, with the normal there.
//!
//! Ridges are too fine for the grid. What a displacement does to them is that they move: a pixel then sees another phase of them. Where phases
//! change by much from ray to ray, pixels between see all of them, and nothing is left of a wave in the mean.
//!
//! Assumptions: no shadows; ridges are lit as on the untouched inside, and no closer where the inside stretches.
//!
//! Cost: nodes that neither move nor have a neighbour that does are skipped; a lighting for any other, and a product of 15 × 3 numbers where it moves
//! so little that its looks change in proportion, after a table that takes 0.1 s once.

use std::sync::OnceLock;

use nalgebra::{Matrix3, Point3, Vector3};

use super::casting::{Corner, Met, Rays, towards};
use super::displaced::{self, Displaced, Turned, across, displacement, flat, neighbours};
use super::lens::Camera;
use super::light::{COLOURS, Light};
use super::ridges::{Phases, Ridges};
use super::visibility::{PARTS, part};
use crate::elastic::basis::{Field, Grid};
use crate::elastic::mesh::Elastomer;

/// Least cosine between ray and normal: rays that graze the surface see it move no further than this lets them.
pub(super) const GRAZING: f64 = 0.05;

/// What is known of a node of the grid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub(super) position: Point3<f64>,
    /// Inwards.
    pub(super) normal: Vector3<f64>,
    /// Of the grid itself, which differs from the surface's by its cells.
    pub(super) of_grid: Vector3<f64>,
    /// 1 where the product of the edges between neighbours points inwards, −1 where it points outwards.
    turn: f64,
    /// How the normal changes beside it, per metre.
    bends: Matrix3<f64>,
    /// Of ridges.
    pub(super) along: Phases,
    /// \[m\] that it and its neighbours move at most for its colours to change in proportion.
    pub(super) slight: f32,
    /// What its ray meets of the untouched inside.
    pub(super) met: Met,
}

/// The lit inside.
#[derive(Debug, Clone)]
pub struct Shading {
    pub(super) grid: Grid,
    pub(super) nodes: Vec<Node>,
    pub(super) rays: Rays,
    /// What a picture says of each ray where nothing moves.
    pub(super) seen: Vec<[f32; COLOURS]>,
    /// Parts of each ray, [`PARTS`] of them, where they end if nothing moves, and what a picture says of them then.
    pub(super) parts: Rays,
    pub(super) untouched: Vec<Met>,
    pub(super) seen_in_parts: Vec<[f32; COLOURS]>,
    /// Whether a ray differs from the mean of its parts where nothing moves.
    pub(super) uneven: Vec<bool>,
    pub(super) light: Light,
    /// \[rad\] from row to row and from column to column.
    pub(super) ridges: [f64; 2],
    /// What a node says more for each metre that it and its neighbours move; made by the first that asks.
    slopes: OnceLock<Vec<Slopes>>,
}

/// Changes of colours, and of ridges.
pub(super) fn with_ridges([red, green, blue]: [f32; COLOURS], ridges: [f64; 2]) -> [f32; CHANGES] {
    let [along, around] = ridges.map(|v| v as f32);
    [red, green, blue, along, around]
}

/// Of a node and its [`neighbours`], along x, y, z of each: changes of the colours.
type Slopes = [[f32; COLOURS]; 3 * MOVING];
/// A node and its neighbours.
const MOVING: usize = 5;
/// \[m\] by which nodes are moved for their slopes.
const SLIGHTLY: f64 = 1e-5;
/// Share of the way between its neighbours that a node and these move along x, y and z at most for its colours to change in proportion. The inside
/// then turns by a hundredth of a radian or so, also at the tip, where meridians meet.
const SLIGHT: f64 = 4e-3;

/// Changes of colours by node, a column more than the grid has: the last is the first again. And the rows that have any.
#[derive(Debug, Clone, Default)]
pub struct Changes {
    /// Row by row: of each colour, and of ridges' phases, as the sine of how far those that are seen are from those that were.
    pub values: Vec<[f32; CHANGES]>,
    /// First row, and the one after the last.
    pub rows: [usize; 2],
    /// Nodes whose rows and columns (of the grid with one column more) have a value.
    pub nodes: Vec<u32>,
}

/// Numbers of a node that changes.
pub const CHANGES: usize = COLOURS + 2;

impl Changes {
    pub(super) fn clear(&mut self, grid: &Grid) {
        let size = grid.rows * (grid.columns + 1);
        if self.values.len() == size {
            for node in self.nodes.drain(..) {
                self.values[node as usize] = [0.0; CHANGES];
            }
        } else {
            self.values.clear();
            self.values.resize(size, [0.0; CHANGES]);
            self.nodes.clear();
        }
        self.rows = [grid.rows, 0];
    }

    pub(super) fn set(&mut self, grid: &Grid, node: usize, value: [f32; CHANGES]) {
        let (row, column) = (node / grid.columns, node % grid.columns);
        let wide = grid.columns + 1;
        self.values[row * wide + column] = value;
        self.nodes.push((row * wide + column) as u32);
        if column == 0 {
            self.values[row * wide + grid.columns] = value;
            self.nodes.push((row * wide + grid.columns) as u32);
        }
        self.rows = [self.rows[0].min(row), self.rows[1].max(row + 1)];
    }
}

/// The point of the inside at (s, φ), and its inward normal.
#[must_use]
pub fn inside(elastomer: &Elastomer, s: f64, azimuth: f64) -> (Point3<f64>, Vector3<f64>) {
    let at = |s: f64, azimuth: f64| {
        elastomer.thumb.point(s.max(0.0), azimuth, elastomer.thickness_at(s.max(0.0), azimuth)).0
    };
    let (p, outwards) = elastomer.thumb.point(s, azimuth, elastomer.thickness_at(s, azimuth));
    if elastomer.fovea.is_none() || elastomer.thickness_at(s, azimuth) >= elastomer.thickness {
        return (p, -outwards);
    }
    // Where the thickness changes, the inside is no parallel of the outside.
    let (ds, turn) = (5e-5, 5e-5 / elastomer.thumb.meridian(s, 0.0)[0].max(1e-3));
    let down = at(s + ds, azimuth) - at(s - ds, azimuth);
    let around = at(s, azimuth + turn) - at(s, azimuth - turn);
    (
        p,
        around
            .cross(&down)
            .try_normalize(1e-15)
            .map_or(-outwards, |n| if n.dot(&outwards) > 0.0 { -n } else { n }),
    )
}

impl Shading {
    /// The inside of an elastomer, lit and seen.
    #[must_use]
    pub fn new(
        elastomer: &Elastomer,
        grid: Grid,
        camera: &Camera,
        light: Light,
        ridges: Option<&Ridges>,
    ) -> Self {
        let node = |node: usize| {
            let [s, azimuth] = grid.place(node);
            let (position, normal) = inside(elastomer, s, azimuth);
            let none = [Vector3::zeros(); 2];
            let along = ridges.map_or(none, |ridges| ridges.phases(elastomer, [s, azimuth], &normal).1);
            let met = Met {
                depth: (position - camera.position).norm(),
                corners: [node; 3],
                shares: [1.0, 0.0, 0.0],
            };
            Node {
                position,
                normal,
                of_grid: normal,
                turn: 1.0,
                bends: Matrix3::zeros(),
                along,
                slight: 0.0,
                met,
            }
        };
        let nodes: Vec<Node> = (0..grid.count()).map(node).collect();
        let through = |i: usize| {
            let [s, azimuth] = part(&grid, i / PARTS, i % PARTS);
            towards(&camera.position, &inside(elastomer, s, azimuth).0)
        };
        let parts = (0..grid.count() * PARTS).map(through).collect();
        let directions = nodes.iter().map(|node| towards(&camera.position, &node.position)).collect();
        let mut shading = Self {
            grid,
            nodes,
            rays: Rays::new(camera.position, directions),
            seen: Vec::new(),
            parts: Rays::new(camera.position, parts),
            untouched: Vec::new(),
            seen_in_parts: Vec::new(),
            uneven: Vec::new(),
            light,
            ridges: ridges.map_or([0.0; 2], |ridges| ridges.per_cell(&grid)),
            slopes: OnceLock::new(),
        };
        shading.know_neighbours();
        shading.see_untouched();
        shading
    }

    /// Completes what nodes have of their neighbours.
    fn know_neighbours(&mut self) {
        let of = |node: usize| {
            let Node { normal, .. } = &self.nodes[node];
            let mut flat = flat(&self.grid, node, |node| self.nodes[node].position, (1.0, normal));
            let turn = if flat.normal.dot(normal) < 0.0 { -1.0 } else { 1.0 };
            flat.normal *= turn;
            let turns = across(&self.grid, node)
                .map(|[one, other]| self.nodes[other].normal - self.nodes[one].normal);
            // The vector that has a product of 1 with one edge, and none with the other nor with the normal.
            let dual = |own: &Vector3<f64>, other: &Vector3<f64>| {
                let across = other.cross(normal);
                let product = own.dot(&across);
                if product.abs() > 1e-15 { across / product } else { Vector3::zeros() }
            };
            let [first, second] = &flat.edges;
            let bends =
                turns[0] * dual(first, second).transpose() + turns[1] * dual(second, first).transpose();
            (flat.normal, turn, bends, (SLIGHT * first.norm().min(second.norm())) as f32)
        };
        let known: Vec<_> = (0..self.nodes.len()).map(of).collect();
        for (node, (of_grid, turn, bends, slight)) in self.nodes.iter_mut().zip(known) {
            (node.of_grid, node.turn, node.bends, node.slight) = (of_grid, turn, bends, slight);
        }
    }

    /// The same with light that the inside has reflected once: a share of the mean light on it, everywhere alike.
    #[must_use]
    pub fn lit(
        elastomer: &Elastomer,
        grid: Grid,
        camera: &Camera,
        mut light: Light,
        (ambient, ridges): (f64, Option<&Ridges>),
    ) -> Self {
        let (mut sum, mut area) = ([0.0; COLOURS], 0.0);
        for node in 0..grid.count() {
            let [s, azimuth] = grid.place(node);
            let (p, normal) = inside(elastomer, s, azimuth);
            let around = p.x.hypot(p.y);
            area += around;
            for lamp in &light.lamps {
                let by = light.finish.diffuse * around * light.irradiance(lamp, &p, &normal);
                sum.iter_mut().zip(lamp.power).for_each(|(sum, power)| *sum += power * by);
            }
        }
        light.ambient = sum.map(|sum| ambient * sum / area);
        Self::new(elastomer, grid, camera, light, ridges)
    }

    /// Adds what the whole skeleton gives way, clamped at its base: `top` \[m\] at the highest point, with the square of the height.
    pub fn sway(&self, top: &Vector3<f64>, field: &mut Field) {
        let highest = self.nodes.first().map_or(1.0, |node| node.position.z);
        for (u, node) in field.values.as_chunks_mut::<3>().0.iter_mut().zip(&self.nodes) {
            let share = (node.position.z / highest).max(0.0).powi(2);
            u[0] += (top.x * share) as f32;
            u[1] += (top.y * share) as f32;
        }
        field.rows = [0, self.grid.rows];
    }

    /// What lights it.
    #[must_use]
    pub fn light(&self) -> &Light {
        &self.light
    }

    /// Its grid.
    #[must_use]
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Changes of what a picture says, by node, where the inside is displaced; `displaced` becomes what rays meet then.
    pub fn changes(&self, field: &Field, displaced: &mut Displaced, out: &mut Changes) {
        out.clear(&self.grid);
        self.see(field, displaced);
        for (node, hit) in displaced.hits.places.iter().zip(&displaced.hits.values) {
            let node = *node as usize;
            let whole = self.lit_at(&self.rays.directions[node], &hit.met, displaced);
            let whole = std::array::from_fn(|c| whole[c] - self.seen[node][c]);
            let ridges = std::array::from_fn(|k| hit.left[k] * hit.phases[k].sin());
            out.set(&self.grid, node, with_ridges(self.with_parts(node, whole, displaced), ridges));
        }
        let mut moving = Vec::new();
        displaced::moving(&self.grid, field, &mut moving);
        let changes = |node: usize| moving[node] || displaced.edges.has(node);
        for node in (0..moving.len()).filter(|node| changes(*node) && !displaced.hits.has(*node)) {
            let whole = self.by_slopes(node, field);
            let ridges = self.phases(node, &displacement(field, node)).map(f64::sin);
            out.set(&self.grid, node, with_ridges(self.with_parts(node, whole, displaced), ridges));
        }
    }

    /// Changes of the colours of a ray, of which the parts have so much as it is beside an edge.
    fn with_parts(&self, node: usize, whole: [f32; COLOURS], displaced: &Displaced) -> [f32; COLOURS] {
        let Some(sharp) = displaced.edges.get(node) else { return whole };
        let mut change = whole.map(|v| v * (1.0 - *sharp) as f32);
        let share = (*sharp / PARTS as f64) as f32;
        for part in node * PARTS..(node + 1) * PARTS {
            let Some(met) = displaced.parts.get(part) else { continue };
            let seen = self.lit_at(&self.parts.directions[part], met, displaced);
            let before = &self.seen_in_parts[part];
            let both = seen.iter().zip(before);
            change.iter_mut().zip(both).for_each(|(sum, (now, then))| *sum += share * (now - then));
        }
        change
    }

    /// Changes of a node's colours, to first order, where nodes are displaced by `by`.
    pub(super) fn by_slopes(&self, node: usize, by: &Field) -> [f32; COLOURS] {
        let slopes =
            self.slopes.get_or_init(|| (0..self.nodes.len()).map(|node| self.slopes_of(node)).collect());
        let mut value = [0.0; COLOURS];
        let moving = [node].into_iter().chain(neighbours(&self.grid, node));
        for (of, slopes) in moving.zip(slopes[node].as_chunks::<3>().0) {
            for (u, slope) in by.values[3 * of..3 * of + 3].iter().zip(slopes) {
                value.iter_mut().zip(slope).for_each(|(value, slope)| *value += u * slope);
            }
        }
        value
    }

    /// A node of the displaced grid.
    pub(super) fn turned(&self, field: &Field, node: usize) -> Turned {
        let place = |node: usize| self.nodes[node].position + displacement(field, node);
        let Node { normal, of_grid: like, turn, .. } = &self.nodes[node];
        let flat = flat(&self.grid, node, place, (*turn, like));
        let position = place(node);
        let turned = normal + flat.normal - like;
        let length = turned.norm();
        let (normal, length) = if length > 1e-9 { (turned / length, length) } else { (*normal, 1.0) };
        let corner = Corner { node, position, in_picture: self.rays.place(&position) };
        Turned { corner, normal, flat, length }
    }

    /// What a picture says of what a ray meets.
    pub(super) fn lit_at(
        &self,
        direction: &Vector3<f64>,
        met: &Met,
        displaced: &Displaced,
    ) -> [f32; COLOURS] {
        let normal = normal_at(met, displaced).try_normalize(1e-9);
        self.colour(direction, met.depth, &normal.unwrap_or(-direction))
    }

    /// What a picture says of a ray that ends at a depth \[m\] where the inside has a unit normal.
    pub(super) fn colour(
        &self,
        direction: &Vector3<f64>,
        depth: f64,
        normal: &Vector3<f64>,
    ) -> [f32; COLOURS] {
        let end = self.rays.camera + direction * depth;
        self.light.seen(self.light.radiance(&end, normal, &-direction))
    }

    /// What a picture says of a node where it and its neighbours are displaced, as long as its ray ends beside it.
    fn colours_beside(&self, ray: usize, moved: impl Fn(usize) -> Vector3<f64>) -> [f32; COLOURS] {
        let Node { normal, of_grid: like, turn, bends, met, .. } = &self.nodes[ray];
        let place = |node: usize| self.nodes[node].position + moved(node);
        let of_grid = flat(&self.grid, ray, place, (*turn, like)).normal;
        let (on, beside) = self.further(ray, &moved(ray));
        let turned = (normal + of_grid - like + bends * beside).try_normalize(1e-9).unwrap_or(*normal);
        self.colour(&self.rays.directions[ray], met.depth + on, &turned)
    }

    /// \[m\] by which a ray ends further on where its node is displaced, and from which place beside it what it then sees has come.
    fn further(&self, ray: usize, u: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (direction, normal) = (&self.rays.directions[ray], &self.nodes[ray].normal);
        let on = u.dot(normal) / direction.dot(normal).min(-GRAZING);
        (on, direction * on - u)
    }

    /// \[rad\] from the ridges that a ray sees of an untouched inside to those that it sees where its node is displaced, to first order.
    pub(super) fn phases(&self, ray: usize, u: &Vector3<f64>) -> [f64; 2] {
        let (_, beside) = self.further(ray, u);
        self.nodes[ray].along.map(|along| beside.dot(&along))
    }

    /// \[rad\] from the ridges that a ray sees of an untouched inside to those of what it meets.
    pub(super) fn other_phases(&self, ray: usize, met: &Met) -> [f64; 2] {
        let rows_and_columns = met.corners.map(|corner| self.cells_from(ray, corner));
        std::array::from_fn(|k| {
            let cells: f64 = rows_and_columns.iter().zip(met.shares).map(|(by, share)| by[k] * share).sum();
            self.ridges_change(ray, k) * cells
        })
    }

    /// \[rad\] by which ridges change from a row or a column to the next, where a ray sees any.
    pub(super) fn ridges_change(&self, ray: usize, k: usize) -> f64 {
        if self.nodes[ray].along[k] == Vector3::zeros() { 0.0 } else { self.ridges[k] }
    }

    /// Rows and columns from one node to another.
    pub(super) fn cells_from(&self, from: usize, to: usize) -> [f64; 2] {
        let columns = self.grid.columns;
        let around = (to % columns + columns + columns / 2 - from % columns) % columns;
        [(to / columns) as f64 - (from / columns) as f64, around as f64 - (columns / 2) as f64]
    }

    fn slopes_of(&self, node: usize) -> Slopes {
        let mut slopes = [[0.0; COLOURS]; 3 * MOVING];
        if self.nodes[node].met.corners[0] != node {
            return slopes;
        }
        let [a, b, c, d] = neighbours(&self.grid, node);
        let moving = [node, a, b, c, d];
        for (i, of) in moving.into_iter().enumerate() {
            // The last row has no neighbour below, and names itself.
            if moving[..i].contains(&of) {
                continue;
            }
            for axis in 0..3 {
                let at = |by: f64| {
                    let mut u = Vector3::zeros();
                    u[axis] = by;
                    self.colours_beside(node, |node| if node == of { u } else { Vector3::zeros() })
                };
                let (more, less) = (at(SLIGHTLY), at(-SLIGHTLY));
                slopes[3 * i + axis] =
                    std::array::from_fn(|c| (f64::from(more[c] - less[c]) / (2.0 * SLIGHTLY)) as f32);
            }
        }
        slopes
    }
}

/// The normal where a ray ends, before it is made a unit.
pub(super) fn normal_at(met: &Met, displaced: &Displaced) -> Vector3<f64> {
    let normal = |corner: &usize| displaced.corners.get(*corner).map_or_else(Vector3::zeros, |of| of.normal);
    met.corners.iter().zip(met.shares).map(|(corner, share)| normal(corner) * share).sum()
}

#[cfg(test)]
mod tests;
