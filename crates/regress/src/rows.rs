//! Tables, row by row, and columns of alike spread.

use crate::RegressError;

/// The `n` with which every n-th of `count` is taken, so that there are `most` at most; one at least.
#[must_use]
pub const fn stride(count: usize, most: usize) -> usize {
    let n = count.div_ceil(if most == 0 { 1 } else { most });
    if n == 0 { 1 } else { n }
}

/// A table of numbers, row by row.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    values: &'a [f64],
    width: usize,
}

impl<'a> Rows<'a> {
    /// `values` in rows of `width`; `what` is what errors call the table.
    ///
    /// # Errors
    ///
    /// [`RegressError`] where there are no rows, the last one is not whole, or a number is not finite.
    pub fn new(values: &'a [f64], width: usize, what: &'static str) -> Result<Self, RegressError> {
        if width == 0 || values.is_empty() {
            return Err(RegressError::Empty);
        }
        let left = values.len() % width;
        if left != 0 {
            return Err(RegressError::Size { what, found: left, expected: width });
        }
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(RegressError::NotFinite { what, row: at / width });
        }
        Ok(Self { values, width })
    }

    /// Numbers in a row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of the table; at least one.
    #[must_use]
    pub fn count(&self) -> usize {
        self.values.len() / self.width
    }

    /// One row.
    #[must_use]
    pub fn row(&self, index: usize) -> &'a [f64] {
        &self.values[index * self.width..(index + 1) * self.width]
    }

    /// All rows in order.
    pub fn iter(&self) -> std::slice::ChunksExact<'a, f64> {
        self.values.chunks_exact(self.width)
    }
}

/// Mean and spread of every column: what is subtracted and divided by, so that all columns count alike.
#[derive(Debug, Clone, PartialEq)]
pub struct Standard {
    /// Of each column.
    pub mean: Vec<f64>,
    /// Standard deviation of each column; 1 where it does not vary.
    pub spread: Vec<f64>,
}

impl Standard {
    /// Of the columns of a table.
    #[must_use]
    pub fn of(rows: &Rows<'_>) -> Self {
        let count = rows.count() as f64;
        let mut mean = vec![0.0; rows.width()];
        for row in rows.iter() {
            mean.iter_mut().zip(row).for_each(|(m, v)| *m += v / count);
        }
        let mut spread = vec![0.0; rows.width()];
        for row in rows.iter() {
            for ((s, v), m) in spread.iter_mut().zip(row).zip(&mean) {
                *s += (v - m) * (v - m) / count;
            }
        }
        for (s, m) in spread.iter_mut().zip(&mean) {
            let root = s.sqrt();
            *s = if root > 1e-12 * m.abs().max(f64::MIN_POSITIVE) { root } else { 1.0 };
        }
        Self { mean, spread }
    }

    /// A row with mean 0 and spread 1 in every column, appended to `out`.
    pub fn push(&self, row: &[f64], out: &mut Vec<f64>) {
        out.extend(row.iter().zip(&self.mean).zip(&self.spread).map(|((v, m), s)| (v - m) / s));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_that_cannot_be_are_refused() {
        assert!(Rows::new(&[], 3, "inputs").is_err());
        insta::assert_snapshot!(Rows::new(&[1.0, 2.0, 3.0], 2, "inputs").unwrap_err(), @"inputs has 1 numbers where 2 belong");
        insta::assert_snapshot!(Rows::new(&[1.0, 2.0, 3.0, f64::NAN], 2, "targets").unwrap_err(), @"targets, row 1: holds a number that is not finite");
    }

    #[test]
    fn columns_become_alike() {
        let values = [1.0, 7.0, 3.0, 7.0];
        let rows = Rows::new(&values, 2, "inputs").unwrap();
        let standard = Standard::of(&rows);
        assert_eq!(
            (standard.mean.as_slice(), standard.spread.as_slice()),
            (&[2.0, 7.0][..], &[1.0, 1.0][..])
        );
        let mut out = Vec::new();
        standard.push(rows.row(0), &mut out);
        assert_eq!(out, [-1.0, 0.0]);
    }
}
