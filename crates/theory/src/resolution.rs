//! Super-resolution factors: how many virtual taxels a real one stands for.

use serde::Serialize;

/// Precision of the testbed that an error is measured with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Testbed {
    /// \[m\] resolution of its stage.
    pub position: f64,
    /// \[N\] standard deviation of its force sensor.
    pub force: f64,
}

impl Testbed {
    /// That of the thesis: 7.5 µm and 4 mN.
    pub const THESIS: Self = Self { position: 7.5e-6, force: 4e-3 };

    /// σ̃_P = σ_P + stage (5.21) \[m\].
    #[must_use]
    pub fn position(&self, sigma: f64) -> f64 {
        sigma + self.position
    }

    /// σ̃_F = σ_F + force sensor (5.22) \[N\].
    #[must_use]
    pub fn force(&self, sigma: f64) -> f64 {
        sigma + self.force
    }
}

/// Ω = length / (n · 2σ_P) along a line with n taxels (5.4, 5.20, 5.23); lengths \[m\].
#[must_use]
pub fn along_line(length: f64, taxels: usize, sigma: f64) -> f64 {
    length / (taxels as f64 * 2.0 * sigma)
}

/// Ω = area / (n · π σ_x σ_y) on a surface with n taxels (5.24); area \[m²\], deviations \[m\].
#[must_use]
pub fn on_surface(area: f64, taxels: usize, sigma: [f64; 2]) -> f64 {
    area / (taxels as f64 * std::f64::consts::PI * sigma[0] * sigma[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_what_the_thesis_computes() {
        // Table 5.1: an RMSE of 0.0416 mm on the row, 0.1606 mm (in all) on the grid, "Smpl.".
        approx::assert_relative_eq!(along_line(0.0325, 6, 0.0416e-3), 65.1, max_relative = 1e-3);
        approx::assert_relative_eq!(
            on_surface(0.026 * 0.026, 25, [0.1606e-3; 2]),
            333.7,
            max_relative = 1e-3
        );
        // 0.0525 mm of theory, and 0.0075 mm of testbed.
        let seen = Testbed::THESIS.position(0.0525e-3);
        approx::assert_relative_eq!(along_line(0.0325, 6, seen), 45.1, max_relative = 1e-3);
        approx::assert_relative_eq!(Testbed::THESIS.force(0.001), 0.005);
    }
}
