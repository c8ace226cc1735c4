//! Smooth interpolation on a regular grid.

/// Vectors at the points of a regular grid in two coordinates, interpolated by Catmull-Rom cubics: continuous together
/// with their first derivatives.
#[derive(Debug, Clone)]
pub struct Bicubic {
    start: [f64; 2],
    step: [f64; 2],
    /// Points along each coordinate, without the one more at either end that cubics need.
    count: [usize; 2],
    width: usize,
    /// Rows of the first coordinate, then of the second, `width` numbers each.
    values: Vec<f64>,
}

impl Bicubic {
    /// `count` points (at least two) along each coordinate, from `start` in steps of `step`; `value` writes the `width`
    /// numbers at a point, given by its indices. It is asked for one point beyond either end, too (−1 and `count`).
    #[must_use]
    pub fn new(
        start: [f64; 2],
        step: [f64; 2],
        count: [usize; 2],
        width: usize,
        mut value: impl FnMut([isize; 2], &mut [f64]),
    ) -> Self {
        let padded = count.map(|c| c + 2);
        let mut values = vec![0.0; padded[0] * padded[1] * width];
        if width > 0 {
            for (place, out) in values.chunks_exact_mut(width).enumerate() {
                value([(place / padded[1]) as isize - 1, (place % padded[1]) as isize - 1], out);
            }
        }
        Self { start, step, count, width, values }
    }

    /// Numbers at a point.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Adds `weight` times the vector at (`u`, `v`) to `out`. Outside of the grid, the value of its edge is taken.
    ///
    /// # Panics
    ///
    /// Where `out` is not as long as a vector of the grid.
    pub fn add(&self, u: f64, v: f64, weight: f64, out: &mut [f64]) {
        let (i, along) = self.place(0, u);
        let (j, across) = self.place(1, v);
        let columns = self.count[1] + 2;
        assert_eq!(out.len(), self.width);
        for (di, a) in along.iter().enumerate() {
            for (dj, b) in across.iter().enumerate() {
                let at = ((i + di) * columns + j + dj) * self.width;
                let factor = weight * a * b;
                for (o, value) in out.iter_mut().zip(&self.values[at..at + self.width]) {
                    *o += factor * value;
                }
            }
        }
    }

    /// First of the four points around a coordinate, counted from the one before the start, and their weights.
    fn place(&self, axis: usize, at: f64) -> (usize, [f64; 4]) {
        let last = (self.count[axis] - 1) as f64;
        // What is not a number becomes the start: the caller has checked it, and indices must hold in any case.
        let x = ((at - self.start[axis]) / self.step[axis]).clamp(0.0, last).max(0.0);
        let i = (x as usize).min(self.count[axis] - 2);
        let t = x - i as f64;
        let weights = [
            ((2.0 - t) * t - 1.0) * t * 0.5,
            ((3.0 * t - 5.0) * t * t + 2.0) * 0.5,
            ((4.0 - 3.0 * t) * t + 1.0) * t * 0.5,
            (t - 1.0) * t * t * 0.5,
        ];
        (i, weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Bicubic {
        Bicubic::new([-1.0, 2.0], [0.5, 0.25], [5, 7], 2, |[i, j], out| {
            let (x, y) = (-1.0 + 0.5 * i as f64, 2.0 + 0.25 * j as f64);
            out[0] = 1.0 + x - 2.0 * y + x * x + 0.5 * x * y;
            out[1] = y * y;
        })
    }

    #[test]
    fn quadratics_are_exact() {
        for (x, y) in [(-1.0, 2.0), (-0.9, 2.1), (0.33, 2.77), (1.0, 3.5)] {
            let mut out = [10.0, 0.0];
            table().add(x, y, 2.0, &mut out);
            approx::assert_relative_eq!(
                out[0],
                10.0 + 2.0 * (1.0 + x - 2.0 * y + x * x + 0.5 * x * y),
                epsilon = 1e-12
            );
            approx::assert_relative_eq!(out[1], 2.0 * y * y, epsilon = 1e-12);
        }
    }

    #[test]
    fn no_question_panics() {
        for bad in [f64::NAN, f64::INFINITY, -1e300, 1e300] {
            table().add(bad, bad, 1.0, &mut [0.0; 2]);
        }
    }
}
