//! Where elements could be.

use anyhow::Result;
use dermis_skin::{SkinDescription, Surface, SurfaceSpec, Taxel};
use nalgebra::Point3;

/// Candidates of a family without a preference.
const MOST: usize = 1500;

/// Places below the surface, as deep as the present elements lie (their median), and with the axis of the first, if it has one.
pub fn below_the_surface(skin: &SkinDescription) -> Result<Vec<Taxel>> {
    let surface = skin.surface();
    let mut depths: Vec<f64> = skin
        .taxels
        .iter()
        .map(|t| {
            let (foot, normal) = surface.project(&t.point());
            (foot - t.point()).dot(&normal)
        })
        .collect();
    depths.sort_by(f64::total_cmp);
    let depth = depths[depths.len() / 2];
    let every = surface.points.len().div_ceil(MOST);
    let points = surface.points.iter().zip(&surface.normals).step_by(every);
    Ok(points
        .enumerate()
        .map(|(n, (point, normal))| Taxel {
            name: format!("c{n}"),
            position: (point - normal * depth).into(),
            normal: (*normal).into(),
            axis: skin.taxels.first().and_then(|t| t.axis),
        })
        .collect())
}

/// Where a surface is held: the ends of a panel along x. Other shapes are held from below, everywhere.
pub fn held(spec: &SurfaceSpec, surface: &Surface) -> Vec<Point3<f64>> {
    if !matches!(spec, SurfaceSpec::Panel { .. }) {
        return Vec::new();
    }
    let end = surface.points.iter().map(|p| p.x.abs()).fold(0.0, f64::max);
    surface.points.iter().filter(|p| p.x.abs() > end - 1e-6).copied().collect()
}
