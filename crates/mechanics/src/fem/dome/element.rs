//! The element: a quadratic quadrilateral on the half section, for one harmonic about the axis.
//!
//! Nine nodes with three displacements each, and a dilatation that is linear over the element (B-bar; Hughes, "Generalization
//! of selective integration procedures to anisotropic and nonlinear media", Int. J. Numer. Methods Eng. 15, 1980), integrated
//! by three times three Gauss points. It neither locks near incompressibility nor shows alternating pressures.

use nalgebra::{Matrix3, Vector3};

use crate::quadrature::gauss_legendre;

/// Nodes of an element, three times three.
pub(super) const NODES: usize = 9;
/// Displacements of an element's nodes.
pub(super) const DOFS: usize = 3 * NODES;

/// Stiffness of an element with nodes at `locations` \[m\] for the harmonic `m` and Young's modulus 1, by rows; of a radian about the axis, and half of
/// that where both sine and cosine are concerned (which cancels out of each harmonic's equations).
pub(super) fn stiffness(locations: &[[f64; 2]; NODES], m: f64, poisson_ratio: f64) -> Option<Vec<f64>> {
    let bulk = 1.0 / (3.0 * (1.0 - 2.0 * poisson_ratio));
    let shear = 0.5 / (1.0 + poisson_ratio);
    let mut matrix = vec![0.0; DOFS * DOFS];
    let mut moments = Matrix3::zeros();
    let mut dilatation = [[0.0; DOFS]; 3];
    let rule: Vec<(f64, f64)> = gauss_legendre(3).iter().map(|(x, w)| (2.0 * x - 1.0, 2.0 * w)).collect();
    for &(xi, weight_xi) in &rule {
        for &(eta, weight_eta) in &rule {
            let (along, across) = (quadratic(xi), quadratic(eta));
            let (mut r, mut jacobian) = (0.0, [[0.0; 2]; 2]);
            let local: [(f64, f64, f64); NODES] = std::array::from_fn(|n| {
                let ((a, da), (b, db)) = (along[n / 3], across[n % 3]);
                (a * b, da * b, a * db)
            });
            for (place, (value, xi, eta)) in locations.iter().zip(local) {
                r += value * place[0];
                for axis in 0..2 {
                    jacobian[0][axis] += xi * place[axis];
                    jacobian[1][axis] += eta * place[axis];
                }
            }
            let determinant = jacobian[0][0] * jacobian[1][1] - jacobian[0][1] * jacobian[1][0];
            // The arc runs down, the other coordinate outwards: that is left-handed in (r, z).
            let weight = determinant.abs() * r * weight_xi * weight_eta;
            if weight.is_nan() || weight <= 0.0 {
                return None;
            }
            // Strains rr, θθ, zz, rz, rθ, zθ of each displacement, and its dilatation.
            let mut strain = [[0.0; 6]; DOFS];
            let mut volume = [0.0; DOFS];
            for (n, (value, xi, eta)) in local.into_iter().enumerate() {
                let dr = (jacobian[1][1] * xi - jacobian[0][1] * eta) / determinant;
                let dz = (jacobian[0][0] * eta - jacobian[1][0] * xi) / determinant;
                let hoop = value / r;
                strain[3 * n] = [dr, hoop, 0.0, dz, -m * hoop, 0.0];
                strain[3 * n + 1] = [0.0, m * hoop, 0.0, 0.0, dr - hoop, dz];
                strain[3 * n + 2] = [0.0, 0.0, dz, dr, 0.0, -m * hoop];
                for k in 0..3 {
                    let s = &strain[3 * n + k];
                    volume[3 * n + k] = s[0] + s[1] + s[2];
                }
            }
            let basis = Vector3::new(1.0, xi, eta);
            moments += basis * basis.transpose() * weight;
            for (row, b) in dilatation.iter_mut().zip(basis.iter()) {
                for (d, v) in row.iter_mut().zip(&volume) {
                    *d += b * v * weight;
                }
            }
            for i in 0..DOFS {
                for j in i..DOFS {
                    let (a, b) = (&strain[i], &strain[j]);
                    let normal = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
                    let shears = a[3] * b[3] + a[4] * b[4] + a[5] * b[5];
                    let trace = volume[i] * volume[j];
                    matrix[i * DOFS + j] += shear * weight * (2.0 * normal - 2.0 / 3.0 * trace + shears);
                }
            }
        }
    }
    let inverse = moments.try_inverse()?;
    for i in 0..DOFS {
        let here = inverse * Vector3::new(dilatation[0][i], dilatation[1][i], dilatation[2][i]) * bulk;
        for j in i..DOFS {
            let there = Vector3::new(dilatation[0][j], dilatation[1][j], dilatation[2][j]);
            matrix[i * DOFS + j] += here.dot(&there);
            matrix[j * DOFS + i] = matrix[i * DOFS + j];
        }
    }
    Some(matrix)
}

/// Values and slopes of the three quadratic shape functions on [−1, 1].
pub(super) fn quadratic(xi: f64) -> [(f64, f64); 3] {
    [(xi * (xi - 1.0) / 2.0, xi - 0.5), (1.0 - xi * xi, -2.0 * xi), (xi * (xi + 1.0) / 2.0, xi + 0.5)]
}

/// Takes an element's matrix to the frames of its nodes.
pub(super) fn transform(matrix: &mut [f64], frames: &[[Vector3<f64>; 3]; NODES]) {
    let plain = [Vector3::x(), Vector3::y(), Vector3::z()];
    for (n, frame) in frames.iter().enumerate() {
        if *frame == plain {
            continue;
        }
        for i in 0..DOFS {
            let row = Vector3::from_fn(|k, _| matrix[i * DOFS + 3 * n + k]);
            for (k, vector) in frame.iter().enumerate() {
                matrix[i * DOFS + 3 * n + k] = vector.dot(&row);
            }
        }
        for j in 0..DOFS {
            let column = Vector3::from_fn(|k, _| matrix[(3 * n + k) * DOFS + j]);
            for (k, vector) in frame.iter().enumerate() {
                matrix[(3 * n + k) * DOFS + j] = vector.dot(&column);
            }
        }
    }
}
