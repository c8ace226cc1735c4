//! A flat rectangular facet of a thin shell: Adini, Clough and Melosh's plate and Pian and Sumihara's membrane.
//!
//! Corners in order (0, 0), (a, 0), (a, b), (0, b); at each u, v, w, rotations about the local axes x, y, z. Strains are those of
//! the middle, positive where it stretches; curvatures are -w'' so that a strain at height z is that of the middle plus z times them.

use nalgebra::{Matrix3, SMatrix};

/// Stiffness of a facet, in its own axes.
pub(super) type Stiffness = SMatrix<f64, 24, 24>;
/// From displacements of a facet's corners to three strains.
pub(super) type Strains = SMatrix<f64, 3, 24>;

/// An orthotropic material in plane stress.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Material {
    /// \[Pa\] along x and y.
    pub young: [f64; 2],
    /// Poisson's ratio of a pull along x.
    pub poisson: f64,
}

impl Material {
    /// From strains to stresses.
    pub fn stress(&self) -> Matrix3<f64> {
        let [along, across] = self.young;
        let back = self.poisson * across / along;
        let d = 1.0 - self.poisson * back;
        // Huber's shear modulus.
        let shear = (along * across).sqrt() / (2.0 * (1.0 + (self.poisson * back).sqrt()));
        Matrix3::new(
            along / d,
            self.poisson * across / d,
            0.0,
            self.poisson * across / d,
            across / d,
            0.0,
            0.0,
            0.0,
            shear,
        )
    }
}

/// A rectangle with sides `a` and `b` \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Facet {
    pub a: f64,
    pub b: f64,
}

const GAUSS: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];
/// Signs of the corners along both axes.
const CORNERS: [[f64; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
/// Powers of the plate's polynomial.
const POWERS: [[i32; 2]; 12] =
    [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2], [3, 0], [2, 1], [1, 2], [0, 3], [3, 1], [1, 3]];

/// Derivative of order `d` of x to the power `n`.
fn power(x: f64, n: i32, d: i32) -> f64 {
    if d > n {
        return 0.0;
    }
    let factor: f64 = (0..d).map(|i| f64::from(n - i)).product();
    factor * x.powi(n - d)
}

impl Facet {
    /// From the corners' w and its slopes to the coefficients of the plate's polynomial in natural coordinates.
    fn plate(&self) -> SMatrix<f64, 12, 12> {
        let mut values = SMatrix::<f64, 12, 12>::zeros();
        for (corner, [xi, eta]) in CORNERS.into_iter().enumerate() {
            for (term, [m, n]) in POWERS.into_iter().enumerate() {
                values[(3 * corner, term)] = power(xi, m, 0) * power(eta, n, 0);
                // Rotation about x is ∂w/∂y, about y it is -∂w/∂x.
                values[(3 * corner + 1, term)] = power(xi, m, 0) * power(eta, n, 1) * 2.0 / self.b;
                values[(3 * corner + 2, term)] = -power(xi, m, 1) * power(eta, n, 0) * 2.0 / self.a;
            }
        }
        values.try_inverse().unwrap_or_else(SMatrix::zeros)
    }

    /// Curvatures at natural coordinates, of all displacements.
    fn curvature(&self, inverse: &SMatrix<f64, 12, 12>, xi: f64, eta: f64) -> Strains {
        let (sx, sy) = (2.0 / self.a, 2.0 / self.b);
        let mut second = SMatrix::<f64, 3, 12>::zeros();
        for (term, [m, n]) in POWERS.into_iter().enumerate() {
            second[(0, term)] = -power(xi, m, 2) * power(eta, n, 0) * sx * sx;
            second[(1, term)] = -power(xi, m, 0) * power(eta, n, 2) * sy * sy;
            second[(2, term)] = -2.0 * power(xi, m, 1) * power(eta, n, 1) * sx * sy;
        }
        let plate = second * inverse;
        let mut all = Strains::zeros();
        for corner in 0..4 {
            for i in 0..3 {
                all.set_column(6 * corner + 2 + i, &plate.column(3 * corner + i));
            }
        }
        all
    }

    /// Strains of the middle as the displacements alone say them.
    fn stretch(&self, xi: f64, eta: f64) -> Strains {
        let mut all = Strains::zeros();
        for (corner, [x, y]) in CORNERS.into_iter().enumerate() {
            let dx = x * (1.0 + y * eta) / 4.0 * 2.0 / self.a;
            let dy = y * (1.0 + x * xi) / 4.0 * 2.0 / self.b;
            all[(0, 6 * corner)] = dx;
            all[(1, 6 * corner + 1)] = dy;
            all[(2, 6 * corner)] = dy;
            all[(2, 6 * corner + 1)] = dx;
        }
        all
    }

    /// From displacements to the five coefficients of Pian and Sumihara's stresses.
    fn hybrid(&self, material: &Material) -> (SMatrix<f64, 5, 5>, SMatrix<f64, 5, 24>) {
        let compliance = material.stress().try_inverse().unwrap_or_else(Matrix3::zeros);
        let (mut h, mut g) = (SMatrix::<f64, 5, 5>::zeros(), SMatrix::<f64, 5, 24>::zeros());
        for (xi, wx) in GAUSS {
            for (eta, wy) in GAUSS {
                let weight = wx * wy * self.a * self.b / 4.0;
                let p = stresses(xi, eta);
                h += p.transpose() * compliance * p * weight;
                g += p.transpose() * self.stretch(xi, eta) * weight;
            }
        }
        (h.try_inverse().unwrap_or_else(SMatrix::zeros), g)
    }

    /// Stiffness of a wall of `thickness` \[m\].
    pub fn stiffness(&self, material: &Material, thickness: f64) -> Stiffness {
        let inverse = self.plate();
        let bending = material.stress() * (thickness.powi(3) / 12.0);
        let mut k = Stiffness::zeros();
        for (xi, wx) in GAUSS {
            for (eta, wy) in GAUSS {
                let b = self.curvature(&inverse, xi, eta);
                k += b.transpose() * bending * b * (wx * wy * self.a * self.b / 4.0);
            }
        }
        let (h, g) = self.hybrid(material);
        k += g.transpose() * h * g * thickness;
        // What turns about the normal has no stiffness of its own; a little keeps the system regular.
        let spring = 1e-4 * material.young[0] * thickness * self.a * self.b;
        for i in 0..4 {
            for j in 0..4 {
                k[(6 * i + 5, 6 * j + 5)] += spring * if i == j { 1.0 } else { -1.0 / 3.0 };
            }
            k[(6 * i + 5, 6 * i + 5)] += 1e-3 * spring;
        }
        k
    }

    /// Strains at height `z` \[m\] over the middle, at natural coordinates.
    pub fn strains(&self, material: &Material, (xi, eta): (f64, f64), z: f64) -> Strains {
        let (h, g) = self.hybrid(material);
        let compliance = material.stress().try_inverse().unwrap_or_else(Matrix3::zeros);
        let middle = compliance * stresses(xi, eta) * h * g;
        middle + self.curvature(&self.plate(), xi, eta) * z
    }

    /// Shares of the corners of a load at natural coordinates.
    pub fn shares((xi, eta): (f64, f64)) -> [f64; 4] {
        CORNERS.map(|[x, y]| (1.0 + x * xi) * (1.0 + y * eta) / 4.0)
    }
}

fn stresses(xi: f64, eta: f64) -> SMatrix<f64, 3, 5> {
    SMatrix::<f64, 3, 5>::from_row_slice(&[
        1.0, 0.0, 0.0, eta, 0.0, //
        0.0, 1.0, 0.0, 0.0, xi, //
        0.0, 0.0, 1.0, 0.0, 0.0,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pure_bending_and_pure_stretch_are_exact() {
        let facet = Facet { a: 0.003, b: 0.002 };
        let material = Material { young: [1.7e9, 1.7e9], poisson: 0.394 };
        // w = -x² / 2 and u = 0.001 x, v = -ν u: curvature 1 and strain 0.001 along x.
        let mut d = nalgebra::SVector::<f64, 24>::zeros();
        for (corner, [sx, sy]) in CORNERS.into_iter().enumerate() {
            let (x, y) = (sx * facet.a / 2.0, sy * facet.b / 2.0);
            d[6 * corner] = 1e-3 * x;
            d[6 * corner + 1] = -0.394e-3 * y;
            d[6 * corner + 2] = -x * x / 2.0;
            d[6 * corner + 4] = x;
        }
        let strains = facet.strains(&material, (0.3, -0.6), 0.001) * d;
        approx::assert_relative_eq!(strains[0], 2e-3, max_relative = 1e-9);
        approx::assert_relative_eq!(strains[1], -0.394e-3, max_relative = 1e-9);
        approx::assert_abs_diff_eq!(strains[2], 0.0, epsilon = 1e-12);
        // Energy of both: E t ε² / 2 and D κ² / 2 over the area.
        let t = 0.002;
        let energy = 0.5 * d.dot(&(facet.stiffness(&material, t) * d));
        let area = facet.a * facet.b;
        let bending = 1.7e9 / (1.0 - 0.394f64.powi(2)) * f64::powi(t, 3) / 12.0 / 2.0 * area;
        let stretch = 1.7e9 * t * 1e-6 / 2.0 * area;
        approx::assert_relative_eq!(energy, bending + stretch, max_relative = 1e-6);
    }
}
