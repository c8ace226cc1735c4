//! What large displacements do to the elastomer: it stretches, and gives way more slowly than forces grow.
//!
//! Problem: 1 N moves the thin elastomer of the fovea by 40 mm if displacements are linear in forces, thirty times its thickness; a real skin
//! carries that load like a membrane, after some millimetres. Method: the law of a clamped plate that cannot slide in, w/t + β (w/t)³ = w₀/t, where
//! w₀ is the deflection without stretching (S. Timoshenko and S. Woinowsky-Krieger, *Theory of Plates and Shells*, 1959, article 98). Here w₀ is
//! how far the inside gives way where it does so most, and t the elastomer's thickness there. A contact moves everything by the same share of what
//! it moves without stretching, as if it pressed less. Assumptions: the shape of what moves is that of small displacements; contacts do not
//! stretch each other's elastomer. Cost: a product of 3 × 3 numbers for each point that a contact presses on.

use nalgebra::{Matrix3, Vector3};

use super::basis::Basis;

/// Share of stiffening where the inside gives way by the elastomer's thickness: of a plate of neo-Hookean rubber as large and thin as the fovea,
/// whose edges cannot move, pushed in by one to three times its thickness (solids of CalculiX; case I6 of `dermis validate insight` compares). Of a
/// material that stays linear it is 0.443 (Timoshenko and Woinowsky-Krieger).
pub const STRETCHED: f64 = 0.2;

/// What stretches beneath each point of the outside.
#[derive(Debug)]
pub struct Stretching {
    /// \[m/N\] where the inside gives way most, per elastomer's thickness \[m\].
    gives: Vec<Matrix3<f64>>,
}

impl Stretching {
    /// Of an elastomer that is so thick \[m\] beneath each point of the outside.
    #[must_use]
    pub fn new(basis: &Basis, thickness: &[f64]) -> Self {
        let gives = thickness.iter().enumerate().map(|(point, thickness)| basis.most(point) / *thickness);
        Self { gives: gives.collect() }
    }

    /// Share of the displacements by a `force` \[N\], as they are without stretching, that remains of them; `shares` are those of the points that
    /// it presses on, `beta` the stiffening where the inside gives way by the thickness.
    #[must_use]
    pub fn share(&self, shares: &[(usize, f64)], force: &Vector3<f64>, beta: f64) -> f64 {
        let gives: Matrix3<f64> = shares.iter().map(|(point, share)| self.gives[*point] * *share).sum();
        relaxed((gives * force).norm(), beta)
    }
}

/// x / x₀ with x + β x³ = x₀.
pub fn relaxed(linear: f64, beta: f64) -> f64 {
    let scale = (3.0 * beta).sqrt();
    // The one real root of a rising cubic, by hyperbolic functions.
    let by = 1.5 * linear * scale;
    if by < 1e-6 { 1.0 } else { (by.asinh() / 3.0).sinh() * 3.0 / by }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_remains_solves_the_cubic() {
        for beta in [0.05, STRETCHED, 3.0] {
            for x in [1e-9f64, 1e-4, 0.1, 0.7, 4.0, 30.0] {
                let linear = x + beta * x.powi(3);
                let share = relaxed(linear, beta);
                assert!((share * linear / x - 1.0).abs() < 1e-9, "{beta}, {x}: {share}");
            }
        }
        assert_eq!((relaxed(3.0, 0.0), relaxed(0.0, STRETCHED)), (1.0, 1.0));
    }
}
