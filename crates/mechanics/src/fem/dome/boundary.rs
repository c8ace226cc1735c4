//! What the sources do at the boundaries, harmonic by harmonic.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};

use super::element::quadratic;
use super::meridian::{Edge, Meridian};
use crate::fem::source::Source;
use crate::quadrature::gauss_legendre;

/// What sources do at the boundary: harmonics of the forces that free the boundary of their stress, and of the displacements
/// that undo theirs on the core.
pub(super) struct Boundary {
    harmonics: usize,
    /// Place of each node among those of the boundary.
    locations: Vec<Option<usize>>,
    nodes: usize,
    loads: Vec<[f64; 3]>,
    displacements: Vec<[f64; 3]>,
}

impl Boundary {
    pub(super) fn new(mesh: &Meridian, edges: &[Edge], sources: &[Source], harmonics: usize) -> Self {
        let core = (0..mesh.nodes.len()).step_by(mesh.line());
        let mut locations = vec![None; mesh.nodes.len()];
        let mut nodes = 0;
        for n in edges.iter().flat_map(|e| e.nodes).chain(core.clone()) {
            locations[n].get_or_insert_with(|| {
                nodes += 1;
                nodes - 1
            });
        }
        let size = sources.len() * (harmonics + 1) * nodes;
        let mut boundary = Self {
            harmonics,
            locations,
            nodes,
            loads: vec![[0.0; 3]; size],
            displacements: vec![[0.0; 3]; size],
        };
        let turns = Turns::new(harmonics);
        let rule = gauss_legendre(4);
        for edge in edges {
            for &(x, w) in &rule {
                let shapes = quadratic(2.0 * x - 1.0);
                let (mut place, mut tangent) = ([0.0; 2], [0.0; 2]);
                for (n, (value, slope)) in edge.nodes.iter().zip(shapes) {
                    for axis in 0..2 {
                        place[axis] += value * mesh.nodes[*n][axis];
                        tangent[axis] += slope * mesh.nodes[*n][axis];
                    }
                }
                let length = tangent[0].hypot(tangent[1]);
                // To the left of the way down is out; of the way out along the foot, and on the core, it is in.
                let normal = [-tangent[1] / length * edge.outward, tangent[0] / length * edge.outward];
                let weight = 2.0 * w * length * place[0];
                for (s, source) in sources.iter().enumerate() {
                    let modes = turns.modes(|cosine, sine| {
                        let at = Point3::new(place[0] * cosine, place[0] * sine, place[1]);
                        source.traction(&at, &Vector3::new(normal[0] * cosine, normal[0] * sine, normal[1]))
                    });
                    for (m, mode) in modes.iter().enumerate() {
                        for (n, (value, _)) in edge.nodes.iter().zip(shapes) {
                            let Some(at) = boundary.index(s, m, *n) else { continue };
                            for (load, t) in boundary.loads[at].iter_mut().zip(mode) {
                                *load -= value * weight * t;
                            }
                        }
                    }
                }
            }
        }
        for n in core {
            let place = mesh.nodes[n];
            for (s, source) in sources.iter().enumerate() {
                let modes = turns.modes(|cosine, sine| {
                    source.displacement(&Point3::new(place[0] * cosine, place[0] * sine, place[1]))
                });
                for (m, mode) in modes.iter().enumerate() {
                    let Some(at) = boundary.index(s, m, n) else { continue };
                    boundary.displacements[at] = mode.map(|u| -u);
                }
            }
        }
        boundary
    }

    fn index(&self, source: usize, harmonic: usize, node: usize) -> Option<usize> {
        self.locations[node].map(|place| (source * (self.harmonics + 1) + harmonic) * self.nodes + place)
    }

    pub(super) fn load(&self, source: usize, harmonic: usize, node: usize) -> Vector3<f64> {
        self.index(source, harmonic, node).map_or_else(Vector3::zeros, |i| self.loads[i].into())
    }

    pub(super) fn displacement(&self, source: usize, harmonic: usize, node: usize) -> Vector3<f64> {
        self.index(source, harmonic, node).map_or_else(Vector3::zeros, |i| self.displacements[i].into())
    }
}

/// Angles over half a turn, and their harmonics: enough to resolve twice the highest one.
struct Turns {
    angles: Vec<(f64, f64)>,
    /// cos mφ and sin mφ with the series' weights, by harmonic and angle.
    waves: Vec<Vec<(f64, f64)>>,
}

impl Turns {
    fn new(harmonics: usize) -> Self {
        let count = 2 * harmonics.max(8);
        let angle = |j: usize| PI * (j as f64 + 0.5) / count as f64;
        let weight = |m: usize| if m == 0 { 1.0 } else { 2.0 } / count as f64;
        Self {
            angles: (0..count).map(|j| (angle(j).cos(), angle(j).sin())).collect(),
            waves: (0..=harmonics)
                .map(|m| {
                    (0..count)
                        .map(|j| (m as f64 * angle(j)).sin_cos())
                        .map(|(s, c)| (weight(m) * c, weight(m) * s))
                        .collect()
                })
                .collect(),
        }
    }

    /// Amplitudes of a field that is symmetric to the plane of angle 0, given by cosine and sine of the angle: radial and
    /// axial ones of cosines, those around the axis of sines.
    fn modes(&self, field: impl Fn(f64, f64) -> Vector3<f64>) -> Vec<[f64; 3]> {
        let samples: Vec<[f64; 3]> = self
            .angles
            .iter()
            .map(|&(c, s)| {
                let f = field(c, s);
                [f.x * c + f.y * s, f.y * c - f.x * s, f.z]
            })
            .collect();
        self.waves
            .iter()
            .map(|wave| {
                let mut sum = [0.0; 3];
                for (f, (c, s)) in samples.iter().zip(wave) {
                    sum[0] += c * f[0];
                    sum[1] += s * f[1];
                    sum[2] += c * f[2];
                }
                sum
            })
            .collect()
    }
}
