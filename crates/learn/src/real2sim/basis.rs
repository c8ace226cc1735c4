//! The few shapes that maps are sums of.

use dermis_regress::dense::Product;
use nalgebra::{DMatrix, SymmetricEigen};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Shapes at most.
const MOST: usize = 240;
/// Shapes beyond those that are requested, by which the random start is more likely to hold them.
const MARGIN: usize = 16;

/// Orthonormal shapes of maps, the strongest first: principal components without a mean, so that the untouched skin, whose map is
/// 0, has amplitudes of 0, and so that the amplitudes of contacts add up where their maps do.
#[derive(Debug, Clone, PartialEq)]
pub struct MapBasis {
    /// Row-major \[shapes, points\]; none of a basis of points.
    shapes: Vec<f32>,
    points: usize,
    kept: f64,
    /// Whether the amplitudes are the displacements of all points.
    whole: bool,
}

impl MapBasis {
    /// The fewest shapes that keep this `share` of the sum of squares of `maps` (row-major \[n, points\]); 240 at most. A random
    /// start, two rounds of subspace iteration, and an eigenvalue problem of the size of the subspace (N. Halko,
    /// P.-G. Martinsson, J. A. Tropp, *SIAM Rev.* 53 (2011) 217).
    #[must_use]
    pub fn measure(maps: &[f32], points: usize, share: f64, seed: u64) -> Self {
        let count = maps.len() / points.max(1);
        let width = (MOST + MARGIN).min(count).min(points);
        let energy: f64 = maps.iter().map(|v| f64::from(*v).powi(2)).sum();
        if width == 0 || energy <= 0.0 {
            return Self { shapes: Vec::new(), points, kept: 0.0, whole: false };
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let start: Vec<f32> = (0..points * width).map(|_| rng.sample(StandardNormal)).collect();
        // maps · start, then back and forth.
        let forth = |b: &[f32]| {
            let mut out = vec![0.0; count * width];
            let product = Product { rows: count, inner: points, columns: width, keep: false };
            product.run(maps, [points, 1], b, [width, 1], &mut out);
            orthonormal(&out, count, width)
        };
        let back = |q: &[f32]| {
            let mut out = vec![0.0; points * width];
            let product = Product { rows: points, inner: count, columns: width, keep: false };
            product.run(maps, [1, points], q, [width, 1], &mut out);
            out
        };
        let mut q = forth(&start);
        for _ in 0..2 {
            q = forth(&orthonormal(&back(&q), points, width));
        }
        // qᵀ · maps, whose singular values are those of the maps.
        let inner = back(&q);
        let inner = DMatrix::from_fn(width, points, |i, j| f64::from(inner[j * width + i]));
        let eigen = SymmetricEigen::new(&inner * inner.transpose());
        let mut order: Vec<usize> = (0..width).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let (mut shapes, mut kept) = (Vec::new(), 0.0);
        for i in order.into_iter().take(MOST) {
            let square = eigen.eigenvalues[i];
            if kept >= share * energy || square <= 1e-12 * energy {
                break;
            }
            kept += square;
            let shape = eigen.eigenvectors.column(i).transpose() * &inner / square.sqrt();
            shapes.extend(shape.iter().map(|v| *v as f32));
        }
        Self { shapes, points, kept: kept / energy, whole: false }
    }

    /// The basis of points: amplitudes are maps, and nothing is lost.
    #[must_use]
    pub fn whole(points: usize) -> Self {
        Self { shapes: Vec::new(), points, kept: 1.0, whole: true }
    }

    /// Whether amplitudes are maps.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.whole
    }

    /// Number of amplitudes of a map.
    #[must_use]
    pub fn rank(&self) -> usize {
        if self.whole { self.points } else { self.shapes.len() / self.points.max(1) }
    }

    /// Points of a map.
    #[must_use]
    pub fn points(&self) -> usize {
        self.points
    }

    /// Share of the sum of squares of the maps it was measured on that it keeps.
    #[must_use]
    pub fn kept(&self) -> f64 {
        self.kept
    }

    /// The shapes, row-major \[shapes, points\]; empty of a basis of points.
    #[must_use]
    pub fn shapes(&self) -> &[f32] {
        &self.shapes
    }

    /// Amplitudes of maps that lie end to end.
    #[must_use]
    pub fn encode(&self, maps: &[f32]) -> Vec<f32> {
        if self.whole {
            return maps.to_vec();
        }
        let (rows, rank) = (maps.len() / self.points.max(1), self.rank());
        let mut out = vec![0.0; rows * rank];
        let product = Product { rows, inner: self.points, columns: rank, keep: false };
        product.run(maps, [self.points, 1], &self.shapes, [1, self.points], &mut out);
        out
    }

    /// Maps of amplitudes that lie end to end.
    #[must_use]
    pub fn decode(&self, amplitudes: &[f32]) -> Vec<f32> {
        if self.whole {
            return amplitudes.to_vec();
        }
        let rank = self.rank();
        let rows = amplitudes.len() / rank.max(1);
        let mut out = vec![0.0; rows * self.points];
        let product = Product { rows, inner: rank, columns: self.points, keep: false };
        product.run(amplitudes, [rank, 1], &self.shapes, [self.points, 1], &mut out);
        out
    }
}

/// An orthonormal basis of the columns of a row-major matrix.
fn orthonormal(values: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let matrix = DMatrix::from_fn(rows, columns, |i, j| f64::from(values[i * columns + j]));
    let q = matrix.qr().q();
    let mut out = Vec::with_capacity(rows * columns);
    for i in 0..rows {
        out.extend((0..columns).map(|j| q[(i, j)] as f32));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_of_few_shapes_are_kept_whole() {
        let points = 120;
        let shape = |k: usize, i: usize| ((k + 1) as f32 * i as f32 * 0.05).sin();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut maps = Vec::new();
        for _ in 0..80 {
            let a: [f32; 3] = std::array::from_fn(|k| rng.random_range(-1.0..1.0) / (k + 1) as f32);
            maps.extend((0..points).map(|i| (0..3).map(|k| a[k] * shape(k, i)).sum::<f32>()));
        }
        let basis = MapBasis::measure(&maps, points, 0.999_999, 1);
        assert_eq!((basis.rank(), basis.points()), (3, points));
        assert!(basis.kept() > 0.999_99);
        let back = basis.decode(&basis.encode(&maps));
        assert!(maps.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-4));
        let rough = MapBasis::measure(&maps, points, 0.5, 1);
        assert_eq!(rough.rank(), 1);
        assert!((0.5..1.0).contains(&rough.kept()));
    }

    #[test]
    fn a_basis_of_points_changes_nothing() {
        let basis = MapBasis::whole(3);
        let maps = [1.0, -2.0, 0.5, 0.0, 4.0, 1e-9];
        assert_eq!((basis.rank(), basis.kept(), basis.is_whole()), (3, 1.0, true));
        assert_eq!(basis.decode(&basis.encode(&maps)), maps);
        assert!(!MapBasis::measure(&maps, 3, 0.9, 1).is_whole());
    }

    #[test]
    fn no_maps_make_no_shapes() {
        assert_eq!(MapBasis::measure(&[], 10, 0.99, 1).rank(), 0);
        assert_eq!(MapBasis::measure(&[0.0; 40], 10, 0.99, 1).rank(), 0);
    }
}
