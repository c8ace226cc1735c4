//! Surfaces laid flat.

use dermis_skin::{SkinDescription, Surface, SurfaceSpec};
use nalgebra::Point3;

/// Points of a surface laid flat \[mm\]: as they are on a flat one; otherwise at their distance along the surface from its
/// highest point, in their direction.
#[must_use]
pub fn flat(surface: &Surface, points: &[Point3<f64>]) -> (Vec<(f64, f64)>, [&'static str; 2]) {
    let level = surface.normals.iter().all(|n| n.z > 0.999);
    if level {
        return (points.iter().map(|p| (p.x * 1e3, p.y * 1e3)).collect(), ["x [mm]", "y [mm]"]);
    }
    let top = surface.points.iter().max_by(|a, b| a.z.total_cmp(&b.z)).copied().unwrap_or_default();
    let laid = points.iter().zip(surface.geodesics(&top, points)).map(|(p, far)| {
        let (far, turn) = (far * 1e3, (p.y - top.y).atan2(p.x - top.x));
        (far * turn.cos(), far * turn.sin())
    });
    (laid.collect(), ["along the surface from the tip, towards x [mm]", "towards y [mm]"])
}

/// The same \[mm\] of a skin: a panel is unrolled.
#[must_use]
pub fn laid_flat(
    skin: &SkinDescription,
    surface: &Surface,
    points: &[Point3<f64>],
) -> (Vec<(f64, f64)>, [&'static str; 2]) {
    if let SurfaceSpec::Panel { radius, .. } = skin.surface {
        let unrolled = points.iter().map(|p| (p.x * 1e3, -p.y.atan2(p.z) * radius * 1e3)).collect();
        return (unrolled, ["along the limb [mm]", "along the arc [mm]"]);
    }
    flat(surface, points)
}
