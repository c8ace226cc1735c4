//! From the lit inside to pictures, and to the numbers of a frame.
//!
//! A table holds for every pixel which cell of the grid it sees and what it says where nothing touches. A touch adds what its nodes change,
//! linear in between. Where the inside has ridges, the table also has what a pixel says more where a ridge moves by a radian of its phase; it is a
//! mean over parts of a pixel, and the change its first harmonic. The numbers of a frame are means over blocks of pixels. They follow from the nodes' changes by a sparse matrix, so
//! that they need no pictures: a pixel at the end of its scale has no part in it.
//!
//! Noise has the variance a·I + b² of a pixel that says I: a table of standard normal numbers, which each row reads from another place. One
//! number of the caller's is the seed of a picture.
//!
//! Cost: 20 bytes a pixel, and 12 for ridges; a picture of 410 × 308 takes 2 to 4 ms, one of 1640 × 1232 some 30 to 40 ms.

use std::collections::HashMap;
use std::sync::OnceLock;

use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::lens::Camera;
use super::light::COLOURS;
use super::shading::{CHANGES, Changes, Ridges, Shading, inside};
use super::table::{add_glint, blur, factors, in_parallel, meets, ridged};
use crate::elastic::mesh::Elastomer;

/// Noise of a pixel that says I, full scale 1: variance shot · I + read².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Variance per brightness.
    pub shot: f64,
    /// Standard deviation in the dark.
    pub read: f64,
}

impl Noise {
    /// Standard deviation at a brightness of 0 to 1.
    #[must_use]
    pub fn deviation(&self, brightness: f64) -> f64 {
        (self.shot * brightness + self.read * self.read).sqrt()
    }
}

/// What a pixel sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pixel {
    /// Upper left node of its cell, by the grid with one column more.
    corner: u32,
    /// Shares of the lower row and of the right column, of 65,535.
    beyond: [u16; 2],
    /// What it says where nothing touches; above 1 where it is saturated.
    pub(super) base: [f32; COLOURS],
}

impl Pixel {
    /// Nodes around it, by the grid with `wide` columns, and their weights.
    fn corners(&self, wide: usize) -> [(usize, f32); 4] {
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

/// What the inside has besides its shape.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Texture {
    /// Reflectance by node of the grid; 1 everywhere where empty.
    pub albedo: Vec<f64>,
    /// Bright spots: place, \[m\] of their radius, and what they add to a picture at their middle.
    pub glints: Vec<(Point3<f64>, f64, f64)>,
    /// \[pixels\], standard deviation of the lens' blur.
    pub blur: f64,
    /// Ridges of the inside.
    pub ridges: Option<Ridges>,
}

/// What makes pictures.
#[derive(Debug, Clone)]
pub struct Picture {
    size: [u32; 2],
    /// Columns of the grid, and one more.
    wide: usize,
    pixels: Vec<Pixel>,
    /// Factor of each pixel's changes; 1 everywhere where empty.
    texture: Vec<f32>,
    /// What each pixel says more for each radian of the ridges' phases, in parts of [`RADIAN`]; none where empty.
    ridges: Vec<[[i16; COLOURS]; 2]>,
    noise: Noise,
    blocks: [u32; 2],
    /// Means over blocks, of all pixels and of those that are not saturated, per number.
    means: Vec<f64>,
    free: Vec<f64>,
    /// Of each node of the grid with one column more: where its blocks begin.
    starts: Vec<u32>,
    /// Blocks, and what a change at the node changes of their means.
    weights: Vec<(u32, [[f32; COLOURS]; 3])>,
}

/// Parts of full scale in which the table of ridges counts.
const RADIAN: f32 = 1.0 / 8192.0;

impl Picture {
    /// The table of a camera's picture of an inside; `blocks` across and down are what a frame's numbers are means over.
    #[must_use]
    pub fn new(
        elastomer: &Elastomer,
        camera: &Camera,
        shading: &Shading,
        texture: &Texture,
        noise: Noise,
        blocks: [u32; 2],
    ) -> Self {
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
        let mut picture = Self {
            size: camera.size,
            wide,
            pixels,
            texture: factor,
            ridges,
            noise,
            blocks,
            means: Vec::new(),
            free: Vec::new(),
            starts: Vec::new(),
            weights: Vec::new(),
        };
        picture.observe_nodes(grid.rows * wide);
        picture
    }

    /// Pixels across and down.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Numbers of a frame: block by block, row by row, colour by colour.
    #[must_use]
    pub fn numbers(&self) -> usize {
        self.means.len()
    }

    fn block(&self, pixel: usize) -> usize {
        block_of(self.size, self.blocks, pixel)
    }

    /// What a pixel says more for each radian of the ridges' phases.
    fn moved(&self, pixel: usize) -> [[f32; COLOURS]; 2] {
        let of = |moved: &[[i16; COLOURS]; 2]| moved.map(|of| of.map(|v| f32::from(v) * RADIAN));
        self.ridges.get(pixel).map_or([[0.0; COLOURS]; 2], of)
    }

    fn factor(&self, pixel: usize) -> f32 {
        self.texture.get(pixel).copied().unwrap_or(1.0)
    }

    fn observe_nodes(&mut self, nodes: usize) {
        let count = self.blocks[0] as usize * self.blocks[1] as usize;
        let mut pixels_of = vec![0_u32; count];
        for pixel in 0..self.pixels.len() {
            pixels_of[self.block(pixel)] += 1;
        }
        self.means = vec![0.0; count * COLOURS];
        self.free = vec![0.0; count * COLOURS];
        let mut found: HashMap<(u32, u32), [[f32; COLOURS]; 3]> = HashMap::new();
        for (i, pixel) in self.pixels.iter().enumerate() {
            let block = self.block(i);
            let share = 1.0 / pixels_of[block] as f32;
            let open = pixel.base.map(|v| if v < 1.0 { share } else { 0.0 });
            for (colour, base) in pixel.base.iter().enumerate() {
                self.means[block * COLOURS + colour] += f64::from(base.min(1.0) * share);
                self.free[block * COLOURS + colour] += f64::from(base * open[colour]);
            }
            for (node, weight) in pixel.corners(self.wide) {
                if weight > 0.0 {
                    let sum = found.entry((node as u32, block as u32)).or_insert([[0.0; COLOURS]; 3]);
                    let by = weight * self.factor(i);
                    let [along, around] = self.moved(i);
                    for (colour, open) in open.iter().enumerate() {
                        sum[0][colour] += by * open;
                        sum[1][colour] += by * open * along[colour];
                        sum[2][colour] += by * open * around[colour];
                    }
                }
            }
        }
        let mut found: Vec<_> = found.into_iter().collect();
        found.sort_unstable_by_key(|(key, _)| *key);
        self.starts = vec![0; nodes + 1];
        for ((node, _), _) in &found {
            self.starts[*node as usize + 1] += 1;
        }
        for node in 0..nodes {
            self.starts[node + 1] += self.starts[node];
        }
        self.weights = found.into_iter().map(|((_, block), weights)| (block, weights)).collect();
    }

    /// The numbers of a frame without noise. Changes of the inside come with their share in the first row: those of the frame before
    /// have the more of a row, the earlier it is read. Lamps are `brighter` by this factor in a picture.
    pub fn respond(&self, shown: &[(&Changes, f64)], brighter: f64, out: &mut [f64]) {
        for ((value, mean), free) in out.iter_mut().zip(&self.means).zip(&self.free) {
            *value = mean + (brighter - 1.0) * free;
        }
        let [columns, rows] = self.blocks;
        for (k, (changes, _)) in shown.iter().enumerate() {
            let by_row: Vec<f32> = (0..rows)
                .map(|row| shares(shown, (f64::from(row) + 0.5) / f64::from(rows))[k] * brighter as f32)
                .collect();
            for node in &changes.nodes {
                let [from, to] = [0, 1].map(|k| self.starts[*node as usize + k] as usize);
                let change = &changes.values[*node as usize];
                for (block, weights) in &self.weights[from..to] {
                    let by = by_row[(block / columns) as usize];
                    let place = *block as usize * COLOURS;
                    let [own, along, around] = weights;
                    for (colour, value) in out[place..place + COLOURS].iter_mut().enumerate() {
                        let ridges = along[colour] * change[COLOURS] + around[colour] * change[COLOURS + 1];
                        *value += f64::from(by * (own[colour] * change[colour] + ridges));
                    }
                }
            }
        }
        out.iter_mut().for_each(|value| *value = value.clamp(0.0, 1.0));
    }

    /// A picture, row by row, three bytes a pixel; without noise where there is no seed for it. The rest as for [`respond`](Self::respond).
    #[must_use]
    pub fn render(&self, shown: &[(&Changes, f64)], brighter: f64, seed: Option<u64>) -> Vec<u8> {
        let [width, height] = self.size.map(|n| n as usize);
        let mut deviations = [0.0; 257];
        if seed.is_some() {
            for (i, deviation) in deviations.iter_mut().enumerate() {
                *deviation = 255.0 * self.noise.deviation(i as f64 / 256.0) as f32;
            }
        }
        let normal = normal_numbers();
        let mut state = seed.unwrap_or(0);
        let mut data = vec![0; self.pixels.len() * COLOURS];
        let mut line = vec![0.0_f32; COLOURS * width];
        for (y, row) in data.chunks_exact_mut(COLOURS * width).enumerate() {
            self.brightness(y, shown, shares(shown, (y as f64 + 0.5) / height as f64), &mut line);
            let start = scrambled(&mut state) as usize % (NORMAL - COLOURS * MOST);
            let normal = &normal[start..start + COLOURS * width];
            for ((byte, v), noise) in row.iter_mut().zip(&line).zip(normal) {
                let bright = (v * brighter as f32).clamp(0.0, 1.0);
                *byte = (bright * 255.0 + deviations[(bright * 256.0) as usize] * noise + 0.5) as u8;
            }
        }
        data
    }

    /// What the pixels of a row say without noise; more than 1 where they are saturated.
    fn brightness(&self, y: usize, shown: &[(&Changes, f64)], shares: [f32; 2], out: &mut [f32]) {
        let width = self.size[0] as usize;
        let pixels = &self.pixels[y * width..(y + 1) * width];
        for (value, pixel) in out.as_chunks_mut::<COLOURS>().0.iter_mut().zip(pixels) {
            *value = pixel.base;
        }
        for ((changes, _), share) in shown.iter().zip(shares).filter(|(_, share)| *share > 0.0) {
            let first = changes.rows[0].saturating_sub(1) * self.wide;
            let touched = first as u32..(changes.rows[1] * self.wide) as u32;
            for (x, (value, pixel)) in out.as_chunks_mut::<COLOURS>().0.iter_mut().zip(pixels).enumerate() {
                if !touched.contains(&pixel.corner) {
                    continue;
                }
                let by = share * self.factor(y * width + x);
                let [a, b, c, d] =
                    pixel.corners(self.wide).map(|(node, weight)| (&changes.values[node], by * weight));
                let change: [f32; CHANGES] =
                    std::array::from_fn(|k| a.0[k] * a.1 + b.0[k] * b.1 + c.0[k] * c.1 + d.0[k] * d.1);
                value.iter_mut().zip(change).for_each(|(v, c)| *v += c);
                if !self.ridges.is_empty() {
                    let [along, around] = self.moved(y * width + x);
                    for (colour, v) in value.iter_mut().enumerate() {
                        *v += along[colour] * change[COLOURS] + around[colour] * change[COLOURS + 1];
                    }
                }
            }
        }
    }
}

/// Shares of the inside of now and of the frame before in a row that is so far down, 0 to 1: a shutter that takes as long as the time between
/// frames shows in its first row what was before.
fn shares(shown: &[(&Changes, f64)], down: f64) -> [f32; 2] {
    let before = shown.get(1).map_or(0.0, |(_, skew)| (skew * (1.0 - down)).clamp(0.0, 1.0));
    [(1.0 - before) as f32, before as f32]
}

/// Block of a pixel: blocks are as equal as whole pixels let them be.
fn block_of([width, height]: [u32; 2], [columns, rows]: [u32; 2], pixel: usize) -> usize {
    let (x, y) = (pixel % width as usize, pixel / width as usize);
    y * rows as usize / height as usize * columns as usize + x * columns as usize / width as usize
}

/// Means over blocks of a picture of three bytes a pixel, 0 to 1, as [`Picture`] makes them.
pub fn means(size: [u32; 2], blocks: [u32; 2], data: &[u8], out: &mut [f64]) {
    let mut sums = vec![[0_u32; COLOURS + 1]; blocks[0] as usize * blocks[1] as usize];
    let width = size[0] as usize;
    let columns: Vec<usize> = (0..width).map(|x| x * blocks[0] as usize / width).collect();
    for (y, row) in data.chunks_exact(width * COLOURS).enumerate() {
        let first = block_of(size, blocks, y * width);
        for (pixel, column) in row.as_chunks::<COLOURS>().0.iter().zip(&columns) {
            let sum = &mut sums[first + column];
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += u32::from(*value);
            }
            sum[COLOURS] += 1;
        }
    }
    for (out, sum) in out.chunks_exact_mut(COLOURS).zip(&sums) {
        let full = 255.0 * f64::from(sum[COLOURS].max(1));
        out.iter_mut().zip(sum).for_each(|(value, sum)| *value = f64::from(*sum) / full);
    }
}

/// Standard normal numbers of the table.
const NORMAL: usize = 1 << 16;
/// Pixels of a row at most.
pub const MOST: usize = 4096;

fn normal_numbers() -> &'static [f32] {
    static NUMBERS: OnceLock<Vec<f32>> = OnceLock::new();
    NUMBERS.get_or_init(|| {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        (0..NORMAL).map(|_| rng.sample::<f32, _>(StandardNormal)).collect()
    })
}

/// The next of a stream of scrambled numbers (G. Steele and others, SplitMix64, 2014).
fn scrambled(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
