//! Displacement inside a medium under a sphere.

use crate::error::positive;
use crate::medium::{Base, EXPONENT_MAX, love_constants, love_parts};
use crate::quadrature::panels;
use crate::{MechanicsError, Medium, SphereContact};

/// Steps of the search for the contact that a force makes.
const STEPS: usize = 60;

/// Displacement \[m\] of a point of the medium.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displacement {
    /// Away from the axis of the sphere.
    pub radial: f64,
    /// Into the medium.
    pub axial: f64,
}

/// What moves where in a half-space, or in a layer that is bonded to its base, when a rigid sphere presses on it.
///
/// With Love's function f as in [`Medium::pressure_kernel`]: 2G û_z = (1−2ν) f'' − 2(1−ν) k² f and 2G û_r = k f', the first
/// transformed by J₀, the second by J₁.
#[derive(Debug, Clone)]
pub struct SphereDisplacement {
    medium: Medium,
    contact: SphereContact,
}

impl SphereDisplacement {
    /// A sphere of `diameter` \[m\] that presses with `force` \[N\] on a half-space or a bonded layer.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a number is not positive.
    pub fn new(medium: &Medium, diameter: f64, force: f64) -> Result<Self, MechanicsError> {
        let radius = positive("diameter of the sphere [m]", diameter)? / 2.0;
        positive("force [N]", force)?;
        // The force grows with the contact: artanh(a/R) is bisected.
        let contact = |u: f64| SphereContact::new(medium, radius, radius * u.tanh());
        let (mut low, mut high) = (1e-6, 8.0);
        for _ in 0..STEPS {
            let middle = f64::midpoint(low, high);
            if contact(middle)?.force() < force { low = middle } else { high = middle }
        }
        Ok(Self { medium: *medium, contact: contact(high)? })
    }

    /// At `depth` \[m\] and the distance `r` \[m\] from the axis.
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where the depth lies outside of the medium or a number cannot be.
    pub fn at(&self, depth: f64, r: f64) -> Result<Displacement, MechanicsError> {
        self.medium.check_depth(depth)?;
        let r = r.abs();
        let thickness = self.medium.thickness();
        // The Bessel functions and the contact's transform oscillate, the layer's kernel bends within 1/h.
        let bend = if thickness.is_finite() { 3.0 / thickness } else { f64::INFINITY };
        let panel = (6.0 / (r + self.contact.contact_radius())).min(3.0 / depth).min(bend);
        let mut found = Displacement { radial: 0.0, axial: 0.0 };
        for (k, weight) in panels(EXPONENT_MAX / depth, panel) {
            let [radial, axial] = self.kernel(k, depth);
            let pressure = weight * k * self.contact.transform(k);
            found.radial += pressure * radial * libm::j1(k * r);
            found.axial += pressure * axial * libm::j0(k * r);
        }
        Ok(found)
    }

    /// Radial and axial displacement per surface pressure, all Hankel-transformed; \[m/Pa\].
    fn kernel(&self, k: f64, depth: f64) -> [f64; 2] {
        let nu = self.medium.poisson_ratio();
        let shear = self.medium.young_modulus() / (2.0 * (1.0 + nu));
        let alpha = k * self.medium.thickness();
        let s = k * depth;
        // f, f' and f'' with respect to s, for unit pressure.
        let [f, first, second] = if alpha > EXPONENT_MAX {
            // A half-space: f = −(2ν + s) e^(−s).
            let e = (-s).exp();
            [-(2.0 * nu + s) * e, (2.0 * nu - 1.0 + s) * e, (2.0 - 2.0 * nu - s) * e]
        } else {
            // Below this the system loses its digits while the displacement has long reached its limit.
            bonded(alpha.max(1e-3), s.max(1e-3 * depth / self.medium.thickness()), nu)
        };
        let scale = 1.0 / (2.0 * shear * k);
        [scale * first, scale * ((1.0 - 2.0 * nu) * second - 2.0 * (1.0 - nu) * f)]
    }
}

/// Love's function of a layer of kh = `alpha` that is bonded to its base, and its first two derivatives at kz = `s`.
fn bonded(alpha: f64, s: f64, nu: f64) -> [f64; 3] {
    let constants = love_constants(alpha, nu, Base::Bonded);
    let here = love_parts(alpha, s);
    std::array::from_fn(|i| (0..4).map(|j| here[i][j] * constants[(j, 0)]).sum())
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    /// The medium of the thesis' Fig. 5.7, of these thickness and Poisson's ratio.
    fn pad(thickness: f64, poisson: f64) -> Medium {
        Medium::layer(70e3, poisson, thickness, Base::Bonded).unwrap()
    }

    /// Under 1 N on a sphere of 10 mm, as there.
    fn under(medium: &Medium, diameter: f64) -> SphereDisplacement {
        SphereDisplacement::new(medium, diameter, 1.0).unwrap()
    }

    const L1: f64 = 0.001;
    const L2: f64 = 0.005;
    const L3: f64 = 0.009;

    #[test]
    fn the_surface_follows_the_sphere_and_the_base_stands_still() {
        for medium in [pad(0.010, 0.49), pad(0.010, 0.3), Medium::half_space(70e3, 0.4).unwrap()] {
            let found = under(&medium, 0.010);
            // Just below the surface within the contact: what the contact itself says.
            let near = found.at(1e-4, 0.0).unwrap();
            assert_relative_eq!(near.axial, found.contact.indentation(), max_relative = 0.02);
            assert_eq!(near.radial, 0.0);
        }
        let base = under(&pad(0.010, 0.45), 0.010).at(0.010, 0.004).unwrap();
        assert!(base.axial.abs() < 1e-8 && base.radial.abs() < 1e-8, "{base:?}");
    }

    #[test]
    fn far_away_it_is_a_point_load_on_a_half_space() {
        // Boussinesq: u_z = F (1+ν) / (2πE) · (z²/R³ + 2(1−ν)/R), u_r = F (1+ν) / (2πE) · (rz/R³ − (1−2ν) r / (R(R+z))).
        let nu = 0.3;
        let found = under(&Medium::half_space(70e3, nu).unwrap(), 0.004);
        let (z, r) = (0.03f64, 0.04f64);
        let big = z.hypot(r);
        let scale = 1.0 * (1.0 + nu) / (std::f64::consts::TAU * 70e3);
        let at = found.at(z, r).unwrap();
        assert_relative_eq!(
            at.axial,
            scale * (z * z / big.powi(3) + 2.0 * (1.0 - nu) / big),
            max_relative = 5e-3
        );
        let radial = scale * (r * z / big.powi(3) - (1.0 - 2.0 * nu) * r / (big * (big + z)));
        assert_relative_eq!(at.radial, radial, max_relative = 2e-2);
    }

    #[test]
    fn depth_decides_as_the_thesis_found() {
        let found = under(&pad(0.010, 0.49), 0.010);
        let axial = |depth: f64, r: f64| found.at(depth, r).unwrap().axial;
        let radial = |depth: f64, r: f64| found.at(depth, r).unwrap().radial;
        // Δz falls monotonically with the distance and is much stronger near the surface than at the base.
        for depth in [L1, L2, L3] {
            let along: Vec<f64> = (0..=6).map(|i| axial(depth, f64::from(i) * 1e-3)).collect();
            assert!(along.windows(2).all(|w| w[1] < w[0]), "{depth}: {along:?}");
        }
        assert!(axial(L1, 0.0) > 2.0 * axial(L2, 0.0) && axial(L1, 0.0) > 10.0 * axial(L3, 0.0));
        // Δx is 0 in the middle, grows, then falls: its isolines have a pole there.
        for depth in [L1, L2, L3] {
            let along: Vec<f64> = (0..=12).map(|i| radial(depth, f64::from(i) * 1e-3)).collect();
            let peak = (0..along.len()).max_by(|a, b| along[*a].total_cmp(&along[*b])).unwrap();
            assert!(along[0] == 0.0 && (2..11).contains(&peak), "{depth}: {along:?}");
            assert!(along[..=peak].windows(2).all(|w| w[1] > w[0]));
            assert!(along[peak..].windows(2).all(|w| w[1] < w[0]), "{along:?}");
        }
    }

    #[test]
    fn thicker_media_move_more() {
        // 1 mm below the surface of 5, 10 and 15 mm: in depth, while aside it changes little, and falls.
        let at = |thickness, r| under(&pad(thickness, 0.49), 0.010).at(L1, r).unwrap();
        let axial = [0.005, 0.010, 0.015].map(|h| at(h, 0.0).axial);
        assert!(axial[0] < axial[1] && axial[1] < axial[2], "{axial:?}");
        let radial = [0.005, 0.010, 0.015].map(|h| at(h, 0.003).radial);
        assert!(radial[0] > radial[1] && radial[1] > radial[2], "{radial:?}");
        assert!(axial[2] / axial[0] > radial[0] / radial[2], "{axial:?} {radial:?}");
    }

    #[test]
    fn a_lower_poisson_ratio_moves_more_in_depth_and_less_aside() {
        let at = |poisson, r| under(&pad(0.010, poisson), 0.010).at(L1, r).unwrap();
        let axial = [0.3, 0.4, 0.49].map(|nu| at(nu, 0.0).axial);
        assert!(axial[0] > axial[1] && axial[1] > axial[2], "{axial:?}");
        let radial = [0.3, 0.4, 0.49].map(|nu| at(nu, 0.003).radial);
        assert!(radial[0] < radial[1] && radial[1] < radial[2], "{radial:?}");
    }

    #[test]
    fn larger_indenters_move_less() {
        let axial = [0.004, 0.010, 0.020].map(|d| under(&pad(0.010, 0.49), d).at(L1, 0.0).unwrap().axial);
        assert!(axial[0] > axial[1] && axial[1] > axial[2], "{axial:?}");
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let medium = pad(0.010, 0.49);
        assert!(SphereDisplacement::new(&medium, 0.0, 1.0).is_err());
        assert!(SphereDisplacement::new(&medium, 0.01, -1.0).is_err());
        assert!(under(&medium, 0.010).at(0.011, 0.0).is_err());
    }
}
