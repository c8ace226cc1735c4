//! The outline of a sheet, and where electrodes are on it.

use std::f64::consts::TAU;

use crate::ElectricsError;

/// A closed outline about the origin that every ray from there meets once, with electrodes in counter-clockwise order.
///
/// Between electrodes the radius is a periodic cubic through their centres in the angle (Catmull–Rom), so that a circle of electrodes
/// that are evenly spaced is a circle.
#[derive(Debug, Clone, PartialEq)]
pub struct Rim {
    /// Angle \[rad\], growing within one turn, and radius of every electrode's centre.
    centres: Vec<(f64, f64)>,
    /// Half of an electrode's width, as an angle \[rad\].
    half: f64,
}

impl Rim {
    /// A circle of `radius`, with the first electrode at angle 0. `share` of the rim is covered by electrodes.
    ///
    /// # Errors
    ///
    /// [`ElectricsError::Value`].
    pub fn circle(radius: f64, electrodes: usize, share: f64) -> Result<Self, ElectricsError> {
        let angle = |k: usize| TAU * k as f64 / electrodes as f64;
        let points: Vec<[f64; 2]> =
            (0..electrodes).map(|k| [radius * angle(k).cos(), radius * angle(k).sin()]).collect();
        Self::through(&points, share)
    }

    /// Through the centres of the electrodes, in counter-clockwise order about the origin. Each electrode covers the same angle, all of
    /// them together `share` of a turn.
    ///
    /// # Errors
    ///
    /// [`ElectricsError`] where there are fewer than four, one lies at the origin, they do not go round once, or they would overlap.
    pub fn through(points: &[[f64; 2]], share: f64) -> Result<Self, ElectricsError> {
        let value = |what, value, must| Err(ElectricsError::Value { what, value, must });
        if points.len() < 4 {
            return value("the number of electrodes", points.len() as f64, "at least 4");
        }
        if !(share > 0.0 && share < 1.0) {
            return value("the share of the rim that electrodes cover", share, "above 0 and below 1");
        }
        let mut centres: Vec<(f64, f64)> = Vec::with_capacity(points.len());
        for [x, y] in points {
            let radius = x.hypot(*y);
            if !(radius.is_finite() && radius > 0.0) {
                return value("an electrode's distance from the middle", radius, "a positive number");
            }
            let mut angle = y.atan2(*x);
            if let Some((before, _)) = centres.last() {
                angle = before + (angle - before).rem_euclid(TAU);
            }
            centres.push((angle, radius));
        }
        let half = 0.5 * TAU * share / points.len() as f64;
        let first = centres[0].0;
        for second in 0..centres.len() {
            let before = (second + centres.len() - 1) % centres.len();
            let gap = (centres[second].0 - centres[before].0).rem_euclid(TAU);
            if gap < 2.0 * half * (1.0 + 1e-9) {
                return Err(ElectricsError::Overlap { first: before, second });
            }
        }
        let turn = centres[centres.len() - 1].0 - first;
        if turn >= TAU {
            return value("the angle from the first to the last electrode", turn, "below a whole turn");
        }
        Ok(Self { centres, half })
    }

    /// Number of electrodes.
    #[must_use]
    pub fn electrodes(&self) -> usize {
        self.centres.len()
    }

    /// Angles \[rad\] at which an electrode begins and ends.
    #[must_use]
    pub fn span(&self, electrode: usize) -> [f64; 2] {
        let (angle, _) = self.centres[electrode];
        [angle - self.half, angle + self.half]
    }

    /// Radius at an angle.
    #[must_use]
    pub fn radius(&self, angle: f64) -> f64 {
        let n = self.centres.len();
        let first = self.centres[0].0;
        let turned = first + (angle - first).rem_euclid(TAU);
        let at = self.centres.partition_point(|(a, _)| *a <= turned).saturating_sub(1);
        // The four electrodes about it, as if they went on for ever.
        let point = |step: isize| {
            let index = (at as isize + step).rem_euclid(n as isize) as usize;
            let turns = (at as isize + step).div_euclid(n as isize) as f64;
            (self.centres[index].0 + TAU * turns, self.centres[index].1)
        };
        let [before, left, right, after] = [-1, 0, 1, 2].map(point);
        let width = right.0 - left.0;
        let t = (turned - left.0) / width;
        let slope = |a: (f64, f64), b: (f64, f64)| (b.1 - a.1) / (b.0 - a.0) * width;
        let (at_left, at_right) = (slope(before, right), slope(left, after));
        let (square, cube) = (t * t, t * t * t);
        (2.0 * cube - 3.0 * square + 1.0) * left.1
            + (cube - 2.0 * square + t) * at_left
            + (3.0 * square - 2.0 * cube) * right.1
            + (cube - square) * at_right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outline_goes_through_the_electrodes() {
        let ellipse = |k: usize| {
            let angle = TAU * (k as f64 + 0.3) / 16.0;
            [1.7 * angle.cos(), 1.2 * angle.sin()]
        };
        let points: Vec<[f64; 2]> = (0..16).map(ellipse).collect();
        let rim = Rim::through(&points, 0.3).unwrap();
        for (k, [x, y]) in points.iter().enumerate() {
            let [from, to] = rim.span(k);
            let middle = f64::midpoint(from, to);
            assert!((rim.radius(middle) - x.hypot(*y)).abs() < 1e-12);
            assert!((middle.sin() - y / x.hypot(*y)).abs() < 1e-9);
            assert!((rim.radius(middle + TAU) - rim.radius(middle)).abs() < 1e-9);
        }
        // Between them it follows the ellipse, within what a cubic over 22 degrees can.
        for step in 0..200 {
            let angle = TAU * f64::from(step) / 200.0;
            let true_radius = 1.0 / (angle.cos() / 1.7).hypot(angle.sin() / 1.2);
            assert!((rim.radius(angle) - true_radius).abs() < 0.01, "{angle}: {}", rim.radius(angle));
        }
        let circle = Rim::circle(2.0, 8, 0.5).unwrap();
        assert!((0..100).all(|i| (circle.radius(f64::from(i) * 0.1) - 2.0).abs() < 1e-12));
    }

    #[test]
    fn what_is_no_outline_is_refused() {
        assert!(Rim::circle(1.0, 3, 0.3).unwrap_err().to_string().contains("at least 4"));
        assert!(Rim::circle(1.0, 8, 1.0).unwrap_err().to_string().contains("above 0 and below 1"));
        assert!(Rim::circle(0.0, 8, 0.5).is_err());
        let close = [[1.0, 0.0], [0.99, 0.01], [-1.0, 0.0], [0.0, -1.0]];
        assert_eq!(Rim::through(&close, 0.5), Err(ElectricsError::Overlap { first: 0, second: 1 }));
        // Twice round.
        let twice: Vec<[f64; 2]> =
            (0..8).map(|k| [(1.6 * f64::from(k)).cos(), (1.6 * f64::from(k)).sin()]).collect();
        assert!(Rim::through(&twice, 0.01).unwrap_err().to_string().contains("below a whole turn"));
    }
}
