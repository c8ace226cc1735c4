//! Gaussian processes of more rows than a matrix over all of them allows.
//!
//! Problem: an exact process of n rows takes n³/3 multiplications and n² numbers, and its answers a kernel a row. Method: the
//! subset of regressors, whose mean is that of the deterministic training conditional (J. Quiñonero-Candela and C. E. Rasmussen, *A
//! unifying view of sparse approximate Gaussian process regression*, JMLR 6, 2005): all n rows are fitted by a sum of kernels
//! around m of them. With K_mm = LLᵀ and features φ(x) = L⁻¹k_m(x) it is a ridge regression, β = (ΦᵀΦ + λI)⁻¹Φᵀt, and the weights
//! of the kernels are L⁻ᵀβ: solved so, rows that are nearly alike do no harm. The m rows are those of a randomly pivoted Cholesky
//! decomposition (Y. Chen, E. N. Epperly, J. A. Tropp and R. J. Webber, *Randomly pivoted Cholesky*, Communications on Pure and
//! Applied Mathematics 78, 2025), in blocks: drawn with the variance that the rows before leave them, so that neither a crowd of
//! rows nor outliers take all. It ends early where what is left is below a hundredth of the noise. Assumptions: none beside those
//! of the process. Cost: nm² multiplications; 8(2m² + 2m·m + 1024m) bytes, which do not grow with n, beside the rows themselves:
//! 200 MB for 2,500.

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{BlockStructure, matmul as triangular_matmul};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Mat, Par};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Problem, Solved, solve};
use crate::stride;

/// Rows that supports are drawn from, for each of them.
const CANDIDATES: usize = 2;
/// Rows that are drawn at once.
const DRAWN: usize = 64;
/// Variance that supports may leave of a row, as a share of that of the noise. With less, weights grow beyond what a graph of 32-bit
/// numbers adds up; with ten times more, answers differ from the exact ones by some percent.
const LEFT: f64 = 0.01;
/// Rows whose features are held at once.
const BLOCK: usize = 1024;
/// What rows are drawn by.
const SEED: u64 = 1;

/// Fits a sum over `most` rows at most to all. `None` where the noise is too small.
pub(super) fn fit(problem: &Problem, most: usize) -> Option<Solved> {
    let (chosen, basis) = supports(problem, most);
    let (n, m, outputs) = (problem.count(), chosen.len(), problem.targets.ncols());
    let mut normal = Mat::<f64>::zeros(m, m);
    (0..m).for_each(|i| normal[(i, i)] = problem.noise);
    let mut weights = Mat::<f64>::zeros(m, outputs);
    for start in (0..n).step_by(BLOCK) {
        let count = BLOCK.min(n - start);
        let mut features = Mat::from_fn(m, count, |i, j| problem.covariance(chosen[i], start + j));
        solve_lower_triangular_in_place(basis.as_ref(), features.as_mut(), Par::Seq);
        triangular_matmul(
            normal.as_mut(),
            BlockStructure::TriangularLower,
            Accum::Add,
            features.as_ref(),
            BlockStructure::Rectangular,
            features.as_ref().transpose(),
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
        let targets = problem.targets.as_ref().subrows(start, count);
        matmul(weights.as_mut(), Accum::Add, features.as_ref(), targets, 1.0, Par::Seq);
    }
    solve(&mut normal, &mut weights)?;
    solve_upper_triangular_in_place(basis.as_ref().transpose(), weights.as_mut(), Par::Seq);
    let rows = chosen.iter().flat_map(|i| problem.row(*i)).copied().collect();
    Some((rows, weights))
}

/// Rows that stand for all, at most `most`, and the lower Cholesky factor of their covariances.
fn supports(problem: &Problem, most: usize) -> (Vec<usize>, Mat<f64>) {
    let step = stride(problem.count(), most.saturating_mul(CANDIDATES));
    let rows: Vec<usize> = (0..problem.count()).step_by(step).collect();
    let most = most.min(rows.len());
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    // Covariances of all candidates and those that were chosen, in the features of these.
    let mut factor = Mat::<f64>::zeros(rows.len(), most);
    let mut left = vec![1.0; rows.len()];
    let mut chosen: Vec<usize> = Vec::with_capacity(most);
    let floor = LEFT * problem.noise;
    loop {
        let drawn = draw(&left, DRAWN.min(most - chosen.len()), floor, &mut rng);
        if drawn.is_empty() {
            break;
        }
        let before = chosen.len();
        let mut columns =
            Mat::from_fn(rows.len(), drawn.len(), |i, j| problem.covariance(rows[i], rows[drawn[j]]));
        if before > 0 {
            let of_drawn = Mat::from_fn(before, drawn.len(), |i, j| factor[(drawn[j], i)]);
            let known = factor.as_ref().subcols(0, before);
            matmul(columns.as_mut(), Accum::Add, known, of_drawn.as_ref(), -1.0, Par::Seq);
        }
        for (j, pivot) in drawn.iter().copied().enumerate() {
            let variance = columns[(pivot, j)];
            // One that was drawn together with it may stand for it.
            if variance > floor {
                let column = chosen.len();
                for (i, left) in left.iter_mut().enumerate() {
                    let value = columns[(i, j)] / variance.sqrt();
                    factor[(i, column)] = value;
                    *left -= value * value;
                }
                for (other, later) in drawn.iter().enumerate().skip(j + 1) {
                    let share = factor[(*later, column)];
                    (0..rows.len()).for_each(|i| columns[(i, other)] -= share * factor[(i, column)]);
                }
                chosen.push(pivot);
            }
            // Rounding must not let it be drawn again.
            left[pivot] = 0.0;
        }
    }
    let basis =
        Mat::from_fn(chosen.len(), chosen.len(), |i, j| if j <= i { factor[(chosen[i], j)] } else { 0.0 });
    (chosen.into_iter().map(|i| rows[i]).collect(), basis)
}

/// At most `count` different rows, each with a probability that grows with what is left of it (P. S. Efraimidis and P. G. Spirakis,
/// *Weighted random sampling with a reservoir*, Information Processing Letters 97, 2006); none whose rest is below `floor`.
fn draw(left: &[f64], count: usize, floor: f64, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let mut keys: Vec<(f64, usize)> = left
        .iter()
        .enumerate()
        .filter(|(_, left)| **left > floor)
        .map(|(i, left)| (-(1.0 - rng.random::<f64>()).ln() / left, i))
        .collect();
    keys.sort_by(|a, b| a.0.total_cmp(&b.0));
    keys.into_iter().take(count).map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use crate::{GaussianSettings, Kernel, KernelExpansion, Rows, gaussian_process};

    /// Rows over a square, in no order, and two outputs that wave over it.
    fn waves(count: usize) -> (Vec<f64>, Vec<f64>) {
        // Additive recurrence of the plastic number: even, and never twice the same.
        let at = |i: usize, step: f64| (0.5 + i as f64 * step).fract() * 4.0;
        let rows: Vec<f64> = (0..count)
            .flat_map(|i| [at(i, 0.754_877_666_246_692_8), at(i, 0.569_840_290_998_053_3)])
            .collect();
        let targets = rows.chunks_exact(2).flat_map(wave).collect();
        (rows, targets)
    }

    fn wave(row: &[f64]) -> [f64; 2] {
        [(3.0 * row[0]).sin() * (2.0 * row[1]).cos(), 5.0 + (2.5 * row[0] + 1.5 * row[1]).cos()]
    }

    /// A deterministic disturbance of a tenth.
    fn noisy(targets: &[f64]) -> Vec<f64> {
        let disturbance = |i: usize| 0.1 * (0.5 - (i as f64 * 0.618_033_988_749_895).fract()) * 3.46;
        targets.iter().enumerate().map(|(i, t)| t + disturbance(i)).collect()
    }

    fn fitted(rows: &[f64], targets: &[f64], settings: GaussianSettings) -> KernelExpansion {
        let (inputs, targets) = (Rows::new(rows, 2, "inputs").unwrap(), Rows::new(targets, 2, "t").unwrap());
        gaussian_process(inputs, targets, &settings).unwrap()
    }

    fn rms(fitted: &KernelExpansion, rows: &[f64]) -> f64 {
        let squares = rows.chunks_exact(2).map(|row| {
            let answer = fitted.predict(row).unwrap();
            answer.iter().zip(wave(row)).map(|(a, t)| (a - t).powi(2)).sum::<f64>()
        });
        (squares.sum::<f64>() / (rows.len() / 2) as f64).sqrt()
    }

    fn settings(kernel: Kernel, gamma: f64, noise: f64, supports: Option<usize>) -> GaussianSettings {
        GaussianSettings { kernel, gamma, noise, supports }
    }

    #[test]
    fn with_every_row_as_a_support_it_is_the_exact_one() {
        let (rows, targets) = waves(150);
        for kernel in [Kernel::Gaussian, Kernel::Matern] {
            // So narrow that no row stands for another.
            let of = settings(kernel, 40.0, 1e-2, None);
            let exact = fitted(&rows, &targets, of);
            let (problem, standard) = super::Problem::new(
                Rows::new(&rows, 2, "inputs").unwrap(),
                Rows::new(&targets, 2, "targets").unwrap(),
                &of,
            );
            let (supports, weights) = super::fit(&problem, 150).unwrap();
            assert_eq!(supports.len(), exact.supports.len());
            let sparse = KernelExpansion {
                standard,
                supports,
                weights: weights.col_iter().flat_map(|c| c.iter().map(|w| w * problem.scale)).collect(),
                ..exact.clone()
            };
            for row in [[0.3, 0.4], [1.7, 3.1], [3.9, 2.2]] {
                let (a, b) = (exact.predict(&row).unwrap(), sparse.predict(&row).unwrap());
                assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-9), "{kernel:?}: {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn few_supports_stand_for_all_where_the_function_is_smooth() {
        let (rows, targets) = waves(1200);
        let noisy = noisy(&targets);
        let unseen = waves(1500).0.split_off(2400);
        let exact = fitted(&rows, &noisy, settings(Kernel::Gaussian, 2.0, 1e-2, None));
        let sparse = fitted(&rows, &noisy, settings(Kernel::Gaussian, 2.0, 1e-2, Some(300)));
        assert!(sparse.supports.len() / 2 <= 300);
        let (a, b) = (rms(&exact, &unseen), rms(&sparse, &unseen));
        assert!(b < 1.05 * a && a < 0.1, "exact {a}, sparse {b}");
    }

    #[test]
    fn more_rows_do_better_with_as_many_supports() {
        let (rows, targets) = waves(2000);
        let noisy = noisy(&targets);
        let unseen = waves(2300).0.split_off(4000);
        let of = settings(Kernel::Matern, 1.0, 3e-2, Some(250));
        let few = rms(&fitted(&rows[..500], &noisy[..500], of), &unseen);
        let many = rms(&fitted(&rows, &noisy, of), &unseen);
        // Eight times the rows average the noise: the root of that at best.
        assert!(many < 0.7 * few, "250 rows {few}, 2000 rows {many}");
    }

    #[test]
    fn rows_that_are_alike_are_taken_once_and_weights_stay_within_single_precision() {
        // Every row three times.
        let (once, targets) = waves(400);
        let rows: Vec<f64> = (0..3).flat_map(|_| once.clone()).collect();
        let thrice: Vec<f64> = (0..3).flat_map(|_| noisy(&targets)).collect();
        let fitted = fitted(&rows, &thrice, settings(Kernel::Gaussian, 1.0, 1e-4, Some(600)));
        assert!(fitted.supports.len() / 2 <= 400, "{}", fitted.supports.len() / 2);
        let single = |values: &[f64]| values.iter().map(|v| f64::from(*v as f32)).collect::<Vec<f64>>();
        let rounded = KernelExpansion {
            supports: single(&fitted.supports),
            weights: single(&fitted.weights),
            ..fitted.clone()
        };
        for row in [[0.3, 0.4], [1.7, 3.1], [3.9, 2.2]] {
            let (a, b) = (fitted.predict(&row).unwrap(), rounded.predict(&row).unwrap());
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 4e-3), "{a:?} {b:?}");
        }
    }
}
