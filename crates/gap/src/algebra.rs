//! Small dense algebra: normal equations with priors and bounds, and principal components of a few long vectors.

use nalgebra::{DMatrix, SymmetricEigen};

/// Mean; 0 of no values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Solves `a x = b` for a symmetric positive definite matrix of `n` rows, in place; `None` where it is not.
pub fn cholesky_solve(a: &mut [f64], n: usize, b: &mut [f64]) -> Option<()> {
    cholesky(a, n)?;
    forward(a, n, b);
    backward(a, n, b);
    Some(())
}

/// Upper factor R of a = RᵀR, in the upper half of `a`; `None` where there is none.
pub fn cholesky(a: &mut [f64], n: usize) -> Option<()> {
    for j in 0..n {
        let (done, rest) = a.split_at_mut(j * n);
        for k in 0..j {
            let row = &done[k * n..k * n + n];
            let f = row[j];
            if f != 0.0 {
                for (x, y) in rest[j..n].iter_mut().zip(&row[j..n]) {
                    *x -= f * y;
                }
            }
        }
        let pivot = rest[j];
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        let root = pivot.sqrt();
        for x in &mut rest[j..n] {
            *x /= root;
        }
    }
    Some(())
}

/// Solves Rᵀ x = b in place.
pub fn forward(a: &[f64], n: usize, b: &mut [f64]) {
    for i in 0..n {
        let mut s = b[i];
        for k in 0..i {
            s -= a[k * n + i] * b[k];
        }
        b[i] = s / a[i * n + i];
    }
}

/// Solves R x = b in place.
pub fn backward(a: &[f64], n: usize, b: &mut [f64]) {
    for i in (0..n).rev() {
        let mut s = b[i];
        for k in i + 1..n {
            s -= a[i * n + k] * b[k];
        }
        b[i] = s / a[i * n + i];
    }
}

/// Principal components of `vectors`, each scaled so that a coefficient of standard deviation 1 gives back the spread of the
/// vectors about zero; as many as hold `share` of their energy, `most` at most. Also the share that they hold.
pub fn components(vectors: &[impl AsRef<[f32]>], share: f64, most: usize) -> (Vec<Vec<f32>>, f64) {
    let m = vectors.len();
    let mut gram = DMatrix::<f64>::zeros(m, m);
    for i in 0..m {
        for j in 0..=i {
            let dot = dot(vectors[i].as_ref(), vectors[j].as_ref());
            (gram[(i, j)], gram[(j, i)]) = (dot, dot);
        }
    }
    let total = gram.trace();
    if total.is_nan() || total <= 0.0 {
        return (Vec::new(), 0.0);
    }
    let eigen = SymmetricEigen::new(gram);
    let mut order: Vec<usize> = (0..m).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let (mut found, mut held) = (Vec::new(), 0.0);
    for index in order {
        let value = eigen.eigenvalues[index];
        if found.len() >= most || value <= 1e-9 * total || held >= share * total {
            break;
        }
        let scale = 1.0 / (m as f64).sqrt();
        let mut component = vec![0.0f32; vectors[0].as_ref().len()];
        for (i, vector) in vectors.iter().enumerate() {
            let f = (eigen.eigenvectors[(i, index)] * scale) as f32;
            for (c, v) in component.iter_mut().zip(vector.as_ref()) {
                *c += f * v;
            }
        }
        // Σ uᵢ vᵢ is of length √λ already.
        found.push(component);
        held += value;
    }
    (found, held / total)
}

/// The direction of unit length that many short vectors of `n` numbers have most in common.
pub fn direction<'a>(vectors: impl Iterator<Item = &'a [f64]>, n: usize) -> Vec<f64> {
    let mut spread = DMatrix::<f64>::zeros(n, n);
    for vector in vectors {
        for i in 0..n {
            for j in 0..=i {
                spread[(i, j)] += vector[i] * vector[j];
            }
        }
    }
    spread.fill_upper_triangle_with_lower_triangle();
    let eigen = SymmetricEigen::new(spread);
    let largest = (0..n).max_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    largest.map_or_else(Vec::new, |at| eigen.eigenvectors.column(at).iter().copied().collect())
}

/// Dot product in double precision.
pub fn dot(a: &[f32], b: &[f32]) -> f64 {
    // Chunks in single precision keep the loop vectorised; their sums do not lose digits.
    a.chunks(64)
        .zip(b.chunks(64))
        .map(|(a, b)| f64::from(a.iter().zip(b).map(|(x, y)| x * y).sum::<f32>()))
        .sum()
}

/// Distribution function of the normal distribution (Abramowitz and Stegun 7.1.26, within 2e-7).
#[must_use]
pub fn normal(z: f64) -> f64 {
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let poly = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = 0.5 * poly * (-x * x).exp();
    if z > 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_equations_are_solved() {
        let mut a = vec![4.0, 2.0, 0.6, 2.0, 5.0, 1.0, 0.6, 1.0, 3.0];
        let x = [1.0, -2.0, 0.5];
        let mut b: Vec<f64> = (0..3).map(|i| (0..3).map(|j| a[i * 3 + j] * x[j]).sum()).collect();
        cholesky_solve(&mut a, 3, &mut b).unwrap();
        for (found, x) in b.iter().zip(x) {
            approx::assert_relative_eq!(*found, x, max_relative = 1e-12);
        }
        assert!(cholesky_solve(&mut [1.0, 2.0, 2.0, 1.0], 2, &mut [1.0, 1.0]).is_none());
    }

    #[test]
    fn components_span_what_they_are_made_of() {
        let (u, v) = (vec![1.0f32, 0.0, 2.0, 0.0], vec![0.0f32, 1.0, 0.0, 0.0]);
        let mix = |a: f32, b: f32| u.iter().zip(&v).map(|(u, v)| a * u + b * v).collect::<Vec<f32>>();
        let (found, held) = components(&[mix(1.0, 0.1), mix(-2.0, 0.3), mix(0.5, -0.2)], 0.9999, 4);
        assert_eq!(found.len(), 2);
        assert!(held > 0.9999);
        // The first is the strongest direction, as long as the root mean square of the vectors along it.
        approx::assert_relative_eq!(dot(&found[0], &found[0]), 5.0 * 5.25 / 3.0, max_relative = 0.01);
    }

    #[test]
    fn the_normal_distribution_is_that_of_the_tables() {
        for (z, p) in [(0.0, 0.5), (-1.959_964, 0.025), (2.326_348, 0.99), (-5.0, 2.8665e-7)] {
            approx::assert_abs_diff_eq!(normal(z), p, epsilon = 2e-7);
        }
    }
}
