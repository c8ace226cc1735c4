//! A resistive sheet over a leaking foam, and its Green's function.
//!
//! Problem: −∇·(σ∇φ) + g φ = Σ I_k δ_k on a rectangle without current through its border, where σ is the conductance per square
//! of the sheet and g \[S/m²\] what leaks through the foam to ground.
//!
//! Method: linear triangles on a regular grid with g lumped at its points. Right angles make the diagonals of the triangles carry
//! nothing, so that the stiffness matrix is the stencil of five points. A uniform sheet is solved in closed form: the grid is
//! continued by its mirror images to a torus, on which cosines diagonalise the matrix ([`Mirrored`]), so that an entry of the full
//! Green's matrix is four look-ups in a table of as many numbers as there are points. A sheet that is not uniform is factored
//! (sparse Cholesky) and its Green's matrix kept whole in single precision (`Dense`).
//!
//! A point source at a grid point acts like a disc of the radius [`Grid::equivalent_radius`] (Peaceman, SPE Journal 1983).
//!
//! The mean of the potential is apart from the rest of it: 1 over the leak of the whole sheet, far larger than all differences.
//! Every Green's function here is without that mean, which [`Sheet::mean`] adds.
//!
//! Assumptions: the sheet is thin, currents in the foam cross it straight. Cost: a uniform sheet takes milliseconds and as many
//! numbers as points; another one some seconds and half the square of that number.

mod dense;
mod update;

use std::f64::consts::{PI, TAU};

use dermis_mechanics::MechanicsError;

pub use dense::{Conductors, Factored};
pub use update::{Load, Update};

use dense::Dense;

/// A regular grid of points over a rectangle about the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// \[m\] along x and y.
    pub size: [f64; 2],
    /// Cells along x and y.
    pub cells: [usize; 2],
}

impl Grid {
    /// Points along x and y.
    #[must_use]
    pub fn points(&self) -> [usize; 2] {
        self.cells.map(|n| n + 1)
    }

    /// All points.
    #[must_use]
    pub fn count(&self) -> usize {
        self.points().into_iter().product()
    }

    /// \[m\] of a cell.
    #[must_use]
    pub fn step(&self) -> [f64; 2] {
        [0, 1].map(|k| self.size[k] / self.cells[k] as f64)
    }

    /// Number of the point in this column and row.
    #[must_use]
    pub fn number(&self, [i, j]: [usize; 2]) -> usize {
        j * (self.cells[0] + 1) + i
    }

    /// Column and row of a point.
    #[must_use]
    pub fn place(&self, node: usize) -> [usize; 2] {
        let width = self.cells[0] + 1;
        [node % width, node / width]
    }

    /// \[m\] where a point is.
    #[must_use]
    pub fn position(&self, node: usize) -> [f64; 2] {
        let (place, step) = (self.place(node), self.step());
        [0, 1].map(|k| place[k] as f64 * step[k] - self.size[k] / 2.0)
    }

    /// \[m²\] around a point: half a cell at an edge, a quarter at a corner.
    #[must_use]
    pub fn area(&self, node: usize) -> f64 {
        let (place, step) = (self.place(node), self.step());
        let share = |k: usize| if place[k] == 0 || place[k] == self.cells[k] { 0.5 } else { 1.0 };
        share(0) * share(1) * step[0] * step[1]
    }

    /// Corners of the cell around a place \[m\], and how much each of them counts there; what lies outside is moved to the border.
    #[must_use]
    pub fn weights(&self, at: [f64; 2]) -> [(usize, f64); 4] {
        let step = self.step();
        let [(i, s), (j, t)] = [0, 1].map(|k| {
            let along = ((at[k] + self.size[k] / 2.0) / step[k]).clamp(0.0, self.cells[k] as f64);
            let cell = (along as usize).min(self.cells[k] - 1);
            (cell, along - cell as f64)
        });
        [
            (self.number([i, j]), (1.0 - s) * (1.0 - t)),
            (self.number([i + 1, j]), s * (1.0 - t)),
            (self.number([i, j + 1]), (1.0 - s) * t),
            (self.number([i + 1, j + 1]), s * t),
        ]
    }

    /// \[m\] radius of the disc that has the potential of a source at a grid point, for resistances \[Ω per square\] along x and y
    /// (Peaceman 1983, equation 15; 0.1985 of the step for square cells).
    #[must_use]
    pub fn equivalent_radius(&self, resistance: [f64; 2]) -> f64 {
        // e^-γ / 2, γ Euler's constant.
        const SHARE: f64 = 0.280_729_483_6;
        let [hx, hy] = self.step();
        let ratio = (resistance[0] / resistance[1]).sqrt();
        SHARE * (ratio * hx * hx + hy * hy / ratio).sqrt() / (ratio.sqrt() + 1.0 / ratio.sqrt())
    }
}

/// Green's function of a uniform sheet, in closed form.
///
/// P(dx, dy) is that of the torus of the grid and its mirror images; the one of the grid is the sum of P over the four images of
/// the source. Points of the border have fewer images, each of which counts as often as it coincides.
#[derive(Debug, Clone)]
pub struct Mirrored {
    cells: [usize; 2],
    /// P \[Ω\] without its mean, for distances up to the cells along both axes.
    table: Vec<f64>,
}

impl Mirrored {
    /// Of a sheet with these resistances \[Ω per square\] along x and y, over a leak \[S/m²\].
    #[must_use]
    pub fn new(grid: &Grid, resistance: [f64; 2], leak: f64) -> Self {
        let [hx, hy] = grid.step();
        let [nx, ny] = grid.cells;
        let conductance = [hy / (hx * resistance[0]), hx / (hy * resistance[1])];
        let stiff = |k: usize, mode: usize, n: usize| {
            2.0 * conductance[k] * (1.0 - (PI * mode as f64 / n as f64).cos())
        };
        // The first and the last cosine stand once in a period of twice the cells, the others as two of the same frequency.
        let times = |mode: usize, n: usize| if mode == 0 || mode == n { 1.0 } else { 2.0 };
        let cosines =
            |n: usize| -> Vec<f64> { (0..2 * n).map(|k| (TAU * k as f64 / (2 * n) as f64).cos()).collect() };
        let [cx, cy] = [cosines(nx), cosines(ny)];
        let scale = 1.0 / (4.0 * (nx * ny) as f64);
        let mut table = vec![0.0; (nx + 1) * (ny + 1)];
        let mut column = vec![0.0; ny + 1];
        for p in 0..=nx {
            column.fill(0.0);
            for q in 0..=ny {
                if p == 0 && q == 0 {
                    continue;
                }
                let value = scale * times(p, nx) * times(q, ny)
                    / (stiff(0, p, nx) + stiff(1, q, ny) + leak * hx * hy);
                column.iter_mut().enumerate().for_each(|(dy, c)| *c += value * cy[(q * dy) % (2 * ny)]);
            }
            for (dy, value) in column.iter().enumerate() {
                let row = &mut table[dy * (nx + 1)..(dy + 1) * (nx + 1)];
                row.iter_mut().enumerate().for_each(|(dx, t)| *t += value * cx[(p * dx) % (2 * nx)]);
            }
        }
        Self { cells: grid.cells, table }
    }

    /// P at this distance, in cells.
    fn torus(&self, dx: usize, dy: usize) -> f64 {
        self.table[dy * (self.cells[0] + 1) + dx]
    }

    /// \[Ω\] between two points so many cells apart, on a sheet without borders.
    fn between(&self, dx: usize, dy: usize) -> f64 {
        2.0 * (self.torus(0, 0) - self.torus(dx, dy))
    }

    /// \[Ω\] potential at a point (column and row) for a current of 1 A at another, without the mean.
    #[inline]
    fn value(&self, [i, j]: [usize; 2], [k, l]: [usize; 2]) -> f64 {
        let fold = |a: usize, b: usize, n: usize| {
            let sum = a + b;
            (a.abs_diff(b), if sum > n { 2 * n - sum } else { sum })
        };
        let (dx, sx) = fold(i, k, self.cells[0]);
        let (dy, sy) = fold(j, l, self.cells[1]);
        self.torus(dx, dy) + self.torus(sx, dy) + self.torus(dx, sy) + self.torus(sx, sy)
    }
}

/// What a sheet is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Where its points are.
    pub grid: Grid,
    /// \[Ω per square\] along x and y.
    pub resistance: [f64; 2],
    /// \[S/m²\] through the foam, everywhere.
    pub leak: f64,
    /// Where it is not uniform: factor of the resistance at every point, and conductance \[S\] to ground at every point besides
    /// the leak.
    pub field: Option<(Vec<f64>, Vec<f64>)>,
}

/// An electrode on a sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Electrode {
    /// \[m\] in the plane of the sheet.
    pub at: [f64; 2],
    /// \[m\] of its disc.
    pub radius: f64,
}

#[derive(Debug)]
enum Green {
    Mirrored(Mirrored),
    Dense(Dense),
}

/// A sheet with electrodes.
#[derive(Debug)]
pub struct Sheet {
    grid: Grid,
    green: Green,
    /// \[Ω\] that every potential has in common.
    mean: f64,
    electrodes: usize,
    /// \[Ω\] at every point for a current into every electrode, without the mean: electrodes of a point together.
    reach: Vec<f64>,
    /// \[Ω\] at every electrode for a current into every electrode, without the mean.
    transfer: Vec<f64>,
}

impl Sheet {
    /// Solves a sheet.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Singular`] where numbers of the field are none.
    pub fn new(design: &Design, electrodes: &[Electrode]) -> Result<Self, MechanicsError> {
        let grid = design.grid;
        let uniform = Mirrored::new(&grid, design.resistance, design.leak);
        let area: f64 = grid.size.iter().product();
        let spread: Vec<[(usize, f64); 4]> = electrodes.iter().map(|e| grid.weights(e.at)).collect();
        // What the grid makes of a disc: its own four corners, and the disc that a point is.
        let local = (design.resistance[0] * design.resistance[1]).sqrt() / TAU;
        let point = grid.equivalent_radius(design.resistance);
        let own: Vec<f64> = electrodes
            .iter()
            .zip(&spread)
            .map(|(electrode, corners)| {
                let factor = design
                    .field
                    .as_ref()
                    .map_or(1.0, |(field, _)| corners.iter().map(|(node, w)| w * field[*node]).sum::<f64>());
                factor * (apart(&grid, &uniform, corners) + local * (point / electrode.radius).ln())
            })
            .collect();
        let n = electrodes.len();
        let (green, mean, reach) = match &design.field {
            None => {
                let mut reach = Vec::with_capacity(grid.count() * n);
                for node in 0..grid.count() {
                    let at = grid.place(node);
                    reach.extend(spread.iter().map(|corners| {
                        corners.iter().map(|(c, w)| w * uniform.value(at, grid.place(*c))).sum::<f64>()
                    }));
                }
                (Green::Mirrored(uniform), 1.0 / (design.leak * area), reach)
            }
            Some((factors, ground)) => {
                let (dense, mean) = Dense::new(design, factors, ground)?;
                let mut reach = Vec::with_capacity(grid.count() * n);
                for node in 0..grid.count() {
                    reach.extend(spread.iter().map(|corners| {
                        corners.iter().map(|(c, w)| w * f64::from(dense.value(node, *c))).sum::<f64>()
                    }));
                }
                (Green::Dense(dense), mean, reach)
            }
        };
        let mut transfer = vec![0.0; n * n];
        for (j, corners) in spread.iter().enumerate() {
            for k in 0..n {
                transfer[k * n + j] = corners.iter().map(|(c, w)| w * reach[c * n + k]).sum();
            }
            transfer[j * n + j] += own[j];
        }
        Ok(Self { grid, green, mean, electrodes: n, reach, transfer })
    }

    /// Its grid.
    #[must_use]
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// How many electrodes it has.
    #[must_use]
    pub fn electrodes(&self) -> usize {
        self.electrodes
    }

    /// \[Ω\] that every potential has in common.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// \[Ω\] at each electrode for a current into each electrode where nothing touches, without the mean.
    #[must_use]
    pub fn transfer(&self) -> &[f64] {
        &self.transfer
    }

    /// \[Ω\] at a point for a current of 1 A into each electrode, without the mean.
    fn reach(&self, node: usize) -> &[f64] {
        &self.reach[node * self.electrodes..(node + 1) * self.electrodes]
    }

    /// \[Ω\] potential at a point for a current of 1 A at another, without the mean.
    #[must_use]
    pub fn green(&self, a: usize, b: usize) -> f64 {
        match &self.green {
            Green::Mirrored(mirrored) => mirrored.value(self.grid.place(a), self.grid.place(b)),
            Green::Dense(dense) => f64::from(dense.value(a, b)),
        }
    }
}

/// \[Ω\] by which a source that is shared by the corners of a cell has less potential over them than one at a single point.
fn apart(grid: &Grid, uniform: &Mirrored, corners: &[(usize, f64); 4]) -> f64 {
    let mut sum = 0.0;
    for (a, (i, wi)) in corners.iter().enumerate() {
        for (j, wj) in &corners[..a] {
            let ([ix, iy], [jx, jy]) = (grid.place(*i), grid.place(*j));
            sum += wi * wj * uniform.between(ix.abs_diff(jx), iy.abs_diff(jy));
        }
    }
    sum
}

#[cfg(test)]
mod tests;
