//! How much of a measured pattern a computed one explains.

/// A computed pattern against a measured one, after the one scale that fits best: a tank's conductivity, depth and drive are one
/// unknown factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Measured over computed.
    pub scale: f64,
    /// ‖measured − scale · computed‖ / ‖measured‖.
    pub residual: f64,
    /// The same over the part that differs from the mean reading of each drive-to-read distance, which every turn of the tank leaves
    /// alike; NaN where nothing differs.
    pub uneven_residual: f64,
}

/// Fits one scale by least squares. `distances` names the class of each reading, for [`Fit::uneven_residual`].
///
/// # Panics
///
/// Where the three have different lengths.
#[must_use]
pub fn fit_scale(measured: &[f64], computed: &[f64], distances: &[usize]) -> Fit {
    assert!(measured.len() == computed.len() && measured.len() == distances.len(), "one of each a reading");
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let scale = dot(measured, computed) / dot(computed, computed);
    let left = |a: &[f64], b: &[f64]| {
        let difference: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - scale * b).collect();
        let all = dot(a, a);
        if all > 0.0 { (dot(&difference, &difference) / all).sqrt() } else { f64::NAN }
    };
    let (uneven, uneven_computed) = (without_means(measured, distances), without_means(computed, distances));
    Fit { scale, residual: left(measured, computed), uneven_residual: left(&uneven, &uneven_computed) }
}

/// Values less the mean of their class.
fn without_means(values: &[f64], classes: &[usize]) -> Vec<f64> {
    let count = classes.iter().max().map_or(0, |most| most + 1);
    let mut sums = vec![(0.0, 0.0_f64); count];
    for (value, class) in values.iter().zip(classes) {
        sums[*class].0 += value;
        sums[*class].1 += 1.0;
    }
    values.iter().zip(classes).map(|(value, class)| value - sums[*class].0 / sums[*class].1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_explains_everything_and_a_difference_is_left() {
        let computed = [1.0, 2.0, 3.0, 5.0];
        let measured = computed.map(|v| -2.5 * v);
        let fit = fit_scale(&measured, &computed, &[0, 0, 1, 1]);
        assert!((fit.scale + 2.5).abs() < 1e-12 && fit.residual < 1e-12 && fit.uneven_residual < 1e-12);
        // Orthogonal to what is computed: nothing of it is explained.
        let fit = fit_scale(&[2.0, -1.0, 0.0, 0.0], &computed, &[0, 0, 1, 1]);
        assert!(fit.scale.abs() < 1e-12 && (fit.residual - 1.0).abs() < 1e-12);
        // What is alike within every class leaves nothing uneven.
        assert!(fit_scale(&[1.0, 1.0], &[2.0, 1.0], &[0, 0]).uneven_residual.is_nan());
    }
}
