//! The compliance of the elastomer: what forces on the points of its outside do to its inside and to its outside.
//!
//! Linear elasticity by finite elements ([`Solid`](dermis_mechanics::fem::Solid), locking-free hexahedra): one factorisation, then three
//! solutions for each point of the outside. A column holds the displacements of the inside on a grid of rows and meridians, in a window that
//! reaches so far from the point, and how far points of the outside give way. Besides, the body's own weight along x, y and z.
//!
//! Assumption: displacements are linear in forces; [`stretching`](super::stretching) says by how much less a skin gives way once it stretches. What lies
//! outside of a window is left out: 8 % of the energy at 10 mm.
//!
//! Cost: with 100,000 unknowns and 3,800 points about a minute on two cores, and some 100 MB; it is kept on disk.

use std::f64::consts::TAU;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use dermis_mechanics::MechanicsError;
use dermis_skin::cache::{Bytes, Keep, Key, kept};
use nalgebra::{Matrix3, Point3, Vector3};

use super::mesh::{Elastomer, Meshed};
use crate::surface::Rings;

/// Rows of the inside from the tip to the base, and meridians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// From the tip to the base.
    pub rows: usize,
    /// Around.
    pub columns: usize,
    /// \[m\] between rows.
    pub step: f64,
}

impl Grid {
    /// Rows about `step` \[m\] apart over `length` \[m\].
    #[must_use]
    pub fn new(length: f64, step: f64, columns: usize) -> Self {
        let rows = (length / step).ceil().max(2.0) as usize;
        Self { rows: rows + 1, columns, step: length / rows as f64 }
    }

    /// How many nodes it has.
    #[must_use]
    pub fn count(&self) -> usize {
        self.rows * self.columns
    }

    /// (s, φ) of a node.
    #[must_use]
    pub fn place(&self, node: usize) -> [f64; 2] {
        let (row, column) = (node / self.columns, node % self.columns);
        [row as f64 * self.step, column as f64 / self.columns as f64 * TAU]
    }

    /// The node above and left of (s, φ), and how far on the way to the next row and column.
    #[must_use]
    pub fn cell(&self, s: f64, azimuth: f64) -> (usize, usize, f64, f64) {
        let at = (s / self.step).clamp(0.0, (self.rows - 1) as f64);
        let row = (at as usize).min(self.rows - 2);
        let around = (azimuth / TAU * self.columns as f64).rem_euclid(self.columns as f64);
        let column = (around as usize).min(self.columns - 1);
        (row, column, at - row as f64, around - column as f64)
    }
}

/// Displacements \[m\] of the inside's nodes, and which rows have any.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Field {
    /// x, y, z node by node.
    pub values: Vec<f32>,
    /// First row, and the one after the last.
    pub rows: [usize; 2],
}

impl Field {
    /// Nothing moves.
    pub fn clear(&mut self, grid: &Grid) {
        self.values.clear();
        self.values.resize(3 * grid.count(), 0.0);
        self.rows = [grid.rows, 0];
    }

    fn touch(&mut self, first: usize, end: usize) {
        self.rows = [self.rows[0].min(first), self.rows[1].max(end)];
    }
}

/// Where a column has values: rows, first meridian, meridians, start of the values.
type Window = [u64; 5];

/// Displacements by forces.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    /// Of the inside.
    pub grid: Grid,
    windows: Vec<Window>,
    /// Of each point: along x, y, z of the force, row by row, meridian by meridian, x, y, z of the displacement.
    inner: Vec<f32>,
    /// Start of each point's neighbours on the outside.
    starts: Vec<u64>,
    neighbours: Vec<u64>,
    /// How far a neighbour gives way inwards by 1 N along x, y, z.
    outer: Vec<f32>,
    /// Of the inside by 1 m/s² along x, y, z.
    weight: Vec<f32>,
}

impl Keep for Basis {
    fn put(&self, out: &mut Vec<u8>) {
        [self.grid.rows as u64, self.grid.columns as u64].put(out);
        self.grid.step.put(out);
        self.windows.iter().flatten().copied().collect::<Vec<u64>>().put(out);
        self.inner.put(out);
        self.starts.put(out);
        self.neighbours.put(out);
        self.outer.put(out);
        self.weight.put(out);
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        let [rows, columns] = <[u64; 2]>::take(from)?.map(|n| n as usize);
        let step = f64::take(from)?;
        let flat = Vec::<u64>::take(from)?;
        let (windows, rest) = flat.as_chunks();
        if !rest.is_empty() {
            return None;
        }
        Some(Self {
            grid: Grid { rows, columns, step },
            windows: windows.to_vec(),
            inner: Vec::take(from)?,
            starts: Vec::take(from)?,
            neighbours: Vec::take(from)?,
            outer: Vec::take(from)?,
            weight: Vec::take(from)?,
        })
    }
}

/// What the columns of some points are made of.
struct Columns {
    window: Window,
    inner: Vec<f32>,
    neighbours: Vec<u64>,
    outer: Vec<f32>,
}

/// Points whose columns are solved at once.
const TOGETHER: usize = 16;

/// What a basis is computed from.
#[derive(Debug)]
struct Task<'a> {
    elastomer: &'a Elastomer,
    grid: Grid,
    /// (s, φ) of the points of the outside.
    locations: Vec<[f64; 2]>,
    reach: f64,
    meshed: Meshed,
    /// Nodes of a layer with weights, for the points of the outside and for the grid's nodes; none below the elastomer's end.
    at_points: Vec<[(usize, f64); 3]>,
    at_grid: Vec<Option<[(usize, f64); 3]>>,
}

impl Basis {
    /// The basis of an elastomer for forces on the points of `rings`; displacements reach `reach` \[m\]. Found on disk, in memory of the
    /// process, or computed.
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where the elastomer cannot be meshed.
    pub fn of(
        elastomer: &Elastomer,
        rings: &Rings,
        grid: Grid,
        reach: f64,
    ) -> Result<Arc<Self>, MechanicsError> {
        /// Bases that a process keeps: devices that differ in optics only share one.
        const LATEST: usize = 3;
        static KNOWN: Mutex<Vec<(String, Arc<Basis>)>> = Mutex::new(Vec::new());
        let depends = format!("{elastomer:?} {rings:?} {grid:?} {reach:?}");
        let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(place) = known.iter().position(|(of, _)| *of == depends) {
            let found = known.remove(place);
            let basis = Arc::clone(&found.1);
            known.push(found);
            return Ok(basis);
        }
        let what = "the compliance of the elastomer over its skeleton (finite elements; up to two minutes)";
        let basis = kept(what, Key::new("thumb").text(&depends), || {
            Self::compute(elastomer, rings, grid, reach).map(Arc::new)
        })?;
        if known.len() >= LATEST {
            known.remove(0);
        }
        known.push((depends, Arc::clone(&basis)));
        Ok(basis)
    }

    fn compute(elastomer: &Elastomer, rings: &Rings, grid: Grid, reach: f64) -> Result<Self, MechanicsError> {
        let meshed = elastomer.mesh()?;
        let on = |s: f64, azimuth: f64| meshed.weights(&elastomer.thumb.point(s, azimuth, 0.0).0);
        let locations = rings.locations();
        let at_points = locations.iter().map(|[s, phi]| on(*s, *phi)).collect();
        let at_grid = (0..grid.count())
            .map(|node| {
                let [s, phi] = grid.place(node);
                (s <= elastomer.end()).then(|| on(s, phi))
            })
            .collect();
        let task = Task { elastomer, grid, locations, reach, meshed, at_points, at_grid };
        let solid = task.meshed.solid(elastomer.young_modulus, elastomer.poisson_ratio)?;
        let blocks = task.locations.len().div_ceil(TOGETHER);
        let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(blocks)));
        let threads = std::thread::available_parallelism().map_or(1, usize::from).min(blocks);
        std::thread::scope(|scope| {
            for _ in 0..threads {
                scope.spawn(|| {
                    loop {
                        let block = next.fetch_add(1, Ordering::Relaxed);
                        if block >= blocks {
                            return;
                        }
                        let columns = task.columns(&solid, block);
                        done.lock().unwrap_or_else(PoisonError::into_inner).push((block, columns));
                    }
                });
            }
        });
        let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
        done.sort_unstable_by_key(|(block, _)| *block);
        let mut basis = Self {
            grid,
            windows: Vec::new(),
            inner: Vec::new(),
            starts: vec![0],
            neighbours: Vec::new(),
            outer: Vec::new(),
            weight: task.weight(&solid),
        };
        for columns in done.into_iter().flat_map(|(_, columns)| columns) {
            let [row, rows, first, around, _] = columns.window;
            basis.windows.push([row, rows, first, around, basis.inner.len() as u64]);
            basis.inner.extend_from_slice(&columns.inner);
            basis.neighbours.extend_from_slice(&columns.neighbours);
            basis.outer.extend_from_slice(&columns.outer);
            basis.starts.push(basis.neighbours.len() as u64);
        }
        Ok(basis)
    }

    /// Adds what a force \[N\] at a point of the outside does to the inside.
    pub fn add(&self, point: usize, force: &Vector3<f64>, field: &mut Field) {
        let [row, rows, first, around, start] = self.windows[point].map(|n| n as usize);
        let size = 3 * around;
        field.touch(row, row + rows);
        for (axis, f) in force.iter().enumerate().filter(|(_, f)| **f != 0.0) {
            let f = *f as f32;
            let from = start + axis * rows * size;
            let values = &self.inner[from..from + rows * size];
            for (k, line) in values.chunks_exact(size).enumerate() {
                let begin = 3 * (row + k) * self.grid.columns;
                let target = &mut field.values[begin..begin + 3 * self.grid.columns];
                let split = 3 * (self.grid.columns - first).min(around);
                let (right, left) = line.split_at(split);
                target[3 * first..].iter_mut().zip(right).for_each(|(t, v)| *t += f * v);
                target.iter_mut().zip(left).for_each(|(t, v)| *t += f * v);
            }
        }
    }

    /// Adds what an acceleration \[m/s²\] of all of the body does.
    pub fn add_weight(&self, acceleration: &Vector3<f64>, field: &mut Field) {
        if acceleration.norm_squared() == 0.0 {
            return;
        }
        field.touch(0, self.grid.rows);
        for (axis, values) in self.weight.chunks_exact(3 * self.grid.count()).enumerate() {
            let a = acceleration[axis] as f32;
            field.values.iter_mut().zip(values).for_each(|(t, v)| *t += a * v);
        }
    }

    /// Where the inside gives way most to forces at a point of the outside, by 1 N along x, y, z \[m/N\]: columns of a matrix.
    #[must_use]
    pub fn most(&self, point: usize) -> Matrix3<f64> {
        let [_, rows, _, around, start] = self.windows[point].map(|n| n as usize);
        let size = 3 * rows * around;
        let moved = |node: usize, axis: usize| {
            let at = start + axis * size + 3 * node;
            Vector3::from_fn(|k, _| f64::from(self.inner[at + k]))
        };
        let all = |node: usize| Matrix3::from_columns(&[0, 1, 2].map(|axis| moved(node, axis)));
        let square = |m: &Matrix3<f64>| m.norm_squared();
        let most = (0..rows * around).map(all).max_by(|a, b| square(a).total_cmp(&square(b)));
        most.unwrap_or_else(Matrix3::zeros)
    }

    /// How far points of the outside give way inwards \[m\] under a force \[N\] at one of them: calls `each` with point and distance.
    pub fn give(&self, point: usize, force: &Vector3<f64>, mut each: impl FnMut(usize, f64)) {
        let [start, end] = [self.starts[point], self.starts[point + 1]].map(|n| n as usize);
        let f = force.cast::<f32>();
        for (neighbour, v) in
            self.neighbours[start..end].iter().zip(self.outer[3 * start..3 * end].chunks_exact(3))
        {
            each(*neighbour as usize, f64::from(f.x * v[0] + f.y * v[1] + f.z * v[2]));
        }
    }

    /// \[m\] by which points of the outside give way inwards under a force \[N\] that they share, in the mean by their shares: each
    /// point comes once, in rising order.
    #[must_use]
    pub fn mean_give(&self, shares: &[(usize, f64)], force: &Vector3<f64>) -> f64 {
        let mut mean = 0.0;
        for (point, share) in shares {
            self.give(*point, &(force * *share), |neighbour, by| {
                if let Ok(place) = shares.binary_search_by_key(&neighbour, |(p, _)| *p) {
                    mean += by * shares[place].1;
                }
            });
        }
        mean
    }
}

impl Task<'_> {
    /// Rows and meridians within reach of (s, φ).
    fn window(&self, [s, phi]: [f64; 2]) -> [usize; 4] {
        let grid = &self.grid;
        let row = ((s - self.reach) / grid.step).floor().max(0.0) as usize;
        let end = (((s + self.reach) / grid.step).ceil() as usize + 1).min(grid.rows);
        // On the inside, at the narrow end of the window.
        let thumb = &self.elastomer.thumb;
        let r = thumb.meridian((s - self.reach).max(thumb.cap()), self.elastomer.thickness)[0];
        let half = if s < self.reach { TAU } else { self.reach / r };
        let width = ((2.0 * half / TAU) * grid.columns as f64).ceil() as usize + 2;
        if width >= grid.columns {
            return [row, end - row, 0, grid.columns];
        }
        let middle = (phi / TAU * grid.columns as f64).round() as isize;
        let first = (middle - (width / 2) as isize).rem_euclid(grid.columns as isize) as usize;
        [row, end - row, first, width]
    }

    fn columns(&self, solid: &dermis_mechanics::fem::Solid, block: usize) -> Vec<Columns> {
        let (count, outer) = (self.meshed.count, self.meshed.hexes.nodes.len() - self.meshed.count);
        let points = block * TOGETHER..((block + 1) * TOGETHER).min(self.locations.len());
        let loads: Vec<Vec<(usize, Vector3<f64>)>> = points
            .clone()
            .flat_map(|point| {
                [Vector3::x(), Vector3::y(), Vector3::z()]
                    .map(|axis| self.at_points[point].iter().map(|(n, w)| (outer + n, axis * *w)).collect())
            })
            .collect();
        let moved = solid.displacements(&loads);
        let at = |layer: usize, weights: &[(usize, f64); 3], u: &[Vector3<f64>]| {
            weights.iter().map(|(n, w)| u[layer * count + n] * *w).sum::<Vector3<f64>>()
        };
        let last = self.elastomer.layers;
        let column = |(point, three): (usize, &[Vec<Vector3<f64>>])| {
            let [row, rows, first, around] = self.window(self.locations[point]);
            let mut inner = Vec::with_capacity(9 * rows * around);
            for u in three {
                for node in (row..row + rows).flat_map(|row| {
                    (0..around).map(move |k| row * self.grid.columns + (first + k) % self.grid.columns)
                }) {
                    let v = self.at_grid[node].as_ref().map_or_else(Vector3::zeros, |w| at(0, w, u));
                    inner.extend(v.iter().map(|v| *v as f32));
                }
            }
            let own = self.position(point).0;
            let near = (0..self.locations.len()).filter(|k| (self.position(*k).0 - own).norm() < self.reach);
            let (mut neighbours, mut outer) = (Vec::new(), Vec::new());
            for k in near {
                let normal = self.position(k).1;
                neighbours.push(k as u64);
                outer.extend(three.iter().map(|u| -at(last, &self.at_points[k], u).dot(&normal) as f32));
            }
            let window = [row as u64, rows as u64, first as u64, around as u64, 0];
            Columns { window, inner, neighbours, outer }
        };
        points.zip(moved.chunks_exact(3)).map(column).collect()
    }

    fn position(&self, point: usize) -> (Point3<f64>, Vector3<f64>) {
        let [s, phi] = self.locations[point];
        self.elastomer.thumb.point(s, phi, 0.0)
    }

    fn weight(&self, solid: &dermis_mechanics::fem::Solid) -> Vec<f32> {
        let masses = self.meshed.masses(self.elastomer.density);
        let loads: Vec<_> = [Vector3::x(), Vector3::y(), Vector3::z()]
            .iter()
            .map(|axis| masses.iter().enumerate().map(|(n, m)| (n, axis * *m)).collect())
            .collect();
        let of = |u: &Vec<Vector3<f64>>| {
            let node = |w: &Option<[(usize, f64); 3]>| -> [f32; 3] {
                let none = Vector3::zeros();
                w.as_ref().map_or(none, |w| w.iter().map(|(n, w)| u[*n] * *w).sum()).cast::<f32>().into()
            };
            self.at_grid.iter().flat_map(node).collect::<Vec<f32>>()
        };
        solid.displacements(&loads).iter().flat_map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elastic::tests::coarse;

    fn basis() -> (Arc<Basis>, Elastomer, Rings) {
        let (elastomer, rings, grid) = coarse();
        (Basis::of(&elastomer, &rings, grid, 0.012).unwrap(), elastomer, rings)
    }

    /// Betti: the work of one force on the displacement of another is that of the other on the first's.
    #[test]
    fn compliance_is_reciprocal() {
        let (basis, elastomer, rings) = basis();
        let locations = rings.locations();
        let normal = |k: usize| elastomer.thumb.point(locations[k][0], locations[k][1], 0.0).1;
        let give = |from: usize, to: usize| {
            let mut found = 0.0;
            basis.give(from, &-normal(from), |k, by| {
                if k == to {
                    found = by;
                }
            });
            found
        };
        let mut tried = 0;
        for a in (0..locations.len()).step_by(5) {
            let near: Vec<usize> = basis.neighbours[basis.starts[a] as usize..basis.starts[a + 1] as usize]
                .iter()
                .map(|k| *k as usize)
                .collect();
            for b in near.into_iter().step_by(3) {
                let (there, back, own) = (give(a, b), give(b, a), give(a, a));
                assert!(own > 0.0 && (there - back).abs() < 1e-4 * own, "{a} {b}: {there} {back}");
                tried += 1;
            }
        }
        assert!(tried > 20, "{tried}");
    }

    #[test]
    fn a_press_pushes_the_inside_inwards_and_survives_the_disk() {
        let (basis, elastomer, rings) = basis();
        let locations = rings.locations();
        let point = locations.len() / 2;
        let (_, normal) = elastomer.thumb.point(locations[point][0], locations[point][1], 0.0);
        let mut field = Field::default();
        field.clear(&basis.grid);
        basis.add(point, &(-0.1 * normal), &mut field);
        let inwards = |values: &[f32]| -> f64 {
            values
                .as_chunks::<3>()
                .0
                .iter()
                .map(|u| -normal.dot(&Vector3::from(*u).cast::<f64>()))
                .fold(f64::MIN, f64::max)
        };
        // A tenth of a newton moves the inner wall by some tenths of a millimetre.
        let deep = inwards(&field.values);
        assert!((1e-5..1e-3).contains(&deep), "{deep}");
        let mut weight = Field::default();
        weight.clear(&basis.grid);
        basis.add_weight(&Vector3::new(9.81, 0.0, 0.0), &mut weight);
        let sag = weight.values.iter().copied().fold(0.0, f32::max);
        assert!((1e-8..1e-4).contains(&sag), "{sag}");
        let mut bytes = Vec::new();
        basis.put(&mut bytes);
        assert!(bytes.len() > 1000);
    }
}
