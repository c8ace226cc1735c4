//! A frame of a camera as blocks of a picture: where they look, which lamp lights them, and what lenses and converters make of
//! them.
//!
//! A frame has for each block of pixels the means of three colours and, for an inside with ridges, two numbers around 0.5 of how
//! far its ridges have moved. Blocks are treated as the pixels of a small picture: blur, shifts and magnification interpolate
//! between them (bilinear), light is what is encoded to the power γ. Where a block looks is found without the shape of the skin:
//! the point of its surface that lies nearest to the block's ray of an equisolid fisheye. Lamps shine as beams with a steep rim
//! that fade with the square of the distance.
//!
//! Assumptions: what a light factor does to a mean it does to all pixels of the block; numbers of ridges shrink with light and
//! contrast and do not move with the picture, beyond what they lose where ridges leave the place that they were designed for.

use dermis_skin::{SkinDescription, Surface};
use nalgebra::{Point3, Vector3};

use crate::{BenchmarkError, number};

/// Colours of a picture.
pub(super) const COLOURS: usize = 3;
/// Pixels of the width that focal lengths are given for.
const FULL_WIDTH: f64 = 1640.0;
/// What a number of ridges says where they are as designed.
const MIDDLE: f64 = 0.5;
/// Pixels of a shift that take a radian of the ridges' phase.
const RIDGE: f64 = 6.0;
/// Squares of 8 x 8 pixels that stand for a block.
const SQUARES: usize = 6;
/// Share of the light that comes from everywhere.
const AMBIENT: f64 = 0.1;

/// Blocks of a picture.
#[derive(Debug, Clone)]
pub(super) struct Blocks {
    pub columns: usize,
    pub rows: usize,
    /// Numbers of a block.
    pub per: usize,
    /// Pixels of a block across and down.
    pub pixels: [f64; 2],
    /// A picture says the power 1/γ of light.
    pub gamma: f64,
    /// Share of each lamp in the light of a block's colour that has its colour; by block, then lamp.
    lit: Vec<Vec<f64>>,
    /// Colour of each lamp.
    colours: Vec<usize>,
}

/// A picture is moved: \[px\] right and down, \[rad\] turned, and magnified.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moved {
    pub by: [f64; 2],
    pub turn: f64,
    pub larger: f64,
}

impl Blocks {
    pub fn of(skin: &SkinDescription, surface: &Surface) -> Result<Self, BenchmarkError> {
        let pair = |value: Option<&toml::Value>, field: &str| -> Result<[f64; 2], BenchmarkError> {
            let values: Option<Vec<f64>> = value.and_then(|v| v.as_array()).map(|all| {
                all.iter().filter_map(|v| v.as_float().or(v.as_integer().map(|i| i as f64))).collect()
            });
            match values.as_deref() {
                Some([a, b]) if *a >= 2.0 && *b >= 2.0 => Ok([*a, *b]),
                _ => Err(BenchmarkError::skin(skin, field, "must be two numbers from 2 on")),
            }
        };
        let [columns, rows] = pair(skin.medium.get("blocks"), "medium.blocks")?;
        let size = pair(skin.medium.get("camera").and_then(|c| c.get("size")), "medium.camera.size")?;
        let (columns, rows) = (columns as usize, rows as usize);
        let channels = skin.channels().len();
        let per = columns.checked_mul(rows).map_or(0, |count| channels / count);
        if per < COLOURS || per * columns * rows != channels {
            let reason = format!("are no three colours or more of {columns} x {rows} blocks");
            return Err(BenchmarkError::skin(skin, "channels", &reason));
        }
        let pixels = [size[0] / columns as f64, size[1] / rows as f64];
        let gamma = number(skin, "camera.gamma")?;
        let mut blocks = Self { columns, rows, per, pixels, gamma, lit: Vec::new(), colours: Vec::new() };
        blocks.light(skin, surface, size)?;
        Ok(blocks)
    }

    /// How many lamps there are.
    pub fn lamps(&self) -> usize {
        self.colours.len()
    }

    /// Which lamp lights which block how much.
    fn light(
        &mut self,
        skin: &SkinDescription,
        surface: &Surface,
        size: [f64; 2],
    ) -> Result<(), BenchmarkError> {
        let of = |key: &str| number(skin, &format!("lamps.{key}"));
        let letters = skin.medium.get("lamps").and_then(|l| l.get("colours")).and_then(|c| c.as_str());
        let letters = letters.unwrap_or_default();
        self.colours = letters.chars().filter_map(|c| "RGB".find(c)).collect();
        if self.colours.is_empty() || self.colours.len() != letters.len() {
            return Err(BenchmarkError::skin(skin, "medium.lamps.colours", "must be letters R, G and B"));
        }
        let (first, radius, height) = (of("azimuth")?, of("radius")?, of("height")?);
        let (tilt, beam, spread) = (of("tilt")?, of("beam")?, of("spread")?);
        let eye = Point3::new(0.0, 0.0, number(skin, "camera.height")?);
        let focal = number(skin, "camera.focal")? * size[0] / FULL_WIDTH;
        let count = self.colours.len() as f64;
        let lamp = |l: usize| {
            let (sin, cos) = (first + std::f64::consts::TAU * l as f64 / count).sin_cos();
            let at = Point3::new(radius * cos, radius * sin, height);
            (at, Vector3::new(tilt.sin() * cos, tilt.sin() * sin, tilt.cos()))
        };
        let rays: Vec<(Vector3<f64>, Point3<f64>)> =
            surface.points.iter().filter_map(|p| Some(((p - eye).try_normalize(1e-9)?, *p))).collect();
        for block in 0..self.columns * self.rows {
            let at = self.middle(block);
            let off = [0, 1].map(|k| at[k] - size[k] / 2.0);
            let half = (off[0].hypot(off[1]) / (2.0 * focal)).min(1.0);
            let (theta, turn) = (2.0 * half.asin(), off[1].atan2(off[0]));
            let ray = Vector3::new(theta.sin() * turn.cos(), theta.sin() * turn.sin(), theta.cos());
            let seen = rays.iter().max_by(|a, b| a.0.dot(&ray).total_cmp(&b.0.dot(&ray)));
            let place = seen.map_or(eye, |(_, p)| *p);
            let sent: Vec<f64> = (0..self.colours.len())
                .map(|l| {
                    let (at, axis) = lamp(l);
                    let way = place - at;
                    let along = way.dot(&axis).max(1e-6);
                    let beyond = (way - axis * along).norm() / (beam + spread * along);
                    (-beyond.powi(4)).exp() / way.norm_squared().max(1e-8)
                })
                .collect();
            let everywhere = AMBIENT * sent.iter().sum::<f64>() + f64::MIN_POSITIVE;
            let share = |l: usize| {
                let same = sent.iter().zip(&self.colours).filter(|(_, c)| **c == self.colours[l]);
                sent[l] / (same.map(|(s, _)| s).sum::<f64>() + everywhere)
            };
            let shares = (0..self.colours.len()).map(share).collect();
            self.lit.push(shares);
        }
        Ok(())
    }

    /// Pixels from the upper left corner to the middle of a block.
    pub fn middle(&self, block: usize) -> [f64; 2] {
        let at = [block % self.columns, block / self.columns];
        [0, 1].map(|k| (at[k] as f64 + 0.5) * self.pixels[k])
    }

    /// Pixels of the picture.
    pub fn size(&self) -> [f64; 2] {
        [self.columns as f64 * self.pixels[0], self.rows as f64 * self.pixels[1]]
    }

    /// Share of a lamp in the light of each colour of a block.
    pub fn lit_by(&self, block: usize, lamp: usize) -> [f64; COLOURS] {
        let mut shares = [0.0; COLOURS];
        shares[self.colours[lamp]] = self.lit[block][lamp];
        shares
    }

    /// Multiplies the light of a block, by colour; numbers of ridges shrink or grow with its mean.
    pub fn lighten(&self, row: &mut [f64], block: usize, factors: [f64; COLOURS]) {
        let numbers = &mut row[block * self.per..(block + 1) * self.per];
        let seen = factors.map(|f| f.max(0.0).powf(1.0 / self.gamma));
        numbers[..COLOURS].iter_mut().zip(seen).for_each(|(v, f)| *v *= f);
        let mean = seen.iter().sum::<f64>() / COLOURS as f64;
        numbers[COLOURS..].iter_mut().for_each(|v| *v = MIDDLE + (*v - MIDDLE) * mean);
    }

    /// Takes away contrast of a block: colours towards those of `towards`, ridges towards their middle.
    pub fn fade(&self, row: &mut [f64], towards: &[f64], block: usize, left: f64) {
        let of = block * self.per..(block + 1) * self.per;
        for (k, (value, towards)) in row[of.clone()].iter_mut().zip(&towards[of]).enumerate() {
            let rest = if k < COLOURS { *towards } else { MIDDLE };
            *value = rest + (*value - rest) * left;
        }
    }

    /// Changes the encoding of all means, and of ridges by its slope.
    pub fn encode(&self, row: &mut [f64], tone: impl Fn(f64) -> f64) {
        for numbers in row.chunks_mut(self.per) {
            let mean = numbers[..COLOURS].iter().sum::<f64>() / COLOURS as f64;
            let step = 1e-3;
            let slope =
                (tone(mean + step) - tone((mean - step).max(0.0))) / (mean + step - (mean - step).max(0.0));
            numbers[..COLOURS].iter_mut().for_each(|v| *v = tone(v.max(0.0)));
            numbers[COLOURS..].iter_mut().for_each(|v| *v = MIDDLE + (*v - MIDDLE) * slope);
        }
    }

    /// A number of the picture at a place \[px\], between blocks; beyond the rim that of the rim.
    fn at(&self, row: &[f64], [x, y]: [f64; 2], k: usize) -> f64 {
        let counts = [self.columns, self.rows];
        let along = [x / self.pixels[0] - 0.5, y / self.pixels[1] - 0.5];
        let [(i, s), (j, t)] = [0, 1].map(|axis| {
            let at = along[axis].clamp(0.0, (counts[axis] - 1) as f64);
            let cell = (at as usize).min(counts[axis] - 2);
            (cell, at - cell as f64)
        });
        let of = |i: usize, j: usize| row[(j * self.columns + i) * self.per + k];
        (of(i, j) * (1.0 - s) + of(i + 1, j) * s) * (1.0 - t)
            + (of(i, j + 1) * (1.0 - s) + of(i + 1, j + 1) * s) * t
    }

    /// Moves the picture.
    pub fn shift(&self, row: &mut [f64], moved: Moved) {
        let before = row.to_vec();
        let middle = self.size().map(|s| s / 2.0);
        let (sin, cos) = moved.turn.sin_cos();
        for block in 0..self.columns * self.rows {
            let at = self.middle(block);
            let off = [0, 1].map(|k| at[k] - middle[k] - moved.by[k]);
            let from =
                [cos * off[0] + sin * off[1], cos * off[1] - sin * off[0]].map(|v| v / (1.0 + moved.larger));
            let from = [0, 1].map(|k| from[k] + middle[k]);
            let way = (at[0] - from[0]).hypot(at[1] - from[1]);
            // The filter of a ridge is designed for where it was.
            let seen = (way / RIDGE).min(std::f64::consts::FRAC_PI_2).cos();
            for k in 0..self.per {
                let value = self.at(&before, from, k);
                row[block * self.per + k] =
                    if k < COLOURS { value } else { MIDDLE + (value - MIDDLE) * seen };
            }
        }
    }

    /// Blurs the picture by a disc of this radius \[px\].
    pub fn blur(&self, row: &mut [f64], radius: f64) {
        let before = row.to_vec();
        // A dozen points of equal area.
        let points: Vec<[f64; 2]> = (0..12)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * 2.399_963).sin_cos();
                let r = radius * ((f64::from(i) + 0.5) / 12.0).sqrt();
                [r * cos, r * sin]
            })
            .collect();
        // The mean over a wave of 2π RIDGE pixels, to second order.
        let left = (-(radius / RIDGE).powi(2) / 8.0).exp();
        for block in 0..self.columns * self.rows {
            let at = self.middle(block);
            for k in 0..self.per {
                let mean =
                    points.iter().map(|p| self.at(&before, [at[0] + p[0], at[1] + p[1]], k)).sum::<f64>()
                        / 12.0;
                row[block * self.per + k] = if k < COLOURS { mean } else { MIDDLE + (mean - MIDDLE) * left };
            }
        }
    }

    /// Compresses the picture: the mean of each square of 8 pixels comes in steps, and ridges are lost in them. `texture` is what
    /// pixels lie apart from their block's mean: six squares for each colour of each block.
    pub fn compress(&self, row: &mut [f64], step: f64, texture: &[f64]) {
        let left = 1.0 / (1.0 + (step / 0.04).powi(2));
        for (block, numbers) in row.chunks_mut(self.per).enumerate() {
            for (colour, v) in numbers[..COLOURS].iter_mut().enumerate() {
                let first = (block * COLOURS + colour) * SQUARES;
                let squares = &texture[first..first + SQUARES];
                let rounded = squares.iter().map(|t| ((*v + t) / step).round() * step - t);
                *v = rounded.sum::<f64>() / SQUARES as f64;
            }
            numbers[COLOURS..].iter_mut().for_each(|v| *v = MIDDLE + (*v - MIDDLE) * left);
        }
    }

    /// Numbers that [`compress`](Self::compress) needs.
    pub fn squares(&self) -> usize {
        self.columns * self.rows * COLOURS * SQUARES
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// 4 x 3 blocks of 10 pixels with five numbers each.
    fn blocks() -> Blocks {
        Blocks {
            columns: 4,
            rows: 3,
            per: 5,
            pixels: [10.0; 2],
            gamma: 2.0,
            lit: Vec::new(),
            colours: Vec::new(),
        }
    }

    /// Brighter to the right by 0.1 a block; ridges at 0.7.
    fn ramp() -> Vec<f64> {
        (0..12).flat_map(|block| [0.2 + 0.1 * f64::from(block % 4), 0.3, 0.4, 0.7, 0.5]).collect()
    }

    #[test]
    fn light_is_encoded_by_gamma_and_ridges_follow_it() {
        let mut row = ramp();
        blocks().lighten(&mut row, 1, [0.25, 1.0, 1.0]);
        approx::assert_relative_eq!(row[5], 0.15, max_relative = 1e-12);
        approx::assert_relative_eq!(row[8], 0.5 + 0.2 * (0.5 + 1.0 + 1.0) / 3.0, max_relative = 1e-12);
        assert_eq!(row[0], 0.2, "other blocks stay");
    }

    #[test]
    fn a_shifted_picture_is_the_picture_elsewhere() {
        let mut row = ramp();
        blocks().shift(&mut row, Moved { by: [10.0, 0.0], turn: 0.0, larger: 0.0 });
        // What was one block to the left.
        approx::assert_relative_eq!(row[2 * 5], 0.3, max_relative = 1e-9);
        assert!(row[2 * 5 + 3] < 0.6, "ridges have left their filter: {}", row[13]);
        let mut turned = ramp();
        blocks().shift(&mut turned, Moved { by: [0.0; 2], turn: std::f64::consts::PI, larger: 0.0 });
        approx::assert_relative_eq!(turned[0], 0.5, max_relative = 1e-9);
        let mut same = ramp();
        blocks().shift(&mut same, Moved { by: [0.0; 2], turn: 0.0, larger: 0.0 });
        same.iter().zip(ramp()).for_each(|(a, b)| approx::assert_relative_eq!(*a, b, max_relative = 1e-12));
    }

    #[test]
    fn blur_keeps_a_ramp_and_flattens_a_point() {
        let mut row = ramp();
        blocks().blur(&mut row, 3.0);
        approx::assert_relative_eq!(row[5 * 5], 0.3, epsilon = 0.01);
        let mut point = vec![0.0; 60];
        point[5 * 5] = 1.0;
        blocks().blur(&mut point, 6.0);
        assert!(point[25] < 0.9 && point[30] > 0.01, "{} {}", point[25], point[30]);
    }

    #[test]
    fn compression_comes_in_steps() {
        let blocks = blocks();
        let texture = vec![0.0; blocks.squares()];
        let mut row = ramp();
        row[0] = 0.234;
        blocks.compress(&mut row, 0.1, &texture);
        approx::assert_relative_eq!(row[0], 0.2, max_relative = 1e-9);
        assert!((row[3] - 0.5).abs() < 0.05, "{}", row[3]);
        let mut tone = ramp();
        blocks.encode(&mut tone, |v| v * v);
        approx::assert_relative_eq!(tone[0], 0.04, max_relative = 1e-12);
    }
}
