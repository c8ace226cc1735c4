//! An elastomer over a rigid core, both hemispheres on cylinders.
//!
//! Problem: the influence of a sensor inside, which is the stress that it reads under a unit force anywhere on the outside.
//! Method: semi-analytical finite elements for a body of revolution (Wilson, "Structural analysis of axisymmetric solids",
//! AIAA J. 3, 1965): a Fourier series about the axis, each harmonic solved on the half section. By reciprocity the load is a
//! source of dilatation in the sensor's place; its field in a medium without boundaries (Kelvin's solution) is known and taken
//! out, so that the elements find only the smooth part that the boundaries add.
//! Assumptions: linear elasticity, a homogeneous elastomer, a rigid core to which it is bonded or on which it slips; the
//! outside and the foot are free.
//! Cost: one sparse Cholesky factorisation a harmonic, at most 81, shared by all sensors; sensors on one ring share a solution.
//!
//! `shape` is the geometry, `meridian` the mesh, `element` the stiffness of an element, `boundary` the loads of the sources,
//! `harmonics` the equations of each harmonic.

use std::f64::consts::{PI, TAU};

use dermis_skin::cache::{Bytes, Keep};
use nalgebra::{Point3, Vector3};

use super::source::Source;
use super::{Bicubic, Probe};
use crate::{Base, MechanicsError, Medium};
use meridian::Meridian;

pub use shape::DomeShape;

mod boundary;
mod element;
mod harmonics;
mod meridian;
mod shape;
#[cfg(test)]
mod tests;

/// Most harmonics.
const HARMONICS_MAX: f64 = 80.0;

/// \[m\] between rings that are taken for one.
const SAME: f64 = 1e-6;

/// How finely all is resolved, in the depth of the shallowest sensor.
struct Resolution {
    /// Elements in that depth.
    elements: f64,
    /// Points of the table of influences in that depth.
    points: f64,
    /// What may be left of the highest harmonic.
    left: f64,
}

/// Resolves influences to about 0.2 % of their peak.
const USUAL: Resolution = Resolution { elements: 6.0, points: 7.0, left: 1e-4 };

/// Influence of sensors in a dome, tabulated over its outside.
///
/// The core is rigid; the outside and the foot of the cylinder are free. Around the axis, displacements are a Fourier
/// series; each harmonic is solved on the meridian by quadratic quadrilaterals with a linear dilatation each (B-bar), which
/// neither lock nor show alternating pressures. What a sensor's place sends out in a medium without end is known, so that
/// the elements only find what the boundaries add.
#[derive(Debug, Clone)]
pub struct Dome {
    shape: DomeShape,
    table: Bicubic,
}

impl Keep for Dome {
    fn put(&self, out: &mut Vec<u8>) {
        [self.shape.radius, self.shape.cylinder, self.shape.thickness].put(out);
        self.table.put(out);
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        let [radius, cylinder, thickness] = Keep::take(from)?;
        Some(Self { shape: DomeShape { radius, cylinder, thickness }, table: Keep::take(from)? })
    }
}

impl Dome {
    /// Solves for `probes` in an elastomer of `poisson_ratio` on a core to which it is bonded or on which it slips.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a number cannot be, or a point of a probe does not lie in the elastomer, at least
    /// a twentieth of its thickness away from the outside, the core and the foot.
    pub fn new(
        shape: DomeShape,
        poisson_ratio: f64,
        base: Base,
        probes: &[Probe],
    ) -> Result<Self, MechanicsError> {
        Self::resolved(shape, poisson_ratio, base, probes, &USUAL)
    }

    fn resolved(
        shape: DomeShape,
        poisson_ratio: f64,
        base: Base,
        probes: &[Probe],
        resolution: &Resolution,
    ) -> Result<Self, MechanicsError> {
        shape.check()?;
        Medium::half_space(1.0, poisson_ratio)?;
        let depth = least_depth(&shape, probes)?;
        let mesh = Meridian::new(shape, depth / resolution.elements);
        let (rings, locations) = on_rings(probes);
        // The field that boundaries send back comes from beyond them and falls by R/(R+d) from harmonic to harmonic.
        let harmonics =
            (-resolution.left.ln() / (depth / shape.radius).ln_1p()).ceil().min(HARMONICS_MAX) as usize;
        let sources: Vec<Source> =
            rings.iter().map(|[r, z]| Source::new(Point3::new(*r, 0.0, *z), poisson_ratio)).collect();
        let step = depth / resolution.points;
        let along = (shape.length() / step).ceil().clamp(8.0, 200.0) as usize + 1;
        // Even, so that the other side of the tip is a point of the table.
        let around = 2 * (PI * shape.radius / step).ceil().clamp(8.0, 150.0) as usize;
        let steps = [shape.length() / (along - 1) as f64, TAU / around as f64];
        let arcs: Vec<f64> = (0..along).map(|i| i as f64 * steps[0]).collect();
        let returned = mesh.solve(poisson_ratio, base, &sources, harmonics, &arcs)?;
        let fields = Fields { shape, sources, harmonics, arcs, returned };

        let width = 3 * probes.len();
        let mut values = vec![0.0; along * around * width];
        for i in 0..along {
            for (p, probe) in locations.iter().enumerate() {
                for j in 0..around {
                    let sum = fields.influence(probe, i, j as f64 * steps[1]);
                    let place = (i * around + j) * width + 3 * p;
                    values[place..place + 3].copy_from_slice(sum.as_slice());
                }
            }
        }
        Ok(Self { shape, table: table(&values, steps, [along, around], width) })
    }

    /// The shape.
    #[must_use]
    pub fn shape(&self) -> &DomeShape {
        &self.shape
    }

    /// A mixture: the influence in a dome of which the share `share` behaves like `other`, and the rest like this one.
    ///
    /// # Panics
    ///
    /// Where the other has not the same shape, or other probes.
    #[must_use]
    pub fn mixed(mut self, other: &Self, share: f64) -> Self {
        assert_eq!(self.shape, other.shape);
        self.table.mix(&other.table, share);
        self
    }

    /// Over [`DomeShape::chart`]: \[Pa\] per \[N\] of a force in x, y and z, three numbers a probe.
    #[must_use]
    pub fn influence(&self) -> &Bicubic {
        &self.table
    }
}

/// \[m\] below the outside of the shallowest point of the probes, and at most half of the elastomer's thickness.
fn least_depth(shape: &DomeShape, probes: &[Probe]) -> Result<f64, MechanicsError> {
    let mut depth = shape.thickness / 2.0;
    for (point, _) in probes.iter().flatten() {
        let nearest = shape.depth(point).min(shape.thickness - shape.depth(point)).min(point.z);
        if nearest.is_nan() || nearest < shape.thickness / 20.0 {
            return Err(MechanicsError::Value {
                quantity: "distance of a sensor from the nearest side of the elastomer [m]",
                value: nearest,
                expected: "at least a twentieth of its thickness",
            });
        }
        depth = depth.min(shape.depth(point));
    }
    Ok(depth)
}

/// A point of a probe: its ring, its angle about the axis \[rad\], its weight.
type OnRing = (usize, f64, f64);

/// Radius and height of each ring about the axis that holds a sensor, and the points of each probe on them: sensors on one
/// ring have the same field, turned.
fn on_rings(probes: &[Probe]) -> (Vec<[f64; 2]>, Vec<Vec<OnRing>>) {
    let mut rings: Vec<[f64; 2]> = Vec::new();
    let locations = probes
        .iter()
        .map(|probe| {
            probe
                .iter()
                .map(|(p, weight)| {
                    let (r, angle) = (p.x.hypot(p.y), p.y.atan2(p.x));
                    let same = |ring: &[f64; 2]| (ring[0] - r).abs().max((ring[1] - p.z).abs()) < SAME;
                    let ring = rings.iter().position(same).unwrap_or_else(|| {
                        rings.push([r, p.z]);
                        rings.len() - 1
                    });
                    (ring, angle, *weight)
                })
                .collect()
        })
        .collect();
    (rings, locations)
}

/// The field of each ring: its source, and what the boundaries send back.
struct Fields {
    shape: DomeShape,
    /// By ring.
    sources: Vec<Source>,
    /// The highest one.
    harmonics: usize,
    arcs: Vec<f64>,
    /// Amplitudes by ring, harmonic and arc.
    returned: Vec<[f64; 3]>,
}

impl Fields {
    /// Influence of a probe at the arc of number `i` and an angle about the axis.
    fn influence(&self, probe: &[OnRing], i: usize, angle: f64) -> Vector3<f64> {
        let at = self.shape.point([self.arcs[i], angle]);
        let mut sum = Vector3::zeros();
        for &(ring, turned, weight) in probe {
            let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), turned);
            let here = turn.inverse() * at;
            let own = self.sources[ring].displacement(&here);
            // cos mφ and sin mφ by recursion.
            let (sine, cosine) = (angle - turned).sin_cos();
            let (mut c, mut s) = (1.0, 0.0);
            let mut back = Vector3::zeros();
            for harmonic in 0..=self.harmonics {
                let [u, v, w] = self.returned[(ring * (self.harmonics + 1) + harmonic) * self.arcs.len() + i];
                back += Vector3::new(u * c, v * s, w * c);
                (c, s) = (c * cosine - s * sine, s * cosine + c * sine);
            }
            let cartesian =
                Vector3::new(back.x * cosine - back.y * sine, back.x * sine + back.y * cosine, back.z);
            sum += turn * (own + cartesian) * weight;
        }
        sum
    }
}

/// The table over arc and angle. Beyond the tip it continues on the other side, below the foot by a parabola.
fn table(values: &[f64], steps: [f64; 2], [along, around]: [usize; 2], width: usize) -> Bicubic {
    let row = |i: usize, j: isize| {
        let place = (i * around + j.rem_euclid(around as isize) as usize) * width;
        &values[place..place + width]
    };
    Bicubic::new([0.0; 2], steps, [along, around + 1], width, |[i, j], out| {
        if i < 0 {
            out.copy_from_slice(row(1, j + around as isize / 2));
        } else if i as usize == along {
            let last = [row(along - 1, j), row(along - 2, j), row(along - 3, j)];
            for (k, o) in out.iter_mut().enumerate() {
                *o = 3.0 * (last[0][k] - last[1][k]) + last[2][k];
            }
        } else {
            out.copy_from_slice(row(i as usize, j));
        }
    })
}
