//! From resistances between electrodes to the voltages of a frame.
//!
//! A source V_s feeds electrode k through the resistance R_s of source and multiplexer; every electrode j is read, k included.
//! With Z the resistances of the panel, V_jk = V_s Z_jk / (Z_kk + z_k + R_s): electrodes that are only read carry no current, so
//! that just the one that is fed shows its contact impedance z_k, and reads V_kk = V_s (Z_kk + z_k) / (Z_kk + z_k + R_s).
//! What is wrong with wires and multiplexer comes after that, in the order of the fields.

/// How a frame is made.
#[derive(Debug, Clone, PartialEq)]
pub struct Drive {
    /// \[V\].
    pub source: f64,
    /// \[Ω\] of source and multiplexer.
    pub series: f64,
    /// \[Ω\] of each electrode's contact with the sheet.
    pub impedance: Vec<f64>,
    /// \[S\] to ground of each electrode's wire.
    pub short: Vec<f64>,
    /// \[Ω\] from the top layer to ground.
    pub ground: f64,
    /// Share of its voltage that each electrode's wire passes on: 1 where it is whole.
    pub whole: Vec<f64>,
    /// Share of the way to V_s by which switches that are off pull every reading.
    pub leakage: f64,
    /// Share of the reading of the injection before that has not settled.
    pub unsettled: f64,
    /// Electrode that each wire really leads to, and the share in which it does.
    pub exchanged: Option<(Vec<usize>, f64)>,
}

impl Drive {
    /// One without faults.
    #[must_use]
    pub fn new(source: f64, series: f64, electrodes: usize) -> Self {
        Self {
            source,
            series,
            impedance: vec![0.0; electrodes],
            short: vec![0.0; electrodes],
            ground: 0.0,
            whole: vec![1.0; electrodes],
            leakage: 0.0,
            unsettled: 0.0,
            exchanged: None,
        }
    }

    /// Voltages of a frame, injection by injection, for resistances \[Ω\] `z` between electrodes, which are changed to those that
    /// the wires see.
    pub fn read(&self, z: &mut [f64], out: &mut [f64]) {
        let n = self.impedance.len();
        for (e, &short) in self.short.iter().enumerate().filter(|(_, s)| **s > 0.0) {
            let own: Vec<f64> = z[e * n..(e + 1) * n].to_vec();
            let share = short / (1.0 + short * own[e]);
            for (row, a) in z.chunks_exact_mut(n).zip(&own) {
                row.iter_mut().zip(&own).for_each(|(z, b)| *z -= share * a * b);
            }
        }
        if self.ground > 0.0 {
            z.iter_mut().for_each(|z| *z += self.ground);
        }
        for (k, (row, out)) in z.chunks_exact(n).zip(out.chunks_exact_mut(n)).enumerate() {
            let fed = row[k] + self.impedance[k];
            let current = self.source / (fed + self.series);
            out.iter_mut().zip(row).for_each(|(v, z)| *v = z * current);
            out[k] = fed * current;
        }
        self.wires(out, self.leakage * self.source);
    }

    /// Change of the voltages for a change `dz` of the resistances; `z` as [`read`](Self::read) got them.
    pub fn change(&self, z: &[f64], dz: &mut [f64], out: &mut [f64]) {
        let n = self.impedance.len();
        let mut z = z.to_vec();
        for (e, &short) in self.short.iter().enumerate().filter(|(_, s)| **s > 0.0) {
            let (own, change) = (z[e * n..(e + 1) * n].to_vec(), dz[e * n..(e + 1) * n].to_vec());
            let share = short / (1.0 + short * own[e]);
            let less = share * share * change[e];
            for j in 0..n {
                for k in 0..n {
                    dz[j * n + k] +=
                        less * own[j] * own[k] - share * (change[j] * own[k] + own[j] * change[k]);
                    z[j * n + k] -= share * own[j] * own[k];
                }
            }
        }
        if self.ground > 0.0 {
            z.iter_mut().for_each(|z| *z += self.ground);
        }
        for k in 0..n {
            let (row, change) = (&z[k * n..(k + 1) * n], &dz[k * n..(k + 1) * n]);
            let all = row[k] + self.impedance[k] + self.series;
            let (per, less) = (self.source / all, self.source * change[k] / (all * all));
            let out = &mut out[k * n..(k + 1) * n];
            for ((v, z), dz) in out.iter_mut().zip(row).zip(change) {
                *v = dz * per - z * less;
            }
            out[k] = change[k] * per - (row[k] + self.impedance[k]) * less;
        }
        self.wires(out, 0.0);
    }

    /// What wires and multiplexer make of voltages, or of changes of them, where switches that are off add `pull`.
    fn wires(&self, out: &mut [f64], pull: f64) {
        let n = self.impedance.len();
        if self.whole.iter().any(|w| *w != 1.0) {
            for (row, fed) in out.chunks_exact_mut(n).zip(&self.whole) {
                row.iter_mut().zip(&self.whole).for_each(|(v, read)| *v *= fed * read);
            }
        }
        if self.leakage > 0.0 {
            out.iter_mut().for_each(|v| *v = *v * (1.0 - self.leakage) + pull);
        }
        if self.unsettled > 0.0 {
            // The last injection of the frame before is taken to be that of this one.
            let mut before = out[(n - 1) * n..].to_vec();
            for row in out.chunks_exact_mut(n) {
                for (v, before) in row.iter_mut().zip(&mut before) {
                    let settled = *v;
                    *v += self.unsettled * (*before - settled);
                    *before = settled;
                }
            }
        }
        if let Some((really, share)) = &self.exchanged {
            let own = out.to_vec();
            for (k, row) in out.chunks_exact_mut(n).enumerate() {
                for (j, v) in row.iter_mut().enumerate() {
                    *v += share * (own[really[k] * n + really[j]] - *v);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    /// Three electrodes with every fault at once.
    fn faulty() -> Drive {
        Drive {
            impedance: vec![100.0, 900.0, 10.0],
            short: vec![0.0, 1e-5, 0.0],
            ground: 50.0,
            whole: vec![1.0, 0.5, 0.9],
            leakage: 0.01,
            unsettled: 0.05,
            exchanged: Some((vec![0, 2, 1], 0.3)),
            ..Drive::new(3.0, 220.0, 3)
        }
    }

    const Z: [f64; 9] = [50e3, 30e3, 20e3, 30e3, 60e3, 25e3, 20e3, 25e3, 70e3];

    #[test]
    fn an_untouched_panel_reads_the_source() {
        let drive = Drive::new(3.0, 0.0, 3);
        let mut out = [0.0; 9];
        drive.read(&mut [1e9; 9], &mut out);
        out.iter().for_each(|v| assert_relative_eq!(*v, 3.0));
    }

    #[test]
    fn changes_are_those_of_the_readings() {
        let drive = faulty();
        let dz = [3.0, -1.0, 2.0, -1.0, 4.0, 0.5, 2.0, 0.5, -2.0];
        let step = 1e-2;
        let read = |by: f64| {
            let mut z: Vec<f64> = Z.iter().zip(&dz).map(|(z, d)| z + by * d).collect();
            let mut out = [0.0; 9];
            drive.read(&mut z, &mut out);
            out
        };
        let (more, less) = (read(step), read(-step));
        let mut found = [0.0; 9];
        drive.change(&Z, &mut dz.clone(), &mut found);
        for k in 0..9 {
            let wanted = (more[k] - less[k]) / (2.0 * step);
            assert!((found[k] - wanted).abs() < 1e-9, "{k}: {} for {wanted}", found[k]);
        }
    }

    #[test]
    fn a_cycle_of_three_electrodes_is_reciprocal() {
        let drive = Drive { impedance: vec![100.0, 900.0, 10.0], ..Drive::new(3.0, 220.0, 3) };
        let mut v = [0.0; 9];
        drive.read(&mut Z.clone(), &mut v);
        assert_relative_eq!(v[1] * v[5] * v[6], v[3] * v[7] * v[2], max_relative = 1e-12);
    }
}
