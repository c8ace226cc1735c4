//! The equations of each harmonic, and their solution.

use nalgebra::Vector3;

use super::boundary::Boundary;
use super::element::{DOFS, NODES, stiffness, transform};
use super::meridian::{Frame, Meridian, Role};
use crate::fem::source::Source;
use crate::fem::sparse::{HELD, Ordering, Symmetric};
use crate::{Base, MechanicsError};

/// Stiffness of an element as a polynomial of second degree in the number of the harmonic: its three coefficients.
type Parts = [Vec<f64>; 3];

/// The unknowns of one harmonic.
struct Unknowns {
    harmonic: usize,
    frames: Vec<Frame>,
    free: usize,
    given: usize,
    /// Of each element: the number of each displacement, or [`HELD`].
    dofs: Vec<Vec<usize>>,
}

impl Unknowns {
    fn new(mesh: &Meridian, harmonic: usize, base: Base) -> Self {
        let (frames, free, given) = mesh.frames(harmonic, base);
        let dofs = mesh
            .elements()
            .map(|nodes| {
                nodes
                    .iter()
                    .flat_map(|&n| frames[n].map(|(_, role)| if let Role::Free(i) = role { i } else { HELD }))
                    .collect()
            })
            .collect();
        Self { harmonic, frames, free, given, dofs }
    }

    /// Right-hand sides, and the displacements that are given, of each source.
    fn loads(&self, boundary: &Boundary, sources: usize) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
        let mut columns = vec![vec![0.0; self.free]; sources];
        let mut values = vec![vec![0.0; self.given]; sources];
        for source in 0..sources {
            for (n, frame) in self.frames.iter().enumerate() {
                for (vector, role) in frame {
                    match *role {
                        Role::Free(i) => {
                            columns[source][i] += vector.dot(&boundary.load(source, self.harmonic, n));
                        }
                        Role::Given(i) => {
                            values[source][i] = vector.dot(&boundary.displacement(source, self.harmonic, n));
                        }
                        Role::None => {}
                    }
                }
            }
        }
        (columns, values)
    }

    /// Adds every element to the matrix, and what given displacements contribute to the right-hand sides.
    fn assemble(
        &self,
        mesh: &Meridian,
        parts: &[Parts],
        matrix: &mut Symmetric,
        columns: &mut [Vec<f64>],
        values: &[Vec<f64>],
    ) {
        let number = self.harmonic as f64;
        for ((nodes, parts), dofs) in mesh.elements().zip(parts).zip(&self.dofs) {
            let mut local: Vec<f64> = parts[0]
                .iter()
                .zip(&parts[1])
                .zip(&parts[2])
                .map(|((a, b), c)| a + number * (b + number * c))
                .collect();
            transform(&mut local, &nodes.map(|n| self.frames[n].map(|(v, _)| v)));
            matrix.add(dofs, &local);
            let roles: Vec<Role> = nodes.iter().flat_map(|&n| self.frames[n].map(|(_, role)| role)).collect();
            for (k, role) in roles.iter().enumerate() {
                let Role::Given(g) = *role else { continue };
                for (column, values) in columns.iter_mut().zip(values) {
                    for (i, &dof) in dofs.iter().enumerate() {
                        if dof != HELD {
                            column[dof] -= local[i * DOFS + k] * values[g];
                        }
                    }
                }
            }
        }
    }

    /// Displacement of a node: radial, around, along the axis.
    fn displacement(&self, node: usize, free: &[f64], given: &[f64]) -> Vector3<f64> {
        self.frames[node]
            .iter()
            .map(|(vector, role)| match *role {
                Role::Free(i) => vector * free[i],
                Role::Given(i) => vector * given[i],
                Role::None => Vector3::zeros(),
            })
            .sum()
    }
}

impl Meridian {
    /// Amplitudes (radial, around, along the axis) on the outside of what the boundaries send back, at each of `arcs`, for
    /// each harmonic of each source.
    pub(super) fn solve(
        &self,
        poisson_ratio: f64,
        base: Base,
        sources: &[Source],
        harmonics: usize,
        arcs: &[f64],
    ) -> Result<Vec<[f64; 3]>, MechanicsError> {
        let parts = self.parts(poisson_ratio)?;
        let edges = self.edges(base);
        let boundary = Boundary::new(self, &edges, sources, harmonics);
        let outside: Vec<(usize, [f64; 3])> = arcs.iter().map(|&arc| self.on_outside(arc)).collect();
        let mut answer = vec![[0.0; 3]; sources.len() * (harmonics + 1) * arcs.len()];
        // From the second harmonic on, all have the same unknowns.
        let mut kept: Option<(Symmetric, Ordering)> = None;
        for m in 0..=harmonics {
            let unknowns = Unknowns::new(self, m, base);
            let (mut matrix, ordering) = match kept.take() {
                Some((mut matrix, ordering)) if m > 2 => {
                    matrix.clear();
                    (matrix, ordering)
                }
                _ => {
                    let matrix = Symmetric::new(unknowns.free, unknowns.dofs.iter().map(Vec::as_slice));
                    let ordering = matrix.order(None)?;
                    (matrix, ordering)
                }
            };
            let (mut columns, values) = unknowns.loads(&boundary, sources.len());
            unknowns.assemble(self, &parts, &mut matrix, &mut columns, &values);
            matrix.factor(&ordering)?.solve(&mut columns);
            for (source, column) in columns.iter().enumerate() {
                let at = |node: usize| unknowns.displacement(node, column, &values[source]);
                for (i, (first, weights)) in outside.iter().enumerate() {
                    let sum: Vector3<f64> =
                        weights.iter().enumerate().map(|(j, w)| at(first + j * self.line()) * *w).sum();
                    answer[(source * (harmonics + 1) + m) * arcs.len() + i] = sum.into();
                }
            }
            if m >= 2 {
                kept = Some((matrix, ordering));
            }
        }
        Ok(answer)
    }

    /// Of each element, from its stiffness in the harmonics 0, 1 and −1.
    fn parts(&self, poisson_ratio: f64) -> Result<Vec<Parts>, MechanicsError> {
        self.elements()
            .enumerate()
            .map(|(cell, nodes)| {
                let locations: [[f64; 2]; NODES] = nodes.map(|n| self.nodes[n]);
                let [zero, one, minus] = [0.0, 1.0, -1.0].map(|m| stiffness(&locations, m, poisson_ratio));
                match (zero, one, minus) {
                    (Some(zero), Some(one), Some(minus)) => {
                        let linear = one.iter().zip(&minus).map(|(a, b)| (a - b) / 2.0).collect();
                        let square =
                            one.iter().zip(&minus).zip(&zero).map(|((a, b), c)| (a + b) / 2.0 - c).collect();
                        Ok([zero, linear, square])
                    }
                    _ => Err(MechanicsError::Mesh { cell }),
                }
            })
            .collect()
    }
}
