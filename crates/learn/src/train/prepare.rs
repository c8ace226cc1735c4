//! What happens to an input before the first layer, in training and inside of the graph.

use dermis_inference::FeatureConfig;
use dermis_inference::onnx::{GraphBuilder, Value};

use super::config::InputForm;

/// What is done to the readings of the first tap. Factor and offset, one a channel, lead from normalised readings to what is
/// named.
#[derive(Debug, Clone, PartialEq)]
enum Form {
    /// Nothing.
    Plain,
    /// [`InputForm::Direction`], of multiples of the noise.
    Direction(Vec<f32>, Vec<f32>),
    /// [`InputForm::Ratios`], of multiples of the noise.
    Ratios(Vec<f32>, Vec<f32>),
    /// [`InputForm::Logarithm`], of multiples of the knee.
    Logarithm(Vec<f32>, Vec<f32>),
}

impl Form {
    /// How many channels it changes.
    fn channels(&self) -> usize {
        match self {
            Self::Plain => 0,
            Self::Direction(factor, _) | Self::Ratios(factor, _) | Self::Logarithm(factor, _) => factor.len(),
        }
    }

    /// Columns that it adds.
    fn added(&self) -> usize {
        usize::from(matches!(self, Self::Direction(..)))
    }
}

/// Changes the readings of the first tap as [`InputForm`] says, and normalises every column.
#[derive(Debug, Clone, PartialEq)]
pub struct Preparation {
    form: Form,
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
        let unit = |one: f32| {
            let of = |values: &[f32]| values.iter().map(|v| v / one).collect::<Vec<f32>>();
            (of(&features.scale), of(&features.mean))
        };
        let form = match form {
            InputForm::Plain => Form::Plain,
            InputForm::Direction | InputForm::Ratios => {
                // The magnitude of the noise alone: weaker signals have no direction.
                let floor = noise.iter().map(|n| n * n).sum::<f64>().sqrt() as f32;
                let (factor, offset) = unit(floor);
                let with_magnitude = form == InputForm::Direction;
                if with_magnitude { Form::Direction(factor, offset) } else { Form::Ratios(factor, offset) }
            }
            InputForm::Logarithm => {
                let (factor, offset) = unit(knee(features, noise, rows));
                Form::Logarithm(factor, offset)
            }
        };
        let columns = width + form.added();
        let mut plain = Self { form, centre: vec![0.0; columns], factor: vec![1.0; columns], width };
        if plain.form == Form::Plain {
            return plain;
        }
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
            let (first, rest) = row.split_at(self.form.channels());
            match &self.form {
                Form::Plain => {}
                Form::Direction(factor, offset) | Form::Ratios(factor, offset) => {
                    all.extend(first.iter().zip(factor).zip(offset).map(|((z, f), o)| z * f + o));
                    let magnitude = (all[start..].iter().map(|x| x * x).sum::<f32>() + 1.0).sqrt();
                    all[start..].iter_mut().for_each(|x| *x /= magnitude);
                    if matches!(self.form, Form::Direction(..)) {
                        all.push(magnitude.ln());
                    }
                }
                Form::Logarithm(factor, offset) => {
                    all.extend(first.iter().zip(factor).zip(offset).map(|((z, f), o)| (z * f + o).asinh()));
                }
            }
            all.extend_from_slice(rest);
            for ((v, c), f) in all[start..].iter_mut().zip(&self.centre).zip(&self.factor) {
                *v = (*v - c) * f;
            }
        }
        all
    }

    /// The same as operators of a graph; `input` is \[1, width\].
    pub fn to_graph(&self, g: &mut GraphBuilder, input: &Value) -> Value {
        let (factor, offset, prefix) = match &self.form {
            Form::Plain => return input.clone(),
            Form::Direction(factor, offset) | Form::Ratios(factor, offset) => (factor, offset, "noise"),
            Form::Logarithm(factor, offset) => (factor, offset, "knee"),
        };
        let channels = factor.len();
        let end = i64::try_from(channels).unwrap_or(i64::MAX);
        let first = if channels < self.width { g.slice(input, 1, 0, end) } else { input.clone() };
        let factor = g.constant(&format!("{prefix}_factor"), &[1, channels], factor);
        let offset = g.constant(&format!("{prefix}_offset"), &[1, channels], offset);
        let scaled = g.mul(&first, &factor);
        let scaled = g.add(&scaled, &offset);
        let mut parts = match &self.form {
            Form::Logarithm(..) => vec![g.operator("Asinh", &[&scaled], &[], 1).swap_remove(0)],
            Form::Ratios(..) => vec![direction_to_graph(g, &scaled).0],
            _ => {
                let (direction, magnitude) = direction_to_graph(g, &scaled);
                vec![direction, g.operator("Log", &[&magnitude], &[], 1).swap_remove(0)]
            }
        };
        if channels < self.width {
            parts.push(g.slice(input, 1, end, i64::try_from(self.width).unwrap_or(i64::MAX)));
        }
        let joined = match parts.as_slice() {
            [one] => one.clone(),
            _ => g.concat(&parts.iter().collect::<Vec<_>>(), 1),
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

/// Direction and magnitude of `scaled`.
fn direction_to_graph(g: &mut GraphBuilder, scaled: &Value) -> (Value, Value) {
    let squares = g.mul(scaled, scaled);
    let sum = g.reduce_sum(&squares, 1);
    let one = g.constant("one", &[1, 1], &[1.0]);
    let sum = g.add(&sum, &one);
    let magnitude = g.sqrt(&sum);
    let direction = g.div(scaled, &magnitude);
    (direction, magnitude)
}

/// The strength of a usual signal in the unit of the skin: over the rows, the median of the root mean square of the channels; never
/// below that of the noise.
fn knee(features: &FeatureConfig, noise: &[f64], rows: &[f32]) -> f32 {
    let channels = features.scale.len().max(1);
    let mut strengths: Vec<f64> = rows
        .chunks_exact(features.input_len().max(1))
        .map(|row| {
            let readings = row.iter().zip(&features.scale).zip(&features.mean);
            let squares = readings.map(|((z, scale), mean)| f64::from(z * scale + mean).powi(2));
            (squares.sum::<f64>() / channels as f64).sqrt()
        })
        .filter(|strength| strength.is_finite())
        .collect();
    let floor = (noise.iter().map(|n| n * n).sum::<f64>() / noise.len().max(1) as f64).sqrt();
    let middle = strengths.len() / 2;
    let median =
        if strengths.is_empty() { 0.0 } else { *strengths.select_nth_unstable_by(middle, f64::total_cmp).1 };
    let knee = median.max(floor);
    if knee > 0.0 { knee as f32 } else { 1.0 }
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
        // Without the magnitude, presses of twice the force are one.
        let ratios = Preparation::measure(InputForm::Ratios, &features, &[1.0, 1.0], &rows);
        assert_eq!((ratios.width(), ratios.columns()), (4, 4));
        let [weak, strong] = [[300.0, -150.0], [600.0, -300.0]].map(|signal| ratios.apply(&row(signal)));
        assert!(weak.iter().zip(&strong).all(|(a, b)| (a - b).abs() < 1e-3), "{weak:?} {strong:?}");
        let other = ratios.apply(&row([300.0, 150.0]));
        assert!((other[1] - weak[1]).abs() > 0.1, "{other:?} {weak:?}");
    }

    #[test]
    fn the_logarithm_keeps_small_signals_and_tames_large_ones() {
        let mut features = FeatureConfig::newest(vec![5.0, -2.0], vec![3.0, 2.0]);
        features.low_pass = vec![1.0];
        let row = |signal: [f32; 2]| [(signal[0] - 5.0) / 3.0, (signal[1] + 2.0) / 2.0, 0.3, 0.4];
        // Root mean squares of 1, 2 and 1000: the knee is 2.
        let signals = [[1.0, -1.0], [2.0, 2.0], [1000.0, -1000.0]];
        let rows: Vec<f32> = signals.into_iter().flat_map(row).collect();
        let preparation = Preparation::measure(InputForm::Logarithm, &features, &[0.1, 0.1], &rows);
        assert_eq!((preparation.width(), preparation.columns()), (4, 4));
        let all = preparation.apply(&rows);
        // Columns are normalised over the rows; the spacing of the three is that of asinh(x / 2).
        let [a, b, c] = [1.0_f32, 2.0, 1000.0].map(|x| (x / 2.0).asinh());
        let share = (all[4] - all[0]) / (all[8] - all[0]);
        assert!((share - (b - a) / (c - a)).abs() < 1e-4, "{share}");
        assert!(all.chunks(4).map(|r| r[1]).sum::<f32>().abs() < 1e-5, "the mean of a column is 0");
        // What is weaker than the noise has the noise for its knee.
        let weak = Preparation::measure(InputForm::Logarithm, &features, &[50.0, 50.0], &rows);
        assert!(matches!(&weak.form, Form::Logarithm(factor, _) if (factor[0] - 3.0 / 50.0).abs() < 1e-6));
    }
}
