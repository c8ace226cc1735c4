//! Triangles between the middle of a sheet and its rim.

use std::f64::consts::TAU;

use crate::{ElectricsError, Rim};

/// How fine a mesh is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Density {
    /// Segments across every electrode.
    pub across: usize,
    /// Segments between two electrodes.
    pub between: usize,
    /// Rings of nodes from the middle to the rim; they become narrower towards it.
    pub rings: usize,
}

impl Default for Density {
    fn default() -> Self {
        Self { across: 6, between: 10, rings: 28 }
    }
}

/// Node at which rings are half as wide as at the middle: the exponent of 1 − (1 − s)^p for ring s of 1.
const GRADING: f64 = 1.6;

/// Triangles of nodes, the first of which lies in the middle, and the rest on rings.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// \[m\]
    pub nodes: Vec<[f64; 2]>,
    /// Counter-clockwise.
    pub triangles: Vec<[usize; 3]>,
    /// Pairs of nodes on the rim under every electrode.
    pub electrodes: Vec<Vec<[usize; 2]>>,
}

impl Mesh {
    /// A mesh of the inside of `rim` whose nodes lie on the edges of electrodes.
    ///
    /// # Errors
    ///
    /// [`ElectricsError::Value`] for no segments or rings.
    pub fn new(rim: &Rim, density: Density) -> Result<Self, ElectricsError> {
        for (what, count, must) in [
            ("the number of segments across an electrode", density.across, "at least 1"),
            ("the number of segments between electrodes", density.between, "at least 1"),
            ("the number of rings", density.rings, "at least 1"),
        ] {
            if count == 0 {
                return Err(ElectricsError::Value { what, value: 0.0, must });
            }
        }
        let angles = sectors(rim, density);
        let count = angles.len();
        let mut nodes = vec![[0.0, 0.0]];
        for ring in 1..=density.rings {
            let share = 1.0 - (1.0 - ring as f64 / density.rings as f64).powf(GRADING);
            nodes.extend(angles.iter().map(|angle| {
                let radius = share * rim.radius(*angle);
                [radius * angle.cos(), radius * angle.sin()]
            }));
        }
        let node = |ring: usize, sector: usize| 1 + (ring - 1) * count + sector % count;
        let mut triangles: Vec<[usize; 3]> = (0..count).map(|s| [0, node(1, s), node(1, s + 1)]).collect();
        for ring in 1..density.rings {
            for s in 0..count {
                let corners = [node(ring, s), node(ring + 1, s), node(ring + 1, s + 1), node(ring, s + 1)];
                // Diagonals alternate, so that the mesh prefers no direction of turning.
                if (ring + s) % 2 == 0 {
                    triangles.push([corners[0], corners[1], corners[2]]);
                    triangles.push([corners[0], corners[2], corners[3]]);
                } else {
                    triangles.push([corners[0], corners[1], corners[3]]);
                    triangles.push([corners[1], corners[2], corners[3]]);
                }
            }
        }
        let each = density.across + density.between;
        let electrodes = (0..rim.electrodes())
            .map(|e| {
                let segment =
                    |s: usize| [node(density.rings, e * each + s), node(density.rings, e * each + s + 1)];
                (0..density.across).map(segment).collect()
            })
            .collect();
        Ok(Self { nodes, triangles, electrodes })
    }

    /// Area of a triangle, and the gradients of the functions that are 1 at one of its corners.
    #[must_use]
    pub fn gradients(&self, triangle: [usize; 3]) -> (f64, [[f64; 2]; 3]) {
        let [a, b, c] = triangle.map(|i| self.nodes[i]);
        let twice = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        let across = |p: [f64; 2], q: [f64; 2]| [(p[1] - q[1]) / twice, (q[0] - p[0]) / twice];
        (0.5 * twice, [across(b, c), across(c, a), across(a, b)])
    }

    /// \[m\] between two nodes.
    #[must_use]
    pub fn length(&self, [a, b]: [usize; 2]) -> f64 {
        let (a, b) = (self.nodes[a], self.nodes[b]);
        (a[0] - b[0]).hypot(a[1] - b[1])
    }
}

/// Angles of the nodes of a ring: across the first electrode, to the second, across it, and so on.
fn sectors(rim: &Rim, density: Density) -> Vec<f64> {
    let mut angles = Vec::new();
    for electrode in 0..rim.electrodes() {
        let [from, to] = rim.span(electrode);
        let next = rim.span((electrode + 1) % rim.electrodes())[0];
        let gap = (next - to).rem_euclid(TAU);
        let steps = |start: f64, width: f64, count: usize| {
            (0..count).map(move |i| start + width * i as f64 / count as f64)
        };
        angles.extend(steps(from, to - from, density.across));
        angles.extend(steps(to, gap, density.between));
    }
    angles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_fill_the_disc_and_electrodes_their_share_of_the_rim() {
        let rim = Rim::circle(2.0, 16, 0.25).unwrap();
        let mesh = Mesh::new(&rim, Density::default()).unwrap();
        let area: f64 = mesh.triangles.iter().map(|t| mesh.gradients(*t).0).sum();
        assert!(mesh.triangles.iter().all(|t| mesh.gradients(*t).0 > 0.0));
        // A polygon of unequal sides, at most 0.0245 rad: it lacks a share of at most that squared over 6.
        let circle = std::f64::consts::PI * 4.0;
        assert!(area < circle && (circle - area) / circle < 1e-3, "{area}");
        for electrode in &mesh.electrodes {
            let length: f64 = electrode.iter().map(|segment| mesh.length(*segment)).sum();
            assert!((length - 0.25 * TAU * 2.0 / 16.0).abs() < 1e-4, "{length}");
        }
        // Gradients of the three functions cancel, and reproduce a linear field.
        let (_, gradients) = mesh.gradients(mesh.triangles[777]);
        assert!((0..2).all(|i| gradients.iter().map(|g| g[i]).sum::<f64>().abs() < 1e-9));
        let field = |p: [f64; 2]| 3.0 * p[0] - 2.0 * p[1];
        let slope: Vec<f64> = (0..2)
            .map(|i| {
                gradients.iter().zip(mesh.triangles[777]).map(|(g, n)| g[i] * field(mesh.nodes[n])).sum()
            })
            .collect();
        assert!((slope[0] - 3.0).abs() < 1e-9 && (slope[1] + 2.0).abs() < 1e-9);
    }
}
