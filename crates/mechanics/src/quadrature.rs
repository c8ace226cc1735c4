//! Gauss-Legendre quadrature, plain and in panels.

/// Points of one panel.
const POINTS: usize = 16;

/// Nodes and weights of the n-point Gauss-Legendre rule on \[0, 1\].
///
/// Newton's iteration on the Legendre polynomial from Tricomi's initial guess.
#[must_use]
pub fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    let count = n as f64;
    (0..n)
        .map(|i| {
            let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (count + 0.5)).cos();
            let mut derivative = 1.0;
            for _ in 0..50 {
                let (mut p0, mut p1) = (1.0, x);
                for j in 2..=n {
                    let j = j as f64;
                    (p0, p1) = (p1, ((2.0 * j - 1.0) * x * p1 - (j - 1.0) * p0) / j);
                }
                derivative = count * (x * p1 - p0) / (x * x - 1.0);
                let step = p1 / derivative;
                x -= step;
                if step.abs() < 1e-15 {
                    break;
                }
            }
            (0.5 * (1.0 - x), 1.0 / ((1.0 - x * x) * derivative * derivative))
        })
        .collect()
}

/// Nodes and weights on \[0, `end`\] in equal panels no wider than `panel`.
pub(crate) fn panels(end: f64, panel: f64) -> Vec<(f64, f64)> {
    // The bound keeps a question about a point kilometres away from eating all memory.
    let count = (end / panel).ceil().clamp(1.0, 20_000.0);
    let width = end / count;
    let rule = gauss_legendre(POINTS);
    (0..count as usize)
        .flat_map(|p| rule.iter().map(move |&(x, w)| ((p as f64 + x) * width, w * width)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integrates_polynomials_exactly() {
        for n in [2, 5, 16, 33] {
            let degree = 2 * n as i32 - 1;
            let integral: f64 = gauss_legendre(n).iter().map(|(x, w)| w * x.powi(degree)).sum();
            approx::assert_relative_eq!(integral, 1.0 / f64::from(degree + 1), max_relative = 1e-12);
        }
    }

    #[test]
    fn panels_resolve_oscillation() {
        let integral: f64 = panels(100.0, 1.0).iter().map(|(x, w)| w * x.cos()).sum();
        approx::assert_relative_eq!(integral, 100f64.sin(), max_relative = 1e-11);
    }
}
