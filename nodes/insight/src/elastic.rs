//! What the elastomer does: a mesh over the skeleton, its compliance, and what presses it.

pub mod basis;
pub mod contact;
pub mod mesh;

pub use basis::{Basis, Field, Grid};
pub use contact::Footprint;
pub use mesh::{Elastomer, Fovea, Meridians, Skeleton};

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::shape::Thumb;
    use crate::surface::Rings;

    /// A thumb in few cells, its points of the outside, and the grid of its inside.
    pub fn coarse() -> (Elastomer, Rings, Grid) {
        let thumb = Thumb::new(0.020, 0.070, 0.009).unwrap();
        let end = thumb.way_to(0.0115);
        let elastomer = Elastomer {
            thumb,
            thickness: 0.004,
            young_modulus: 70e3,
            poisson_ratio: 0.49,
            density: 1070.0,
            skeleton: Skeleton {
                beam: 0.0016,
                inside: 0.0008,
                rings: vec![0.020, 0.036, 0.052, end],
                meridians: vec![Meridians { count: 4, from: 0.012, azimuth: 0.0 }],
            },
            fovea: Some(Fovea { from_tip: 0.028, azimuth: 0.8, size: [0.013, 0.011], thickness: 0.0012 }),
            around: 4,
            layers: 5,
            cell: 0.004,
        };
        let grid = Grid::new(thumb.length(), 0.004, 32);
        (elastomer, Rings::new(&thumb, end, 0.008), grid)
    }
}
