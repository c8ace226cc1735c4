//! Whether readings come in steps: what no mean of residuals shows.

use crate::constants::quantization::{BESIDE, DISTINCT, FEWEST, ON, READINGS};

/// The step that readings come in, in their unit; `None` where they come in none. Readings that are not finite do not count.
#[must_use]
pub fn step(readings: &[f32]) -> Option<f64> {
    let finite = readings.iter().filter(|v| v.is_finite()).count();
    let every = finite.div_ceil(READINGS).max(1);
    let mut values: Vec<f64> =
        readings.iter().filter(|v| v.is_finite()).step_by(every).map(|v| f64::from(*v)).collect();
    values.sort_by(f64::total_cmp);
    let largest = values.iter().fold(0.0f64, |l, v| l.max(v.abs()));
    let alike = 1e-6 * largest;
    let mut gaps: Vec<f64> = values.windows(2).map(|w| w[1] - w[0]).filter(|gap| *gap > alike).collect();
    if values.len() < FEWEST || gaps.len() < 3 || gaps.len() as f64 > DISTINCT * values.len() as f64 {
        return None;
    }
    // Where most steps are met by some reading, half of the gaps are one step.
    gaps.sort_by(f64::total_cmp);
    let step = gaps[gaps.len() / 4];
    let on = values.iter().filter(|v| ((*v / step) - (*v / step).round()).abs() < BESIDE).count();
    (on as f64 > ON * values.len() as f64).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn a_step_is_found_only_where_it_is() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let plain: Vec<f32> = (0..4000).map(|_| rng.random_range(-100.0..6000.0f32)).collect();
        let coarse: Vec<f32> = plain.iter().map(|v| (v / 68.3).floor() * 68.3).collect();
        approx::assert_relative_eq!(step(&coarse).unwrap(), 68.3, max_relative = 1e-3);
        assert_eq!(step(&plain), None);
        // Readings that are cut off at the end of a range repeat, and are no steps.
        let cut: Vec<f32> = plain.iter().map(|v| v.min(300.0)).collect();
        assert_eq!(step(&cut), None);
        assert_eq!(step(&[]), None);
    }
}
