//! Finer triangles where stress is steep.
//!
//! At an opening's corner of 270° stress is singular, and along a free edge a twisted shell that shears across its thickness has
//! a layer as narrow as h/√10. Triangles as long as the thickness see neither: their error falls with the first power of their
//! size. Splitting those at edges and corners alone buys the same accuracy with fewer triangles.
//!
//! Method: longest-edge refinement. M.-C. Rivara, *Algorithms for refining triangular grids suitable for adaptive and multigrid
//! techniques*, Int. J. Numer. Meth. Engng 20 (1984) 745-756. Every triangle is cut at the middle of its longest side first, so
//! that angles stay above half the smallest one of before. Cost: linear in the number of triangles.

use std::collections::{HashMap, HashSet};

use nalgebra::{Point3, Vector3};

use super::{Quads, ShellMesh};

/// \[rad\] of material around a point of an edge from which on it counts as a corner that goes in.
const CORNER: f64 = 1.15 * std::f64::consts::PI;
/// How often triangles at corners are split after those at edges were.
const AT_CORNERS: usize = 2;
/// Sides are as long as each other within this share: rounding does not decide.
const AS_LONG: f64 = 1e-9;

/// A mesh that was refined. Its first points are those of the mesh before, unmoved.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Refined {
    /// The finer mesh.
    pub mesh: ShellMesh,
    /// Which triangle of before each triangle is a part of.
    pub parents: Vec<u32>,
    /// Of each point that is new: the two points, among those that come before it, in whose middle it lies.
    pub ends: Vec<[u32; 2]>,
}

type Edge = (u32, u32);

fn edge(a: u32, b: u32) -> Edge {
    (a.min(b), a.max(b))
}

fn sides([a, b, c]: [u32; 3]) -> [Edge; 3] {
    [edge(a, b), edge(b, c), edge(c, a)]
}

impl Refined {
    fn whole(mesh: &ShellMesh) -> Self {
        let parents = (0..mesh.triangles.len() as u32).collect();
        Self { mesh: mesh.clone(), parents, ends: Vec::new() }
    }

    /// Points whose number is true, and the new ones between two that are, and so on: what a piece of an edge hands on to the
    /// points that it got.
    #[must_use]
    pub fn inherit(&self, of_before: &[usize]) -> Vec<usize> {
        let before = self.mesh.points.len() - self.ends.len();
        let mut has = vec![false; self.mesh.points.len()];
        for &n in of_before {
            has[n] = true;
        }
        for (k, [a, b]) in self.ends.iter().enumerate() {
            has[before + k] = has[*a as usize] && has[*b as usize];
        }
        (0..has.len()).filter(|&n| has[n]).collect()
    }

    /// Splits the triangles of which `marked` is true into four, and those beside them as far as needed.
    fn split(&mut self, marked: impl Fn(&[u32; 3]) -> bool, place: &impl Fn(Point3<f64>) -> Point3<f64>) {
        let points = &self.mesh.points;
        let length = |(a, b): Edge| (points[a as usize] - points[b as usize]).norm();
        // Corners of each triangle, those of its longest side first.
        let turned: Vec<[u32; 3]> = self
            .mesh
            .triangles
            .iter()
            .map(|t| {
                let lengths = sides(*t).map(length);
                let longer = |best: usize, k: usize| lengths[k] > lengths[best] * (1.0 + AS_LONG);
                let first = (1..3).fold(0, |best, k| if longer(best, k) { k } else { best });
                [0, 1, 2].map(|k| t[(first + k) % 3])
            })
            .collect();
        let mut cut: HashSet<Edge> = turned.iter().filter(|t| marked(t)).flat_map(|t| sides(*t)).collect();
        loop {
            let more: Vec<Edge> = turned
                .iter()
                .map(|t| sides(*t))
                .filter(|[longest, b, c]| !cut.contains(longest) && (cut.contains(b) || cut.contains(c)))
                .map(|[longest, ..]| longest)
                .collect();
            if more.is_empty() {
                break;
            }
            cut.extend(more);
        }

        let mut points = points.clone();
        let mut middles: HashMap<Edge, u32> = HashMap::new();
        let (mut triangles, mut parents) = (Vec::new(), Vec::new());
        for (t, parent) in turned.into_iter().zip(&self.parents) {
            let [a, b, c] = t;
            let [m, n, o] = sides(t).map(|side| {
                cut.contains(&side).then(|| {
                    *middles.entry(side).or_insert_with(|| {
                        points.push(place(nalgebra::center(
                            &points[side.0 as usize],
                            &points[side.1 as usize],
                        )));
                        self.ends.push([side.0, side.1]);
                        points.len() as u32 - 1
                    })
                })
            });
            let Some(m) = m else {
                triangles.push(t);
                parents.push(*parent);
                continue;
            };
            let from = triangles.len();
            match o {
                Some(o) => triangles.extend([[a, m, o], [o, m, c]]),
                None => triangles.push([a, m, c]),
            }
            match n {
                Some(n) => triangles.extend([[m, b, n], [m, n, c]]),
                None => triangles.push([m, b, c]),
            }
            parents.extend(triangles[from..].iter().map(|_| *parent));
        }
        self.mesh = ShellMesh { points, triangles };
        self.parents = parents;
    }
}

impl ShellMesh {
    /// The mesh with triangles of half the size along its edges, and of an eighth at corners that go in. `place` moves the
    /// middle of a side to where the surface is; points of before stay.
    #[must_use]
    pub fn graded(&self, place: impl Fn(Point3<f64>) -> Point3<f64>) -> Refined {
        let mut refined = Refined::whole(self);
        let edges: Vec<bool> = self.around_edges().into_iter().map(|angle| angle.is_some()).collect();
        refined.split(|t| t.iter().any(|n| edges[*n as usize]), &place);
        let corners: HashSet<u32> = (0u32..)
            .zip(refined.mesh.around_edges())
            .filter(|(_, angle)| angle.is_some_and(|angle| angle > CORNER))
            .map(|(n, _)| n)
            .collect();
        for _ in 0..AT_CORNERS {
            refined.split(|t| t.iter().any(|n| corners.contains(n)), &place);
        }
        refined
    }

    /// The mesh with every triangle split into four, `times` times.
    #[must_use]
    pub fn finer(&self, times: usize, place: impl Fn(Point3<f64>) -> Point3<f64>) -> Refined {
        let mut refined = Refined::whole(self);
        for _ in 0..times {
            refined.split(|_| true, &place);
        }
        refined
    }

    /// Of each point of an edge, the angle \[rad\] of material around it.
    fn around_edges(&self) -> Vec<Option<f64>> {
        let mut angles = vec![0.0; self.points.len()];
        let mut triangles_of: HashMap<Edge, u32> = HashMap::new();
        for t in &self.triangles {
            for k in 0..3 {
                let [p, q, r] = [0, 1, 2].map(|j| self.points[t[(k + j) % 3] as usize]);
                angles[t[k] as usize] += (q - p).angle(&(r - p));
            }
            for side in sides(*t) {
                *triangles_of.entry(side).or_default() += 1;
            }
        }
        let mut on_edge = vec![false; self.points.len()];
        for ((a, b), count) in triangles_of {
            if count == 1 {
                on_edge[a as usize] = true;
                on_edge[b as usize] = true;
            }
        }
        angles.into_iter().zip(on_edge).map(|(angle, on)| on.then_some(angle)).collect()
    }
}

impl Quads {
    /// The surface with every quadrilateral split into four; `place` moves middles to where the surface is. Points of before
    /// come first and stay.
    #[must_use]
    pub fn quartered(&self, place: impl Fn(Point3<f64>) -> Point3<f64>) -> Self {
        let mut points = self.points.clone();
        let mut middles: HashMap<Edge, u32> = HashMap::new();
        let mut quads = Vec::with_capacity(4 * self.quads.len());
        for &[a, b, c, d] in &self.quads {
            let [e, f, g, h] = [edge(a, b), edge(b, c), edge(c, d), edge(d, a)].map(|side| {
                *middles.entry(side).or_insert_with(|| {
                    points.push(place(nalgebra::center(&points[side.0 as usize], &points[side.1 as usize])));
                    points.len() as u32 - 1
                })
            });
            let sum = [a, b, c, d].iter().fold(Vector3::zeros(), |sum, n| sum + points[*n as usize].coords);
            points.push(place(Point3::from(sum / 4.0)));
            let m = points.len() as u32 - 1;
            quads.extend([[a, e, m, h], [e, b, f, m], [m, f, c, g], [h, m, g, d]]);
        }
        Self { points, quads }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 60 mm by 60 mm with an opening of 20 mm by 20 mm in its middle.
    fn frame() -> ShellMesh {
        Quads::grid_with_holes(
            6,
            6,
            |x, y| Point3::new(0.06 * x, 0.06 * y, 0.0),
            |i, j| (2..4).contains(&i) && (2..4).contains(&j),
        )
        .split()
    }

    fn sharpest(mesh: &ShellMesh) -> f64 {
        let angle = |t: &[u32; 3], k: usize| {
            let [p, q, r] = [0, 1, 2].map(|j| mesh.points[t[(k + j) % 3] as usize]);
            (q - p).angle(&(r - p))
        };
        mesh.triangles.iter().flat_map(|t| [0, 1, 2].map(|k| angle(t, k))).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn pieces_make_up_the_whole_and_fit_together() {
        let mesh = frame();
        let refined = mesh.graded(|p| p);
        assert_eq!(refined.mesh.points[..mesh.points.len()], mesh.points[..]);
        let area = |m: &ShellMesh| m.areas().iter().sum::<f64>();
        assert!((area(&refined.mesh) / area(&mesh) - 1.0).abs() < 1e-12);
        // Each triangle's pieces make up its area, and lie the same way round.
        let mut of_parent = vec![0.0; mesh.triangles.len()];
        for (t, parent) in refined.mesh.triangles.iter().zip(&refined.parents) {
            let [a, b, c] = t.map(|n| refined.mesh.points[n as usize]);
            let z = (b - a).cross(&(c - a)).z / 2.0;
            assert!(z > 0.0);
            of_parent[*parent as usize] += z;
        }
        for (t, got) in mesh.triangles.iter().zip(of_parent) {
            let [a, b, c] = t.map(|n| mesh.points[n as usize]);
            assert!((got / ((b - a).cross(&(c - a)).z / 2.0) - 1.0).abs() < 1e-9);
        }
        // No point lies on another triangle's side: the edges are as long as before.
        let edge_length = |m: &ShellMesh| {
            let mut count: HashMap<Edge, u32> = HashMap::new();
            m.triangles.iter().flat_map(|t| sides(*t)).for_each(|s| *count.entry(s).or_default() += 1);
            assert!(count.values().all(|n| *n < 3));
            let length = |(a, b): Edge| (m.points[a as usize] - m.points[b as usize]).norm();
            count.into_iter().filter(|(_, n)| *n == 1).map(|(s, _)| length(s)).sum::<f64>()
        };
        assert!((edge_length(&refined.mesh) - 0.32).abs() < 1e-12);
        assert!(sharpest(&refined.mesh) >= sharpest(&mesh) / 2.0);
    }

    #[test]
    fn corners_that_go_in_are_the_finest() {
        let mesh = frame();
        let refined = mesh.graded(|p| p).mesh;
        let longest_at = |place: Point3<f64>| {
            let n = refined.points.iter().position(|p| (p - place).norm() < 1e-9).unwrap() as u32;
            let at = refined.triangles.iter().filter(|t| t.contains(&n)).flat_map(|t| sides(*t));
            let length = |(a, b): Edge| (refined.points[a as usize] - refined.points[b as usize]).norm();
            at.map(length).fold(0.0, f64::max)
        };
        // From 14.1 mm along the diagonals: halved once along edges, twice more at the opening's corners.
        let side = 0.01 * 2f64.sqrt();
        assert!(longest_at(Point3::new(0.02, 0.02, 0.0)) < 1.01 * side / 8.0);
        assert!(longest_at(Point3::new(0.0, 0.0, 0.0)) > 0.99 * side / 2.0);
        assert!(longest_at(Point3::new(0.0, 0.03, 0.0)) < 1.01 * side / 2.0);
    }

    #[test]
    fn what_is_held_along_an_edge_is_held_between_its_points() {
        let mesh = frame();
        let held: Vec<usize> = (0..mesh.points.len()).filter(|n| mesh.points[*n].x == 0.0).collect();
        let refined = mesh.graded(|p| p);
        let points = &refined.mesh.points;
        let expected: Vec<usize> = (0..points.len()).filter(|n| points[*n].x == 0.0).collect();
        assert!(expected.len() == 2 * held.len() - 1);
        assert_eq!(refined.inherit(&held), expected);
    }

    #[test]
    fn quartered_quadrilaterals_make_up_the_whole() {
        let quads = Quads::grid(4, 2, |x, y| Point3::new(0.04 * x, 0.01 * y + 0.02 * x * y, 0.0));
        let finer = quads.quartered(|p| p);
        assert_eq!((finer.points.len(), finer.quads.len()), (9 * 5, 8 * 4));
        assert_eq!(finer.points[..quads.points.len()], quads.points[..]);
        let area = |q: &Quads| q.split().areas().iter().sum::<f64>();
        assert!((area(&finer) / area(&quads) - 1.0).abs() < 1e-12);
        assert!(finer.split().normals().iter().all(|n| n.z > 0.999));
    }

    #[test]
    fn finer_quarters_every_triangle() {
        let mesh = frame();
        let lifted = mesh.finer(2, |p| Point3::new(p.x, p.y, 0.001));
        assert_eq!(lifted.mesh.triangles.len(), 16 * mesh.triangles.len());
        assert!(lifted.mesh.points[mesh.points.len()..].iter().all(|p| p.z == 0.001));
        assert!(lifted.parents.iter().all(|p| (*p as usize) < mesh.triangles.len()));
    }
}
