//! Displacement along the normals under forces along the normals, between all nodes.

use std::sync::Mutex;

use nalgebra::Vector3;

use super::{FREEDOMS, Shell};
use crate::MechanicsError;
use crate::fem::sparse::{BLOCK, HELD};

/// Displacement of every node along its normal, for a force along the normal of every node: G = Nᵀ K⁻¹ N \[m/N\].
#[derive(Debug, Clone, PartialEq)]
pub struct Green {
    nodes: usize,
    /// By columns.
    values: Vec<f32>,
}

impl Green {
    /// How many nodes it is between.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.nodes
    }

    /// \[m/N\] of all nodes along their normals, for a force along the normal of `node`; by reciprocity also of `node`, for a
    /// force on each.
    ///
    /// # Panics
    ///
    /// Where there is no such node.
    #[must_use]
    pub fn column(&self, node: usize) -> &[f32] {
        &self.values[node * self.nodes..(node + 1) * self.nodes]
    }

    /// All columns, one after the other.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.values
    }
}

impl Shell {
    /// Solves for a force of 1 N along the normal of each node, on all cores. Numbers are computed in double and kept in
    /// single precision.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Count`] unless there is one normal a node.
    pub fn normal_green(&self, normals: &[Vector3<f64>]) -> Result<Green, MechanicsError> {
        let nodes = self.mesh.points.len();
        if normals.len() != nodes {
            return Err(MechanicsError::Count {
                what: "normals of the shell",
                got: normals.len(),
                expected: nodes,
            });
        }
        self.normal_green_of_first(normals)
    }

    /// The same between the first nodes only, as many as there are normals: those that a mesh had before it was refined.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Count`] where there are more normals than nodes.
    pub fn normal_green_of_first(&self, normals: &[Vector3<f64>]) -> Result<Green, MechanicsError> {
        let nodes = normals.len();
        if nodes > self.mesh.points.len() {
            return Err(MechanicsError::Count {
                what: "normals of the shell",
                got: nodes,
                expected: self.mesh.points.len(),
            });
        }
        let mut values = vec![0.0f32; nodes * nodes];
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let work = Mutex::new(values.chunks_mut((BLOCK * nodes).max(1)).enumerate());
        let size = self.unknowns();
        // Where the normal displacement of each node is found among the unknowns.
        let parts = |node: usize| {
            (0..3).filter_map(move |k| {
                let unknown = self.unknowns[FREEDOMS * node + k];
                (unknown != HELD).then(|| (unknown, normals[node][k]))
            })
        };
        std::thread::scope(|scope| {
            for _ in 0..threads {
                scope.spawn(|| {
                    let mut columns = vec![0.0; size * BLOCK];
                    loop {
                        // Nobody panics while it is locked: taking the next piece cannot fail.
                        let next = work.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next();
                        let Some((block, out)) = next else { break };
                        let count = out.len() / nodes;
                        let columns = &mut columns[..size * count];
                        columns.fill(0.0);
                        for j in 0..count {
                            for (unknown, part) in parts(BLOCK * block + j) {
                                columns[j * size + unknown] = part;
                            }
                        }
                        self.factor.solve_columns(columns, count);
                        for (j, out) in out.chunks_exact_mut(nodes).enumerate() {
                            let column = &columns[j * size..(j + 1) * size];
                            for (node, out) in out.iter_mut().enumerate() {
                                *out = parts(node).map(|(unknown, part)| column[unknown] * part).sum::<f64>()
                                    as f32;
                            }
                        }
                    }
                });
            }
        });
        Ok(Green { nodes, values })
    }
}
