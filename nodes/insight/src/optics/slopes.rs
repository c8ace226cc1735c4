//! How the looks of a displaced inside change where it is displaced by a little more.
//!
//! The chain rule, ray by ray. A triangle that is displaced by u where a ray meets it moves the ray's end by t = u·m / d·m, m the triangle's own
//! normal and d the ray's direction; the ray then meets what was at t d − u beside. The normal there changes by what corners turn, and by what the
//! normals of the corners differ. How colours change with depth and with the normal is found by differences once for a displaced inside.
//!
//! Assumptions: what hides something hides it still. Cost: four lightings for each ray once, and some sums for each way in which the inside moves on.

use dermis_model::tangents;
use nalgebra::Vector3;

use super::casting::{Met, Sparse};
use super::displaced::{self, Displaced, Flat, Turned, across, displacement};
use super::light::COLOURS;
use super::shading::{CHANGES, Changes, Shading, normal_at, with_ridges};
use super::visibility::PARTS;
use crate::elastic::basis::{Field, Grid};

/// \[m\] and \[rad\] by which an end of a ray is moved and turned for a difference.
const ON: f64 = 1e-5;
const TURN: f64 = 1e-3;

/// How what a ray sees changes.
#[derive(Debug, Clone, Copy)]
struct Ray {
    node: usize,
    direction: Vector3<f64>,
    /// Nodes of the triangle, and how much of each.
    corners: [usize; 3],
    shares: [f64; 3],
    /// Of colours, per metre along the ray, and per radian about both tangents of the normal.
    by_depth: [f64; COLOURS],
    by_turn: [[f64; COLOURS]; 2],
    tangents: [Vector3<f64>; 2],
    /// \[m\] along the ray for each metre that the triangle is displaced.
    on: Vector3<f64>,
    /// Shares of the second and third corner for each metre beside.
    beside: [Vector3<f64>; 2],
    /// Of normals before they are made a unit.
    length: f64,
    /// What ridges' sines change by for each row and column.
    by_cells: [f64; 2],
}

/// What a corner does as the inside moves on.
#[derive(Debug, Clone, Copy)]
struct Shift {
    by: Vector3<f64>,
    turn: Vector3<f64>,
}

/// How the looks of a displaced inside change, ray by ray; with memory for one way in which it moves on.
#[derive(Debug, Clone, Default)]
pub struct Linear {
    rays: Vec<Ray>,
    /// Nodes that move on, or have a neighbour that does.
    moving: Vec<bool>,
    shifts: Sparse<Shift>,
}

impl Shading {
    /// How the looks of a displaced inside change, which [`changes`](Self::changes) has seen.
    pub fn linearise(&self, displaced: &Displaced, out: &mut Linear) {
        out.rays.clear();
        for (node, hit) in displaced.hits.places.iter().zip(&displaced.hits.values) {
            let node = *node as usize;
            let by_cells =
                std::array::from_fn(|k| hit.left[k] * hit.phases[k].cos() * self.ridges_change(node, k));
            // Beside an edge, its parts have a share in the colours.
            let share = 1.0 - displaced.edges.get(node).copied().unwrap_or(0.0);
            let direction = &self.rays.directions[node];
            out.rays.extend(self.ray((node, direction), (&hit.met, displaced), (share, by_cells)));
            self.linearise_parts(node, displaced, &mut out.rays);
        }
        for node in displaced.edges.places.iter().map(|node| *node as usize) {
            if !displaced.hits.has(node) {
                self.linearise_parts(node, displaced, &mut out.rays);
            }
        }
    }

    /// How what the parts of a ray see changes, if it is beside an edge.
    fn linearise_parts(&self, node: usize, displaced: &Displaced, out: &mut Vec<Ray>) {
        let Some(sharp) = displaced.edges.get(node) else { return };
        for part in node * PARTS..(node + 1) * PARTS {
            let Some(met) = displaced.parts.get(part) else { continue };
            let direction = &self.parts.directions[part];
            let share = sharp / PARTS as f64;
            out.extend(self.ray((node, direction), (met, displaced), (share, [0.0; 2])));
        }
    }

    /// How `share` of what a ray of a node sees changes.
    fn ray(
        &self,
        (node, direction): (usize, &Vector3<f64>),
        (met, displaced): (&Met, &Displaced),
        (share, by_cells): (f64, [f64; 2]),
    ) -> Option<Ray> {
        let [a, b, c] = corners_of(met.corners, displaced)?.map(|of| of.corner.position);
        let (first, second) = (b - a, c - a);
        let flat = first.cross(&second);
        let facing = flat.dot(direction);
        let raw = normal_at(met, displaced);
        let length = raw.norm();
        if facing == 0.0 || length < 1e-9 {
            return None;
        }
        let normal = raw / length;
        let seen = self.colour(direction, met.depth, &normal);
        let per = |other: [f32; COLOURS], by: f64| -> [f64; COLOURS] {
            std::array::from_fn(|c| share * f64::from(other[c] - seen[c]) / by)
        };
        let tangents = tangents(&normal);
        let turned = |by: Vector3<f64>| self.colour(direction, met.depth, &(normal + by * TURN).normalize());
        Some(Ray {
            node,
            direction: *direction,
            corners: met.corners,
            shares: met.shares,
            by_depth: per(self.colour(direction, met.depth + ON, &normal), ON),
            by_turn: tangents.map(|tangent| per(turned(tangent), TURN)),
            tangents,
            on: flat / facing,
            beside: [second.cross(&flat), flat.cross(&first)].map(|dual| dual / flat.norm_squared()),
            length,
            by_cells,
        })
    }

    /// How changes change, to first order, where the displacements `field` of the inside change by `by`.
    pub fn slopes(
        &self,
        (field, displaced): (&Field, &Displaced),
        linear: &mut Linear,
        by: &Field,
        out: &mut Changes,
    ) {
        out.clear(&self.grid);
        let Linear { rays, moving, shifts } = linear;
        displaced::moving(&self.grid, by, moving);
        shifts.clear(self.grid.count());
        for of_node in rays.chunk_by(|a, b| a.node == b.node) {
            let (mut value, mut any) = ([0.0; CHANGES], false);
            for ray in of_node.iter().filter(|ray| ray.corners.iter().any(|corner| moving[*corner])) {
                let slope = self.slope(ray, displaced, by, shifts);
                value.iter_mut().zip(slope).for_each(|(sum, slope)| *sum += slope);
                any = true;
            }
            if any {
                out.set(&self.grid, of_node[0].node, value);
            }
        }
        for node in (0..moving.len()).filter(|node| moving[*node] && displaced.sees_own(*node)) {
            let [now, more] = [field, by].map(|field| self.phases(node, &displacement(field, node)));
            let ridges = std::array::from_fn(|k| now[k].cos() * more[k]);
            out.set(&self.grid, node, with_ridges(self.by_slopes(node, by), ridges));
        }
    }

    fn slope(
        &self,
        ray: &Ray,
        displaced: &Displaced,
        by: &Field,
        shifts: &mut Sparse<Shift>,
    ) -> [f32; CHANGES] {
        let Some(corners) = corners_of(ray.corners, displaced) else { return [0.0; CHANGES] };
        let shift = corners.map(|of| *shifts.or_insert_with(of.corner.node, || of.moves_on(&self.grid, by)));
        let sum = |of: &dyn Fn(usize) -> Vector3<f64>| -> Vector3<f64> {
            (0..3).map(|k| of(k) * ray.shares[k]).sum()
        };
        let moved = sum(&|k| shift[k].by);
        let on = ray.on.dot(&moved);
        let beside = ray.direction * on - moved;
        let [second, third] = ray.beside.map(|dual| dual.dot(&beside));
        let more = [-second - third, second, third];
        let other: Vector3<f64> = (0..3).map(|k| corners[k].normal * more[k]).sum();
        let turn = (sum(&|k| shift[k].turn) + other) / ray.length;
        let turns = ray.tangents.map(|tangent| tangent.dot(&turn));
        let cells = ray.corners.map(|corner| self.cells_from(ray.node, corner));
        std::array::from_fn(|c| match c.checked_sub(COLOURS) {
            None => {
                (ray.by_depth[c] * on + ray.by_turn[0][c] * turns[0] + ray.by_turn[1][c] * turns[1]) as f32
            }
            Some(k) => (ray.by_cells[k] * (0..3).map(|i| cells[i][k] * more[i]).sum::<f64>()) as f32,
        })
    }
}

impl Turned {
    /// What it does where the inside moves on by `by`.
    fn moves_on(&self, grid: &Grid, by: &Field) -> Shift {
        let node = self.corner.node;
        let own = displacement(by, node);
        let Flat { edges, normal, area } = &self.flat;
        if *area == 0.0 {
            return Shift { by: own, turn: Vector3::zeros() };
        }
        let [first, second] =
            across(grid, node).map(|[one, other]| displacement(by, other) - displacement(by, one));
        let product = (first.cross(&edges[1]) + edges[0].cross(&second)) / *area;
        let turn = product - normal * normal.dot(&product);
        Shift { by: own, turn: (turn - self.normal * self.normal.dot(&turn)) / self.length }
    }
}

/// The corners of a triangle.
fn corners_of(nodes: [usize; 3], displaced: &Displaced) -> Option<[&Turned; 3]> {
    let [a, b, c] = nodes.map(|node| displaced.corners.get(node));
    Some([a?, b?, c?])
}
