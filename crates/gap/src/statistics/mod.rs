//! Sufficient statistics per group of contacts: every fold, subset, resampling and permutation is algebra over them.
//!
//! A column that changes one channel only overlaps with columns of the same channel and with those of all channels. So the
//! products of columns are kept, and solved, as a matrix of blocks: one of the shared columns, and for each channel one of its own
//! columns and their products with the shared ones. Hundreds of channels with columns of their own cost no more than each alone.

mod factor;
mod gram;
mod layout;
#[cfg(test)]
pub(crate) mod tests;

use std::sync::Arc;

use dermis_model::in_parallel;

use crate::algebra::{cholesky, forward};
use crate::samples::Samples;

pub use factor::Factor;
pub(crate) use gram::Gram;
use layout::{Layout, Split};

/// One direction in which an effect changes readings, in deviations of the noise.
#[derive(Debug, Clone)]
pub struct Column {
    /// Where it changes one channel only: one value a sample. Otherwise samples × channels values.
    pub channel: Option<usize>,
    /// Values.
    pub values: Vec<f32>,
}

/// Products of columns and residual within one group.
#[derive(Debug, Clone)]
struct Group {
    g: Vec<f32>,
    b: Vec<f64>,
    rr: f64,
}

/// Products of columns and residual, by group.
#[derive(Debug, Clone)]
pub struct Statistics {
    layout: Arc<Layout>,
    groups: Vec<Group>,
}

/// Weighted sum over groups.
#[derive(Debug, Clone)]
pub struct Sum {
    layout: Arc<Layout>,
    g: Vec<f64>,
    /// Scores, one a column.
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
    split: Split,
}

impl Fit {
    /// Coefficient of a column; 0 where it is not in the fit.
    #[must_use]
    pub fn of(&self, column: usize) -> f64 {
        self.set.iter().position(|c| *c == column).map_or(0.0, |at| self.theta[at])
    }

    /// Columns with their coefficients.
    pub fn terms(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.set.iter().copied().zip(self.theta.iter().copied())
    }
}

impl Statistics {
    /// Products of `columns` with each other and with `residual` (samples × channels).
    #[must_use]
    pub fn new(columns: &[Column], residual: &[f32], samples: &Samples, channels: usize) -> Self {
        let layout = Arc::new(Layout::new(columns, channels));
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); samples.groups];
        for (i, row) in samples.list.iter().enumerate() {
            members[row.group].push(i);
        }
        let groups = in_parallel(members.len(), |i| group(columns, residual, &layout, channels, &members[i]));
        Self { layout, groups }
    }

    /// Number of groups.
    #[must_use]
    pub fn groups(&self) -> usize {
        self.groups.len()
    }

    /// Number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.layout.place.len()
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
        let mut g = vec![0.0; self.layout.len()];
        let (mut b, mut rr) = (vec![0.0; self.columns()], 0.0);
        for (group, &w) in self.groups.iter().zip(weights) {
            if w == 0.0 {
                continue;
            }
            for (s, g) in g.iter_mut().zip(&group.g) {
                *s += w * f64::from(*g);
            }
            for (s, b) in b.iter_mut().zip(&group.b) {
                *s += w * b;
            }
            rr += w * group.rr;
        }
        Sum { layout: Arc::clone(&self.layout), g, b, rr }
    }

    /// What is left of one group's energy after a fit.
    #[must_use]
    pub fn loss(&self, group: usize, fit: &Fit) -> f64 {
        let group = &self.groups[group];
        let along: f64 = fit.set.iter().zip(&fit.theta).map(|(&i, x)| x * group.b[i]).sum();
        group.rr - 2.0 * along + self.layout.energy(&group.g, &fit.split, &fit.theta)
    }

    /// Products of one group's columns with a fit.
    #[must_use]
    pub fn project(&self, group: usize, fit: &Fit, of: &[usize]) -> Vec<f64> {
        self.layout.project(&self.groups[group].g, &fit.split, &fit.theta, of)
    }
}

/// Products within the samples `member`.
fn group(columns: &[Column], residual: &[f32], layout: &Layout, channels: usize, member: &[usize]) -> Group {
    let d = layout.shared.len();
    let mut g = vec![0.0f32; layout.len()];
    let mut shared = vec![0.0f64; d * d];
    let (mut b, mut rr) = (vec![0.0f64; columns.len()], 0.0f64);
    let mut block: Vec<f32> = Vec::new();
    let mut local: Vec<f64> = Vec::new();
    for (k, own) in layout.own.iter().enumerate() {
        let m = d + own.len() + 1;
        block.clear();
        for &i in member {
            block.extend(layout.shared.iter().map(|&c| columns[c].values[i * channels + k]));
            block.extend(own.iter().map(|&c| columns[c].values[i]));
            block.push(residual[i * channels + k]);
        }
        local.clear();
        local.resize(m * m, 0.0);
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
        let product = |a: usize, c: usize| local[a.min(c) * m + a.max(c)];
        for a in 0..d {
            for c in a..d {
                shared[a * d + c] += local[a * m + c];
            }
            b[layout.shared[a]] += local[a * m + m - 1];
        }
        let width = d + own.len();
        for (a, &column) in own.iter().enumerate() {
            let row = &mut g[layout.begin[k] + a * width..][..width];
            row.iter_mut().enumerate().for_each(|(c, r)| *r = product(d + a, c) as f32);
            b[column] += local[(d + a) * m + m - 1];
        }
        rr += local[m * m - 1];
    }
    for a in 0..d {
        for c in a..d {
            let value = shared[a * d + c] as f32;
            (g[a * d + c], g[c * d + a]) = (value, value);
        }
    }
    Group { g, b, rr }
}

impl Sum {
    /// Number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.b.len()
    }

    /// Product of two columns.
    #[must_use]
    pub fn at(&self, i: usize, j: usize) -> f64 {
        self.layout.at(i, j).map_or(0.0, |index| self.g[index])
    }

    /// Energy of one column.
    #[must_use]
    pub fn diagonal(&self, column: usize) -> f64 {
        self.at(column, column)
    }

    /// Sum without another.
    #[must_use]
    pub fn minus(&self, other: &Self) -> Self {
        let subtract = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect();
        Self {
            layout: Arc::clone(&self.layout),
            g: subtract(&self.g, &other.g),
            b: subtract(&self.b, &other.b),
            rr: self.rr - other.rr,
        }
    }

    /// What is left of the energy after a fit.
    #[must_use]
    pub fn loss(&self, fit: &Fit) -> f64 {
        let along: f64 = fit.set.iter().zip(&fit.theta).map(|(&i, x)| x * self.b[i]).sum();
        self.rr - 2.0 * along + self.layout.energy(&self.g, &fit.split, &fit.theta)
    }

    /// Energy of a sum of columns.
    #[must_use]
    pub fn energy(&self, set: &[usize], theta: &[f64]) -> f64 {
        self.layout.energy(&self.g, &self.layout.split(set), theta)
    }

    /// Products of the columns `of` with a sum of columns.
    #[must_use]
    pub fn project(&self, set: &[usize], theta: &[f64], of: &[usize]) -> Vec<f64> {
        self.layout.project(&self.g, &self.layout.split(set), theta, of)
    }

    /// Least squares on the columns of `set`, each coefficient under a prior of mean 0: `prior` gives the inverse of its variance.
    #[must_use]
    pub fn fit(&self, set: &[usize], prior: impl Fn(usize) -> f64) -> Fit {
        let b: Vec<f64> = set.iter().map(|&i| self.b[i]).collect();
        let factor = self.factor(set, |i, g| g * (1.0 + 1e-9) + prior(i) + 1e-12);
        let theta = factor.as_ref().map_or_else(|| vec![0.0; set.len()], |f| f.solve(&b));
        let split = factor.map_or_else(|| self.layout.split(set), |f| f.split);
        Fit { set: set.to_vec(), theta, split }
    }

    /// Factor of the products of the columns of `set`; `diagonal` makes the diagonal of each column and its energy. `None` where
    /// the matrix is not positive definite.
    #[must_use]
    pub fn factor(&self, set: &[usize], diagonal: impl Fn(usize, f64) -> f64) -> Option<Factor> {
        let split = self.layout.split(set);
        let d = self.layout.shared.len();
        let s = split.shared.len();
        let mut corner: Vec<f64> = Vec::with_capacity(s * s);
        for (r, &(at, slot)) in split.shared.iter().enumerate() {
            corner.extend(split.shared.iter().map(|&(_, t)| self.g[slot * d + t]));
            corner[r * s + r] = diagonal(set[at], corner[r * s + r]);
        }
        let mut blocks = Vec::with_capacity(split.own.len());
        for (k, of) in &split.own {
            let (m, width) = (of.len(), d + self.layout.own[*k].len());
            let row = |slot: usize| &self.g[self.layout.begin[*k] + slot * width..][..width];
            let mut own: Vec<f64> = Vec::with_capacity(m * m);
            for (r, &(at, slot)) in of.iter().enumerate() {
                own.extend(of.iter().map(|&(_, t)| row(slot)[d + t]));
                own[r * m + r] = diagonal(set[at], own[r * m + r]);
            }
            cholesky(&mut own, m)?;
            // One row for each shared column, solved with the factor of this channel.
            let mut side: Vec<f64> = Vec::with_capacity(s * m);
            for &(_, t) in &split.shared {
                let mut along: Vec<f64> = of.iter().map(|&(_, slot)| row(slot)[t]).collect();
                forward(&own, m, &mut along);
                side.extend(along);
            }
            for a in 0..s {
                for b in a..s {
                    let inner: f64 = side[a * m..(a + 1) * m]
                        .iter()
                        .zip(&side[b * m..(b + 1) * m])
                        .map(|(x, y)| x * y)
                        .sum();
                    corner[a * s + b] -= inner;
                }
            }
            blocks.push((own, side));
        }
        cholesky(&mut corner, s)?;
        Some(Factor { split, blocks, corner, count: set.len() })
    }
}
