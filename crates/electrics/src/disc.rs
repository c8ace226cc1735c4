//! The analytic solution for a uniform disc.
//!
//! Problem: what a mesh is checked against. Method: the average-gap model, in which every electrode passes an even current density and
//! reads the mean potential under it, as a Fourier series on the rim (K. S. Cheng, D. Isaacson, J. C. Newell, D. G. Gisser, *Electrode
//! models for electric current computed tomography*, IEEE Trans. Biomed. Eng. 36, 1989). The complete electrode model becomes this one as
//! its contact impedance grows, because the density under an electrode becomes even. Assumptions: a disc of one conductance. Cost: one
//! sum of [`TERMS`] for each pair of electrodes.

use std::f64::consts::PI;

/// Terms of the series; they fall with the third power of their number.
const TERMS: usize = 4000;

/// Mean potentials \[V\] under the electrodes of a disc for currents \[A\] through them, but for a constant. Electrodes are evenly spaced,
/// the first at angle 0, and cover `share` of the rim; `conductance` is in S per square.
#[must_use]
pub fn potentials(currents: &[f64], share: f64, conductance: f64) -> Vec<f64> {
    let count = currents.len();
    let half = PI * share / count as f64;
    // By the distance between two electrodes: the mean potential under one for a current of 1 through the other.
    let green: Vec<f64> = (0..count)
        .map(|distance| {
            let angle = 2.0 * PI * distance as f64 / count as f64;
            (1..=TERMS)
                .map(|n| {
                    let n = n as f64;
                    let spread = (n * half).sin() / (n * half);
                    spread * spread * (n * angle).cos() / n
                })
                .sum::<f64>()
                / (PI * conductance)
        })
        .collect();
    (0..count)
        .map(|m| currents.iter().enumerate().map(|(l, current)| current * green[m.abs_diff(l)]).sum())
        .collect()
}
