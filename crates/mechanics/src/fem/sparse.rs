//! Symmetric positive definite systems: assembly from elements, sparse Cholesky factors by faer.

use std::sync::Arc;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::{
    LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, Mat, MatMut, Par, Side};

use crate::MechanicsError;

/// In place of an unknown's number: its value is given.
pub(crate) const HELD: usize = usize::MAX;
/// Right-hand sides that are solved at once: more, or one by one, take longer.
pub(crate) const BLOCK: usize = 64;

/// The lower half of a symmetric matrix, by columns.
#[derive(Debug, Clone)]
pub(crate) struct Symmetric {
    starts: Vec<usize>,
    rows: Vec<usize>,
    values: Vec<f64>,
}

/// Order of elimination, and where the factor has entries: the same for all matrices of one pattern.
#[derive(Debug, Clone)]
pub(crate) struct Ordering(Arc<SymbolicCholesky<usize>>);

/// A factor.
#[derive(Debug)]
pub(crate) struct Factor {
    ordering: Ordering,
    values: Vec<f64>,
}

impl Symmetric {
    /// Zeros for `size` unknowns, of which each element of `elements` joins those that it names; [`HELD`] ones are not
    /// in the matrix.
    pub fn new<'a>(size: usize, elements: impl Iterator<Item = &'a [usize]> + Clone) -> Self {
        // Entries of each column before repetitions are removed.
        let mut counts = vec![0usize; size + 1];
        let joined = |dofs: &'a [usize]| {
            dofs.iter().flat_map(move |&c| {
                dofs.iter().filter(move |&&r| c != HELD && r != HELD && r >= c).map(move |&r| (r, c))
            })
        };
        for dofs in elements.clone() {
            for (_, c) in joined(dofs) {
                counts[c + 1] += 1;
            }
        }
        for c in 0..size {
            counts[c + 1] += counts[c];
        }
        let mut all = vec![0usize; counts[size]];
        let mut ends = counts.clone();
        for dofs in elements {
            for (r, c) in joined(dofs) {
                all[ends[c]] = r;
                ends[c] += 1;
            }
        }
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for c in 0..size {
            let column = &mut all[counts[c]..counts[c + 1]];
            column.sort_unstable();
            for i in 0..column.len() {
                if i == 0 || column[i] != column[i - 1] {
                    rows.push(column[i]);
                }
            }
            starts.push(rows.len());
        }
        let values = vec![0.0; rows.len()];
        Self { starts, rows, values }
    }

    /// Sets every entry to 0.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Adds an element's square `matrix` (by rows) to the entries of its unknowns.
    pub fn add(&mut self, dofs: &[usize], matrix: &[f64]) {
        let n = dofs.len();
        for (j, &c) in dofs.iter().enumerate() {
            if c == HELD {
                continue;
            }
            let (start, end) = (self.starts[c], self.starts[c + 1]);
            let rows = &self.rows[start..end];
            for (i, &r) in dofs.iter().enumerate() {
                if r == HELD || r < c {
                    continue;
                }
                if let Ok(at) = rows.binary_search(&r) {
                    self.values[start + at] += matrix[i * n + j];
                }
            }
        }
    }

    /// How many unknowns there are.
    pub fn size(&self) -> usize {
        self.starts.len() - 1
    }

    /// Where each column starts, the rows of its entries, and the entries.
    pub fn columns(&self) -> (&[usize], &[usize], &[f64]) {
        (&self.starts, &self.rows, &self.values)
    }

    fn pattern(&self) -> SymbolicSparseColMatRef<'_, usize> {
        let n = self.starts.len() - 1;
        SymbolicSparseColMatRef::new_checked(n, n, &self.starts, None, &self.rows)
    }

    /// Looks for the entries of the factor in the order of elimination `first` (unknowns by number), or in one that is found
    /// here and keeps the factor sparse.
    pub fn order(&self, first: Option<&[usize]>) -> Result<Ordering, MechanicsError> {
        let inverse = first.map(|first| {
            let mut inverse = vec![0; first.len()];
            for (place, &unknown) in first.iter().enumerate() {
                inverse[unknown] = place;
            }
            inverse
        });
        let ordering = match (first, &inverse) {
            (Some(first), Some(inverse)) => {
                SymmetricOrdering::Custom(PermRef::new_checked(first, inverse, first.len()))
            }
            _ => SymmetricOrdering::Amd,
        };
        factorize_symbolic_cholesky(self.pattern(), Side::Lower, ordering, Default::default())
            .map(|symbolic| Ordering(Arc::new(symbolic)))
            .map_err(|_| MechanicsError::Singular)
    }

    /// Factors the matrix.
    pub fn factor(&self, ordering: &Ordering) -> Result<Factor, MechanicsError> {
        let matrix = SparseColMatRef::new(self.pattern(), &self.values[..]);
        let symbolic = &ordering.0;
        let mut values = vec![0.0; symbolic.len_val()];
        let need = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        symbolic
            .factorize_numeric_llt(
                &mut values,
                matrix,
                Side::Lower,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut MemBuffer::new(need)),
                Default::default(),
            )
            .map_err(|_| MechanicsError::Singular)?;
        Ok(Factor { ordering: ordering.clone(), values })
    }
}

impl Factor {
    /// Puts the solution in the place of each column.
    pub fn solve(&self, columns: &mut [Vec<f64>]) {
        for block in columns.chunks_mut(BLOCK) {
            let n = block[0].len();
            let mut right = Mat::from_fn(n, block.len(), |i, j| block[j][i]);
            self.solve_matrix(right.as_mut());
            for (j, column) in block.iter_mut().enumerate() {
                column.copy_from_slice(right.col_as_slice(j));
            }
        }
    }

    /// Puts the solution in the place of `count` columns that lie one after the other; best [`BLOCK`] of them or fewer.
    pub fn solve_columns(&self, columns: &mut [f64], count: usize) {
        let size = columns.len().checked_div(count).unwrap_or(0);
        self.solve_matrix(MatMut::from_column_major_slice_mut(columns, size, count));
    }

    fn solve_matrix(&self, right: MatMut<'_, f64>) {
        let symbolic = &*self.ordering.0;
        let need = symbolic.solve_in_place_scratch::<f64>(right.ncols(), Par::Seq);
        LltRef::new(symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            right,
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(need)),
        );
    }
}
