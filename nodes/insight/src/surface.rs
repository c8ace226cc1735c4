//! The points at which forces are reported: rings around the axis, about one spacing apart along and across, and the triangles between them.

use std::f64::consts::TAU;

use dermis_skin::TriangleMesh;
use nalgebra::Point3;

use crate::shape::Thumb;

/// Rings of points on the outside, the tip first.
#[derive(Debug, Clone, PartialEq)]
pub struct Rings {
    /// Number of points of each ring, the tip alone first.
    counts: Vec<usize>,
    /// Number of points before each ring.
    starts: Vec<usize>,
    /// \[m\] along the meridian between rings.
    step: f64,
}

/// Points of [`Rings`] by number, with weights that sum to 1.
pub type Weights = [(usize, f64); 4];

impl Rings {
    /// Rings from the tip down to the way `end` \[m\] along the meridian.
    #[must_use]
    pub fn new(thumb: &Thumb, end: f64, spacing: f64) -> Self {
        let rows = (end / spacing).round().max(1.0);
        let step = end / rows;
        let mut counts = vec![1];
        counts.extend((1..=rows as usize).map(|row| {
            let around = TAU * thumb.meridian(row as f64 * step, 0.0)[0];
            (around / spacing).round().max(6.0) as usize
        }));
        let starts = counts
            .iter()
            .scan(0, |sum, count| {
                *sum += count;
                Some(*sum - count)
            })
            .collect();
        Self { counts, starts, step }
    }

    /// How many points there are.
    #[must_use]
    pub fn points(&self) -> usize {
        self.counts.iter().sum()
    }

    /// (s, φ) of every point. Every second ring is turned by half a point.
    #[must_use]
    pub fn locations(&self) -> Vec<[f64; 2]> {
        let ring = |(row, count): (usize, &usize)| {
            let (count, step) = (*count, self.step);
            (0..count).map(move |i| [row as f64 * step, azimuth(row, count, i)])
        };
        self.counts.iter().enumerate().flat_map(ring).collect()
    }

    /// The four points around (s, φ), two on either ring, with weights that are linear in between. Below the last ring, that ring.
    #[must_use]
    pub fn weights(&self, s: f64, phi: f64) -> Weights {
        let rows = self.counts.len() - 1;
        let at = (s / self.step).clamp(0.0, rows as f64);
        let row = (at as usize).min(rows - 1);
        let lower = at - row as f64;
        let on = |row: usize, share: f64| {
            let (count, start) = (self.counts[row], self.starts[row]);
            let place = (phi / TAU * count as f64 - turn(row)).rem_euclid(count as f64);
            let first = (place as usize).min(count - 1);
            let beyond = place - first as f64;
            [(start + first, share * (1.0 - beyond)), (start + (first + 1) % count, share * beyond)]
        };
        let ([a, b], [c, d]) = (on(row, 1.0 - lower), on(row + 1, lower));
        [a, b, c, d]
    }

    /// Triangles between neighbouring rings, counter-clockwise seen from outside.
    fn triangles(&self) -> Vec<[usize; 3]> {
        let mut triangles = Vec::new();
        for row in 1..self.counts.len() {
            let ([n, m], [upper, lower]) =
                ([row - 1, row].map(|r| self.counts[r]), [row - 1, row].map(|r| self.starts[r]));
            if n == 1 {
                triangles.extend((0..m).map(|j| [upper, lower + j, lower + (j + 1) % m]));
                continue;
            }
            // Both rings are walked once around; the next corner is that of the smaller azimuth.
            let angle = |row: usize, count: usize, i: usize| (i as f64 + turn(row)) / count as f64;
            let (mut i, mut j) = (0, 0);
            while i < n || j < m {
                let over = i < n && (j == m || angle(row - 1, n, i + 1) <= angle(row, m, j + 1));
                if over {
                    triangles.push([upper + i % n, lower + j % m, upper + (i + 1) % n]);
                    i += 1;
                } else {
                    triangles.push([upper + i % n, lower + j % m, lower + (j + 1) % m]);
                    j += 1;
                }
            }
        }
        triangles
    }

    /// The triangulated outside.
    ///
    /// # Errors
    ///
    /// What is wrong with the triangles: spacings that are too wide for the thumb.
    pub fn mesh(&self, thumb: &Thumb) -> Result<TriangleMesh, String> {
        let points: Vec<Point3<f64>> =
            self.locations().into_iter().map(|[s, phi]| thumb.point(s, phi, 0.0).0).collect();
        TriangleMesh::from_triangles(points, &self.triangles(), 1)
    }
}

/// Share of a point by which a ring is turned.
fn turn(row: usize) -> f64 {
    if row.is_multiple_of(2) { 0.0 } else { 0.5 }
}

fn azimuth(row: usize, count: usize, i: usize) -> f64 {
    (i as f64 + turn(row)) / count as f64 * TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_as_far_apart_as_requested() {
        let thumb = Thumb::new(0.020, 0.070, 0.009).unwrap();
        let end = thumb.way_to(0.0115);
        let rings = Rings::new(&thumb, end, 0.001135);
        // The thesis has 3,800 points on 4,800 mm².
        assert!((3780..3820).contains(&rings.points()), "{}", rings.points());
        let area = thumb.area(end);
        assert!((area - 4.8e-3).abs() < 0.1e-3, "{area}");
        rings.mesh(&thumb).unwrap();
        for spacing in [0.002, 0.0035, 0.006] {
            Rings::new(&thumb, end, spacing).mesh(&thumb).unwrap();
        }
    }

    #[test]
    fn weights_are_linear_in_between() {
        let thumb = Thumb::new(0.020, 0.070, 0.009).unwrap();
        let rings = Rings::new(&thumb, 0.060, 0.003);
        for (i, [s, phi]) in rings.locations().into_iter().enumerate() {
            let weights = rings.weights(s + 1e-12, phi + 1e-12);
            let own: f64 = weights.iter().filter(|(p, _)| *p == i).map(|(_, w)| w).sum();
            assert!(own > 1.0 - 1e-6, "{i}: {weights:?}");
        }
        for k in 0..500 {
            let (s, phi) = (f64::from(k) * 1.3e-4, f64::from(k) * 0.7);
            let sum: f64 = rings.weights(s, phi).iter().map(|(_, w)| w).sum();
            assert!((sum - 1.0).abs() < 1e-12);
        }
    }
}
