//! Taxel value isolines: the force that it takes, at every place, for a channel to read one value.

use serde::Serialize;

use crate::Responses;

/// \[m\] that distances are measured in within λ|d|^α: with metres λ would span dozens of decades.
pub const UNIT: f64 = 1e-3;
/// Exponents that are tried.
const ALPHA: [f64; 2] = [0.2, 40.0];
/// Points that a fit needs: one more than it has unknowns.
const FEWEST: usize = 4;

/// One point of an isoline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IsolinePoint {
    /// Index of the location.
    #[serde(rename = "place")]
    pub location: usize,
    /// \[m\] along the surface from the taxel's foot; negative on the one side of it, on a line.
    pub distance: f64,
    /// \[N\].
    pub force: f64,
}

/// Where and how hard a channel is pressed when it reads one value (thesis, definition 1).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Isoline {
    /// Which channel.
    pub channel: usize,
    /// S, in the unit of the skin.
    pub value: f64,
    /// At the locations where some force up to the largest tabulated gives the value.
    pub points: Vec<IsolinePoint>,
}

/// I(d) = g + λ (|d| / 1 mm)^α (5.16), fitted to one isoline by least squares in the force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IsolineFit {
    /// S, in the unit of the skin.
    pub value: f64,
    /// g(S) \[N\]: the force straight above the taxel.
    pub g: f64,
    /// λ \[N\]: what a distance of 1 mm takes more.
    pub lambda: f64,
    /// α.
    pub alpha: f64,
    /// \[N\] root mean square of what the fit leaves.
    pub residual: f64,
    /// Points that it was fitted to.
    pub points: usize,
}

impl Isoline {
    /// The isoline of a channel's value, `distances` \[m\] of each place from the taxel's foot given.
    #[must_use]
    pub fn of(responses: &Responses, distances: &[f64], channel: usize, value: f64) -> Self {
        let points = distances
            .iter()
            .enumerate()
            .filter_map(|(location, distance)| {
                let force = responses.force_for(location, channel, value)?;
                Some(IsolinePoint { location, distance: *distance, force })
            })
            .collect();
        Self { channel, value, points }
    }

    /// The points around the taxel's foot, in order of their distance: what a far side of the skin reads again, beyond a gap
    /// of several steps, is no part of the curve.
    fn around_foot(&self) -> Vec<IsolinePoint> {
        let mut points = self.points.clone();
        points.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        let mut steps: Vec<f64> = points.windows(2).map(|w| w[1].distance - w[0].distance).collect();
        let gaps = steps.clone();
        steps.sort_by(f64::total_cmp);
        let widest = steps.get(steps.len() / 2).map_or(f64::INFINITY, |step| 4.0 * step);
        let nearest =
            points.iter().enumerate().min_by(|a, b| a.1.distance.abs().total_cmp(&b.1.distance.abs()));
        let Some((nearest, _)) = nearest else { return points };
        let end = (nearest..gaps.len()).find(|i| gaps[*i] > widest).unwrap_or(gaps.len());
        let start = (0..nearest).rev().find(|i| gaps[*i] > widest).map_or(0, |i| i + 1);
        points[start..=end].to_vec()
    }

    /// Fits g + λ|d|^α. `None` where there are too few points.
    #[must_use]
    pub fn fit(&self) -> Option<IsolineFit> {
        let points: Vec<(f64, f64)> =
            self.around_foot().iter().map(|p| (p.distance.abs() / UNIT, p.force)).collect();
        let far = points.iter().map(|p| p.0).fold(0.0, f64::max);
        if points.len() < FEWEST || far <= 0.0 {
            return None;
        }
        // For each exponent the rest is a straight line: search the exponent coarsely, then ever finer.
        let [low, high] = ALPHA.map(f64::ln);
        let (mut best, mut step) = (f64::midpoint(low, high), (high - low) / 40.0);
        let mut wide = 20;
        for _ in 0..9 {
            let tried = (-wide..=wide).map(|i| (best + f64::from(i) * step).clamp(low, high));
            let left = tried.map(|exponent| (exponent, straight(&points, far, exponent.exp()).2));
            best = left.min_by(|a, b| a.1.total_cmp(&b.1))?.0;
            step /= 5.0;
            wide = 6;
        }
        let alpha = best.exp();
        let (g, at_far, squares) = straight(&points, far, alpha);
        Some(IsolineFit {
            value: self.value,
            g,
            lambda: at_far / far.powf(alpha),
            alpha,
            residual: (squares / points.len() as f64).sqrt(),
            points: points.len(),
        })
    }
}

impl IsolineFit {
    /// I(d) \[N\] at a distance \[m\].
    #[must_use]
    pub fn force(&self, distance: f64) -> f64 {
        self.g + self.lambda * (distance.abs() / UNIT).powf(self.alpha)
    }

    /// m = |dI/dd| \[N/m\] at a distance \[m\] (5.11).
    #[must_use]
    pub fn slope(&self, distance: f64) -> f64 {
        self.lambda * self.alpha * (distance.abs() / UNIT).powf(self.alpha - 1.0) / UNIT
    }

    /// What lies between two fits: α and ln λ interpolated over the value, as both vary over decades.
    #[must_use]
    pub fn between(fits: &[Self], value: f64) -> Option<Self> {
        let after = fits.partition_point(|f| f.value < value);
        let (Some(high), Some(low)) = (fits.get(after).or(fits.last()), fits.get(after.saturating_sub(1)))
        else {
            return None;
        };
        let span = high.value - low.value;
        let share = if span > 0.0 { ((value - low.value) / span).clamp(0.0, 1.0) } else { 0.0 };
        let blend = |a: f64, b: f64| a + share * (b - a);
        // λ may be 0 where an isoline is flat.
        let lambda = if low.lambda > 0.0 && high.lambda > 0.0 {
            blend(low.lambda.ln(), high.lambda.ln()).exp()
        } else {
            blend(low.lambda, high.lambda)
        };
        Some(Self {
            value,
            g: blend(low.g, high.g),
            lambda,
            alpha: blend(low.alpha, high.alpha),
            residual: blend(low.residual, high.residual),
            points: low.points.min(high.points),
        })
    }
}

/// g, λ·far^α and the sum of squares that they leave, for one exponent; neither falls below 0.
fn straight(points: &[(f64, f64)], far: f64, alpha: f64) -> (f64, f64, f64) {
    let n = points.len() as f64;
    let rise = |d: f64| (d / far).powf(alpha);
    let (mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0);
    for (d, force) in points {
        let x = rise(*d);
        sx += x;
        sy += force;
        sxx += x * x;
        sxy += x * force;
    }
    let spread = n * sxx - sx * sx;
    let slope = if spread > 0.0 { ((n * sxy - sx * sy) / spread).max(0.0) } else { 0.0 };
    let mut g = (sy - slope * sx) / n;
    let mut slope = slope;
    if g < 0.0 {
        g = 0.0;
        slope = if sxx > 0.0 { (sxy / sxx).max(0.0) } else { 0.0 };
    }
    let squares = points.iter().map(|(d, force)| (force - g - slope * rise(*d)).powi(2)).sum();
    (g, slope, squares)
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use nalgebra::Point3;
    use proptest::prelude::*;

    use super::*;
    use crate::force_ladder;
    use crate::testing::{DEPTH, row};

    fn made(g: f64, lambda: f64, alpha: f64) -> Isoline {
        let points = (-60..=60).map(|i| {
            let distance = f64::from(i) * 1e-4;
            IsolinePoint { location: 0, distance, force: g + lambda * (distance.abs() / UNIT).powf(alpha) }
        });
        Isoline { channel: 0, value: 1.0, points: points.collect() }
    }

    proptest! {
        #[test]
        fn a_fit_finds_what_was_put_in(g in 0.0..1.0f64, lambda in 0.001..0.3f64, alpha in 0.5..8.0f64) {
            let fit = made(g, lambda, alpha).fit().unwrap();
            prop_assert!((fit.alpha / alpha - 1.0).abs() < 0.01, "{fit:?}");
            prop_assert!((fit.lambda / lambda - 1.0).abs() < 0.05 && (fit.g - g).abs() < 1e-3 + 1e-5 * fit.force(6e-3), "{fit:?}");
            prop_assert!(fit.residual < 1e-3 * fit.force(6e-3), "{fit:?}");
        }
    }

    #[test]
    fn the_toys_isolines_are_parabolas() {
        // F · h / (d² + h²) = S, so that I(d) = S (h + d²/h).
        let model = row(3);
        let points: Vec<Point3<f64>> =
            (-40..=40).map(|i| Point3::new(f64::from(i) * 2e-4, 0.0, 0.0)).collect();
        let responses = Responses::of_model(&model, &points, &force_ladder(2.0, 40), 0.004).unwrap();
        let distances: Vec<f64> = points.iter().map(|p| p.x).collect();
        for value in [20.0, 60.0] {
            let isoline = Isoline::of(&responses, &distances, 1, value);
            let fit = isoline.fit().unwrap();
            assert_relative_eq!(fit.alpha, 2.0, max_relative = 1e-3);
            assert_relative_eq!(fit.g, value * DEPTH, max_relative = 1e-3);
            assert_relative_eq!(fit.lambda, value / DEPTH * UNIT * UNIT, max_relative = 1e-2);
            let d = 0.003;
            assert_relative_eq!(fit.slope(d), 2.0 * value * d / DEPTH, max_relative = 1e-2);
        }
        // What no force gives is left out.
        assert!(Isoline::of(&responses, &distances, 1, 1e6).fit().is_none());
        let few = Isoline::of(&responses, &distances, 1, 380.0);
        assert!(few.points.len() < points.len() && few.points.iter().all(|p| p.force <= 2.0));
    }

    #[test]
    fn what_lies_beyond_a_gap_is_not_fitted() {
        let mut isoline = made(0.1, 0.02, 2.0);
        let far = [-0.031, 0.030, 0.0301].map(|distance| IsolinePoint { location: 0, distance, force: 0.5 });
        isoline.points.extend(far);
        let fit = isoline.fit().unwrap();
        assert_relative_eq!(fit.alpha, 2.0, max_relative = 1e-3);
        assert_eq!(fit.points, 121);
        isoline.points.clear();
        assert!(isoline.fit().is_none());
    }

    #[test]
    fn between_two_fits_lies_what_varies_slowly() {
        let fit =
            |value, alpha, lambda| IsolineFit { value, g: value, lambda, alpha, residual: 0.0, points: 9 };
        let fits = [fit(1.0, 8.0, 1e-6), fit(3.0, 2.0, 1e-2)];
        let middle = IsolineFit::between(&fits, 2.0).unwrap();
        assert_relative_eq!(middle.alpha, 5.0);
        assert_relative_eq!(middle.lambda, 1e-4, max_relative = 1e-9);
        assert_relative_eq!(IsolineFit::between(&fits, 9.0).unwrap().alpha, 2.0);
        assert_relative_eq!(IsolineFit::between(&fits, 0.1).unwrap().alpha, 8.0);
        assert!(IsolineFit::between(&[], 1.0).is_none());
    }
}
