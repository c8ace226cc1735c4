//! Sufficient statistics per group of contacts: every fold, subset, resampling and permutation is algebra over them.

use crate::algebra::cholesky_solve;
use crate::rows::Rows;

/// One direction in which an effect changes readings, in deviations of the noise.
#[derive(Debug, Clone)]
pub struct Column {
    /// Where it changes one channel only: one value a row. Otherwise rows × channels values.
    pub channel: Option<usize>,
    /// Values.
    pub values: Vec<f32>,
}

/// Products of columns and residual within one group.
#[derive(Debug, Clone)]
struct Group {
    /// P × P.
    g: Vec<f32>,
    b: Vec<f64>,
    rr: f64,
}

/// Products of columns and residual, by group.
#[derive(Debug, Clone)]
pub struct Statistics {
    /// Number of columns.
    pub columns: usize,
    groups: Vec<Group>,
}

/// Weighted sum over groups.
#[derive(Debug, Clone)]
pub struct Sum {
    /// P × P.
    pub g: Vec<f64>,
    /// P.
    pub b: Vec<f64>,
    /// Energy of the residual.
    pub rr: f64,
}

/// A fit: columns and their coefficients.
#[derive(Debug, Clone, Default)]
pub struct Fit {
    /// Columns.
    pub set: Vec<usize>,
    /// Coefficients, one a column.
    pub theta: Vec<f64>,
}

impl Statistics {
    /// Products of `columns` with each other and with `residual` (rows × channels).
    #[must_use]
    pub fn new(columns: &[Column], residual: &[f32], rows: &Rows, channels: usize) -> Self {
        let p = columns.len();
        let dense: Vec<usize> = (0..p).filter(|c| columns[*c].channel.is_none()).collect();
        let active: Vec<Vec<usize>> = (0..channels)
            .map(|k| {
                let own = (0..p).filter(|c| columns[*c].channel == Some(k));
                dense.iter().copied().chain(own).collect()
            })
            .collect();
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); rows.groups];
        for (i, row) in rows.rows.iter().enumerate() {
            members[row.group].push(i);
        }
        let mut groups = Vec::with_capacity(rows.groups);
        let mut block: Vec<f32> = Vec::new();
        for member in &members {
            let mut g = vec![0.0f32; p * p];
            let (mut b, mut rr) = (vec![0.0f64; p], 0.0f64);
            for (k, active) in active.iter().enumerate() {
                let m = active.len() + 1;
                block.clear();
                for &i in member {
                    for &c in active {
                        let column = &columns[c];
                        let at = if column.channel.is_some() { i } else { i * channels + k };
                        block.push(column.values[at]);
                    }
                    block.push(residual[i * channels + k]);
                }
                let mut local = vec![0.0f64; m * m];
                for values in block.chunks_exact(m) {
                    for (a, x) in values.iter().enumerate() {
                        if *x == 0.0 {
                            continue;
                        }
                        let x = f64::from(*x);
                        for (l, y) in local[a * m + a..a * m + m].iter_mut().zip(&values[a..]) {
                            *l += x * f64::from(*y);
                        }
                    }
                }
                for (a, &i) in active.iter().enumerate() {
                    for (d, &j) in active.iter().enumerate().skip(a) {
                        g[i * p + j] += local[a * m + d] as f32;
                        if i != j {
                            g[j * p + i] += local[a * m + d] as f32;
                        }
                    }
                    b[i] += local[a * m + m - 1];
                }
                rr += local[m * m - 1];
            }
            groups.push(Group { g, b, rr });
        }
        Self { columns: p, groups }
    }

    /// Number of groups.
    #[must_use]
    pub fn groups(&self) -> usize {
        self.groups.len()
    }

    /// Scores of one group.
    #[must_use]
    pub fn score(&self, group: usize) -> &[f64] {
        &self.groups[group].b
    }

    /// Energy of the residual of one group.
    #[must_use]
    pub fn energy(&self, group: usize) -> f64 {
        self.groups[group].rr
    }

    /// Sum over groups with these weights.
    #[must_use]
    pub fn sum(&self, weights: &[f64]) -> Sum {
        let p = self.columns;
        let mut sum = Sum { g: vec![0.0; p * p], b: vec![0.0; p], rr: 0.0 };
        for (group, &w) in self.groups.iter().zip(weights) {
            if w == 0.0 {
                continue;
            }
            for (s, g) in sum.g.iter_mut().zip(&group.g) {
                *s += w * f64::from(*g);
            }
            for (s, b) in sum.b.iter_mut().zip(&group.b) {
                *s += w * b;
            }
            sum.rr += w * group.rr;
        }
        sum
    }

    /// What is left of one group's energy after a fit.
    #[must_use]
    pub fn loss(&self, group: usize, fit: &Fit) -> f64 {
        let (group, p) = (&self.groups[group], self.columns);
        let mut loss = group.rr;
        for (a, (&i, x)) in fit.set.iter().zip(&fit.theta).enumerate() {
            loss -= 2.0 * x * group.b[i];
            let row = &group.g[i * p..(i + 1) * p];
            let mut cross = 0.0;
            for (&j, y) in fit.set[..a].iter().zip(&fit.theta) {
                cross += y * f64::from(row[j]);
            }
            loss += x * (2.0 * cross + x * f64::from(row[i]));
        }
        loss
    }

    /// Products of one group's columns with a fit.
    #[must_use]
    pub fn project(&self, group: usize, fit: &Fit, of: &[usize]) -> Vec<f64> {
        let (group, p) = (&self.groups[group], self.columns);
        of.iter()
            .map(|&i| {
                let row = &group.g[i * p..(i + 1) * p];
                fit.set.iter().zip(&fit.theta).map(|(&j, x)| x * f64::from(row[j])).sum()
            })
            .collect()
    }
}

impl Sum {
    /// Sum without another.
    #[must_use]
    pub fn minus(&self, other: &Self) -> Self {
        let subtract = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect();
        Self { g: subtract(&self.g, &other.g), b: subtract(&self.b, &other.b), rr: self.rr - other.rr }
    }

    /// Least squares on the columns of `set`, each coefficient under a prior of mean 0: `prior` gives the inverse of its variance.
    #[must_use]
    pub fn fit(&self, set: &[usize], prior: impl Fn(usize) -> f64) -> Fit {
        let (n, p) = (set.len(), self.b.len());
        let mut a = vec![0.0; n * n];
        let mut theta: Vec<f64> = set.iter().map(|&i| self.b[i]).collect();
        for (r, &i) in set.iter().enumerate() {
            for (c, &j) in set.iter().enumerate() {
                a[r * n + c] = self.g[i * p + j];
            }
            a[r * n + r] = a[r * n + r] * (1.0 + 1e-9) + prior(i) + 1e-12;
        }
        if cholesky_solve(&mut a, n, &mut theta).is_none() {
            theta = vec![0.0; n];
        }
        Fit { set: set.to_vec(), theta }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::rows::Row;
    use dermis_skin::Phase;

    pub(crate) fn rows(groups: &[usize]) -> Rows {
        let row = |group: usize| Row {
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
        };
        let number = groups.iter().max().map_or(0, |g| g + 1);
        Rows {
            rows: groups.iter().map(|g| row(*g)).collect(),
            groups: number,
            test: vec![false; number],
            presses: number,
            missing: 0,
        }
    }

    #[test]
    fn sums_are_those_of_all_rows() {
        // Three rows of two channels; one column for all channels, one for the second.
        let columns = vec![
            Column { channel: None, values: vec![1.0, 2.0, 0.5, -1.0, 3.0, 1.0] },
            Column { channel: Some(1), values: vec![1.0, 2.0, -1.0] },
        ];
        let residual = [2.0f32, 1.0, 0.0, 4.0, -1.0, 2.0];
        let statistics = Statistics::new(&columns, &residual, &rows(&[0, 1, 0]), 2);
        let sum = statistics.sum(&[1.0, 1.0]);
        let wanted = [1.0 + 4.0 + 0.25 + 1.0 + 9.0 + 1.0, 2.0 - 2.0 - 1.0, -1.0, 1.0 + 4.0 + 1.0];
        assert_eq!(sum.g, wanted);
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
        approx::assert_relative_eq!(held.theta[0], sum.b[0] / sum.g[0], max_relative = 1e-6);
    }
}
