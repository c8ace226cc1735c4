use proptest::prelude::*;

use super::*;
use crate::disc;

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

fn apart(a: &[f64], b: &[f64]) -> f64 {
    norm(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>()) / norm(b)
}

/// A drive of 1 A from the first to the second electrode, which on a disc stands for all.
fn drive() -> Vec<f64> {
    let mut currents = vec![0.0; 16];
    (currents[0], currents[1]) = (1.0, -1.0);
    currents
}

/// Readings behind that drive.
fn readings(potentials: &[f64]) -> Vec<f64> {
    (2..15).map(|m| potentials[m] - potentials[m + 1 - 16 * ((m + 1) / 16)]).collect()
}

/// The disc against the series: with a contact impedance of 100 times radius over conductance, the density under an electrode is even
/// within a thousandth, and linear triangles of some 1/16 of the spacing of electrodes are within a percent.
#[test]
fn a_disc_is_that_of_the_series() {
    for share in [0.2, 0.5] {
        let rim = Rim::circle(3.0, 16, share).unwrap();
        let contacts = Contacts { impedance: 100.0 * 3.0 / 0.7 };
        let on = |density| {
            let sheet = Sheet::uniform(&rim, density, 0.7, contacts).unwrap();
            readings(&sheet.solve(&drive()).unwrap().1)
        };
        let ours = on(Density::default());
        let exact = readings(&disc::potentials(&drive(), share, 0.7));
        let error = apart(&ours, &exact);
        assert!(error < 0.01, "{share}: {error}");
        // And each reading for itself, the weakest included.
        for (reading, (ours, exact)) in ours.iter().zip(&exact).enumerate() {
            assert!((ours - exact).abs() < 0.02 * exact.abs(), "{share}, {reading}: {ours} {exact}");
        }
        // Finer is nearer.
        assert!(apart(&on(Density { across: 2, between: 4, rings: 10 }), &exact) > 2.0 * error);
    }
}

/// The series itself, against its closed form: electrodes that are points have −ln(2 sin(θ/2)) / π of potential for a current of 1.
#[test]
fn the_series_of_narrow_electrodes_is_that_of_points() {
    let of = |angle: f64| -(2.0 * (0.5 * angle).sin()).ln() / std::f64::consts::PI;
    let step = std::f64::consts::TAU / 16.0;
    let mut currents = vec![0.0; 16];
    (currents[0], currents[3]) = (1.0, -1.0);
    let found = disc::potentials(&currents, 0.01, 1.0);
    for m in [5_u8, 8, 12] {
        let exact = of(f64::from(m) * step) - of((f64::from(m) - 3.0).abs() * step);
        // 4,000 terms of electrodes of 0.2 degrees.
        assert!((found[usize::from(m)] - exact).abs() < 1e-3, "{m}: {} {exact}", found[usize::from(m)]);
    }
}

#[test]
fn better_contacts_shorten_the_way_of_the_current() {
    let rim = Rim::circle(1.0, 16, 0.5).unwrap();
    let driven = |impedance: f64| {
        let sheet = Sheet::uniform(&rim, Density::default(), 1.0, Contacts { impedance }).unwrap();
        let potentials = sheet.solve(&drive()).unwrap().1;
        (potentials[0] - potentials[1], potentials[4] - potentials[5])
    };
    let (good, poor) = (driven(1e-3), driven(1.0));
    // Two contacts of length 2 pi / 32 in series with what is left, which an even density does not make smaller.
    let contacts = 2.0 * (1.0 - 1e-3) / (std::f64::consts::TAU / 32.0);
    assert!(poor.0 - good.0 > 0.99 * contacts, "{poor:?} {good:?}");
    // Electrodes that conduct well let current in at their near edges, and shunt the sheet under those that are read.
    assert!(good.1.abs() < poor.1.abs());
}

#[test]
fn what_cannot_be_is_refused() {
    let rim = Rim::circle(1.0, 16, 0.5).unwrap();
    let refused = |conductance, impedance| {
        Sheet::uniform(&rim, Density::default(), conductance, Contacts { impedance }).unwrap_err().to_string()
    };
    assert_eq!(refused(0.0, 1.0), "a conductance is 0, and must be a positive number");
    assert_eq!(refused(1.0, f64::NAN), "the contact impedance is NaN, and must be a positive number");
    let sheet = Sheet::uniform(&rim, Density::default(), 1.0, Contacts { impedance: 0.1 }).unwrap();
    assert!(sheet.solve(&[1.0]).is_err());
    assert!(Sheet::new(sheet.mesh().clone(), &[1.0], Contacts { impedance: 0.1 }).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    /// Whatever the outline and the conductance: driving one pair and reading another is the same the other way round, potentials
    /// scale with the resistance, and a higher conductance nowhere raises the power (Rayleigh's monotonicity).
    #[test]
    fn networks_of_conductors_are_reciprocal(
        radii in proptest::collection::vec(0.7_f64..1.4, 8), patch in 0.2_f64..5.0, scale in 0.5_f64..3.0,
    ) {
        let at = |k: usize| std::f64::consts::TAU * k as f64 / 8.0;
        let points: Vec<[f64; 2]> = radii.iter().enumerate().map(|(k, r)| [r * at(k).cos(), r * at(k).sin()]).collect();
        let rim = Rim::through(&points, 0.3).unwrap();
        let density = Density { across: 3, between: 4, rings: 8 };
        let mesh = Mesh::new(&rim, density).unwrap();
        let inside = |t: &[usize; 3]| mesh.nodes[t[0]][0] > 0.2;
        let of = |factor: f64, patch: f64| -> Vec<f64> {
            mesh.triangles.iter().map(|t| factor * if inside(t) { patch } else { 1.0 }).collect()
        };
        let pattern = Adjacent { electrodes: 8 };
        let contacts = Contacts { impedance: 0.05 };
        let sheet = Sheet::new(mesh.clone(), &of(1.0, patch), contacts).unwrap();
        let potentials = sheet.potentials(pattern).unwrap();
        let read = |k: usize, m: usize| potentials[k][m] - potentials[k][(m + 1) % 8];
        for (k, m) in pattern.readings() {
            prop_assert!((read(k, m) - read(m, k)).abs() < 1e-7 * read(k, k).abs());
        }
        let scaled = Sheet::new(mesh.clone(), &of(scale, patch), Contacts { impedance: 0.05 / scale }).unwrap();
        let scaled = scaled.potentials(pattern).unwrap();
        prop_assert!((scaled[2][2] * scale - potentials[2][2]).abs() < 1e-7 * potentials[2][2].abs());
        let better = Sheet::new(mesh.clone(), &of(1.0, patch * 1.3), contacts).unwrap().potentials(pattern).unwrap();
        for k in 0..8 {
            let power = |p: &[Vec<f64>]| p[k][k] - p[k][(k + 1) % 8];
            prop_assert!(power(&better) <= power(&potentials) * (1.0 + 1e-9));
        }
    }
}
