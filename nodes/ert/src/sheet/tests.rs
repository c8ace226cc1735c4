use approx::assert_relative_eq;
use proptest::prelude::*;

use super::*;

const RESISTANCE: f64 = 1e4;
const LEAK: f64 = 1e-6;

fn design(cells: [usize; 2], resistance: [f64; 2]) -> Design {
    Design { grid: Grid { size: [0.3, 0.2], cells }, resistance, leak: LEAK, field: None }
}

fn electrodes() -> Vec<Electrode> {
    [[-0.1, -0.06], [0.0, 0.0], [0.107, 0.033], [-0.02, 0.071]]
        .map(|at| Electrode { at, radius: 5e-3 })
        .to_vec()
}

fn loads(grid: &Grid, values: &[(usize, f64)]) -> Vec<Load> {
    values.iter().map(|&(node, conductance)| Load { node: node % grid.count(), conductance }).collect()
}

/// Of the sheet's own matrix, factored with the loads in it: without what stands for the discs of electrodes.
fn refactored(design: &Design, electrodes: &[Electrode], loads: &[Load]) -> Vec<f64> {
    let factors = design.field.as_ref().map(|(factors, _)| &factors[..]);
    let mut conductors = Conductors::new(design.grid, design.resistance, factors, design.leak);
    if let Some((_, ground)) = &design.field {
        conductors.ground.iter_mut().zip(ground).for_each(|(all, g)| *all += g);
    }
    for load in loads {
        conductors.ground[load.node] += load.conductance;
    }
    let spread: Vec<[(usize, f64); 4]> = electrodes.iter().map(|e| design.grid.weights(e.at)).collect();
    let currents: Vec<Vec<f64>> = spread
        .iter()
        .map(|corners| {
            let mut current = vec![0.0; design.grid.count()];
            corners.iter().for_each(|(node, w)| current[*node] += w);
            current
        })
        .collect();
    let solved = conductors.factor().unwrap().solve(&currents);
    let read = |potential: &Vec<f64>, corners: &[(usize, f64); 4]| -> f64 {
        corners.iter().map(|(node, w)| w * potential[*node]).sum()
    };
    solved.iter().flat_map(|potential| spread.iter().map(|corners| read(potential, corners))).collect()
}

/// What the update makes of the same: `own` is what stands for the discs, which the matrix does not know.
fn updated(sheet: &Sheet, bare: &[f64], loads: &[Load]) -> Vec<f64> {
    let n = sheet.electrodes();
    let mut out = vec![0.0; n * n];
    Update::default().solve(sheet, loads, 1.0, &mut out);
    for e in 0..n {
        out[e * n + e] -= sheet.transfer()[e * n + e] + sheet.mean() - bare[e * n + e];
    }
    out
}

#[test]
fn the_closed_form_is_the_inverse_of_the_matrix() {
    let design = design([12, 9], [RESISTANCE, 0.6 * RESISTANCE]);
    let sheet = Sheet::new(&design, &electrodes()).unwrap();
    let factored = Conductors::new(design.grid, design.resistance, None, LEAK).factor().unwrap();
    let count = design.grid.count();
    let currents: Vec<Vec<f64>> =
        (0..count).map(|k| (0..count).map(|i| f64::from(u8::from(i == k))).collect()).collect();
    let inverse = factored.solve(&currents);
    for (a, row) in inverse.iter().enumerate() {
        for (b, wanted) in row.iter().enumerate() {
            let found = sheet.green(a, b) + sheet.mean();
            // The mean is a hundred times what is looked for: rounding of the factor, by that.
            assert!((found - wanted).abs() < 1e-10 * sheet.mean(), "{a} {b}: {found} for {wanted}");
        }
    }
}

#[test]
fn a_sheet_that_is_solved_whole_is_the_same() {
    let uniform = design([24, 16], [RESISTANCE; 2]);
    let count = uniform.grid.count();
    let whole = Design { field: Some((vec![1.0; count], vec![0.0; count])), ..uniform.clone() };
    let sheets = [uniform, whole].map(|design| Sheet::new(&design, &electrodes()).unwrap());
    let loads = loads(sheets[0].grid(), &[(100, 1e-6), (101, 3e-6), (217, 1e-4)]);
    let [a, b] = sheets.each_ref().map(|sheet| {
        let mut out = vec![0.0; 16];
        Update::default().solve(sheet, &loads, 1.0, &mut out);
        out
    });
    // Single precision of Green's matrix, whose entries are some ten kilohms.
    a.iter().zip(&b).for_each(|(a, b)| assert!((a - b).abs() < 0.02, "{a} {b}"));
}

#[test]
fn finer_grids_agree_about_electrodes_anywhere() {
    let of = |cells| {
        let sheet = Sheet::new(&design(cells, [RESISTANCE, 2.0 * RESISTANCE]), &electrodes()).unwrap();
        sheet.transfer().to_vec()
    };
    let (coarse, fine) = (of([50, 33]), of([200, 132]));
    for (c, f) in coarse.iter().zip(&fine) {
        // Of what a disc of 5 mm has against the border of the sheet, about 10 kΩ.
        assert!((c - f).abs() < 30.0, "{c} Ω on the coarse grid, {f} Ω on the fine one");
    }
}

#[test]
fn potentials_are_those_of_the_factored_sheet() {
    let design = design([24, 16], [RESISTANCE; 2]);
    let sheet = Sheet::new(&design, &electrodes()).unwrap();
    let loads = loads(&design.grid, &[(30, 2e-5), (31, 1e-30), (200, 4e-7)]);
    let mut conductors = Conductors::new(design.grid, design.resistance, None, LEAK);
    loads.iter().for_each(|load| conductors.ground[load.node] += load.conductance);
    let mut current = vec![0.0; design.grid.count()];
    design.grid.weights(electrodes()[1].at).iter().for_each(|(node, w)| current[*node] += w);
    let wanted = &conductors.factor().unwrap().solve(&[current])[0];
    let (mut update, mut out, mut found) = (Update::default(), vec![0.0; 16], Vec::new());
    update.solve(&sheet, &loads, 1.0, &mut out);
    update.potentials(&mut found);
    for (i, load) in loads.iter().enumerate() {
        assert_relative_eq!(found[4 * i + 1], wanted[load.node], max_relative = 1e-9);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever is pressed: the update is the refactored sheet to 1e-9, symmetric, and positive; no press raises a resistance.
    #[test]
    fn updates_are_refactorisations(
        values in proptest::collection::btree_map(0..425usize, -9.0..-3.0f64, 0..60), anisotropy in 0.5..2.0f64,
    ) {
        let design = design([24, 16], [RESISTANCE, anisotropy * RESISTANCE]);
        let sheet = Sheet::new(&design, &electrodes()).unwrap();
        let values: Vec<(usize, f64)> = values.into_iter().map(|(node, exponent)| (node, 10f64.powf(exponent))).collect();
        let loads = loads(&design.grid, &values);
        let bare = refactored(&design, &electrodes(), &[]);
        let wanted = refactored(&design, &electrodes(), &loads);
        let found = updated(&sheet, &bare, &loads);
        for (i, (f, w)) in found.iter().zip(&wanted).enumerate() {
            prop_assert!((f - w).abs() < 1e-9 * sheet.mean(), "{i}: {f} for {w}");
            prop_assert!((f - found[i % 4 * 4 + i / 4]).abs() < 1e-9 * sheet.mean());
            prop_assert!(*f > 0.0 && *f <= bare[i] * (1.0 + 1e-9));
        }
    }
}
