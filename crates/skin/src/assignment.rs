//! Which of several contacts is which of several others.
//!
//! Problem: contacts that were found have to be paired with true ones, or with those of a moment ago, none twice. Method: the linear
//! sum assignment, solved by the Hungarian method (Kuhn 1955, Munkres 1957). Cost: the square of the shorter side times the longer.

use pathfinding::matrix::Matrix;
use pathfinding::prelude::kuhn_munkres_min;

/// Largest cost that counts: 10 km in pm, of which sums cannot overflow.
const FARTHEST: i64 = 10_000_000_000_000_000;

/// Which column belongs to each row, none twice: the assignment whose costs add up to least. Every row of the shorter side gets a
/// partner. A cost is a distance \[m\], or a number without unit; steps below 10⁻¹² are not seen, and what is above 10⁴ or no number
/// counts as 10⁴.
#[must_use]
pub fn assign(rows: usize, columns: usize, cost: impl Fn(usize, usize) -> f64) -> Vec<Option<usize>> {
    // The method adds weights up exactly: whole numbers.
    let weight = |r: usize, c: usize| {
        let steps = cost(r, c) * 1e12;
        if steps < FARTHEST as f64 { steps as i64 } else { FARTHEST }
    };
    let mut assigned = vec![None; rows];
    if rows == 0 || columns == 0 {
        return assigned;
    }
    // Every row gets a column: the shorter side has to be the rows.
    if rows <= columns {
        let weights = Matrix::from_fn(rows, columns, |(r, c)| weight(r, c));
        for (r, c) in kuhn_munkres_min(&weights).1.into_iter().enumerate() {
            assigned[r] = Some(c);
        }
    } else {
        let weights = Matrix::from_fn(columns, rows, |(c, r)| weight(r, c));
        for (c, r) in kuhn_munkres_min(&weights).1.into_iter().enumerate() {
            assigned[r] = Some(c);
        }
    }
    assigned
}
