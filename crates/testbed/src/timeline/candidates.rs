//! Where a surface can be touched.

use std::collections::BTreeMap;

use dermis_skin::Surface;
use nalgebra::{Point3, Vector3};
use rand::Rng;

use crate::plan::PRESSES_MAX;

/// Where a surface can be touched.
pub(super) struct CandidateLocations<'a> {
    pub(super) surface: &'a Surface,
    /// Sum of the areas of the triangles up to and with each.
    cumulative: Vec<f64>,
    /// Edges of one triangle only.
    rim: Vec<[Point3<f64>; 2]>,
    margin: f64,
    region: Option<[[f64; 3]; 2]>,
}

impl<'a> CandidateLocations<'a> {
    pub(super) fn new(surface: &'a Surface, margin: f64, region: Option<[[f64; 3]; 2]>) -> Self {
        let mut sum = 0.0;
        let mut uses: BTreeMap<[u32; 2], u32> = BTreeMap::new();
        let mut cumulative = Vec::with_capacity(surface.triangles.len());
        for t in &surface.triangles {
            let [a, b, c] = t.map(|i| surface.points[i as usize]);
            sum += (b - a).cross(&(c - a)).norm() / 2.0;
            cumulative.push(sum);
            for [i, j] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
                *uses.entry([i.min(j), i.max(j)]).or_default() += 1;
            }
        }
        let rim = uses.into_iter().filter(|(_, n)| *n == 1);
        let rim = rim.map(|(edge, _)| edge.map(|i| surface.points[i as usize])).collect();
        Self { surface, cumulative, rim, margin, region }
    }

    pub(super) fn random(&self, rng: &mut impl Rng) -> Point3<f64> {
        let total = self.cumulative.last().copied().unwrap_or_default();
        let pick = rng.random_range(0.0..1.0) * total;
        let index = self.cumulative.partition_point(|a| *a < pick).min(self.cumulative.len() - 1);
        let [a, b, c] = self.surface.triangles[index].map(|i| self.surface.points[i as usize]);
        let (mut u, mut v): (f64, f64) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        self.surface.project(&(a + (b - a) * u + (c - a) * v)).0
    }

    /// Edges that a place is compared with.
    pub(super) fn edges(&self) -> u64 {
        if self.margin > 0.0 { self.rim.len() as u64 } else { 0 }
    }

    /// Whether a place lies in the region and keeps the margin.
    pub(super) fn may_be_touched(&self, p: &Point3<f64>) -> bool {
        self.lies_within(p) && self.keeps_margin(p)
    }

    fn lies_within(&self, p: &Point3<f64>) -> bool {
        let inside = |[low, high]: [[f64; 3]; 2]| (0..3).all(|k| (low[k]..=high[k]).contains(&p[k]));
        self.region.is_none_or(inside)
    }

    fn keeps_margin(&self, p: &Point3<f64>) -> bool {
        // Rounding must not drop a place that is exactly the margin away.
        let least = self.margin * (1.0 - 1e-9);
        least <= 0.0
            || self.rim.iter().all(|[a, b]| {
                let edge = b - a;
                let along = ((p - a).dot(&edge) / edge.norm_squared()).clamp(0.0, 1.0);
                (p - (a + edge * along)).norm() >= least
            })
    }

    /// Points that keep the margin: on a flat skin a centred grid of that pitch along x and y; on a curved one points of its
    /// triangulation, at least one pitch from one another along one of the axes.
    ///
    /// # Errors
    ///
    /// Why that pitch cannot be.
    pub(super) fn grid(&self, pitch: [f64; 2]) -> Result<Vec<Point3<f64>>, String> {
        let points = &self.surface.points;
        let (low, high) =
            points.iter().fold((points[0], points[0]), |(low, high), p| (low.inf(p), high.sup(p)));
        if high.z - low.z < 1e-9 {
            let middle = nalgebra::center(&low, &high);
            let count = |axis: usize| {
                let usable = high[axis] - low[axis] - 2.0 * self.margin;
                // Rounding must not drop a line that just fits.
                if usable < -1e-12 { 0.0 } else { (usable.max(0.0) / pitch[axis] + 1e-9).floor() + 1.0 }
            };
            let [nx, ny] = [count(0), count(1)];
            if nx * ny > PRESSES_MAX as f64 {
                return Err(format!(
                    "makes {:.0} locations; {PRESSES_MAX} contacts at most fit a recording",
                    nx * ny
                ));
            }
            let along = |k: u32, n: f64, pitch: f64| (f64::from(k) - (n - 1.0) / 2.0) * pitch;
            let mut locations = Vec::new();
            for j in 0..ny as u32 {
                for i in 0..nx as u32 {
                    let offset = Vector3::new(along(i, nx, pitch[0]), along(j, ny, pitch[1]), 0.0);
                    locations.push(self.surface.project(&(middle + offset)).0);
                }
            }
            locations.retain(|p| self.lies_within(p));
            return Ok(locations);
        }
        let [pitch, other] = pitch;
        if pitch != other {
            return Err("is of two numbers, which a flat skin has only".into());
        }
        let mut sides: Vec<f64> = self
            .surface
            .triangles
            .iter()
            .map(|t| (points[t[0] as usize] - points[t[1] as usize]).norm())
            .collect();
        sides.sort_by(f64::total_cmp);
        let spacing = sides.get(sides.len() / 2).copied().unwrap_or_default();
        if pitch < 0.9 * spacing {
            return Err(format!(
                "is {pitch} m, and the points of this curved surface are {spacing:.6} m apart: take a wider pitch, or a \
                 finer `surface.spacing` in the skin description"
            ));
        }
        let mut chosen: Vec<Point3<f64>> = Vec::new();
        // Rounding must not drop a neighbour that is exactly one pitch away.
        let least = pitch * (1.0 - 1e-9);
        for p in points {
            if self.may_be_touched(p) && chosen.iter().all(|q| (p - q).amax() >= least) {
                chosen.push(*p);
            }
        }
        Ok(chosen)
    }
}
