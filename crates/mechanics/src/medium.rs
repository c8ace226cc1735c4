//! A layered elastic medium in Hankel space.

use nalgebra::{Matrix4, Matrix4x2};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::MechanicsError;
use crate::error::positive;
use crate::quadrature::panels;

/// Beyond this exponent a kernel is below the resolution of f64.
pub(crate) const EXPONENT_MAX: f64 = 40.0;
/// kh below which the system of a layer loses its digits, while its kernels have long reached their limits.
const LONGEST: f64 = 1e-3;

/// What holds the lower side of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Base {
    /// Glued to something rigid: no displacement at all.
    #[default]
    Bonded,
    /// Lying on something rigid and smooth: no vertical displacement, no shear stress.
    Slip,
}

/// A load on the surface whose distribution is axisymmetric about its centre: a pressure, or a shear traction that
/// points in one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Load {
    /// All of it in one point.
    Point {
        /// \[N\] pressing in, or along the surface.
        force: f64,
    },
    /// Uniform pressure on a disc.
    Disc {
        /// \[N\] pressing in, or along the surface.
        force: f64,
        /// \[m\] of the disc.
        radius: f64,
    },
    /// The pressure p₀ √(1 − r²/a²) that a sphere makes on a half-space at small indentation (Hertz).
    Hertz {
        /// \[N\] pressing in, or along the surface.
        force: f64,
        /// \[m\] of the contact.
        radius: f64,
    },
}

impl Load {
    /// \[N\] pressing in, or along the surface.
    #[must_use]
    pub fn force(&self) -> f64 {
        match *self {
            Self::Point { force } | Self::Disc { force, .. } | Self::Hertz { force, .. } => force,
        }
    }

    /// Hankel transform of order 0, ∫ p(r) J₀(kr) r dr \[N\], at the wavenumber `k` [1/m].
    #[must_use]
    pub fn transform(&self, k: f64) -> f64 {
        let shape = match *self {
            Self::Point { .. } => 1.0,
            Self::Disc { radius, .. } => {
                let x = k * radius;
                // Series below, where the quotient would lose digits.
                if x < 1e-4 { 1.0 - x * x / 8.0 } else { 2.0 * libm::j1(x) / x }
            }
            Self::Hertz { radius, .. } => {
                let x = k * radius;
                if x < 1e-2 {
                    1.0 - x * x / 10.0 + x.powi(4) / 280.0
                } else {
                    3.0 * (x.sin() - x * x.cos()) / x.powi(3)
                }
            }
        };
        self.force() / TAU * shape
    }

    fn check(&self) -> Result<f64, MechanicsError> {
        if !self.force().is_finite() {
            return Err(MechanicsError::Value {
                quantity: "force [N]",
                value: self.force(),
                expected: "a finite number",
            });
        }
        match *self {
            Self::Point { .. } => Ok(0.0),
            Self::Disc { radius, .. } | Self::Hertz { radius, .. } => {
                positive("radius of the load [m]", radius)
            }
        }
    }
}

/// A linear elastic, isotropic half-space, or a layer on a rigid base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Medium {
    young_modulus: f64,
    poisson_ratio: f64,
    /// Thickness \[m\] and share of slip.
    layer: Option<(f64, f64)>,
}

impl Medium {
    /// A layer of `thickness` \[m\] with `young_modulus` \[Pa\] and `poisson_ratio` on a rigid base.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a modulus or thickness is not positive, or Poisson's ratio is not in
    /// \[0, 0.4999\] (an exactly incompressible layer has no solution in displacements).
    pub fn layer(
        young_modulus: f64,
        poisson_ratio: f64,
        thickness: f64,
        base: Base,
    ) -> Result<Self, MechanicsError> {
        let slip = match base {
            Base::Bonded => 0.0,
            Base::Slip => 1.0,
        };
        Self::mixed(young_modulus, poisson_ratio, thickness, slip)
    }

    /// A layer whose base is neither glued nor free to slip: its kernels are `slip` (0 to 1) parts of those of a
    /// slipping base and 1 − `slip` of those of a bonded one.
    ///
    /// # Errors
    ///
    /// As [`layer`](Self::layer), and where `slip` is not a share.
    pub fn mixed(
        young_modulus: f64,
        poisson_ratio: f64,
        thickness: f64,
        slip: f64,
    ) -> Result<Self, MechanicsError> {
        positive("thickness [m]", thickness)?;
        if !(0.0..=1.0).contains(&slip) {
            return Err(MechanicsError::Value {
                quantity: "share of slip at the base",
                value: slip,
                expected: "between 0 and 1",
            });
        }
        Ok(Self { layer: Some((thickness, slip)), ..Self::half_space(young_modulus, poisson_ratio)? })
    }

    /// An infinitely deep medium with `young_modulus` \[Pa\] and `poisson_ratio`.
    ///
    /// # Errors
    ///
    /// As [`layer`](Self::layer).
    pub fn half_space(young_modulus: f64, poisson_ratio: f64) -> Result<Self, MechanicsError> {
        positive("Young's modulus [Pa]", young_modulus)?;
        if !(0.0..=0.4999).contains(&poisson_ratio) {
            return Err(MechanicsError::Value {
                quantity: "Poisson's ratio",
                value: poisson_ratio,
                expected: "between 0 and 0.4999",
            });
        }
        Ok(Self { young_modulus, poisson_ratio, layer: None })
    }

    /// \[Pa\].
    #[must_use]
    pub fn young_modulus(&self) -> f64 {
        self.young_modulus
    }

    /// Dimensionless.
    #[must_use]
    pub fn poisson_ratio(&self) -> f64 {
        self.poisson_ratio
    }

    /// \[m\]; infinite for a half-space.
    #[must_use]
    pub fn thickness(&self) -> f64 {
        self.layer.map_or(f64::INFINITY, |(h, _)| h)
    }

    /// Share of slip at the base; 0 for a half-space, which has none.
    #[must_use]
    pub fn slip(&self) -> f64 {
        self.layer.map_or(0.0, |(_, slip)| slip)
    }

    /// 2 (1 − ν²) / E \[1/Pa\]: the half-space's surface displacement is this over k, per transformed pressure.
    pub(crate) fn compliance(&self) -> f64 {
        2.0 * (1.0 - self.poisson_ratio * self.poisson_ratio) / self.young_modulus
    }

    /// Mean compressive stress −σₖₖ/3 at `depth` \[m\] per surface pressure, both Hankel-transformed, at the
    /// wavenumber `k` [1/m]. Dimensionless, finite for every k ≥ 0.
    ///
    /// Love's strain function of the layer is f = (A + Bz) e^(−kz) + (C + Dz) e^(k(z−h)). Its four constants
    /// follow from σ_zz = −p and σ_rz = 0 on the surface, and u = w = 0 (bonded) or w = 0, σ_rz = 0 (slip) at
    /// the base; then −σₖₖ/3 = −(1+ν)/3 · 2k² (B e^(−kz) + D e^(k(z−h))). All exponents are negative, so
    /// nothing overflows. (A. E. H. Love, *A Treatise on the Mathematical Theory of Elasticity*, §188;
    /// I. N. Sneddon, *Fourier Transforms*, ch. 10.)
    #[must_use]
    pub fn pressure_kernel(&self, k: f64, depth: f64) -> f64 {
        self.kernels(k, depth)[0]
    }

    /// Mean compressive stress −σₖₖ/3 at `depth` \[m\] per shear traction on the surface, at the wavenumber `k`
    /// [1/m]: under a traction along x whose magnitude has the Hankel transform T̂ of order 0, the stress at the
    /// distance r and the angle θ from x is cos θ ∫ S(k) T̂(k) J₁(kr) k dk. Dimensionless, finite for every k > 0; where
    /// the base slips it grows as 1/k towards long waves.
    ///
    /// The traction's part along the wave vector is the plane problem that Love's function solves, with σ_rz = τ in
    /// place of σ_zz = −p on the surface; its part across the wave vector shears without any change of volume. On a
    /// half-space this is Cerruti's solution, (1+ν) Q x / (3πR³).
    #[must_use]
    pub fn shear_kernel(&self, k: f64, depth: f64) -> f64 {
        self.kernels(k, depth)[1]
    }

    /// [`pressure_kernel`](Self::pressure_kernel) and [`shear_kernel`](Self::shear_kernel).
    pub(crate) fn kernels(&self, k: f64, depth: f64) -> [f64; 2] {
        let nu = self.poisson_ratio;
        let Some((h, slip)) = self.layer.filter(|(h, _)| k * h <= EXPONENT_MAX) else {
            return [2.0 * (1.0 + nu) / 3.0 * (-k * depth).exp(); 2];
        };
        let alpha = (k * h).max(LONGEST);
        let s = alpha * depth / h;
        let (down, up) = ((-s).exp(), (s - alpha).exp());
        // What shear does vanishes with kh where the base holds, and grows as its inverse where it slips.
        let long = k * h / alpha;
        let of = |base, long: f64| {
            let constants = love_constants(alpha, nu, base);
            let kernel = |i| -(1.0 + nu) / 3.0 * 2.0 * (constants[(1, i)] * down + constants[(3, i)] * up);
            [kernel(0), long * kernel(1)]
        };
        mix(slip, || of(Base::Bonded, long), || of(Base::Slip, 1.0 / long))
    }

    /// 1 − g: displacement of the layer's surface relative to that of the half-space at the wavenumber `k`.
    ///
    /// Bonded: (2κ sinh 2α − 4α) / (2κ cosh 2α + 4α² + 1 + κ²) with κ = 3 − 4ν, α = kh; slip:
    /// (cosh 2α − 1) / (sinh 2α + 2α). (K. L. Johnson, *Contact Mechanics*, §5.8.)
    pub(crate) fn relative_displacement(&self, k: f64) -> f64 {
        let Some((h, slip)) = self.layer else { return 1.0 };
        let a = k * h;
        if a > EXPONENT_MAX {
            return 1.0;
        }
        let bonded = || {
            let kappa = 3.0 - 4.0 * self.poisson_ratio;
            let numerator = 2.0 * kappa * (2.0 * a).sinh() - 4.0 * a;
            [numerator / (2.0 * kappa * (2.0 * a).cosh() + 4.0 * a * a + 1.0 + kappa * kappa)]
        };
        // cosh 2α − 1 = 2 sinh² α keeps the digits of a small α.
        let slipping =
            || [if a < 1e-8 { a / 2.0 } else { 2.0 * a.sinh().powi(2) / ((2.0 * a).sinh() + 2.0 * a) }];
        mix(slip, bonded, slipping)[0]
    }

    /// Displacement of the surface into the medium per surface pressure, both Hankel-transformed, at the
    /// wavenumber `k` [1/m]; \[m/Pa\].
    #[must_use]
    pub fn displacement_kernel(&self, k: f64) -> f64 {
        self.compliance() / k * self.relative_displacement(k)
    }

    /// A depth that lies in the medium, or why not.
    pub(crate) fn check_depth(&self, depth: f64) -> Result<(), MechanicsError> {
        let thickness = self.thickness();
        if depth.is_finite() && depth > 0.0 && depth <= thickness {
            Ok(())
        } else {
            Err(MechanicsError::Depth { depth, thickness })
        }
    }

    /// Mean compressive stress −σₖₖ/3 \[Pa\] at `depth` \[m\] and distance `r` \[m\] from the axis of `load`, which
    /// presses.
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where the depth lies outside of the medium or a number cannot be.
    pub fn pressure(&self, load: &Load, depth: f64, r: f64) -> Result<f64, MechanicsError> {
        let a = load.check()?;
        let kernel = |k: f64, x: f64| self.pressure_kernel(k, depth) * load.transform(k) * libm::j0(x);
        self.integrate(a, depth, r, kernel)
    }

    /// Mean compressive stress −σₖₖ/3 \[Pa\] at `depth` \[m\] and distance `r` \[m\] straight ahead of `load`, which is
    /// exerted on the surface along it. At the angle θ from its direction it is cos θ of that: what lies ahead is
    /// compressed, what lies behind is stretched.
    ///
    /// # Errors
    ///
    /// As [`pressure`](Self::pressure).
    pub fn pressure_of_shear(&self, load: &Load, depth: f64, r: f64) -> Result<f64, MechanicsError> {
        let a = load.check()?;
        let kernel = |k: f64, x: f64| self.shear_kernel(k, depth) * load.transform(k) * libm::j1(x);
        let ahead = self.integrate(a, depth, r, kernel)?;
        Ok(if r < 0.0 { -ahead } else { ahead })
    }

    /// ∫ kernel(k, k |r|) k dk for a load of the radius `a` \[m\].
    pub(crate) fn integrate(
        &self,
        a: f64,
        depth: f64,
        r: f64,
        kernel: impl Fn(f64, f64) -> f64,
    ) -> Result<f64, MechanicsError> {
        self.check_depth(depth)?;
        let r = distance(r)?;
        // Both Bessel functions oscillate: a panel spans about one and a half of their periods.
        let panel = (6.0 / (r + a)).min(3.0 / depth);
        let nodes = panels(EXPONENT_MAX / depth, panel);
        Ok(nodes.iter().map(|&(k, w)| w * k * kernel(k, k * r)).sum())
    }

    /// Displacement of the surface into the medium \[m\] at the distance `r` \[m\] from the axis of `load`;
    /// infinite under a point load.
    ///
    /// The half-space's part is a closed form; only the smooth correction of the layer is integrated.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a number cannot be.
    pub fn surface_displacement(&self, load: &Load, r: f64) -> Result<f64, MechanicsError> {
        let a = load.check()?;
        let r = distance(r)?;
        let force = load.force();
        let half = self.compliance() / 2.0;
        let infinite = match *load {
            Load::Point { .. } => half * force / (PI * r),
            Load::Disc { .. } => {
                let p = force / (PI * a * a);
                if r <= a {
                    half * 4.0 * p * a / PI * elliptic(r / a).1
                } else {
                    let m = a / r;
                    let (first, second) = elliptic(m);
                    half * 4.0 * p * r / PI * (second - (1.0 - m * m) * first)
                }
            }
            Load::Hertz { .. } => {
                let p = 1.5 * force / (PI * a * a);
                if r <= a {
                    half * PI * p / (4.0 * a) * (2.0 * a * a - r * r)
                } else {
                    let m = a / r;
                    let angle = (2.0 * a * a - r * r) * m.asin();
                    half * p / (2.0 * a) * (angle + r * a * (1.0 - m * m).sqrt())
                }
            }
        };
        let Some((h, _)) = self.layer else { return Ok(infinite) };
        let panel = (6.0 / (r + a)).min(1.0 / h);
        let correction: f64 = panels(EXPONENT_MAX / 2.0 / h, panel)
            .iter()
            .map(|&(k, w)| w * (1.0 - self.relative_displacement(k)) * load.transform(k) * libm::j0(k * r))
            .sum();
        Ok(infinite - self.compliance() * correction)
    }
}

fn distance(r: f64) -> Result<f64, MechanicsError> {
    if r.is_finite() {
        Ok(r.abs())
    } else {
        Err(MechanicsError::Value { quantity: "distance [m]", value: r, expected: "a finite number" })
    }
}

/// `slip` parts of one kernel and the rest of the other; a part that is not there is not computed.
fn mix<const N: usize>(
    slip: f64,
    bonded: impl Fn() -> [f64; N],
    slipping: impl Fn() -> [f64; N],
) -> [f64; N] {
    if slip <= 0.0 {
        bonded()
    } else if slip >= 1.0 {
        slipping()
    } else {
        let (b, s) = (bonded(), slipping());
        std::array::from_fn(|i| (1.0 - slip) * b[i] + slip * s[i])
    }
}

/// Each constant's part of Love's function f = (A + Bs) e^(−s) + (C + Ds) e^(s−α) and of its first three derivatives (rows)
/// with respect to s = kz, in a layer of kh = `alpha`.
pub(crate) fn love_parts(alpha: f64, s: f64) -> [[f64; 4]; 4] {
    let (down, up) = ((-s).exp(), (s - alpha).exp());
    [
        [down, s * down, up, s * up],
        [-down, (1.0 - s) * down, up, (1.0 + s) * up],
        [down, (s - 2.0) * down, up, (2.0 + s) * up],
        [-down, (3.0 - s) * down, up, (3.0 + s) * up],
    ]
}

/// The constants (rows) of Love's function for unit surface pressure and for unit shear stress (columns); lengths are scaled
/// by k, so that f k³ has the derivatives of [`love_parts`] and every entry stays of order α e^0.
pub(crate) fn love_constants(alpha: f64, nu: f64, base: Base) -> Matrix4x2<f64> {
    let row = |d: &[[f64; 4]; 4], weights: [f64; 4]| -> [f64; 4] {
        std::array::from_fn(|j| (0..4).map(|i| weights[i] * d[i][j]).sum())
    };
    let (top, bottom) = (love_parts(alpha, 0.0), love_parts(alpha, alpha));
    let normal_stress = [0.0, -(2.0 - nu), 0.0, 1.0 - nu];
    let shear_stress = [1.0 - nu, 0.0, nu, 0.0];
    let vertical = [-2.0 * (1.0 - nu), 0.0, 1.0 - 2.0 * nu, 0.0];
    let radial = [0.0, 1.0, 0.0, 0.0];
    let held = match base {
        Base::Bonded => radial,
        Base::Slip => shear_stress,
    };
    let rows =
        [row(&top, normal_stress), row(&top, shear_stress), row(&bottom, vertical), row(&bottom, held)];
    let system = Matrix4::from_fn(|i, j| rows[i][j]);
    let mut sides = Matrix4x2::zeros();
    (sides[(0, 0)], sides[(1, 1)]) = (-1.0, 1.0);
    system.lu().solve(&sides).unwrap_or_default()
}

/// Complete elliptic integrals of the first and second kind of the modulus `m` in \[0, 1\], by the
/// arithmetic-geometric mean (Abramowitz & Stegun 17.6). The first is infinite at 1, where its factor in
/// [`Medium::surface_displacement`] is 0; it is returned as 0 there.
fn elliptic(m: f64) -> (f64, f64) {
    if m >= 1.0 {
        return (0.0, 1.0);
    }
    let (mut a, mut b, mut c) = (1.0, (1.0 - m * m).sqrt(), m);
    let (mut sum, mut power) = (c * c / 2.0, 1.0);
    while c.abs() > 1e-16 {
        (a, b, c) = ((a + b) / 2.0, (a * b).sqrt(), (a - b) / 2.0);
        sum += power * c * c;
        power *= 2.0;
    }
    let first = FRAC_PI_2 / a;
    (first, first * (1.0 - sum))
}

#[cfg(test)]
mod tests;
