//! A resistive sheet by finite volumes, and what one press changes between its electrodes.
//!
//! Problem: −∇·(1/R ∇φ) + g φ = I on a rectangle without current through its border, R \[Ω per square\] along each axis and from
//! place to place, g what foam lets through to ground. Method: cells of a regular grid with harmonic means of conductances between
//! neighbours (Patankar 1980), factored once (sparse Cholesky), its Green's matrix whole; a press adds conductance to ground at a
//! few cells, by Woodbury's identity. The foam conducts in proportion to a power of its pressure, which is spread as a Gaussian.
//!
//! It is used for differences only: what a cause of the sheet changes is added to the voltages of the design
//! ([`Designs`](crate::Designs)). So its coarse grid does not count as a gap. Cost: half a second to make, some 30 µs a press.

use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};
use nalgebra::{DMatrix, DVector};

/// \[m\] of a cell, about.
const CELL: f64 = 0.015;
/// Deviations beyond which a press's pressure is left out.
const BEYOND: f64 = 3.0;

/// How current comes in, and through the foam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Foam {
    /// \[S/m²\] untouched.
    pub leak: f64,
    /// \[S/m²\] at the reference pressure \[Pa\], and the power of the pressure.
    pub conductance: f64,
    pub reference: f64,
    pub exponent: f64,
    /// \[m\] of what lies between tip and foam.
    pub cover: f64,
}

/// What a sheet is made of.
pub(super) struct Weave<'a> {
    /// \[m\] along x and y.
    pub size: [f64; 2],
    /// \[Ω per square\] along x and y.
    pub resistance: [f64; 2],
    /// Factor of that at a place \[m\].
    pub factor: &'a dyn Fn([f64; 2]) -> f64,
    /// \[m\] of the middles of electrodes.
    pub electrodes: &'a [[f64; 2]],
    /// \[m\] of their discs.
    pub radius: f64,
    pub foam: Foam,
}

/// A sheet, solved.
#[derive(Debug)]
pub(super) struct Sheet {
    size: [f64; 2],
    cells: [usize; 2],
    foam: Foam,
    /// \[Ω\] at every cell for a current into every cell.
    green: Mat<f64>,
    /// \[Ω\] at every electrode, by cells.
    reach: DMatrix<f64>,
    /// \[Ω\] between electrodes where nothing touches.
    untouched: DMatrix<f64>,
}

impl Sheet {
    /// `None` where it cannot be solved: a number of it is none.
    pub fn new(weave: &Weave<'_>) -> Option<Self> {
        let cells = weave.size.map(|s| (s / CELL).round().max(4.0) as usize);
        let count = cells[0] * cells[1];
        let step = [0, 1].map(|k| weave.size[k] / cells[k] as f64);
        let place = |n: usize| {
            let at = [n % cells[0], n / cells[0]];
            [0, 1].map(|k| (at[k] as f64 + 0.5) * step[k] - weave.size[k] / 2.0)
        };
        let factor: Vec<f64> = (0..count).map(|n| (weave.factor)(place(n)).max(1e-3)).collect();
        let mut entries = Vec::new();
        for n in 0..count {
            entries.push(Triplet::new(n, n, weave.foam.leak * step[0] * step[1]));
            let neighbours =
                [(n % cells[0] + 1 < cells[0], n + 1, 0), (n / cells[0] + 1 < cells[1], n + cells[0], 1)];
            for (_, other, axis) in neighbours.into_iter().filter(|(inside, ..)| *inside) {
                // Two half cells in series.
                let resistance = weave.resistance[axis] * f64::midpoint(factor[n], factor[other]);
                let conductance = step[1 - axis] / (step[axis] * resistance);
                entries.push(Triplet::new(n, n, conductance));
                entries.push(Triplet::new(other, other, conductance));
                entries.push(Triplet::new(other, n, -conductance));
            }
        }
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(count, count, &entries).ok()?;
        let green = matrix.sp_cholesky(Side::Lower).ok()?.solve(&Mat::<f64>::identity(count, count));
        let n = weave.electrodes.len();
        let mut sheet = Self {
            size: weave.size,
            cells,
            foam: weave.foam,
            green,
            reach: DMatrix::zeros(n, count),
            untouched: DMatrix::zeros(n, n),
        };
        let corners: Vec<[(usize, f64); 4]> = weave.electrodes.iter().map(|e| sheet.corners(*e)).collect();
        for (e, corners) in corners.iter().enumerate() {
            for cell in 0..count {
                sheet.reach[(e, cell)] = corners.iter().map(|(c, w)| w * sheet.green[(*c, cell)]).sum();
            }
        }
        let square = (weave.resistance[0] * weave.resistance[1]).sqrt() / std::f64::consts::TAU;
        // A source in a cell is as good as a disc of a fifth of it (Peaceman 1983).
        let disc = 0.2 * (step[0] * step[1]).sqrt();
        for (e, corners) in corners.iter().enumerate() {
            for other in 0..n {
                sheet.untouched[(other, e)] = corners.iter().map(|(c, w)| w * sheet.reach[(other, *c)]).sum();
            }
            let local: f64 = corners.iter().map(|(c, w)| w * factor[*c]).sum();
            sheet.untouched[(e, e)] += local * square * (disc / weave.radius).ln();
        }
        let finite = sheet.untouched.iter().all(|z| z.is_finite());
        finite.then_some(sheet)
    }

    /// Cells around a place \[m\], and how much each of them counts there.
    fn corners(&self, at: [f64; 2]) -> [(usize, f64); 4] {
        let [(i, s), (j, t)] = [0, 1].map(|k| {
            let along = (at[k] / self.size[k] + 0.5) * self.cells[k] as f64 - 0.5;
            let along = along.clamp(0.0, (self.cells[k] - 1) as f64);
            let cell = (along as usize).min(self.cells[k] - 2);
            (cell, along - cell as f64)
        });
        let number = |i: usize, j: usize| j * self.cells[0] + i;
        [
            (number(i, j), (1.0 - s) * (1.0 - t)),
            (number(i + 1, j), s * (1.0 - t)),
            (number(i, j + 1), (1.0 - s) * t),
            (number(i + 1, j + 1), s * t),
        ]
    }

    /// \[S\] that a round tip of this radius \[m\] adds to cells when it presses with `force` \[N\].
    fn pressed(&self, at: [f64; 2], radius: f64, force: f64) -> Vec<(usize, f64)> {
        let step = [0, 1].map(|k| self.size[k] / self.cells[k] as f64);
        let wide = radius + self.foam.cover;
        let area = std::f64::consts::PI * wide * wide;
        let pressure = force / area;
        let whole = self.foam.conductance * (pressure / self.foam.reference).powf(self.foam.exponent) * area;
        let deviation = (0.5 * wide).max(0.6 * step[0].max(step[1]));
        let mut shares = Vec::new();
        for n in 0..self.cells[0] * self.cells[1] {
            let cell = [n % self.cells[0], n / self.cells[0]];
            let off =
                [0, 1].map(|k| ((cell[k] as f64 + 0.5) * step[k] - self.size[k] / 2.0 - at[k]) / deviation);
            let far = off[0].hypot(off[1]);
            if far < BEYOND {
                shares.push((n, (-0.5 * far * far).exp()));
            }
        }
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.iter_mut().for_each(|(_, share)| *share *= whole / total.max(f64::MIN_POSITIVE));
        shares
    }

    /// \[Ω\] between electrodes under one tip; `None` where it does not press.
    pub fn between(&self, at: [f64; 2], radius: f64, force: f64) -> Option<DMatrix<f64>> {
        let loads = self.pressed(at, radius, force);
        if force <= 0.0 || loads.is_empty() {
            return None;
        }
        let m = loads.len();
        let mut inner = DMatrix::zeros(m, m);
        for (a, (i, conductance)) in loads.iter().enumerate() {
            for (b, (j, _)) in loads.iter().enumerate() {
                inner[(a, b)] = self.green[(*i, *j)];
            }
            inner[(a, a)] += 1.0 / conductance;
        }
        let n = self.untouched.nrows();
        let side = DMatrix::from_fn(n, m, |e, a| self.reach[(e, loads[a].0)]);
        let solved = inner.cholesky()?.solve(&side.transpose());
        Some(&self.untouched - side * solved)
    }

    /// \[Ω\] between electrodes where nothing touches.
    pub fn untouched(&self) -> &DMatrix<f64> {
        &self.untouched
    }
}

/// \[V\] at every electrode for a feed of each, injection by injection, from a source \[V\] behind a resistance \[Ω\].
pub(super) fn voltages(z: &DMatrix<f64>, (source, series): (f64, f64)) -> DVector<f64> {
    let n = z.nrows();
    DVector::from_fn(n * n, |i, _| {
        let (k, j) = (i / n, i % n);
        source * z[(j, k)] / (z[(k, k)] + series)
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::fabric) const FOAM: Foam =
        Foam { leak: 1e-7, conductance: 2e-3, reference: 5e4, exponent: 1.5, cover: 0.003 };
    const ELECTRODES: [[f64; 2]; 4] = [[-0.08, -0.08], [0.08, -0.08], [-0.08, 0.08], [0.08, 0.08]];

    fn sheet(resistance: [f64; 2], factor: &dyn Fn([f64; 2]) -> f64) -> Sheet {
        let weave = Weave {
            size: [0.24, 0.24],
            resistance,
            factor,
            electrodes: &ELECTRODES,
            radius: 0.005,
            foam: FOAM,
        };
        Sheet::new(&weave).unwrap()
    }

    #[test]
    fn resistances_are_reciprocal_and_symmetric_as_the_square_is() {
        let sheet = sheet([1e4; 2], &|_| 1.0);
        let z = sheet.between([0.02, -0.03], 0.01, 20.0).unwrap();
        for k in 0..4 {
            for j in 0..4 {
                approx::assert_relative_eq!(z[(j, k)], z[(k, j)], max_relative = 1e-5);
            }
        }
        let middle = sheet.between([0.0, 0.0], 0.01, 20.0).unwrap();
        approx::assert_relative_eq!(middle[(0, 1)], middle[(2, 3)], max_relative = 1e-4);
        // What leaks everywhere and through the press is all that leads to ground: a current into any electrode leaves there.
        let ground = 1.0 / (FOAM.leak * 0.24 * 0.24);
        let mean = sheet.untouched().iter().sum::<f64>() / 16.0;
        assert!((mean / ground - 1.0).abs() < 0.01, "{mean} for {ground}");
    }

    #[test]
    fn a_press_lowers_what_lies_near_it_most_and_a_tear_keeps_currents_apart() {
        let whole = sheet([1e4; 2], &|_| 1.0);
        let z = whole.between([0.07, 0.07], 0.01, 20.0).unwrap();
        assert!(z[(3, 3)] < z[(0, 0)] && z[(0, 0)] < whole.untouched()[(0, 0)], "{z}");
        let torn = sheet([1e4; 2], &|at| if at[0].abs() < 0.02 { 1000.0 } else { 1.0 });
        let (near, far) = (torn.untouched()[(0, 2)], torn.untouched()[(0, 1)]);
        let apart = whole.untouched()[(0, 2)] - whole.untouched()[(0, 1)];
        assert!(near - far > 1e3 * apart.abs().max(1.0), "{near} {far} {apart}");
    }
}
