//! Where elements cannot be.

use dermis_skin::{Surface, SurfaceSpec};
use nalgebra::Point3;

/// Where a surface is held: the ends of a panel along x. Other shapes are held from below, everywhere.
pub fn held(spec: &SurfaceSpec, surface: &Surface) -> Vec<Point3<f64>> {
    if !matches!(spec, SurfaceSpec::Panel { .. }) {
        return Vec::new();
    }
    let end = surface.points.iter().map(|p| p.x.abs()).fold(0.0, f64::max);
    surface.points.iter().filter(|p| p.x.abs() > end - 1e-6).copied().collect()
}

/// \[m\] between neighbouring points of a surface, as if each had the same square of its area to itself.
pub(crate) fn point_spacing(surface: &Surface) -> f64 {
    (surface.areas.iter().sum::<f64>() / surface.points.len() as f64).sqrt()
}
