//! What happens to an input before the first layer, in training and inside of the graph.

use dermis_inference::FeatureConfig;
use dermis_inference::onnx::{GraphBuilder, Value};

use super::config::InputForm;

/// Takes the first block of an input apart into direction and magnitude, and normalises every column.
#[derive(Debug, Clone, PartialEq)]
pub struct Preparation {
    /// For [`InputForm::Direction`]: factor and offset from normalised readings to multiples of the noise.
    direction: Option<(Vec<f32>, Vec<f32>)>,
    /// Subtracted from every column.
    centre: Vec<f32>,
    /// Every column is multiplied by it after that.
    factor: Vec<f32>,
    width: usize,
}

impl Preparation {
    /// Measures the columns over rows that lie end to end. `noise` is the standard deviation of every channel, in
    /// the unit of the skin.
    #[must_use]
    pub fn measure(form: InputForm, features: &FeatureConfig, noise: &[f64], rows: &[f32]) -> Self {
        let width = features.input_len();
        let mut plain = Self { direction: None, centre: vec![0.0; width], factor: vec![1.0; width], width };
        if form == InputForm::Plain {
            return plain;
        }
        // The magnitude of the noise alone: weaker signals have no direction.
        let floor = noise.iter().map(|n| n * n).sum::<f64>().sqrt() as f32;
        plain.direction = Some((
            features.scale.iter().map(|s| s / floor).collect(),
            features.mean.iter().map(|m| m / floor).collect(),
        ));
        let columns = width + 1;
        (plain.centre, plain.factor) = (vec![0.0; columns], vec![1.0; columns]);
        let prepared = plain.apply(rows);
        let count = (prepared.len() / columns).max(1) as f64;
        let (mut sums, mut squares) = (vec![0.0_f64; columns], vec![0.0_f64; columns]);
        for row in prepared.chunks_exact(columns) {
            for ((sum, square), v) in sums.iter_mut().zip(&mut squares).zip(row) {
                *sum += f64::from(*v);
                *square += f64::from(*v) * f64::from(*v);
            }
        }
        for (i, (sum, square)) in sums.iter().zip(&squares).enumerate() {
            let mean = sum / count;
            let deviation = (square / count - mean * mean).max(0.0).sqrt();
            plain.centre[i] = mean as f32;
            plain.factor[i] = if deviation > 1e-6 { (1.0 / deviation) as f32 } else { 1.0 };
        }
        plain
    }

    /// Columns that come out.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.centre.len()
    }

    /// Prepares rows that lie end to end.
    #[must_use]
    pub fn apply(&self, rows: &[f32]) -> Vec<f32> {
        let mut all = Vec::with_capacity(rows.len() / self.width.max(1) * self.columns());
        for row in rows.chunks_exact(self.width) {
            let start = all.len();
            if let Some((factor, offset)) = &self.direction {
                let (first, rest) = row.split_at(factor.len());
                all.extend(first.iter().zip(factor).zip(offset).map(|((z, f), o)| z * f + o));
                let magnitude = (all[start..].iter().map(|x| x * x).sum::<f32>() + 1.0).sqrt();
                all[start..].iter_mut().for_each(|x| *x /= magnitude);
                all.push(magnitude.ln());
                all.extend_from_slice(rest);
            } else {
                all.extend_from_slice(row);
            }
            for ((v, c), f) in all[start..].iter_mut().zip(&self.centre).zip(&self.factor) {
                *v = (*v - c) * f;
            }
        }
        all
    }

    /// The same as operators of a graph; `input` is \\[1, width\\].
    pub fn to_graph(&self, g: &mut GraphBuilder, input: &Value) -> Value {
        let Some((factor, offset)) = &self.direction else { return input.clone() };
        let channels = factor.len();
        let end = i64::try_from(channels).unwrap_or(i64::MAX);
        let first = if channels < self.width { g.slice(input, 1, 0, end) } else { input.clone() };
        let factor = g.constant("noise_factor", &[1, channels], factor);
        let offset = g.constant("noise_offset", &[1, channels], offset);
        let scaled = g.mul(&first, &factor);
        let scaled = g.add(&scaled, &offset);
        let squares = g.mul(&scaled, &scaled);
        let sum = g.reduce_sum(&squares, 1);
        let one = g.constant("one", &[1, 1], &[1.0]);
        let sum = g.add(&sum, &one);
        let magnitude = g.sqrt(&sum);
        let direction = g.div(&scaled, &magnitude);
        let logarithm = g.operator("Log", &[&magnitude], &[], 1).swap_remove(0);
        let joined = if channels < self.width {
            let rest = g.slice(input, 1, end, i64::try_from(self.width).unwrap_or(i64::MAX));
            g.concat(&[&direction, &logarithm, &rest], 1)
        } else {
            g.concat(&[&direction, &logarithm], 1)
        };
        let centre = g.constant("column_centre", &[1, self.columns()], &self.centre);
        let factor = g.constant("column_factor", &[1, self.columns()], &self.factor);
        let centred = g.sub(&joined, &centre);
        g.mul(&centred, &factor)
    }

    /// Numbers that go in.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn direction_does_not_depend_on_the_strength_of_a_signal() {
        let mut features = FeatureConfig::newest(vec![100.0, -50.0], vec![30.0, 20.0]);
        features.low_pass = vec![1.0];
        let row = |signal: [f32; 2]| {
            let z = [(signal[0] - 100.0) / 30.0, (signal[1] + 50.0) / 20.0];
            [z[0], z[1], 0.3, 0.4]
        };
        let rows: Vec<f32> =
            [[600.0, -300.0], [-200.0, 400.0], [10.0, 900.0]].into_iter().flat_map(row).collect();
        let preparation = Preparation::measure(InputForm::Direction, &features, &[1.0, 1.0], &rows);
        assert_eq!((preparation.width(), preparation.columns()), (4, 5));
        let weak = preparation.apply(&row([300.0, -150.0]));
        let strong = preparation.apply(&row([600.0, -300.0]));
        assert!((weak[0] - strong[0]).abs() < 1e-3 && (weak[1] - strong[1]).abs() < 1e-3);
        assert!(strong[2] - weak[2] > 0.1, "the magnitude differs");
        let all = preparation.apply(&rows);
        let mean: f32 = all.chunks(5).map(|r| r[0]).sum::<f32>() / 3.0;
        assert!(mean.abs() < 1e-5);
    }
}
