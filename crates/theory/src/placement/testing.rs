//! A plate that is held at both ends, with elements that read its bending along x where they are.

use dermis_fixtures::Analytic;
use dermis_skin::{Surface, SurfaceSpec};
use nalgebra::Point3;

use super::{Field, Location};

/// \[m\] size, and reach of a press.
const SIZE: [f64; 2] = [0.2, 0.12];
const REACH: f64 = 0.03;

fn model(nx: usize, ny: usize) -> Analytic {
    let at = |i: usize, n: usize, l: f64| (i as f64 / (n - 1) as f64 - 0.5) * l * 0.9;
    let elements = (0..nx * ny).map(|i| Point3::new(at(i % nx, nx, SIZE[0]), at(i / nx, ny, SIZE[1]), 0.0));
    let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: SIZE, spacing: 0.01 });
    Analytic::new(surface, elements, 3.0, |c, e| {
        let free = 1.0 - (c.position.x / (0.55 * SIZE[0])).powi(2);
        let (dx, dy) = ((c.position.x - e.x) / REACH, (c.position.y - e.y) / REACH);
        -c.force.z * 60.0 * free * (1.0 - dx * dx) * (-(dx * dx + dy * dy) / 2.0).exp()
    })
}

/// Readings of nx × ny elements for presses of 10 N all over the plate.
pub fn plate(nx: usize, ny: usize) -> Field {
    let model = model(nx, ny);
    let surface = &model.surface;
    let inside = |p: &Point3<f64>| p.x.abs() < 0.095 && p.y.abs() < 0.055;
    let locations: Vec<Location> = surface
        .points
        .iter()
        .zip(&surface.normals)
        .filter(|(p, _)| inside(p))
        .map(|(point, normal)| Location { point: *point, normal: *normal })
        .collect();
    Field::of_model(&model, &locations, &[10.0], 0.01, &|_| true).unwrap().unwrap()
}
