//! The elastomer in hexahedra, and where the skeleton holds it.
//!
//! A half-sphere on a cylinder ([`HexMesh::dome`]) is bent to the thumb: its polar angle becomes the way along the meridian, its rings the
//! lines that the edges of the skeleton's rings lie on. The skeleton is a million times as stiff as the elastomer and is taken as rigid: nodes
//! inside of a beam do not move. Below the last ring nothing moves.
//!
//! Assumptions: beams have a square section; a meridian beam is as wide as the nodes within it, so that its width is off by up to one
//! cell; elastomer and skeleton do not part.

use dermis_mechanics::MechanicsError;
use dermis_mechanics::fem::{HexMesh, Solid};
use dermis_skin::closest_on_triangle;
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

use crate::shape::Thumb;

/// Beams that hold the elastomer.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Skeleton {
    /// \[m\] across a beam.
    pub beam: f64,
    /// \[m\] of elastomer inside of the beams.
    pub inside: f64,
    /// \[m\] along the outside from the tip to each ring; the last is where the elastomer ends.
    pub rings: Vec<f64>,
    /// Beams from the base up.
    pub meridians: Vec<Meridians>,
}

/// Beams along meridians, equally far apart.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Meridians {
    /// How many.
    pub count: u32,
    /// \[m\] from the tip to where they end.
    pub from: f64,
    /// \[rad\] to the first.
    pub azimuth: f64,
}

/// A nail-shaped zone of thinner elastomer without beams, carved out of the inside; a beam runs around it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fovea {
    /// \[m\] along the outside from the tip to its middle.
    pub from_tip: f64,
    /// \[rad\] to its middle.
    pub azimuth: f64,
    /// \[m\] along the meridian, and around.
    pub size: [f64; 2],
    /// \[m\] of elastomer.
    pub thickness: f64,
}

/// The elastomer on its skeleton.
#[derive(Debug, Clone, PartialEq)]
pub struct Elastomer {
    /// Its outside.
    pub thumb: Thumb,
    /// \[m\].
    pub thickness: f64,
    /// \[Pa\].
    pub young_modulus: f64,
    /// Poisson's ratio.
    pub poisson_ratio: f64,
    /// \[kg/m³\].
    pub density: f64,
    /// What holds it.
    pub skeleton: Skeleton,
    /// The thin zone.
    pub fovea: Option<Fovea>,
    /// Quads around a quarter of the mesh: an even number, as the tip is divided like half of a cube.
    pub around: usize,
    /// Cells through the thickness.
    pub layers: usize,
    /// \[m\] of a cell along the meridian.
    pub cell: f64,
}

/// Ways past the end of the cap that the dome's half-sphere is stretched to, so that its cells are as large as the others.
const CROWN: f64 = 1.6;

/// 0 below 0, 1 above 1, smooth in between.
pub fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// An angle \[rad\] as −π to π.
pub fn wrapped(angle: f64) -> f64 {
    (angle + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
}

impl Fovea {
    /// How far (s, φ) is from the middle: 1 at the edge.
    fn out(&self, thumb: &Thumb, s: f64, azimuth: f64) -> f64 {
        let r = thumb.meridian(s, 0.0)[0];
        let [along, across] = [s - self.from_tip, wrapped(azimuth - self.azimuth) * r];
        (2.0 * along / self.size[0]).hypot(2.0 * across / self.size[1])
    }
}

impl Elastomer {
    /// \[m\] of elastomer at (s, φ): the fovea's edge is as wide as a beam.
    #[must_use]
    pub fn thickness_at(&self, s: f64, azimuth: f64) -> f64 {
        let Some(fovea) = &self.fovea else { return self.thickness };
        let edge = 2.0 * self.skeleton.beam / fovea.size[0].min(fovea.size[1]);
        let thin = 1.0 - smooth_step((fovea.out(&self.thumb, s, azimuth) - 1.0) / edge);
        self.thickness + (fovea.thickness - self.thickness) * thin
    }

    /// \[m\] where it is thinnest, and where it is thickest.
    #[must_use]
    pub fn thicknesses(&self) -> [f64; 2] {
        let fovea = self.fovea.as_ref().map_or(self.thickness, |fovea| fovea.thickness);
        [self.thickness.min(fovea), self.thickness.max(fovea)]
    }

    /// \[m\] from the tip to where the elastomer ends.
    #[must_use]
    pub fn end(&self) -> f64 {
        self.skeleton.rings.iter().copied().fold(0.0, f64::max)
    }

    /// Whether a beam passes (s, φ), whatever the depth.
    #[must_use]
    pub fn beam_at(&self, s: f64, azimuth: f64) -> bool {
        let half = self.skeleton.beam / 2.0 + 1e-9;
        if let Some(fovea) = &self.fovea {
            let out = fovea.out(&self.thumb, s, azimuth);
            let edge = 2.0 * self.skeleton.beam / fovea.size[0].min(fovea.size[1]);
            if out <= 1.0 + edge {
                return out >= 1.0;
            }
        }
        let r = self.thumb.meridian(s, 0.0)[0];
        let along = |m: &Meridians| {
            let step = std::f64::consts::TAU / f64::from(m.count);
            let turned = (azimuth - m.azimuth + step / 2.0).rem_euclid(step) - step / 2.0;
            s >= m.from && (turned * r).abs() <= half
        };
        self.skeleton.rings.iter().any(|ring| (s - ring).abs() <= half)
            || self.skeleton.meridians.iter().any(along)
    }

    /// \[m\] of each layer of nodes above the inside, and the layers that beams reach through. Their faces lie on layers, so that
    /// a skeleton that lies a little deeper is another one.
    fn levels(&self) -> (Vec<f64>, std::ops::RangeInclusive<usize>) {
        let Skeleton { beam, inside, .. } = self.skeleton;
        let parts = [inside, beam, (self.thickness - inside - beam).max(0.0)];
        let share = |part: f64| (part / self.thickness * self.layers as f64).round() as usize;
        let most = self.layers.saturating_sub(1);
        let below = if inside > 0.0 { share(inside).clamp(1, most.max(1)) } else { 0 };
        let within = share(beam).clamp(1, (self.layers - below).max(1));
        let above = self.layers.saturating_sub(below + within);
        let mut levels = vec![0.0];
        for (part, cells) in parts.into_iter().zip([below, within, above]) {
            let from = levels[levels.len() - 1];
            levels.extend((1..=cells).map(|i| from + part * i as f64 / cells as f64));
        }
        (levels, below..=below + within)
    }

    /// Lines along which rings of nodes lie, from the crown down to the end.
    fn lines(&self) -> Vec<f64> {
        let (half, end) = (self.skeleton.beam / 2.0, self.end());
        let crown = (CROWN * self.thumb.cap()).min(0.5 * end);
        let mut edges: Vec<f64> =
            self.skeleton.rings.iter().flat_map(|r| [r - half, r + half]).filter(|s| *s < end).collect();
        edges.push(end);
        edges.sort_unstable_by(f64::total_cmp);
        let mut lines = vec![crown];
        for edge in edges {
            let last = lines[lines.len() - 1];
            if edge <= last + 0.3 * self.cell {
                continue;
            }
            let parts = ((edge - last) / self.cell).round().max(1.0);
            lines.extend((1..=parts as usize).map(|i| last + (edge - last) * i as f64 / parts));
        }
        lines
    }

    /// The mesh, and what is known of its nodes.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a length is not positive.
    pub fn mesh(&self) -> Result<Meshed, MechanicsError> {
        let lines = self.lines();
        let rows = lines.len() - 1;
        // Of a radius of 1, so that the dome has as many rings of cells.
        let cylinder = rows as f64 * std::f64::consts::TAU / (4 * self.around) as f64;
        let mut hexes = HexMesh::dome(1.0, cylinder, 0.5, self.around, self.layers)?;
        let count = hexes.nodes.len() / (self.layers + 1);
        let locations: Vec<[f64; 2]> = hexes.nodes[..count]
            .iter()
            .map(|p| {
                let (above, r) = (p.z - cylinder, p.x.hypot(p.y));
                let s = if above > 1e-9 {
                    r.atan2(above) / std::f64::consts::FRAC_PI_2 * lines[0]
                } else {
                    lines[((-above / cylinder) * rows as f64).round() as usize]
                };
                [s, p.y.atan2(p.x)]
            })
            .collect();
        let (levels, within) = self.levels();
        let reaches = levels[levels.len() - 1];
        let mut held = Vec::with_capacity(hexes.nodes.len());
        for (i, node) in hexes.nodes.iter_mut().enumerate() {
            let [s, azimuth] = locations[i % count];
            let (layer, share) = (i / count, levels[i / count] / reaches);
            let thickness = self.thickness_at(s, azimuth);
            *node = self.thumb.point(s, azimuth, (1.0 - share) * thickness).0;
            // Also where the elastomer is thinner, a beam has as many layers.
            held.push(s >= self.end() - 1e-9 || (within.contains(&layer) && self.beam_at(s, azimuth)));
        }
        Ok(Meshed::new(hexes, held, count))
    }
}

/// A mesh whose layers have nodes one behind the other.
#[derive(Debug, Clone)]
pub struct Meshed {
    /// Nodes and cells.
    pub hexes: HexMesh,
    /// Whether each node is held.
    pub held: Vec<bool>,
    /// Nodes of a layer, the inside first.
    pub count: usize,
    /// Triangles of the outside, by its nodes, and \[m\] of their lowest and highest corners, sorted by the lowest.
    faces: Vec<([u32; 3], [f64; 2])>,
}

impl Meshed {
    fn new(hexes: HexMesh, held: Vec<bool>, count: usize) -> Self {
        let outer = hexes.nodes.len() - count;
        let top = |cell: &[u32; 8]| cell[4..].iter().all(|n| *n as usize >= outer);
        let mut faces = Vec::new();
        for cell in hexes.cells.iter().filter(|cell| top(cell)) {
            let [a, b, c, d] = [4, 5, 6, 7].map(|k| cell[k] - outer as u32);
            for t in [[a, b, c], [a, c, d]] {
                let z = t.map(|n| hexes.nodes[outer + n as usize].z);
                faces.push((t, [z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2])]));
            }
        }
        faces.sort_unstable_by(|a, b| a.1[0].total_cmp(&b.1[0]));
        Self { hexes, held, count, faces }
    }

    /// Nodes of a layer around a point of the outside, with weights that sum to 1.
    #[must_use]
    pub fn weights(&self, p: &Point3<f64>) -> [(usize, f64); 3] {
        let outer = self.hexes.nodes.len() - self.count;
        let mut best = (f64::INFINITY, [(0, 0.0); 3]);
        for (t, [low, high]) in &self.faces {
            let off = (low - p.z).max(p.z - high).max(0.0);
            if off * off > best.0 {
                if *low > p.z {
                    break;
                }
                continue;
            }
            let corners = t.map(|n| self.hexes.nodes[outer + n as usize]);
            let w = closest_on_triangle(&corners, p);
            let at: Vector3<f64> = corners.iter().zip(w).map(|(c, w)| c.coords * w).sum();
            let away = (p.coords - at).norm_squared();
            if away < best.0 {
                best = (away, std::array::from_fn(|k| (t[k] as usize, w[k])));
            }
        }
        best.1
    }

    /// The elastic body.
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where a cell is turned inside out or the material cannot be.
    pub fn solid(&self, young_modulus: f64, poisson_ratio: f64) -> Result<Solid, MechanicsError> {
        Solid::new(self.hexes.clone(), young_modulus, poisson_ratio, |i, _| [self.held[i]; 3])
    }

    /// Weight \[N\] of every node in a field of 1 m/s², for a density \[kg/m³\].
    #[must_use]
    pub fn masses(&self, density: f64) -> Vec<f64> {
        let mut masses = vec![0.0; self.hexes.nodes.len()];
        for cell in &self.hexes.cells {
            let p = cell.map(|n| self.hexes.nodes[n as usize]);
            let middle = p.iter().map(|p| p.coords).sum::<Vector3<f64>>() / 8.0;
            // Twelve tetrahedra from the middle to the triangles of the sides.
            let sides = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
            let volume: f64 = sides
                .iter()
                .flat_map(|s| [[s[0], s[1], s[2]], [s[0], s[2], s[3]]])
                .map(|t| {
                    let [a, b, c] = t.map(|k| p[k].coords - middle);
                    a.dot(&b.cross(&c)) / 6.0
                })
                .sum();
            cell.iter().for_each(|n| masses[*n as usize] += density * volume / 8.0);
        }
        masses
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elastic::tests::coarse;

    #[test]
    fn the_mesh_has_the_elastomer_s_volume_and_is_held() {
        let elastomer = Elastomer { fovea: None, ..coarse().0 };
        let meshed = elastomer.mesh().unwrap();
        let volume: f64 = meshed.masses(1.0).iter().sum();
        // Between the outside and the inside: ∫ (1 − d κ) over the thickness, by the areas of outside and inside.
        let (thumb, end, t) = (elastomer.thumb, elastomer.end(), elastomer.thickness);
        let steps = 4000;
        let slice = |i: usize| {
            let s = (i as f64 + 0.5) / f64::from(steps) * end;
            let ds = end / f64::from(steps);
            let [outer, inner] = [0.0, t].map(|d| thumb.meridian(s, d)[0]);
            let length = |d: f64| {
                let [a, b] = [s - 0.5 * ds, s + 0.5 * ds].map(|s| thumb.meridian(s, d));
                (a[0] - b[0]).hypot(a[1] - b[1])
            };
            std::f64::consts::PI * (outer + inner) * t * f64::midpoint(length(0.0), length(t))
        };
        let exact: f64 = (0..4000).map(slice).sum();
        // Chords of 16 cells around are short by 1 − sin(2π/16)/(2π/16) = 2.6 % of the area.
        assert!((volume / exact - 1.0).abs() < 0.05, "{volume} {exact}");
        let held = meshed.held.iter().filter(|h| **h).count();
        assert!(held > meshed.count / 10 && held < meshed.hexes.nodes.len() / 2, "{held}");
    }

    #[test]
    fn points_are_found_between_nodes() {
        let meshed = coarse().0.mesh().unwrap();
        let thumb = coarse().0.thumb;
        let outer = meshed.hexes.nodes.len() - meshed.count;
        for k in 0..40 {
            let (s, phi) = (0.001 + 0.0014 * f64::from(k), f64::from(k));
            let p = thumb.point(s, phi, 0.0).0;
            let weights = meshed.weights(&p);
            let at: Vector3<f64> =
                weights.iter().map(|(n, w)| meshed.hexes.nodes[outer + n].coords * *w).sum();
            // The sagitta of the chords.
            assert!((at - p.coords).norm() < 0.0015, "{s} {phi}");
        }
    }
}
