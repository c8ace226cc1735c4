//! Pressure inside a layer under a tip: a doubly periodic Fourier series of waves, summed once into tables.

use super::depth::Layer;

/// How the pressure under a tip is distributed over its contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Profile {
    /// Hertz's: an ellipsoid.
    Ellipsoid,
    /// Hertz's, the flatter the more of the tip's radius \[m\] is in contact.
    Flattening(f64),
}

impl Profile {
    /// Fourier transform of a unit load with contact radius `a` \[m\] at wave number `k` \[1/m\].
    fn transform(self, k: f64, a: f64) -> f64 {
        let x = k * a;
        if x < 1e-3 {
            return 1.0 - x * x / 10.0;
        }
        let ellipsoid = 3.0 * (x.sin() - x * x.cos()) / x.powi(3);
        match self {
            Self::Ellipsoid => ellipsoid,
            Self::Flattening(radius) => {
                let flat = 0.5 * (a / radius).clamp(0.0, 1.0).powi(2);
                ellipsoid * (1.0 - flat) + 2.0 * libm::j1(x) / x * flat
            }
        }
    }
}

/// How finely a field is computed, and what of it is left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Grain {
    /// \[m\] after which the layer repeats.
    pub period: f64,
    /// \[1/m\] of the shortest wave.
    pub shortest: f64,
    /// Elements across the depth.
    pub elements: usize,
}

/// Pressure at depths and distances, of tips of several contact radii.
#[derive(Debug, Clone)]
pub(crate) struct Field {
    depths: [f64; 2],
    radius: f64,
    reach: f64,
    normal: Vec<f64>,
    along: Vec<f64>,
}

const DEPTHS: usize = 7;
const RADII: usize = 7;
const LOCATIONS: usize = 150;

impl Field {
    /// Tables of `layer` for depths \[m\] of the range, contact radii up to `radius` \[m\] and distances up to `reach` \[m\].
    /// `lid` \[m\]: a taxel reads the mean over a square of this side.
    pub fn new(
        layer: &Layer,
        grain: Grain,
        profile: Profile,
        (depths, radius, reach): ([f64; 2], f64, f64),
        lid: f64,
    ) -> Self {
        let layer = Layer { elements: grain.elements, ..layer.clone() };
        let at: Vec<f64> = (0..DEPTHS)
            .map(|i| depths[0] + (depths[1] - depths[0]) * i as f64 / (DEPTHS - 1) as f64)
            .collect();
        // Waves of every length that the sum needs, interpolated: they change slowly with their number.
        let step = std::f64::consts::TAU / grain.period;
        let modes = (grain.shortest / step).floor() as usize;
        let fine = 4 * modes;
        let known: Vec<_> = (0..=fine)
            .map(|i| layer.wave((i as f64 * grain.shortest / fine as f64).max(1e-3), &at))
            .collect();
        let mut field = Self {
            depths,
            radius,
            reach,
            normal: vec![0.0; DEPTHS * RADII * LOCATIONS],
            along: vec![0.0; DEPTHS * RADII * LOCATIONS],
        };
        let cell = 1.0 / (grain.period * grain.period);
        let sinc = |x: f64| if x.abs() < 1e-6 { 1.0 } else { x.sin() / x };
        // Along the x axis: the sum over ky of each kx first, then a cosine (or sine) series.
        let mut rows = vec![[0.0; 2]; DEPTHS * RADII * (modes + 1)];
        for i in 0..=modes {
            for j in 0..=modes {
                let (kx, ky) = (i as f64 * step, j as f64 * step);
                let k = kx.hypot(ky);
                if k > grain.shortest {
                    continue;
                }
                let place = k / grain.shortest * fine as f64;
                let low = (place as usize).min(fine - 1);
                let part = place - low as f64;
                // Both signs of kx and ky.
                let count = if i == 0 { 1.0 } else { 2.0 } * if j == 0 { 1.0 } else { 2.0 };
                let lid = sinc(kx * lid / 2.0) * sinc(ky * lid / 2.0);
                for r in 0..RADII {
                    let a = radius * r as f64 / (RADII - 1) as f64;
                    let weight = count * cell * profile.transform(k, a) * lid;
                    for d in 0..DEPTHS {
                        let mix = |v: &dyn Fn(usize) -> f64| v(low) * (1.0 - part) + v(low + 1) * part;
                        let row = &mut rows[(d * RADII + r) * (modes + 1) + i];
                        row[0] += weight * mix(&|m| known[m].normal[d]);
                        row[1] += weight * kx / k.max(1e-9) * mix(&|m| known[m].along[d]);
                    }
                }
            }
        }
        for place in 0..LOCATIONS {
            let x = reach * place as f64 / (LOCATIONS - 1) as f64;
            let turns: Vec<(f64, f64)> = (0..=modes).map(|i| (i as f64 * step * x).sin_cos()).collect();
            for table in 0..DEPTHS * RADII {
                let row = &rows[table * (modes + 1)..(table + 1) * (modes + 1)];
                let (mut normal, mut along) = (0.0, 0.0);
                for (value, (sin, cos)) in row.iter().zip(&turns) {
                    normal += value[0] * cos;
                    along -= value[1] * sin;
                }
                field.normal[table * LOCATIONS + place] = normal;
                field.along[table * LOCATIONS + place] = along;
            }
        }
        field
    }

    /// \[1/m²\] pressure of 1 N at `distance` \[m\] along the surface, `depth` \[m\] below it, of a contact of radius `a` \[m\];
    /// of a force into the surface, and of one along it that points at the place.
    pub fn at(&self, depth: f64, a: f64, distance: f64) -> (f64, f64) {
        let place = |value: f64, count: usize| {
            let value = value.clamp(0.0, 1.0) * (count - 1) as f64;
            let low = (value as usize).min(count - 2);
            (low, value - low as f64)
        };
        if distance >= self.reach {
            return (0.0, 0.0);
        }
        let (d, dp) = place((depth - self.depths[0]) / (self.depths[1] - self.depths[0]), DEPTHS);
        let (r, rp) = place(a / self.radius, RADII);
        let (x, t) = place(distance / self.reach, LOCATIONS);
        // Catmull and Rom's cubic along the distance.
        let weights = [
            t * (t * (1.0 - 0.5 * t) - 0.5),
            1.0 + t * t * (1.5 * t - 2.5),
            t * (0.5 + t * (2.0 - 1.5 * t)),
            0.5 * t * t * (t - 1.0),
        ];
        let mut sum = (0.0, 0.0);
        for (depth, share) in [(d, 1.0 - dp), (d + 1, dp)] {
            for (radius, part) in [(r, 1.0 - rp), (r + 1, rp)] {
                let table = (depth * RADII + radius) * LOCATIONS;
                for (i, weight) in weights.iter().enumerate() {
                    // The field is even about its middle, and that of a force along the surface is odd.
                    let (index, sign) = match (x + i).checked_sub(1) {
                        None => (1, -1.0),
                        Some(index) => (index.min(LOCATIONS - 1), 1.0),
                    };
                    let weight = weight * share * part;
                    sum.0 += weight * self.normal[table + index];
                    sum.1 += weight * sign * self.along[table + index];
                }
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FINE: Grain = Grain { period: 0.16, shortest: 3000.0, elements: 40 };

    #[test]
    fn far_from_the_base_it_is_the_field_of_boussinesq_and_cerruti() {
        let layer = Layer { thickness: 0.050, poisson: 0.49, grade: 0.0, slip: 0.0, elements: 0 };
        let grain = Grain { elements: 120, period: 0.3, ..FINE };
        let field = Field::new(&layer, grain, Profile::Ellipsoid, ([0.003, 0.006], 0.002, 0.03), 0.0);
        for distance in [0.0, 0.002, 0.004, 0.008] {
            let depth = 0.005f64;
            let r3 = depth.hypot(distance).powi(3);
            let (normal, along) = field.at(depth, 0.0, distance);
            let scale = 1.49 / (3.0 * std::f64::consts::PI);
            approx::assert_relative_eq!(normal, scale * depth / r3, max_relative = 0.02, epsilon = 60.0);
            approx::assert_relative_eq!(along, scale * distance / r3, max_relative = 0.02, epsilon = 60.0);
        }
    }

    #[test]
    fn a_finer_grain_changes_little() {
        let layer = Layer { thickness: 0.010, poisson: 0.49, grade: 0.0, slip: 0.0, elements: 0 };
        let make =
            |grain| Field::new(&layer, grain, Profile::Flattening(0.002), ([0.003, 0.007], 0.002, 0.04), 0.0);
        let (coarse, fine) = (make(Grain { period: 0.12, elements: 24, shortest: 2500.0 }), make(FINE));
        let peak = fine.at(0.005, 0.001, 0.0).0;
        for distance in [0.0, 0.003, 0.01, 0.02] {
            let off = (coarse.at(0.005, 0.001, distance).0 - fine.at(0.005, 0.001, distance).0) / peak;
            assert!(off.abs() < 5e-3, "{off} at {distance} m");
        }
    }
}
