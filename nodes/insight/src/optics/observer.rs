//! From pictures to the numbers of a frame.
//!
//! Problem: a picture has some 380,000 values, and what touches changes it by less than their noise. Means over blocks of pixels keep changes
//! of colour that are wider than a block, and lose the ridges of the inside, of which a block sees several. Method: besides the means of its
//! three colours, a block has two numbers that say how far its ridges have moved, along and around: the picture less that of the untouched
//! design, times what a ridge's move changes there. That is the matched filter (D. O. North, 1943) of the changes that the forward model
//! knows: [`Shading`](super::shading::Shading) has three colours and two phases at each of its nodes. Each is scaled so that the noise of pixels makes as much of it as of a
//! mean, and is 0.5 where nothing touches the device as designed.
//!
//! Assumptions: the camera sees the ridges where the design has them; they move by less than a quarter of their wave, beyond which the number
//! falls again. Where a block sees no ridges in one direction, that number is the slope of its brightness down or across.
//!
//! Cost: 12 bytes a pixel, half a millisecond for 410 × 308 pixels.

use super::light::COLOURS;
use super::table::Table;

/// Numbers of a block that say how far its ridges have moved.
pub const PATTERNS: usize = 2;
/// What a number of ridges says where nothing touches the design.
const MIDDLE: f64 = 0.5;
/// Full scale per radian of the ridges' phase, root mean square over a block, below which it does not count as seeing them.
const FAINT: f64 = 2e-3;
/// Largest weight of a pixel in a number.
const LARGEST: f64 = 1023.0;

/// What a block's number takes of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Filter {
    /// Factor of the weights.
    scale: f64,
    /// What the untouched design gives.
    untouched: f64,
}

/// Makes numbers of pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Observer {
    size: [u32; 2],
    blocks: [u32; 2],
    /// Weights of each pixel's colours in the numbers of ridges, row by row; none for a smooth inside.
    weights: Vec<[[i16; COLOURS]; PATTERNS]>,
    /// By block.
    filters: Vec<[Filter; PATTERNS]>,
}

impl Observer {
    /// Of means alone.
    #[must_use]
    pub fn of_means(size: [u32; 2], blocks: [u32; 2]) -> Self {
        Self { size, blocks, weights: Vec::new(), filters: Vec::new() }
    }

    /// Of the picture of an untouched design.
    #[must_use]
    pub fn new(table: &Table, blocks: [u32; 2]) -> Self {
        let size = table.size;
        let mut observer = Self::of_means(size, blocks);
        if table.ridges.is_empty() {
            return observer;
        }
        let count = blocks[0] as usize * blocks[1] as usize;
        let mut pixels = vec![Vec::new(); count];
        for pixel in 0..table.pixels.len() {
            pixels[observer.block(pixel)].push(pixel);
        }
        observer.weights = vec![[[0; COLOURS]; PATTERNS]; table.pixels.len()];
        observer.filters = vec![[Filter::default(); PATTERNS]; count];
        for (block, pixels) in pixels.iter().enumerate() {
            for k in 0..PATTERNS {
                observer.filters[block][k] = observer.filter(table, pixels, k);
            }
        }
        observer
    }

    /// Chooses the weights of a block's pixels in the number `k` of its ridges.
    fn filter(&mut self, table: &Table, pixels: &[usize], k: usize) -> Filter {
        // What is saturated says nothing, unless all of it is.
        let unsaturated = |i: usize, colour: usize| table.pixels[i].base[colour] < 1.0;
        let any = pixels.iter().any(|i| (0..COLOURS).any(|colour| unsaturated(*i, colour)));
        let counts = |i: usize, colour: usize| !any || unsaturated(i, colour);
        let centred = |of: &dyn Fn(usize, usize) -> f64| -> Vec<[f64; COLOURS]> {
            let (mut sums, mut numbers) = ([0.0; COLOURS], [0.0_f64; COLOURS]);
            for i in pixels {
                for colour in (0..COLOURS).filter(|colour| counts(*i, *colour)) {
                    sums[colour] += of(*i, colour);
                    numbers[colour] += 1.0;
                }
            }
            let weight = |i: usize, colour: usize| match counts(i, colour) {
                true => of(i, colour) - sums[colour] / numbers[colour],
                false => 0.0,
            };
            pixels.iter().map(|i| std::array::from_fn(|colour| weight(*i, colour))).collect()
        };
        let energy = |weights: &[[f64; COLOURS]]| weights.iter().flatten().map(|w| w * w).sum::<f64>();
        let width = self.size[0] as usize;
        let mut weights = centred(&|i, colour| f64::from(table.moved(i)[k][colour]));
        if energy(&weights) < FAINT * FAINT * (COLOURS * pixels.len()) as f64 {
            // The tip has no ridges along meridians: rather a slope than a channel that never says anything.
            weights = centred(&|i, _| if k == 0 { (i / width) as f64 } else { (i % width) as f64 });
        }
        let most = weights.iter().flatten().fold(0.0_f64, |most, w| most.max(w.abs()));
        let (mut square, mut untouched) = (0.0, 0.0);
        for (i, weights) in pixels.iter().zip(&weights) {
            for (colour, weight) in weights.iter().enumerate() {
                let kept = if most > 0.0 { (weight / most * LARGEST).round() } else { 0.0 };
                self.weights[*i][k][colour] = kept as i16;
                square += kept * kept;
                untouched += kept * f64::from(table.pixels[*i].base[colour].min(1.0));
            }
        }
        // A mean over N values has 1/√N of their noise, and so has a sum whose weights' squares add up to 1/N.
        let scale = if square > 0.0 { 1.0 / (pixels.len() as f64 * square).sqrt() } else { 0.0 };
        Filter { scale, untouched: untouched * scale }
    }

    /// Pixels across and down.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Blocks across and down.
    #[must_use]
    pub fn blocks(&self) -> [u32; 2] {
        self.blocks
    }

    /// Numbers of each block: its colours and, with ridges, how far these have moved.
    #[must_use]
    pub fn per_block(&self) -> usize {
        if self.weights.is_empty() { COLOURS } else { COLOURS + PATTERNS }
    }

    /// Numbers of a picture: block by block, row by row.
    #[must_use]
    pub fn numbers(&self) -> usize {
        self.blocks[0] as usize * self.blocks[1] as usize * self.per_block()
    }

    /// Share of one pixel in a mean of its block, by block.
    pub(super) fn shares(&self) -> Vec<f64> {
        let [blocks, pixels] = [self.blocks, self.size].map(|[a, b]| (a * b) as usize);
        let mut counts = vec![0_u32; blocks];
        (0..pixels).for_each(|pixel| counts[self.block(pixel)] += 1);
        counts.into_iter().map(|count| 1.0 / f64::from(count)).collect()
    }

    /// Block of a pixel: blocks are as equal as whole pixels let them be.
    pub(super) fn block(&self, pixel: usize) -> usize {
        let ([width, height], [columns, rows]) = (self.size, self.blocks);
        let (x, y) = (pixel % width as usize, pixel / width as usize);
        y * rows as usize / height as usize * columns as usize + x * columns as usize / width as usize
    }

    /// What a pixel's colours count in the numbers of its block's ridges; none for a smooth inside.
    pub(super) fn weights(&self, pixel: usize, block: usize) -> Option<[[f64; COLOURS]; PATTERNS]> {
        let weights = self.weights.get(pixel)?;
        let by = |k: usize| weights[k].map(|w| f64::from(w) * self.filters[block][k].scale);
        Some(std::array::from_fn(by))
    }

    /// What the numbers of a block's ridges are more than the sum of its pixels' colours by their [weights](Self::weights).
    pub(super) fn offsets(&self, block: usize) -> [f64; PATTERNS] {
        self.filters.get(block).map_or([0.0; PATTERNS], |of| of.map(|f| MIDDLE - f.untouched))
    }

    /// The numbers of a picture of three bytes a pixel; `out` has room for [`numbers`](Self::numbers).
    pub fn observe(&self, data: &[u8], out: &mut [f64]) {
        let per = self.per_block();
        let width = self.size[0] as usize;
        let blocks = self.blocks[0] as usize * self.blocks[1] as usize;
        let mut sums = vec![[0_u32; COLOURS + 1]; blocks];
        let mut moved = vec![[0_i64; PATTERNS]; self.filters.len()];
        let edge = |k: usize| (k * width).div_ceil(self.blocks[0] as usize);
        for (y, row) in data.chunks_exact(width * COLOURS).enumerate() {
            let first = self.block(y * width);
            for column in 0..self.blocks[0] as usize {
                let (from, to) = (edge(column), edge(column + 1));
                let pixels = row[from * COLOURS..to * COLOURS].as_chunks::<COLOURS>().0;
                let sum = &mut sums[first + column];
                for pixel in pixels {
                    sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += u32::from(*value));
                }
                sum[COLOURS] += (to - from) as u32;
                if let Some(moved) = moved.get_mut(first + column) {
                    let mut line = [0_i32; PATTERNS];
                    for (pixel, weights) in pixels.iter().zip(&self.weights[y * width + from..y * width + to])
                    {
                        for (line, weights) in line.iter_mut().zip(weights) {
                            for (value, weight) in pixel.iter().zip(weights) {
                                *line += i32::from(*value) * i32::from(*weight);
                            }
                        }
                    }
                    moved.iter_mut().zip(line).for_each(|(moved, line)| *moved += i64::from(line));
                }
            }
        }
        for (block, (out, sum)) in out.chunks_exact_mut(per).zip(&sums).enumerate() {
            let full = 255.0 * f64::from(sum[COLOURS].max(1));
            out.iter_mut().zip(&sum[..COLOURS]).for_each(|(value, sum)| *value = f64::from(*sum) / full);
            if let Some(moved) = moved.get(block) {
                for (k, (value, offset)) in out[COLOURS..].iter_mut().zip(self.offsets(block)).enumerate() {
                    let seen = moved[k] as f64 / 255.0 * self.filters[block][k].scale + offset;
                    *value = seen.clamp(0.0, 1.0);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks of other widths than their neighbours, too.
    #[test]
    fn means_are_those_of_the_blocks_pixels() {
        let observer = Observer::of_means([7, 4], [3, 2]);
        let data: Vec<u8> = (0..7 * 4 * 3).map(|i| (i * 37 % 251) as u8).collect();
        let mut found = vec![0.0; observer.numbers()];
        observer.observe(&data, &mut found);
        let (mut sums, mut counts) = (vec![0.0; 18], [0.0; 6]);
        for pixel in 0..28 {
            let block = observer.block(pixel);
            counts[block] += 1.0;
            (0..3).for_each(|c| sums[3 * block + c] += f64::from(data[3 * pixel + c]) / 255.0);
        }
        for (i, (sum, value)) in sums.iter().zip(&found).enumerate() {
            assert!((sum / counts[i / 3] - value).abs() < 1e-12, "{i}");
        }
    }
}
