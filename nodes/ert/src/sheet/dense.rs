//! Sheets that are not uniform: the matrix itself, its factor, and the whole Green's matrix.

use std::num::NonZeroUsize;

use dermis_mechanics::MechanicsError;
use faer::linalg::solvers::SolveCore;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Conj, Mat, Side};

use super::{Design, Grid};

/// Right-hand sides that are solved at once.
const BLOCK: usize = 64;

/// The conductances of a grid.
#[derive(Debug, Clone)]
pub struct Conductors {
    grid: Grid,
    /// \[S\] from each point to the next one along x, and along y; 0 where there is none.
    along: [Vec<f64>; 2],
    /// \[S\] from each point to ground.
    pub ground: Vec<f64>,
}

impl Conductors {
    /// Of a sheet whose resistance \[Ω per square\] is `resistance` times the `factors` of its points; `leak` \[S/m²\].
    #[must_use]
    pub fn new(grid: Grid, resistance: [f64; 2], factors: Option<&[f64]>, leak: f64) -> Self {
        let ([nx, ny], [hx, hy]) = (grid.points(), grid.step());
        let mut along = [vec![0.0; grid.count()], vec![0.0; grid.count()]];
        for node in 0..grid.count() {
            let [i, j] = grid.place(node);
            let edge = |k: usize, n: usize| if k == 0 || k == n - 1 { 0.5 } else { 1.0 };
            // In a row, halves of two cells follow each other: their resistances add up.
            let mean = |next: usize| factors.map_or(1.0, |f| f64::midpoint(f[node], f[next]));
            if i + 1 < nx {
                along[0][node] = edge(j, ny) * hy / (hx * resistance[0] * mean(node + 1));
            }
            if j + 1 < ny {
                along[1][node] = edge(i, nx) * hx / (hy * resistance[1] * mean(node + nx));
            }
        }
        let ground = (0..grid.count()).map(|node| leak * grid.area(node)).collect();
        Self { grid, along, ground }
    }

    /// Its triplets (row, column, conductance) of the lower half.
    #[must_use]
    pub fn triplets(&self) -> Vec<(usize, usize, f64)> {
        let width = self.grid.points()[0];
        let mut diagonal = self.ground.clone();
        let mut lower = Vec::with_capacity(3 * diagonal.len());
        for (along, by) in self.along.iter().zip([1, width]) {
            for (node, &conductance) in along.iter().enumerate().filter(|(_, c)| **c > 0.0) {
                diagonal[node] += conductance;
                diagonal[node + by] += conductance;
                lower.push((node + by, node, -conductance));
            }
        }
        lower.extend(diagonal.into_iter().enumerate().map(|(node, d)| (node, node, d)));
        lower
    }

    /// Factors the matrix.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Singular`] where nothing leads to ground, or numbers are none.
    pub fn factor(&self) -> Result<Factored, MechanicsError> {
        let n = self.grid.count();
        let triplets: Vec<Triplet<usize, usize, f64>> =
            self.triplets().into_iter().map(|(row, col, val)| Triplet { row, col, val }).collect();
        let matrix =
            SparseColMat::try_new_from_triplets(n, n, &triplets).map_err(|_| MechanicsError::Singular)?;
        let factor = matrix.sp_cholesky(Side::Lower).map_err(|_| MechanicsError::Singular)?;
        Ok(Factored { factor, size: n })
    }
}

/// A factored sheet.
#[derive(Debug)]
pub struct Factored {
    factor: Llt<usize, f64>,
    size: usize,
}

impl Factored {
    /// Potentials \[V\] for the currents \[A\] of each column.
    #[must_use]
    pub fn solve(&self, currents: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let mut right = Mat::from_fn(self.size, currents.len(), |i, j| currents[j][i]);
        self.factor.solve_in_place_with_conj(Conj::No, right.as_mut());
        (0..currents.len()).map(|j| right.col_as_slice(j).to_vec()).collect()
    }
}

/// The lower half of a Green's matrix without its mean, by columns.
#[derive(Debug)]
pub(super) struct Dense {
    size: usize,
    values: Vec<f32>,
}

impl Dense {
    /// Green's matrix of a sheet, and its mean \[Ω\].
    pub fn new(design: &Design, factors: &[f64], ground: &[f64]) -> Result<(Self, f64), MechanicsError> {
        let mut conductors = Conductors::new(design.grid, design.resistance, Some(factors), design.leak);
        conductors.ground.iter_mut().zip(ground).for_each(|(all, g)| *all += g);
        let mean = 1.0 / conductors.ground.iter().sum::<f64>();
        let factored = conductors.factor()?;
        let size = design.grid.count();
        let mut values = vec![0.0f32; size * (size + 1) / 2];
        // Each block of columns is a piece of its own.
        let mut pieces: Vec<(usize, &mut [f32])> = Vec::new();
        let mut rest = &mut values[..];
        for first in (0..size).step_by(BLOCK) {
            let last = (first + BLOCK).min(size);
            let length = start(size, last) - start(size, first);
            let (piece, after) = rest.split_at_mut(length);
            pieces.push((first, piece));
            rest = after;
        }
        let threads = std::thread::available_parallelism().map_or(1, NonZeroUsize::get).min(8);
        let mut shares: Vec<Vec<(usize, &mut [f32])>> = (0..threads).map(|_| Vec::new()).collect();
        for (i, piece) in pieces.into_iter().enumerate() {
            shares[i % threads].push(piece);
        }
        std::thread::scope(|scope| {
            for share in shares {
                scope.spawn(|| {
                    for (first, piece) in share {
                        fill(&factored, mean, first, piece);
                    }
                });
            }
        });
        Ok((Self { size, values }, mean))
    }

    #[inline]
    pub fn value(&self, a: usize, b: usize) -> f32 {
        let (row, column) = (a.max(b), a.min(b));
        self.values[start(self.size, column) + row - column]
    }
}

/// Where a column of the lower half begins.
#[inline]
fn start(size: usize, column: usize) -> usize {
    column * (2 * size + 1 - column) / 2
}

/// Computes the columns from `first` on that `piece` has room for.
fn fill(factored: &Factored, mean: f64, first: usize, piece: &mut [f32]) {
    let size = factored.size;
    let count = (size - first).min(BLOCK);
    let mut right = Mat::from_fn(size, count, |i, j| if i == first + j { 1.0 } else { 0.0 });
    factored.factor.solve_in_place_with_conj(Conj::No, right.as_mut());
    let mut out = piece;
    for j in 0..count {
        let (column, rest) = out.split_at_mut(size - first - j);
        for (to, from) in column.iter_mut().zip(&right.col_as_slice(j)[first + j..]) {
            *to = (from - mean) as f32;
        }
        out = rest;
    }
}
