//! A Kalman filter that knows that some errors stay.
//!
//! Problem: readings of one skin share an error (its place on the link, its gain, what its model gets wrong here). A filter that takes
//! every reading for independent is sure of a biased mean after a hundred frames. Method: the Schmidt–Kalman or consider filter
//! (Schmidt 1966; Jazwinski, *Stochastic Processes and Filtering Theory*, 1970, §8.3): the bias of each skin is not estimated, but its
//! covariance with the state is carried along, so that gain and covariance count it.
//!
//! Model: z = H x + b + v, where H takes the first three components, b is the constant bias of the skin with covariance B, and v is
//! white with covariance R. Biases of different skins are independent.
//!
//! Cost: a 3×3 inverse and products of N×3 for each reading, and one N×3 product for each further skin.

use nalgebra::{Cholesky, Matrix3, SMatrix, SVector, Vector3};

/// The bias of one skin as it enters the state.
#[derive(Debug, Clone)]
struct Bias<const N: usize> {
    skin: usize,
    /// B.
    variance: Matrix3<f64>,
    /// Covariance of the state's error with the bias.
    cross: SMatrix<f64, N, 3>,
}

/// One reading of the first three components.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reading {
    /// Index of the skin that it is of.
    pub skin: usize,
    /// z.
    pub value: Vector3<f64>,
    /// R: what is new in each reading.
    pub noise: Matrix3<f64>,
    /// B: what stays; the first reading of a skin decides.
    pub bias: Matrix3<f64>,
}

/// What a reading differs by, and the covariance of that.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Innovation {
    pub value: Vector3<f64>,
    pub covariance: Matrix3<f64>,
}

impl Innovation {
    /// Squared Mahalanobis distance, and the logarithm of the determinant; infinite where the covariance is none.
    pub(crate) fn distance(&self) -> (f64, f64) {
        let Some(cholesky) = Cholesky::new(self.covariance) else { return (f64::INFINITY, f64::INFINITY) };
        let log_det = 2.0 * cholesky.l().diagonal().iter().map(|v| v.ln()).sum::<f64>();
        (self.value.dot(&cholesky.solve(&self.value)), log_det)
    }
}

/// Mean and covariance of a state of N components, and how far each skin's bias is in it.
#[derive(Debug, Clone)]
pub(crate) struct Filter<const N: usize> {
    pub mean: SVector<f64, N>,
    pub covariance: SMatrix<f64, N, N>,
    biases: Vec<Bias<N>>,
}

impl<const N: usize> Filter<N> {
    /// A state that is known from one reading; the components behind the third have mean 0 and variance `rest`.
    pub(crate) fn begin(reading: &Reading, rest: f64) -> Self {
        let mut mean = SVector::<f64, N>::zeros();
        mean.fixed_rows_mut::<3>(0).copy_from(&reading.value);
        let mut covariance = SMatrix::<f64, N, N>::from_diagonal_element(rest);
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&(reading.noise + reading.bias));
        let mut cross = SMatrix::<f64, N, 3>::zeros();
        // The error of the mean is −(b + v).
        cross.fixed_rows_mut::<3>(0).copy_from(&-reading.bias);
        Self { mean, covariance, biases: vec![Bias { skin: reading.skin, variance: reading.bias, cross }] }
    }

    /// The first three components and their covariance.
    pub(crate) fn head(&self) -> (Vector3<f64>, Matrix3<f64>) {
        (self.mean.fixed_rows::<3>(0).into_owned(), self.covariance.fixed_view::<3, 3>(0, 0).into_owned())
    }

    /// x ← F x + w, where w has the covariance Q.
    pub(crate) fn predict(&mut self, f: &SMatrix<f64, N, N>, q: &SMatrix<f64, N, N>) {
        self.mean = f * self.mean;
        self.covariance = f * self.covariance * f.transpose() + q;
        for bias in &mut self.biases {
            bias.cross = f * bias.cross;
        }
    }

    /// x ← x + w, where w has the covariance Q.
    pub(crate) fn diffuse(&mut self, q: &SMatrix<f64, N, N>) {
        self.covariance += q;
    }

    /// Covariance of the state with the bias of the reading's skin, and that of the bias.
    fn bias_of(&self, reading: &Reading) -> (SMatrix<f64, N, 3>, Matrix3<f64>) {
        self.biases
            .iter()
            .find(|b| b.skin == reading.skin)
            .map_or_else(|| (SMatrix::zeros(), reading.bias), |b| (b.cross, b.variance))
    }

    /// What a reading differs by from what is expected.
    pub(crate) fn innovation(&self, reading: &Reading) -> Innovation {
        let (mean, covariance) = self.head();
        let (cross, bias) = self.bias_of(reading);
        let cross = cross.fixed_rows::<3>(0).into_owned();
        Innovation {
            value: reading.value - mean,
            covariance: covariance + cross + cross.transpose() + bias + reading.noise,
        }
    }

    /// Takes a reading. One whose covariance is none is skipped.
    pub(crate) fn update(&mut self, reading: &Reading) {
        let innovation = self.innovation(reading);
        let Some(inverse) = innovation.covariance.try_inverse() else { return };
        let (cross, variance) = self.bias_of(reading);
        let gain = (self.covariance.fixed_columns::<3>(0) + cross) * inverse;
        self.mean += gain * innovation.value;
        self.covariance -= gain * innovation.covariance * gain.transpose();
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
        if !self.biases.iter().any(|b| b.skin == reading.skin) {
            self.biases.push(Bias { skin: reading.skin, variance, cross });
        }
        for bias in &mut self.biases {
            let mut moved = bias.cross.fixed_rows::<3>(0).into_owned();
            if bias.skin == reading.skin {
                moved += variance;
            }
            bias.cross -= gain * moved;
        }
    }

    /// Begins anew at a reading, and keeps what the state was beyond its first three components as little as [`begin`](Self::begin).
    pub(crate) fn reset(&mut self, reading: &Reading, rest: f64) {
        *self = Self::begin(reading, rest);
    }

    /// The state that two estimates of it make together, their errors independent but for biases of skins that are in both, which are
    /// dropped from the second.
    pub(crate) fn merged(&self, other: &Self) -> Option<Self> {
        let inverse = (self.covariance + other.covariance).try_inverse()?;
        let of_other = self.covariance * inverse;
        let of_self = SMatrix::<f64, N, N>::identity() - of_other;
        let covariance = of_self * self.covariance;
        let mut biases: Vec<Bias<N>> =
            self.biases.iter().map(|b| Bias { cross: of_self * b.cross, ..b.clone() }).collect();
        for bias in &other.biases {
            if !biases.iter().any(|b| b.skin == bias.skin) {
                biases.push(Bias { cross: of_other * bias.cross, ..bias.clone() });
            }
        }
        Some(Self {
            mean: of_self * self.mean + of_other * other.mean,
            covariance: (covariance + covariance.transpose()) * 0.5,
            biases,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix6;

    fn reading(skin: usize, value: f64, noise: f64, bias: f64) -> Reading {
        Reading {
            skin,
            value: Vector3::repeat(value),
            noise: Matrix3::from_diagonal_element(noise),
            bias: Matrix3::from_diagonal_element(bias),
        }
    }

    /// What stays does not average out, and what two skins say independently does.
    #[test]
    fn a_bias_stays_in_the_covariance() {
        let mut filter = Filter::<3>::begin(&reading(0, 1.0, 1.0, 4.0), 0.0);
        for _ in 0..10_000 {
            filter.update(&reading(0, 1.0, 1.0, 4.0));
        }
        assert!((filter.covariance[(0, 0)] - 4.0).abs() < 1e-3, "{}", filter.covariance);
        for _ in 0..10_000 {
            filter.update(&reading(1, 3.0, 1.0, 4.0));
        }
        // The mean of two biases has half the variance. What is not estimated is reached slowly: the gain falls with the information.
        assert!((2.0..2.3).contains(&filter.covariance[(0, 0)]), "{}", filter.covariance);
        assert!((1.8..2.2).contains(&filter.mean[0]), "{}", filter.mean);
    }

    /// Against the same estimate with the biases as states: batch least squares over all readings.
    #[test]
    fn it_is_the_best_linear_estimate_of_the_first_readings() {
        // Two readings of skin 0, one of skin 1: e = x − Σ w z with covariance M = R + B where skins agree.
        let (noise, bias) = ([1.0, 1.0, 0.5], [2.0, 2.0, 3.0]);
        let m = Matrix3::new(
            noise[0] + bias[0],
            bias[0],
            0.0,
            bias[0],
            noise[1] + bias[1],
            0.0,
            0.0,
            0.0,
            noise[2] + bias[2],
        );
        let information = (m.try_inverse().unwrap() * Vector3::repeat(1.0)).sum();
        let mut filter = Filter::<3>::begin(&reading(0, 1.0, 1.0, 2.0), 0.0);
        filter.update(&reading(0, 2.0, 1.0, 2.0));
        filter.update(&reading(1, 4.0, 0.5, 3.0));
        assert!((filter.covariance[(1, 1)] - 1.0 / information).abs() < 1e-12);
        let weights = m.try_inverse().unwrap() * Vector3::repeat(1.0) / information;
        assert!((filter.mean[2] - weights.dot(&Vector3::new(1.0, 2.0, 4.0))).abs() < 1e-12);
    }

    #[test]
    fn two_estimates_make_one() {
        let a = Filter::<6>::begin(&reading(0, 0.0, 1.0, 1.0), 1.0);
        let b = Filter::<6>::begin(&reading(1, 3.0, 3.0, 1.0), 1.0);
        let both = a.merged(&b).unwrap();
        assert!((both.mean[0] - 1.0).abs() < 1e-12, "{}", both.mean);
        assert!((both.covariance[(0, 0)] - 4.0 / 3.0).abs() < 1e-12);
        assert_eq!(both.biases.len(), 2);
        // The same as taking the second's reading.
        let mut filter = a;
        filter.predict(&Matrix6::identity(), &Matrix6::zeros());
        filter.update(&reading(1, 3.0, 3.0, 1.0));
        assert!((filter.covariance[(0, 0)] - both.covariance[(0, 0)]).abs() < 1e-12);
        assert!((filter.biases[1].cross[(0, 0)] - both.biases[1].cross[(0, 0)]).abs() < 1e-12);
    }
}
