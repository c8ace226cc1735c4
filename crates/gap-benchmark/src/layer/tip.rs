//! A spherical tip that sinks into a layer: Sneddon's sphere with the thickness correction of Dimitriadis.

/// A tip in a layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tip {
    /// \[m\] of the sphere.
    pub radius: f64,
    /// \[Pa\].
    pub young: f64,
    /// Poisson's ratio.
    pub poisson: f64,
    /// \[m\] of the layer.
    pub thickness: f64,
    /// Whether the exact sphere is taken (Sneddon 1965), or the paraboloid (Hertz 1881).
    pub sphere: bool,
}

/// Coefficients of Dimitriadis et al. 2002 for a bonded, incompressible layer.
const THIN: [f64; 4] = [1.133, 1.283, 0.769, 0.0975];

impl Tip {
    /// Force \[N\] and depth \[m\] of a contact of radius `a` \[m\].
    fn of_radius(&self, a: f64) -> (f64, f64) {
        let modulus = self.young / (1.0 - self.poisson * self.poisson);
        let r = self.radius;
        let (force, depth) = if self.sphere {
            let ratio = ((r + a) / (r - a)).ln();
            (modulus * (0.5 * (a * a + r * r) * ratio - a * r), 0.5 * a * ratio)
        } else {
            (4.0 / 3.0 * modulus * a.powi(3) / r, a * a / r)
        };
        let chi = (r * depth).sqrt() / self.thickness;
        let stiffer = THIN.iter().rev().fold(0.0, |sum, c| (sum + c) * chi) + 1.0;
        (force * stiffer, depth)
    }

    /// Contact radius and depth \[m\] under `force` \[N\].
    pub fn under(&self, force: f64) -> (f64, f64) {
        // The contact does not grow beyond the shaft, which is as wide as the tip.
        let (mut low, mut high) = (0.0, 0.98 * self.radius);
        if force <= 0.0 {
            return (0.0, 0.0);
        }
        let (most, deepest) = self.of_radius(high);
        if force >= most {
            // Beyond, it is a punch: stiffness 2 a E* with the same correction.
            return (high, deepest + (force - most) / (most / deepest));
        }
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if self.of_radius(middle).0 < force {
                low = middle;
            } else {
                high = middle;
            }
        }
        (low, self.of_radius(low).1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_light_touch_of_a_thick_layer_is_hertz() {
        let tip = Tip { radius: 0.002, young: 70e3, poisson: 0.49, thickness: 1.0, sphere: true };
        let (a, depth) = tip.under(1e-4);
        let modulus = 70e3 / (1.0 - 0.49f64.powi(2));
        let hertz = (0.75 * 1e-4 * 0.002 / modulus).cbrt();
        approx::assert_relative_eq!(a, hertz, max_relative = 0.01);
        approx::assert_relative_eq!(depth, hertz * hertz / 0.002, max_relative = 0.02);
    }

    #[test]
    fn more_force_sinks_deeper() {
        let tip = Tip { radius: 0.002, young: 70e3, poisson: 0.49, thickness: 0.01, sphere: true };
        let depths: Vec<f64> = (0..40).map(|i| tip.under(0.05 * f64::from(i)).1).collect();
        assert!(depths.windows(2).all(|d| d[0] < d[1]));
    }
}
