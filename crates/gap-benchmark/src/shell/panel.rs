//! A clamped panel of facets: the strain in each gauge under a force anywhere, by reciprocity.

use dermis_skin::SurfaceSpec;
use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};
use nalgebra::{Matrix3, Vector3};

use super::plate::{Facet, Material, Wall};
use super::relief::Relief;

/// Shape of the panel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shape {
    /// \[m\] of the outside.
    pub radius: f64,
    /// \[m\] along x and along the arc of the outside.
    pub size: [f64; 2],
    /// \[m\] of solid material at the ends and at the sides.
    pub borders: [f64; 2],
    /// Openings along both.
    pub cells: [u32; 2],
    /// \[m\] between openings.
    pub beam: [f64; 2],
}

impl Shape {
    pub fn of(spec: &SurfaceSpec) -> Option<Self> {
        match *spec {
            SurfaceSpec::Panel { radius, size, margin, rail, cells, beam, .. } => {
                Some(Self { radius, size, borders: [margin, rail], cells, beam })
            }
            _ => None,
        }
    }

    /// Where openings begin and end along an axis.
    fn openings(&self, axis: usize) -> Vec<[f64; 2]> {
        let n = f64::from(self.cells[axis]);
        let free = self.size[axis] - 2.0 * self.borders[axis] - (n - 1.0) * self.beam[axis];
        let first = -self.size[axis] / 2.0 + self.borders[axis];
        (0..self.cells[axis])
            .map(|i| first + f64::from(i) * (free / n + self.beam[axis]))
            .map(|from| [from, from + free / n])
            .collect()
    }

    /// Lines of the mesh along an axis, about `spacing` \[m\] apart, on every edge of an opening.
    fn lines(&self, axis: usize, spacing: f64) -> Vec<f64> {
        let half = self.size[axis] / 2.0;
        let mut edges = vec![-half];
        edges.extend(self.openings(axis).into_iter().flatten());
        edges.push(half);
        let mut lines = vec![-half];
        for pair in edges.windows(2) {
            let parts = ((pair[1] - pair[0]) / spacing).round().max(2.0);
            lines.extend((1..=parts as usize).map(|i| pair[0] + (pair[1] - pair[0]) * i as f64 / parts));
        }
        lines
    }
}

/// A gauge on the inner face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gauge {
    /// \[m\] of its middle, unrolled on the outside: along x and the arc.
    pub at: [f64; 2],
    /// \[rad\] from x towards the arc.
    pub angle: f64,
    /// \[m\] along and across.
    pub size: [f64; 2],
    /// Share of the strain across that it measures.
    pub across: f64,
}

/// What of a panel is not its shape.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Build {
    pub material: Material,
    /// \[m\] of the wall on average, which the facets lie in the middle of.
    pub wall: f64,
    pub relief: Relief,
    /// \[N/m\] of each clamped node along each direction.
    pub clamp: f64,
    /// \[m\] between lines of the mesh.
    pub spacing: f64,
}

impl Build {
    /// The wall at a place, unrolled.
    fn wall_at(&self, at: [f64; 2]) -> Wall<'_> {
        Wall { material: &self.material, thickness: self.wall * self.relief.at(at) }
    }
}

/// Influence of forces on gauges.
#[derive(Debug)]
pub(crate) struct Influence {
    shape: Shape,
    lines: [Vec<f64>; 2],
    /// Node of each crossing of lines; openings have none.
    nodes: Vec<Option<usize>>,
    /// Whether there is material between lines.
    solid: Vec<bool>,
    /// Strain of each gauge by a force of 1 N at each node, by its components.
    strains: Vec<Vec<Vector3<f64>>>,
}

/// Whether there is material between lines, and whether it touches each crossing of lines.
fn material(shape: &Shape, lines: &[Vec<f64>; 2]) -> (Vec<bool>, Vec<bool>) {
    let counts = [lines[0].len(), lines[1].len()];
    let openings = [shape.openings(0), shape.openings(1)];
    let inside =
        |axis: usize, value: f64| openings[axis].iter().any(|[from, to]| *from < value && value < *to);
    let mut solid = vec![false; (counts[0] - 1) * (counts[1] - 1)];
    let mut used = vec![false; counts[0] * counts[1]];
    for i in 0..counts[0] - 1 {
        for j in 0..counts[1] - 1 {
            let middle = |axis: usize, k: usize| 0.5 * (lines[axis][k] + lines[axis][k + 1]);
            if !(inside(0, middle(0, i)) && inside(1, middle(1, j))) {
                solid[i * (counts[1] - 1) + j] = true;
                for (p, q) in [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)] {
                    used[p * counts[1] + q] = true;
                }
            }
        }
    }
    (solid, used)
}

impl Influence {
    pub(super) fn new(shape: Shape, build: &Build, gauges: &[Gauge]) -> Option<Self> {
        let lines = [shape.lines(0, build.spacing), shape.lines(1, build.spacing)];
        let (solid, used) = material(&shape, &lines);
        let mut count = 0;
        let nodes: Vec<Option<usize>> = used
            .into_iter()
            .map(|used| {
                used.then(|| {
                    count += 1;
                    count - 1
                })
            })
            .collect();
        let mut influence = Self { shape, lines, nodes, solid, strains: Vec::new() };
        let entries = influence.stiffness(build);
        let matrix =
            SparseColMat::<usize, f64>::try_new_from_triplets(6 * count, 6 * count, &entries).ok()?;
        let mut sides = Mat::<f64>::zeros(6 * count, gauges.len());
        for (g, gauge) in gauges.iter().enumerate() {
            for (dof, value) in influence.strain_row(gauge, build) {
                sides[(dof, g)] += value;
            }
        }
        let answer = matrix.sp_cholesky(Side::Lower).ok()?.solve(&sides);
        influence.strains = (0..gauges.len())
            .map(|g| (0..count).map(|n| Vector3::from_fn(|i, _| answer[(6 * n + i, g)])).collect())
            .collect();
        Some(influence)
    }

    /// Lower half of the stiffness of all facets and clamps, six displacements a node.
    fn stiffness(&self, build: &Build) -> Vec<Triplet<usize, usize, f64>> {
        let counts = [self.lines[0].len(), self.lines[1].len()];
        let mut entries = Vec::new();
        for i in 0..counts[0] - 1 {
            for j in 0..counts[1] - 1 {
                let Some(corners) = self.corners(i, j) else { continue };
                let (facet, axes) = self.facet(i, j, build.wall);
                let middle = [
                    0.5 * (self.lines[0][i] + self.lines[0][i + 1]),
                    0.5 * (self.lines[1][j] + self.lines[1][j + 1]),
                ];
                let k = facet.stiffness(build.wall_at(middle));
                // Blocks of three turn with the facet.
                for a in 0..8 {
                    for b in 0..8 {
                        let block: Matrix3<f64> = k.fixed_view::<3, 3>(3 * a, 3 * b).into_owned();
                        let block = axes.transpose() * block * axes;
                        let (row, column) =
                            (6 * corners[a / 2] + 3 * (a % 2), 6 * corners[b / 2] + 3 * (b % 2));
                        for r in 0..3 {
                            for c in 0..3 {
                                if row + r >= column + c {
                                    entries.push(Triplet::new(row + r, column + c, block[(r, c)]));
                                }
                            }
                        }
                    }
                }
            }
        }
        for j in 0..counts[1] {
            for i in [0, counts[0] - 1] {
                let Some(node) = self.nodes[i * counts[1] + j] else { continue };
                for dof in 0..6 {
                    // A clamp that gives way by some length gives way by some angle, over its own depth of 10 mm.
                    let stiffness = build.clamp * if dof < 3 { 1.0 } else { 1e-4 };
                    entries.push(Triplet::new(6 * node + dof, 6 * node + dof, stiffness));
                }
            }
        }
        entries
    }

    /// Nodes at the corners of a facet.
    fn corners(&self, i: usize, j: usize) -> Option<[usize; 4]> {
        let across = self.lines[1].len();
        if !self.solid[i * (across - 1) + j] {
            return None;
        }
        let node = |p: usize, q: usize| self.nodes[p * across + q];
        Some([node(i, j)?, node(i + 1, j)?, node(i + 1, j + 1)?, node(i, j + 1)?])
    }

    /// A facet and its axes, as rows.
    fn facet(&self, i: usize, j: usize, wall: f64) -> (Facet, Matrix3<f64>) {
        let [from, to] = [self.lines[1][j], self.lines[1][j + 1]].map(|s| s / self.shape.radius);
        let chord = 2.0 * (self.shape.radius - wall / 2.0) * ((to - from) / 2.0).sin();
        let (sin, cos) = (0.5 * (from + to)).sin_cos();
        let facet = Facet { a: self.lines[0][i + 1] - self.lines[0][i], b: chord };
        (facet, Matrix3::new(1.0, 0.0, 0.0, 0.0, cos, -sin, 0.0, sin, cos))
    }

    /// The facet at a place and the place's natural coordinates in it.
    fn find(&self, at: [f64; 2]) -> Option<(usize, usize, (f64, f64))> {
        let place = |axis: usize| {
            let lines = &self.lines[axis];
            let k = lines.partition_point(|l| *l <= at[axis]).clamp(1, lines.len() - 1) - 1;
            let natural = 2.0 * (at[axis] - lines[k]) / (lines[k + 1] - lines[k]) - 1.0;
            (k, natural.clamp(-1.0, 1.0), natural)
        };
        let ((i, xi, raw_x), (j, eta, raw_y)) = (place(0), place(1));
        let outside = raw_x.abs() > 1.001 || raw_y.abs() > 1.001;
        (!outside && self.corners(i, j).is_some()).then_some((i, j, (xi, eta)))
    }

    /// Strain of a gauge as a sum over displacements.
    fn strain_row(&self, gauge: &Gauge, build: &Build) -> Vec<(usize, f64)> {
        let (sin, cos) = gauge.angle.sin_cos();
        let mut found = Vec::new();
        for p in [-0.35, -0.1, 0.1, 0.35] {
            for q in [-0.33, 0.0, 0.33] {
                let (along, across) = (p * gauge.size[0], q * gauge.size[1]);
                let at = [gauge.at[0] + along * cos - across * sin, gauge.at[1] + along * sin + across * cos];
                found.extend(self.find(at).map(|f| (f, at)));
            }
        }
        let share = 1.0 / found.len().max(1) as f64;
        let mut sum = Vec::new();
        for ((i, j, natural), at) in found {
            let Some(corners) = self.corners(i, j) else { continue };
            let (facet, axes) = self.facet(i, j, build.wall);
            let wall = build.wall_at(at);
            let strains = facet.strains(wall, natural, -wall.thickness / 2.0);
            let mix = [cos * cos, sin * sin, sin * cos];
            let turned = [sin * sin, cos * cos, -sin * cos];
            for corner in 0..4 {
                for half in 0..2 {
                    let local = Vector3::from_fn(|c, _| {
                        (0..3)
                            .map(|r| {
                                (mix[r] + gauge.across * turned[r]) * strains[(r, 6 * corner + 3 * half + c)]
                            })
                            .sum()
                    });
                    let global = axes.transpose() * local;
                    sum.extend((0..3).map(|c| (6 * corners[corner] + 3 * half + c, share * global[c])));
                }
            }
        }
        sum
    }

    /// Strain of each gauge by a force of 1 N along each axis, over a round patch of this radius \[m\] with a parabolic pressure.
    pub fn of_patch(&self, at: [f64; 2], radius: f64) -> Vec<Vector3<f64>> {
        let mut total = 0.0;
        let mut sums = vec![Vector3::zeros(); self.strains.len()];
        for ring in 0..4 {
            let r = (f64::from(ring) + 0.5) / 4.0;
            let around = 4 + 4 * ring;
            for k in 0..around {
                let (sin, cos) = (std::f64::consts::TAU * (f64::from(k) + 0.5) / f64::from(around)).sin_cos();
                let place = [at[0] + radius * r * cos, at[1] + radius * r * sin];
                let Some((i, j, natural)) = self.find(place) else { continue };
                let Some(corners) = self.corners(i, j) else { continue };
                let weight = (1.0 - r * r) * r / f64::from(around);
                total += weight;
                for (corner, share) in corners.into_iter().zip(Facet::shares(natural)) {
                    for (sum, strains) in sums.iter_mut().zip(&self.strains) {
                        *sum += strains[corner] * (weight * share);
                    }
                }
            }
        }
        sums.iter_mut().for_each(|s| *s /= f64::max(total, 1e-12));
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_strip_bends_as_a_clamped_beam() {
        // Nearly flat, no openings, no Poisson effect: at a clamp the strain of the inner face under a force in the middle is that of
        // the moment F L / 8.
        let shape =
            Shape { radius: 10.0, size: [0.1, 0.01], borders: [0.0, 0.0], cells: [0, 0], beam: [0.0, 0.0] };
        let build = Build {
            material: Material { young: [1e9, 1e9], poisson: 0.0 },
            wall: 0.002,
            relief: Relief::default(),
            clamp: 1e13,
            spacing: 0.0025,
        };
        let gauge = |x: f64| Gauge { at: [x, 0.0], angle: 0.0, size: [1e-4, 1e-4], across: 0.0 };
        let influence = Influence::new(shape, &build, &[gauge(-0.0499), gauge(0.0)]).unwrap();
        let strains = influence.of_patch([0.0, 0.0], 0.002);
        let moment = 0.1 / 8.0 * (1.0 - 4.0 * 0.0001 / 0.1);
        let strain = moment / (1e9 * 0.01 * f64::powi(0.002, 2) / 6.0);
        // A force inwards pulls the inner face in the middle and presses it at the ends.
        approx::assert_relative_eq!(-strains[0].z, -strain, max_relative = 0.02);
        approx::assert_relative_eq!(-strains[1].z, strain, max_relative = 0.05);
    }

    #[test]
    fn strains_settle_as_the_mesh_becomes_finer() {
        // A curved wall with openings: beams along the arc twist, and facets meet at an angle.
        let shape = Shape {
            radius: 0.045,
            size: [0.08, 0.08],
            borders: [0.01, 0.01],
            cells: [2, 2],
            beam: [0.01, 0.008],
        };
        let build = |spacing| Build {
            material: Material { young: [1.7e9, 1.7e9], poisson: 0.394 },
            wall: 0.002,
            relief: Relief::default(),
            clamp: 1e12,
            spacing,
        };
        let gauges: Vec<Gauge> = [[0.0, 0.0], [0.0, 0.02], [-0.02, 0.0]]
            .into_iter()
            .zip([0.0, std::f64::consts::FRAC_PI_2, 0.0])
            .map(|(at, angle)| Gauge { at, angle, size: [0.008, 0.005], across: 0.0 })
            .collect();
        let strains = |spacing| {
            let influence = Influence::new(shape, &build(spacing), &gauges).unwrap();
            let places = [[0.01, 0.0], [-0.02, 0.005], [0.005, 0.02], [0.0, -0.02]];
            places.map(|at| influence.of_patch(at, 0.005)).concat()
        };
        let (coarse, fine) = (strains(0.002), strains(0.001));
        let size = fine.iter().map(Vector3::norm_squared).sum::<f64>();
        let off: f64 = coarse.iter().zip(&fine).map(|(a, b)| (a - b).norm_squared()).sum();
        assert!(off < 0.05f64.powi(2) * size, "off by {} of the strains", (off / size).sqrt());
    }
}
