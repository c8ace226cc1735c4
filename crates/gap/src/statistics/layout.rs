//! Where products of columns are kept.
//!
//! A column that changes one channel only overlaps with columns of the same channel and with those of all channels. So the matrix
//! of products is an arrow of blocks: one of the shared columns, and for each channel one of its own columns and their products
//! with the shared ones.

use super::Column;

/// Where products of columns are kept: D × D of the shared columns first, then for each channel its own M columns × (D + M).
#[derive(Debug)]
pub(super) struct Layout {
    /// For each column its channel, if it is of one, and its place among those of its kind.
    pub place: Vec<(Option<usize>, usize)>,
    /// Shared columns.
    pub shared: Vec<usize>,
    /// Columns of each channel.
    pub own: Vec<Vec<usize>>,
    /// Where the block of each channel begins; the last is the end of all.
    pub begin: Vec<usize>,
}

/// Columns of a model by where they lie: positions in its list, and places in the layout.
#[derive(Debug, Clone, Default)]
pub(super) struct Split {
    pub shared: Vec<(usize, usize)>,
    pub own: Vec<(usize, Vec<(usize, usize)>)>,
}

/// In double precision.
fn wide<T: Into<f64>>(value: T) -> f64 {
    value.into()
}

impl Layout {
    pub fn new(columns: &[Column], channels: usize) -> Self {
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

    pub fn len(&self) -> usize {
        self.begin[self.begin.len() - 1]
    }

    /// Where the product of two columns is kept; nowhere where they do not overlap.
    pub fn at(&self, i: usize, j: usize) -> Option<usize> {
        let d = self.shared.len();
        let block = |k: usize, a: usize, b: usize| self.begin[k] + a * (d + self.own[k].len()) + b;
        match (self.place[i], self.place[j]) {
            ((None, a), (None, b)) => Some(a * d + b),
            ((Some(k), a), (None, b)) | ((None, b), (Some(k), a)) => Some(block(k, a, b)),
            ((Some(k), a), (Some(l), b)) if k == l => Some(block(k, a, d + b)),
            _ => None,
        }
    }

    pub fn split(&self, set: &[usize]) -> Split {
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
    pub fn energy<T: Copy + Into<f64>>(&self, g: &[T], split: &Split, theta: &[f64]) -> f64 {
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
    pub fn project<T: Copy + Into<f64>>(
        &self,
        g: &[T],
        split: &Split,
        theta: &[f64],
        of: &[usize],
    ) -> Vec<f64> {
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
