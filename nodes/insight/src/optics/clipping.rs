//! What pixels at the ends of their scale keep from the numbers of a frame.
//!
//! Problem: [`Numbers`](super::numbers::Numbers) add up what changes, as if each pixel stayed as open or as saturated as it is where nothing
//! touches. A strong touch turns bright locations away from the lamps and dark ones towards them: pixels leave the end of their scale and reach it,
//! and numbers near the camera would be up to a seventh too large. Method: pixels are sorted by the cell of the grid that they see; where the
//! changes at a cell's four nodes can bring none of its pixels to an end of the scale or away from it, nothing is done, elsewhere each pixel is
//! cut as it is in a picture. Assumptions: noise is small beside the scale. Cost: ten products for each cell that changes, six for each pixel
//! of those with an end in reach, and fifty for each pixel that itself may come to one; 4 bytes a pixel.

use super::grouped::grouped;
use super::light::COLOURS;
use super::observer::{Observer, PATTERNS};
use super::picture::shares;
use super::shading::{CHANGES, Changes};
use super::table::Table;

/// What the pixels of a cell have in common.
#[derive(Debug, Clone, Copy)]
struct Reach {
    /// Least that a value that is not saturated can rise by, and fall by.
    up: f32,
    down: f32,
    /// Least that a saturated value can fall by.
    over: f32,
    /// Largest factor of changes, and of what ridges' phases change.
    factor: f32,
    steep: [f32; 2],
}

const ANYWHERE: Reach =
    Reach { up: f32::INFINITY, down: f32::INFINITY, over: f32::INFINITY, factor: 0.0, steep: [0.0; 2] };

/// Pixels by cells.
#[derive(Debug, Clone)]
pub(super) struct Clipping {
    /// Rows of blocks.
    block_rows: usize,
    per_block: usize,
    /// By block: share of one pixel in a mean.
    shares: Vec<f64>,
    /// Pixels, cell by cell, and where those of a cell begin; cells by their first node, of the grid with one column more.
    pixels: Vec<u32>,
    starts: Vec<u32>,
    reach: Vec<Reach>,
}

/// A value of a pixel that a touch opens or shuts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Switch {
    pixel: u32,
    colour: u8,
    /// 1 where it counts now and does not where nothing touches, −1 where it is the other way round.
    by: f32,
}

impl Clipping {
    pub(super) fn new(table: &Table, observer: &Observer) -> Self {
        let (starts, pixels) = grouped(table.nodes, table.pixels.iter().map(|pixel| pixel.corner as usize));
        let mut reach = vec![ANYWHERE; table.nodes];
        for (i, pixel) in table.pixels.iter().enumerate() {
            let of = &mut reach[pixel.corner as usize];
            of.factor = of.factor.max(table.factor(i).abs());
            for (steep, by) in of.steep.iter_mut().zip(table.moved(i)) {
                *steep = by.iter().fold(*steep, |most, by| most.max(by.abs()));
            }
            for base in pixel.base {
                if base < 1.0 {
                    (of.up, of.down) = (of.up.min(1.0 - base), of.down.min(base));
                } else {
                    of.over = of.over.min(base - 1.0);
                }
            }
        }
        Self {
            block_rows: observer.blocks()[1] as usize,
            per_block: observer.per_block(),
            shares: observer.shares(),
            pixels,
            starts,
            reach,
        }
    }

    /// Takes from the numbers what [`Numbers::respond`](super::numbers::Numbers::respond) has too much.
    pub(super) fn cut(
        &self,
        table: &Table,
        observer: &Observer,
        shown: &[(&Changes, f64)],
        brighter: f32,
        out: &mut [f64],
    ) {
        self.each_in_reach(table, shown, brighter, |pixel, change| {
            let block = observer.block(pixel);
            let base = table.pixels[pixel].base;
            let mut wrong = [0.0_f32; COLOURS];
            for ((wrong, base), change) in wrong.iter_mut().zip(base).zip(change) {
                let counted = if base < 1.0 { brighter * change } else { 0.0 };
                let seen = |v: f32| (brighter * v).clamp(0.0, 1.0);
                *wrong = seen(base + change) - seen(base) - counted;
            }
            if wrong != [0.0; COLOURS] {
                self.add(observer, pixel, block, wrong, out);
            }
        });
    }

    /// Values that count otherwise than where nothing touches.
    pub(super) fn switches(&self, table: &Table, changes: &Changes, brighter: f32) -> Vec<Switch> {
        let mut all = Vec::new();
        self.each_in_reach(table, &[(changes, 1.0)], brighter, |pixel, change| {
            for (colour, (base, change)) in table.pixels[pixel].base.into_iter().zip(change).enumerate() {
                let now = brighter * (base + change);
                let by = f32::from(u8::from(now > 0.0 && now < 1.0)) - f32::from(u8::from(base < 1.0));
                if by != 0.0 {
                    all.push(Switch { pixel: pixel as u32, colour: colour as u8, by });
                }
            }
        });
        all
    }

    /// Adds what changes add where these values count, to first order.
    pub(super) fn change(
        &self,
        (table, observer): (&Table, &Observer),
        switches: &[Switch],
        changes: &Changes,
        brighter: f32,
        out: &mut [f64],
    ) {
        for same in switches.chunk_by(|a, b| a.pixel == b.pixel) {
            let pixel = same[0].pixel as usize;
            let corners = table.pixels[pixel].corners(table.wide);
            let mut at = [0.0_f32; CHANGES];
            for (node, weight) in corners {
                at.iter_mut().zip(&changes.values[node]).for_each(|(sum, value)| *sum += weight * value);
            }
            if at == [0.0; CHANGES] {
                continue;
            }
            let change = seen_of(table, pixel, at);
            let mut by = [0.0_f32; COLOURS];
            for switch in same {
                let colour = usize::from(switch.colour);
                by[colour] = switch.by * brighter * change[colour];
            }
            self.add(observer, pixel, observer.block(pixel), by, out);
        }
    }

    /// Adds what a pixel's colours change to the numbers of its block.
    fn add(&self, observer: &Observer, pixel: usize, block: usize, by: [f32; COLOURS], out: &mut [f64]) {
        let numbers = &mut out[block * self.per_block..(block + 1) * self.per_block];
        let by = by.map(f64::from);
        for (number, by) in numbers.iter_mut().zip(by) {
            *number += self.shares[block] * by;
        }
        let patterns: [[f64; COLOURS]; PATTERNS] = observer.weights(pixel, block).unwrap_or_default();
        for (number, weights) in numbers[COLOURS..].iter_mut().zip(patterns) {
            *number += weights.iter().zip(by).map(|(weight, by)| weight * by).sum::<f64>();
        }
    }

    /// Calls for each pixel of the cells where an end of the scale is in reach, with what its colours change.
    fn each_in_reach(
        &self,
        table: &Table,
        shown: &[(&Changes, f64)],
        brighter: f32,
        mut each: impl FnMut(usize, [f32; COLOURS]),
    ) {
        let wide = table.wide;
        let rows = table.nodes / wide;
        let from = shown.iter().map(|(changes, _)| changes.rows[0]).min().unwrap_or(0).saturating_sub(1);
        let to =
            shown.iter().map(|(changes, _)| changes.rows[1]).max().unwrap_or(0).min(rows.saturating_sub(1));
        let block_rows = self.block_rows;
        let by_row: Vec<[f32; 2]> =
            (0..block_rows).map(|row| shares(shown, (row as f64 + 0.5) / block_rows as f64)).collect();
        let height = table.size[1] as usize;
        for corner in (from * wide..to * wide).filter(|corner| (corner + 1) % wide != 0) {
            let [begin, end] = [corner, corner + 1].map(|at| self.starts[at] as usize);
            if begin == end {
                continue;
            }
            let nodes = [corner, corner + 1, corner + wide, corner + wide + 1];
            let (mut rise, mut fall, mut phase) = (0.0_f32, 0.0_f32, [0.0_f32; 2]);
            for (changes, _) in shown {
                for node in nodes {
                    let value = &changes.values[node];
                    for change in &value[..COLOURS] {
                        (rise, fall) = (rise.max(*change), fall.max(-change));
                    }
                    for (most, value) in phase.iter_mut().zip(&value[COLOURS..]) {
                        *most = most.max(value.abs());
                    }
                }
            }
            let Reach { up, down, over, factor, steep } = self.reach[corner];
            let ridges = steep[0] * phase[0] + steep[1] * phase[1];
            let (rise, fall) = (factor * (rise + ridges), factor * (fall + ridges));
            // What is brighter reaches the end sooner.
            let room = up - (1.0 - brighter.max(1.0).recip());
            if rise + fall == 0.0 || rise <= room && fall <= down && fall <= over {
                continue;
            }
            for pixel in &self.pixels[begin..end] {
                let pixel = *pixel as usize;
                // Most pixels of the cell are farther from an end than its nearest one.
                if !reaches_an_end(table.pixels[pixel].base, brighter, [rise, fall]) {
                    continue;
                }
                let row = pixel / table.size[0] as usize * block_rows / height;
                let weights = table.pixels[pixel].corners(wide);
                let mut at = [0.0_f32; CHANGES];
                for ((changes, _), share) in shown.iter().zip(by_row[row]) {
                    for (node, weight) in weights {
                        let by = share * weight;
                        at.iter_mut().zip(&changes.values[node]).for_each(|(sum, value)| *sum += by * value);
                    }
                }
                each(pixel, seen_of(table, pixel, at));
            }
        }
    }
}

/// Whether a pixel that says `base` where nothing touches may count otherwise where its colours rise and fall by so much at most.
fn reaches_an_end(base: [f32; COLOURS], brighter: f32, [rise, fall]: [f32; 2]) -> bool {
    let open = |base: f32| brighter * (base + rise) >= 1.0 || base <= fall;
    base.into_iter().any(|base| if base < 1.0 { open(base) } else { brighter * (base - fall) < 1.0 })
}

/// What a pixel's colours change where its nodes' mean changes so.
fn seen_of(table: &Table, pixel: usize, at: [f32; CHANGES]) -> [f32; COLOURS] {
    let [along, around] = table.moved(pixel);
    let factor = table.factor(pixel);
    std::array::from_fn(|colour| {
        factor * (at[colour] + along[colour] * at[COLOURS] + around[colour] * at[COLOURS + 1])
    })
}
