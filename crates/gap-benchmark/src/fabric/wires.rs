//! Electrodes, wires, multiplexer and converter as a network with as many ports as electrodes.
//!
//! The voltages of a frame are turned into resistances between electrodes, Z_kk = R V_kk / (V_s − V_kk) and Z_jk = V_jk (Z_kk + R)
//! / V_s for a source V_s behind R that feeds one electrode k at a time. What is wrong with seams, threads, ground and switches
//! changes that network (superposition and Thévenin; rank-one changes after Sherman and Morrison 1950), and the changed one is fed
//! again. What is wrong behind the multiplexer changes voltages.

use nalgebra::{DMatrix, DVector};
use rand::Rng;

use crate::cause::{Cause, Causes};
use crate::script::Script;

/// \[s\] of a break between frames over which nothing is remembered.
const BREAK: f64 = 1.0;
/// \[s\] that seams are as good as new, and in which their resistance reaches its size.
const LOOSENING: [f64; 2] = [60.0, 3600.0];
/// \[s\] in which a reference settles, and the shares of both.
const SETTLES: [(f64, f64); 2] = [(80.0, 0.7), (700.0, 0.3)];
/// How near to its source a voltage may come, as a share of it: where nothing flows, a resistance has no end.
const APART: f64 = 1e-12;

/// How a panel is fed and read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drive {
    /// \[V\].
    pub source: f64,
    /// \[Ω\] of source and multiplexer.
    pub series: f64,
    /// \[V\] of the converter's largest count.
    pub full_scale: f64,
    /// \[V\] of a count.
    pub count: f64,
    /// Electrodes.
    pub electrodes: usize,
}

/// What of the network is not as designed.
struct Faults {
    /// \[Ω\] of each seam, from the start.
    seams: Vec<f64>,
    /// \[Ω\] of each seam after an hour.
    loosening: Vec<f64>,
    /// Electrode and conductance \[S\] of a thread to the top layer.
    thread: Option<(usize, f64)>,
    /// \[Ω\] from the top layer to ground.
    ground: f64,
    /// \[S\] of a switch that is off.
    off: f64,
}

impl Faults {
    fn of(causes: &Causes, electrodes: usize) -> Option<Self> {
        let seams = |id: &str| {
            causes.get(id).map_or_else(
                || vec![0.0; electrodes],
                |(cause, size)| cause.normals(electrodes).iter().map(|n| size * (0.8 * n).exp()).collect(),
            )
        };
        let thread = causes.get("touching-thread").map(|(cause, size)| (one(cause, electrodes), size));
        let found = Self {
            seams: seams("poor-seams"),
            loosening: seams("loosening-seams"),
            thread,
            ground: causes.size("long-ground"),
            off: causes.size("leaking-switches"),
        };
        let ids = ["poor-seams", "loosening-seams", "touching-thread", "long-ground", "leaking-switches"];
        ids.iter().any(|id| causes.get(id).is_some()).then_some(found)
    }

    /// \[Ω\] of the network's ports that wires see at `time` \[s\].
    fn change(&self, z: &mut DMatrix<f64>, time: f64) {
        if let Some((e, conductance)) = self.thread {
            let own = z.column(e).into_owned();
            let share = conductance / (1.0 + conductance * own[e]);
            *z -= &own * own.transpose() * share;
        }
        z.add_scalar_mut(self.ground);
        let [good, hour] = LOOSENING;
        let late = (time / good).ln_1p() / (hour / good).ln_1p();
        for (e, (seam, loosening)) in self.seams.iter().zip(&self.loosening).enumerate() {
            z[(e, e)] += seam + loosening * late;
        }
    }
}

/// The electrode that a cause sits on.
pub(super) fn one(cause: &Cause, electrodes: usize) -> usize {
    cause.rng().random_range(0..electrodes.max(1))
}

/// Two electrodes.
fn two(cause: &Cause, electrodes: usize) -> [usize; 2] {
    let first = one(cause, electrodes);
    let mut rng = cause.rng();
    rng.set_stream(2);
    [first, (first + 1 + rng.random_range(0..electrodes.max(2) - 1)) % electrodes]
}

impl Drive {
    /// \[Ω\] between electrodes, of the voltages of a frame.
    fn resistances(&self, row: &[f64]) -> DMatrix<f64> {
        let n = self.electrodes;
        let mut z = DMatrix::zeros(n, n);
        for k in 0..n {
            let own = row[k * n + k];
            let fed = self.series * own / (self.source - own).max(APART * self.source);
            for j in 0..n {
                z[(j, k)] = row[k * n + j] * (fed + self.series) / self.source;
            }
        }
        z
    }

    /// \[V\] of a network whose switches let `off` \[S\] through from the source to every electrode that is not fed.
    fn feed(&self, z: &DMatrix<f64>, off: f64, row: &mut [f64]) {
        let n = self.electrodes;
        if off <= 0.0 {
            row.copy_from_slice(super::sheet::voltages(z, (self.source, self.series)).as_slice());
            return;
        }
        // (Z⁻¹ + G + δ e_k e_kᵀ) V = V_s (G 1 + δ e_k), δ = 1/R − G, with A = (Z⁻¹ + G)⁻¹ = Z (1 + G Z)⁻¹.
        let inner = DMatrix::identity(n, n) + z * off;
        let Some(inverse) = inner.try_inverse() else { return };
        let a = z * inverse;
        let all = &a * DVector::from_element(n, 1.0);
        let more = 1.0 / self.series.max(1e-3) - off;
        for k in 0..n {
            let own = (off * all[k] + more * a[(k, k)]) / (1.0 + more * a[(k, k)]);
            for j in 0..n {
                row[k * n + j] = self.source * (off * all[j] + more * a[(j, k)] * (1.0 - own));
            }
        }
    }

    /// Changes voltages \[V\], frame by frame, as wires and multiplexer do.
    pub fn apply(&self, causes: &Causes, script: &Script, readings: &mut [f64]) {
        let channels = self.electrodes * self.electrodes;
        if let Some(faults) = Faults::of(causes, self.electrodes) {
            for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
                let mut z = self.resistances(row);
                faults.change(&mut z, instant.time);
                self.feed(&z, faults.off, row);
            }
        }
        if let Some((_, duration)) = causes.get("slow-scan") {
            let rows = self.electrodes as f64;
            let early = |c: usize| duration * (1.0 - (c / self.electrodes) as f64 / rows);
            earlier(script, channels, early, readings);
        }
        self.charging(causes, script, readings);
        self.connections(causes, readings);
        if let Some((_, start)) = causes.get("sinking-reference") {
            for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
                let left: f64 =
                    SETTLES.iter().map(|(time, share)| share * (-instant.time / time).exp()).sum();
                row.iter_mut().for_each(|v| *v /= 1.0 + start * left);
            }
        }
    }

    /// Each wire keeps a share of the injection before.
    fn charging(&self, causes: &Causes, script: &Script, readings: &mut [f64]) {
        let Some((cause, size)) = causes.get("charging-wires") else { return };
        let n = self.electrodes;
        let shares: Vec<f64> = cause.normals(n).iter().map(|x| (size * (0.4 * x).exp()).min(0.95)).collect();
        let mut held: Option<Vec<f64>> = None;
        let mut last = f64::NEG_INFINITY;
        for (frame, instant) in readings.chunks_mut(n * n).zip(&script.instants) {
            // After a break the panel has gone on being scanned.
            let fresh = instant.time - last > BREAK;
            last = instant.time;
            let mut before = match held.take() {
                Some(held) if !fresh => held,
                _ => frame[(n - 1) * n..].to_vec(),
            };
            for row in frame.chunks_mut(n) {
                for ((v, before), share) in row.iter_mut().zip(&mut before).zip(&shares) {
                    *v += share * (*before - *v);
                    *before = *v;
                }
            }
            held = Some(before);
        }
    }

    /// Wires that are broken, or lead elsewhere.
    fn connections(&self, causes: &Causes, readings: &mut [f64]) {
        let n = self.electrodes;
        if let Some((cause, loss)) = causes.get("open-wire") {
            let e = one(cause, n);
            for frame in readings.chunks_mut(n * n) {
                frame[e * n..(e + 1) * n].iter_mut().for_each(|v| *v *= 1.0 - loss);
                for k in 0..n {
                    let held = frame[k * n + (e + n - 1) % n];
                    frame[k * n + e] += loss * (held - frame[k * n + e]);
                }
            }
        }
        if let Some((cause, _)) = causes.get("swapped-wires") {
            let [a, b] = two(cause, n);
            for frame in readings.chunks_mut(n * n) {
                (0..n).for_each(|j| frame.swap(a * n + j, b * n + j));
                (0..n).for_each(|k| frame.swap(k * n + a, k * n + b));
            }
        }
    }

    /// Counts of the converter, in volts.
    pub fn convert(&self, readings: &mut [f64]) {
        for v in readings {
            *v = (*v / self.count).round().clamp(0.0, (self.full_scale / self.count).floor()) * self.count;
        }
    }
}

/// Every channel as it was some time \[s\] before its stamp, between the frames that there are.
pub(crate) fn earlier(script: &Script, channels: usize, by: impl Fn(usize) -> f64, readings: &mut [f64]) {
    let clean = readings.to_vec();
    for (t, row) in readings.chunks_mut(channels).enumerate() {
        for (c, value) in row.iter_mut().enumerate() {
            let wanted = script.instants[t].time - by(c);
            let mut later = t;
            while later > 0
                && script.instants[later - 1].time > wanted
                && script.instants[later].time - script.instants[later - 1].time < BREAK
            {
                later -= 1;
            }
            let at = |t: usize| clean[t * channels + c];
            let before = later.checked_sub(1).map(|b| script.instants[b].time);
            *value = match before {
                Some(time)
                    if script.instants[later].time - time < BREAK && wanted < script.instants[later].time =>
                {
                    let part = (wanted - time) / (script.instants[later].time - time);
                    at(later - 1) + (at(later) - at(later - 1)) * part
                }
                _ => at(later),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use dermis_testbed::GroundTruth;

    use super::*;
    use crate::fabric::CAUSES;
    use crate::script::Instant;

    const DRIVE: Drive =
        Drive { source: 3.0, series: 100.0, full_scale: 3.3, count: 3.3 / 4096.0, electrodes: 3 };
    const Z: [f64; 9] = [50e3, 30e3, 20e3, 30e3, 60e3, 25e3, 20e3, 25e3, 70e3];

    fn script(count: usize) -> Script {
        let instant =
            |i: usize| Instant { time: 0.04 * i as f64, session: 0, moment: GroundTruth::default() };
        Script { step: 0.04, instants: (0..count).map(instant).collect(), quiet: 0 }
    }

    fn causes(id: &str, strength: f64) -> Causes {
        Causes::new(CAUSES, &[Cause { id: id.to_owned(), strength, seed: 4 }]).unwrap()
    }

    fn voltages(z: &DMatrix<f64>) -> Vec<f64> {
        let mut row = vec![0.0; 9];
        DRIVE.feed(z, 0.0, &mut row);
        row
    }

    #[test]
    fn voltages_and_resistances_go_both_ways() {
        let z = DMatrix::from_row_slice(3, 3, &Z);
        let back = DRIVE.resistances(&voltages(&z));
        approx::assert_relative_eq!(back, z, max_relative = 1e-8);
    }

    #[test]
    fn a_leaking_switch_solves_the_network() {
        let z = DMatrix::from_row_slice(3, 3, &Z);
        let off = 1e-6;
        let mut row = vec![0.0; 9];
        DRIVE.feed(&z, off, &mut row);
        // Currents into the sheet are those that come through source and switches.
        for k in 0..3 {
            let v = DVector::from_row_slice(&row[k * 3..(k + 1) * 3]);
            let current = DVector::from_fn(3, |j, _| {
                (DRIVE.source - v[j]) * if j == k { 1.0 / DRIVE.series } else { off }
            });
            approx::assert_relative_eq!(&z * current, v, max_relative = 1e-9);
        }
    }

    #[test]
    fn a_thread_is_a_resistor_to_ground() {
        let mut z = DMatrix::from_row_slice(3, 3, &Z);
        let faults = Faults {
            seams: vec![0.0; 3],
            loosening: vec![0.0; 3],
            thread: Some((1, 1e-4)),
            ground: 0.0,
            off: 0.0,
        };
        faults.change(&mut z, 0.0);
        // Of the electrode itself: 60 kΩ beside 10 kΩ.
        approx::assert_relative_eq!(z[(1, 1)], 60e3 * 10e3 / 70e3, max_relative = 1e-9);
    }

    #[test]
    fn faults_of_wires_do_what_they_say() {
        let clean = voltages(&DMatrix::from_row_slice(3, 3, &Z));
        let apply = |id: &str, strength: f64| {
            let mut readings = [clean.clone(), clean.clone()].concat();
            DRIVE.apply(&causes(id, strength), &script(2), &mut readings);
            readings
        };
        let open = apply("open-wire", 1.0);
        let fed = (0..3).find(|k| open[k * 3..(k + 1) * 3].iter().all(|v| *v == 0.0)).unwrap();
        let (other, before) = ((fed + 1) % 3, (fed + 2) % 3);
        approx::assert_relative_eq!(open[other * 3 + fed], open[other * 3 + before], max_relative = 1e-9);
        let swapped = apply("swapped-wires", 0.2);
        assert_ne!(swapped[..9], clean[..]);
        let mut sorted = [swapped[..9].to_vec(), clean.clone()];
        sorted.iter_mut().for_each(|v| v.sort_by(f64::total_cmp));
        assert_eq!(sorted[0], sorted[1]);
        let sinking = apply("sinking-reference", 1.0);
        assert!((sinking[0] / clean[0] - 1.0).abs() > 0.04, "{} {}", sinking[0], clean[0]);
        for id in ["poor-seams", "long-ground", "leaking-switches", "touching-thread", "charging-wires"] {
            assert!(
                apply(id, 1.0).iter().zip(clean.iter().cycle()).any(|(a, b)| (a - b).abs() > 1e-3),
                "{id}"
            );
        }
    }

    #[test]
    fn a_scan_reads_what_was() {
        // A ramp of 1 V a frame, 40 ms: 100 ms ago it was 2.5 V lower.
        let mut readings: Vec<f64> = (0..10).map(f64::from).collect();
        earlier(&script(10), 1, |_| 0.1, &mut readings);
        approx::assert_relative_eq!(readings[9], 6.5, max_relative = 1e-9);
        assert_eq!(readings[0], 0.0, "nothing is known of before the start");
    }

    #[test]
    fn counts_end_where_the_converter_does() {
        let mut readings = vec![-1.0, 1.0, 9.0];
        DRIVE.convert(&mut readings);
        assert!(
            readings[0] == 0.0 && (readings[1] - 1.0).abs() < DRIVE.count && readings[2] <= 3.3,
            "{readings:?}"
        );
    }
}
