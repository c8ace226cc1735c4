//! A rigid sphere pressed into a medium.

use nalgebra::{DMatrix, DVector};
use std::f64::consts::{PI, TAU};

use crate::error::positive;
use crate::quadrature::{gauss_legendre, panels};
use crate::{MechanicsError, Medium};

/// Points along the contact radius. The solution is smooth except for the logarithm of the sphere's slope.
const POINTS: usize = 40;
/// artanh(a/R) up to which contacts are solved: there the contact is as wide as its sphere to seven digits, and the
/// indentation on a half-space eight times as deep.
pub(crate) const DEEPEST: f64 = 8.0;
/// ka up to which a Gauss rule of that many points integrates cos kt.
const RESOLVED: f64 = 60.0;

/// Frictionless contact of a rigid sphere with a [`Medium`].
///
/// Sneddon's representation p̂(k) = ∫₀ᵃ φ(t) cos kt dt of a pressure that vanishes outside of the contact
/// radius a turns "the surface has the shape of the sphere" into Fredholm's equation
///
/// φ(t) − ∫₀ᵃ M(t, s) φ(s) ds = E/(π(1−ν²)) · (δ − t artanh(t/R)),
/// M(t, s) = (2/π) ∫₀^∞ g(k) cos kt cos ks dk,
///
/// where 1 − g is the layer's surface displacement relative to the half-space's. For a half-space g = 0 and
/// Sneddon's solution remains (I. N. Sneddon, *Int. J. Eng. Sci.* 3 (1965) 47–57; the equation for a layer is
/// Lebedev's and Ufliand's, *PMM* 22 (1958) 442–450). The contact ends smoothly: φ(a) = 0 gives the
/// indentation δ. The kernel is smooth, so a Gauss rule of 40 points (Nyström) is accurate to many digits.
///
/// The geometry of the sphere is exact, strains are taken as small: at indentations of the order of the sphere's
/// radius or the layer's thickness a real elastomer stiffens beyond this.
#[derive(Debug, Clone)]
pub struct SphereContact {
    contact_radius: f64,
    indentation: f64,
    force: f64,
    /// t \[m\] and weight · φ(t) \[N\].
    density: Vec<(f64, f64)>,
}

impl SphereContact {
    /// The contact of a sphere of `sphere_radius` \[m\] that touches the medium within `contact_radius` \[m\].
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a radius is not positive or the contact is not smaller than the sphere.
    pub fn new(medium: &Medium, sphere_radius: f64, contact_radius: f64) -> Result<Self, MechanicsError> {
        let big = positive("radius of the sphere [m]", sphere_radius)?;
        let a = positive("radius of the contact [m]", contact_radius)?;
        if a >= big {
            return Err(MechanicsError::Value {
                quantity: "radius of the contact [m]",
                value: a,
                expected: "smaller than that of the sphere",
            });
        }
        let nodes: Vec<(f64, f64)> = gauss_legendre(POINTS).iter().map(|(x, w)| (x * a, w * a)).collect();
        let slope = |t: f64| t * (t / big).atanh();

        // Kernel of the layer: one outer product per wavenumber, evaluated at the nodes and at the edge.
        let mut points: Vec<f64> = nodes.iter().map(|n| n.0).collect();
        points.push(a);
        let mut kernel = DMatrix::<f64>::zeros(POINTS + 1, POINTS);
        let h = medium.thickness();
        if h.is_finite() {
            let wavenumbers = panels(20.0 / h, (1.0 / h).min(3.0 / a));
            let mut cosines = DMatrix::<f64>::zeros(POINTS + 1, wavenumbers.len());
            let mut weighted = DMatrix::<f64>::zeros(wavenumbers.len(), POINTS);
            for (q, &(k, w)) in wavenumbers.iter().enumerate() {
                let g = 2.0 / PI * w * (1.0 - medium.relative_displacement(k));
                for (i, &t) in points.iter().enumerate() {
                    cosines[(i, q)] = (k * t).cos();
                }
                for (j, &(_, weight)) in nodes.iter().enumerate() {
                    weighted[(q, j)] = g * cosines[(j, q)] * weight;
                }
            }
            kernel = cosines * weighted;
        }
        let system = DMatrix::identity(POINTS, POINTS) - kernel.rows(0, POINTS);
        let sides = DMatrix::from_fn(POINTS, 2, |i, j| if j == 0 { 1.0 } else { slope(nodes[i].0) });
        // The operator is the identity minus a contraction, hence regular.
        let solution = system.lu().solve(&sides).unwrap_or_else(|| sides.clone());
        let edge = kernel.row(POINTS) * &solution;
        let indentation = (slope(a) + edge[1]) / (1.0 + edge[0]);
        let scale = 2.0 / (PI * medium.compliance());
        let phi: DVector<f64> = (solution.column(0) * indentation - solution.column(1)) * scale;
        let density: Vec<(f64, f64)> = nodes.iter().zip(phi.iter()).map(|(&(t, w), f)| (t, w * f)).collect();
        let force = TAU * density.iter().map(|d| d.1).sum::<f64>();
        Ok(Self { contact_radius: a, indentation, force, density })
    }

    /// The contact of a sphere of `sphere_radius` \[m\] whose lowest point lies `indentation` \[m\] below the undeformed
    /// surface.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a length is not positive, or the sphere would be in so deep that no contact
    /// smaller than itself carries it.
    pub fn at_indentation(
        medium: &Medium,
        sphere_radius: f64,
        indentation: f64,
    ) -> Result<Self, MechanicsError> {
        positive("indentation [m]", indentation)?;
        // The indentation grows without bound with artanh(a/R).
        let contact = |u: f64| Self::new(medium, sphere_radius, sphere_radius * u.tanh());
        let (mut low, mut high) = (0.0, DEEPEST);
        let mut found = contact(high)?;
        if found.indentation < indentation {
            return Err(MechanicsError::Value {
                quantity: "indentation [m]",
                value: indentation,
                expected: "of the order of the sphere's radius at most",
            });
        }
        while high - low > 1e-11 * high {
            let middle = (low + high) / 2.0;
            let tried = contact(middle)?;
            if tried.indentation < indentation {
                low = middle;
            } else {
                (high, found) = (middle, tried);
            }
        }
        Ok(found)
    }

    /// \[m\] of the circle within which sphere and medium touch.
    #[must_use]
    pub fn contact_radius(&self) -> f64 {
        self.contact_radius
    }

    /// \[m\] of the sphere's lowest point below the undeformed surface.
    #[must_use]
    pub fn indentation(&self) -> f64 {
        self.indentation
    }

    /// \[N\] that presses the sphere in.
    #[must_use]
    pub fn force(&self) -> f64 {
        self.force
    }

    /// Hankel transform of order 0 of the contact pressure, ∫ p(r) J₀(kr) r dr \[N\], at `k` [1/m].
    ///
    /// 0 where ka exceeds 60, beyond what the quadrature resolves: the transform has fallen to about 1/(ka)² of
    /// the force there.
    #[must_use]
    pub fn transform(&self, k: f64) -> f64 {
        if k * self.contact_radius > RESOLVED {
            return 0.0;
        }
        self.density.iter().map(|(t, f)| f * (k * t).cos()).sum()
    }

    /// The ring that stands for the contact where a field varies little over it: its radius \[m\], and the share of the force on
    /// it; the rest acts at the centre. Such a load has the pressure's moments ⟨r²⟩ and ⟨r⁴⟩, which are 2⟨t²⟩ and 8/3 ⟨t⁴⟩ over φ:
    /// compare the powers of k in p̂(k) = ∫ p J₀(kr) r dr = ∫ φ cos kt dt.
    #[must_use]
    pub fn ring(&self) -> (f64, f64) {
        let moment = |power: i32| self.density.iter().map(|(t, f)| f * t.powi(power)).sum::<f64>();
        let whole = moment(0);
        let (second, fourth) = (2.0 * moment(2) / whole, 8.0 / 3.0 * moment(4) / whole);
        ((fourth / second).sqrt(), second * second / fourth)
    }

    /// \[Pa\] that the sphere presses with at the distance `r` \[m\] from its axis: p(r) = −∫ φ′(t) / √(t² − r²) dt from r to a.
    #[must_use]
    pub fn surface_pressure(&self, r: f64) -> f64 {
        let a = self.contact_radius;
        if !(0.0..a).contains(&r) {
            return 0.0;
        }
        let rule = gauss_legendre(POINTS);
        // φ is even and nearly a polynomial: its slope by differences of the one through its values.
        let values: Vec<(f64, f64)> =
            self.density.iter().zip(&rule).map(|((t, f), (_, w))| (t / a, f / (w * a))).collect();
        // Barycentric weights of Gauss nodes (H. Wang, S. Xiang, Math. Comp. 81 (2012) 861-877).
        let weights: Vec<f64> = rule
            .iter()
            .enumerate()
            .map(|(i, (x, w))| (x * (1.0 - x) * w).sqrt() * if i % 2 == 0 { 1.0 } else { -1.0 })
            .collect();
        let phi = |x: f64| {
            let (mut above, mut below) = (0.0, 0.0);
            for ((t, f), weight) in values.iter().zip(&weights) {
                let by = x - t;
                if by.abs() < 1e-13 {
                    return *f;
                }
                above += weight / by * f;
                below += weight / by;
            }
            above / below
        };
        let slope = |x: f64| {
            let step = 1e-4_f64.min(1.0 - x).max(1e-7);
            (phi(x + step) - phi(x - step)) / (2.0 * step)
        };
        // With u = √(t² − r²), dt / √(t² − r²) = du / t.
        let (r, end) = (r / a, (1.0 - (r / a).powi(2)).sqrt());
        let sum: f64 = panels(end, 0.2)
            .iter()
            .map(|(u, w)| {
                let t = r.hypot(*u);
                w * slope(t) / t
            })
            .sum();
        -sum / a
    }

    /// Mean compressive stress −σₖₖ/3 \[Pa\] at `depth` \[m\] and distance `r` \[m\] from the sphere's axis, integrated;
    /// [`PressureTable`](crate::PressureTable) looks it up. `medium` is the one that the contact was solved for.
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where the depth lies outside of the medium or the distance is not a number.
    pub fn pressure(&self, medium: &Medium, depth: f64, r: f64) -> Result<f64, MechanicsError> {
        let kernel = |k: f64, x: f64| medium.pressure_kernel(k, depth) * self.transform(k) * libm::j0(x);
        medium.integrate(self.contact_radius, depth, r, kernel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Base;
    use approx::assert_relative_eq;

    const E: f64 = 70e3;
    const NU: f64 = 0.49;
    const R: f64 = 0.002;

    fn at_indentation(medium: &Medium, depth: f64) -> SphereContact {
        SphereContact::at_indentation(medium, R, depth).unwrap()
    }

    #[test]
    fn a_light_touch_presses_as_hertz_says() {
        let half = Medium::half_space(E, NU).unwrap();
        let contact = SphereContact::new(&half, R, 0.02 * R).unwrap();
        let (a, force) = (contact.contact_radius(), contact.force());
        let most = 1.5 * force / (PI * a * a);
        for part in [0.0, 0.3, 0.6, 0.9_f64] {
            let exact = most * (1.0 - part * part).sqrt();
            assert_relative_eq!(contact.surface_pressure(part * a), exact, max_relative = 1e-3);
        }
        // ⟨r²⟩ = 2a²/5 and ⟨r⁴⟩ = 8a⁴/35.
        let (radius, share) = contact.ring();
        assert_relative_eq!(radius, (4.0f64 / 7.0).sqrt() * a, max_relative = 1e-3);
        assert_relative_eq!(share, 0.7, max_relative = 1e-3);
    }

    #[test]
    fn pressure_and_ring_of_a_deep_touch_are_one_load() {
        let pad = Medium::layer(E, NU, 0.010, Base::Bonded).unwrap();
        let contact = at_indentation(&pad, 0.0024);
        let a = contact.contact_radius();
        let moment = |power: i32| {
            let rule = panels(a, a / 20.0);
            rule.iter().map(|(r, w)| TAU * w * r.powi(power + 1) * contact.surface_pressure(*r)).sum::<f64>()
        };
        assert_relative_eq!(moment(0), contact.force(), max_relative = 5e-3);
        let (radius, share) = contact.ring();
        assert_relative_eq!(moment(2), contact.force() * share * radius.powi(2), max_relative = 1e-2);
        assert_relative_eq!(moment(4), contact.force() * share * radius.powi(4), max_relative = 1e-2);
    }

    #[test]
    fn sphere_on_half_space_is_sneddon() {
        let half = Medium::half_space(E, NU).unwrap();
        for (depth, force) in [(0.0012, 0.2146), (0.0024, 0.5683)] {
            assert_relative_eq!(at_indentation(&half, depth).force(), force, max_relative = 5e-4);
        }
        for part in [0.1, 0.5, 0.9, 0.99] {
            let a = part * R;
            let c = SphereContact::new(&half, R, a).unwrap();
            let log = ((R + a) / (R - a)).ln();
            assert_relative_eq!(c.indentation(), a / 2.0 * log, max_relative = 1e-9);
            let force = E / (1.0 - NU * NU) * ((a * a + R * R) / 2.0 * log - a * R);
            assert_relative_eq!(c.force(), force, max_relative = 1e-5);
        }
    }

    #[test]
    fn light_touch_is_hertz() {
        let half = Medium::half_space(E, NU).unwrap();
        let c = SphereContact::new(&half, R, R / 100.0).unwrap();
        let modulus = E / (1.0 - NU * NU);
        assert_relative_eq!(c.force(), 4.0 / 3.0 * modulus * (R / 100.0).powi(3) / R, max_relative = 1e-4);
        let hertz = crate::Load::Hertz { force: c.force(), radius: c.contact_radius() };
        for k in [0.0, 1e3, 1e4, 1e5] {
            assert!((c.transform(k) - hertz.transform(k)).abs() < 1e-4 * hertz.transform(0.0));
        }
    }

    /// Reference: boundary elements of another code.
    #[test]
    fn bonded_layer_stiffens_the_contact() {
        let half = Medium::half_space(E, NU).unwrap();
        let pad = Medium::layer(E, NU, 0.010, Base::Bonded).unwrap();
        for (depth, ratio) in [(0.0002, 1.074), (0.0005, 1.120), (0.0012, 1.185), (0.0024, 1.241)] {
            let contact = at_indentation(&pad, depth);
            assert_relative_eq!(contact.indentation(), depth, max_relative = 1e-9);
            let found = contact.force() / at_indentation(&half, depth).force();
            assert_relative_eq!(found, ratio, max_relative = 0.01);
        }
    }

    /// The solution fulfils its conditions: under the sphere, the surface has the sphere's shape.
    #[test]
    fn surface_follows_the_sphere() {
        let pad = Medium::layer(E, NU, 0.004, Base::Bonded).unwrap();
        let c = SphereContact::new(&pad, R, 0.6 * R).unwrap();
        let a = c.contact_radius();
        for part in [0.0, 0.3, 0.7, 0.95] {
            let r = part * a;
            let w: f64 = panels(RESOLVED / a, 3.0 / a)
                .iter()
                .map(|&(k, w)| w * k * pad.displacement_kernel(k) * c.transform(k) * libm::j0(k * r))
                .sum();
            let sphere = c.indentation() - (R - (R * R - r * r).sqrt());
            assert_relative_eq!(w, sphere, max_relative = 5e-3);
        }
    }

    #[test]
    fn a_contact_as_wide_as_its_sphere_is_refused() {
        let pad = Medium::layer(E, NU, 0.004, Base::Bonded).unwrap();
        let error = SphereContact::new(&pad, R, R).unwrap_err();
        insta::assert_snapshot!(error, @"radius of the contact [m] is 0.002 and must be smaller than that of the sphere");
        let error = SphereContact::at_indentation(&pad, R, 1.0).unwrap_err();
        insta::assert_snapshot!(error, @"indentation [m] is 1 and must be of the order of the sphere's radius at most");
    }
}
