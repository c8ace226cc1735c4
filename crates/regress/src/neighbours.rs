//! Means of the nearest rows.

use crate::{RegressError, Rows, Standard};

/// Regression by nearest neighbours: the mean of the targets of the rows that lie nearest, weighted with the inverse of their
/// distance.
#[derive(Debug, Clone)]
pub struct Neighbours {
    standard: Standard,
    inputs: Vec<f64>,
    targets: Vec<f64>,
    outputs: usize,
    count: usize,
}

impl Neighbours {
    /// Keeps all rows; `count` of them answer each time. Columns count alike: they are divided by their spread.
    ///
    /// # Errors
    ///
    /// [`RegressError`] where the tables do not have equally many rows or `count` is 0.
    pub fn fit(inputs: Rows<'_>, targets: Rows<'_>, count: usize) -> Result<Self, RegressError> {
        Self::scaled_by(Standard::of(&inputs), inputs, targets, count)
    }

    /// As [`fit`](Self::fit), with columns that are of one scale already, as readings in deviations of their noise are.
    ///
    /// # Errors
    ///
    /// As [`fit`](Self::fit).
    pub fn fit_as_given(inputs: Rows<'_>, targets: Rows<'_>, count: usize) -> Result<Self, RegressError> {
        let width = inputs.width();
        let standard = Standard { mean: vec![0.0; width], spread: vec![1.0; width] };
        Self::scaled_by(standard, inputs, targets, count)
    }

    fn scaled_by(
        standard: Standard,
        inputs: Rows<'_>,
        targets: Rows<'_>,
        count: usize,
    ) -> Result<Self, RegressError> {
        if targets.count() != inputs.count() {
            return Err(RegressError::Size {
                what: "the table of targets",
                found: targets.count(),
                expected: inputs.count(),
            });
        }
        if count == 0 {
            return Err(RegressError::Setting { name: "count", value: 0.0, must: "at least 1" });
        }
        let mut scaled = Vec::with_capacity(inputs.count() * inputs.width());
        inputs.iter().for_each(|row| standard.push(row, &mut scaled));
        Ok(Self {
            standard,
            inputs: scaled,
            targets: targets.iter().flatten().copied().collect(),
            outputs: targets.width(),
            count: count.min(inputs.count()),
        })
    }

    /// The answer to one row.
    ///
    /// # Errors
    ///
    /// [`RegressError::Size`] for a row of another width.
    pub fn predict(&self, row: &[f64]) -> Result<Vec<f64>, RegressError> {
        let width = self.standard.mean.len();
        if row.len() != width {
            return Err(RegressError::Size { what: "a row", found: row.len(), expected: width });
        }
        let mut scaled = Vec::with_capacity(width);
        self.standard.push(row, &mut scaled);
        let mut nearest: Vec<(f64, usize)> = Vec::with_capacity(self.count + 1);
        for (index, other) in self.inputs.chunks_exact(width).enumerate() {
            let distance: f64 = scaled.iter().zip(other).map(|(a, b)| (a - b) * (a - b)).sum();
            if nearest.len() < self.count || nearest.last().is_some_and(|(worst, _)| distance < *worst) {
                let at = nearest.partition_point(|(d, _)| *d < distance);
                nearest.insert(at, (distance, index));
                nearest.truncate(self.count);
            }
        }
        let mut out = vec![0.0; self.outputs];
        let mut total = 0.0;
        for (distance, index) in nearest {
            // A row that was learnt answers itself.
            let weight = 1.0 / distance.max(1e-24).sqrt();
            let target = &self.targets[index * self.outputs..(index + 1) * self.outputs];
            out.iter_mut().zip(target).for_each(|(o, t)| *o += weight * t);
            total += weight;
        }
        out.iter_mut().for_each(|o| *o /= total);
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_that_are_of_one_scale_stay() {
        let (inputs, targets) = ([0.0, 0.0, 1.0, 0.0, 0.0, 100.0], [1.0, 2.0, 3.0]);
        let (inputs, targets) =
            (Rows::new(&inputs, 2, "inputs").unwrap(), Rows::new(&targets, 1, "targets").unwrap());
        let predicted = |model: Neighbours| model.predict(&[0.9, 60.0]).unwrap()[0];
        // In spreads of the columns, 0.47 and 47, the second row is nearest; as given it is the third.
        assert!((predicted(Neighbours::fit(inputs, targets, 1).unwrap()) - 2.0).abs() < 1e-12);
        assert!((predicted(Neighbours::fit_as_given(inputs, targets, 1).unwrap()) - 3.0).abs() < 1e-12);
    }

    #[test]
    fn near_rows_answer() {
        let inputs = [0.0, 0.0, 1.0, 0.0, 0.0, 100.0];
        let targets = [1.0, 2.0, 3.0];
        let rows = Rows::new(&inputs, 2, "inputs").unwrap();
        let model = Neighbours::fit(rows, Rows::new(&targets, 1, "targets").unwrap(), 2).unwrap();
        assert!((model.predict(&[0.0, 0.0]).unwrap()[0] - 1.0).abs() < 1e-9);
        assert!((model.predict(&[0.5, 0.0]).unwrap()[0] - 1.5).abs() < 1e-9);
        assert!(model.predict(&[0.5]).is_err());
        assert!(Neighbours::fit(rows, Rows::new(&targets, 1, "targets").unwrap(), 0).is_err());
    }
}
