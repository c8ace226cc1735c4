//! Where on the mesh a touch is.

use dermis_model::tangents;
use dermis_skin::Surface;
use nalgebra::{Matrix3, Point3, Vector3};

/// A touch is never narrower than this many edges of the mesh: fewer points would not carry it evenly.
const NARROWEST: f64 = 1.6;
/// Points inspected when the surface around a place is so coarse that none lies in the patch.
const FEWEST: usize = 4;

/// The points of a surface, found by place.
#[derive(Debug)]
pub(super) struct Nodes {
    low: Point3<f64>,
    cell: f64,
    cells: [usize; 3],
    /// Where each cell's points begin in `points`.
    starts: Vec<u32>,
    points: Vec<u32>,
    /// \[m\] median edge of the mesh.
    edge: f64,
    /// Triangles around each point.
    around: Vec<Vec<u32>>,
}

impl Nodes {
    /// Sorts the points of a surface.
    pub fn new(surface: &Surface, patch: f64) -> Self {
        let points = &surface.points;
        let mut edges: Vec<f64> = surface
            .triangles
            .iter()
            .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]])
            .map(|[i, j]| (points[i as usize] - points[j as usize]).norm())
            .collect();
        edges.sort_by(f64::total_cmp);
        let edge = edges.get(edges.len() / 2).copied().unwrap_or(patch);
        let cell = patch.max(NARROWEST * edge);
        let first = points.first().copied().unwrap_or_else(Point3::origin);
        let (low, high) = points.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
        let cells = [0, 1, 2].map(|k| ((high[k] - low[k]) / cell) as usize + 1);
        let mut nodes = Self {
            low,
            cell,
            cells,
            starts: vec![0; cells.iter().product::<usize>() + 1],
            points: vec![0; points.len()],
            edge,
            around: vec![Vec::new(); points.len()],
        };
        let of: Vec<usize> =
            points.iter().map(|p| nodes.number(nodes.place(p).map(|k| k as usize))).collect();
        for cell in &of {
            nodes.starts[cell + 1] += 1;
        }
        for c in 1..nodes.starts.len() {
            nodes.starts[c] += nodes.starts[c - 1];
        }
        let mut ends = nodes.starts.clone();
        for (i, cell) in of.iter().enumerate() {
            nodes.points[ends[*cell] as usize] = i as u32;
            ends[*cell] += 1;
        }
        for (t, corners) in surface.triangles.iter().enumerate() {
            for corner in corners {
                nodes.around[*corner as usize].push(t as u32);
            }
        }
        nodes
    }

    fn place(&self, p: &Point3<f64>) -> [f64; 3] {
        [0, 1, 2].map(|k| ((p[k] - self.low[k]) / self.cell).clamp(0.0, (self.cells[k] - 1) as f64))
    }

    fn number(&self, [i, j, k]: [usize; 3]) -> usize {
        (k * self.cells[1] + j) * self.cells[0] + i
    }

    /// Calls `with` for every point whose cell is within `radius` of `p`.
    fn near(&self, p: &Point3<f64>, radius: f64, mut with: impl FnMut(usize)) {
        let by = Vector3::repeat(radius);
        let (from, to) = (self.place(&(p - by)), self.place(&(p + by)));
        for k in from[2] as usize..=to[2] as usize {
            for j in from[1] as usize..=to[1] as usize {
                let row = self.number([0, j, k]);
                let (first, last) = (row + from[0] as usize, row + to[0] as usize);
                let found = &self.points[self.starts[first] as usize..self.starts[last + 1] as usize];
                found.iter().for_each(|i| with(*i as usize));
            }
        }
    }

    /// Points that share a touch of this `radius` \[m\] at `p`, with weights that sum to 1 and whose mean place is `p` along the
    /// surface: a paraboloid of pressure, squared so that it ends smoothly, over the area of each point.
    pub fn patch(
        &self,
        surface: &Surface,
        p: &Point3<f64>,
        normal: &Vector3<f64>,
        radius: f64,
        out: &mut Vec<(usize, f64)>,
    ) {
        let radius = radius.max(NARROWEST * self.edge);
        let [first, second] = tangents(normal);
        let mut reach = radius;
        loop {
            out.clear();
            let square = reach * reach;
            self.near(p, reach, |i| {
                let inside = 1.0 - (surface.points[i] - p).norm_squared() / square;
                // The other side of a limb is not touched.
                if inside > 0.0 && surface.normals[i].dot(normal) > 0.0 {
                    out.push((i, inside * inside * surface.areas[i]));
                }
            });
            if out.len() >= FEWEST || out.len() == surface.points.len() {
                break;
            }
            reach *= 1.5;
        }
        let along = |i: usize| {
            let by = surface.points[i] - p;
            Vector3::new(reach, by.dot(&first), by.dot(&second))
        };
        let mut moments = Matrix3::zeros();
        for &(i, w) in &*out {
            let t = along(i);
            moments += t * t.transpose() * w;
        }
        // Points in one line leave a direction open, in which there is nothing to correct.
        let scale = moments[(0, 0)];
        moments[(1, 1)] += 1e-9 * scale;
        moments[(2, 2)] += 1e-9 * scale;
        let Some(inverse) = moments.try_inverse() else { return };
        let weight = inverse * Vector3::new(reach, 0.0, 0.0);
        for (i, w) in out {
            *w *= along(*i).dot(&weight);
        }
    }

    /// Corners of the triangle around `p`, and how much each of them counts there.
    pub fn corners(&self, surface: &Surface, p: &Point3<f64>, normal: &Vector3<f64>) -> [(usize, f64); 3] {
        // The two nearest points: the triangle around `p` mostly has one of them, also on a stretched mesh.
        let mut nearest = [(f64::INFINITY, 0); 3];
        // The three nearest lie within an edge, mostly.
        let mut reach = self.edge * 1.05;
        while nearest[2].0.is_infinite() && reach < 1e3 * self.edge {
            nearest = [(f64::INFINITY, 0); 3];
            self.near(p, reach, |i| {
                let far = (surface.points[i] - p).norm_squared();
                if far < nearest[2].0 && surface.normals[i].dot(normal) > 0.0 {
                    nearest[2] = (far, i);
                    if far < nearest[1].0 {
                        nearest.swap(1, 2);
                        if far < nearest[0].0 {
                            nearest.swap(0, 1);
                        }
                    }
                }
            });
            reach *= 2.0;
        }
        let mut best = (f64::NEG_INFINITY, [(nearest[0].1, 1.0), (nearest[0].1, 0.0), (nearest[0].1, 0.0)]);
        for (_, node) in nearest {
            for t in &self.around[node] {
                let corners = surface.triangles[*t as usize].map(|i| i as usize);
                let [a, b, c] = corners.map(|i| surface.points[i]);
                let across = (b - a).cross(&(c - a));
                let part = |q: Point3<f64>, r: Point3<f64>| (q - p).cross(&(r - p)).dot(&across);
                let (wa, wb, wc) = (part(b, c), part(c, a), part(a, b));
                let whole = wa + wb + wc;
                let least = (wa.min(wb).min(wc)) / whole;
                if least > best.0 {
                    let weights = [wa, wb, wc].map(|w| (w / whole).max(0.0));
                    let sum: f64 = weights.iter().sum();
                    best = (least, [0, 1, 2].map(|k| (corners[k], weights[k] / sum)));
                    if least >= 0.0 {
                        return best.1;
                    }
                }
            }
        }
        best.1
    }
}
