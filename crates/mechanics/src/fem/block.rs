//! A layer that ends somewhere.

use nalgebra::{Matrix3, Point3, Vector3};

use super::{HexMesh, Probe, Solid};
use crate::quadrature::gauss_legendre;
use crate::{Base, MechanicsError};

/// Radius of the ball over which a sensor's stress is averaged, in widths of its cell.
const BALL: f64 = 2.5;
/// Points of integration along each edge of a cell, for its share of a ball.
const PARTS: usize = 3;

/// What becomes of a block's sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sides {
    /// Nothing touches them.
    Free,
    /// They do not move: the block stands for a layer that goes on.
    Held,
}

/// An elastic block on a rigid base, its top free.
#[derive(Debug)]
pub struct Block {
    axes: [Vec<f64>; 3],
    /// Whether nothing keeps it from sliding on its base.
    slides: bool,
    solid: Solid,
    /// Sides along x and y of what a sensor may average over, about the origin.
    within: [f64; 2],
}

impl Block {
    /// A block with cells between the planes at `axes` \[m\], each strictly ascending; the last plane along z is the
    /// surface, the first the base.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a number cannot be, [`MechanicsError::Mesh`] where planes do not ascend.
    pub fn new(
        axes: [Vec<f64>; 3],
        poisson_ratio: f64,
        base: Base,
        sides: Sides,
    ) -> Result<Self, MechanicsError> {
        if axes.iter().any(|a| a.len() < 2) {
            return Err(MechanicsError::Mesh { cell: 0 });
        }
        let mesh = HexMesh::block([&axes[0], &axes[1], &axes[2]]);
        let end = axes.each_ref().map(|a| (a[0], a[a.len() - 1]));
        let slides = base == Base::Slip && sides == Sides::Free;
        // Influences do not depend on Young's modulus.
        let solid = Solid::new(mesh, 1.0, poisson_ratio, |node, p| {
            let below = p.z == end[2].0;
            let beside = p.x == end[0].0 || p.x == end[0].1 || p.y == end[1].0 || p.y == end[1].1;
            match base {
                _ if sides == Sides::Held && beside => [true; 3],
                Base::Bonded => [below; 3],
                // Sources of dilatation push nothing away as a whole: two corners keep it in its place and are not loaded.
                Base::Slip => {
                    [slides && node == 0, slides && (node == 0 || node + 1 == axes[0].len()), below]
                }
            }
        })?;
        Ok(Self { axes, slides, solid, within: [f64::INFINITY; 2] })
    }

    /// The block, its sensors averaging over nothing that lies outside of a rectangle of `size` \[m\] about the origin:
    /// as they would in a smaller block.
    #[must_use]
    pub fn averaging_within(mut self, size: [f64; 2]) -> Self {
        self.within = size;
        self
    }

    /// Mean compressive stress \[Pa\] that each of `probes` reads per \[N\] of a force in x, y and z at each node of the
    /// top: one list a probe, nodes along x first.
    ///
    /// Mean stress is a harmonic function, so that its average over a ball is its value in the centre. Balls of four cells'
    /// width, or as wide as the block allows, are averaged over: a single cell of a nearly incompressible material would
    /// also show the alternating pressures that trilinear displacements cannot resist.
    ///
    /// A force along the top of a block that slides is held by friction, spread evenly over its base.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a point does not lie in the block.
    pub fn influence(&self, probes: &[Probe]) -> Result<Vec<Vec<Vector3<f64>>>, MechanicsError> {
        let loads = probes
            .iter()
            .map(|probe| {
                let mut cells = Vec::new();
                for (point, weight) in probe {
                    cells.extend(self.ball(point)?.into_iter().map(|(cell, share)| (cell, weight * share)));
                }
                Ok(self.solid.pressure_load(&cells))
            })
            .collect::<Result<Vec<_>, MechanicsError>>()?;
        let counts = self.axes.each_ref().map(Vec::len);
        let top = counts[0] * counts[1] * (counts[2] - 1);
        let fields = self.solid.displacements(&loads).into_iter().map(|u| {
            let motion = if self.slides { self.motion(&u) } else { Vector3::zeros() };
            let still = |(p, u): (&Point3<f64>, &Vector3<f64>)| {
                u - Vector3::new(motion.x - motion.z * p.y, motion.y + motion.z * p.x, 0.0)
            };
            self.solid.mesh().nodes[top..].iter().zip(&u[top..]).map(still).collect()
        });
        Ok(fields.collect())
    }

    /// Mean displacement of the base along x and y, and its mean turn about z.
    fn motion(&self, displacements: &[Vector3<f64>]) -> Vector3<f64> {
        let width = |planes: &[f64], i: usize| {
            let next = planes[(i + 1).min(planes.len() - 1)];
            (next - planes[i.saturating_sub(1)]) / 2.0
        };
        let [nx, ny, _] = self.axes.each_ref().map(Vec::len);
        let mut equations = Matrix3::zeros();
        let mut sums = Vector3::zeros();
        for j in 0..ny {
            for i in 0..nx {
                let (x, y) = (self.axes[0][i], self.axes[1][j]);
                let u = displacements[j * nx + i];
                let area = width(&self.axes[0], i) * width(&self.axes[1], j);
                for (row, moved) in [(Vector3::new(1.0, 0.0, -y), u.x), (Vector3::new(0.0, 1.0, x), u.y)] {
                    equations += row * row.transpose() * area;
                    sums += row * (moved * area);
                }
            }
        }
        equations.try_inverse().map_or_else(Vector3::zeros, |inverse| inverse * sums)
    }

    /// Cells around a point, with weights that sum to 1 and whose centre is the point.
    fn ball(&self, centre: &Point3<f64>) -> Result<Vec<(usize, f64)>, MechanicsError> {
        let mut radius = f64::INFINITY;
        for (axis, (planes, &at)) in self.axes.iter().zip(centre.iter()).enumerate() {
            let half = self.within.get(axis).map_or(f64::INFINITY, |size| size / 2.0);
            let (first, last) = (planes[0].max(-half), planes[planes.len() - 1].min(half));
            // Also refuses what is not a number.
            if !(at > first && at < last) {
                return Err(MechanicsError::Value {
                    quantity: "coordinate of a sensor [m]",
                    value: at,
                    expected: "inside of the block",
                });
            }
            let above = planes.partition_point(|p| *p <= at).min(planes.len() - 1);
            let width = planes[above] - planes[above - 1];
            radius = radius.min(BALL * width).min((at - first).max(width)).min((last - at).max(width));
        }
        let counts = self.axes.each_ref().map(|a| a.len() - 1);
        let range = |k: usize| {
            let planes = &self.axes[k];
            let low = planes.partition_point(|p| *p <= centre[k] - radius).saturating_sub(1);
            low..planes.partition_point(|p| *p < centre[k] + radius).min(counts[k])
        };
        let parts = gauss_legendre(PARTS);
        // Where the points of integration of a cell lie from the ball's centre along an axis, and their weights.
        let along = |k: usize, cell: usize| {
            let (low, high) = (self.axes[k][cell], self.axes[k][cell + 1]);
            parts
                .iter()
                .map(|(x, w)| (low + x * (high - low) - centre[k], w * (high - low)))
                .collect::<Vec<_>>()
        };
        let mut cells: Vec<(usize, f64, Vector3<f64>)> = Vec::new();
        for k in range(2) {
            for j in range(1) {
                for i in range(0) {
                    let [xs, ys, zs] = [along(0, i), along(1, j), along(2, k)];
                    let mut weight = 0.0;
                    for (x, wx) in &xs {
                        for (y, wy) in &ys {
                            for (z, wz) in &zs {
                                let near = (1.0 - (x * x + y * y + z * z) / (radius * radius)).max(0.0);
                                weight += wx * wy * wz * near * near;
                            }
                        }
                    }
                    let middle = |k: usize, cell: usize| {
                        (self.axes[k][cell] + self.axes[k][cell + 1]) / 2.0 - centre[k]
                    };
                    let offset = Vector3::new(middle(0, i), middle(1, j), middle(2, k));
                    cells.push(((k * counts[1] + j) * counts[0] + i, weight, offset));
                }
            }
        }
        // A cell's pressure counts for its middle: tilt the weights until that of all cells is the ball's centre.
        let first: Vector3<f64> = cells.iter().map(|(_, w, o)| o * *w).sum();
        let second: Matrix3<f64> = cells.iter().map(|(_, w, o)| o * o.transpose() * *w).sum();
        let tilt = second.try_inverse().map_or_else(Vector3::zeros, |inverse| -(inverse * first));
        for (_, weight, offset) in &mut cells {
            *weight *= 1.0 + tilt.dot(offset);
        }
        let sum: f64 = cells.iter().map(|c| c.1).sum();
        Ok(cells.into_iter().map(|(cell, weight, _)| (cell, weight / sum)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Load, Medium};

    const NU: f64 = 0.49;
    const DEPTH: f64 = 0.010;

    /// Cells of `width` out to 15 mm, wider ones out to 40 mm.
    fn wide(width: f64) -> Vec<f64> {
        let cells = (0.015 / width).round() as i32;
        let mut half = Vec::new();
        let (mut at, mut step) = (0.015, width);
        while at < 0.040 {
            step *= 1.35;
            at += step;
            half.push(at);
        }
        let mut axis: Vec<f64> = half.iter().rev().map(|x| -x).collect();
        axis.extend((-cells..=cells).map(|i| f64::from(i) * width));
        axis.extend(half);
        axis
    }

    /// A few percent under the force, where cells are too wide for a point's field, and less beside it.
    #[test]
    fn wide_block_is_the_layer() {
        for base in [Base::Bonded, Base::Slip] {
            let layers = 8;
            let z: Vec<f64> =
                (0..=layers).map(|k| DEPTH * (f64::from(k) / f64::from(layers) - 1.0)).collect();
            let axis = wide(0.00125);
            let block = Block::new([axis.clone(), axis.clone(), z], NU, base, Sides::Held).unwrap();
            let sensor = Point3::new(0.0, 0.0, -0.005);
            let field = block.influence(&[vec![(sensor, 1.0)]]).unwrap().remove(0);
            let layer = Medium::layer(1.0, NU, DEPTH, base).unwrap();
            let point = Load::Point { force: 1.0 };
            let peak = layer.pressure(&point, 0.005, 0.0).unwrap();
            let n = axis.len();
            for (i, x) in axis.iter().enumerate().filter(|(_, x)| x.abs() < 0.0151) {
                let pushed = -field[(n / 2) * n + i].z - layer.pressure(&point, 0.005, x.abs()).unwrap();
                // A force along x presses the medium ahead of it.
                let along = field[(n / 2) * n + i].x
                    + x.signum() * layer.pressure_of_shear(&point, 0.005, x.abs()).unwrap();
                let tolerance = if x.abs() < 0.003 { 0.08 } else { 0.035 };
                assert!(pushed.abs() < tolerance * peak, "{base:?} {x}: {pushed} of {peak}");
                assert!(along.abs() < tolerance * peak, "{base:?} {x}: {along} of {peak}");
            }
        }
    }

    #[test]
    fn a_ball_is_centred_on_its_sensor() {
        let axis: Vec<f64> = (0..=10).map(|i| f64::from(i) * 0.001).collect();
        let block = Block::new([axis.clone(), axis.clone(), axis], 0.3, Base::Bonded, Sides::Free).unwrap();
        for at in [[0.005, 0.005, 0.005], [0.0043, 0.0027, 0.0061], [0.0002, 0.0098, 0.0049]] {
            let ball = block.ball(&Point3::from(at)).unwrap();
            let mut centre = Vector3::zeros();
            for (cell, weight) in &ball {
                let place = [cell % 10, cell / 10 % 10, cell / 100].map(|i| (i as f64 + 0.5) * 0.001);
                centre += Vector3::from(place) * *weight;
            }
            approx::assert_relative_eq!(ball.iter().map(|c| c.1).sum::<f64>(), 1.0, max_relative = 1e-12);
            assert!((centre - Vector3::from(at)).norm() < 1e-9, "{at:?}: {centre}");
        }
        assert!(block.ball(&Point3::new(0.005, 0.005, 0.011)).is_err());
    }

    /// Nothing holds a block that slips but friction, spread over its base: no force along its top acts on its middle.
    #[test]
    fn a_block_that_slides_has_an_answer() {
        let axis: Vec<f64> = (-6..=6).map(|i| f64::from(i) * 0.002).collect();
        let z: Vec<f64> = (0..=4).map(|i| f64::from(i) * 0.002 - 0.008).collect();
        let block = Block::new([axis.clone(), axis, z], NU, Base::Slip, Sides::Free).unwrap();
        let field = block.influence(&[vec![(Point3::new(0.0, 0.0, -0.004), 1.0)]]).unwrap().remove(0);
        let peak = field.iter().map(Vector3::norm).fold(0.0, f64::max);
        let (middle, left, right) = (field[6 * 13 + 6], field[6 * 13 + 3], field[6 * 13 + 9]);
        assert!(middle.x.hypot(middle.y) < 1e-6 * peak, "{middle}");
        assert!((left.x + right.x).abs() < 1e-6 * peak && (left.z - right.z).abs() < 1e-6 * peak);
    }
}
