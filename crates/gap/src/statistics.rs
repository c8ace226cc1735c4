//! Sufficient statistics per group of contacts: every fold, subset, resampling and permutation is algebra over them.
//!
//! A column that changes one channel only overlaps with columns of the same channel and with those of all channels. So the
//! products of columns are kept, and solved, as a matrix of blocks: one of the shared columns, and for each channel one of its own
//! columns and their products with the shared ones. Hundreds of channels with columns of their own cost no more than each alone.

use std::sync::Arc;

use crate::algebra::{backward, cholesky, forward};
use crate::rows::Rows;

/// One direction in which an effect changes readings, in deviations of the noise.
#[derive(Debug, Clone)]
pub struct Column {
    /// Where it changes one channel only: one value a row. Otherwise rows × channels values.
    pub channel: Option<usize>,
    /// Values.
    pub values: Vec<f32>,
}

/// Where products of columns are kept: D × D of the shared columns first, then for each channel its own M columns × (D + M).
#[derive(Debug)]
struct Layout {
    /// For each column its channel, if it is of one, and its place among those of its kind.
    place: Vec<(Option<usize>, usize)>,
    /// Shared columns.
    shared: Vec<usize>,
    /// Columns of each channel.
    own: Vec<Vec<usize>>,
    /// Where the block of each channel begins; the last is the end of all.
    begin: Vec<usize>,
}

/// Columns of a model by where they lie: positions in its list, and places in the layout.
#[derive(Debug, Clone, Default)]
struct Split {
    shared: Vec<(usize, usize)>,
    own: Vec<(usize, Vec<(usize, usize)>)>,
}

/// In double precision.
fn wide<T: Into<f64>>(value: T) -> f64 {
    value.into()
}

impl Layout {
    fn new(columns: &[Column], channels: usize) -> Self {
        let (mut place, mut shared, mut own) = (Vec::new(), Vec::new(), vec![Vec::new(); channels]);
        for (c, column) in columns.iter().enumerate() {
            let of = column.channel.map_or(&mut shared, |k| &mut own[k]);
            place.push((column.channel, of.len()));
            of.push(c);
        }
        let mut begin = vec![shared.len() * shared.len()];
        for of in &own {
            begin.push(begin[begin.len() - 1] + of.len() * (shared.len() + of.len()));
        }
        Self { place, shared, own, begin }
    }

    fn len(&self) -> usize {
        self.begin[self.begin.len() - 1]
    }

    /// Where the product of two columns is kept; nowhere where they do not overlap.
    fn at(&self, i: usize, j: usize) -> Option<usize> {
        let d = self.shared.len();
        let block = |k: usize, a: usize, b: usize| self.begin[k] + a * (d + self.own[k].len()) + b;
        match (self.place[i], self.place[j]) {
            ((None, a), (None, b)) => Some(a * d + b),
            ((Some(k), a), (None, b)) | ((None, b), (Some(k), a)) => Some(block(k, a, b)),
            ((Some(k), a), (Some(l), b)) if k == l => Some(block(k, a, d + b)),
            _ => None,
        }
    }

    fn split(&self, set: &[usize]) -> Split {
        let mut split = Split::default();
        let mut own: Vec<(usize, (usize, usize))> = Vec::new();
        for (at, &c) in set.iter().enumerate() {
            match self.place[c] {
                (None, slot) => split.shared.push((at, slot)),
                (Some(k), slot) => own.push((k, (at, slot))),
            }
        }
        // Columns of a channel stay in their order.
        own.sort_by_key(|(k, _)| *k);
        for of in own.chunk_by(|a, b| a.0 == b.0) {
            split.own.push((of[0].0, of.iter().map(|(_, place)| *place).collect()));
        }
        split
    }

    /// Energy of a sum of columns.
    fn energy<T: Copy + Into<f64>>(&self, g: &[T], split: &Split, theta: &[f64]) -> f64 {
        let d = self.shared.len();
        let mut energy = 0.0;
        for (n, &(at, slot)) in split.shared.iter().enumerate() {
            let row = &g[slot * d..(slot + 1) * d];
            let cross: f64 = split.shared[..n].iter().map(|&(b, t)| theta[b] * wide(row[t])).sum();
            energy += theta[at] * (2.0 * cross + theta[at] * wide(row[slot]));
        }
        for (k, of) in &split.own {
            let width = d + self.own[*k].len();
            for (n, &(at, slot)) in of.iter().enumerate() {
                let row = &g[self.begin[*k] + slot * width..][..width];
                let shared: f64 = split.shared.iter().map(|&(b, t)| theta[b] * wide(row[t])).sum();
                let own: f64 = of[..n].iter().map(|&(b, t)| theta[b] * wide(row[d + t])).sum();
                energy += theta[at] * (2.0 * (shared + own) + theta[at] * wide(row[d + slot]));
            }
        }
        energy
    }

    /// Products of the columns `of` with a sum of columns.
    fn project<T: Copy + Into<f64>>(&self, g: &[T], split: &Split, theta: &[f64], of: &[usize]) -> Vec<f64> {
        let d = self.shared.len();
        let value = |index: usize| wide(g[index]);
        // What columns of channels give to each shared one.
        let mut shared = vec![0.0; d];
        for &(at, slot) in &split.shared {
            for (s, v) in shared.iter_mut().zip(&g[slot * d..(slot + 1) * d]) {
                *s += theta[at] * wide(*v);
            }
        }
        for (k, own) in &split.own {
            let width = d + self.own[*k].len();
            for &(at, slot) in own {
                for (s, v) in shared.iter_mut().zip(&g[self.begin[*k] + slot * width..][..d]) {
                    *s += theta[at] * wide(*v);
                }
            }
        }
        of.iter()
            .map(|&c| match self.place[c] {
                (None, slot) => shared[slot],
                (Some(k), slot) => {
                    let row = self.begin[k] + slot * (d + self.own[k].len());
                    let from: f64 = split.shared.iter().map(|&(b, t)| theta[b] * value(row + t)).sum();
                    let Ok(found) = split.own.binary_search_by_key(&k, |(k, _)| *k) else { return from };
                    let own = split.own[found].1.iter().map(|&(b, t)| theta[b] * value(row + d + t));
                    from + own.sum::<f64>()
                }
            })
            .collect()
    }
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
    /// Products of `columns` with each other and with `residual` (rows × channels).
    #[must_use]
    pub fn new(columns: &[Column], residual: &[f32], rows: &Rows, channels: usize) -> Self {
        let layout = Arc::new(Layout::new(columns, channels));
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); rows.groups];
        for (i, row) in rows.rows.iter().enumerate() {
            members[row.group].push(i);
        }
        let of = |member: &Vec<usize>| group(columns, residual, &layout, channels, member);
        // Two threads, as all simulations have.
        let (first, last) = members.split_at(members.len() / 2);
        let mut groups = Vec::with_capacity(members.len());
        std::thread::scope(|scope| {
            let other = scope.spawn(|| last.iter().map(of).collect::<Vec<_>>());
            groups.extend(first.iter().map(of));
            match other.join() {
                Ok(found) => groups.extend(found),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        });
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

/// Products within the rows `member`.
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

/// Factor of products of columns: channels first, then what is left of the shared ones.
#[derive(Debug, Clone)]
pub struct Factor {
    split: Split,
    /// For each channel the factor of its own columns, and the products with the shared ones solved with it.
    blocks: Vec<(Vec<f64>, Vec<f64>)>,
    corner: Vec<f64>,
    count: usize,
}

impl Factor {
    /// Coefficients for these scores, in the order of the columns that were factored.
    #[must_use]
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let s = self.split.shared.len();
        let mut shared: Vec<f64> = self.split.shared.iter().map(|&(at, _)| b[at]).collect();
        let mut parts = Vec::with_capacity(self.blocks.len());
        for ((_, of), (own, side)) in self.split.own.iter().zip(&self.blocks) {
            let m = of.len();
            let mut y: Vec<f64> = of.iter().map(|&(at, _)| b[at]).collect();
            if y.iter().any(|v| *v != 0.0) {
                forward(own, m, &mut y);
                for (x, row) in shared.iter_mut().zip(side.chunks_exact(m)) {
                    *x -= row.iter().zip(&y).map(|(a, b)| a * b).sum::<f64>();
                }
            }
            parts.push(y);
        }
        forward(&self.corner, s, &mut shared);
        backward(&self.corner, s, &mut shared);
        let mut found = vec![0.0; self.count];
        for (&(at, _), x) in self.split.shared.iter().zip(&shared) {
            found[at] = *x;
        }
        for (((_, of), (own, side)), mut y) in self.split.own.iter().zip(&self.blocks).zip(parts) {
            let m = of.len();
            for (x, row) in shared.iter().zip(side.chunks_exact(m)) {
                y.iter_mut().zip(row).for_each(|(y, r)| *y -= x * r);
            }
            backward(own, m, &mut y);
            for (&(at, _), x) in of.iter().zip(&y) {
                found[at] = *x;
            }
        }
        found
    }

    /// Energy that columns with these scores hold: scores times coefficients.
    #[must_use]
    pub fn held(&self, b: &[f64]) -> f64 {
        let s = self.split.shared.len();
        let mut shared: Vec<f64> = self.split.shared.iter().map(|&(at, _)| b[at]).collect();
        let mut held = 0.0;
        let mut y: Vec<f64> = Vec::new();
        for ((_, of), (own, side)) in self.split.own.iter().zip(&self.blocks) {
            let m = of.len();
            y.clear();
            y.extend(of.iter().map(|&(at, _)| b[at]));
            if y.iter().all(|v| *v == 0.0) {
                continue;
            }
            forward(own, m, &mut y);
            held += y.iter().map(|v| v * v).sum::<f64>();
            for (x, row) in shared.iter_mut().zip(side.chunks_exact(m)) {
                *x -= row.iter().zip(&y).map(|(a, b)| a * b).sum::<f64>();
            }
        }
        forward(&self.corner, s, &mut shared);
        held + shared.iter().map(|v| v * v).sum::<f64>()
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
            glances: 0,
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
    fn mixed() -> (Vec<Column>, Vec<f32>, Rows) {
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
        (columns, residual, rows(&(0..n).map(|i| i % 3).collect::<Vec<_>>()))
    }

    #[test]
    fn blocks_say_what_the_whole_matrix_says() {
        let (columns, residual, rows) = mixed();
        let statistics = Statistics::new(&columns, &residual, &rows, 4);
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
            let mut a: Vec<f64> = set
                .iter()
                .flat_map(|&i| set.iter().map(move |&j| (i, j)))
                .map(|(i, j)| sum.at(i, j))
                .collect();
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
            let left: f64 =
                [1.0, 0.5, 2.0].iter().enumerate().map(|(g, w)| w * statistics.loss(g, &fit)).sum();
            approx::assert_relative_eq!(left, sum.rr - 2.0 * dot(&b, &theta) + energy, epsilon = 1e-6);
        }
        // Columns that say the same twice are no factor without a prior.
        assert!(sum.factor(&[1, 1], |_, g| g).is_none());
    }
}
