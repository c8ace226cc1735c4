//! What lies on the sheet: foam that is pressed and conducts, under a soft top layer that spreads the pressure.
//!
//! - **Stroke.** Each layer is a Winkler bed that densifies: σ = E ε / (1 − ε/ε_D) (Gibson and Ashby's plateau is left out, as the
//!   thesis measured a Young's modulus only). Layers lie in series: their strokes add up under one pressure.
//! - **Spreading.** The top layer is elastic and bonded; what arrives at the foam is smoother than the face of the tip. The width
//!   of that follows from the layer's transfer function ([`smoothing`]); the profile itself is a smooth step of that width at the
//!   rim of a flat tip, and a squared paraboloid of equal second moment under a ball. Profiles are scaled on the grid, so that the
//!   pressures of a tip carry its force exactly.
//! - **Conduction.** A pressed point conducts g₁ (p/p₀)^m \[S/m²\] besides what the foam leaks untouched.
//!
//! Assumptions: a tip presses along the normal; it is far smaller than the radius of a curved panel, which unrolls without stretch.

use dermis_model::TipShape;
use nalgebra::{Matrix2, Matrix4, Vector2};

use crate::sheet::Grid;

/// A layer that densifies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layer {
    /// \[m\].
    pub thickness: f64,
    /// \[Pa\] at no load.
    pub young_modulus: f64,
    /// Of the solid.
    pub poisson_ratio: f64,
    /// Strain at which nothing is left to be compressed.
    pub densification: f64,
}

impl Layer {
    /// \[Pa\] at which half of the strain to densification is used up.
    fn knee(&self) -> f64 {
        self.young_modulus * self.densification
    }

    /// Strain under a pressure \[Pa\].
    #[must_use]
    pub fn strain(&self, pressure: f64) -> f64 {
        pressure / self.young_modulus / (1.0 + pressure / self.knee())
    }

    /// \[m/Pa\] by which the stroke grows with the pressure.
    fn compliance(&self, pressure: f64) -> f64 {
        self.thickness / self.young_modulus / (1.0 + pressure / self.knee()).powi(2)
    }

    /// \[N/m\] integral of the stroke over the pressure.
    fn complement(&self, pressure: f64) -> f64 {
        let knee = self.knee();
        self.thickness * self.densification * (pressure - knee * (pressure / knee).ln_1p())
    }
}

/// How a point conducts under pressure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piezo {
    /// \[S/m²\] at the reference pressure.
    pub conductance: f64,
    /// \[Pa\].
    pub reference: f64,
    /// Exponent of the pressure, 1 or more.
    pub exponent: f64,
    /// \[Pa\] that close the air gaps before anything conducts.
    pub threshold: f64,
}

impl Piezo {
    /// \[S/m²\] under a pressure \[Pa\].
    #[must_use]
    pub fn at(&self, pressure: f64) -> f64 {
        let share = (pressure - self.threshold) / self.reference;
        if share > 0.0 { self.conductance * share.powf(self.exponent) } else { 0.0 }
    }
}

/// Foam and top layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stack {
    /// The foam, and the layer on it.
    pub layers: [Layer; 2],
    /// \[m\] half width of the smooth rim of a flat tip's pressure.
    pub rim: f64,
}

/// Where a point's cell is sampled along each axis, in steps of the grid from the point.
const SAMPLES: [f64; 2] = [-0.25, 0.25];

impl Stack {
    /// The layers, with the rim that the upper one makes.
    #[must_use]
    pub fn new(foam: Layer, top: Layer) -> Self {
        Self { layers: [foam, top], rim: smoothing(&foam, &top) }
    }

    /// \[m\] that both layers give way under a pressure \[Pa\].
    #[must_use]
    pub fn stroke(&self, pressure: f64) -> f64 {
        self.layers.iter().map(|layer| layer.thickness * layer.strain(pressure)).sum()
    }

    /// \[Pa\] for a stroke \[m\]; `None` where the layers cannot give way that far.
    #[must_use]
    pub fn pressure(&self, stroke: f64) -> Option<f64> {
        let most: f64 = self.layers.iter().map(|layer| layer.thickness * layer.densification).sum();
        if !(0.0..0.999 * most).contains(&stroke) {
            return None;
        }
        let (mut low, mut high) = (0.0, self.layers.iter().map(Layer::knee).fold(0.0, f64::max));
        while self.stroke(high) < stroke {
            high *= 2.0;
        }
        for _ in 0..60 {
            let middle = f64::midpoint(low, high);
            if self.stroke(middle) < stroke { low = middle } else { high = middle }
        }
        Some(f64::midpoint(low, high))
    }

    /// \[N\] on a ball of this radius whose lowest point presses with `peak` \[Pa\]: 2πR ∫ p ds over the stroke.
    fn ball_force(&self, radius: f64, peak: f64) -> f64 {
        let complement: f64 = self.layers.iter().map(|layer| layer.complement(peak)).sum();
        std::f64::consts::TAU * radius * (peak * self.stroke(peak) - complement)
    }

    /// \[Pa\] under the lowest point of a ball of this radius that presses with `force` \[N\]: Newton's method on logarithms.
    fn ball_peak(&self, radius: f64, force: f64) -> f64 {
        let soft: f64 = self.layers.iter().map(|layer| layer.compliance(0.0)).sum();
        let mut peak = (force / (std::f64::consts::PI * radius * soft)).sqrt();
        for _ in 0..40 {
            let found = self.ball_force(radius, peak);
            let compliance: f64 = self.layers.iter().map(|layer| layer.compliance(peak)).sum();
            let slope = std::f64::consts::TAU * radius * peak * peak * compliance / found;
            let step = ((force / found).ln() / slope).clamp(-2.0, 2.0);
            peak *= step.exp();
            if step.abs() < 1e-14 {
                break;
            }
        }
        peak
    }

    /// \[m\] that a tip sinks in when it presses with `force` \[N\].
    #[must_use]
    pub fn depth(&self, tip: &TipShape, force: f64) -> Option<f64> {
        match *tip {
            _ if force <= 0.0 => Some(0.0),
            TipShape::FlatPunch { diameter } => {
                Some(self.stroke(force / (std::f64::consts::FRAC_PI_4 * diameter * diameter)))
            }
            TipShape::Sphere { diameter } => Some(self.stroke(self.ball_peak(diameter / 2.0, force))),
            _ => None,
        }
    }

    /// \[N\] that press a tip in by `depth` \[m\].
    #[must_use]
    pub fn force(&self, tip: &TipShape, depth: f64) -> Option<f64> {
        let pressure = self.pressure(depth)?;
        match *tip {
            TipShape::FlatPunch { diameter } => {
                Some(pressure * std::f64::consts::FRAC_PI_4 * diameter * diameter)
            }
            TipShape::Sphere { diameter } => Some(self.ball_force(diameter / 2.0, pressure)),
            _ => None,
        }
    }

    /// The profile of a tip's pressure on the foam; `None` for shapes that the model does not know.
    #[must_use]
    pub fn profile(&self, tip: &TipShape, force: f64) -> Option<Profile> {
        match *tip {
            TipShape::FlatPunch { diameter } => {
                let radius = diameter / 2.0;
                Some(Profile::Step { inner: (radius - self.rim).max(0.0), outer: radius + self.rim })
            }
            TipShape::Sphere { diameter } => {
                let radius = diameter / 2.0;
                // Of the area that touches: a ball dips in by its stroke.
                let stroke = self.stroke(self.ball_peak(radius, force.max(1e-9)));
                let touched = (2.0 * radius * stroke).min(radius * radius);
                // Second moments of the paraboloid, of what smooths it, and of the profile: a²/3, 2b²/7, ρ²/4.
                let outer = (4.0 * (touched / 3.0 + 2.0 * self.rim * self.rim / 7.0)).sqrt();
                Some(Profile::Bump { outer })
            }
            _ => None,
        }
    }

    /// Appends the pressures \[Pa\] of a tip at the points of a grid around `at` \[m\] that it reaches.
    pub fn press(
        &self,
        grid: &Grid,
        at: [f64; 2],
        profile: &Profile,
        force: f64,
        out: &mut Vec<(usize, f64)>,
    ) {
        let (step, points, outer) = (grid.step(), grid.points(), profile.outer());
        let first = out.len();
        let range = |k: usize| {
            let place = (at[k] + grid.size[k] / 2.0) / step[k];
            let reach = outer / step[k] + 0.5;
            let low = (place - reach).ceil().max(0.0) as usize;
            let high = ((place + reach).floor().max(0.0) as usize).min(points[k] - 1);
            low..=high
        };
        let mut total = 0.0;
        for j in range(1) {
            for i in range(0) {
                let node = grid.number([i, j]);
                let p = grid.position(node);
                let mut sum = 0.0;
                for sx in SAMPLES {
                    for sy in SAMPLES {
                        let [x, y] = [p[0] + sx * step[0] - at[0], p[1] + sy * step[1] - at[1]];
                        sum += profile.at(x * x + y * y);
                    }
                }
                if sum > 0.0 {
                    total += sum * grid.area(node);
                    out.push((node, sum));
                }
            }
        }
        if total > 0.0 {
            let scale = force / total;
            out[first..].iter_mut().for_each(|(_, p)| *p *= scale);
        } else {
            // A tip so small that it lies between all samples.
            for (node, weight) in grid.weights(at) {
                if weight > 0.0 {
                    out.push((node, force * weight / grid.area(node)));
                }
            }
        }
    }
}

/// Shape of a tip's pressure over the distance from its middle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Profile {
    /// 1 up to `inner` \[m\], and a step of continuous curvature down to 0 at `outer`.
    Step {
        /// \[m\].
        inner: f64,
        /// \[m\].
        outer: f64,
    },
    /// (1 − r²/`outer`²)².
    Bump {
        /// \[m\].
        outer: f64,
    },
}

impl Profile {
    /// \[m\] beyond which nothing is pressed.
    #[must_use]
    pub fn outer(&self) -> f64 {
        match *self {
            Self::Step { outer, .. } | Self::Bump { outer } => outer,
        }
    }

    /// \[m²\] its integral over the plane.
    #[must_use]
    pub fn area(&self) -> f64 {
        match *self {
            Self::Step { inner, outer } => {
                let (middle, half) = (f64::midpoint(inner, outer), (outer - inner) / 2.0);
                std::f64::consts::PI * (middle * middle + half * half / 7.0)
            }
            Self::Bump { outer } => std::f64::consts::PI * outer * outer / 3.0,
        }
    }

    /// At the square \[m²\] of a distance.
    #[must_use]
    pub fn at(&self, square: f64) -> f64 {
        match *self {
            Self::Step { inner, outer } => {
                if square >= outer * outer {
                    return 0.0;
                }
                if square <= inner * inner {
                    return 1.0;
                }
                let t = (outer - square.sqrt()) / (outer - inner);
                t * t * t * (10.0 + t * (6.0 * t - 15.0))
            }
            Self::Bump { outer } => {
                let inside = 1.0 - square / (outer * outer);
                if inside > 0.0 { inside * inside } else { 0.0 }
            }
        }
    }
}

/// Share of a pressure wave of `number` \[1/m\] on the top layer that arrives at the foam: the layer by its elastic transfer
/// matrix (axisymmetric state of displacements and stresses), bonded to a foam that resists by E/t and G/t.
#[must_use]
pub fn transfer(foam: &Layer, top: &Layer, number: f64) -> f64 {
    let (e, nu, k) = (top.young_modulus, top.poisson_ratio, number);
    let mu = e / (2.0 * (1.0 + nu));
    let lambda = e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu));
    let p = lambda + 2.0 * mu;
    // d/dz of (u_r, u_z, σ_rz, σ_zz) for J₁, J₀, J₁, J₀ along r; stresses are taken by E, so that numbers are alike.
    let generator = Matrix4::new(
        0.0,
        k,
        e / mu,
        0.0, //
        -lambda / p * k,
        0.0,
        0.0,
        e / p, //
        4.0 * mu * (lambda + mu) / p * k * k / e,
        0.0,
        0.0,
        lambda / p * k, //
        0.0,
        0.0,
        -k,
        0.0,
    );
    let through = (generator * top.thickness).exp();
    let normal = foam.young_modulus / foam.thickness / e;
    let shear = foam.young_modulus / (2.0 * (1.0 + foam.poisson_ratio)) / foam.thickness / e;
    // Displacements of the top follow from σ_rz = −shear u_r and σ_zz = −normal u_z below, where σ_zz = −1 above.
    let above = |r: f64, z: f64, load: f64| through * nalgebra::Vector4::new(r, z, 0.0, -load);
    let rows = |s: nalgebra::Vector4<f64>| Vector2::new(s[2] + shear * s[0], s[3] + normal * s[1]);
    let matrix = Matrix2::from_columns(&[rows(above(1.0, 0.0, 0.0)), rows(above(0.0, 1.0, 0.0))]);
    let right = -rows(above(0.0, 0.0, 1.0));
    let Some(u) = matrix.lu().solve(&right) else { return 1.0 };
    -above(u[0], u[1], 1.0)[3]
}

/// \[m\] half width of the smooth step that stands for the top layer: its kernel has the wave number at which half of a wave
/// arrives in common with a Gaussian, and that Gaussian's variance w² is b²/7.
#[must_use]
pub fn smoothing(foam: &Layer, top: &Layer) -> f64 {
    let (mut low, mut high) = (0.0, 10.0 / top.thickness);
    for _ in 0..50 {
        let middle = f64::midpoint(low, high);
        if transfer(foam, top, middle) > 0.5 { low = middle } else { high = middle }
    }
    let width = (2.0 * 2f64.ln()).sqrt() / f64::midpoint(low, high);
    7f64.sqrt() * width
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use dermis_model::TipShape;
    use proptest::prelude::*;

    use super::*;

    fn stack() -> Stack {
        let foam = Layer { thickness: 8e-3, young_modulus: 157e3, poisson_ratio: 0.03, densification: 0.85 };
        let top = Layer { thickness: 3.2e-3, young_modulus: 95e3, poisson_ratio: 0.25, densification: 0.85 };
        Stack::new(foam, top)
    }

    #[test]
    fn strokes_and_pressures_are_inverse() {
        let stack = stack();
        for pressure in [1e2, 1e4, 1.27e5, 1e6] {
            let found = stack.pressure(stack.stroke(pressure)).unwrap();
            assert_relative_eq!(found, pressure, max_relative = 1e-9);
        }
        assert!(stack.pressure(0.00952).is_none() && stack.pressure(-1e-6).is_none());
    }

    /// F = 2πR ∫ p ds, the integral by Simpson's rule on 2,000 strokes.
    #[test]
    fn a_ball_presses_with_the_integral_of_its_pressure() {
        let stack = stack();
        let (radius, peak) = (0.01, 9e4);
        let depth = stack.stroke(peak);
        let n = 2000;
        let p = |i: usize| stack.pressure(depth * i as f64 / n as f64).unwrap();
        let weight = |i: usize| {
            if i == 0 || i == n {
                1.0
            } else if i % 2 == 1 {
                4.0
            } else {
                2.0
            }
        };
        let integral: f64 = (0..=n).map(|i| weight(i) * p(i)).sum::<f64>() * depth / n as f64 / 3.0;
        let force = stack.ball_force(radius, peak);
        assert_relative_eq!(force, std::f64::consts::TAU * radius * integral, max_relative = 1e-6);
        assert_relative_eq!(stack.ball_peak(radius, force), peak, max_relative = 1e-9);
        let ball = TipShape::Sphere { diameter: 2.0 * radius };
        assert_relative_eq!(stack.force(&ball, depth).unwrap(), force, max_relative = 1e-6);
        assert_relative_eq!(stack.depth(&ball, force).unwrap(), depth, max_relative = 1e-9);
    }

    /// A long wave presses through whole, a short one not at all, and shorter ones ever less.
    #[test]
    fn the_top_layer_lets_long_waves_through() {
        let [foam, top] = stack().layers;
        assert_relative_eq!(transfer(&foam, &top, 1e-3), 1.0, max_relative = 1e-6);
        let mut last = 1.0;
        for i in 1..40 {
            let found = transfer(&foam, &top, f64::from(i) * 50.0);
            assert!(found < last + 1e-9 && found > -0.05, "{found} at {i}");
            last = found;
        }
        assert!(last < 0.05, "{last}");
        let rim = smoothing(&foam, &top);
        assert!((0.5 * top.thickness..4.0 * top.thickness).contains(&rim), "{rim}");
    }

    proptest! {
        /// Pressures carry the force, wherever the tip is and however small.
        #[test]
        fn pressures_carry_the_force(
            x in -0.27..0.27f64, y in -0.28..0.28f64, force in 0.01..40.0f64, diameter in 1e-4..0.06f64, ball in any::<bool>(),
        ) {
            let grid = Grid { size: [0.54, 0.56], cells: [90, 90] };
            let tip = if ball { TipShape::Sphere { diameter } } else { TipShape::FlatPunch { diameter } };
            let stack = stack();
            let profile = stack.profile(&tip, force).unwrap();
            let mut out = Vec::new();
            stack.press(&grid, [x, y], &profile, force, &mut out);
            let carried: f64 = out.iter().map(|(node, p)| p * grid.area(*node)).sum();
            prop_assert!((carried - force).abs() < 1e-9 * force);
            prop_assert!(out.iter().all(|(_, p)| *p > 0.0));
        }
    }
}
