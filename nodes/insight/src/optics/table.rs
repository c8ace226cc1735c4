//! What the table of a picture is made of: where rays meet the inside, and what they see there.
//!
//! Rays meet the inside in closed form, and the slope of its fovea by sampling and bisection. Ridges are averaged over parts of a pixel, as a
//! coarser picture of a finer camera is. Albedo, glints and blur change the table where nothing touches.
//!
//! Cost: a ray and a lighting for each pixel of a smooth inside; with ridges a ray and five lightings for each part of it.

use dermis_model::in_parallel;
use nalgebra::{Point3, Vector3};

use super::lens::Camera;
use super::light::{COLOURS, Light};
use super::picture::Texture;
use super::ridges::Ridges;
use super::shading::{Shading, inside};
use crate::elastic::basis::Grid;
use crate::elastic::mesh::Elastomer;

/// \[rad\] by which ridges are moved for a difference.
const MOVED: f64 = 0.3;
/// Pixels of a row below which a pixel is inspected in parts, and such parts along a side at most.
const FINE: u32 = 1640;
const PARTS: u32 = 2;

/// \[m\] to which the length of a ray is known.
const CLOSE: f64 = 1e-9;
/// Parts of a ray between where the elastomer could be thickest and where it could be thinnest, each shorter than the slope of a fovea is wide.
const SAMPLES: u32 = 32;

/// What a pixel sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pixel {
    /// Upper left node of its cell, by the grid with one column more.
    pub(super) corner: u32,
    /// Shares of the lower row and of the right column, of 65,535.
    beyond: [u16; 2],
    /// What it says where nothing touches; above 1 where it is saturated.
    pub(super) base: [f32; COLOURS],
}

impl Pixel {
    /// Nodes around it, by the grid with `wide` columns, and their weights.
    pub(super) fn corners(&self, wide: usize) -> [(usize, f32); 4] {
        let [down, right] = self.beyond.map(|b| f32::from(b) / f32::from(u16::MAX));
        let corner = self.corner as usize;
        [
            (corner, (1.0 - down) * (1.0 - right)),
            (corner + 1, (1.0 - down) * right),
            (corner + wide, down * (1.0 - right)),
            (corner + wide + 1, down * right),
        ]
    }
}

/// Parts of full scale in which the table of ridges counts.
const RADIAN: f32 = 1.0 / 8192.0;

/// What every pixel sees.
#[derive(Debug, Clone)]
pub struct Table {
    pub(super) size: [u32; 2],
    /// Columns of the grid, and one more.
    pub(super) wide: usize,
    /// Nodes of the grid with one column more.
    pub(super) nodes: usize,
    pub(super) pixels: Vec<Pixel>,
    /// Factor of each pixel's changes; 1 everywhere where empty.
    texture: Vec<f32>,
    /// What each pixel says more for each radian of the ridges' phases, in parts of [`RADIAN`]; none where empty.
    pub(super) ridges: Vec<[[i16; COLOURS]; 2]>,
}

impl Table {
    /// Of a camera's picture of an inside.
    #[must_use]
    pub fn new(elastomer: &Elastomer, camera: &Camera, shading: &Shading, texture: &Texture) -> Self {
        let grid = *shading.grid();
        let wide = grid.columns + 1;
        let [width, height] = camera.size.map(|n| n as usize);
        let light = shading.light();
        let see = |i: usize| {
            let at = [(i % width) as f64 + 0.5, (i / width) as f64 + 0.5];
            let [s, azimuth] = meets(elastomer, camera, at).unwrap_or([elastomer.thumb.length(), 0.0]);
            let (row, column, down, right) = grid.cell(s, azimuth);
            let (p, normal) = inside(elastomer, s, azimuth);
            let view = (camera.position - p).try_normalize(1e-9).unwrap_or_else(Vector3::z);
            Pixel {
                corner: (row * wide + column) as u32,
                beyond: [down, right].map(|b| (b.clamp(0.0, 1.0) * f64::from(u16::MAX)).round() as u16),
                base: light.seen(light.radiance(&p, &normal, &view)),
            }
        };
        let mut pixels = in_parallel(width * height, see);
        let mut ridges = Vec::new();
        if let Some(known) = &texture.ridges {
            let place = |i: usize| [i % width, i / width];
            let ridged = in_parallel(width * height, |i| ridged(elastomer, camera, light, known, place(i)));
            ridges.reserve_exact(ridged.len());
            for (pixel, (base, moved)) in pixels.iter_mut().zip(ridged) {
                pixel.base = base;
                ridges.push(moved.map(|of| of.map(|v| (v / RADIAN).clamp(-32e3, 32e3) as i16)));
            }
        }
        let albedo = factors(&grid, &texture.albedo, light.gamma);
        let mut factor = Vec::new();
        if !albedo.is_empty() {
            factor.extend(pixels.iter().map(|pixel| {
                pixel.corners(wide).iter().map(|(node, weight)| albedo[*node] * weight).sum::<f32>()
            }));
            for (pixel, factor) in pixels.iter_mut().zip(&factor) {
                pixel.base = pixel.base.map(|v| v * factor);
            }
        }
        for glint in &texture.glints {
            add_glint(&mut pixels, width, camera, glint);
        }
        if texture.blur > 0.0 {
            blur(&mut pixels, [width, height], texture.blur);
        }
        Self { size: camera.size, wide, nodes: grid.rows * wide, pixels, texture: factor, ridges }
    }

    /// What a pixel says more for each radian of the ridges' phases.
    pub(super) fn moved(&self, pixel: usize) -> [[f32; COLOURS]; 2] {
        let of = |moved: &[[i16; COLOURS]; 2]| moved.map(|of| of.map(|v| f32::from(v) * RADIAN));
        self.ridges.get(pixel).map_or([[0.0; COLOURS]; 2], of)
    }

    /// Factor of a pixel's changes.
    pub(super) fn factor(&self, pixel: usize) -> f32 {
        self.texture.get(pixel).copied().unwrap_or(1.0)
    }
}

/// (s, φ) of the inside that a place of the picture shows.
#[must_use]
pub fn meets(elastomer: &Elastomer, camera: &Camera, pixel: [f64; 2]) -> Option<[f64; 2]> {
    met_along(elastomer, &camera.position, &camera.direction(pixel)?)
}

/// (s, φ) where a ray from a point along a unit vector meets the inside for the first time, to 1 nm along the ray.
///
/// In closed form where the elastomer is as thick as it can be; along the slope of a fovea by sampling and bisection: a ray that grazes the
/// slope can pass through it, and the wall is met again behind it.
#[must_use]
pub fn met_along(elastomer: &Elastomer, from: &Point3<f64>, ray: &Vector3<f64>) -> Option<[f64; 2]> {
    let thumb = &elastomer.thumb;
    let met = |way: f64| {
        let (s, azimuth, depth) = thumb.locate(&(from + ray * way));
        ([s, azimuth], depth - elastomer.thickness_at(s, azimuth))
    };
    let [thin, thick] = elastomer.thicknesses();
    let first = thumb.way_out(from, ray, thick)?;
    let (mut place, left) = met(first);
    if left > CLOSE {
        let part = (thumb.way_out(from, ray, thin)? - first) / f64::from(SAMPLES);
        let sample = |k: u32| first + f64::from(k) * part;
        let end = (1..SAMPLES).find(|k| met(sample(*k)).1 <= 0.0).unwrap_or(SAMPLES);
        let [mut within, mut beyond] = [end - 1, end].map(sample);
        while beyond - within > CLOSE {
            let middle = f64::midpoint(within, beyond);
            if met(middle).1 > 0.0 { within = middle } else { beyond = middle }
        }
        place = met(beyond).0;
    }
    // Rays that leave through the base see its rim.
    Some([place[0].min(thumb.length()), place[1]])
}

/// What a pixel of a ridged inside says, in the mean over its parts, and what it says more for each radian of the ridges' phases.
fn ridged(
    elastomer: &Elastomer,
    camera: &Camera,
    light: &Light,
    ridges: &Ridges,
    [x, y]: [usize; 2],
) -> ([f32; COLOURS], [[f32; COLOURS]; 2]) {
    let parts = FINE.div_ceil(camera.size[0]).clamp(1, PARTS);
    let share = 1.0 / (parts * parts) as f32;
    let (mut base, mut moved) = ([0.0; COLOURS], [[0.0; COLOURS]; 2]);
    for part in 0..parts * parts {
        let within = |k: u32| (f64::from(k) + 0.5) / f64::from(parts);
        let at = [x as f64 + within(part % parts), y as f64 + within(part / parts)];
        let place = meets(elastomer, camera, at).unwrap_or([elastomer.thumb.length(), 0.0]);
        let (p, normal) = inside(elastomer, place[0], place[1]);
        let view = (camera.position - p).try_normalize(1e-9).unwrap_or_else(Vector3::z);
        let (phases, along) = ridges.phases(elastomer, place, &normal);
        let lamps: Vec<_> = light.reaching(&p).collect();
        let seen = |phases: [f64; 2]| {
            light.seen(light.reflected(lamps.iter().copied(), &ridges.tilted(&normal, phases, &along), &view))
        };
        base.iter_mut().zip(seen(phases)).for_each(|(sum, v)| *sum += share * v);
        for (k, moved) in moved.iter_mut().enumerate() {
            let by = |by: f64| seen(std::array::from_fn(|i| if i == k { phases[i] + by } else { phases[i] }));
            let (more, less) = (by(MOVED), by(-MOVED));
            // The derivative of a first harmonic, by a difference over a part of its wave.
            let scale = share / (2.0 * MOVED.sin()) as f32;
            moved.iter_mut().zip(more.iter().zip(less)).for_each(|(sum, (a, b))| *sum += scale * (a - b));
        }
    }
    (base, moved)
}

/// By node of the grid with one column more, what a picture's values are multiplied by; none where nothing is.
fn factors(grid: &Grid, albedo: &[f64], gamma: f64) -> Vec<f32> {
    if albedo.len() != grid.count() {
        return Vec::new();
    }
    let of = |i: usize| {
        let (row, column) = (i / (grid.columns + 1), i % (grid.columns + 1));
        albedo[row * grid.columns + column % grid.columns].max(0.0).powf(1.0 / gamma) as f32
    };
    (0..grid.rows * (grid.columns + 1)).map(of).collect()
}

fn add_glint(pixels: &mut [Pixel], width: usize, camera: &Camera, glint: &(Point3<f64>, f64, f64)) {
    let (middle, radius, bright) = glint;
    let Some([cx, cy]) = camera.project(middle) else { return };
    let size = (camera.focal * radius / (middle - camera.position).norm().max(1e-4)).max(0.5);
    let height = pixels.len() / width;
    let span = |c: f64, most: usize| {
        let reach = 3.0 * size;
        ((c - reach).max(0.0) as usize)..((c + reach).ceil().max(0.0) as usize).min(most)
    };
    for y in span(cy, height) {
        for x in span(cx, width) {
            let off = ((x as f64 + 0.5 - cx).powi(2) + (y as f64 + 0.5 - cy).powi(2)) / (size * size);
            let by = (bright * (-0.5 * off).exp()) as f32;
            pixels[y * width + x].base.iter_mut().for_each(|v| *v += by);
        }
    }
}

/// Blurs what pixels say where nothing touches by a Gaussian, along rows and then along columns.
fn blur(pixels: &mut [Pixel], [width, height]: [usize; 2], deviation: f64) {
    let reach = (3.0 * deviation).ceil() as isize;
    let kernel: Vec<f32> =
        (-reach..=reach).map(|i| (-0.5 * (i as f64 / deviation).powi(2)).exp() as f32).collect();
    let total: f32 = kernel.iter().sum();
    let mut line: Vec<[f32; COLOURS]> = Vec::new();
    let mut along = |first: usize, step: usize, count: usize, pixels: &mut [Pixel]| {
        line.clear();
        line.extend((0..count).map(|i| pixels[first + i * step].base));
        for i in 0..count {
            let mut sum = [0.0; COLOURS];
            for (k, weight) in kernel.iter().enumerate() {
                let at = (i as isize + k as isize - reach).clamp(0, count as isize - 1) as usize;
                sum.iter_mut().zip(line[at]).for_each(|(s, v)| *s += weight * v);
            }
            pixels[first + i * step].base = sum.map(|s| s / total);
        }
    };
    (0..height).for_each(|y| along(y * width, 1, width, pixels));
    (0..width).for_each(|x| along(x, width, height, pixels));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::tests::{SMALL, skin};
    use crate::parameters::Parameters;

    /// Also where it grazes the rim of the fovea, behind which the wall is met a second time.
    #[test]
    fn a_ray_ends_at_the_first_wall() {
        let skin = skin(&SMALL.replace("size = [104, 80]", "size = [410, 308]"));
        let Parameters { elastomer, camera, .. } = Parameters::nominal(&skin).unwrap();
        let thumb = &elastomer.thumb;
        let mut walls = 0;
        for pixel in (0..410 * 308).map(|i| [f64::from(i % 410) + 0.5, f64::from(i / 410) + 0.5]) {
            let Some(ray) = camera.direction(pixel) else { continue };
            let Some([s, azimuth]) = met_along(&elastomer, &camera.position, &ray) else { continue };
            // Those that leave through the base are shown where its rim is.
            if s >= thumb.length() {
                continue;
            }
            walls += 1;
            let wall = thumb.point(s, azimuth, elastomer.thickness_at(s, azimuth)).0;
            let way = (wall - camera.position).norm();
            assert!((wall - (camera.position + ray * way)).norm() < 1e-8, "{pixel:?}");
            for share in (0..40).map(|i| f64::from(i) / 40.0) {
                let (s, azimuth, depth) = thumb.locate(&(camera.position + ray * (way * share)));
                let left = depth - elastomer.thickness_at(s, azimuth);
                assert!(left > 0.0, "{pixel:?} at {share} of the way: {left} m");
            }
        }
        assert!(walls > 100_000, "{walls}");
    }
}
