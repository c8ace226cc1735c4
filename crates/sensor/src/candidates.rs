//! Where sensing elements could be.

use dermis_skin::{SkinDescription, Taxel};

/// Most candidates of a family without a preference.
const MOST: usize = 1500;

/// Locations below the points of the surface, as deep as the present elements lie (their median), and with the axis of the first,
/// if it has one. At most 1500.
#[must_use]
pub fn below_the_surface(skin: &SkinDescription) -> Vec<Taxel> {
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
    let depth = depths.get(depths.len() / 2).copied().unwrap_or(0.0);
    let every = surface.points.len().div_ceil(MOST).max(1);
    let points = surface.points.iter().zip(&surface.normals).step_by(every);
    points
        .enumerate()
        .map(|(n, (point, normal))| Taxel {
            name: format!("c{n}"),
            position: (point - normal * depth).into(),
            normal: (*normal).into(),
            axis: skin.taxels.first().and_then(|t| t.axis),
        })
        .collect()
}
