//! Linear elasticity on hexahedra.

use nalgebra::{Matrix3, Point3, Vector3};

use super::mesh::{CORNERS, HexMesh};
use super::sparse::{Factor, HELD, Symmetric};
use crate::error::positive;
use crate::{MechanicsError, Medium};

/// A body of linear elastic, isotropic material on a mesh of hexahedra, its stiffness factored: any number of loads can
/// be requested.
///
/// Displacements are trilinear; the dilatation is replaced by its mean over each cell (B-bar), which keeps a nearly
/// incompressible material from locking. (T. J. R. Hughes, *The Finite Element Method*, §4.5.)
#[derive(Debug)]
pub struct Solid {
    mesh: HexMesh,
    bulk: f64,
    /// Unknowns of each node.
    dofs: Vec<[usize; 3]>,
    unknowns: usize,
    factor: Factor,
}

/// A cell's gradients of its shape functions at the points of integration with their weights, and the mean gradients with
/// the volume.
struct Gradients {
    points: [([Vector3<f64>; 8], f64); 8],
    mean: [Vector3<f64>; 8],
    volume: f64,
}

fn gradients(corners: &[Point3<f64>; 8]) -> Option<Gradients> {
    let mut points = [([Vector3::zeros(); 8], 0.0); 8];
    let mut mean = [Vector3::zeros(); 8];
    let mut volume = 0.0;
    for (place, at) in points.iter_mut().zip(CORNERS) {
        let xi = at.map(|c| c / 3f64.sqrt());
        let local: [Vector3<f64>; 8] = CORNERS.map(|c| {
            let f = [1.0 + c[0] * xi[0], 1.0 + c[1] * xi[1], 1.0 + c[2] * xi[2]];
            Vector3::new(c[0] * f[1] * f[2], f[0] * c[1] * f[2], f[0] * f[1] * c[2]) / 8.0
        });
        let mut jacobian = Matrix3::zeros();
        for (g, p) in local.iter().zip(corners) {
            jacobian += g * p.coords.transpose();
        }
        let determinant = jacobian.determinant();
        if determinant.is_nan() || determinant <= 0.0 {
            return None;
        }
        let inverse = jacobian.try_inverse()?;
        let global = local.map(|g| inverse * g);
        for (m, g) in mean.iter_mut().zip(&global) {
            *m += g * determinant;
        }
        volume += determinant;
        *place = (global, determinant);
    }
    for m in &mut mean {
        *m /= volume;
    }
    Some(Gradients { points, mean, volume })
}

/// A cell's stiffness, 24 × 24 by rows; unknowns follow the corners, three each.
fn stiffness(g: &Gradients, shear: f64, bulk: f64) -> Vec<f64> {
    let mut k = vec![0.0; 24 * 24];
    for a in 0..8 {
        for b in a..8 {
            let mut block = g.mean[a] * g.mean[b].transpose() * (bulk * g.volume);
            for (gradient, weight) in &g.points {
                let (x, y) = (&gradient[a], &gradient[b]);
                let part =
                    Matrix3::identity() * x.dot(y) + y * x.transpose() - x * y.transpose() * (2.0 / 3.0);
                block += part * (shear * weight);
            }
            for i in 0..3 {
                for j in 0..3 {
                    k[(3 * a + i) * 24 + 3 * b + j] = block[(i, j)];
                    k[(3 * b + j) * 24 + 3 * a + i] = block[(i, j)];
                }
            }
        }
    }
    k
}

impl Solid {
    /// A body of `young_modulus` \[Pa\] and `poisson_ratio`; `held` says of each node, by its index and place, which of
    /// its displacements are none.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a number cannot be, [`MechanicsError::Mesh`] for a cell that is turned inside
    /// out, [`MechanicsError::Singular`] where the body is not held.
    pub fn new(
        mesh: HexMesh,
        young_modulus: f64,
        poisson_ratio: f64,
        held: impl Fn(usize, &Point3<f64>) -> [bool; 3],
    ) -> Result<Self, MechanicsError> {
        positive("Young's modulus [Pa]", young_modulus)?;
        // The same bounds as a layer's.
        Medium::half_space(young_modulus, poisson_ratio)?;
        let bulk = young_modulus / (3.0 * (1.0 - 2.0 * poisson_ratio));
        let shear = young_modulus / (2.0 * (1.0 + poisson_ratio));
        let mut unknowns = 0;
        let dofs: Vec<[usize; 3]> = mesh
            .nodes
            .iter()
            .enumerate()
            .map(|(i, p)| {
                held(i, p).map(|held| {
                    if held {
                        HELD
                    } else {
                        unknowns += 1;
                        unknowns - 1
                    }
                })
            })
            .collect();
        let elements: Vec<[usize; 24]> = mesh
            .cells
            .iter()
            .map(|cell| std::array::from_fn(|k| dofs[cell[k / 3] as usize][k % 3]))
            .collect();
        let mut matrix = Symmetric::new(unknowns, elements.iter().map(<[usize; 24]>::as_slice));
        for (cell, dofs) in elements.iter().enumerate() {
            let g = gradients(&mesh.corners(&mesh.cells[cell])).ok_or(MechanicsError::Mesh { cell })?;
            matrix.add(dofs, &stiffness(&g, shear, bulk));
        }
        let first: Vec<usize> =
            mesh.dissect().into_iter().flat_map(|n| dofs[n as usize]).filter(|&dof| dof != HELD).collect();
        let factor = matrix.factor(&matrix.order(Some(&first))?)?;
        Ok(Self { mesh, bulk, dofs, unknowns, factor })
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> &HexMesh {
        &self.mesh
    }

    /// Displacements \[m\] of all nodes for each load, which is a list of forces \[N\] at nodes.
    #[must_use]
    pub fn displacements(&self, loads: &[Vec<(usize, Vector3<f64>)>]) -> Vec<Vec<Vector3<f64>>> {
        let mut columns: Vec<Vec<f64>> = loads
            .iter()
            .map(|load| {
                let mut column = vec![0.0; self.unknowns];
                for (node, force) in load {
                    for (dof, f) in self.dofs[*node].iter().zip(force.iter()) {
                        if *dof != HELD {
                            column[*dof] += f;
                        }
                    }
                }
                column
            })
            .collect();
        self.factor.solve(&mut columns);
        columns
            .iter()
            .map(|column| {
                let of = |dof: usize| if dof == HELD { 0.0 } else { column[dof] };
                self.dofs.iter().map(|d| Vector3::new(of(d[0]), of(d[1]), of(d[2]))).collect()
            })
            .collect()
    }

    /// The forces at nodes whose work on any displacement is the mean compressive stress −σₖₖ/3 \[Pa\] of that
    /// displacement, averaged over cells with weights. Their displacements are the influence of that average: \[Pa\] per
    /// \[N\] at each node.
    ///
    /// # Panics
    ///
    /// Where a cell is not in the mesh.
    #[must_use]
    pub fn pressure_load(&self, cells: &[(usize, f64)]) -> Vec<(usize, Vector3<f64>)> {
        let mut load = Vec::with_capacity(8 * cells.len());
        for &(cell, weight) in cells {
            let corners = &self.mesh.cells[cell];
            // A cell that has no gradients was refused when the body was made.
            if let Some(g) = gradients(&self.mesh.corners(corners)) {
                load.extend(
                    corners.iter().zip(g.mean).map(|(&n, m)| (n as usize, m * (-self.bulk * weight))),
                );
            }
        }
        load
    }

    /// Mean compressive stress −σₖₖ/3 \[Pa\] in a cell, of the displacements of all nodes.
    ///
    /// # Panics
    ///
    /// Where the cell is not in the mesh or a displacement is missing.
    #[must_use]
    pub fn pressure(&self, cell: usize, displacements: &[Vector3<f64>]) -> f64 {
        self.pressure_load(&[(cell, 1.0)]).iter().map(|(n, f)| f.dot(&displacements[*n])).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    /// Constant strain on a crooked mesh: no forces at inner nodes, the same stress everywhere.
    #[test]
    fn patch_test() {
        let axis = [0.0, 0.4, 1.0, 1.3];
        let mut mesh = HexMesh::block([&axis, &axis, &axis]);
        let inner = |p: &Point3<f64>| p.iter().all(|c| *c > 0.0 && *c < 1.3);
        let inside: Vec<bool> = mesh.nodes.iter().map(inner).collect();
        for (i, p) in mesh.nodes.iter_mut().enumerate() {
            if inside[i] {
                let wave = |k: f64| 0.08 * (k * (i as f64 + 1.0)).sin();
                *p += Vector3::new(wave(1.3), wave(2.7), wave(4.1));
            }
        }
        let gradient = Matrix3::new(0.3, -0.2, 0.5, 0.1, -0.4, 0.2, 0.6, 0.3, 0.2);
        let (shear, bulk) = (1.0, 50.0);
        let mut forces = vec![Vector3::zeros(); mesh.nodes.len()];
        for cell in &mesh.cells {
            let g = gradients(&mesh.corners(cell)).unwrap();
            let k = stiffness(&g, shear, bulk);
            let u: Vec<f64> = cell
                .iter()
                .flat_map(|&n| (gradient * mesh.nodes[n as usize].coords).iter().copied().collect::<Vec<_>>())
                .collect();
            for row in 0..24 {
                forces[cell[row / 3] as usize][row % 3] +=
                    (0..24).map(|c| k[row * 24 + c] * u[c]).sum::<f64>();
            }
        }
        for (f, inside) in forces.iter().zip(&inside) {
            assert!(!inside || f.norm() < 1e-13, "{f}");
        }
        // The work of the boundary's forces is twice the energy of that strain.
        let strain = (gradient + gradient.transpose()) / 2.0;
        let trace = strain.trace();
        let energy = 2.0 * shear * (strain.norm_squared() - trace * trace / 3.0) + bulk * trace * trace;
        let work: f64 = forces.iter().zip(&mesh.nodes).map(|(f, p)| f.dot(&(gradient * p.coords))).sum();
        assert_relative_eq!(work, energy * 1.3f64.powi(3), max_relative = 1e-12);
    }

    /// A tube under inner pressure in plane strain (G. Lamé): the inner wall's displacement, exact.
    #[test]
    fn lame_tube_does_not_lock() {
        let (a, b, e, p) = (10.0, 17.2, 70.0, 1.0);
        for poisson in [0.3, 0.49, 0.4999] {
            let exact =
                (1.0 + poisson) / e * p * a * a / (b * b - a * a) * ((1.0 - 2.0 * poisson) * a + b * b / a);
            let (cells, quarter) = (24, std::f64::consts::FRAC_PI_2);
            let radii: Vec<f64> = (0..=8).map(|i| a + (b - a) * f64::from(i) / 8.0).collect();
            let angles: Vec<f64> = (0..=cells).map(|i| quarter * f64::from(i) / f64::from(cells)).collect();
            let mut mesh = HexMesh::block([&radii, &angles, &[0.0, 1.0]]);
            let polar: Vec<(f64, f64)> = mesh.nodes.iter().map(|n| (n.x, n.y)).collect();
            for n in &mut mesh.nodes {
                let (r, t) = (n.x, n.y);
                (n.x, n.y) = (r * t.cos(), r * t.sin());
            }
            let end = |t: f64, at: f64| (t - at).abs() < 1e-9;
            let solid =
                Solid::new(mesh, e, poisson, |i, _| [end(polar[i].1, quarter), end(polar[i].1, 0.0), true])
                    .unwrap();
            // Pressure on the chords of the inner wall, half of each at either end, over both ends of unit length.
            let chord = 2.0 * a * (quarter / f64::from(cells) / 2.0).sin();
            let load = polar
                .iter()
                .enumerate()
                .filter(|(_, (r, _))| *r == a)
                .map(|(i, (_, t))| {
                    let share = if end(*t, 0.0) || end(*t, quarter) { 0.5 } else { 1.0 };
                    (i, Vector3::new(t.cos(), t.sin(), 0.0) * (p * chord * share / 2.0))
                })
                .collect();
            let u = solid.displacements(&[load]).remove(0);
            for (i, (r, t)) in polar.iter().enumerate() {
                if *r == a {
                    let radial = u[i].x * t.cos() + u[i].y * t.sin();
                    assert_relative_eq!(radial, exact, max_relative = 0.01);
                }
            }
            if poisson == 0.49 {
                assert_relative_eq!(exact, 0.32372, max_relative = 1e-4);
            }
        }
    }

    #[test]
    fn what_is_not_held_is_refused() {
        let mesh = HexMesh::block([&[0.0, 1.0], &[0.0, 1.0], &[0.0, 1.0]]);
        let error = Solid::new(mesh.clone(), 1.0, 0.3, |_, _| [false; 3]).unwrap_err();
        insta::assert_snapshot!(error, @"the body can move without being deformed, or its numbers are too far apart to be solved: hold it somewhere");
        let mut crushed = mesh;
        crushed.nodes[7].z = -3.0;
        let error = Solid::new(crushed, 1.0, 0.3, |i, _| [i < 4; 3]).unwrap_err();
        insta::assert_snapshot!(error, @"cell 0 of the mesh is turned inside out");
    }

    /// The dome's cells are upright and fill what they shall.
    #[test]
    fn dome_has_its_volume() {
        let (r, h, t) = (0.010, 0.016, 0.0072);
        let mesh = HexMesh::dome(r, h, t, 12, 6).unwrap();
        let volume: f64 = mesh.cells.iter().map(|c| gradients(&mesh.corners(c)).unwrap().volume).sum();
        let of = |r: f64| std::f64::consts::PI * r * r * (h + 2.0 / 3.0 * r);
        assert_relative_eq!(volume, of(r) - of(r - t), max_relative = 0.02);
        assert!(HexMesh::dome(r, h, 0.010, 12, 6).is_err());
    }
}
