//! One wave of load on a soft layer over a rigid base: finite elements across the depth.
//!
//! A load `q cos(k x)` on the surface (or a traction `t sin(k x)` along it) leaves displacements `u_x = U(z) sin(k x)`,
//! `u_z = W(z) cos(k x)` and a mean pressure `P(z) cos(k x)`. U and W are quadratic, P is linear in every element
//! (Taylor-Hood, so that a nearly incompressible layer does not lock); the modulus may differ from element to element.

use std::ops::Range;

/// A layer, seen across its depth.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Layer {
    /// \[m\].
    pub thickness: f64,
    /// Poisson's ratio, below 0.5.
    pub poisson: f64,
    /// Share of the shear modulus' change from the middle to the surface: 0 is a layer that is the same throughout.
    pub grade: f64,
    /// 0 is bonded to the base, 1 slips on it freely; between, the bond is a shear spring of (1 - slip) / slip · μ / thickness.
    pub slip: f64,
    /// Elements across the depth.
    pub elements: usize,
}

/// What one wave leaves at each of some depths.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Wave {
    /// Pressure of each depth, of a unit load across the surface.
    pub normal: Vec<f64>,
    /// Pressure of each depth, of a unit traction along the surface; in sine phase with it, so that its Fourier partner is cos.
    pub along: Vec<f64>,
    /// \[m / Pa\] that the surface sinks in, with shear modulus 1 Pa.
    pub sink: f64,
}

/// Half the bandwidth of the system: an element holds U, W at three nodes and P at two.
const BAND: usize = 8;

/// Symmetric quasidefinite band matrix: it has an LDLᵀ in every order, without pivots (Vanderbei 1995).
struct Band {
    rows: usize,
    lower: Vec<f64>,
}

impl Band {
    fn new(rows: usize) -> Self {
        Self { rows, lower: vec![0.0; rows * (BAND + 1)] }
    }

    fn add(&mut self, i: usize, j: usize, value: f64) {
        if j <= i {
            self.lower[i * (BAND + 1) + BAND - (i - j)] += value;
        }
    }

    fn get(&self, i: usize, j: usize) -> f64 {
        self.lower[i * (BAND + 1) + BAND - (i - j)]
    }

    fn reach(i: usize) -> Range<usize> {
        i.saturating_sub(BAND)..i
    }

    /// Factorises and solves for each right side in its place.
    fn solve(mut self, sides: &mut [Vec<f64>]) {
        let mut d = vec![0.0; self.rows];
        for i in 0..self.rows {
            let mut pivot = self.get(i, i);
            for j in Self::reach(i) {
                let mut sum = self.get(i, j);
                let first = Self::reach(i).start.max(Self::reach(j).start);
                for (m, pivot) in d.iter().enumerate().take(j).skip(first) {
                    sum -= self.get(i, m) * self.get(j, m) * pivot;
                }
                let l = sum / d[j];
                self.lower[i * (BAND + 1) + BAND - (i - j)] = l;
                pivot -= l * l * d[j];
            }
            d[i] = pivot;
        }
        for x in sides {
            for i in 0..self.rows {
                for j in Self::reach(i) {
                    x[i] -= self.get(i, j) * x[j];
                }
            }
            for i in 0..self.rows {
                x[i] /= d[i];
            }
            for i in (0..self.rows).rev() {
                for j in Self::reach(i) {
                    x[j] -= self.get(i, j) * x[i];
                }
            }
        }
    }
}

impl Layer {
    /// Shear modulus at height `z` over the base, relative to that of the middle.
    fn shear(&self, z: f64) -> f64 {
        1.0 + self.grade * (2.0 * z / self.thickness - 1.0)
    }

    /// The wave of number `k` \[1/m\] at `depths` \[m\] below the surface.
    pub fn wave(&self, k: f64, depths: &[f64]) -> Wave {
        let n = self.elements;
        let size = self.thickness / n as f64;
        // Node by node from the base up: U, W and, at the ends of elements, P.
        let rows = 5 * n + 3;
        let displacement = |node: usize| 5 * (node / 2) + 3 * (node % 2);
        let pressure = |end: usize| 5 * end + 2;
        let mut matrix = Band::new(rows);
        let bulk = 2.0 * (1.0 + self.poisson) / (3.0 * (1.0 - 2.0 * self.poisson));
        // Gauss points of the interval from -1 to 1.
        let gauss = [(-0.6f64.sqrt(), 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.6f64.sqrt(), 5.0 / 9.0)];
        for e in 0..n {
            for (xi, weight) in gauss {
                let z = (e as f64 + 0.5 * (1.0 + xi)) * size;
                let mu = self.shear(z);
                let w = weight * size / 2.0;
                let shape = [0.5 * xi * (xi - 1.0), 1.0 - xi * xi, 0.5 * xi * (xi + 1.0)];
                let slope = [xi - 0.5, -2.0 * xi, xi + 0.5].map(|s| s * 2.0 / size);
                let linear = [0.5 * (1.0 - xi), 0.5 * (1.0 + xi)];
                // The deviator's energy is 2 μ (εxx² + εzz² - (εxx + εzz)² / 3) / 2 + μ γ² / 2.
                for a in 0..3 {
                    for b in 0..3 {
                        let (i, j) = (displacement(2 * e + a), displacement(2 * e + b));
                        let (xx, xz, zz) =
                            (k * k * shape[a] * shape[b], k * shape[a] * slope[b], slope[a] * slope[b]);
                        matrix.add(i, j, w * mu * (4.0 / 3.0 * xx + zz));
                        matrix.add(i + 1, j + 1, w * mu * (4.0 / 3.0 * zz + xx));
                        let cross = w * mu * (-2.0 / 3.0 * xz - k * slope[a] * shape[b]);
                        matrix.add(i, j + 1, cross);
                        matrix.add(j + 1, i, cross);
                    }
                    for (b, p) in linear.iter().enumerate() {
                        let (i, j) = (displacement(2 * e + a), pressure(e + b));
                        for (row, coupling) in [(i, -w * k * shape[a] * p), (i + 1, -w * slope[a] * p)] {
                            matrix.add(row.max(j), row.min(j), coupling);
                        }
                    }
                }
                for a in 0..2 {
                    for b in 0..=a {
                        matrix.add(
                            pressure(e + a),
                            pressure(e + b),
                            -w * linear[a] * linear[b] / (bulk * mu),
                        );
                    }
                }
            }
        }
        // A stiff spring holds the base; a softer one along it where it may slip.
        let hold = 1e9 / self.thickness;
        let slip = self.slip.clamp(0.0, 1.0);
        let bond = if slip < 1e-6 { hold } else { self.shear(0.0) * (1.0 - slip) / slip / self.thickness };
        matrix.add(0, 0, bond + 1e-9 / self.thickness);
        matrix.add(1, 1, hold);
        let top = displacement(2 * n);
        let mut sides = [vec![0.0; rows], vec![0.0; rows]];
        sides[0][top + 1] = -1.0;
        sides[1][top] = 1.0;
        matrix.solve(&mut sides);
        let at = |x: &[f64], depth: f64| {
            let height = ((self.thickness - depth) / size).clamp(0.0, n as f64);
            let e = (height as usize).min(n - 1);
            let part = height - e as f64;
            x[pressure(e)] * (1.0 - part) + x[pressure(e + 1)] * part
        };
        Wave {
            normal: depths.iter().map(|d| at(&sides[0], *d)).collect(),
            along: depths.iter().map(|d| at(&sides[1], *d)).collect(),
            sink: -sides[0][top + 1],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_waves_do_not_feel_the_base() {
        // Half space, any Poisson's ratio: mean pressure 2 (1 + ν) / 3 · exp(-k z) of a unit wave (Boussinesq).
        let layer = Layer { thickness: 0.020, poisson: 0.49, grade: 0.0, slip: 0.0, elements: 80 };
        for k in [500.0, 1000.0] {
            let wave = layer.wave(k, &[0.002, 0.005]);
            for (depth, pressure) in [0.002f64, 0.005].into_iter().zip(wave.normal) {
                let exact = 2.0 * 1.49 / 3.0 * (-k * depth).exp();
                approx::assert_relative_eq!(pressure, exact, max_relative = 1e-2);
            }
            // The surface sinks in by (1 - ν) q / (μ k).
            approx::assert_relative_eq!(wave.sink, 0.51 / k, max_relative = 2e-3);
        }
    }

    #[test]
    fn a_long_wave_squeezes_the_layer() {
        // Where it cannot move along the base: confined compression, the load times (1 + ν) / (3 (1 - ν)).
        let bonded = Layer { thickness: 0.010, poisson: 0.45, grade: 0.0, slip: 0.0, elements: 40 };
        approx::assert_relative_eq!(
            bonded.wave(0.5, &[0.005]).normal[0],
            1.45 / (3.0 * 0.55),
            max_relative = 1e-3
        );
        // Where it slips freely it gives way along the wave: the load times (1 + ν) / 3.
        let free = Layer { slip: 1.0, ..bonded };
        approx::assert_relative_eq!(free.wave(20.0, &[0.005]).normal[0], 1.45 / 3.0, max_relative = 1e-2);
    }
}
