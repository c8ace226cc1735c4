//! What the elastomer does: a mesh over the skeleton, its compliance, and what presses it.

pub mod basis;
pub mod contact;
pub mod mesh;
pub mod stretching;

pub use basis::{Basis, Field, Grid};
pub use contact::Footprint;
pub use mesh::{Elastomer, Fovea, Meridians, Skeleton};
pub use stretching::Stretching;

#[cfg(test)]
pub(crate) mod tests {
    use dermis_mechanics::{Base, Medium, SphereContact};
    use dermis_model::{Tip, TipShape};

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

    /// Where the skeleton fills everything below 12 mm, the elastomer is a bonded layer: a sphere sinks into it as it does into the layer of
    /// [`dermis_mechanics`], whose contact is solved exactly. Points of the outside are as far apart as nodes: 7 and 10 % too deep remain, as a
    /// point's own force does not spread over its cell.
    #[test]
    fn a_sphere_sinks_in_as_into_a_bonded_layer() {
        let thumb = Thumb::new(0.060, 0.075, 0.055).unwrap();
        let elastomer = Elastomer {
            thumb,
            thickness: 0.016,
            skeleton: Skeleton {
                beam: 0.004,
                inside: 0.0,
                rings: (0..16).map(|i| 0.004 * f64::from(i)).collect(),
                meridians: Vec::new(),
            },
            fovea: None,
            around: 14,
            layers: 8,
            cell: 0.004,
            ..coarse().0
        };
        let rings = Rings::new(&thumb, 0.014, 0.002);
        let basis = Basis::of(&elastomer, &rings, Grid::new(thumb.length(), 0.004, 32), 0.03).unwrap();
        let layer = Medium::layer(70e3, 0.49, 0.012, Base::Bonded).unwrap();
        let modulus = 70e3 / (1.0 - 0.49f64.powi(2));
        let (at, normal) = thumb.point(0.0, 0.0, 0.0);
        for diameter in [0.024, 0.04] {
            let radius = contact::relative_radius(&thumb, 0.0, diameter);
            let exact = SphereContact::at_indentation(&layer, radius, 0.004).unwrap();
            let force = exact.force();
            let footprint = Footprint::of_sphere(&thumb, &rings, &at, [diameter, force, modulus]);
            let depth = basis.mean_give(&footprint.shares, &(-normal * force)) + footprint.height;
            assert!((depth / exact.indentation() - 1.0).abs() < 0.12, "{diameter}: {depth}");
            // What is solved for tips of any shape finds the same for a ball.
            let ball = Tip::standing(TipShape::Sphere { diameter }, &normal);
            let footprint = Footprint::of_tip((&thumb, &rings, &basis), &at, &ball, [force, 1.0]).unwrap();
            let depth = basis.mean_give(&footprint.shares, &(-normal * force)) + footprint.height;
            assert!((depth / exact.indentation() - 1.0).abs() < 0.12, "{diameter}: {depth} as any tip");
        }
    }
}
