//! Which part of a displaced inside each ray meets.
//!
//! Every ray keeps the nearest of the triangles that it passes through (E. Catmull, *A subdivision algorithm for computer display of curved surfaces*,
//! 1974). Only triangles that move are tried, and rays that none of them comes in the way of end where they did. Where the ends of neighbouring
//! rays lie far apart, an edge hides what is between. A ray there stands for a part of the picture that sees both sides, and is followed
//! in [`PARTS`] (T. Whitted, *Communications of the ACM*, 1980), so that numbers change evenly as the edge moves.

use std::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::{Point3, Vector3};

use super::casting::{Met, Sparse};
use super::displaced::{Displaced, Hit, beside, neighbours};
use super::light::COLOURS;
use super::shading::{GRAZING, Shading};
use crate::elastic::basis::{Field, Grid};
use crate::elastic::mesh::smooth_step;

/// Parts of a ray, down and across. Edges run around the axis rather than along it, since the camera looks along.
pub(super) const PARTS: usize = DOWN * ACROSS;
const DOWN: usize = 4;
const ACROSS: usize = 2;
/// Times as far apart as nodes are where neighbouring rays end, between which an edge comes to lie.
const APART: [f64; 2] = [1.5, 2.5];
/// Full scale by which a ray differs from the mean of its parts where nothing touches, from which it does not stand for them: 3 % of the rays of the
/// thumb that ships do, as at the border of the fovea, where the inside turns within a cell of the grid.
const UNEVEN: f32 = 0.03;
/// \[m\] by which depths differ by rounding.
const SAME: f64 = 1e-9;

/// (s, φ) of a part of the ray through a node.
pub(super) fn part(grid: &Grid, node: usize, part: usize) -> [f64; 2] {
    let within = |k: usize, of: usize| (k as f64 + 0.5) / of as f64 - 0.5;
    let (row, column) = (node / grid.columns, node % grid.columns);
    let at = (row as f64 + within(part / ACROSS, DOWN)).abs().min((grid.rows - 1) as f64);
    let around = column as f64 + within(part % ACROSS, ACROSS);
    [at * grid.step, around / grid.columns as f64 * TAU]
}

impl Shading {
    /// What rays and their parts meet where nothing moves: their own nodes, but for those that lie behind others.
    pub(super) fn see_untouched(&mut self) {
        let mut displaced = Displaced::default();
        let mut still = Field::default();
        still.clear(&self.grid);
        still.rows = [0, self.grid.rows];
        displaced.near.resize(self.grid.count(), true);
        self.meet(&still, &mut displaced);
        for node in 0..self.nodes.len() {
            let own = self.nodes[node].met;
            displaced.corners.or_insert_with(node, || self.turned(&still, node));
            let hit = displaced.hits.get(node).map(|hit| hit.met);
            if let Some(met) = hit.filter(|met| met.depth < own.depth - SAME) {
                // It sees no ridges of its own.
                (self.nodes[node].met, self.nodes[node].along) = (met, [Vector3::zeros(); 2]);
            }
        }
        let seen = |shading: &Self, node: usize| {
            shading.lit_at(&shading.rays.directions[node], &shading.nodes[node].met, &displaced)
        };
        self.seen = (0..self.nodes.len()).map(|node| seen(self, node)).collect();
        let mut parts: Sparse<Met> = Sparse::default();
        parts.clear(self.nodes.len() * PARTS);
        self.meet_parts(&displaced, &mut parts, |_| true, |_| f64::INFINITY);
        let met = |part: usize| parts.get(part).copied().unwrap_or(self.nodes[part / PARTS].met);
        self.untouched = (0..self.nodes.len() * PARTS).map(met).collect();
        let seen = |(met, direction)| self.lit_at(direction, met, &displaced);
        self.seen_in_parts = self.untouched.iter().zip(&self.parts.directions).map(seen).collect();
        let uneven = |(own, parts): (&[f32; COLOURS], &[[f32; COLOURS]; PARTS])| {
            let mean = |c: usize| parts.iter().map(|part| part[c]).sum::<f32>() / PARTS as f32;
            (0..COLOURS).any(|c| (own[c] - mean(c)).abs() > UNEVEN)
        };
        let by_ray = self.seen_in_parts.as_chunks().0;
        self.uneven = self.seen.iter().zip(by_ray).map(uneven).collect();
    }

    /// What rays meet of a displaced inside.
    pub(super) fn see(&self, field: &Field, displaced: &mut Displaced) {
        let strongly = |node: usize| {
            let most = self.nodes[node].slight;
            field.values[3 * node..3 * node + 3].iter().any(|u| u.abs() > most)
        };
        beside(&self.grid, field, strongly, &mut displaced.near);
        self.meet(field, displaced);
        self.find_edges(displaced);
        if !displaced.edges.places.is_empty() {
            let mut parts = std::mem::take(&mut displaced.parts);
            let farthest = |part: usize| self.farthest(part / PARTS, &self.untouched[part], &displaced.near);
            self.meet_parts(displaced, &mut parts, |part| displaced.edges.has(part / PARTS), farthest);
            displaced.parts = parts;
        }
        let hits = &mut displaced.hits;
        for i in 0..hits.values.len() {
            let (node, met) = (hits.places[i] as usize, hits.values[i].met);
            hits.values[i].phases = self.other_phases(node, &met);
        }
        if self.ridges != [0.0; 2] {
            for i in 0..hits.values.len() {
                hits.values[i].left = self.left_of_waves(hits.places[i] as usize, hits);
            }
        }
    }

    /// Finds what rays meet in all triangles with a corner that is near what moves.
    fn meet(&self, field: &Field, displaced: &mut Displaced) {
        let Grid { rows, columns, .. } = self.grid;
        let Displaced { near, corners, triangles, hits, edges, parts } = displaced;
        corners.clear(rows * columns);
        triangles.clear();
        hits.clear(rows * columns);
        edges.clear(rows * columns);
        parts.clear(rows * columns * PARTS);
        let [first, end] = field.rows;
        for row in first.saturating_sub(2)..(end + 1).min(rows - 1) {
            for column in 0..columns {
                let beside = (column + 1) % columns;
                let [above, below] = [row, row + 1].map(|row| row * columns);
                let cell = [above + column, below + column, below + beside, above + beside];
                if !cell.iter().any(|node| near[*node]) {
                    continue;
                }
                let [a, b, c, d] = cell;
                // All columns have the tip in common.
                let own = if row == 0 { &[[a, b, c]][..] } else { &[[a, b, c], [a, c, d]] };
                for nodes in own {
                    let [a, b, c] =
                        nodes.map(|node| corners.or_insert_with(node, || self.turned(field, node)).corner);
                    triangles.push(*nodes);
                    self.rays.each_through(
                        [&a, &b, &c],
                        |_| true,
                        |ray, met| {
                            let farthest = hits.get(ray).map_or_else(
                                || self.farthest(ray, &self.nodes[ray].met, near),
                                |hit| hit.met.depth,
                            );
                            if met.depth < farthest {
                                let hit = Hit { met, phases: [0.0; 2], left: [1.0; 2] };
                                *hits.or_insert_with(ray, || hit) = hit;
                            }
                        },
                    );
                }
            }
        }
    }

    /// What those parts of rays meet that are wanted, in the triangles that rays were tried with; none farther than `farthest`.
    fn meet_parts(
        &self,
        displaced: &Displaced,
        out: &mut Sparse<Met>,
        wanted: impl Fn(usize) -> bool,
        farthest: impl Fn(usize) -> f64,
    ) {
        for nodes in &displaced.triangles {
            let [Some(a), Some(b), Some(c)] = nodes.map(|node| displaced.corners.get(node)) else { continue };
            self.parts.each_through([&a.corner, &b.corner, &c.corner], &wanted, |part, met| {
                if met.depth < out.get(part).map_or_else(|| farthest(part), |met| met.depth) {
                    *out.or_insert_with(part, || met) = met;
                }
            });
        }
    }

    /// \[m\] up to which something may move into the way of a ray or its part: to where that ends otherwise, unless this moves itself.
    fn farthest(&self, ray: usize, untouched: &Met, near: &[bool]) -> f64 {
        let Met { depth, corners, shares } = untouched;
        let nearest = if shares[1] > shares[0] { 1 } else { 0 };
        let nearest = if shares[2] > shares[nearest] { 2 } else { nearest };
        if near[corners[nearest]] {
            return f64::INFINITY;
        }
        // What moves slightly is still the same.
        depth - f64::from(self.nodes[ray].slight) / GRAZING
    }

    /// Marks rays that end far from where a neighbour does, and those that never stand for their parts.
    fn find_edges(&self, displaced: &mut Displaced) {
        let Displaced { hits, edges, .. } = displaced;
        let position = |node: usize| self.nodes[node].position;
        let of = |met: &Met| -> Point3<f64> {
            let parts =
                met.corners.iter().zip(met.shares).map(|(corner, share)| position(*corner).coords * share);
            Point3::from(parts.sum::<Vector3<f64>>())
        };
        let ends = |ray: usize| of(hits.get(ray).map_or(&self.nodes[ray].met, |hit| &hit.met));
        for (node, hit) in hits.places.iter().zip(&hits.values) {
            let (node, end) = (*node as usize, of(&hit.met));
            if self.uneven[node] {
                *edges.or_insert_with(node, || 1.0) = 1.0;
            }
            for other in neighbours(&self.grid, node) {
                let apart = (position(node) - position(other)).norm().max(self.grid.step);
                let beyond = (end - ends(other)).norm() / apart - APART[0];
                if beyond > 0.0 {
                    let sharp = smooth_step(beyond / (APART[1] - APART[0]));
                    for ray in [node, other] {
                        let known = edges.or_insert_with(ray, || sharp);
                        *known = known.max(sharp);
                    }
                }
            }
        }
    }

    /// What is left of a wave of ridges in the mean over a ray's part of the picture, where neighbouring rays see other phases of them. Of phases that
    /// differ evenly by x from ray to ray it is sin (x/2) / (x/2), which cos² (x/4) is within a tenth up to a third of a wave.
    fn left_of_waves(&self, ray: usize, hits: &Sparse<Hit>) -> [f64; 2] {
        let phases = |ray: usize| hits.get(ray).map_or([0.0; 2], |hit| hit.phases);
        let (own, others) = (phases(ray), neighbours(&self.grid, ray).map(phases));
        std::array::from_fn(|k| {
            let left = |other: &[f64; 2]| ((other[k] - own[k]) / 4.0).abs().min(FRAC_PI_2).cos();
            others.iter().map(left).product()
        })
    }
}
