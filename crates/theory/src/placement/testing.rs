//! A plate that is held at both ends, with elements that read its bending along x where they are.

use dermis_model::{ForwardModel, Stimulus};
use dermis_skin::{ModelError, Surface, SurfaceSpec};
use nalgebra::Point3;

use super::{Field, Place};

pub struct Plate {
    pub surface: Surface,
    pub elements: Vec<Point3<f64>>,
    pub noise: Vec<f64>,
}

/// \[m\] size, and reach of a press.
pub const SIZE: [f64; 2] = [0.2, 0.12];
const REACH: f64 = 0.03;

impl Plate {
    pub fn new(nx: usize, ny: usize) -> Self {
        let at = |i: usize, n: usize, l: f64| (i as f64 / (n - 1) as f64 - 0.5) * l * 0.9;
        let elements: Vec<_> = (0..nx * ny)
            .map(|i| Point3::new(at(i % nx, nx, SIZE[0]), at(i / nx, ny, SIZE[1]), 0.0))
            .collect();
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: SIZE, spacing: 0.01 });
        Self { surface, noise: vec![3.0; elements.len()], elements }
    }
}

impl ForwardModel for Plate {
    fn channels(&self) -> usize {
        self.elements.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for c in &stimulus.contacts {
            let free = 1.0 - (c.position.x / (0.55 * SIZE[0])).powi(2);
            for (value, e) in out.iter_mut().zip(&self.elements) {
                let (dx, dy) = ((c.position.x - e.x) / REACH, (c.position.y - e.y) / REACH);
                *value += -c.force.z * 60.0 * free * (1.0 - dx * dx) * (-(dx * dx + dy * dy) / 2.0).exp();
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

/// Readings of nx × ny elements for presses of 10 N all over the plate.
pub fn plate(nx: usize, ny: usize) -> Field {
    let model = Plate::new(nx, ny);
    let surface = &model.surface;
    let inside = |p: &Point3<f64>| p.x.abs() < 0.095 && p.y.abs() < 0.055;
    let places: Vec<Place> = surface
        .points
        .iter()
        .zip(&surface.normals)
        .filter(|(p, _)| inside(p))
        .map(|(point, normal)| Place { point: *point, normal: *normal })
        .collect();
    Field::of_model(&model, &places, &[10.0], 0.01, &|_| true).unwrap().unwrap()
}
