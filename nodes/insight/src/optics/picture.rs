//! From the lit inside to pictures, and to the numbers of a frame.
//!
//! A table holds for every pixel which cell of the grid it sees and what it says where nothing touches. A touch adds what its nodes change,
//! linear in between, and is cut at the ends of the scale. Where the inside has ridges, the table also has what a pixel says more where a ridge
//! moves by a radian of its phase; it is a mean over parts of a pixel, and the change its first harmonic. The numbers of a frame ([`Observer`])
//! follow from the nodes' changes by a sparse matrix, and from the few pixels that a touch brings to an end of their scale or away from it
//! ([`Clipping`]), so that they need no pictures.
//!
//! Noise has the variance a·I + b² of a pixel that says I: a table of standard normal numbers, which each row reads from another place. One
//! number of the caller's is the seed of a picture.
//!
//! Cost: 20 bytes a pixel, and 12 for ridges; a picture of 410 × 308 takes 2 to 4 ms, one of 1640 × 1232 some 30 to 40 ms.

use std::sync::{Arc, OnceLock};

use dermis_skin::{Image, PixelFormat};
use nalgebra::Point3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::clipping::{Clipping, Switch};
use super::light::COLOURS;
use super::numbers::Numbers;
use super::observer::Observer;
use super::ridges::Ridges;
use super::shading::{CHANGES, Changes};
use super::table::Table;
use crate::jpeg::sent;

/// Pictures that the noise of what was compressed is taken from.
const PICTURES: u64 = 8;

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
    table: Table,
    noise: Noise,
    observer: Arc<Observer>,
    numbers: Numbers,
    clipping: Clipping,
    deviations: OnceLock<Vec<f64>>,
}

/// How far numbers of pictures of the same are apart.
struct Spread<'a> {
    observer: &'a Observer,
    numbers: Vec<f64>,
    /// Of each number over all pictures: it, and its square.
    sums: Vec<[f64; 2]>,
}

impl<'a> Spread<'a> {
    fn new(observer: &'a Observer) -> Self {
        let n = observer.numbers();
        Self { observer, numbers: vec![0.0; n], sums: vec![[0.0; 2]; n] }
    }

    fn add(&mut self, picture: &[u8]) {
        self.observer.observe(picture, &mut self.numbers);
        self.sums.iter_mut().zip(&self.numbers).for_each(|([sum, squares], value)| {
            *sum += value;
            *squares += value * value;
        });
    }

    /// By place in a block, summed over blocks in units of `noise`, so that every number counts alike.
    fn by_place(&self, noise: &[f64]) -> Vec<f64> {
        let mut spread = vec![0.0; self.observer.per_block()];
        for (block, noise) in self.sums.chunks(spread.len()).zip(noise.chunks(spread.len())) {
            for ((sum, [once, squares]), sigma) in spread.iter_mut().zip(block).zip(noise) {
                if *sigma > 0.0 {
                    *sum += (squares - once * once / PICTURES as f64) / (sigma * sigma);
                }
            }
        }
        spread
    }
}

impl Picture {
    /// Of a table, whose numbers are what `observer` makes of it: that of the design, whatever became of the device.
    #[must_use]
    pub fn new(table: Table, noise: Noise, observer: Arc<Observer>) -> Self {
        let numbers = Numbers::new(&table, &observer, noise, table.nodes);
        let clipping = Clipping::new(&table, &observer);
        Self { table, noise, observer, numbers, clipping, deviations: OnceLock::new() }
    }

    /// A picture as the camera takes it; `None` of no pixels. The rest as for [`render`](Self::render).
    #[must_use]
    pub fn image(&self, shown: &[(&Changes, f64)], brighter: f64, seed: Option<u64>) -> Option<Image> {
        let [width, height] = self.size();
        Image::new(width, height, PixelFormat::Rgb8, self.render(shown, brighter, seed))
    }

    /// A picture as a host has it that the camera sent it to; without noise, as the camera takes it.
    #[must_use]
    pub fn capture(&self, shown: &[(&Changes, f64)], brighter: f64, seed: Option<u64>) -> Option<Image> {
        let image = self.image(shown, brighter, seed)?;
        match seed {
            // Sides that no JPEG can have are refused where a picture is sent.
            Some(_) => Some(sent(&image).unwrap_or(image)),
            None => Some(image),
        }
    }

    /// Pixels across and down.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.table.size
    }

    /// What makes numbers of its pictures.
    #[must_use]
    pub fn observer(&self) -> &Arc<Observer> {
        &self.observer
    }

    /// Standard deviation of each number of a frame whose picture was sent. What compression changes of a picture is another thing for each
    /// noise, and so adds to it: it is counted in some pictures without a touch when it is first requested.
    #[must_use]
    pub fn deviations(&self) -> &[f64] {
        self.deviations.get_or_init(|| {
            let raw = self.numbers.noise();
            let factors = self.compression();
            raw.iter().zip(factors.iter().cycle()).map(|(sigma, factor)| sigma * factor).collect()
        })
    }

    /// By what factor numbers are noisier for compression, by their place in a block.
    fn compression(&self) -> Vec<f64> {
        let mut spreads = [(); 2].map(|()| Spread::new(&self.observer));
        for seed in 1..=PICTURES {
            let Some(image) = self.image(&[], 1.0, Some(seed)) else { continue };
            spreads[0].add(image.data());
            // Sides that no JPEG can have are refused where a picture is sent.
            spreads[1].add(sent(&image).as_ref().unwrap_or(&image).data());
        }
        let [raw, sent] = spreads.map(|spread| spread.by_place(self.numbers.noise()));
        let more = |(sent, raw): (&f64, &f64)| if *raw > 0.0 { (sent / raw).max(1.0).sqrt() } else { 1.0 };
        sent.iter().zip(&raw).map(more).collect()
    }

    /// The numbers of a frame without noise. Changes of the inside come with their share in the first row: those of the frame before
    /// have the more of a row, the earlier it is read. Lamps are `brighter` by this factor in a picture.
    pub fn respond(&self, shown: &[(&Changes, f64)], brighter: f64, out: &mut [f64]) {
        self.numbers.respond(shown, brighter, out);
        self.clipping.cut(&self.table, &self.observer, shown, brighter as f32, out);
        out.iter_mut().for_each(|value| *value = value.clamp(0.0, 1.0));
    }

    /// Values that a touch brings to the end of their scale or away from it.
    #[must_use]
    pub(crate) fn switches(&self, changes: &Changes, brighter: f64) -> Vec<Switch> {
        self.clipping.switches(&self.table, changes, brighter as f32)
    }

    /// What changes alone add to the numbers, to first order, where these values count otherwise than where nothing touches.
    pub(crate) fn change(&self, changes: &Changes, switches: &[Switch], brighter: f64, out: &mut [f64]) {
        self.numbers.change(changes, brighter, out);
        self.clipping.change((&self.table, &self.observer), switches, changes, brighter as f32, out);
    }

    /// A picture, row by row, three bytes a pixel; without noise where there is no seed for it. The rest as for [`respond`](Self::respond).
    #[must_use]
    pub fn render(&self, shown: &[(&Changes, f64)], brighter: f64, seed: Option<u64>) -> Vec<u8> {
        let [width, height] = self.table.size.map(|n| n as usize);
        let mut deviations = [0.0; 257];
        if seed.is_some() {
            for (i, deviation) in deviations.iter_mut().enumerate() {
                *deviation = 255.0 * self.noise.deviation(i as f64 / 256.0) as f32;
            }
        }
        let normal = normal_numbers();
        let mut state = seed.unwrap_or(0);
        let mut data = vec![0; self.table.pixels.len() * COLOURS];
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
        let width = self.table.size[0] as usize;
        let pixels = &self.table.pixels[y * width..(y + 1) * width];
        for (value, pixel) in out.as_chunks_mut::<COLOURS>().0.iter_mut().zip(pixels) {
            *value = pixel.base;
        }
        for ((changes, _), share) in shown.iter().zip(shares).filter(|(_, share)| *share > 0.0) {
            self.add(y, changes, share, out);
        }
    }

    /// Adds a share of what changes to the pixels of a row.
    fn add(&self, y: usize, changes: &Changes, share: f32, out: &mut [f32]) {
        let Table { wide, ridges, .. } = &self.table;
        let width = self.table.size[0] as usize;
        let pixels = &self.table.pixels[y * width..(y + 1) * width];
        let first = changes.rows[0].saturating_sub(1) * wide;
        let touched = first as u32..(changes.rows[1] * wide) as u32;
        for (x, (value, pixel)) in out.as_chunks_mut::<COLOURS>().0.iter_mut().zip(pixels).enumerate() {
            if !touched.contains(&pixel.corner) {
                continue;
            }
            let by = share * self.table.factor(y * width + x);
            let [a, b, c, d] =
                pixel.corners(*wide).map(|(node, weight)| (&changes.values[node], by * weight));
            let change: [f32; CHANGES] =
                std::array::from_fn(|k| a.0[k] * a.1 + b.0[k] * b.1 + c.0[k] * c.1 + d.0[k] * d.1);
            value.iter_mut().zip(change).for_each(|(v, c)| *v += c);
            if !ridges.is_empty() {
                let [along, around] = self.table.moved(y * width + x);
                for (colour, v) in value.iter_mut().enumerate() {
                    *v += along[colour] * change[COLOURS] + around[colour] * change[COLOURS + 1];
                }
            }
        }
    }

    /// What changes add to each value of the picture, in units of its noise, to first order; 0 where it is saturated.
    #[must_use]
    pub fn whitened(&self, changes: &Changes) -> Vec<f32> {
        let [width, height] = self.table.size.map(|n| n as usize);
        let mut all = vec![0.0; COLOURS * width * height];
        for (y, row) in all.chunks_exact_mut(COLOURS * width).enumerate() {
            self.add(y, changes, 1.0, row);
            let pixels = &self.table.pixels[y * width..(y + 1) * width];
            for (value, base) in row.iter_mut().zip(pixels.iter().flat_map(|pixel| pixel.base)) {
                let variance = self.noise.deviation(f64::from(base)).powi(2) + ROUNDING * ROUNDING;
                *value *= if base < 1.0 { (1.0 / variance.sqrt()) as f32 } else { 0.0 };
            }
        }
        all
    }
}

/// Standard deviation of what is lost where a value becomes a byte.
const ROUNDING: f64 = 0.288_675 / 255.0;

/// Shares of the inside of now and of the frame before in a row that is so far down, 0 to 1: a shutter that takes as long as the time between
/// frames shows in its first row what was before.
pub(super) fn shares(shown: &[(&Changes, f64)], down: f64) -> [f32; 2] {
    let before = shown.get(1).map_or(0.0, |(_, skew)| (skew * (1.0 - down)).clamp(0.0, 1.0));
    [(1.0 - before) as f32, before as f32]
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
