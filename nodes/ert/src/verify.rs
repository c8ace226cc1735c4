//! Figures of the panel's physics, computed now, against closed forms and another program's figures: E1 to E7.
//!
//! Where currents go in and come out again, the sheet's mean potential drops out: cases on sheets without a leak use Green's
//! function without its mean.

use std::f64::consts::{LN_2, PI, TAU};

use dermis_mechanics::MechanicsError;
use dermis_model::Case;

use crate::electronics::Drive;
use crate::sheet::{Conductors, Design, Electrode, Grid, Load, Sheet, Update};

/// \[Ω per square\] of the sheets.
const SQUARE: f64 = 1e4;
/// \[m\] of the thesis' panel.
const PANEL: [f64; 2] = [0.54, 0.56];
/// Cells of the grid that references were computed on.
const CELLS: [usize; 2] = [90, 90];

/// Every case of this family.
///
/// # Errors
///
/// [`MechanicsError`] where a case cannot be computed at all.
pub fn cases() -> Result<Vec<Case>, MechanicsError> {
    let mut cases = vec![van_der_pauw()?, four_terminals()?];
    cases.extend(two_terminals()?);
    cases.push(screened()?);
    for length in [3e-3, 10e-3, 30e-3] {
        cases.push(foam_disc(length)?);
    }
    cases.push(update()?);
    cases.push(reciprocity()?);
    Ok(cases)
}

/// A uniform sheet of 10 kΩ, and the points of its grid at locations \[m\] from its lower left corner.
fn sheet(size: [f64; 2], cells: [usize; 2], leak: f64) -> Result<(Sheet, Grid), MechanicsError> {
    let grid = Grid { size, cells };
    Ok((Sheet::new(&Design { grid, resistance: [SQUARE; 2], leak, field: None }, &[])?, grid))
}

fn node(grid: &Grid, from_corner: [f64; 2]) -> usize {
    let step = grid.step();
    grid.number([0, 1].map(|k| (from_corner[k] / step[k]).round() as usize))
}

/// \[V\] between two points for 1 A through two others.
fn between(sheet: &Sheet, [into, out]: [usize; 2], [high, low]: [usize; 2]) -> f64 {
    sheet.green(high, into) - sheet.green(high, out) - sheet.green(low, into) + sheet.green(low, out)
}

/// A leak so small that nothing of it shows in differences.
const NO_LEAK: f64 = 1e-12;

fn van_der_pauw() -> Result<Case, MechanicsError> {
    let (sheet, grid) = sheet([0.5, 0.5], [100, 100], NO_LEAK)?;
    let corner = |i, j| grid.number([i, j]);
    let [a, b, c, d] = [corner(0, 0), corner(100, 0), corner(100, 100), corner(0, 100)];
    let got = between(&sheet, [a, b], [d, c]).abs() / SQUARE;
    Ok(Case::relative(
        "E1",
        "resistance of a square by its corners, over its resistance per square",
        "ln 2 / π (van der Pauw 1958)",
        "",
        [got, LN_2 / PI],
        1e-3,
    ))
}

/// The pair of E2, E3 and E6.
const PAIR: [[f64; 2]; 2] = [[0.090, 0.112], [0.450, 0.448]];

fn four_terminals() -> Result<Case, MechanicsError> {
    let (sheet, grid) = sheet(PANEL, CELLS, NO_LEAK)?;
    let got = between(
        &sheet,
        PAIR.map(|at| node(&grid, at)),
        [[0.270, 0.280], [0.090, 0.448]].map(|at| node(&grid, at)),
    );
    Ok(Case::relative(
        "E2",
        "panel of 540 x 560 mm: voltage between two points for 1 A through two others",
        "double cosine series of a rectangle",
        "ohm",
        [got, -62.772],
        1e-3,
    ))
}

fn two_terminals() -> Result<Vec<Case>, MechanicsError> {
    let (bare, grid) = sheet(PANEL, CELLS, NO_LEAK)?;
    let pair = PAIR.map(|at| node(&grid, at));
    // Discs of the radius that a point of a square grid has: 0.198 steps.
    let [hx, hy] = grid.step();
    let radius = 0.198 * (hx * hy).sqrt();
    let design = Design { grid, resistance: [SQUARE; 2], leak: NO_LEAK, field: None };
    let discs = PAIR.map(|at| Electrode { at: [0, 1].map(|k| at[k] - PANEL[k] / 2.0), radius });
    let sheet = Sheet::new(&design, &discs)?;
    let z = sheet.transfer();
    Ok(vec![
        Case::relative(
            "E3",
            "the same pair: resistance between two discs of 0.198 steps",
            "double cosine series of a rectangle, sources as discs",
            "ohm",
            [z[0] - z[1] - z[2] + z[3], 24_477.4],
            1e-3,
        ),
        Case::relative(
            "E6-pyeit",
            "the same pair: voltage between both points of the grid",
            "pyEIT 1.2.4 on the same mesh; a test asks it again where it can be installed",
            "ohm",
            [between(&bare, pair, pair), 24_468.875],
            1e-4,
        ),
    ])
}

fn screened() -> Result<Case, MechanicsError> {
    let (length, away) = (30e-3, 4usize);
    let (sheet, grid) = sheet(PANEL, CELLS, 1.0 / (SQUARE * length * length))?;
    let middle = grid.number([45, 45]);
    let got = sheet.green(middle, middle + away) + sheet.mean();
    Ok(Case::relative(
        "E4",
        "panel over foam that screens within 30 mm: potential 24 mm from a source of 1 A",
        "Rs K0(r/λ) / 2π",
        "ohm",
        [got, SQUARE / TAU * bessel_k0(away as f64 * grid.step()[0] / length)],
        0.01,
    ))
}

/// Foam under a disc, read from a ring around it: what the sheet between them drops is known.
fn foam_disc(length: f64) -> Result<Case, MechanicsError> {
    const RADIUS: f64 = 10e-3;
    const RING: [f64; 2] = [20e-3, 45e-3];
    let grid = Grid { size: [0.15, 0.15], cells: [200, 200] };
    let conductance = 1.0 / (SQUARE * length * length);
    let step = grid.step()[0];
    let mut loads = Vec::new();
    for node in 0..grid.count() {
        let [x, y] = grid.position(node);
        // The share of the cell that lies in the disc, by 20 x 20 samples.
        let sample = |k: i32| (f64::from(k) + 0.5) / 20.0 - 0.5;
        let inside = |i: i32, j: i32| (x + step * sample(i)).hypot(y + step * sample(j)) < RADIUS;
        let share = (0..20).flat_map(|i| (0..20).map(move |j| (i, j))).filter(|&(i, j)| inside(i, j)).count();
        if share > 0 {
            let conductance = conductance * grid.area(node) * share as f64 / 400.0;
            loads.push(Load { node, conductance });
        }
    }
    // A current that comes from all of a ring at once, as 60 electrodes share it, read on a ring inside of it.
    let ring = |radius: f64| {
        (0..60).map(move |k| {
            let (sin, cos) = (TAU * f64::from(k) / 60.0).sin_cos();
            Electrode { at: [radius * cos, radius * sin], radius: 1e-3 }
        })
    };
    let electrodes: Vec<Electrode> = RING.iter().flat_map(|r| ring(*r)).collect();
    let design = Design { grid, resistance: [SQUARE; 2], leak: 1e-9, field: None };
    let sheet = Sheet::new(&design, &electrodes)?;
    let mut z = vec![0.0; 120 * 120];
    Update::default().solve(&sheet, &loads, 1.0, &mut z);
    let read = (60..120).flat_map(|k| (0..60).map(move |j| (k, j))).map(|(k, j)| z[k * 120 + j]);
    let got = read.sum::<f64>() / 3600.0 - SQUARE / TAU * (RING[0] / RADIUS).ln();
    let (i0, i1) = bessel_i(RADIUS / length);
    let wanted = SQUARE * length * i0 / (TAU * RADIUS * i1);
    Ok(Case::relative(
        format!("E5-{:.0}mm", length * 1e3),
        format!(
            "sheet over a foam disc of 10 mm that screens within {:.0} mm: resistance from its rim to ground",
            length * 1e3
        ),
        "Rs λ I0(R/λ) / (2πR I1(R/λ))",
        "ohm",
        [got, wanted],
        0.02,
    ))
}

/// Electrodes of the cases that need some.
fn hexagon() -> Vec<Electrode> {
    let ring = (0..6).map(|k| (TAU * f64::from(k) / 6.0).sin_cos());
    let mut all: Vec<Electrode> =
        ring.map(|(sin, cos)| Electrode { at: [0.2 * cos, 0.2 * sin], radius: 5e-3 }).collect();
    all.push(Electrode { at: [0.0, 0.0], radius: 5e-3 });
    all
}

/// Loads of three presses.
fn presses(grid: &Grid) -> Vec<Load> {
    let mut loads = Vec::new();
    for (i, j) in [(20, 30), (44, 61), (70, 15)] {
        for (dx, dy) in (0..5).flat_map(|dx| (0..5).map(move |dy| (dx, dy))) {
            let conductance = 1e-7 * 1.7f64.powi(dx + dy);
            loads.push(Load { node: grid.number([i + dx as usize, j + dy as usize]), conductance });
        }
    }
    loads
}

fn update() -> Result<Case, MechanicsError> {
    let grid = Grid { size: PANEL, cells: CELLS };
    let design = Design { grid, resistance: [SQUARE; 2], leak: 1e-6, field: None };
    let electrodes = hexagon();
    let loads = presses(&grid);
    let sheet = Sheet::new(&design, &electrodes)?;
    let n = electrodes.len();
    let mut z = vec![0.0; n * n];
    Update::default().solve(&sheet, &loads, 1.0, &mut z);
    let mut conductors = Conductors::new(grid, design.resistance, None, design.leak);
    loads.iter().for_each(|load| conductors.ground[load.node] += load.conductance);
    let spread: Vec<[(usize, f64); 4]> = electrodes.iter().map(|e| grid.weights(e.at)).collect();
    let currents: Vec<Vec<f64>> = spread
        .iter()
        .map(|corners| {
            let mut current = vec![0.0; grid.count()];
            corners.iter().for_each(|(node, w)| current[*node] += w);
            current
        })
        .collect();
    let solved = conductors.factor()?.solve(&currents);
    let mut worst = 0.0f64;
    for (k, potential) in solved.iter().enumerate() {
        for (j, corners) in spread.iter().enumerate().filter(|(j, _)| *j != k) {
            let wanted: f64 = corners.iter().map(|(node, w)| w * potential[*node]).sum();
            worst = worst.max((z[k * n + j] / wanted - 1.0).abs());
        }
    }
    Ok(Case::new(
        "E6-update",
        "panel with three presses: largest relative difference between the update and the sheet that was factored again",
        "sparse Cholesky factor of the same matrix",
        "",
        [worst, 0.0],
        (1e-9, 1.0),
    ))
}

fn reciprocity() -> Result<Case, MechanicsError> {
    let grid = Grid { size: PANEL, cells: CELLS };
    let design = Design { grid, resistance: [SQUARE; 2], leak: 1e-6, field: None };
    let sheet = Sheet::new(&design, &hexagon())?;
    let n = sheet.electrodes();
    let (mut z, mut v) = (vec![0.0; n * n], vec![0.0; n * n]);
    Update::default().solve(&sheet, &presses(&grid), 1.0, &mut z);
    Drive::new(3.0, 100.0, n).read(&mut z, &mut v);
    let of = |j: usize, k: usize| v[k * n + j];
    Ok(Case::relative(
        "E7",
        "voltages around a cycle of three electrodes, V12 V23 V31 / (V21 V32 V13)",
        "reciprocity with a source of voltage",
        "",
        [of(0, 1) * of(1, 2) * of(2, 0) / (of(1, 0) * of(2, 1) * of(0, 2)), 1.0],
        1e-9,
    ))
}

/// K0 by its integral ∫₀^∞ exp(−x cosh t) dt: the trapezoidal rule converges as fast as exponentials do.
fn bessel_k0(x: f64) -> f64 {
    let step = 0.05;
    let at = |k: i32| (-x * (f64::from(k) * step).cosh()).exp();
    step * (0.5 * at(0) + (1..200).map(at).sum::<f64>())
}

/// I0 and I1 by their series.
fn bessel_i(x: f64) -> (f64, f64) {
    let square = x * x / 4.0;
    let (mut term, mut i0, mut i1) = (1.0, 0.0, 0.0);
    for k in 0..60 {
        let k = f64::from(k);
        i0 += term;
        i1 += term * x / 2.0 / (k + 1.0);
        term *= square / (k + 1.0).powi(2);
    }
    (i0, i1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_passes() {
        dermis_model::suite::all_pass(&cases().unwrap());
    }

    #[test]
    fn bessel_functions_are_those_of_tables() {
        approx::assert_relative_eq!(bessel_k0(0.8), 0.565_347_10, max_relative = 1e-7);
        let (i0, i1) = bessel_i(1.0);
        approx::assert_relative_eq!(i0, 1.266_065_88, max_relative = 1e-8);
        approx::assert_relative_eq!(i1, 0.565_159_10, max_relative = 1e-8);
    }
}
