//! The thumb's outside: a cone that a sphere closes, both about z, the base at z = 0.
//!
//! A location has two coordinates: the way s \[m\] along a meridian of the outside, from the tip downwards, and the azimuth φ \[rad\].
//! The sphere touches the cone, so that the normal is continuous. Surfaces at one depth below the outside are a cone and a sphere again.
//! Everything here is closed-form.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Point3, Vector3};

/// A cone with a spherical tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thumb {
    /// \[m\] of the sphere.
    tip: f64,
    /// \[m\] of its centre above the base.
    centre: f64,
    /// Sine and cosine of the angle between axis and wall.
    slope: [f64; 2],
    /// \[m\] from the tip to where the sphere ends.
    cap: f64,
    /// \[m\] from the tip to the base.
    length: f64,
}

impl Thumb {
    /// A thumb whose base has the radius `base`, which is `height` high, and whose tip is a sphere of the radius `tip`, all \[m\].
    ///
    /// # Errors
    ///
    /// A sentence where no cone touches that sphere.
    pub fn new(base: f64, height: f64, tip: f64) -> Result<Self, String> {
        let centre = height - tip;
        let far = base.hypot(centre);
        // Also refuses what is not a number.
        if !(tip > 0.0 && base >= tip && centre > 0.0) {
            return Err(format!(
                "a tip of {tip} m does not fit a thumb of {height} m with a base of {base} m: its radius must be positive and at \
                 most the base's, and smaller than the height"
            ));
        }
        // The wall's normal (cos α, sin α) satisfies base cos α − centre sin α = tip.
        let angle = (tip / far).acos() - centre.atan2(base);
        let (sin, cos) = angle.sin_cos();
        let cap = tip * (FRAC_PI_2 - angle);
        let wall = (base - tip * cos).hypot(centre + tip * sin);
        Ok(Self { tip, centre, slope: [sin, cos], cap, length: cap + wall })
    }

    /// \[m\] from the tip to the base, along the outside.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    /// \[m\] from the tip to where the sphere ends.
    #[must_use]
    pub fn cap(&self) -> f64 {
        self.cap
    }

    /// \[m\] from the tip down to the height `z` of the outside.
    #[must_use]
    pub fn way_to(&self, z: f64) -> f64 {
        let [sin, cos] = self.slope;
        let from = self.centre + self.tip * sin;
        if z <= from {
            self.cap + (from - z) / cos
        } else {
            self.tip * ((z - self.centre) / self.tip).clamp(-1.0, 1.0).acos()
        }
    }

    /// Distance from the axis, height, and the outward normal's two parts, at the way `s` and `depth` \[m\] below the outside.
    #[must_use]
    pub fn meridian(&self, s: f64, depth: f64) -> [f64; 4] {
        let [sin, cos] = self.slope;
        let radius = self.tip - depth;
        if s <= self.cap {
            let (nr, nz) = (s / self.tip).sin_cos();
            [radius * nr, self.centre + radius * nz, nr, nz]
        } else {
            let down = s - self.cap;
            [radius * cos + down * sin, self.centre + radius * sin - down * cos, cos, sin]
        }
    }

    /// The point at (s, φ), `depth` below the outside, and the outward normal.
    #[must_use]
    pub fn point(&self, s: f64, azimuth: f64, depth: f64) -> (Point3<f64>, Vector3<f64>) {
        let [r, z, nr, nz] = self.meridian(s, depth);
        let (sin, cos) = azimuth.sin_cos();
        (Point3::new(r * cos, r * sin, z), Vector3::new(nr * cos, nr * sin, nz))
    }

    /// (s, φ) of the meridian's point that is closest to `p`, and how far below the outside `p` lies.
    #[must_use]
    pub fn locate(&self, p: &Point3<f64>) -> (f64, f64, f64) {
        let [sin, cos] = self.slope;
        let (square, z) = (p.x * p.x + p.y * p.y, p.z - self.centre);
        let r = square.sqrt();
        let azimuth = p.y.atan2(p.x);
        // Beside the cone's normal through the end of the cap, or above it.
        if z * cos >= r * sin {
            let polar = r.atan2(z);
            (polar * self.tip, azimuth, self.tip - (square + z * z).sqrt())
        } else {
            let down = r * sin - z * cos;
            (self.cap + down, azimuth, self.tip - (r * cos + z * sin))
        }
    }

    /// \[m\] along a unit vector from a point to the surface at this `depth` below the outside; `None` where the point is not within that surface,
    /// or the ray never leaves it.
    #[must_use]
    pub fn way_out(&self, from: &Point3<f64>, ray: &Vector3<f64>, depth: f64) -> Option<f64> {
        let [sin, cos] = self.slope;
        let radius = self.tip - depth;
        if self.locate(from).2 <= depth {
            return None;
        }
        let from = Vector3::new(from.x, from.y, from.z - self.centre);
        // Half the linear term, and the constant one, of a quadratic that is negative within; a ray is along the unit vector.
        let larger = |square: f64, half: f64, constant: f64| {
            let root = (half * half - square * constant).max(0.0).sqrt();
            // Without a difference of two numbers that are nearly alike.
            if half > 0.0 { -constant / (half + root) } else { (root - half) / square }
        };
        let along = from.dot(ray);
        let sphere = larger(1.0, along, from.norm_squared() - radius * radius);
        let p = from + ray * sphere;
        if sphere > 0.0 && p.z * cos >= (p.x * p.x + p.y * p.y).sqrt() * sin {
            return Some(sphere);
        }
        // (r cos)² = (R − z sin)².
        let rest = radius - from.z * sin;
        let square = cos * cos * (ray.x * ray.x + ray.y * ray.y) - sin * sin * ray.z * ray.z;
        let half = cos * cos * (from.x * ray.x + from.y * ray.y) + rest * sin * ray.z;
        let constant = cos * cos * (from.x * from.x + from.y * from.y) - rest * rest;
        let cone = larger(square, half, constant);
        (cone > 0.0 && cone.is_finite()).then_some(cone)
    }

    /// \[1/m\] mean of both curvatures of the outside at the way `s`.
    #[must_use]
    pub fn curvature(&self, s: f64) -> f64 {
        if s <= self.cap {
            1.0 / self.tip
        } else {
            // A cone is straight along its meridians.
            0.5 * self.slope[1] / self.meridian(s, 0.0)[0]
        }
    }

    /// \[m²\] of the outside from the tip down to the way `s`.
    #[must_use]
    pub fn area(&self, s: f64) -> f64 {
        use std::f64::consts::{PI, TAU};
        let polar = s.min(self.cap) / self.tip;
        let round = TAU * self.tip * self.tip * (1.0 - polar.cos());
        let down = (s - self.cap).max(0.0);
        let [top, bottom] = [self.cap, self.cap + down].map(|s| self.meridian(s, 0.0)[0]);
        round + PI * (top + bottom) * down
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn thumb() -> Thumb {
        Thumb::new(0.020, 0.070, 0.009).unwrap()
    }

    #[test]
    fn it_has_the_size_that_it_was_made_of() {
        let thumb = thumb();
        let [r, z, ..] = thumb.meridian(thumb.length(), 0.0);
        assert_relative_eq!(r, 0.020, max_relative = 1e-12);
        assert!(z.abs() < 1e-15);
        assert_relative_eq!(thumb.meridian(0.0, 0.0)[1], 0.070, max_relative = 1e-12);
        assert_relative_eq!(thumb.meridian(thumb.way_to(0.0115), 0.0)[1], 0.0115, max_relative = 1e-12);
        assert_relative_eq!(thumb.meridian(thumb.way_to(0.068), 0.0)[1], 0.068, max_relative = 1e-12);
        // A cylinder with a half-sphere.
        let dome = Thumb::new(0.01, 0.03, 0.01).unwrap();
        assert_relative_eq!(dome.length(), 0.02 + 0.01 * FRAC_PI_2, max_relative = 1e-12);
        assert_relative_eq!(
            dome.area(dome.length()),
            std::f64::consts::TAU * 0.01 * 0.03,
            max_relative = 1e-12
        );
    }

    #[test]
    fn what_cannot_be_is_refused() {
        for [base, height, tip] in [[0.02, 0.07, 0.03], [0.02, 0.01, 0.015], [0.02, 0.07, f64::NAN]] {
            assert!(Thumb::new(base, height, tip).unwrap_err().contains("does not fit"));
        }
    }

    proptest! {
        #[test]
        fn rays_leave_at_the_depth_that_was_asked_for(
            height in 0.005..0.055f64, beside in 0.0..0.004f64, around in -3.1..3.1f64, polar in 0.0..2.5f64, azimuth in -3.1..3.1f64,
            depth in 0.0..0.004f64,
        ) {
            let thumb = thumb();
            let from = Point3::new(beside * around.cos(), beside * around.sin(), height);
            let ray = Vector3::new(polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos());
            let way = thumb.way_out(&from, &ray, depth).unwrap();
            prop_assert!((thumb.locate(&(from + ray * way)).2 - depth).abs() < 1e-12);
            // It is the first such place, and beyond it there is no way out.
            for share in [0.1, 0.5, 0.9] {
                prop_assert!(thumb.locate(&(from + ray * (way * share))).2 > depth);
            }
            prop_assert_eq!(thumb.way_out(&(from + ray * (way + 1e-6)), &ray, depth), None);
        }

        #[test]
        fn locations_are_found_again(share in 0.001..0.999f64, azimuth in -3.1..3.1f64, depth in -0.002..0.004f64) {
            let thumb = thumb();
            let s = share * thumb.length();
            let (p, normal) = thumb.point(s, azimuth, depth);
            prop_assert!((normal.norm() - 1.0).abs() < 1e-12);
            let (found, around, below) = thumb.locate(&p);
            prop_assert!((found - s).abs() < 1e-12 && (around - azimuth).abs() < 1e-9 && (below - depth).abs() < 1e-12);
        }
    }
}
