//! Analysis of variance of three factors from the means and deviations of their cells.
//!
//! Problem: which of three factors (pixel, diameter, noise), alone or together, moves an error that is known as mean, standard
//! deviation and number of samples of each combination? Method: fixed effects by unweighted means (Winer, Statistical Principles in
//! Experimental Design, 1971, chapter 6): effects are differences of plain means over cells, each cell counts as the harmonic mean
//! of the numbers of samples, and the error is pooled within cells. F is held against its distribution by the regularised incomplete
//! beta function, a continued fraction (Lentz 1976). Assumptions: errors are independent and of one variance; those of a frame's
//! contacts are not quite. Cost: none.

use serde_json::{Value, json};

/// A combination of levels and the errors that were measured of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    pub levels: [usize; 3],
    pub mean: f64,
    /// Of the population.
    pub deviation: f64,
    pub samples: f64,
}

/// F and p of every factor and interaction, by their names joined with ` x `; `None` where a combination is missing or has fewer
/// than two samples. Factors with one level are left out.
pub(super) fn effects(names: [&str; 3], sizes: [usize; 3], cells: &[Cell]) -> Option<Value> {
    let whole = cells.len() == sizes.iter().product::<usize>();
    if !whole || cells.iter().any(|cell| cell.samples < 2.0 || !cell.mean.is_finite()) {
        return None;
    }
    let counts = cells.iter().map(|cell| 1.0 / cell.samples).sum::<f64>();
    let each = cells.len() as f64 / counts;
    let within: f64 = cells.iter().map(|cell| cell.samples * cell.deviation.powi(2)).sum();
    let freedom: f64 = cells.iter().map(|cell| cell.samples - 1.0).sum();
    let error = within / freedom;
    let mut all = serde_json::Map::new();
    for factors in 1..8_usize {
        let of: Vec<usize> = (0..3).filter(|factor| factors >> factor & 1 == 1).collect();
        let own: f64 = of.iter().map(|factor| sizes[*factor] as f64 - 1.0).product();
        if own == 0.0 {
            continue;
        }
        let squares: f64 = cells.iter().map(|cell| effect(cells, factors, cell.levels).powi(2)).sum();
        let ratio = each * squares / own / error;
        let name = of.iter().map(|factor| names[*factor]).collect::<Vec<_>>().join(" x ");
        all.insert(name, json!({ "f": ratio, "freedom": [own, freedom], "p": tail(ratio, own, freedom) }));
    }
    Some(Value::Object(all))
}

/// What these factors together add at these levels to what each part of them adds: by inclusion and exclusion.
fn effect(cells: &[Cell], factors: usize, levels: [usize; 3]) -> f64 {
    let parts = (0..8_usize).filter(|part| part & !factors == 0);
    parts
        .map(|part| {
            let fits = |cell: &&Cell| {
                (0..3).all(|factor| part >> factor & 1 == 0 || cell.levels[factor] == levels[factor])
            };
            let (count, sum) = cells
                .iter()
                .filter(fits)
                .fold((0.0, 0.0), |(count, sum), cell| (count + 1.0, sum + cell.mean));
            let sign = if (factors & !part).count_ones().is_multiple_of(2) { 1.0 } else { -1.0 };
            sign * sum / count
        })
        .sum()
}

/// Probability that F of these degrees of freedom is as large.
fn tail(f: f64, own: f64, error: f64) -> f64 {
    incomplete_beta(error / (error + own * f), error / 2.0, own / 2.0)
}

/// The regularised incomplete beta function.
fn incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    // The fraction converges fast below the mean, and the function is symmetric.
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(1.0 - x, b, a);
    }
    let front = libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b) + a * x.ln() + b * (-x).ln_1p();
    let away = |v: f64| if v.abs() < 1e-300 { 1e-300 } else { v };
    let (mut c, mut d) = (1.0, 1.0 / away(1.0 - (a + b) * x / (a + 1.0)));
    let mut fraction = d;
    for m in 1..500 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let before = fraction;
        for term in [even, odd] {
            d = 1.0 / away(1.0 + term * d);
            c = away(1.0 + term / c);
            fraction *= c * d;
        }
        if (fraction - before).abs() < 1e-14 * fraction.abs() {
            break;
        }
    }
    front.exp() * fraction / a
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(levels: [usize; 3], mean: f64) -> Cell {
        Cell { levels, mean, deviation: 1.0, samples: 10.0 }
    }

    #[test]
    fn two_groups_are_a_t_test() {
        let cells = [cell([0, 0, 0], 0.0), cell([1, 0, 0], 1.0)];
        let all = effects(["a", "b", "c"], [2, 1, 1], &cells).unwrap();
        // t = 1 / sqrt(2 s² / 10) with s² = 10 / 9: t² = 4.5, two-sided p of 18 degrees of freedom.
        assert_eq!(all.as_object().unwrap().len(), 1, "{all}");
        assert!((all["a"]["f"].as_f64().unwrap() - 4.5).abs() < 1e-12, "{all}");
        assert!((all["a"]["p"].as_f64().unwrap() - 0.048).abs() < 5e-4, "{all}");
        assert_eq!(all["a"]["freedom"], json!([1.0, 18.0]));
    }

    #[test]
    fn an_interaction_is_told_from_main_effects() {
        let mut cells = Vec::new();
        for a in 0..2 {
            for b in 0..2 {
                for c in 0..3 {
                    let mean = 2.0 * a as f64 + c as f64 + if a == b { 1.0 } else { -1.0 };
                    cells.push(cell([a, b, c], mean));
                }
            }
        }
        let all = effects(["a", "b", "c"], [2, 2, 3], &cells).unwrap();
        let f = |name: &str| all[name]["f"].as_f64().unwrap();
        assert_eq!(all.as_object().unwrap().len(), 7);
        let error = 10.0 / 9.0;
        // Each of twelve cells is one away from the mean by a, and by a and b together; by c one way, not at all, or the other.
        assert!((f("a") - 120.0 / error).abs() < 1e-9 && (f("a x b") - 120.0 / error).abs() < 1e-9, "{all}");
        assert!((f("c") - 80.0 / 2.0 / error).abs() < 1e-9, "{all}");
        for none in ["b", "a x c", "b x c", "a x b x c"] {
            assert!(f(none).abs() < 1e-9 && all[none]["p"].as_f64().unwrap() > 0.999, "{all}");
        }
        assert!(all["a"]["p"].as_f64().unwrap() < 1e-4);
        assert!(effects(["a", "b", "c"], [2, 2, 3], &cells[1..]).is_none());
    }

    #[test]
    fn the_tail_is_that_of_tables() {
        // 5 % points of F: 4.35 of (1, 20), 3.10 of (3, 20) and 2.53 of (4, 30) rounded; of (2, 10) it is exact.
        for (f, own, error) in [(4.351, 1.0, 20.0), (3.098, 3.0, 20.0), (4.103, 2.0, 10.0)] {
            assert!((tail(f, own, error) - 0.05).abs() < 2e-4, "{f}");
        }
        assert!((tail(3.0, 2.0, 10.0) - (1.0 + 2.0 * 3.0 / 10.0_f64).powi(-5)).abs() < 1e-12);
        assert_eq!(tail(0.0, 2.0, 10.0), 1.0);
    }
}
