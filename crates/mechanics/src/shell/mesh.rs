//! Triangles, and quadrilaterals that are split into them.

use nalgebra::{Point3, Vector3};

use crate::MechanicsError;

/// The middle surface of a shell.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShellMesh {
    /// \[m\]; each belongs to a triangle.
    pub points: Vec<Point3<f64>>,
    /// Corners, counter-clockwise seen from the outer side.
    pub triangles: Vec<[u32; 3]>,
}

/// A surface of quadrilaterals.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Quads {
    /// \[m\]; each belongs to a quadrilateral.
    pub points: Vec<Point3<f64>>,
    /// Corners, counter-clockwise seen from the outer side.
    pub quads: Vec<[u32; 4]>,
}

impl Quads {
    /// `nx` by `ny` quadrilaterals between points at `place(x, y)` with x and y from 0 to 1; points follow x first. The outer
    /// side is where x turns to y counter-clockwise.
    #[must_use]
    pub fn grid(nx: usize, ny: usize, place: impl Fn(f64, f64) -> Point3<f64>) -> Self {
        Self::grid_with_holes(nx, ny, place, |_, _| false)
    }

    /// The same without the quadrilaterals of which `hole(i, j)` is true, and without the points that then belong to none.
    #[must_use]
    pub fn grid_with_holes(
        nx: usize,
        ny: usize,
        place: impl Fn(f64, f64) -> Point3<f64>,
        hole: impl Fn(usize, usize) -> bool,
    ) -> Self {
        let mut quads = Vec::new();
        for j in 0..ny {
            for i in (0..nx).filter(|&i| !hole(i, j)) {
                let a = j * (nx + 1) + i;
                quads.push([a, a + 1, a + nx + 2, a + nx + 1]);
            }
        }
        // Numbers of the points that are used.
        let mut numbers = vec![u32::MAX; (nx + 1) * (ny + 1)];
        for n in quads.iter().flatten() {
            numbers[*n] = 0;
        }
        let mut points = Vec::new();
        for (n, number) in numbers.iter_mut().enumerate().filter(|(_, number)| **number == 0) {
            *number = points.len() as u32;
            let share = |k: usize, of: usize| k as f64 / of as f64;
            points.push(place(share(n % (nx + 1), nx), share(n / (nx + 1), ny)));
        }
        let quads = quads.into_iter().map(|q| q.map(|n| numbers[n])).collect();
        Self { points, quads }
    }

    /// The quadrilaterals of a mesh that has two triangles of each, one after the other. `None` where a pair of triangles has
    /// no side in common.
    #[must_use]
    pub fn join(mesh: &ShellMesh) -> Option<Self> {
        let (pairs, []) = mesh.triangles.as_chunks::<2>() else { return None };
        let quads = pairs
            .iter()
            .map(|[first, second]| {
                // The corner that only the first has comes first, the other's lies across.
                let k = first.iter().position(|n| !second.contains(n))?;
                let [a, b, d] = [0, 1, 2].map(|i| first[(k + i) % 3]);
                let c = *second.iter().find(|n| !first.contains(n))?;
                (second.contains(&b) && second.contains(&d)).then_some([a, b, c, d])
            })
            .collect::<Option<Vec<_>>>()?;
        Some(Self { points: mesh.points.clone(), quads })
    }

    /// Two triangles of each quadrilateral, along its shorter diagonal; along the other one in every second quadrilateral
    /// where both are as long, so that no direction is preferred.
    #[must_use]
    pub fn split(&self) -> ShellMesh {
        let mut triangles = Vec::with_capacity(2 * self.quads.len());
        let length = |a: u32, b: u32| (self.points[a as usize] - self.points[b as usize]).norm();
        for (k, &[a, b, c, d]) in self.quads.iter().enumerate() {
            let (first, second) = (length(a, c), length(b, d));
            let even = (first - second).abs() < 1e-9 * first;
            if if even { k % 2 == 0 } else { first < second } {
                triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
        ShellMesh { points: self.points.clone(), triangles }
    }
}

impl ShellMesh {
    /// What is wrong with it, if anything.
    pub(super) fn check(&self) -> Result<(), MechanicsError> {
        let mut used = vec![false; self.points.len()];
        for (triangle, corners) in self.triangles.iter().enumerate() {
            let [a, b, c] = *corners;
            if corners.iter().any(|n| *n as usize >= self.points.len()) {
                return Err(MechanicsError::Triangle {
                    triangle,
                    what: "has a corner that is not among the points",
                });
            }
            if a == b || b == c || c == a {
                return Err(MechanicsError::Triangle { triangle, what: "has the same corner twice" });
            }
            for n in corners {
                used[*n as usize] = true;
            }
        }
        if let Some(node) = self.points.iter().position(|p| !p.coords.iter().all(|x| x.is_finite())) {
            return Err(MechanicsError::Node {
                node,
                what: "is not a place: its coordinates are not finite",
            });
        }
        if let Some(node) = used.iter().position(|used| !used) {
            return Err(MechanicsError::Node { node, what: "belongs to no triangle" });
        }
        if self.triangles.is_empty() {
            return Err(MechanicsError::Count { what: "triangles of the shell", got: 0, expected: 1 });
        }
        Ok(())
    }

    /// Unit, out of the outer side: the mean of the triangles around each point, by their areas.
    #[must_use]
    pub fn normals(&self) -> Vec<Vector3<f64>> {
        let mut normals = vec![Vector3::zeros(); self.points.len()];
        for t in &self.triangles {
            let [a, b, c] = t.map(|n| self.points[n as usize]);
            let area = (b - a).cross(&(c - a));
            for n in t {
                normals[*n as usize] += area;
            }
        }
        normals.into_iter().map(|n| n.try_normalize(0.0).unwrap_or_else(Vector3::z)).collect()
    }

    /// \[m²\] around each point: a third of each triangle.
    #[must_use]
    pub fn areas(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.points.len()];
        for t in &self.triangles {
            let [a, b, c] = t.map(|n| self.points[n as usize]);
            for n in t {
                areas[*n as usize] += (b - a).cross(&(c - a)).norm() / 6.0;
            }
        }
        areas
    }

    /// Of each point, which connected part it belongs to, counted from 0.
    pub(super) fn parts(&self) -> Vec<usize> {
        let mut parent: Vec<usize> = (0..self.points.len()).collect();
        fn root(parent: &mut [usize], mut n: usize) -> usize {
            while parent[n] != n {
                parent[n] = parent[parent[n]];
                n = parent[n];
            }
            n
        }
        for t in &self.triangles {
            for k in 1..3 {
                let (a, b) = (root(&mut parent, t[0] as usize), root(&mut parent, t[k] as usize));
                parent[a.max(b)] = a.min(b);
            }
        }
        let mut names = vec![usize::MAX; parent.len()];
        let mut count = 0;
        (0..parent.len())
            .map(|n| {
                let root = root(&mut parent, n);
                if names[root] == usize::MAX {
                    names[root] = count;
                    count += 1;
                }
                names[root]
            })
            .collect()
    }
}
