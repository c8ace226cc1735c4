//! A rubber plate that is held at its edges, pushed in so far that it stretches.

use nalgebra::{Point3, Vector3};

use super::quadratic::{LAST_SIDE, Quadratic};
use super::{CalculixError, Load, Model};
use crate::fem::HexMesh;

/// A plate whose edges cannot move.
#[derive(Debug, Clone, Copy)]
pub struct Plate {
    /// \[m\] along x and y.
    pub size: [f64; 2],
    /// \[m\] along z.
    pub thickness: f64,
    /// \[Pa\]
    pub young_modulus: f64,
    /// Lateral contraction per extension.
    pub poisson_ratio: f64,
    /// \[m\] radius of the patch in its middle that is pushed.
    pub patch: f64,
    /// Cells along x, y and z.
    pub cells: [usize; 3],
}

impl Plate {
    /// Its cells: the middle is at the origin, forces act on the side of the largest z.
    #[must_use]
    pub fn mesh(&self) -> HexMesh {
        let planes = |length: f64, cells: usize, from: f64| -> Vec<f64> {
            (0..=cells).map(|i| from + length * i as f64 / cells as f64).collect()
        };
        let [x, y] = [0, 1].map(|k| planes(self.size[k], self.cells[k], -self.size[k] / 2.0));
        HexMesh::block([&x, &y, &planes(self.thickness, self.cells[2], 0.0)])
    }

    /// Whether a place is on an edge.
    #[must_use]
    pub fn held(&self, p: &Point3<f64>) -> bool {
        [p.x, p.y].iter().zip(self.size).any(|(p, size)| (p.abs() - size / 2.0).abs() < 1e-9)
    }

    /// Cells whose last side has its middle within the patch.
    #[must_use]
    pub fn pushed(&self, mesh: &HexMesh) -> Vec<usize> {
        let within = |cell: &usize| {
            let corners = LAST_SIDE[..4].iter().map(|k| mesh.nodes[mesh.cells[*cell][*k] as usize].coords);
            let middle = corners.sum::<Vector3<f64>>() / 4.0;
            (middle.z - self.thickness).abs() < 1e-9 && middle.xy().norm() <= self.patch
        };
        (0..mesh.cells.len()).filter(within).collect()
    }

    /// The node in the middle of the side that is not pushed.
    ///
    /// # Errors
    ///
    /// [`CalculixError::Results`] where the cells have none there.
    pub fn middle(&self, nodes: &[Point3<f64>]) -> Result<usize, CalculixError> {
        let middle = nodes.iter().position(|p| p.coords.norm() < 1e-9);
        middle.ok_or(CalculixError::Results("node in the middle"))
    }
}

/// How far the middle of the other side gives way \[m\] under forces \[N\] on the patch that keep their direction, by neo-Hookean solids under large
/// displacements; forces rise.
///
/// # Errors
///
/// [`CalculixError`] where there is no CalculiX, or it fails.
pub fn plate_deflections(plate: &Plate, forces: &[f64]) -> Result<Vec<f64>, CalculixError> {
    let mesh = plate.mesh();
    let solid = Quadratic::new(&mesh, |middle| middle);
    let held = (0..solid.nodes.len()).filter(|n| plate.held(&solid.nodes[*n])).map(|n| (n, [true; 3]));
    let held = held.collect();
    let (shares, points) = solid.spread(plate.pushed(&mesh).into_iter(), |_| -Vector3::z());
    let whole: f64 = points.iter().map(|(_, f)| f.norm()).sum();
    let load = |force: &f64| Load {
        forces: shares.iter().map(|(n, share)| (*n, share * (force / whole))).collect(),
        ..Load::default()
    };
    let middle = plate.middle(&solid.nodes)?;
    let model = Model {
        held,
        nodes: solid.nodes,
        element: "C3D20R",
        elements: solid.cells,
        young_modulus: plate.young_modulus,
        poisson_ratio: plate.poisson_ratio,
        large: true,
        sensors: Vec::new(),
        loads: forces.iter().map(load).collect(),
    };
    Ok(model.solve()?.iter().map(|answer| -answer.displacements[middle].z).collect())
}
