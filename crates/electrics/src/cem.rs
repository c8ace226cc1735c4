//! The complete electrode model.
//!
//! Problem: potentials of a sheet and of the electrodes on its rim when currents go through the electrodes. Method: the complete electrode
//! model, whose electrodes are equipotential and touch the sheet through a contact impedance (E. Somersalo, M. Cheney, D. Isaacson,
//! *Existence and uniqueness for electrode models for electric current computed tomography*, SIAM J. Appl. Math. 52, 1992), in linear
//! triangles (P. J. Vauhkonen, *Image reconstruction in three-dimensional electrical impedance tomography*, 2004, section 2.3); the
//! equations are symmetric and positive but for a constant, and solved by conjugate gradients with a diagonal preconditioner (Y. Saad,
//! *Iterative methods for sparse linear systems*, 2003, algorithm 9.1). Assumptions: a thin sheet, so that potentials do not change across
//! it; one conductance per square in each triangle; one contact impedance for all electrodes. Cost: some hundred products with a
//! matrix of seven numbers a node for each drive.

use crate::{Adjacent, Density, ElectricsError, Mesh, Rim};

/// How electrodes touch the sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contacts {
    /// \[Ω·m\] contact impedance of a unit of an electrode's length.
    pub impedance: f64,
}

/// A sheet with its electrodes.
#[derive(Debug, Clone)]
pub struct Sheet {
    mesh: Mesh,
    /// Unknowns: nodes, then electrodes. Columns and values of every row.
    rows: Vec<Vec<(usize, f64)>>,
}

/// Share of the right side that may be left.
const TOLERANCE: f64 = 1e-10;

impl Sheet {
    /// A sheet of one conductance \[S\] per square.
    ///
    /// # Errors
    ///
    /// [`ElectricsError`] where conductance or impedance is not positive, or the mesh impossible.
    pub fn uniform(
        rim: &Rim,
        density: Density,
        conductance: f64,
        contacts: Contacts,
    ) -> Result<Self, ElectricsError> {
        let mesh = Mesh::new(rim, density)?;
        let conductances = vec![conductance; mesh.triangles.len()];
        Self::new(mesh, &conductances, contacts)
    }

    /// A sheet with a conductance \[S\] per square in every triangle of its mesh.
    ///
    /// # Errors
    ///
    /// [`ElectricsError::Value`] where one is not positive, or their number is not that of the triangles.
    pub fn new(mesh: Mesh, conductances: &[f64], contacts: Contacts) -> Result<Self, ElectricsError> {
        let positive = |what, value: f64| {
            if value.is_finite() && value > 0.0 {
                return Ok(());
            }
            Err(ElectricsError::Value { what, value, must: "a positive number" })
        };
        positive("the contact impedance", contacts.impedance)?;
        conductances.iter().try_for_each(|value| positive("a conductance", *value))?;
        if conductances.len() != mesh.triangles.len() {
            let must = "one for each triangle";
            return Err(ElectricsError::Value {
                what: "the number of conductances",
                value: conductances.len() as f64,
                must,
            });
        }
        let nodes = mesh.nodes.len();
        let mut matrix = Matrix { rows: vec![Vec::new(); nodes + mesh.electrodes.len()] };
        for (triangle, conductance) in mesh.triangles.iter().zip(conductances) {
            let (area, gradients) = mesh.gradients(*triangle);
            for (i, a) in triangle.iter().zip(&gradients) {
                for (j, b) in triangle.iter().zip(&gradients) {
                    matrix.add(*i, *j, conductance * area * (a[0] * b[0] + a[1] * b[1]));
                }
            }
        }
        for (electrode, segments) in mesh.electrodes.iter().enumerate() {
            let own = nodes + electrode;
            for segment in segments {
                let share = mesh.length(*segment) / contacts.impedance;
                let [a, b] = *segment;
                for (i, j, part) in [(a, a, 3.0), (a, b, 6.0), (b, a, 6.0), (b, b, 3.0)] {
                    matrix.add(i, j, share / part);
                }
                for node in [a, b] {
                    matrix.add(node, own, -0.5 * share);
                    matrix.add(own, node, -0.5 * share);
                }
                matrix.add(own, own, share);
            }
        }
        Ok(Self { mesh, rows: matrix.rows })
    }

    /// Potentials \[V\] of nodes and of electrodes for currents \[A\] into the electrodes, whose sum is taken to be zero; potentials have
    /// the mean zero over the electrodes.
    ///
    /// # Errors
    ///
    /// [`ElectricsError`] where there is not one current for each electrode, or the equations are not solved.
    pub fn solve(&self, currents: &[f64]) -> Result<(Vec<f64>, Vec<f64>), ElectricsError> {
        let (nodes, electrodes) = (self.mesh.nodes.len(), self.mesh.electrodes.len());
        if currents.len() != electrodes {
            let must = "one for each electrode";
            let value = currents.len() as f64;
            return Err(ElectricsError::Value { what: "the number of currents", value, must });
        }
        let mut right = vec![0.0; nodes];
        right.extend_from_slice(currents);
        let mut all = self.conjugate_gradients(&right)?;
        let mean = all[nodes..].iter().sum::<f64>() / electrodes as f64;
        all.iter_mut().for_each(|v| *v -= mean);
        let own = all.split_off(nodes);
        Ok((all, own))
    }

    /// Potentials of the electrodes \[V\] for a drive of 1 A at each pair, one row a drive.
    ///
    /// # Errors
    ///
    /// As [`solve`](Self::solve).
    pub fn potentials(&self, pattern: Adjacent) -> Result<Vec<Vec<f64>>, ElectricsError> {
        (0..pattern.electrodes)
            .map(|k| {
                let (source, sink) = pattern.drive(k);
                let mut currents = vec![0.0; self.mesh.electrodes.len()];
                currents[source] = 1.0;
                currents[sink] = -1.0;
                Ok(self.solve(&currents)?.1)
            })
            .collect()
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    fn conjugate_gradients(&self, right: &[f64]) -> Result<Vec<f64>, ElectricsError> {
        let n = right.len();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let diagonal: Vec<f64> = (0..n)
            .map(|i| self.rows[i].iter().find(|(j, _)| *j == i).map_or(1.0, |(_, value)| *value))
            .collect();
        let precondition = |r: &[f64]| r.iter().zip(&diagonal).map(|(r, d)| r / d).collect::<Vec<f64>>();
        let (mut x, mut r) = (vec![0.0; n], right.to_vec());
        let mut z = precondition(&r);
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        let norm = dot(right, right).sqrt();
        let most = 20 * n;
        for _ in 0..most {
            if dot(&r, &r).sqrt() <= TOLERANCE * norm {
                return Ok(x);
            }
            let product: Vec<f64> =
                self.rows.iter().map(|row| row.iter().map(|(j, value)| value * p[*j]).sum()).collect();
            let step = rz / dot(&p, &product);
            x.iter_mut().zip(&p).for_each(|(x, p)| *x += step * p);
            r.iter_mut().zip(&product).for_each(|(r, q)| *r -= step * q);
            z = precondition(&r);
            let next = dot(&r, &z);
            let keep = next / rz;
            rz = next;
            p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + keep * *p);
        }
        Err(ElectricsError::NotSolved { steps: most, residual: dot(&r, &r).sqrt() / norm })
    }
}

/// Rows of a sparse matrix that is being added up.
struct Matrix {
    rows: Vec<Vec<(usize, f64)>>,
}

impl Matrix {
    fn add(&mut self, row: usize, column: usize, value: f64) {
        let row = &mut self.rows[row];
        match row.iter_mut().find(|(j, _)| *j == column) {
            Some((_, sum)) => *sum += value,
            None => row.push((column, value)),
        }
    }
}

#[cfg(test)]
mod tests;
