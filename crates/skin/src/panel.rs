//! Part of a cylinder with a grid of openings: the shell of a limb.

use nalgebra::{Point3, Vector3};

use crate::surface::Triangulation;

/// Where the material of a panel is: see [`SurfaceSpec::Panel`](crate::SurfaceSpec::Panel).
///
/// Its points have the coordinates (x, s): x along the axis, s the length of the arc from the middle of the panel, positive towards +y.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Panel {
    pub radius: f64,
    pub size: [f64; 2],
    /// Openings as \[from, to\] along x and along the arc, in rising order; an opening is a pair of both.
    openings: [Vec<[f64; 2]>; 2],
}

impl Panel {
    /// The panel with `cells` openings along x and the arc between solid `borders` at its ends and sides, and beams of the widths
    /// `beam` between openings (across x and across the arc). `None` where nothing is left of an opening.
    pub fn new(
        radius: f64,
        size: [f64; 2],
        borders: [f64; 2],
        cells: [u32; 2],
        beam: [f64; 2],
    ) -> Option<Self> {
        let along = |axis: usize| -> Option<Vec<[f64; 2]>> {
            let n = cells[axis];
            if n == 0 {
                return Some(Vec::new());
            }
            let room = size[axis] - 2.0 * borders[axis] - f64::from(n - 1) * beam[axis];
            let opening = room / f64::from(n);
            let first = -size[axis] / 2.0 + borders[axis];
            let from = |k: u32| first + f64::from(k) * (opening + beam[axis]);
            (opening > 1e-9).then(|| (0..n).map(|k| [from(k), from(k) + opening]).collect())
        };
        let mut openings = [along(0)?, along(1)?];
        // An opening needs both.
        if openings[0].is_empty() || openings[1].is_empty() {
            openings = [Vec::new(), Vec::new()];
        }
        Some(Self { radius, size, openings })
    }

    /// (x, s) of a point, straight out from the axis.
    pub fn unroll(&self, p: &Point3<f64>) -> [f64; 2] {
        let angle = if p.y == 0.0 && p.z == 0.0 { 0.0 } else { p.y.atan2(p.z) };
        [p.x, self.radius * angle]
    }

    /// Point of the surface at (x, s), and its outward normal.
    pub fn roll(&self, [x, s]: [f64; 2]) -> (Point3<f64>, Vector3<f64>) {
        let (sin, cos) = (s / self.radius).sin_cos();
        (Point3::new(x, self.radius * sin, self.radius * cos), Vector3::new(0.0, sin, cos))
    }

    /// The opening that (x, s) lies in, if any: its \[from, to\] along both.
    fn opening(&self, at: [f64; 2]) -> Option<[[f64; 2]; 2]> {
        let inside = |axis: usize| {
            let all = &self.openings[axis];
            let next = all.partition_point(|[from, _]| *from < at[axis]);
            all.get(next.checked_sub(1)?).copied().filter(|[_, to]| at[axis] < *to)
        };
        Some([inside(0)?, inside(1)?])
    }

    /// The nearest (x, s) with material.
    pub fn nearest(&self, at: [f64; 2]) -> [f64; 2] {
        let mut at = [0, 1].map(|axis| {
            let half = self.size[axis] / 2.0;
            at[axis].clamp(-half, half)
        });
        if let Some(opening) = self.opening(at) {
            let edge = |axis: usize| {
                let [from, to] = opening[axis];
                if at[axis] - from < to - at[axis] { (at[axis] - from, from) } else { (to - at[axis], to) }
            };
            let (x, s) = (edge(0), edge(1));
            if x.0 < s.0 {
                at[0] = x.1;
            } else {
                at[1] = s.1;
            }
        }
        at
    }

    /// Whether the straight way between two points of the unrolled panel keeps to the material.
    pub fn sees(&self, a: [f64; 2], b: [f64; 2]) -> bool {
        for [x0, x1] in &self.openings[0] {
            for [s0, s1] in &self.openings[1] {
                // Part of the way within the opening's inside, by clipping.
                let (mut from, mut to) = (0.0_f64, 1.0_f64);
                for (axis, [low, high]) in [[*x0, *x1], [*s0, *s1]].into_iter().enumerate() {
                    let by = b[axis] - a[axis];
                    let (low, high) = (low + 1e-12, high - 1e-12);
                    if by == 0.0 {
                        if a[axis] <= low || a[axis] >= high {
                            (from, to) = (1.0, 0.0);
                        }
                    } else {
                        let (enter, leave) = ((low - a[axis]) / by, (high - a[axis]) / by);
                        from = from.max(enter.min(leave));
                        to = to.min(enter.max(leave));
                    }
                }
                if from < to {
                    return false;
                }
            }
        }
        true
    }

    /// Points about `spacing` apart, on every edge of an opening too. Two triangles share a cell, their diagonals in turns, so
    /// that none of both directions is preferred.
    pub fn triangulate(&self, spacing: f64) -> Triangulation {
        let lines = |axis: usize| {
            let half = self.size[axis] / 2.0;
            let mut stops = vec![-half];
            stops.extend(self.openings[axis].iter().flatten());
            stops.push(half);
            let mut lines = vec![-half];
            for pair in stops.windows(2) {
                let n = ((pair[1] - pair[0]) / spacing).round().max(1.0) as u32;
                lines.extend((1..=n).map(|k| {
                    if k == n { pair[1] } else { pair[0] + (pair[1] - pair[0]) * f64::from(k) / f64::from(n) }
                }));
            }
            lines
        };
        let (xs, ss) = (lines(0), lines(1));
        let mut number = vec![u32::MAX; xs.len() * ss.len()];
        let (mut points, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
        for j in 0..ss.len() - 1 {
            for i in 0..xs.len() - 1 {
                let middle = [f64::midpoint(xs[i], xs[i + 1]), f64::midpoint(ss[j], ss[j + 1])];
                if self.opening(middle).is_some() {
                    continue;
                }
                let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| {
                    let n = &mut number[j * xs.len() + i];
                    if *n == u32::MAX {
                        *n = points.len() as u32;
                        let (point, normal) = self.roll([xs[i], ss[j]]);
                        points.push(point);
                        normals.push(normal);
                    }
                    *n
                });
                // x runs along the axis, s towards +y, the normal out: x, s, normal are right-handed.
                if (i + j) % 2 == 0 {
                    triangles.extend([[a, b, c], [a, c, d]]);
                } else {
                    triangles.extend([[a, b, d], [b, c, d]]);
                }
            }
        }
        (points, normals, triangles)
    }
}
