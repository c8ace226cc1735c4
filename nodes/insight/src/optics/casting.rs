//! Rays of the camera on a displaced inside.
//!
//! Problem: what a ray sees is not the place that it saw before a touch. The inside has moved towards the camera, so that the ray meets another part
//! of it, and what bulges hides what is behind it. Method: hidden surfaces are removed by depth (E. Catmull, 1974). The grid of the inside is cut
//! into triangles; each that moves is met with the rays through untouched nodes that pass near it (T. Möller and B. Trumbore, 1997), and each ray
//! keeps the nearest. Rays are found by their places in the picture, in square bins.
//!
//! Assumption: triangles are plane.
//!
//! Cost: a product of three vectors for each ray beside a triangle, of which there are some ten.

use nalgebra::{Point3, Vector3};

use super::grouped::grouped;
use super::lens::equisolid;

/// Rays to a bin in the mean.
const EACH: f64 = 4.0;
/// Share of a triangle by which its rays may lie beside it: between corners its sides are curved in the picture, and corners are met by rounding.
const BESIDE: f64 = 0.05;
/// The same, of its sides.
const ROUNDING: f64 = 1e-9;

/// Values of few of many places.
#[derive(Debug, Clone)]
pub(super) struct Sparse<T> {
    /// Of each place: one more than where its value is.
    at: Vec<u32>,
    /// Places that have one, in the order of `values`.
    pub places: Vec<u32>,
    pub values: Vec<T>,
}

impl<T> Default for Sparse<T> {
    fn default() -> Self {
        Self { at: Vec::new(), places: Vec::new(), values: Vec::new() }
    }
}

impl<T> Sparse<T> {
    /// Forgets all values; of so many places.
    pub fn clear(&mut self, places: usize) {
        if self.at.len() == places {
            self.places.drain(..).for_each(|place| self.at[place as usize] = 0);
        } else {
            self.at.clear();
            self.at.resize(places, 0);
            self.places.clear();
        }
        self.values.clear();
    }

    pub fn get(&self, place: usize) -> Option<&T> {
        match self.at[place] {
            0 => None,
            at => Some(&self.values[at as usize - 1]),
        }
    }

    pub fn has(&self, place: usize) -> bool {
        self.at[place] != 0
    }

    /// The value of a place; `make` makes it where there is none.
    pub fn or_insert_with(&mut self, place: usize, make: impl FnOnce() -> T) -> &mut T {
        if self.at[place] == 0 {
            self.places.push(place as u32);
            self.values.push(make());
            self.at[place] = self.values.len() as u32;
        }
        &mut self.values[self.at[place] as usize - 1]
    }
}

/// A place in the picture, whatever the camera's pixels and whichever way it looks.
fn in_picture(direction: &Vector3<f64>) -> [f64; 2] {
    // What is straight behind a lens along the axis is outside of its picture on every side.
    equisolid(direction).unwrap_or([f64::MAX; 2])
}

/// From the camera to a point, as a unit vector; along z for the camera's own place.
pub(super) fn towards(camera: &Point3<f64>, p: &Point3<f64>) -> Vector3<f64> {
    (p - camera).try_normalize(1e-9).unwrap_or_else(Vector3::z)
}

/// A corner of a triangle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    pub node: usize,
    pub position: Point3<f64>,
    pub in_picture: [f64; 2],
}

/// What a ray meets.
#[derive(Debug, Clone, Copy)]
pub(super) struct Met {
    /// \[m\] from the camera.
    pub depth: f64,
    /// Nodes of the triangle, and how much of each.
    pub corners: [usize; 3],
    pub shares: [f64; 3],
}

/// Rays from the camera through the nodes of an untouched grid.
#[derive(Debug, Clone, Default)]
pub(super) struct Rays {
    pub camera: Point3<f64>,
    /// Unit.
    pub directions: Vec<Vector3<f64>>,
    in_picture: Vec<[f64; 2]>,
    /// First corner of the bins, their side, and how many there are across and down.
    corner: [f64; 2],
    side: f64,
    bins: [usize; 2],
    /// Rays, bin by bin, and where those of a bin begin.
    sorted: Vec<u32>,
    starts: Vec<u32>,
}

impl Rays {
    pub fn new(camera: Point3<f64>, directions: Vec<Vector3<f64>>) -> Self {
        let in_picture: Vec<[f64; 2]> = directions.iter().map(in_picture).collect();
        let [low, high] = bounds(&in_picture);
        let (across, down) = ((high[0] - low[0]).max(1e-9), (high[1] - low[1]).max(1e-9));
        let side = (across * down * EACH / in_picture.len().max(1) as f64).sqrt();
        let bins = [across, down].map(|extent| (extent / side) as usize + 1);
        let mut rays = Self { camera, directions, in_picture, corner: low, side, bins, ..Self::default() };
        let bin_of = |at: &[f64; 2]| rays.bin(at[1], 1) * bins[0] + rays.bin(at[0], 0);
        (rays.starts, rays.sorted) = grouped(bins[0] * bins[1], rays.in_picture.iter().map(bin_of));
        rays
    }

    /// The bin across or down that a coordinate is in, or that is nearest.
    fn bin(&self, at: f64, axis: usize) -> usize {
        (((at - self.corner[axis]) / self.side).max(0.0) as usize).min(self.bins[axis] - 1)
    }

    /// Where a point is in the picture.
    pub fn place(&self, p: &Point3<f64>) -> [f64; 2] {
        in_picture(&towards(&self.camera, p))
    }

    /// Calls with each ray that is wanted and meets a triangle, and what it meets.
    pub fn each_through(
        &self,
        corners: [&Corner; 3],
        wanted: impl Fn(usize) -> bool,
        mut each: impl FnMut(usize, Met),
    ) {
        let [low, high] = bounds(&corners.map(|corner| corner.in_picture));
        let beside = BESIDE * (high[0] - low[0]).max(high[1] - low[1]);
        let (low, high) = (low.map(|v| v - beside), high.map(|v| v + beside));
        let [a, first, second] = corners.map(|corner| corner.position);
        let (first, second, from) = (first - a, second - a, self.camera - a);
        let across = from.cross(&first);
        let nodes = corners.map(|corner| corner.node);
        for row in self.bin(low[1], 1)..=self.bin(high[1], 1) {
            // Bins of a row follow each other.
            let [left, right] = [low[0], high[0]].map(|at| row * self.bins[0] + self.bin(at, 0));
            let [from_ray, to_ray] = [left, right + 1].map(|bin| self.starts[bin] as usize);
            for ray in &self.sorted[from_ray..to_ray] {
                let ray = *ray as usize;
                let [x, y] = self.in_picture[ray];
                if x < low[0] || x > high[0] || y < low[1] || y > high[1] || !wanted(ray) {
                    continue;
                }
                let direction = &self.directions[ray];
                let h = direction.cross(&second);
                let volume = first.dot(&h);
                if volume == 0.0 {
                    continue;
                }
                let beyond = [from.dot(&h) / volume, direction.dot(&across) / volume];
                let shares = [1.0 - beyond[0] - beyond[1], beyond[0], beyond[1]];
                let depth = second.dot(&across) / volume;
                if depth > 0.0 && shares.iter().all(|share| *share >= -ROUNDING) {
                    each(ray, Met { depth, corners: nodes, shares });
                }
            }
        }
    }
}

/// Least and largest coordinates of some places.
fn bounds(places: &[[f64; 2]]) -> [[f64; 2]; 2] {
    let of = |from: f64, choose: fn(f64, f64) -> f64| {
        [0, 1].map(|axis| places.iter().fold(from, |best, place| choose(best, place[axis])))
    };
    [of(f64::INFINITY, f64::min), of(f64::NEG_INFINITY, f64::max)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn rays_meet_a_plane_where_it_is_and_none_beside_a_triangle() {
        let camera = Point3::new(0.001, -0.002, 0.003);
        let through = |i: usize| Point3::new((i % 40) as f64 / 40.0 - 0.5, (i / 40) as f64 / 40.0 - 0.5, 1.0);
        let directions: Vec<Vector3<f64>> = (0..1600).map(|i| (through(i) - camera).normalize()).collect();
        let rays = Rays::new(camera, directions.clone());
        let at = [[-0.3, -0.2, 0.5], [0.31, -0.1, 0.6], [0.02, 0.36, 0.7]].map(Point3::from);
        let corners =
            [0, 1, 2].map(|node| Corner { node, position: at[node], in_picture: rays.place(&at[node]) });
        let mut met = vec![None; 1600];
        rays.each_through(
            [&corners[0], &corners[1], &corners[2]],
            |ray| ray != 7,
            |ray, found| met[ray] = Some(found),
        );
        let normal = (at[1] - at[0]).cross(&(at[2] - at[0]));
        let mut inside = 0;
        for (direction, met) in directions.iter().zip(&met) {
            // Shares of a point of the plane are those of the areas opposite its corners.
            let p = camera + direction * (normal.dot(&(at[0] - camera)) / normal.dot(direction));
            let area = |k: usize| {
                let [b, c] = [at[(k + 1) % 3], at[(k + 2) % 3]];
                normal.dot(&(b - p).cross(&(c - p))) / normal.norm_squared()
            };
            let shares = [0, 1, 2].map(area);
            assert_eq!(met.is_some(), shares.iter().all(|share| *share >= 0.0), "{shares:?}");
            if let Some(met) = met {
                inside += 1;
                assert_relative_eq!(met.depth, (p - camera).norm(), max_relative = 1e-9);
                met.shares.iter().zip(shares).for_each(|(a, b)| assert_relative_eq!(*a, b, epsilon = 1e-9));
            }
        }
        assert!(inside > 100, "{inside}");
    }

    #[test]
    fn few_of_many_places_have_values() {
        let mut sparse = Sparse::default();
        for size in [5, 5, 9] {
            sparse.clear(size);
            assert!((0..size).all(|place| !sparse.has(place)));
            *sparse.or_insert_with(3, || 7) += 1;
            *sparse.or_insert_with(3, || 0) += 1;
            assert_eq!((sparse.get(3), sparse.get(2), &sparse.places[..]), (Some(&9), None, &[3][..]));
        }
    }
}
