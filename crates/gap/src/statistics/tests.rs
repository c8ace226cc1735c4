use super::*;
use crate::samples::Sample;
use dermis_skin::Phase;

pub(crate) fn samples(groups: &[usize]) -> Samples {
    let sample = |group: usize| Sample {
        frame: 0,
        group,
        press: group,
        location: (0, group as u32),
        session: 0,
        phase: Phase::Hold,
        force: 1.0,
        since: 0.1,
        time: 0.0,
        before: 0.0,
        speed: 0.0,
        temperature: f64::NAN,
        position: [0.0; 3],
        diameter: 0.004,
        contacts: 1,
        paired: false,
        zero: None,
    };
    let number = groups.iter().max().map_or(0, |g| g + 1);
    Samples {
        list: groups.iter().map(|g| sample(*g)).collect(),
        groups: number,
        test: vec![false; number],
        presses: number,
        single_frame_samples: 0,
        missing: 0,
    }
}

#[test]
fn sums_are_those_of_all_samples() {
    // Three samples of two channels; one column for all channels, one for the second.
    let columns = vec![
        Column { channel: None, values: vec![1.0, 2.0, 0.5, -1.0, 3.0, 1.0] },
        Column { channel: Some(1), values: vec![1.0, 2.0, -1.0] },
    ];
    let residual = [2.0f32, 1.0, 0.0, 4.0, -1.0, 2.0];
    let statistics = Statistics::new(&columns, &residual, &samples(&[0, 1, 0]), 2);
    let sum = statistics.sum(&[1.0, 1.0]);
    let wanted = [1.0 + 4.0 + 0.25 + 1.0 + 9.0 + 1.0, 2.0 - 2.0 - 1.0, -1.0, 1.0 + 4.0 + 1.0];
    let found: Vec<f64> = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(i, j)| sum.at(i, j)).to_vec();
    assert_eq!(found, wanted);
    assert_eq!((sum.b.clone(), sum.rr), (vec![2.0 + 2.0 - 4.0 - 3.0 + 2.0, 1.0 + 8.0 - 2.0], 26.0));
    // What is left by groups is what is left of all.
    let fit = sum.fit(&[0, 1], |_| 0.0);
    let left: f64 = (0..6)
        .map(|i| {
            let own = if i % 2 == 1 { fit.theta[1] * f64::from(columns[1].values[i / 2]) } else { 0.0 };
            (f64::from(residual[i]) - fit.theta[0] * f64::from(columns[0].values[i]) - own).powi(2)
        })
        .sum();
    let by_groups = statistics.loss(0, &fit) + statistics.loss(1, &fit);
    approx::assert_relative_eq!(by_groups, left, max_relative = 1e-6);
    // A strong prior holds a coefficient back, and the other makes the best of it.
    let held = sum.fit(&[0, 1], |c| if c == 1 { 1e12 } else { 0.0 });
    assert!(held.theta[1].abs() < 1e-6);
    approx::assert_relative_eq!(held.theta[0], sum.b[0] / sum.at(0, 0), max_relative = 1e-6);
}

/// Columns of all kinds over four channels, and the products of all of them by hand.
fn mixed() -> (Vec<Column>, Vec<f32>, Samples) {
    let n = 12;
    let mut state = 7u32;
    let mut draw = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1u32 << 24) as f32 - 0.5
    };
    let kinds = [None, Some(2), None, Some(0), Some(2), Some(3), None, Some(0)];
    let columns = kinds
        .iter()
        .map(|&channel| {
            let count = if channel.is_some() { n } else { 4 * n };
            Column { channel, values: (0..count).map(|_| draw()).collect() }
        })
        .collect();
    let residual = (0..4 * n).map(|_| draw()).collect();
    (columns, residual, samples(&(0..n).map(|i| i % 3).collect::<Vec<_>>()))
}

#[test]
fn blocks_say_what_the_whole_matrix_says() {
    let (columns, residual, samples) = mixed();
    let statistics = Statistics::new(&columns, &residual, &samples, 4);
    let sum = statistics.sum(&[1.0, 0.5, 2.0]);
    let dense = |c: &Column| -> Vec<f64> {
        let weight = |i: usize| [1.0f64, 0.5, 2.0][(i / 4) % 3].sqrt();
        let value = |i: usize| match c.channel {
            Some(k) if i % 4 == k => f64::from(c.values[i / 4]),
            Some(_) => 0.0,
            None => f64::from(c.values[i]),
        };
        (0..48).map(|i| weight(i) * value(i)).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let all: Vec<Vec<f64>> = columns.iter().map(dense).collect();
    for i in 0..8 {
        for j in 0..8 {
            approx::assert_relative_eq!(sum.at(i, j), dot(&all[i], &all[j]), epsilon = 1e-6);
        }
    }
    // In any order, with any columns left out.
    for set in [vec![4, 0, 7, 1, 3, 2, 5, 6], vec![1, 7], vec![6, 0], vec![5, 2, 1], vec![]] {
        let m = set.len();
        let mut a: Vec<f64> =
            set.iter().flat_map(|&i| set.iter().map(move |&j| (i, j))).map(|(i, j)| sum.at(i, j)).collect();
        (0..m).for_each(|r| a[r * m + r] = a[r * m + r] * (1.0 + 1e-9) + 0.1 + 1e-12);
        let b: Vec<f64> = set.iter().map(|&i| sum.b[i]).collect();
        let mut theta = b.clone();
        crate::algebra::cholesky_solve(&mut a, m, &mut theta).unwrap();
        let fit = sum.fit(&set, |_| 0.1);
        for (x, y) in fit.theta.iter().zip(&theta) {
            approx::assert_relative_eq!(*x, y, epsilon = 1e-9);
        }
        let factor = sum.factor(&set, |_, g| g * (1.0 + 1e-9) + 0.1 + 1e-12).unwrap();
        approx::assert_relative_eq!(factor.held(&b), dot(&b, &theta), epsilon = 1e-9);
        let energy: f64 = set
            .iter()
            .zip(&theta)
            .map(|(&i, x)| set.iter().zip(&theta).map(|(&j, y)| x * y * sum.at(i, j)).sum::<f64>())
            .sum();
        approx::assert_relative_eq!(sum.energy(&set, &theta), energy, epsilon = 1e-9);
        let every: Vec<usize> = (0..8).collect();
        for (i, p) in sum.project(&set, &theta, &every).into_iter().enumerate() {
            let wanted: f64 = set.iter().zip(&theta).map(|(&j, y)| y * sum.at(i, j)).sum();
            approx::assert_relative_eq!(p, wanted, epsilon = 1e-9);
        }
        let left: f64 = [1.0, 0.5, 2.0].iter().enumerate().map(|(g, w)| w * statistics.loss(g, &fit)).sum();
        approx::assert_relative_eq!(left, sum.rr - 2.0 * dot(&b, &theta) + energy, epsilon = 1e-6);
    }
    // Columns that say the same twice are no factor without a prior.
    assert!(sum.factor(&[1, 1], |_, g| g).is_none());
}
