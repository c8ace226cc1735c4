//! A rubber plate that is held at its edges, pushed in so far that it stretches.

use std::collections::HashMap;

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

    /// The corners of cells' sides whose middle is within the patch.
    #[must_use]
    pub fn pushed(&self, mesh: &HexMesh) -> Vec<[usize; 4]> {
        let sides = mesh.cells.iter().map(|cell| [4, 5, 6, 7].map(|k| cell[k] as usize));
        let within = |side: &[usize; 4]| {
            let middle = side.iter().map(|n| mesh.nodes[*n].coords).sum::<Vector3<f64>>() / 4.0;
            (middle.z - self.thickness).abs() < 1e-9 && middle.xy().norm() <= self.patch
        };
        sides.filter(within).collect()
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
    let sides = plate.pushed(&mesh);
    let solid = Quadratic::new(&mesh, |middle| middle);
    let held = (0..solid.nodes.len()).filter(|n| plate.held(&solid.nodes[*n])).map(|n| (n, [true; 3]));
    let held = held.collect();
    // An even pressure on a side of eight nodes is a third of its force on each node between two corners, less a twelfth on each corner.
    let mut shares: HashMap<usize, f64> = HashMap::new();
    for cell in &solid.cells {
        let side = LAST_SIDE.map(|k| cell[k]);
        if sides.iter().any(|corners| corners.iter().all(|n| side[..4].contains(n))) {
            for (k, n) in side.iter().enumerate() {
                *shares.entry(*n).or_default() += if k < 4 { -1.0 / 12.0 } else { 1.0 / 3.0 };
            }
        }
    }
    let whole: f64 = shares.values().sum();
    let load = |force: &f64| {
        let push = |(n, share): (&usize, &f64)| (*n, Vector3::new(0.0, 0.0, -force * share / whole));
        Load { forces: shares.iter().map(push).collect(), ..Load::default() }
    };
    let middle = |p: &Point3<f64>| p.coords.norm() < 1e-9;
    let middle = solid.nodes.iter().position(middle).ok_or(CalculixError::Results("node in the middle"))?;
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
