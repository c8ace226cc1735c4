//! The inside in its grid: where it is, how it is lit, and how its looks change where it moves.
//!
//! Looks depend on the shape of the surface. A displacement u moves it by h = u·n along its normal; along itself it moves it too, but then it
//! is the same surface again. A pixel looks along a ray: where the surface has moved by h, the ray meets it h/(d·n) further on, d the ray's
//! direction. The normal there is that of the displaced grid. So the change of a pixel's colour is found in its own place, to first
//! order in the displacement over its width.
//!
//! Ridges are too fine for the grid. What a displacement does to them is that they move: a pixel then sees another phase of them.
//!
//! Cost: nodes that neither move nor have a neighbour that does are skipped; about 0.4 µs for any other, and a tenth of that where it moves
//! so little that its looks change in proportion, after a table that takes 0.1 s once. Derivatives are those of the untouched inside but for
//! the ridges' phases, where it is now.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use nalgebra::{Point3, Vector3};

use super::lens::Camera;
use super::light::{COLOURS, Light};
use crate::elastic::basis::{Field, Grid};
use crate::elastic::mesh::Elastomer;

/// Least cosine between ray and normal: rays that graze the surface see it move no further than this lets them.
const GRAZING: f64 = 0.05;

/// Ridges of the inside, moulded along its rings and its meridians: waves of the surface's height, and of its slope.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ridges {
    /// \[m\] along the meridian from ridge to ridge.
    pub pitch: f64,
    /// Ridges around.
    pub count: u32,
    /// \[m\] from trough to crest.
    pub height: f64,
}

/// Directions of a place of the inside in which ridges follow each other, times what a metre along them changes of the ridges' phases \[rad\].
type Phases = [Vector3<f64>; 2];

impl Ridges {
    /// Phases \[rad\] of the ridges at (s, φ), and how they change from there; `normal` points inwards.
    #[must_use]
    pub fn phases(
        &self,
        elastomer: &Elastomer,
        [s, azimuth]: [f64; 2],
        normal: &Vector3<f64>,
    ) -> ([f64; 2], Phases) {
        let (sin, cos) = azimuth.sin_cos();
        let around = Vector3::new(-sin, cos, 0.0);
        let depth = elastomer.thickness_at(s, azimuth);
        let r = elastomer.thumb.meridian(s, depth)[0];
        // On the tip, the inside is shorter than the outside that s is measured on.
        let shorter =
            if s < elastomer.thumb.cap() { 1.0 - depth * elastomer.thumb.curvature(s) } else { 1.0 };
        let wave = TAU / self.pitch;
        let count = f64::from(self.count);
        // Ridges along meridians end where they would be closer than those along rings.
        let closest = if r * wave >= count { count / r } else { 0.0 };
        let phases = [wave * s, count * azimuth];
        (phases, [around.cross(normal) * (wave / shorter), around * closest])
    }

    /// The inward normal with the ridges' slopes.
    #[must_use]
    pub fn tilted(&self, normal: &Vector3<f64>, phases: [f64; 2], along: &Phases) -> Vector3<f64> {
        let slope = |k: usize| along[k] * (0.5 * self.height * phases[k].sin());
        (normal + slope(0) + slope(1)).normalize()
    }
}

/// What is known of a node of the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Node {
    position: Point3<f64>,
    /// Inwards.
    normal: Vector3<f64>,
    /// Of the grid itself, which differs from the surface's by its cells.
    of_grid: Vector3<f64>,
    /// Unit, from the camera.
    ray: Vector3<f64>,
    /// Of ridges.
    along: Phases,
    /// \[m\] that it and its neighbours move at most for its colours to change in proportion.
    slight: f32,
}

/// The lit inside.
#[derive(Debug, Clone)]
pub struct Shading {
    grid: Grid,
    nodes: Vec<Node>,
    /// What a picture says of each node that nothing moves.
    seen: Vec<[f32; COLOURS]>,
    light: Light,
    /// What a node says more for each metre that it and its neighbours move; made by the first that asks.
    slopes: OnceLock<Vec<Slopes>>,
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
    /// Row by row: of each colour, and of ridges' phases, as the negative sine of how far they have moved.
    pub values: Vec<[f32; CHANGES]>,
    /// First row, and the one after the last.
    pub rows: [usize; 2],
    /// Nodes whose rows and columns (of the grid with one column more) have a value.
    pub nodes: Vec<u32>,
}

/// Numbers of a node that changes.
pub const CHANGES: usize = COLOURS + 2;

impl Changes {
    fn clear(&mut self, grid: &Grid) {
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

    fn set(&mut self, grid: &Grid, [row, column]: [usize; 2], value: [f32; CHANGES]) {
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
        let mut nodes: Vec<Node> = (0..grid.count())
            .map(|node| {
                let [s, azimuth] = grid.place(node);
                let (position, normal) = inside(elastomer, s, azimuth);
                let ray = (position - camera.position).try_normalize(1e-9).unwrap_or_else(Vector3::z);
                let none = [Vector3::zeros(); 2];
                let along = ridges.map_or(none, |ridges| ridges.phases(elastomer, [s, azimuth], &normal).1);
                Node { position, normal, of_grid: normal, ray, along, slight: 0.0 }
            })
            .collect();
        let place = |node: usize| nodes[node].position;
        let made: Vec<(Vector3<f64>, f64)> = (0..grid.count())
            .map(|node| {
                let apart = across(&grid, node).map(|[one, other]| (place(other) - place(one)).norm());
                (normal_of(&grid, node, place, &nodes[node].normal), apart[0].min(apart[1]))
            })
            .collect();
        for (node, (flat, apart)) in nodes.iter_mut().zip(made) {
            node.of_grid = flat;
            node.slight = (SLIGHT * apart) as f32;
        }
        let seen =
            nodes.iter().map(|n| light.seen(light.radiance(&n.position, &n.normal, &-n.ray))).collect();
        Self { grid, nodes, seen, light, slopes: OnceLock::new() }
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

    /// Changes of what a picture says, by node, where the inside is displaced.
    pub fn changes(&self, field: &Field, out: &mut Changes) {
        self.each_that_moves(field, out, |node| {
            let u = displacement(field, node);
            let most = self.nodes[node].slight;
            let slightly = |of: usize| field.values[3 * of..3 * of + 3].iter().all(|u| u.abs() <= most);
            let seen = if slightly(node) && neighbours(&self.grid, node).into_iter().all(slightly) {
                self.by_slopes(node, field)
            } else {
                let seen = self.colours(node, |node| displacement(field, node));
                std::array::from_fn(|c| seen[c] - self.seen[node][c])
            };
            let ridges = self.phases(node, &u).map(|phase| -phase.sin() as f32);
            std::array::from_fn(|c| if c < COLOURS { seen[c] } else { ridges[c - COLOURS] })
        });
    }

    /// Changes of a node's colours, to first order, where nodes are displaced by `by`.
    fn by_slopes(&self, node: usize, by: &Field) -> [f32; COLOURS] {
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

    /// How these change, to first order, where the displacements `field` of the inside change by `by`.
    pub fn slopes(&self, field: &Field, by: &Field, out: &mut Changes) {
        self.each_that_moves(by, out, |node| {
            let [red, green, blue] = self.by_slopes(node, by);
            let [now, more] = [field, by].map(|field| self.phases(node, &displacement(field, node)));
            let [along, around] = std::array::from_fn(|k| (-now[k].cos() * more[k]) as f32);
            [red, green, blue, along, around]
        });
    }

    /// Calls for every node that moves or has a neighbour that does.
    fn each_that_moves(&self, field: &Field, out: &mut Changes, value: impl Fn(usize) -> [f32; CHANGES]) {
        out.clear(&self.grid);
        let [first, end] = field.rows;
        let Grid { rows, columns, .. } = self.grid;
        let moves = |node: usize| field.values[3 * node..3 * node + 3] != [0.0; 3];
        for row in first.saturating_sub(1)..(end + 1).min(rows) {
            for column in 0..columns {
                let node = row * columns + column;
                if moves(node) || neighbours(&self.grid, node).into_iter().any(moves) {
                    out.set(&self.grid, [row, column], value(node));
                }
            }
        }
    }

    /// What a picture says of a node where nodes are displaced.
    fn colours(&self, node: usize, moved: impl Fn(usize) -> Vector3<f64>) -> [f32; COLOURS] {
        let Node { position, normal, of_grid, ray, .. } = &self.nodes[node];
        let place = |node: usize| self.nodes[node].position + moved(node);
        let turned = normal + normal_of(&self.grid, node, place, of_grid) - of_grid;
        let turned = turned.try_normalize(1e-9).unwrap_or(*normal);
        let on = self.nodes[node].further(&moved(node));
        self.light.seen(self.light.radiance(&(position + ray * on), &turned, &-ray))
    }

    /// \[rad\] by which a node's displacement moves its ridges: along the surface, by what is left of it where the ray meets it.
    fn phases(&self, node: usize, u: &Vector3<f64>) -> [f64; 2] {
        let node = &self.nodes[node];
        let left = u + node.ray * node.further(u);
        node.along.map(|along| left.dot(&along))
    }

    fn slopes_of(&self, node: usize) -> Slopes {
        let mut slopes = [[0.0; COLOURS]; 3 * MOVING];
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
                    self.colours(node, |node| if node == of { u } else { Vector3::zeros() })
                };
                let (more, less) = (at(SLIGHTLY), at(-SLIGHTLY));
                slopes[3 * i + axis] =
                    std::array::from_fn(|c| (f64::from(more[c] - less[c]) / (2.0 * SLIGHTLY)) as f32);
            }
        }
        slopes
    }
}

impl Node {
    /// \[m\] by which the ray meets the surface further on where the node is displaced.
    fn further(&self, u: &Vector3<f64>) -> f64 {
        u.dot(&self.normal) / self.ray.dot(&self.normal).min(-GRAZING)
    }
}

/// \[m\] of a node.
fn displacement(field: &Field, node: usize) -> Vector3<f64> {
    let u = &field.values[3 * node..3 * node + 3];
    Vector3::new(f64::from(u[0]), f64::from(u[1]), f64::from(u[2]))
}

/// Nodes above, below, left and right; at the tip, those around it.
fn neighbours(grid: &Grid, node: usize) -> [usize; 4] {
    let Grid { rows, columns, .. } = *grid;
    let (row, column) = (node / columns, node % columns);
    if row == 0 {
        return [0, 1, 2, 3].map(|k| columns + (column + k * columns / 4) % columns);
    }
    let [left, right] = [columns - 1, 1].map(|by| row * columns + (column + by) % columns);
    [node - columns, if row + 1 < rows { node + columns } else { node }, left, right]
}

/// The inward normal of the grid at a node whose points are at `place`; `like` where its neighbours are all in one line.
fn normal_of(
    grid: &Grid,
    node: usize,
    place: impl Fn(usize) -> Point3<f64>,
    like: &Vector3<f64>,
) -> Vector3<f64> {
    let [first, second] = across(grid, node).map(|[one, other]| place(other) - place(one));
    first.cross(&second).try_normalize(1e-15).map_or(*like, |n| if n.dot(like) < 0.0 { -n } else { n })
}

/// The neighbours of a node that are opposite each other, in pairs.
fn across(grid: &Grid, node: usize) -> [[usize; 2]; 2] {
    let [a, b, c, d] = neighbours(grid, node);
    if node < grid.columns { [[c, a], [d, b]] } else { [[a, b], [c, d]] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ThumbModel;
    use crate::model::tests::{SMALL, skin};

    /// Neighbours that move in opposite directions, so that the inside is as rough as it can be.
    fn rough(grid: &Grid, most: f32) -> Field {
        let way = |i: usize| [0.3, -0.9, 1.0, -0.4, 0.7, -1.0, 0.1][i % 7];
        Field { values: (0..3 * grid.count()).map(|i| most * way(i)).collect(), rows: [0, grid.rows] }
    }

    #[test]
    fn where_little_moves_colours_change_in_proportion_and_elsewhere_as_light_falls() {
        // The second is as fine as that of the thumb that ships.
        for (spacing, share) in [("grid = 0.004", 0.02), ("grid = 0.00125", 0.05)] {
            colours_change_as_light_falls(&SMALL.replace("grid = 0.004", spacing), share);
        }
    }

    /// A rough inside that moves slightly changes as its slopes say, within a share of the largest change and a quarter of the noise that numbers
    /// of the thumb have which ships.
    fn colours_change_as_light_falls(text: &str, share: f32) {
        let model = ThumbModel::new(&skin(text)).unwrap();
        let shading = model.shading();
        let mut changes = Changes::default();
        let mut most = |field: &Field| {
            shading.changes(field, &mut changes);
            let (mut off, mut change) = (0.0_f32, 0.0_f32);
            for node in 0..shading.nodes.len() {
                let exact = shading.colours(node, |node| displacement(field, node));
                let (row, column) = (node / shading.grid.columns, node % shading.grid.columns);
                let found = changes.values[row * (shading.grid.columns + 1) + column];
                for c in 0..COLOURS {
                    let exact = exact[c] - shading.seen[node][c];
                    off = off.max((found[c] - exact).abs());
                    change = change.max(exact.abs());
                }
            }
            (off, change)
        };
        let slight = || shading.nodes.iter().map(|node| node.slight);
        let (off, change) = most(&rough(&shading.grid, slight().fold(f32::INFINITY, f32::min)));
        assert!(off > 0.0 && off < share * change && off < 1e-4, "{off} of {change}");
        let (off, change) = most(&rough(&shading.grid, 20.0 * slight().fold(0.0, f32::max)));
        assert!(off == 0.0 && change > 0.0, "{off} of {change}");
        // Dents as presses make them, at the tip, where meridians meet, beside it, and on the side.
        for at in [0.0005, 0.001, 0.002, 0.004, 0.008, 0.03] {
            let (middle, normal) = inside(&model.parameters().elastomer, at, 0.7);
            for depth in [1e-5, 1e-4, 4e-4] {
                let dent = |node: &Node| {
                    let share = (-(node.position - middle).norm_squared() / (2.0 * 0.003 * 0.003)).exp();
                    (normal * (depth * share)).map(|u| u as f32)
                };
                let values = shading.nodes.iter().flat_map(|node| <[f32; 3]>::from(dent(node))).collect();
                let (off, change) = most(&Field { values, rows: [0, shading.grid.rows] });
                assert!(off < 1e-5 && off < 0.02 * change, "{at} {depth}: {off} of {change}");
            }
        }
    }
}
