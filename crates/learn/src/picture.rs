//! Maps of forces as pictures: what image networks learn, and how their pixels become forces on the points of a surface.
//!
//! Problem: networks of convolutions give pictures of square pixels, whose size and blur are free (thesis section 4.3.2), and nodes give
//! forces on the points of a surface. Method: a picture lies in the x–y plane of the skin's link about the middle of the surface; each
//! contact's pressing force is spread evenly over the part of a disc of a chosen diameter that lies on the surface ([`Pictures`]). Back to the surface, every pixel
//! is cut into parts finer than the triangulation; a part bears what is interpolated between the pixels' middles, and goes to the
//! corners of the triangle that it lies in by its barycentric coordinates ([`Mixing`]). So pixels whose middle lies
//! on the surface keep their force, and others are cut off.
//!
//! Assumptions: the surface is single-valued over x and y. Cost: a picture is one pass over the pixels of the discs; a mixing is made
//! once and has some ten to thirty numbers a point.

use std::collections::{BTreeMap, HashMap};

use dermis_inference::onnx::{GraphBuilder, Value};
use dermis_skin::Surface;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use crate::LearnError;
use crate::dataset::Truth;
use crate::evaluate::centre;

/// Size of a picture, and how wide a contact is in it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// Rows (along y) and columns (along x).
    pub pixels: [usize; 2],
    /// \[m\] side of a pixel.
    pub pixel: f64,
    /// \[m\] diameter of the disc that a contact's force is spread over.
    pub diameter: f64,
}

/// Parts along each side of a pixel by which it is found how much of it a disc covers.
const COVER: usize = 8;

impl Picture {
    /// Numbers in it.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pixels[0] * self.pixels[1]
    }

    /// Whether there are none; never so in a valid one.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Says what is impossible: field and reason.
    ///
    /// # Errors
    ///
    /// The name of the field, and what it must be.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        if self.pixels.iter().any(|n| !(1..=4096).contains(n)) {
            return Err((
                "pixels",
                format!("is {:?} and must be rows and columns from 1 to 4096", self.pixels),
            ));
        }
        for (field, length) in [("pixel", self.pixel), ("diameter", self.diameter)] {
            if !(length.is_finite() && length > 0.0) {
                return Err((field, format!("is {length} m and must be a positive length")));
            }
        }
        Ok(())
    }

    /// \[m\] x and y of a place in the picture, in pixels from the middle of the first one.
    fn place(&self, column: f64, row: f64, middle: &Point3<f64>) -> [f64; 2] {
        let [rows, columns] = self.pixels;
        let along = |at: f64, count: usize| (at - (count as f64 - 1.0) / 2.0) * self.pixel;
        [along(column, columns) + middle.x, along(row, rows) + middle.y]
    }

    /// Column or row, in pixels from the middle of the first one, of a distance \[m\] from the middle of the picture.
    fn index(&self, distance: f64, count: usize) -> f64 {
        distance / self.pixel + (count as f64 - 1.0) / 2.0
    }
}

/// The middle of a surface.
fn middle_of(surface: &Surface) -> Result<Point3<f64>, LearnError> {
    centre(surface).ok_or_else(|| LearnError::Training {
        reason: "the surface of this skin has no area, of which there is no picture".into(),
    })
}

/// Makes pictures of what was true.
#[derive(Debug, Clone)]
pub struct Pictures {
    picture: Picture,
    middle: Point3<f64>,
    /// Whether the middle of each pixel lies on the surface.
    inside: Vec<bool>,
}

impl Pictures {
    /// Pictures about the middle of a surface.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the surface has no area, or is not single-valued over x and y.
    pub fn new(picture: Picture, surface: &Surface) -> Result<Self, LearnError> {
        let middle = middle_of(surface)?;
        let triangles = Triangles::new(surface)?;
        let columns = picture.pixels[1];
        let on = |i: usize| {
            let [x, y] = picture.place((i % columns) as f64, (i / columns) as f64, &middle);
            triangles.find(x, y).is_some()
        };
        Ok(Self { inside: (0..picture.len()).map(on).collect(), picture, middle })
    }

    /// Appends the picture of a frame \[N\], row by row; NaN throughout where a force is not known. What of a disc lies outside of the
    /// picture is cut off.
    pub fn append(&self, truth: &Truth, out: &mut Vec<f64>) {
        let start = out.len();
        out.resize(start + self.picture.len(), 0.0);
        for contact in &truth.contacts {
            match contact
                .normal_force()
                .filter(|_| contact.position.x.is_finite() && contact.position.y.is_finite())
            {
                Some(force) => self.spread(&contact.position, force, &mut out[start..]),
                None => return out[start..].fill(f64::NAN),
            }
        }
    }

    fn spread(&self, at: &Point3<f64>, force: f64, out: &mut [f64]) {
        let [rows, columns] = self.picture.pixels;
        let x = self.picture.index(at.x - self.middle.x, columns);
        let y = self.picture.index(at.y - self.middle.y, rows);
        let radius = self.picture.diameter / 2.0 / self.picture.pixel;
        let part = 1.0 / COVER as f64;
        let offset = |k: usize| (k as f64 + 0.5) * part - 0.5;
        let reach =
            |middle: f64| [(middle - radius - 0.5).ceil() as i64, (middle + radius + 0.5).floor() as i64];
        let ([left, right], [low, high]) = (reach(x), reach(y));
        let mut covered: Vec<(usize, f64)> = Vec::new();
        for row in low..=high {
            for column in left..=right {
                let inside = |k: usize, l: usize| {
                    let (dx, dy) = (column as f64 + offset(l) - x, row as f64 + offset(k) - y);
                    dx.hypot(dy) <= radius
                };
                let parts = (0..COVER * COVER).filter(|i| inside(i / COVER, i % COVER)).count();
                let place = usize::try_from(row).ok().zip(usize::try_from(column).ok());
                let place = place.filter(|(row, column)| *row < rows && *column < columns);
                if let Some(index) = place.map(|(row, column)| row * columns + column)
                    && parts > 0
                    && self.inside[index]
                {
                    covered.push((index, parts as f64));
                }
            }
        }
        let total: f64 = covered.iter().map(|(_, parts)| parts).sum();
        let (row, column) = (y.round(), x.round());
        if covered.is_empty() && (0.0..rows as f64).contains(&row) && (0.0..columns as f64).contains(&column)
        {
            // A disc that is finer than the parts of a pixel, or beside the surface.
            out[row as usize * columns + column as usize] += force;
        }
        for (index, parts) in covered {
            out[index] += force * parts / total;
        }
    }
}

/// Numbers that are sums of others: a sparse matrix with as many entries in each row.
#[derive(Debug, Clone, PartialEq)]
pub struct Mixing {
    rows: usize,
    columns: usize,
    /// Entries a row; those that are not needed have the weight 0.
    width: usize,
    indices: Vec<usize>,
    weights: Vec<f64>,
}

impl Mixing {
    /// From the pixels of a picture to the points of a surface.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the surface is not single-valued over x and y, or lies outside of the picture.
    pub fn new(picture: &Picture, surface: &Surface) -> Result<Self, LearnError> {
        let middle = middle_of(surface)?;
        let triangles = Triangles::new(surface)?;
        let inside = Pictures::new(*picture, surface)?.inside;
        let [rows, columns] = picture.pixels;
        let parts = (2.0 * picture.pixel / triangles.spacing).ceil().clamp(1.0, 32.0) as usize;
        let mut entries: Vec<BTreeMap<usize, f64>> = vec![BTreeMap::new(); surface.points.len()];
        let fine = |k: usize| (k as f64 + 0.5) / parts as f64 - 0.5;
        for row in 0..rows * parts {
            for column in 0..columns * parts {
                // In pixels from the middle of the first one.
                let v = fine(row);
                let u = fine(column);
                let [x, y] = picture.place(u, v, &middle);
                let Some((corners, shares)) = triangles.find(x, y) else { continue };
                for (pixel, weight) in between(u, v, picture.pixels) {
                    for (corner, share) in corners.iter().zip(shares) {
                        let part = weight * share / (parts * parts) as f64;
                        *entries[*corner as usize].entry(pixel).or_default() += part;
                    }
                }
            }
        }
        // A pixel whose middle is on the surface acts there with all of its force.
        let mut sums = vec![0.0; picture.len()];
        entries.iter().flatten().for_each(|(pixel, weight)| sums[*pixel] += weight);
        for (pixel, weight) in entries.iter_mut().flatten().filter(|(pixel, _)| inside[**pixel]) {
            *weight /= sums[*pixel];
        }
        entries.iter_mut().for_each(|row| row.retain(|_, weight| *weight > 1e-12));
        let width = entries.iter().map(BTreeMap::len).max().unwrap_or(0);
        if width == 0 {
            return Err(LearnError::Training {
                reason: "no point of the surface lies in the picture: its pixels are too few or too small"
                    .into(),
            });
        }
        let (mut indices, mut weights) = (Vec::new(), Vec::new());
        for row in entries {
            let rest = width - row.len();
            indices.extend(row.keys().copied().chain(std::iter::repeat_n(0, rest)));
            weights.extend(row.values().copied().chain(std::iter::repeat_n(0.0, rest)));
        }
        Ok(Self { rows: surface.points.len(), columns: picture.len(), width, indices, weights })
    }

    /// The same with every sum multiplied.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        self.weights.iter_mut().for_each(|w| *w *= factor);
        self
    }

    /// Numbers that come out.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Numbers that go in.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The sums of these numbers.
    #[must_use]
    pub fn apply(&self, values: &[f64]) -> Vec<f64> {
        let rows = self.indices.chunks_exact(self.width).zip(self.weights.chunks_exact(self.width));
        let sum = |(indices, weights): (&[usize], &[f64])| {
            indices.iter().zip(weights).map(|(i, w)| w * values.get(*i).copied().unwrap_or(0.0)).sum()
        };
        rows.map(sum).collect()
    }

    /// Writes it behind a tensor of as many numbers as go in; \[1, rows\].
    pub fn write(&self, graph: &mut GraphBuilder, x: &Value) -> Value {
        let entries = self.rows * self.width;
        let flat = graph.reshape(x, &[1, self.columns]);
        let indices: Vec<i64> = self.indices.iter().map(|i| i64::try_from(*i).unwrap_or(i64::MAX)).collect();
        let indices = graph.constant_i64("mixing.indices", &[entries], &indices);
        let weights: Vec<f32> = self.weights.iter().map(|w| *w as f32).collect();
        let weights = graph.constant("mixing.weights", &[1, entries], &weights);
        let gathered = graph.gather(&flat, &indices, 1);
        let weighted = graph.mul(&gathered, &weights);
        let lists = graph.reshape(&weighted, &[self.rows, self.width]);
        let sums = graph.reduce_sum(&lists, 1);
        graph.reshape(&sums, &[1, self.rows])
    }
}

/// The four pixels around a place, and their bilinear weights; beyond the outermost middles the nearest ones.
fn between(u: f64, v: f64, [rows, columns]: [usize; 2]) -> Vec<(usize, f64)> {
    let two = |at: f64, count: usize| {
        let at = at.clamp(0.0, count as f64 - 1.0);
        let first = (at.floor() as usize).min(count - 1);
        let share = at - first as f64;
        [(first, 1.0 - share), ((first + 1).min(count - 1), share)]
    };
    let (across, along) = (two(u, columns), two(v, rows));
    let all = along
        .iter()
        .flat_map(|(row, a)| across.iter().map(move |(column, b)| (row * columns + column, a * b)));
    all.filter(|(_, weight)| *weight > 0.0).collect()
}

/// Triangles of a surface seen along z, by where they lie.
struct Triangles<'a> {
    surface: &'a Surface,
    /// \[m\] median length of an edge.
    spacing: f64,
    /// Indices of the triangles whose bounding box touches a cell of this many metres.
    cells: HashMap<[i64; 2], Vec<u32>>,
    cell: f64,
}

impl<'a> Triangles<'a> {
    fn new(surface: &'a Surface) -> Result<Self, LearnError> {
        if surface.normals.iter().any(|n| n.z < 0.1) {
            return Err(LearnError::Training {
                reason: "`network.image` draws forces as seen along z of the skin's link, and this surface bends away from that: \
                         give the link a z axis out of the skin, or leave `network.image` out"
                    .into(),
            });
        }
        let points = &surface.points;
        let mut edges: Vec<f64> = surface
            .triangles
            .iter()
            .map(|t| (points[t[0] as usize] - points[t[1] as usize]).norm())
            .collect();
        edges.sort_by(f64::total_cmp);
        let spacing = edges.get(edges.len() / 2).copied().filter(|s| *s > 0.0).unwrap_or(1.0);
        let mut all = Self { surface, spacing, cells: HashMap::new(), cell: 2.0 * spacing };
        for (i, t) in surface.triangles.iter().enumerate() {
            let corners = t.map(|k| points[k as usize]);
            let (low, high) =
                corners.iter().fold((corners[0], corners[0]), |(low, high), p| (low.inf(p), high.sup(p)));
            let ([left, front], [right, back]) = (all.key(low.x, low.y), all.key(high.x, high.y));
            for a in left..=right {
                for b in front..=back {
                    all.cells.entry([a, b]).or_default().push(i as u32);
                }
            }
        }
        Ok(all)
    }

    fn key(&self, x: f64, y: f64) -> [i64; 2] {
        [x, y].map(|v| (v / self.cell).floor() as i64)
    }

    /// Corners of the triangle at a place, and its barycentric coordinates there.
    fn find(&self, x: f64, y: f64) -> Option<([u32; 3], [f64; 3])> {
        let points = &self.surface.points;
        self.cells.get(&self.key(x, y))?.iter().find_map(|i| {
            let corners = self.surface.triangles[*i as usize];
            let [a, b, c] = corners.map(|k| points[k as usize]);
            let twice = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
                (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
            };
            let [a, b, c, p] = [[a.x, a.y], [b.x, b.y], [c.x, c.y], [x, y]];
            let area = twice(a, b, c);
            let shares = [twice(p, b, c) / area, twice(a, p, c) / area, twice(a, b, p) / area];
            // Rounding must not drop what lies on an edge.
            (area != 0.0 && shares.iter().all(|s| *s >= -1e-9))
                .then_some((corners, shares.map(|s| s.max(0.0))))
        })
    }
}

#[cfg(test)]
mod tests;
