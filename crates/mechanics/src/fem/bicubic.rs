//! Smooth interpolation on a regular grid.

use dermis_skin::cache::{Bytes, Keep};

/// Points of the grid, along each coordinate, that are looked up at once.
const WINDOW: usize = 20;

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

impl Keep for Bicubic {
    fn put(&self, out: &mut Vec<u8>) {
        self.start.put(out);
        self.step.put(out);
        self.count.map(|c| c as u64).put(out);
        (self.width as u64).put(out);
        self.values.put(out);
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        let (start, step) = (Keep::take(from)?, Keep::take(from)?);
        let [a, b, width] = <[u64; 3]>::take(from)?.map(|n| usize::try_from(n).unwrap_or(usize::MAX));
        let values = Vec::<f64>::take(from)?;
        let fits = a.checked_add(2)?.checked_mul(b.checked_add(2)?)?.checked_mul(width)? == values.len();
        (fits && a >= 2 && b >= 2).then_some(Self { start, step, count: [a, b], width, values })
    }
}

impl Bicubic {
    /// `count` points (at least two) along each coordinate, from `start` in steps of `step`; `value` writes the `width`
    /// numbers at a point, given by its indices. It is called for one point beyond either end, too (−1 and `count`).
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

    /// Moves every value towards that of `other` by `share` of the way.
    ///
    /// # Panics
    ///
    /// Where the other has not as many values.
    pub fn mix(&mut self, other: &Self, share: f64) {
        assert_eq!((self.count, self.width), (other.count, other.width));
        for (a, b) in self.values.iter_mut().zip(&other.values) {
            *a += share * (b - *a);
        }
    }

    /// The vectors of every `of`-th number of this one's, from the number `first` on.
    ///
    /// # Panics
    ///
    /// Where `of` does not divide the width, or is no larger than `first`.
    #[must_use]
    pub fn every(&self, of: usize, first: usize) -> Self {
        assert!(first < of && self.width.is_multiple_of(of));
        let values = self.values.iter().skip(first).step_by(of).copied().collect();
        Self { width: self.width / of, values, ..*self }
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
        for (di, a) in along.iter().enumerate() {
            for (dj, b) in across.iter().enumerate() {
                self.add_point(i + di, j + dj, weight * a * b, out);
            }
        }
    }

    /// Adds the vectors at all of `points` (u, v, weight) to `out`. Where they lie close together, as those of one contact
    /// do, this takes less time than one by one: every point of the grid is looked up once.
    ///
    /// # Panics
    ///
    /// As [`add`](Self::add).
    pub fn add_all(&self, points: &[[f64; 3]], out: &mut [f64]) {
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for point in points {
            for axis in 0..2 {
                let (first, _) = self.place(axis, point[axis]);
                low[axis] = low[axis].min(first);
                high[axis] = high[axis].max(first + 4);
            }
        }
        let mut weights = [0.0; WINDOW * WINDOW];
        if (0..2).any(|axis| high[axis] > low[axis] + WINDOW) || points.is_empty() {
            for &[u, v, weight] in points {
                self.add(u, v, weight, out);
            }
            return;
        }
        for &[u, v, weight] in points {
            let (i, along) = self.place(0, u);
            let (j, across) = self.place(1, v);
            for (di, a) in along.iter().enumerate() {
                for (dj, b) in across.iter().enumerate() {
                    weights[(i + di - low[0]) * WINDOW + j + dj - low[1]] += weight * a * b;
                }
            }
        }
        for i in low[0]..high[0] {
            for j in low[1]..high[1] {
                let weight = weights[(i - low[0]) * WINDOW + j - low[1]];
                if weight != 0.0 {
                    self.add_point(i, j, weight, out);
                }
            }
        }
    }

    fn add_point(&self, i: usize, j: usize, weight: f64, out: &mut [f64]) {
        let at = (i * (self.count[1] + 2) + j) * self.width;
        let values = &self.values[at..at + self.width];
        assert_eq!(out.len(), values.len());
        for (o, value) in out.iter_mut().zip(values) {
            *o += weight * value;
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
    fn parts_are_those_of_the_whole() {
        let (mut whole, mut part) = ([0.0; 2], [0.0; 1]);
        table().add(0.2, 2.4, 1.5, &mut whole);
        table().every(2, 1).add(0.2, 2.4, 1.5, &mut part);
        assert_eq!(part[0], whole[1]);
    }

    #[test]
    fn many_at_once_are_the_same() {
        for spread in [0.1, 3.0] {
            let points: Vec<[f64; 3]> = (0..9)
                .map(|i| {
                    [-0.9 + spread * f64::from(i % 3), 2.1 + spread * f64::from(i / 3), 0.1 * f64::from(i)]
                })
                .collect();
            let (mut one, mut all) = ([0.0; 2], [0.0; 2]);
            points.iter().for_each(|p| table().add(p[0], p[1], p[2], &mut one));
            table().add_all(&points, &mut all);
            approx::assert_relative_eq!(one[..], all[..], max_relative = 1e-12);
        }
    }

    #[test]
    fn no_question_panics() {
        for bad in [f64::NAN, f64::INFINITY, -1e300, 1e300] {
            table().add(bad, bad, 1.0, &mut [0.0; 2]);
            table().add_all(&[[bad, 0.0, 1.0], [0.0, bad, 1.0]], &mut [0.0; 2]);
        }
    }
}
