//! Ridges of the inside: waves too fine for the grid, which move with it.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::elastic::basis::Grid;
use crate::elastic::mesh::Elastomer;

/// Ridges of the inside, moulded along its rings and its meridians: waves of the surface's height, and of its slope.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ridges {
    /// \[m\] along the meridian from ridge to ridge.
    pub pitch: f64,
    /// Ridges around.
    pub count: u32,
    /// \[m\] from trough to crest.
    pub height: f64,
}

/// Directions of a place of the inside in which ridges follow each other, times what a metre along them changes of the ridges' phases \[rad\].
pub type Phases = [Vector3<f64>; 2];

impl Ridges {
    /// Phases \[rad\] of the ridges at (s, φ), and how they change from there; `normal` points inwards.
    #[must_use]
    pub fn phases(
        &self,
        elastomer: &Elastomer,
        [s, azimuth]: [f64; 2],
        normal: &Vector3<f64>,
    ) -> ([f64; 2], Phases) {
        let (sin, cos) = azimuth.sin_cos();
        let around = Vector3::new(-sin, cos, 0.0);
        let depth = elastomer.thickness_at(s, azimuth);
        let r = elastomer.thumb.meridian(s, depth)[0];
        // On the tip, the inside is shorter than the outside that s is measured on.
        let shorter =
            if s < elastomer.thumb.cap() { 1.0 - depth * elastomer.thumb.curvature(s) } else { 1.0 };
        let wave = TAU / self.pitch;
        let count = f64::from(self.count);
        // Ridges along meridians end where they would be closer than those along rings.
        let closest = if r * wave >= count { count / r } else { 0.0 };
        let phases = [wave * s, count * azimuth];
        (phases, [normal.cross(&around) * (wave / shorter), around * closest])
    }

    /// The inward normal with the ridges' slopes.
    #[must_use]
    pub fn tilted(&self, normal: &Vector3<f64>, phases: [f64; 2], along: &Phases) -> Vector3<f64> {
        let slope = |k: usize| along[k] * (0.5 * self.height * phases[k].sin());
        (normal + slope(0) + slope(1)).normalize()
    }

    /// \[rad\] by which phases change from row to row and from column to column of a grid.
    #[must_use]
    pub fn per_cell(&self, grid: &Grid) -> [f64; 2] {
        [TAU / self.pitch * grid.step, TAU * f64::from(self.count) / grid.columns as f64]
    }
}
