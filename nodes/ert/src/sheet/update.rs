//! What contacts change of a sheet: a symmetric update of low rank (Sherman, Morrison, Woodbury).
//!
//! Contacts add conductance d_i to ground at k points. With G the Green's matrix of the untouched sheet at these points, W that
//! from the electrodes to them, and Z that between the electrodes,
//! Z' = Z − Yᵀ Y, where L Lᵀ = I + √d G √d and L Y = √d W. Nothing is divided by d, so that it may be 0.
//!
//! The potential at a point for a current into each electrode is (L⁻ᵀ Y)_i / √d_i, and the derivative of Z' by d_i is minus the
//! product of two of them.
//!
//! Cost: k²/2 look-ups, k³/6 + 28 k²/2 + 28² k multiplications for 28 electrodes.

use pulp::{Arch, Simd, WithSimd};

use super::{Green, Sheet};

/// A point that is touched, and the conductance \[S\] to ground that it has more than the untouched sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// Number of the point.
    pub node: usize,
    /// \[S\], not negative.
    pub conductance: f64,
}

/// Solves touched sheets, one after another, in the same memory.
#[derive(Debug, Clone, Default)]
pub struct Update {
    /// Points times (points + electrodes): the upper factor, and Y beside it.
    rows: Vec<f64>,
    roots: Vec<f64>,
    locations: Vec<[usize; 2]>,
    electrodes: usize,
}

impl Update {
    /// Resistances \[Ω\] between all electrodes of a touched sheet, written to `out`: at each for a current into each. The sheet's
    /// resistance per square is `scale` times what it was solved for.
    pub fn solve(&mut self, sheet: &Sheet, loads: &[Load], scale: f64, out: &mut [f64]) {
        let (k, n) = (loads.len(), sheet.electrodes);
        assert_eq!(out.len(), n * n);
        self.electrodes = n;
        self.roots.clear();
        self.roots.extend(loads.iter().map(|load| load.conductance.sqrt()));
        self.locations.clear();
        self.locations.extend(loads.iter().map(|load| sheet.grid.place(load.node)));
        let width = k + n;
        self.rows.resize(k * width, 0.0);
        for i in 0..k {
            let row = &mut self.rows[i * width..(i + 1) * width];
            let root = self.roots[i];
            let others = row[i..k].iter_mut().zip(&self.roots[i..]);
            match &sheet.green {
                Green::Mirrored(green) => {
                    for ((entry, other), location) in others.zip(&self.locations[i..]) {
                        let value = green.value(self.locations[i], *location);
                        *entry = root * other * (scale * value + sheet.mean);
                    }
                }
                Green::Dense(green) => {
                    for ((entry, other), load) in others.zip(&loads[i..]) {
                        let value = f64::from(green.value(loads[i].node, load.node));
                        *entry = root * other * (scale * value + sheet.mean);
                    }
                }
            }
            row[i] += 1.0;
            let reach = sheet.reach(loads[i].node);
            row[k..].iter_mut().zip(reach).for_each(|(r, g)| *r = root * (scale * g + sheet.mean));
        }
        out.iter_mut().zip(&sheet.transfer).for_each(|(o, z)| *o = scale * z + sheet.mean);
        Arch::new().dispatch(Reduce { rows: &mut self.rows, points: k, electrodes: n, out });
    }

    /// Potentials \[V\] of the touched points for a current of 1 A into each electrode, of the last sheet that was solved:
    /// electrodes of a point together. A point without conductance gets none.
    pub fn potentials(&self, out: &mut Vec<f64>) {
        let (k, n) = (self.roots.len(), self.electrodes);
        let width = k + n;
        out.clear();
        out.resize(k * n, 0.0);
        for i in (0..k).rev() {
            let row = &self.rows[i * width..(i + 1) * width];
            let (before, after) = out.split_at_mut((i + 1) * n);
            let x = &mut before[i * n..];
            x.copy_from_slice(&row[k..]);
            for (j, other) in after.chunks_exact(n).enumerate() {
                let u = row[i + 1 + j];
                x.iter_mut().zip(other).for_each(|(x, o)| *x -= u * o);
            }
            x.iter_mut().for_each(|x| *x /= row[i]);
        }
        for (x, root) in out.chunks_exact_mut(n.max(1)).zip(&self.roots) {
            x.iter_mut().for_each(|x| *x = if *root > 0.0 { *x / root } else { 0.0 });
        }
    }
}

/// Factors the rows, and subtracts Yᵀ Y from `out`.
struct Reduce<'a> {
    rows: &'a mut [f64],
    points: usize,
    electrodes: usize,
    out: &'a mut [f64],
}

impl WithSimd for Reduce<'_> {
    type Output = ();

    // Plain loops: inlined, they are compiled for the instructions of each kind of processor.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let (k, n) = (self.points, self.electrodes);
        let width = k + n;
        let mut first = 0;
        while first < k {
            // Four pivots at a time, so that each of the other rows is read and written once for all of them.
            let count = (k - first).min(4);
            for p in first..first + count {
                let (above, below) = self.rows.split_at_mut((p + 1) * width);
                let pivot = &mut above[p * width..];
                let root = 1.0 / pivot[p].sqrt();
                pivot[p..].iter_mut().for_each(|v| *v *= root);
                for (l, row) in below.chunks_exact_mut(width).enumerate().take(first + count - p - 1) {
                    let l = p + 1 + l;
                    let u = pivot[l];
                    row[l..].iter_mut().zip(&pivot[l..]).for_each(|(r, v)| *r -= u * v);
                }
            }
            let (above, below) = self.rows.split_at_mut((first + count) * width);
            let above = &above[first * width..];
            for (l, row) in below.chunks_exact_mut(width).enumerate() {
                let l = first + count + l;
                let row = &mut row[l..];
                if count == 4 {
                    let [a, b, c, d] = [0, 1, 2, 3].map(|p| &above[p * width + l..(p + 1) * width]);
                    let [ua, ub, uc, ud] = [a[0], b[0], c[0], d[0]];
                    for ((((r, a), b), c), d) in row.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                        *r -= ua * a + ub * b + uc * c + ud * d;
                    }
                } else {
                    for p in 0..count {
                        let pivot = &above[p * width + l..(p + 1) * width];
                        let u = pivot[0];
                        row.iter_mut().zip(pivot).for_each(|(r, v)| *r -= u * v);
                    }
                }
            }
            first += count;
        }
        for row in self.rows.chunks_exact(width.max(1)) {
            let y = &row[k..];
            for (out, a) in self.out.chunks_exact_mut(n).zip(y) {
                out.iter_mut().zip(y).for_each(|(o, b)| *o -= a * b);
            }
        }
    }
}
