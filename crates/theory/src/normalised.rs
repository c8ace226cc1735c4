//! Two taxels and their isolines g + λ|d|^α: the setting in which the thesis explains what super-resolution depends on
//! (H. Sun, *Machine Learning for Haptics*, 2023, section 5.3.1).
//!
//! Forces and noise are in the same unit, lengths in any other one.

use serde::Serialize;

use crate::TheoryError;
use crate::surface::positive;

/// How far outside of both taxels an area of intersection is followed, in their distances; what reaches this far counts as
/// unbounded.
const FAR: f64 = 1e3;
/// Steps of a bisection: the interval shrinks to rounding.
const BISECTIONS: usize = 200;

/// Two equal taxels, one at 0 and one at `distance`, each with isolines g(S) + λ|d|^α.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TwoTaxels {
    /// Exponent with which a taxel's response attenuates.
    pub alpha: f64,
    /// Force that one length unit from the taxel takes more than straight above it.
    pub lambda: f64,
    /// Between both taxels.
    pub distance: f64,
}

/// One area in which the bands of both isolines overlap.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Area {
    /// Its ends along the line; infinite where it has none.
    pub from: f64,
    /// See `from`.
    pub to: f64,
}

/// What the bounding box of an intersection says: half its width and half its height.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Deviations {
    /// σ_P along the line; infinite where the area has no end.
    pub position: f64,
    /// σ_F, a force.
    pub force: f64,
}

impl TwoTaxels {
    /// The setting of the thesis: distance 1, λ = 1.
    ///
    /// # Errors
    ///
    /// [`TheoryError::NotPositive`] for an exponent that is not.
    pub fn normalised(alpha: f64) -> Result<Self, TheoryError> {
        Ok(Self { alpha: positive("exponent of the isolines", alpha)?, lambda: 1.0, distance: 1.0 })
    }

    /// What a touch at `d` takes beyond g: the isolines of both taxels (5.5, 5.6).
    #[must_use]
    pub fn rise(&self, d: f64) -> [f64; 2] {
        [d, self.distance - d].map(|d| self.lambda * d.abs().powf(self.alpha))
    }

    /// Force from which on a touch at `d` reaches S_min in both taxels, where straight above a taxel `least` = g(S_min)
    /// does.
    #[must_use]
    pub fn minimum_force(&self, d: f64, least: f64) -> f64 {
        let [first, second] = self.rise(d);
        least + first.max(second)
    }

    /// How the isolines of both taxels differ at `d`.
    fn difference(&self, d: f64) -> f64 {
        let [first, second] = self.rise(d);
        first - second
    }

    /// Areas in which the bands I ± σ of both isolines overlap that meet at `contact`, in their order along the line: one
    /// for α > 1, up to three for α < 1, and one without an end outside of both taxels for α = 1.
    #[must_use]
    pub fn areas(&self, contact: f64, sigma: f64) -> Vec<Area> {
        // The bands overlap where the isolines differ by no more than both half widths.
        let meant = self.difference(contact);
        let excess = |d: f64| (self.difference(d) - meant).abs() - 2.0 * sigma;
        let far = FAR * self.distance;
        // Between a taxel and the next, and outside of both, the difference is monotone: an area is found by its ends, and
        // no stretch holds more than one. Stretches that areas continue across are joined.
        let stops = [-far, 0.0, self.distance, self.distance + far];
        let mut found: Vec<Area> = Vec::new();
        for stretch in stops.windows(2) {
            let (a, b) = (stretch[0], stretch[1]);
            let Some((from, to)) = self.within(a, b, meant, 2.0 * sigma) else { continue };
            match found.last_mut() {
                Some(last) if last.to >= from => last.to = to,
                _ => found.push(Area { from, to }),
            }
        }
        for area in &mut found {
            if area.from <= -far && excess(-far) <= 1e-12 * self.lambda {
                area.from = f64::NEG_INFINITY;
            }
            if area.to >= self.distance + far && excess(self.distance + far) <= 1e-12 * self.lambda {
                area.to = f64::INFINITY;
            }
        }
        found
    }

    /// Where, between `a` and `b`, the monotone difference lies within `half` of `meant`.
    fn within(&self, a: f64, b: f64, meant: f64, half: f64) -> Option<(f64, f64)> {
        let (at_a, at_b) = (self.difference(a) - meant, self.difference(b) - meant);
        let rising = at_b >= at_a;
        let cut = |level: f64| {
            // Where the difference passes `level`.
            let (mut low, mut high) = (a, b);
            for _ in 0..BISECTIONS {
                let middle = (low + high) / 2.0;
                if ((self.difference(middle) - meant) < level) == rising {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            (low + high) / 2.0
        };
        // Equal isolines outside of both taxels (α = 1) must not fail by rounding.
        let half = half * (1.0 + 1e-12);
        let inside = |v: f64| v.abs() <= half;
        let (low, high) = (at_a.min(at_b), at_a.max(at_b));
        if low > half || high < -half {
            return None;
        }
        let near = |level: f64| if rising { cut(-level) } else { cut(level) };
        let from = if inside(at_a) { a } else { near(half) };
        let to = if inside(at_b) { b } else { near(-half) };
        Some((from, to))
    }

    /// σ_P and σ_F by the exact corners of the intersection (5.7–5.10): half of their bounding box. Where there are several
    /// areas, the right one is taken for known.
    #[must_use]
    pub fn corners(&self, contact: f64, sigma: f64) -> Deviations {
        let areas = self.areas(contact, sigma);
        let Some(area) = areas.iter().find(|a| a.from <= contact && contact <= a.to) else {
            return Deviations { position: f64::INFINITY, force: f64::INFINITY };
        };
        if !(area.from.is_finite() && area.to.is_finite()) {
            return Deviations { position: f64::INFINITY, force: f64::INFINITY };
        }
        // Both upper and both lower bounds meet at the contact. At either end the upper bound of one isoline meets the
        // lower bound of the other: which one does not matter, their forces are equal there.
        let here = self.rise(contact)[0];
        let end = |d: f64| {
            let [first, second] = self.rise(d);
            let meant = self.rise(contact);
            f64::midpoint(first - meant[0], second - meant[1])
        };
        let forces = [here + sigma, here - sigma, here + end(area.from), here + end(area.to)];
        let high = forces.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let low = forces.iter().copied().fold(f64::INFINITY, f64::min);
        Deviations { position: (area.to - area.from) / 2.0, force: (high - low) / 2.0 }
    }

    /// σ_P = 2σ / (m₁ + m₂) between the taxels (5.14): the intersection as a parallelogram. Outside, where both isolines
    /// rise to the same side, their slopes subtract.
    ///
    /// σ_F is half the parallelogram's height: σ between the taxels; (5.19) names the whole height, 2σ.
    #[must_use]
    pub fn closed_form(&self, contact: f64, sigma: f64) -> Deviations {
        let slope = |d: f64| self.lambda * self.alpha * d.abs().powf(self.alpha - 1.0) * d.signum();
        let (first, second) = (slope(contact), -slope(self.distance - contact));
        let apart = (first - second).abs();
        Deviations { position: 2.0 * sigma / apart, force: sigma * ((first + second).abs() / apart).max(1.0) }
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    use super::*;

    const SIGMA: f64 = 0.02;

    fn taxels(alpha: f64) -> TwoTaxels {
        TwoTaxels::normalised(alpha).unwrap()
    }

    #[test]
    fn parabolas_locate_equally_well_everywhere() {
        // "is constant for α = 2. For normalised TVIs σ_P = σ_S"
        for contact in [-1.5, -0.3, 0.0, 0.2, 0.5, 0.9, 1.0, 1.7] {
            assert_relative_eq!(taxels(2.0).corners(contact, SIGMA).position, SIGMA, max_relative = 1e-9);
            assert_relative_eq!(taxels(2.0).closed_form(contact, SIGMA).position, SIGMA, max_relative = 1e-9);
        }
    }

    #[test]
    fn straight_isolines_locate_only_between() {
        let between = taxels(1.0).corners(0.4, SIGMA);
        assert_relative_eq!(between.position, SIGMA, max_relative = 1e-9);
        for outside in [-0.5, 1.2, 3.0] {
            assert!(taxels(1.0).corners(outside, SIGMA).position.is_infinite());
            assert_eq!(taxels(1.0).areas(outside, SIGMA).len(), 1);
        }
    }

    #[test]
    fn concave_isolines_meet_three_times() {
        let areas = taxels(0.5).areas(0.5, SIGMA);
        assert_eq!(areas.len(), 3, "{areas:?}");
        assert!(areas[0].from.is_infinite() && areas[2].to.is_infinite());
        assert!(areas[1].from < 0.5 && 0.5 < areas[1].to && areas[1].to < 1.0);
        // Off the middle the other area lies on one side only, and a touch there is taken for one between.
        let areas = taxels(0.5).areas(0.8, SIGMA);
        assert_eq!(areas.len(), 2, "{areas:?}");
        assert!(areas[1].from > 1.0);
        assert_eq!(taxels(0.5).areas(1.5, SIGMA).len(), 2);
        // No exponent above 1 is ambiguous.
        for alpha in [1.2, 1.5, 2.0, 4.0] {
            assert_eq!(taxels(alpha).areas(0.8, SIGMA).len(), 1);
        }
    }

    #[test]
    fn the_force_is_known_equally_well_between_whatever_the_exponent() {
        for alpha in [0.5, 1.0, 1.5, 2.0, 3.0, 6.0] {
            for contact in [0.1, 0.35, 0.5, 0.9] {
                let found = taxels(alpha).corners(contact, 1e-4).force;
                assert_relative_eq!(found, 1e-4, max_relative = 1e-2);
            }
        }
        // Outside it is known the better the larger the exponent is.
        let outside = |alpha| taxels(alpha).corners(1.5, 1e-3).force;
        assert!(outside(1.2) > outside(1.5) && outside(1.5) > outside(2.0) && outside(2.0) > outside(4.0));
        assert!(outside(4.0) > 1e-3);
    }

    #[test]
    fn exponents_other_than_one_to_two_locate_worse_between() {
        let middle = |alpha| taxels(alpha).corners(0.5, 1e-3).position;
        assert!(middle(3.0) > middle(2.0) && middle(0.5) > middle(1.0));
        assert_relative_eq!(middle(1.0), middle(2.0), max_relative = 1e-6);
        // "for α > 2, the reduced position error at the outside is paid by an increase in minimal force"
        let outside =
            |alpha| (taxels(alpha).corners(1.4, 1e-3).position, taxels(alpha).minimum_force(1.4, 0.1));
        assert!(outside(4.0).0 < outside(2.0).0 && outside(4.0).1 > outside(2.0).1);
    }

    #[test]
    fn less_force_is_needed_between_than_above() {
        for alpha in [0.5, 1.0, 2.0, 4.0] {
            assert!(taxels(alpha).minimum_force(0.5, 0.1) < taxels(alpha).minimum_force(0.0, 0.1));
        }
        // "Smaller attenuation exponent yields a smaller sensitivity (bigger F_S) between the taxels"
        assert!(taxels(1.0).minimum_force(0.5, 0.1) > taxels(3.0).minimum_force(0.5, 0.1));
    }

    #[test]
    fn the_closed_form_is_the_first_order() {
        // Its error falls with σ²: relative to σ_P, which falls with σ, by a hundred where σ falls by ten.
        for alpha in [1.5, 3.0, 4.0] {
            for contact in [0.3, 0.45, 1.3] {
                let error = |sigma: f64| {
                    let exact = taxels(alpha).corners(contact, sigma).position;
                    (exact / taxels(alpha).closed_form(contact, sigma).position - 1.0).abs()
                };
                let order = (error(1e-2) / error(1e-3)).log10();
                assert!((order - 2.0).abs() < 0.15, "α = {alpha}, contact {contact}: order {order}");
            }
        }
    }

    proptest! {
        #[test]
        fn the_contact_lies_in_its_area(alpha in 0.3..8.0f64, contact in -2.0..3.0f64, sigma in 1e-4..0.1f64) {
            let areas = taxels(alpha).areas(contact, sigma);
            prop_assert!((1..=3).contains(&areas.len()), "{areas:?}");
            prop_assert!(areas.iter().any(|a| a.from <= contact + 1e-9 && contact - 1e-9 <= a.to), "{areas:?}");
            prop_assert!(areas.windows(2).all(|w| w[0].to < w[1].from));
            let found = taxels(alpha).corners(contact, sigma);
            prop_assert!(found.position > 0.0 && found.force >= sigma * (1.0 - 1e-9));
        }
    }
}
