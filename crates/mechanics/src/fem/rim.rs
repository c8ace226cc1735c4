//! What free sides change.

use nalgebra::Vector3;

use super::{Bicubic, Block, Probe, Sides};
use crate::error::positive;
use crate::{Base, MechanicsError};

/// Cells of the layer's height.
const LAYERS: usize = 8;
/// Most cells along a side.
const CELLS_MAX: f64 = 40.0;
/// Fewest cells along a side.
const CELLS_MIN: f64 = 4.0;
/// Thicknesses by which the other block goes on beyond each side.
const PADDING: f64 = 2.0;
/// How fast its cells widen there.
const GROWTH: f64 = 1.4;

/// What it changes in the influence of `probes` that a layer of `thickness` \[m\] ends with free sides around a rectangle of
/// `size` \[m\] in x and y, in place of going on; `slip` is the share in which it slips on its base (0 bonded, 1 slipping).
/// Over x and y \[m\] of a point of the surface: \[Pa\] per \[N\] of a force in x, y and z, three numbers a probe. The middle
/// of the surface is the origin, z is up.
///
/// It is the influence in a block of that size less that in a block of the same cells that goes on beyond. What the cells
/// cannot resolve, the pressure straight under a contact above all, is the same in both and leaves with the difference; what
/// stays is smooth. Cells are an eighth of the thickness wide, wider where a side is longer than five thicknesses.
///
/// # Errors
///
/// [`MechanicsError::Value`] where a number cannot be or a probe's point does not lie in the block.
pub fn free_sides(
    size: [f64; 2],
    thickness: f64,
    poisson_ratio: f64,
    slip: f64,
    probes: &[Probe],
) -> Result<Bicubic, MechanicsError> {
    positive("thickness [m]", thickness)?;
    for side in size {
        positive("side of the block [m]", side)?;
    }
    let counts = size.map(|s| (s / thickness * LAYERS as f64).round().clamp(CELLS_MIN, CELLS_MAX) as usize);
    let planes = |size: f64, count: usize| -> Vec<f64> {
        (0..=count).map(|i| size * (i as f64 / count as f64 - 0.5)).collect()
    };
    let inner = [planes(size[0], counts[0]), planes(size[1], counts[1])];
    let padded = inner.each_ref().map(|planes| pad(planes, PADDING * thickness));
    let height: Vec<f64> = (0..=LAYERS).map(|k| thickness * (k as f64 / LAYERS as f64 - 1.0)).collect();
    let before = (padded[0].len() - inner[0].len()) / 2;
    let beside = (padded[1].len() - inner[1].len()) / 2;
    let columns = padded[0].len();

    let (rows, points) = (counts[1] + 1, (counts[0] + 1) * (counts[1] + 1));
    let mut change = vec![vec![Vector3::zeros(); points]; probes.len()];
    for (base, share) in [(Base::Bonded, 1.0 - slip), (Base::Slip, slip)] {
        if share == 0.0 {
            continue;
        }
        let solve = |[x, y]: &[Vec<f64>; 2], sides| {
            Block::new([x.clone(), y.clone(), height.clone()], poisson_ratio, base, sides)?
                .averaging_within(size)
                .influence(probes)
        };
        let (ending, going_on) = (solve(&inner, Sides::Free)?, solve(&padded, Sides::Held)?);
        for ((change, ending), going_on) in change.iter_mut().zip(&ending).zip(&going_on) {
            for (place, c) in change.iter_mut().enumerate() {
                let (j, i) = (place / (counts[0] + 1), place % (counts[0] + 1));
                *c += (ending[place] - going_on[(j + beside) * columns + i + before]) * share;
            }
        }
    }
    // One more point at either end of a line, on the parabola through the last three.
    let line = |at: isize, count: usize| -> [(usize, f64); 3] {
        if at < 0 {
            [(0, 3.0), (1, -3.0), (2, 1.0)]
        } else if at as usize == count {
            [(count - 1, 3.0), (count - 2, -3.0), (count - 3, 1.0)]
        } else {
            [(at as usize, 1.0), (0, 0.0), (0, 0.0)]
        }
    };
    let steps = [0, 1].map(|k| size[k] / counts[k] as f64);
    Ok(Bicubic::new(size.map(|s| -s / 2.0), steps, [counts[0] + 1, rows], 3 * probes.len(), |[i, j], out| {
        for (out, change) in out.chunks_exact_mut(3).zip(&change) {
            for (j, b) in line(j, rows) {
                for (i, a) in line(i, counts[0] + 1) {
                    let c = change[j * (counts[0] + 1) + i] * (a * b);
                    out.iter_mut().zip(c.iter()).for_each(|(o, c)| *o += c);
                }
            }
        }
    }))
}

/// Planes that go on beyond both ends by at least `length`, further and further apart.
fn pad(planes: &[f64], length: f64) -> Vec<f64> {
    let last = planes[planes.len() - 1];
    let (mut step, mut beyond) = (last - planes[planes.len() - 2], vec![]);
    let mut at = last;
    while at < last + length {
        step *= GROWTH;
        at += step;
        beyond.push(at);
    }
    let mut all: Vec<f64> = beyond.iter().rev().map(|x| -x).collect();
    all.extend_from_slice(planes);
    all.extend(beyond);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn sides_change_what_is_near_them() {
        let probes: Vec<Probe> =
            [-0.0126, 0.0, 0.0126].iter().map(|&x| vec![(Point3::new(x, 0.0, -0.002), 1.0)]).collect();
        let sides = free_sides([0.028, 0.016], 0.004, 0.49, 0.0, &probes).unwrap();
        let at = |x: f64, y: f64| {
            let mut out = vec![0.0; 9];
            sides.add(x, y, 1.0, &mut out);
            out
        };
        // A point load on a layer half as thick as the usual one: four times its peak.
        let peak = 4.0 * 7100.0;
        // Two thicknesses from every side, little is left.
        assert!(at(0.0, 0.0)[5].abs() < 0.015 * peak, "{:?}", at(0.0, 0.0));
        // Where the elastomer ends, a force that would have been carried beyond presses on what is there.
        assert!(-at(0.014, 0.0)[8] > 0.2 * peak, "{:?}", at(0.014, 0.0));
        // Left is like right.
        let (left, right) = (at(-0.012, 0.003), at(0.012, 0.003));
        for (a, b, sign) in [(0, 6, -1.0), (1, 7, 1.0), (2, 8, 1.0)] {
            assert!((left[a] - sign * right[b]).abs() < 1e-6 * peak, "{left:?} {right:?}");
        }
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let probes = [vec![(Point3::new(0.02, 0.0, -0.002), 1.0)]];
        let refused =
            |size, thickness| free_sides(size, thickness, 0.49, 0.0, &probes).unwrap_err().to_string();
        insta::assert_snapshot!(refused([0.028, 0.0], 0.004), @"side of the block [m] is 0 and must be a positive number");
        insta::assert_snapshot!(refused([0.028, 0.028], 0.004), @"coordinate of a sensor [m] is 0.02 and must be inside of the block");
    }
}
